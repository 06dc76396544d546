//! Computes batches in chunks on the compute threads. The work stops when the caller has left, and
//! the bytes of an answer do not depend on how the batch was split.
//!
//! Small batches are computed on the thread that serves the call, because handing a batch to other
//! threads and back costs 20 to 40 us. The estimated cost of a batch decides whether it is small,
//! and how it is cut into chunks ([`Chunks`]).

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};

use tracing::Instrument;

use super::{
    Batch,
    chunks::Chunks,
    run::{Chunked, Run, Spare, Unanswered},
};
use crate::{
    budget::{Caller, Permit},
    compute::{Compute, ComputeError, Job, Panicked, caught},
    log_limit::limited,
    metrics::Metrics,
    service::{
        Outputs,
        admission::{Admission, AdmissionQueue},
        context::no_memory,
        error::ServiceError,
        injected::Injected,
        wire::Columns,
    },
    size::ByteSize,
    trace,
};

/// Computes batches, with a limit on the pairs in flight.
#[derive(Debug)]
pub struct Engine {
    compute: Compute,
    admission: Arc<AdmissionQueue>,
    metrics: Arc<Metrics>,
    shared: Arc<Shared>,
}

/// The part of an engine that every batch uses while it is computed.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) max_answer_bytes: usize,
    pub(super) pairs_computed: AtomicU64,
    pub(super) spare: Spare,
    pub(super) injected: Injected,
}

/// The limits of an engine.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// The most pairs that one caller may have in flight.
    pub max_pairs_in_flight: u32,
    /// Whether callers share the pairs in flight by dynamic thresholds.
    pub shares: bool,
    /// The most bytes of an answer.
    pub max_answer_bytes: usize,
}

impl Engine {
    /// An engine that computes on `compute`.
    pub fn new(compute: Compute, bounds: Bounds, metrics: Arc<Metrics>) -> Self {
        Self {
            compute,
            admission: AdmissionQueue::new(bounds.max_pairs_in_flight, bounds.shares, metrics.clone()),
            metrics,
            shared: Arc::new(Shared {
                max_answer_bytes: bounds.max_answer_bytes,
                pairs_computed: AtomicU64::new(0),
                spare: Spare::default(),
                injected: Injected::default(),
            }),
        }
    }

    /// Controls for tests of overload.
    #[doc(hidden)]
    pub fn injected(&self) -> &Injected {
        &self.shared.injected
    }

    /// The number of pairs computed since the start.
    pub fn pairs_computed(&self) -> u64 {
        self.shared.pairs_computed.load(Ordering::Relaxed)
    }

    /// The number of compute threads.
    pub fn threads(&self) -> usize {
        self.compute.threads()
    }

    /// Admits a batch's pairs. Refuses the batch before any work if its answer would be too large,
    /// or if there is no capacity for it. The capacity is free again when the admission is dropped.
    ///
    /// # Errors
    /// RESPONSE_TOO_LARGE, TOO_BUSY.
    pub fn admit(&self, pairs: usize, outputs: Outputs, caller: &Caller) -> Result<Admission, ServiceError> {
        let least = pairs * outputs.pair_bytes();
        if least > self.shared.max_answer_bytes {
            return Err(too_large(self.shared.max_answer_bytes));
        }
        self.place(pairs, caller)
    }

    /// Admits pairs whose answer may have any size.
    ///
    /// # Errors
    /// TOO_BUSY.
    pub fn place(&self, pairs: usize, caller: &Caller) -> Result<Admission, ServiceError> {
        self.admission.admit(pairs, caller, self.pairs_computed())
    }

    /// Admits a later part of a call; waits until there is capacity.
    pub async fn next_place(&self, pairs: usize, caller: &Caller) -> Admission {
        self.admission.next(pairs, caller).await
    }

    /// The compute threads.
    pub fn compute_threads(&self) -> &Compute {
        &self.compute
    }

    /// The columns of all pairs, in pair order, and the permit for their memory, which grows from
    /// `memory`. Dropping the future stops the computation.
    ///
    /// # Errors
    /// RESPONSE_TOO_LARGE or TOO_BUSY as soon as the answer is known to be too large, or the
    /// caller's budget has no room for it; DEADLINE_EXCEEDED if the job was stopped; INTERNAL.
    pub async fn compute(
        &self,
        batch: Batch,
        mut admission: Admission,
        job: &Job,
        memory: Permit,
    ) -> Result<(Columns, Permit), ServiceError> {
        let pairs = batch.pair_count();
        // If the caller leaves while the batch waits, the batch may be large and must not be freed
        // on this thread.
        let waiting = self.compute.freed_here(batch, if admission.waits() { usize::MAX } else { 0 });
        self.admission.turn(&mut admission).instrument(trace::queue(pairs)).await;
        let batch = waiting.into_inner();
        let started = Instant::now();
        let run = self.begin(batch, admission, job, memory);
        let unanswered = run.unanswered.clone();
        let (columns, memory) = match self.computed(run, job).instrument(trace::compute(pairs)).await {
            Ok(answer) => answer,
            Err(error) => return Err(self.error(error, unanswered.get())),
        };
        self.metrics.compute_seconds.observe(started.elapsed().as_secs_f64());
        self.metrics.solver_iterations.inc_by(columns.solver_iterations());
        self.metrics.answered(columns.outcome_counts(), columns.flags());
        Ok((columns, memory))
    }

    async fn computed(&self, mut run: Run, job: &Job) -> Result<(Columns, Permit), ComputeError> {
        if run.batch.is_small() {
            return Ok(caught(|| run.inline())??);
        }
        if run.chunks.is_unknown() {
            // Estimating every pair's cost is also work for the compute threads.
            run = self.compute.run(|stop| run.cut(stop), job).await??;
        }
        match self.compute.split(run, job).await? {
            Chunked::Answer(answer) => Ok(*answer),
            Chunked::Large(chunks) => self
                .compute
                .run_steps(chunks.steps(), |stop| chunks.concatenated(stop), job)
                .await?
                .map_err(Into::into),
        }
    }

    pub(super) fn begin(&self, mut batch: Batch, admission: Admission, job: &Job, memory: Permit) -> Run {
        let taken = (admission, batch.lease.take());
        let chunks = Chunks::of(&batch);
        Run::new(self, batch, chunks, job, memory, taken)
    }

    fn error(&self, error: ComputeError, unanswered: Option<&Unanswered>) -> ServiceError {
        match (unanswered, error) {
            (Some(Unanswered::TooLarge), _) => too_large(self.shared.max_answer_bytes),
            (Some(Unanswered::NoMemory(why)), _) => no_memory(&self.metrics, *why),
            (None, ComputeError::Stopped) => ServiceError::deadline_exceeded(),
            (None, ComputeError::Panicked(Panicked(why))) => {
                limited!(error, why, "a batch panicked");
                ServiceError::internal("the computation failed; the server's log has the reason")
            }
        }
    }

    pub(super) fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }
}

fn too_large(limit: usize) -> ServiceError {
    ServiceError::refused(
        "RESPONSE_TOO_LARGE",
        format!("the answer would have more than {}: request fewer pairs or outputs", ByteSize(limit as u64)),
    )
}

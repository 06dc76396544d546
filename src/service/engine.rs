//! The engine of the service: the engine of `hullcast-batch`, with a limit on the pairs in flight,
//! metrics, and the errors of the service.

use std::{sync::Arc, time::Instant};

use tracing::Instrument;

#[cfg(feature = "testing")]
use super::test_controls::TestControls;
use super::{
    admission::{Admission, AdmissionQueue},
    context::no_memory,
    error::ServiceError,
    reason::Reason,
};
use crate::{
    batch::{self, Batch, Columns, EngineError, Memory, Outputs},
    budget::{Caller, NoMemory, Permit},
    compute::{Compute, Job, Panicked},
    log_limit::limited,
    metrics::Metrics,
    size::ByteSize,
    store::Lease,
    trace,
};

/// Computes batches, with a limit on the pairs in flight.
#[derive(Debug)]
pub struct ServiceEngine {
    batches: batch::Engine,
    admission: Arc<AdmissionQueue>,
    metrics: Arc<Metrics>,
    #[cfg(feature = "testing")]
    test_controls: Arc<TestControls>,
}

/// The limits of an engine.
#[derive(Clone, Copy, Debug)]
pub struct EngineLimits {
    /// The most pairs that one caller may have in flight.
    pub max_pairs_in_flight: u32,
    /// Whether callers share the pairs in flight by dynamic thresholds.
    pub shares: bool,
    /// The most bytes of an answer.
    pub max_answer_bytes: usize,
}

impl Memory for Permit {
    type Refused = NoMemory;

    fn grow(&mut self, more: u64) -> Result<(), NoMemory> {
        Self::grow(self, more)
    }

    fn shrink_to(&mut self, bytes: u64) {
        Self::shrink_to(self, bytes);
    }
}

impl ServiceEngine {
    /// An engine that computes on `compute`.
    pub fn new(compute: Compute, limits: EngineLimits, metrics: Arc<Metrics>) -> Self {
        #[cfg(feature = "testing")]
        let test_controls = Arc::<TestControls>::default();
        #[cfg(feature = "testing")]
        let batches = test_controls.engine(compute, limits.max_answer_bytes);
        #[cfg(not(feature = "testing"))]
        let batches = batch::Engine::new(compute, limits.max_answer_bytes);
        let admission = AdmissionQueue::new(limits.max_pairs_in_flight, limits.shares, metrics.clone());
        Self {
            batches,
            admission,
            metrics,
            #[cfg(feature = "testing")]
            test_controls,
        }
    }

    /// Controls for tests of overload.
    #[cfg(feature = "testing")]
    pub fn test_controls(&self) -> &TestControls {
        &self.test_controls
    }

    /// The number of pairs computed since the start.
    pub fn pairs_computed(&self) -> u64 {
        self.batches.pairs_computed()
    }

    /// The number of compute threads.
    pub fn threads(&self) -> usize {
        self.compute_threads().threads()
    }

    /// The compute threads.
    pub fn compute_threads(&self) -> &Compute {
        self.batches.compute_threads()
    }

    /// Admits a batch's pairs. Refuses the batch before any work if its answer would be too large,
    /// or if there is no capacity for it. The capacity is free again when the admission is dropped.
    ///
    /// # Errors
    /// RESPONSE_TOO_LARGE, TOO_BUSY.
    pub fn admit(&self, pairs: usize, outputs: Outputs, caller: &Caller) -> Result<Admission, ServiceError> {
        let limit = self.batches.max_answer_bytes();
        if pairs * outputs.pair_bytes() > limit {
            return Err(too_large(limit));
        }
        self.admit_any_size(pairs, caller)
    }

    /// Admits pairs whose answer may have any size.
    ///
    /// # Errors
    /// TOO_BUSY.
    pub fn admit_any_size(&self, pairs: usize, caller: &Caller) -> Result<Admission, ServiceError> {
        self.admission.admit(pairs, caller, self.pairs_computed())
    }

    /// Admits a later part of a call; waits until there is capacity.
    pub async fn admit_when_free(&self, pairs: usize, caller: &Caller) -> Admission {
        self.admission.admit_when_free(pairs, caller).await
    }

    /// The columns of all pairs, in pair order, and the permit for their memory, which grows from
    /// `memory`. `lease` keeps the batch's hulls until the batch is answered. Dropping the future stops the
    /// computation.
    ///
    /// # Errors
    /// RESPONSE_TOO_LARGE or TOO_BUSY as soon as the answer is known to be too large, or the
    /// caller's budget has no room for it; DEADLINE_EXCEEDED if the job was stopped; INTERNAL.
    pub async fn compute(
        &self,
        batch: Batch,
        lease: Option<Arc<Lease>>,
        mut admission: Admission,
        job: &Job,
        memory: Permit,
    ) -> Result<(Columns, Permit), ServiceError> {
        let pairs = batch.pair_count();
        // If the caller leaves while the batch waits, the batch may be large and must not be freed
        // on this thread.
        let bytes = if admission.must_wait() { usize::MAX } else { 0 };
        let waiting = self.compute_threads().defer_drop((batch, lease), bytes);
        self.admission.wait_to_compute(&mut admission).instrument(trace::queue(pairs)).await;
        let (batch, lease) = waiting.into_inner();
        let started = Instant::now();
        let answer = self.batches.compute(batch, job, memory, (admission, lease));
        let answer = answer.instrument(trace::compute(pairs)).await;
        let (columns, memory) = answer.map_err(|error| self.error(error))?;
        self.metrics.compute_seconds.observe(started.elapsed().as_secs_f64());
        self.metrics.solver_iterations.inc_by(columns.solver_iterations());
        self.metrics.answered(columns.outcome_counts(), &columns.flags);
        Ok((columns, memory))
    }

    fn error(&self, error: EngineError<NoMemory>) -> ServiceError {
        match error {
            EngineError::TooLarge(limit) => too_large(limit),
            EngineError::NoMemory(why) => no_memory(&self.metrics, why),
            EngineError::Stopped => ServiceError::deadline_exceeded(),
            EngineError::Panicked(Panicked(why)) => {
                limited!(error, why, "a batch panicked");
                ServiceError::internal("the computation failed; the server's log has the reason")
            }
        }
    }
}

fn too_large(limit: usize) -> ServiceError {
    ServiceError::new(
        Reason::ResponseTooLarge,
        format!("the answer would have more than {}: request fewer pairs or outputs", ByteSize(limit as u64)),
    )
}

//! Computes batches in chunks on the compute threads. The work stops when the caller has left, and
//! the bytes of an answer do not depend on how the batch was split.
//!
//! Small batches are computed on the thread that asks for them, because handing a batch to other
//! threads and back costs 20 to 40 us. The estimated cost of a batch decides whether it is small,
//! and how it is cut into chunks (`chunks`). `run` is a batch while it is computed, and `state` is
//! the part of an engine that all of them use.

mod chunks;
mod run;
mod state;
#[cfg(test)]
mod tests;

use std::sync::{Arc, atomic::Ordering};

use thiserror::Error;

use self::{
    run::{BatchResult, BatchRun, Unanswered},
    state::EngineState,
};
use crate::{
    batch::Batch,
    columns::Columns,
    compute::{CallerId, Compute, ComputeError, Job, Panicked, catch_panic},
    memory::Memory,
};

/// Computes batches on compute threads.
#[derive(Debug)]
pub struct Engine {
    compute: Compute,
    shared: Arc<EngineState>,
}

/// The reason why a batch has no answer. `R` is the reason why there is no memory.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EngineError<R> {
    /// The answer would have more than this number of bytes.
    #[error("the answer would have more than {0} bytes")]
    TooLarge(usize),
    /// There is no memory for the answer.
    #[error("there is no memory for the answer: {0:?}")]
    NoMemory(R),
    /// The job was stopped.
    #[error("the computation was stopped")]
    Stopped,
    /// The computation panicked, which is a bug.
    #[error(transparent)]
    Panicked(Panicked),
}

impl Engine {
    /// An engine that computes on `compute`, and whose answers have at most `max_answer_bytes` bytes.
    pub fn new(compute: Compute, max_answer_bytes: usize) -> Self {
        Self { compute, shared: Arc::new(EngineState::new(max_answer_bytes)) }
    }

    /// An engine that calls `before` with the number of pairs of each chunk before it computes the chunk.
    /// Tests of overload slow an engine down in this way.
    #[cfg(any(test, feature = "testing"))]
    pub fn with_hook(
        compute: Compute,
        max_answer_bytes: usize,
        before: impl Fn(usize) + Send + Sync + 'static,
    ) -> Self {
        let shared =
            EngineState { before_chunk: Some(Box::new(before)), ..EngineState::new(max_answer_bytes) };
        Self { compute, shared: Arc::new(shared) }
    }

    /// The number of pairs computed since the start.
    pub fn pairs_computed(&self) -> u64 {
        self.shared.pairs_computed.load(Ordering::Relaxed)
    }

    /// The most bytes of an answer.
    pub fn max_answer_bytes(&self) -> usize {
        self.shared.max_answer_bytes
    }

    /// The compute threads.
    pub fn compute_threads(&self) -> &Compute {
        &self.compute
    }

    /// The columns of all pairs, in pair order, and `memory`, which now holds their bytes. `held` is dropped
    /// as soon as the answer is complete. Dropping the future stops the computation.
    ///
    /// # Errors
    /// The answer is too large, or there is no memory for it, as soon as that is known; the job was stopped;
    /// the computation panicked.
    pub async fn compute<M: Memory, H: Send + 'static>(
        &self,
        batch: Batch,
        job: &Job<impl CallerId>,
        memory: M,
        held: H,
    ) -> Result<(Columns, M), EngineError<M::Refused>> {
        let run = BatchRun::new(&self.shared, batch, &job.stop, memory, held);
        let unanswered = run.unanswered.clone();
        self.computed(run, job).await.map_err(|error| match (unanswered.get(), error) {
            (Some(Unanswered::TooLarge), _) => EngineError::TooLarge(self.shared.max_answer_bytes),
            (Some(&Unanswered::NoMemory(why)), _) => EngineError::NoMemory(why),
            (None, ComputeError::Stopped) => EngineError::Stopped,
            (None, ComputeError::Panicked(panicked)) => EngineError::Panicked(panicked),
        })
    }

    async fn computed<M: Memory, H: Send + 'static>(
        &self,
        mut run: BatchRun<M, H>,
        job: &Job<impl CallerId>,
    ) -> Result<(Columns, M), ComputeError> {
        if run.batch.is_small() {
            return Ok(catch_panic(|| run.inline())??);
        }
        if run.chunks.is_unknown() {
            // Estimating every pair's cost is also work for the compute threads.
            run = self.compute.run(|stop| run.cut(stop), job).await??;
        }
        match self.compute.run_parts(run, job).await? {
            BatchResult::Answer(answer) => Ok(*answer),
            BatchResult::Large(chunks) => self
                .compute
                .run_steps(chunks.steps(), |stop| chunks.concatenated(stop), job)
                .await?
                .map_err(Into::into),
        }
    }
}

//! What a handler knows of the call that it answers: who calls, when to stop, and the memory
//! that the call holds.
//!
//! The outermost layer makes one [`CallContext`] per call and puts it into the request's
//! extensions. A handler takes it from there with [`CallContext::of`].

use std::sync::{Arc, Mutex, PoisonError};

use super::{App, ServiceError};
use crate::{
    budget::{Caller, MemoryBudget, NoMemory, Part, Permit, Refusal},
    compute::Job,
    metrics::Shed,
};

/// What belongs to one call. Clones belong to the same call.
#[derive(Clone, Debug)]
pub(super) struct CallContext {
    /// Whose turn it is on the compute threads, and the flag that stops the call's work. The
    /// flag is set when the call ends for any reason.
    pub(super) job: Job,
    memory: Arc<MemoryBudget>,
    /// The memory of the answer that the handler has computed and the transport has not taken.
    answer: Arc<Mutex<Option<Permit>>>,
}

impl CallContext {
    /// The context of a call by `caller` whose memory counts in `memory`.
    pub(super) fn new(caller: Caller, memory: Arc<MemoryBudget>) -> Self {
        Self { job: Job::new(caller), memory, answer: Arc::default() }
    }

    /// The context that the outermost layer gave the request. Handlers without that layer, as
    /// in fuzzing, get one without a bound.
    pub(super) fn of<T>(request: &tonic::Request<T>) -> Self {
        let given = request.extensions().get::<Self>().cloned();
        given.unwrap_or_else(|| Self::new(Caller::alone(), MemoryBudget::unlimited()))
    }

    /// Takes memory for a part of the call.
    ///
    /// # Errors
    /// TOO_BUSY where there is no room now, MEMORY_TOO_LARGE where there never is.
    pub(super) fn take(&self, app: &App, part: Part, bytes: usize) -> Result<Permit, ServiceError> {
        self.memory.take(&self.job.caller, part, bytes as u64).map_err(|why| no_memory(app, why))
    }

    /// Takes `more` bytes for a permit of the call.
    ///
    /// # Errors
    /// As [`Self::take`]; the permit keeps what it had.
    pub(super) fn grow(&self, app: &App, permit: &mut Permit, more: usize) -> Result<(), ServiceError> {
        permit.grow(more as u64).map_err(|why| no_memory(app, why))
    }

    /// Takes memory for what a stream keeps between messages; none where there is no room, with
    /// which a stream can go on.
    pub(super) fn keep(&self, bytes: usize) -> Option<Permit> {
        self.memory.take(&self.job.caller, Part::StreamState, bytes as u64).ok()
    }

    /// Keeps the permit of an answer until the transport has taken the answer over.
    pub(super) fn hold_answer(&self, permit: Permit) {
        *self.answer.lock().unwrap_or_else(PoisonError::into_inner) = Some(permit);
    }

    /// The permit of the answer that is about to be sent.
    pub(super) fn take_answer(&self) -> Option<Permit> {
        self.answer.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

/// The error of a call that found no memory.
pub(super) fn no_memory(app: &App, why: NoMemory) -> ServiceError {
    match why.refusal {
        Refusal::Busy => {
            app.metrics().shed(Shed::Memory);
            ServiceError::unavailable("TOO_BUSY", MEMORY_RETRY, format!("{why}; ask again"))
        }
        Refusal::TooLarge => {
            ServiceError::refused("MEMORY_TOO_LARGE", format!("{why}; ask for less at a time"))
        }
    }
}

/// A large request takes some 100 ms to arrive and to be answered.
const MEMORY_RETRY: std::time::Duration = std::time::Duration::from_millis(200);

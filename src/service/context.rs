//! The context of a call: its caller, the flag that stops its work, and the memory that it holds.
//!
//! The outermost layer creates one [`CallContext`] per call and stores it in the request's
//! extensions. A handler gets it with [`CallContext::of`].

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use super::{App, ServiceError};
use crate::{
    budget::{Caller, MemoryBudget, NoMemory, Part, Permit, Refusal},
    compute::Job,
    lock::locked,
    metrics::{Metrics, Shed},
};

/// The state of one call. Clones belong to the same call.
#[derive(Clone, Debug)]
pub(super) struct CallContext {
    /// The caller whose turn the work uses on the compute threads, and the flag that stops the
    /// work. The flag is set when the call ends for any reason.
    pub(super) job: Job,
    memory: Arc<MemoryBudget>,
    /// The memory of messages that have arrived but are not decoded yet.
    arrived: Arc<Mutex<Option<Permit>>>,
    /// The memory of an answer that the handler has computed but the transport has not taken.
    answer: Arc<Mutex<Option<Permit>>>,
}

impl CallContext {
    /// The context of a call by `caller` whose memory is charged to `memory`.
    pub(super) fn new(caller: Caller, memory: Arc<MemoryBudget>) -> Self {
        Self { job: Job::new(caller), memory, arrived: Arc::default(), answer: Arc::default() }
    }

    /// The context that the outermost layer gave the request. Handlers without that layer, as in
    /// fuzzing, get one without limits.
    pub(super) fn of<T>(request: &tonic::Request<T>) -> Self {
        let given = request.extensions().get::<Self>().cloned();
        given.unwrap_or_else(|| Self::new(Caller::alone(), MemoryBudget::unlimited()))
    }

    /// Takes memory for a part of the call.
    ///
    /// # Errors
    /// TOO_BUSY if there is no room now, MEMORY_TOO_LARGE if there never is.
    pub(super) fn take(&self, app: &App, part: Part, bytes: usize) -> Result<Permit, ServiceError> {
        self.memory.take(&self.job.caller, part, bytes as u64).map_err(|why| no_memory(app.metrics(), why))
    }

    /// Takes memory for arriving bytes of a message.
    ///
    /// # Errors
    /// TOO_BUSY if there is no room now, MEMORY_TOO_LARGE if there never is.
    pub(super) fn arrive(&self, app: &App, bytes: usize) -> Result<(), ServiceError> {
        let mut arrived = locked(&self.arrived);
        let taken = if let Some(permit) = &mut *arrived {
            permit.grow(bytes as u64)
        } else {
            let taken = self.memory.take(&self.job.caller, Part::Arriving, bytes as u64);
            taken.map(|permit| *arrived = Some(permit))
        };
        taken.map_err(|why| no_memory(app.metrics(), why))
    }

    /// Releases the memory of the arrived messages, which are decoded now.
    pub(super) fn decoded(&self) {
        drop(locked(&self.arrived).take());
    }

    /// Takes memory for the state that a stream keeps between messages; none if there is no room. A
    /// stream can go on without it.
    pub(super) fn keep(&self, bytes: usize) -> Option<Permit> {
        self.memory.take(&self.job.caller, Part::StreamState, bytes as u64).ok()
    }

    /// Keeps the permit of an answer until the transport has taken over the answer.
    pub(super) fn hold_answer(&self, permit: Permit) {
        *locked(&self.answer) = Some(permit);
    }

    /// The permit of the answer that is about to be sent.
    pub(super) fn take_answer(&self) -> Option<Permit> {
        locked(&self.answer).take()
    }

    /// The bytes taken for the answer that is about to be sent.
    pub(super) fn answer_bytes(&self) -> usize {
        locked(&self.answer).as_ref().map_or(0, |permit| permit.bytes() as usize)
    }
}

/// Takes `more` bytes for a permit of a call.
///
/// # Errors
/// TOO_BUSY, MEMORY_TOO_LARGE; the permit keeps what it had.
pub(super) fn grow(app: &App, permit: &mut Permit, more: usize) -> Result<(), ServiceError> {
    permit.grow(more as u64).map_err(|why| no_memory(app.metrics(), why))
}

/// The error of a call for which there is no memory.
pub(super) fn no_memory(metrics: &Metrics, why: NoMemory) -> ServiceError {
    match why.refusal {
        Refusal::Busy => {
            metrics.shed(if why.part == Part::Arriving { Shed::RequestBytes } else { Shed::Memory });
            ServiceError::unavailable("TOO_BUSY", MEMORY_RETRY, format!("{why}; ask again"))
        }
        Refusal::TooLarge => {
            ServiceError::refused("MEMORY_TOO_LARGE", format!("{why}; ask for less at a time"))
        }
    }
}

/// A large request takes about 100 ms to arrive and to be answered.
const MEMORY_RETRY: Duration = Duration::from_millis(200);

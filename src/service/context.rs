//! The context of a call: its caller, the flag that stops its work, and the memory that it holds.
//!
//! The outermost layer creates one [`CallContext`] per call and stores it in the request's
//! extensions. A handler gets it with [`CallContext::of`].

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex},
    time::Duration,
};

use bytes::{Bytes, BytesMut};

use super::{App, ServiceError};
use crate::{
    budget::{Caller, MemoryBudget, NoMemory, Part, Permit, Refusal},
    compute::Job,
    lock::locked,
    metrics::{Metrics, Shed},
};

/// Messages up to this size, in either direction, pass through tonic's buffers. A call takes the memory for
/// them once ([`CALL_BYTES`]), and not for each message, so that a stream of hundreds of thousands of
/// small messages per second locks nothing.
///
/// Larger messages wait in the [`CallContext`] and tonic passes an empty message in their place, because tonic
/// keeps its buffers, as large as the largest message, until the call ends.
pub(super) const SMALL_BYTES: usize = 4 << 10;

/// A received frame may hold this many bytes of messages that tonic has not asked for yet.
const FRAME_BYTES: u64 = 8 << 10;

/// The memory that each call takes when it begins: its own state, [`FRAME_BYTES`] of a received frame, and
/// [`SMALL_BYTES`] of messages as they arrive, decoded, and as answers.
pub(super) const CALL_BYTES: usize = 32 << 10;

/// The state of one call. Clones belong to the same call.
#[derive(Clone, Debug)]
pub(super) struct CallContext {
    /// The caller whose turn the work uses on the compute threads, and the flag that stops the
    /// work. The flag is set when the call ends for any reason.
    pub(super) job: Job,
    memory: Arc<MemoryBudget>,
    /// The large messages that have arrived and are not decoded yet.
    arrived: Arc<Mutex<VecDeque<Arrived>>>,
    /// The large answers that are encoded and not on their way to the transport yet.
    answers: Arc<Mutex<VecDeque<Answer>>>,
}

/// A message that has arrived whole, in pieces.
#[derive(Debug)]
pub(super) struct Arrived {
    pub(super) pieces: Vec<Bytes>,
    pub(super) memory: Permit,
}

/// An encoded answer with its head.
#[derive(Debug)]
pub(super) struct Answer {
    pub(super) bytes: Bytes,
    pub(super) memory: Permit,
}

impl CallContext {
    /// The context of a call by `caller` whose memory is charged to `memory`.
    pub(super) fn new(caller: Caller, memory: Arc<MemoryBudget>) -> Self {
        Self { job: Job::new(caller), memory, arrived: Arc::default(), answers: Arc::default() }
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
    /// TOO_BUSY if the budget has no room now, MEMORY_TOO_LARGE if the bytes can never fit.
    pub(super) fn take(&self, app: &App, part: Part, bytes: usize) -> Result<Permit, ServiceError> {
        self.memory.take(&self.job.caller, part, bytes as u64).map_err(|why| no_memory(app.metrics(), why))
    }

    /// A permit that holds nothing yet, for a part of the call that never exists twice at the same time. The
    /// call's own memory covers its first [`SMALL_BYTES`].
    pub(super) fn covered(&self, part: Part) -> Permit {
        self.memory.covered(&self.job.caller, part, SMALL_BYTES as u64)
    }

    /// A permit that holds nothing yet, for a received frame.
    pub(super) fn covered_frame(&self) -> Permit {
        self.memory.covered(&self.job.caller, Part::Arriving, FRAME_BYTES)
    }

    /// Keeps a large message until its turn to be decoded.
    pub(super) fn keep_arrived(&self, message: Arrived) {
        locked(&self.arrived).push_back(message);
    }

    /// The message that tonic hands on as `passed`: a small one as it is, and a large one in the order
    /// of arrival.
    pub(super) fn arrived(&self, passed: Bytes) -> Arrived {
        let large = if passed.is_empty() { locked(&self.arrived).pop_front() } else { None };
        large.unwrap_or_else(|| Arrived { pieces: vec![passed], memory: self.covered(Part::Arriving) })
    }

    /// Keeps a large answer until the transport asks for it.
    pub(super) fn keep_answer(&self, answer: Answer) {
        locked(&self.answers).push_back(answer);
    }

    /// The next large answer.
    pub(super) fn next_answer(&self) -> Option<Answer> {
        locked(&self.answers).pop_front()
    }

    /// The bytes of the large answers that wait for the transport.
    pub(super) fn answer_bytes(&self) -> usize {
        locked(&self.answers).iter().map(|answer| answer.bytes.len()).sum()
    }

    /// Takes memory for the state that a stream keeps between messages. Returns `None` if there is no room; a
    /// stream can go on without it.
    pub(super) fn keep(&self, bytes: usize) -> Option<Permit> {
        self.memory.take(&self.job.caller, Part::StreamState, bytes as u64).ok()
    }
}

impl Arrived {
    /// The message's length.
    pub(super) fn len(&self) -> usize {
        self.pieces.iter().map(Bytes::len).sum()
    }

    /// The message in one piece. Each piece is freed as soon as it is copied.
    pub(super) fn joined(self) -> (Bytes, Permit) {
        let length = self.len();
        let Self { mut pieces, memory } = self;
        if pieces.len() == 1 {
            return (pieces.remove(0), memory);
        }
        let mut whole = BytesMut::with_capacity(length);
        for piece in pieces {
            whole.extend_from_slice(&piece);
        }
        (whole.freeze(), memory)
    }
}

/// Takes `more` bytes for a permit of a call.
///
/// # Errors
/// TOO_BUSY, MEMORY_TOO_LARGE. The permit keeps the bytes that it had.
pub(super) fn grow(app: &App, permit: &mut Permit, more: usize) -> Result<(), ServiceError> {
    permit.grow(more as u64).map_err(|why| no_memory(app.metrics(), why))
}

/// The error of a call for which there is no memory.
pub(super) fn no_memory(metrics: &Metrics, why: NoMemory) -> ServiceError {
    match why.refusal {
        Refusal::Busy => {
            metrics.shed(if why.part == Part::Arriving { Shed::RequestBytes } else { Shed::Memory });
            ServiceError::unavailable("TOO_BUSY", MEMORY_RETRY, format!("{why}: retry later"))
        }
        Refusal::TooLarge => ServiceError::refused("MEMORY_TOO_LARGE", format!("{why}: split the request")),
    }
}

/// A large request takes about 100 ms to arrive and to be answered.
const MEMORY_RETRY: Duration = Duration::from_millis(200);

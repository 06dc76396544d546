//! The context of a call: its caller, the flag that stops its work, and the memory that it holds.
//!
//! The outermost layer creates one [`CallContext`] per call and stores it in the request's
//! extensions. A handler gets it with [`CallContext::of`].

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use bytes::{Bytes, BytesMut};

use super::{
    App, Reason, ServiceError,
    sizes::{FRAME_BYTES, SMALL_BYTES},
};
use crate::{
    batch::Hulls,
    budget::{Caller, CallerBudget, MemoryBudget, NoMemory, Part, Permit, ShareRefusal},
    compute::Job,
    lock::locked,
    metrics::{Metrics, Shed},
    proto,
    store::{HullId, Lease},
};

/// The flags of a pair that is not certified.
const UNCERTIFIED: u8 = proto::Flag::Estimated as u8 | proto::Flag::GapOpen as u8;

/// The state of one call. Clones belong to the same call.
#[derive(Clone, Debug)]
pub(super) struct CallContext {
    /// The caller whose turn the work uses on the compute threads, and the flag that stops the
    /// work. The flag is set when the call ends for any reason.
    pub(super) job: Job,
    memory: CallerBudget,
    state: Arc<CallState>,
}

/// The parts of a call that its body, its handler and its answer hand to each other.
#[derive(Debug, Default)]
struct CallState {
    /// The large messages that have arrived and are not decoded yet.
    large_messages: Mutex<VecDeque<(Vec<Bytes>, Permit)>>,
    /// The large answers that are encoded and not on their way to the transport yet.
    answers: Mutex<VecDeque<EncodedAnswer>>,
    /// The hulls of the latest message of a stream.
    leased: Mutex<Option<LeasedHulls>>,
    /// Whether the call may be recorded. Otherwise flags are not looked at.
    is_on_tape: AtomicBool,
    /// Whether a pair of the call is not certified.
    is_flagged: AtomicBool,
}

/// The hulls of a message, all found.
#[derive(Clone, Debug)]
pub(super) struct LeasedHulls {
    pub(super) hull_ids: Arc<Vec<HullId>>,
    pub(super) hulls: Arc<Hulls>,
    pub(super) lease: Arc<Lease>,
}

/// A message that has arrived whole.
#[derive(Debug)]
pub(super) enum ReceivedMessage {
    /// A message that the call's own memory covers.
    Small(Bytes),
    /// A message in pieces, with the permit for their memory.
    Large(Vec<Bytes>, Permit),
}

/// An encoded answer with its head.
#[derive(Debug)]
pub(super) struct EncodedAnswer {
    pub(super) bytes: Bytes,
    pub(super) memory: Permit,
}

impl CallContext {
    /// The context of a call by `caller` whose memory is charged to `memory`.
    pub(super) fn new(caller: Caller, memory: Arc<MemoryBudget>) -> Self {
        let memory = memory.of(&caller);
        Self { job: Job::new(caller), memory, state: Arc::default() }
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
        self.memory.take(part, bytes as u64).map_err(|why| no_memory(app.metrics(), why))
    }

    /// A permit that holds nothing yet, for a part of the call that never exists twice at the same time. The
    /// call's own memory covers its first [`SMALL_BYTES`].
    pub(super) fn covered(&self, part: Part) -> Permit {
        self.memory.covered(part, SMALL_BYTES as u64)
    }

    /// A permit that holds nothing yet, for a received frame.
    pub(super) fn covered_frame(&self) -> Permit {
        self.memory.covered(Part::Arriving, FRAME_BYTES)
    }

    /// Keeps a large message until its turn to be decoded.
    pub(super) fn keep_large_message(&self, pieces: Vec<Bytes>, memory: Permit) {
        locked(&self.state.large_messages).push_back((pieces, memory));
    }

    /// The message that tonic hands on as `passed`: a small one as it is, and a large one in the order
    /// of arrival.
    pub(super) fn received_message(&self, passed: Bytes) -> ReceivedMessage {
        let large = if passed.is_empty() { locked(&self.state.large_messages).pop_front() } else { None };
        large
            .map_or(ReceivedMessage::Small(passed), |(pieces, memory)| ReceivedMessage::Large(pieces, memory))
    }

    /// Keeps a large answer until the transport asks for it.
    pub(super) fn keep_answer(&self, answer: EncodedAnswer) {
        locked(&self.state.answers).push_back(answer);
    }

    /// The next large answer.
    pub(super) fn next_answer(&self) -> Option<EncodedAnswer> {
        locked(&self.state.answers).pop_front()
    }

    /// The bytes of the large answers that wait for the transport.
    pub(super) fn answer_bytes(&self) -> usize {
        locked(&self.state.answers).iter().map(|answer| answer.bytes.len()).sum()
    }

    /// Keeps the hulls of a message leased for the messages of the stream that follow at once.
    pub(super) fn keep_leased(&self, hulls: LeasedHulls) {
        *locked(&self.state.leased) = Some(hulls);
    }

    /// The kept hulls, if they are these and the store still has them. Any others are released.
    pub(super) fn leased_hulls(&self, hull_ids: &[HullId]) -> Option<LeasedHulls> {
        let mut leased = locked(&self.state.leased);
        let is_of = |kept: &mut LeasedHulls| *kept.hull_ids == hull_ids && kept.lease.is_current();
        let others = leased.take_if(|kept| !is_of(kept));
        let kept = leased.clone();
        drop(leased);
        drop(others);
        kept
    }

    /// Releases the kept hulls, because the stream waits or gives way.
    pub(super) fn release_hulls(&self) {
        let released = locked(&self.state.leased).take();
        drop(released);
    }

    /// Notes that the call may be recorded.
    pub(super) fn on_tape(&self) {
        self.state.is_on_tape.store(true, Ordering::Relaxed);
    }

    /// Remembers for the call's record whether any of these flags says that a pair is not certified.
    pub(super) fn note_flags(&self, flags: &[u8]) {
        let is_on_tape = self.state.is_on_tape.load(Ordering::Relaxed);
        if is_on_tape && flags.iter().any(|flags| flags & UNCERTIFIED != 0) {
            self.state.is_flagged.store(true, Ordering::Relaxed);
        }
    }

    /// Whether a pair of the call is not certified.
    pub(super) fn is_flagged(&self) -> bool {
        self.state.is_flagged.load(Ordering::Relaxed)
    }

    /// A permit that holds nothing yet, for the state that a stream keeps between messages.
    pub(super) fn state_memory(&self) -> Permit {
        self.memory.covered(Part::StreamState, 0)
    }
}

impl ReceivedMessage {
    /// The message's length.
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Small(message) => message.len(),
            Self::Large(pieces, _) => pieces.iter().map(Bytes::len).sum(),
        }
    }

    /// The message in one piece, with the permit for its memory. Each piece is freed as soon as it is
    /// copied.
    pub(super) fn joined(self) -> (Bytes, Option<Permit>) {
        let length = self.len();
        let (mut pieces, memory) = match self {
            Self::Small(message) => return (message, None),
            Self::Large(pieces, memory) => (pieces, memory),
        };
        if pieces.len() == 1 {
            return (pieces.remove(0), Some(memory));
        }
        let mut whole = BytesMut::with_capacity(length);
        for piece in pieces {
            whole.extend_from_slice(&piece);
        }
        (whole.freeze(), Some(memory))
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
        ShareRefusal::Busy => {
            metrics.shed(if why.part == Part::Arriving { Shed::RequestBytes } else { Shed::Memory });
            ServiceError::unavailable(Reason::TooBusy, MEMORY_RETRY, format!("{why}: retry later"))
        }
        ShareRefusal::TooLarge => {
            ServiceError::new(Reason::MemoryTooLarge, format!("{why}: split the request"))
        }
    }
}

/// A large request takes about 100 ms to arrive and to be answered.
const MEMORY_RETRY: Duration = Duration::from_millis(200);

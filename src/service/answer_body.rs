//! The body of a response, whose memory is counted until the transport has sent it.
//!
//! The transport takes a whole frame of the body as soon as the peer makes room for a byte of
//! it, and then keeps the frame until the peer has read it all. [`AnswerBody`] wraps the bytes
//! of a frame together with the permit for their memory, so that the permit lives exactly as
//! long as the bytes do, and hands them on in slices, so that a stream that is cut has at most
//! one slice in the transport's queue. It puts the large answers, which are encoded already, in
//! the place of the empty messages that tonic encodes for them. It also sets the call's
//! [`Cutoff`]: an answer has to be taken within a stated time of when it is ready.
//!
//! The transport forgets a body as soon as it has taken the body's end, even if frames before the
//! end are not sent yet. Therefore the end of a large answer waits until all of it is sent. The end
//! of a small answer goes out with it, which saves a packet; its frame holds the memory of the call,
//! and the [`Cutoff`] waits for the frame.

use std::{
    collections::VecDeque,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll, ready},
    time::Duration,
};

use bytes::{Buf, Bytes};
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::Instant;
use tonic::{Status, body::Body};

use super::{
    ServiceError,
    call::{Call, CallResources},
    context::{CallContext, EncodedAnswer, no_memory},
    cutoff::Cutoff,
    request_body::{HEAD_BYTES, per_mebibyte},
};
use crate::{
    budget::{Part, Permit},
    metrics::CutReason,
};

/// The bytes of an answer that are handed to the transport at a time.
const SLICE_BYTES: usize = 256 << 10;

/// A call whose deadline passes ends with DEADLINE_EXCEEDED. If its peer has not read this status after
/// this additional time, the stream is cut.
const AFTER_DEADLINE: Duration = Duration::from_secs(1);

/// The times by which the peer has to take an answer.
#[derive(Clone, Debug)]
pub(super) struct AnswerTimes {
    /// The time for the peer to take an answer, plus a second per MiB of it.
    pub(super) patience: Duration,
    /// The call's own deadline.
    pub(super) deadline: Option<Instant>,
}

impl AnswerTimes {
    /// The time by which an answer of `bytes` bytes that is ready now has to be taken.
    fn due(&self, bytes: usize) -> (Instant, CutReason) {
        let due = Instant::now() + self.patience + per_mebibyte(bytes);
        match self.deadline.map(|deadline| deadline + AFTER_DEADLINE) {
            Some(deadline) if deadline < due => (deadline, CutReason::Deadline),
            _ => (due, CutReason::AnswerNotRead),
        }
    }
}

/// The body of a response. The call ends when the body is dropped.
pub(super) struct AnswerBody {
    body: Body,
    call: Call,
    context: CallContext,
    times: AnswerTimes,
    cutoff: Cutoff,
    /// The bytes that the transport has not asked for yet.
    queued: VecDeque<Bytes>,
    /// Whether a large answer was queued. The trailers then wait for its bytes.
    is_large: bool,
    /// The trailers, which end the answer, while they wait for the bytes before them.
    trailers: Option<Frame<Bytes>>,
    ended: bool,
}

impl AnswerBody {
    /// The body of an answer that is ready now.
    pub(super) fn new(body: Body, call: Call, context: CallContext, times: AnswerTimes) -> Self {
        let cutoff = Cutoff::current();
        cutoff.set(times.due(context.answer_bytes()));
        let queued = VecDeque::new();
        Self { body, call, context, times, cutoff, queued, is_large: false, trailers: None, ended: false }
    }

    /// Separates a frame of tonic's into small messages, which stay together, and large answers, which take
    /// the place of an empty message each.
    fn separate(&mut self, mut frame: Bytes) -> Result<(), ServiceError> {
        let mut small = 0;
        while let Some((&[flag, ref length @ ..], _)) =
            frame.get(small..).and_then(<[u8]>::split_first_chunk::<HEAD_BYTES>)
        {
            let length = u32::from_be_bytes(*length) as usize;
            let large = if flag == 0 && length == 0 { self.context.next_answer() } else { None };
            let Some(EncodedAnswer { bytes, memory }) = large else {
                small += HEAD_BYTES + length;
                continue;
            };
            self.queue_small(frame.split_to(small))?;
            frame.advance(HEAD_BYTES);
            small = 0;
            self.is_large = true;
            self.queue(bytes, memory, None);
        }
        self.queue_small(frame)
    }

    /// The next slice for the transport.
    fn slice(&mut self) -> Option<Bytes> {
        let bytes = self.queued.front_mut()?;
        let slice = bytes.split_to(bytes.remaining().min(SLICE_BYTES));
        if bytes.is_empty() {
            self.queued.pop_front();
        }
        Some(slice)
    }

    /// Queues small messages for the transport. They are covered by the memory of the call, unless earlier
    /// bytes of the answer are not sent yet: then they take memory of their own.
    fn queue_small(&mut self, bytes: Bytes) -> Result<(), ServiceError> {
        if bytes.is_empty() {
            return Ok(());
        }
        let metrics = self.call.app().metrics();
        let mut memory = self.context.covered(Part::Answers);
        memory.grow(bytes.len() as u64).map_err(|why| no_memory(metrics, why))?;
        if !self.cutoff.is_all_sent() {
            memory.uncover().map_err(|why| no_memory(metrics, why))?;
        }
        self.queue(bytes, memory, Some(self.call.resources()));
        Ok(())
    }

    /// Queues bytes for the transport. Their memory counts until they are sent, and so do the resources of
    /// the call, if it covers the memory.
    fn queue(&mut self, bytes: Bytes, memory: Permit, resources: Option<Arc<CallResources>>) {
        let length = bytes.len();
        self.queued.push_back(self.cutoff.until_sent(bytes, (memory, resources)));
        self.cutoff.set(self.times.due(length));
    }

    /// Hands on the trailers, or keeps them until all bytes of a large answer are sent.
    fn poll_end(&mut self, cx: &mut Context<'_>, trailers: Frame<Bytes>) -> Poll<Frame<Bytes>> {
        if self.is_large && self.cutoff.poll_sent(cx).is_pending() {
            self.trailers = Some(trailers);
            return Poll::Pending;
        }
        self.ended = true;
        Poll::Ready(trailers)
    }
}

impl HttpBody for AnswerBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let this = &mut *self;
        while !this.ended {
            if let Some(slice) = this.slice() {
                return Poll::Ready(Some(Ok(Frame::data(slice))));
            }
            if let Some(trailers) = this.trailers.take() {
                return this.poll_end(cx, trailers).map(|trailers| Some(Ok(trailers)));
            }
            let polled = {
                let _entered = this.call.enter();
                Pin::new(&mut this.body).poll_frame(cx)
            };
            // No hulls stay leased while the transport sends this frame, or while the stream has none to send.
            this.context.release_hulls();
            if polled.is_pending() {
                // If the peer has read everything so far, it is not late: the server has not produced the
                // rest yet.
                this.cutoff.clear_if_all_is_sent();
            }
            let Some(frame) = ready!(polled) else { break };
            match frame?.into_data() {
                Ok(bytes) => {
                    if let Err(refused) = this.separate(bytes) {
                        this.queued.clear();
                        this.trailers = Some(this.call.ended_early(&refused.into())?);
                    }
                }
                Err(other) => {
                    if let Some(status) = other.trailers_ref().and_then(Status::from_header_map) {
                        this.call.ended_with(status.code());
                    }
                    return this.poll_end(cx, other).map(|trailers| Some(Ok(trailers)));
                }
            }
        }
        Poll::Ready(None)
    }

    fn is_end_stream(&self) -> bool {
        self.ended || (self.queued.is_empty() && self.trailers.is_none() && self.body.is_end_stream())
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::default()
    }
}

//! The body of a response, whose memory is counted until the transport has sent it.
//!
//! The transport takes a whole frame of the body as soon as the peer makes room for a byte of it, and keeps
//! the frame until the peer has read all of it. Therefore [`AnswerBody`] wraps the bytes of a frame
//! together with the permit for their memory, so that the permit lives exactly as long as the bytes. It
//! hands the bytes on in slices, so that a stream that is cut has at most one slice in the transport's
//! queue. It also sets the call's [`Cutoff`], because the caller has to take an answer within a limited
//! time after it is ready.

use std::{
    pin::Pin,
    task::{Context, Poll, ready},
    time::Duration,
};

use bytes::{Buf, Bytes};
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::Instant;
use tonic::{Status, body::Body};

use super::{
    App, ServiceError,
    call::Call,
    context::{CallContext, no_memory},
    cutoff::Cutoff,
    request_body::per_mebibyte,
};
use crate::{
    budget::{Part, Permit},
    metrics::Cut,
};

/// The bytes of an answer that are handed to the transport at a time.
const SLICE_BYTES: usize = 256 << 10;

/// A call whose deadline passes ends with DEADLINE_EXCEEDED, if its peer still reads that. After this
/// additional time the stream is cut.
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
    fn due(&self, bytes: usize) -> (Instant, Cut) {
        let due = Instant::now() + self.patience + per_mebibyte(bytes);
        match self.deadline.map(|deadline| deadline + AFTER_DEADLINE) {
            Some(deadline) if deadline < due => (deadline, Cut::Deadline),
            _ => (due, Cut::AnswerNotRead),
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
    /// The part of the current frame that has not been handed on yet.
    frame: Bytes,
    ended: bool,
}

impl AnswerBody {
    /// The body of an answer that is ready now.
    pub(super) fn new(body: Body, call: Call, context: CallContext, times: AnswerTimes) -> Self {
        let cutoff = Cutoff::current();
        cutoff.set(times.due(context.answer_bytes()));
        Self { body, call, context, times, cutoff, frame: Bytes::new(), ended: false }
    }

    /// Counts a frame's memory until its bytes are sent.
    fn counted(&self, bytes: Bytes) -> Result<Bytes, ServiceError> {
        let length = bytes.len();
        let permit = self.permit(length)?;
        self.cutoff.queued(length);
        self.cutoff.set(self.times.due(length));
        Ok(Bytes::from_owner(Unsent { bytes, _permit: permit, cutoff: self.cutoff.clone() }))
    }

    /// The permit for the memory that the answer took while it was made; new memory if it took none.
    fn permit(&self, bytes: usize) -> Result<Permit, ServiceError> {
        let app: &App = self.call.app();
        match self.context.take_answer() {
            None => self.context.take(app, Part::Answers, bytes),
            Some(mut permit) => {
                let more = (bytes as u64).saturating_sub(permit.bytes());
                permit.grow(more).map_err(|why| no_memory(app.metrics(), why))?;
                permit.shrink_to(bytes as u64);
                Ok(permit)
            }
        }
    }
}

/// Bytes of an answer, with the permit for their memory.
struct Unsent {
    bytes: Bytes,
    _permit: Permit,
    cutoff: Cutoff,
}

impl AsRef<[u8]> for Unsent {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for Unsent {
    fn drop(&mut self) {
        self.cutoff.freed(self.bytes.len());
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
        if this.ended {
            return Poll::Ready(None);
        }
        if this.frame.is_empty() {
            let polled = {
                let _entered = this.call.enter();
                Pin::new(&mut this.body).poll_frame(cx)
            };
            if polled.is_pending() {
                // If the peer has read everything so far, it is not late: the server has not produced the
                // rest yet.
                this.cutoff.clear_if_all_is_sent();
            }
            let Some(frame) = ready!(polled) else { return Poll::Ready(None) };
            let frame = frame?;
            match frame.into_data() {
                Ok(bytes) => match this.counted(bytes) {
                    Ok(bytes) => this.frame = bytes,
                    Err(refused) => {
                        this.ended = true;
                        return Poll::Ready(Some(this.call.ended_early(&refused.into())));
                    }
                },
                Err(other) => {
                    if let Some(status) = other.trailers_ref().and_then(Status::from_header_map) {
                        this.call.ended_with(status.code());
                    }
                    return Poll::Ready(Some(Ok(other)));
                }
            }
        }
        let slice = this.frame.split_to(this.frame.remaining().min(SLICE_BYTES));
        Poll::Ready(Some(Ok(Frame::data(slice))))
    }

    fn is_end_stream(&self) -> bool {
        self.ended || (self.frame.is_empty() && self.body.is_end_stream())
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::default()
    }
}

//! The body of a request, received as whole messages.
//!
//! gRPC puts five bytes before each message: a flag and the message's length. tonic allocates the declared
//! length before any byte of the message has arrived, and has no time limit within a message. Therefore
//! [`MessageBody`] reads the five bytes itself, refuses a message that is too long, takes memory as the
//! bytes arrive, and hands a message on only when all of it is there. The bytes are copied into separate
//! segments, because a received buffer would keep a whole read buffer of the connection alive.
//!
//! If a method takes one message, further bytes after it are refused, and the request has to end within the
//! time for the message.

use std::{
    collections::VecDeque,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
    time::Duration,
};

use bytes::{Bytes, BytesMut};
use futures_util::FutureExt;
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::{Instant, Sleep, sleep_until};
use tonic::Status;

use super::{App, ServiceError, call::BoxError, context::CallContext};

/// The bytes before each message: a flag that tells whether it is compressed, and its length.
pub(super) const HEAD_BYTES: usize = 5;

/// As it arrives, a message is copied into segments of at most this size, so that memory is taken for
/// arrived bytes and not for declared ones.
const SEGMENT_BYTES: usize = 256 << 10;

/// The limits on the messages of a method's request.
#[derive(Clone, Copy, Debug)]
pub(super) struct MessageRules {
    /// The largest message in bytes.
    pub(super) max_bytes: usize,
    /// Whether the request is a single message.
    pub(super) is_single: bool,
    /// The time for a message to arrive, plus a second per MiB of it.
    pub(super) patience: Duration,
}

/// The body of a request, received as whole messages.
pub(super) struct MessageBody<B> {
    body: B,
    app: Arc<App>,
    context: CallContext,
    rules: MessageRules,
    message: Message,
    /// Whole messages that have not been handed on yet.
    whole: VecDeque<Bytes>,
    /// The time by which the current message has to be complete; none for a stream between messages.
    due: Option<Pin<Box<Sleep>>>,
    started: Instant,
    ended: bool,
}

/// The message that is arriving.
#[derive(Debug, Default)]
struct Message {
    head: [u8; HEAD_BYTES],
    head_bytes: usize,
    /// The bytes of the message that have not arrived yet, once its header is known.
    missing: usize,
    segments: Vec<BytesMut>,
    /// The number of messages that were completed before this one.
    before: usize,
}

impl<B> MessageBody<B> {
    pub(super) fn new(body: B, app: Arc<App>, context: CallContext, rules: MessageRules) -> Self {
        let started = Instant::now();
        let due = rules.is_single.then(|| Box::pin(sleep_until(started + rules.patience)));
        let (message, whole) = (Message::default(), VecDeque::new());
        Self { body, app, context, rules, message, whole, due, started, ended: false }
    }

    /// Adds arrived bytes.
    fn arrived(&mut self, mut bytes: Bytes) -> Result<(), ServiceError> {
        while !bytes.is_empty() {
            if self.rules.is_single && self.message.before > 0 {
                let why = "the request has more than one message, but this method takes one";
                return Err(ServiceError::refused("TOO_MANY_MESSAGES", why));
            }
            if self.message.head_bytes == 0 {
                self.begin();
                if let Some(whole) = self.whole_frame(&bytes)? {
                    self.whole.push_back(whole);
                    self.complete();
                    return Ok(());
                }
            }
            if self.message.head_bytes < HEAD_BYTES {
                self.read_head(&mut bytes)?;
            } else {
                self.read_segment(&mut bytes)?;
            }
            if self.message.head_bytes == HEAD_BYTES && self.message.missing == 0 {
                self.whole.push_back(Bytes::copy_from_slice(&self.message.head));
                let segments = std::mem::take(&mut self.message.segments);
                self.whole.extend(segments.into_iter().map(BytesMut::freeze));
                self.complete();
            }
        }
        Ok(())
    }

    /// Starts the time of a message. For a stream it starts with the message's first byte, for a single
    /// message with the call.
    fn begin(&mut self) {
        if !self.rules.is_single {
            self.started = Instant::now();
            self.due = Some(Box::pin(sleep_until(self.started + self.rules.patience)));
        }
    }

    fn complete(&mut self) {
        self.message = Message { before: self.message.before + 1, ..Message::default() };
        if !self.rules.is_single {
            self.due = None;
        }
    }

    /// Returns a small message that arrived as one frame, which is the usual case. It is handed on without
    /// a copy, because tonic copies it at once.
    fn whole_frame(&mut self, frame: &Bytes) -> Result<Option<Bytes>, ServiceError> {
        let Some((head, message)) = frame.split_first_chunk::<HEAD_BYTES>() else { return Ok(None) };
        let length = declared(*head);
        if message.len() != length || length > SEGMENT_BYTES.min(self.rules.max_bytes) {
            return Ok(None);
        }
        self.context.arrive(&self.app, length)?;
        Ok(Some(frame.clone()))
    }

    fn read_head(&mut self, bytes: &mut Bytes) -> Result<(), ServiceError> {
        let have = self.message.head_bytes;
        let part = bytes.split_to(bytes.len().min(HEAD_BYTES - have));
        self.message.head[have..have + part.len()].copy_from_slice(&part);
        self.message.head_bytes += part.len();
        if self.message.head_bytes < HEAD_BYTES {
            return Ok(());
        }
        let (length, limit) = (declared(self.message.head), self.rules.max_bytes);
        if length > limit {
            let message =
                format!("the message has {length} bytes, at most {limit} are allowed: send less per message");
            return Err(ServiceError::refused("MESSAGE_TOO_LARGE", message));
        }
        self.message.missing = length;
        if let Some(due) = &mut self.due {
            due.as_mut().reset(self.started + self.rules.patience + per_mebibyte(length));
        }
        Ok(())
    }

    fn read_segment(&mut self, bytes: &mut Bytes) -> Result<(), ServiceError> {
        let message = &mut self.message;
        let full = message.segments.last().is_none_or(|segment| segment.len() == segment.capacity());
        if full {
            let capacity = message.missing.min(SEGMENT_BYTES);
            self.context.arrive(&self.app, capacity)?;
            message.segments.push(BytesMut::with_capacity(capacity));
        }
        let Some(segment) = message.segments.last_mut() else { return Ok(()) };
        let part = bytes.split_to(bytes.len().min(message.missing).min(segment.capacity() - segment.len()));
        segment.extend_from_slice(&part);
        message.missing -= part.len();
        Ok(())
    }

    fn late(&self) -> ServiceError {
        let seconds = self.started.elapsed().as_secs();
        ServiceError::message_late(format!("the message had not arrived in full after {seconds} s"))
    }
}

/// The length that a message's header declares.
fn declared(head: [u8; HEAD_BYTES]) -> usize {
    let [_, length @ ..] = head;
    u32::from_be_bytes(length) as usize
}

/// A second per MiB, the lowest speed at which a caller may send or read.
pub(super) fn per_mebibyte(bytes: usize) -> Duration {
    Duration::from_secs((bytes >> 20) as u64)
}

impl<B> HttpBody for MessageBody<B>
where
    B: HttpBody<Data = Bytes> + Unpin,
    B::Error: Into<BoxError>,
{
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        let this = &mut *self;
        loop {
            if let Some(bytes) = this.whole.pop_front() {
                return Poll::Ready(Some(Ok(Frame::data(bytes))));
            }
            if this.ended {
                return Poll::Ready(None);
            }
            let refused = match Pin::new(&mut this.body).poll_frame(cx) {
                Poll::Ready(None) => {
                    this.ended = true;
                    continue;
                }
                Poll::Ready(Some(Err(error))) => {
                    this.ended = true;
                    return Poll::Ready(Some(Err(error.into())));
                }
                Poll::Ready(Some(Ok(frame))) => match frame.into_data() {
                    Ok(bytes) => this.arrived(bytes).err(),
                    Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
                },
                Poll::Pending => match this.due.as_mut().map(|due| due.poll_unpin(cx)) {
                    Some(Poll::Ready(())) => Some(this.late()),
                    _ => return Poll::Pending,
                },
            };
            if let Some(error) = refused {
                this.ended = true;
                this.whole.clear();
                this.message = Message::default();
                return Poll::Ready(Some(Err(Status::from(error).into())));
            }
        }
    }

    fn is_end_stream(&self) -> bool {
        self.whole.is_empty() && (self.ended || self.body.is_end_stream())
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::default()
    }
}

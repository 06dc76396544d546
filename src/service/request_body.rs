//! The body of a request, received as whole messages.
//!
//! gRPC puts five bytes before each message: a flag, and the message's length. tonic allocates
//! the length that a caller declares before a byte of the message is there, keeps that buffer until the
//! call ends, and has no time limit within a message. [`MessageBody`] therefore reads the five bytes
//! itself, refuses a message that is too long, takes memory for each byte that arrives, and hands a
//! message on only when the whole of it is there. A large message goes to the [`CallContext`], where the
//! handler finds it, and tonic gets an empty message in its place. Arrived bytes are copied into
//! segments of their own, because a received buffer keeps a whole read buffer of the connection alive.
//!
//! A received frame may hold thousands of small messages. They are read off the frame one at a time, when
//! tonic asks for the next one, so that a message that tonic has not asked for takes no memory of its own.
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

use super::{
    App, Reason, ServiceError,
    call::BoxError,
    context::{CallContext, grow},
    sizes::SMALL_BYTES,
};
use crate::{
    budget::{Part, Permit},
    size::ByteSize,
};

/// The bytes before each message: a flag that tells whether it is compressed, and its length.
pub(super) const HEAD_BYTES: usize = 5;

/// A large message is copied into pieces of at most this size as it arrives, so that memory is taken
/// as bytes arrive and not as they are declared.
const SEGMENT_BYTES: usize = 256 << 10;

/// Each piece of a message costs as much time as some hundred of its bytes: one chunk of HTTP/1.1, or one
/// frame of HTTP/2. After the first [`FREE_PIECES`], the pieces must therefore have this many bytes on average.
/// Ordinary clients and proxies send a message in pieces of kilobytes.
const LEAST_PIECE_BYTES: usize = 64;

/// The number of pieces of a message that may be of any size.
const FREE_PIECES: usize = 1024;

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

impl MessageRules {
    /// Whether a message may be too large for tonic's buffers.
    fn has_large(&self) -> bool {
        self.max_bytes > SMALL_BYTES
    }
}

/// The body of a request, received as whole messages.
pub(super) struct MessageBody<B> {
    body: B,
    app: Arc<App>,
    context: CallContext,
    rules: MessageRules,
    /// The part of the last received frame that has not been read yet.
    received: Bytes,
    /// The memory of that frame while a part of it waits.
    waiting: Option<Permit>,
    message: ArrivingMessage,
    /// The head and the bytes of a whole message that tonic has not taken yet.
    whole: VecDeque<Bytes>,
    /// The number of messages that were complete.
    complete: usize,
    /// The time by which the current message has to be complete, or `None` for a stream between messages.
    due: Option<Pin<Box<Sleep>>>,
    started: Instant,
    ended: bool,
}

/// The message that is arriving.
#[derive(Debug, Default)]
struct ArrivingMessage {
    head: [u8; HEAD_BYTES],
    head_bytes: usize,
    /// The bytes of the message that have not arrived yet, once its head has arrived.
    missing: usize,
    /// The number of pieces in which the bytes have arrived so far.
    pieces: usize,
    segments: Vec<BytesMut>,
    memory: Option<Permit>,
}

impl<B> MessageBody<B> {
    pub(super) fn new(body: B, app: Arc<App>, context: CallContext, rules: MessageRules) -> Self {
        let started = Instant::now();
        let due = rules.is_single.then(|| Box::pin(sleep_until(started + rules.patience)));
        Self {
            body,
            app,
            context,
            rules,
            received: Bytes::new(),
            waiting: None,
            message: ArrivingMessage::default(),
            whole: VecDeque::new(),
            complete: 0,
            due,
            started,
            ended: false,
        }
    }

    /// Reads received bytes until a message is whole. The rest of the frame waits until tonic asks for the
    /// next message, and keeps the memory of the whole frame.
    fn read(&mut self) -> Result<(), ServiceError> {
        let frame_bytes = self.received.len();
        self.read_message()?;
        if self.received.is_empty() {
            self.waiting = None;
        } else if self.waiting.is_none() {
            let mut memory = self.context.covered_frame();
            grow(&self.app, &mut memory, frame_bytes)?;
            self.waiting = Some(memory);
        }
        Ok(())
    }

    fn read_message(&mut self) -> Result<(), ServiceError> {
        while !self.received.is_empty() && self.whole.is_empty() {
            if self.rules.is_single && self.complete > 0 {
                let why = "the request has more than one message, but this method takes one";
                return Err(ServiceError::new(Reason::TooManyMessages, why));
            }
            if self.message.head_bytes == 0 {
                if let Some(small) = self.small_message() {
                    self.whole.push_back(small);
                    self.completed();
                    return Ok(());
                }
                self.begin();
            }
            if self.message.head_bytes < HEAD_BYTES {
                self.read_head()?;
            } else {
                self.read_segment()?;
            }
            if self.message.head_bytes == HEAD_BYTES && self.message.missing == 0 {
                self.hand_on();
                self.completed();
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

    fn completed(&mut self) {
        self.complete += 1;
        if !self.rules.is_single {
            self.due = None;
        }
    }

    /// The next message, if it is small and whole in the received frame, as most messages are. It is not
    /// copied here, because tonic copies it at once.
    fn small_message(&mut self) -> Option<Bytes> {
        let (head, rest) = self.received.split_first_chunk::<HEAD_BYTES>()?;
        let length = declared(*head);
        let is_small = head[0] == 0 && length > 0 && length <= SMALL_BYTES.min(self.rules.max_bytes);
        (is_small && rest.len() >= length).then(|| self.received.split_to(HEAD_BYTES + length))
    }

    fn read_head(&mut self) -> Result<(), ServiceError> {
        let have = self.message.head_bytes;
        let part = self.received.split_to(self.received.len().min(HEAD_BYTES - have));
        self.message.head[have..have + part.len()].copy_from_slice(&part);
        self.message.head_bytes += part.len();
        if self.message.head_bytes < HEAD_BYTES {
            return Ok(());
        }
        if self.message.head[0] != 0 {
            let why = "the message is marked as compressed, but the call names no compression: send it plain";
            return Err(ServiceError::new(Reason::MalformedMessage, why));
        }
        let (length, limit) = (declared(self.message.head), self.rules.max_bytes);
        if length > limit {
            let (length, limit) = (ByteSize(length as u64), ByteSize(limit as u64));
            let message =
                format!("the message has {length}, at most {limit} are allowed: send less per message");
            return Err(ServiceError::new(Reason::MessageTooLarge, message));
        }
        self.message.missing = length;
        if let Some(due) = &mut self.due {
            due.as_mut().reset(self.started + self.rules.patience + per_mebibyte(length));
        }
        Ok(())
    }

    fn read_segment(&mut self) -> Result<(), ServiceError> {
        let message = &mut self.message;
        let full = message.segments.last().is_none_or(|segment| segment.len() == segment.capacity());
        if full {
            let capacity = message.missing.min(SEGMENT_BYTES);
            let memory = message.memory.get_or_insert_with(|| self.context.covered(Part::Arriving));
            grow(&self.app, memory, capacity)?;
            message.segments.push(BytesMut::with_capacity(capacity));
        }
        let Some(segment) = message.segments.last_mut() else { return Ok(()) };
        let room = segment.capacity() - segment.len();
        let part = self.received.split_to(self.received.len().min(message.missing).min(room));
        segment.extend_from_slice(&part);
        message.missing -= part.len();
        message.pieces += 1;
        let arrived = declared(message.head) - message.missing;
        if message.pieces > FREE_PIECES && arrived < LEAST_PIECE_BYTES * message.pieces {
            let why = format!(
                "the message arrives in {} pieces of {} bytes on average, at least {LEAST_PIECE_BYTES} are \
                 needed after {FREE_PIECES} pieces: send it in larger pieces",
                message.pieces,
                arrived / message.pieces
            );
            return Err(ServiceError::new(Reason::PiecesTooSmall, why));
        }
        Ok(())
    }

    /// Hands a whole message on: a small one to tonic, which copies it, and any other to the context, where
    /// the handler fetches it. For each message in the context tonic gets an empty one. So a message that is
    /// empty itself goes to the context too: otherwise its handler would fetch another message in its place.
    /// Health checks and reflection have no large messages, and their handlers fetch none from the context.
    fn hand_on(&mut self) {
        let ArrivingMessage { head, segments, memory, .. } = std::mem::take(&mut self.message);
        let length = declared(head);
        let pieces = segments.into_iter().map(BytesMut::freeze);
        let is_small = length > 0 && length <= SMALL_BYTES;
        if is_small || !self.rules.has_large() {
            self.whole.push_back(Bytes::copy_from_slice(&head));
            self.whole.extend(pieces);
            return;
        }
        let memory = memory.unwrap_or_else(|| self.context.covered(Part::Arriving));
        self.context.keep_large_message(pieces.collect(), memory);
        self.whole.push_back(Bytes::from_static(&[0; HEAD_BYTES]));
    }

    /// Ends the body with an error, and frees the bytes that have arrived.
    fn refuse(&mut self, why: ServiceError) -> BoxError {
        self.ended = true;
        self.whole.clear();
        (self.received, self.waiting) = (Bytes::new(), None);
        self.message = ArrivingMessage::default();
        Status::from(why).into()
    }

    fn late(&self) -> ServiceError {
        let seconds = self.started.elapsed().as_secs();
        ServiceError::new(
            Reason::MessageLate,
            format!("the message had not arrived in full after {seconds} s"),
        )
    }
}

/// The length that a message's head declares.
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
            if !this.received.is_empty() {
                if let Err(why) = this.read() {
                    return Poll::Ready(Some(Err(this.refuse(why))));
                }
                continue;
            }
            match Pin::new(&mut this.body).poll_frame(cx) {
                Poll::Ready(None) => this.ended = true,
                Poll::Ready(Some(Err(error))) => {
                    this.ended = true;
                    return Poll::Ready(Some(Err(error.into())));
                }
                Poll::Ready(Some(Ok(frame))) => match frame.into_data() {
                    Ok(bytes) => this.received = bytes,
                    Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
                },
                Poll::Pending => {
                    let is_late = this.due.as_mut().is_some_and(|due| due.poll_unpin(cx).is_ready());
                    if !is_late {
                        return Poll::Pending;
                    }
                    let late = this.late();
                    return Poll::Ready(Some(Err(this.refuse(late))));
                }
            }
        }
    }

    fn is_end_stream(&self) -> bool {
        self.whole.is_empty() && (self.ended || (self.received.is_empty() && self.body.is_end_stream()))
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::default()
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::{
        budget::Caller,
        service::{Limits, context::ReceivedMessage},
        store::blobs,
    };

    /// A body of one frame.
    struct OneFrame(Option<Bytes>);

    impl HttpBody for OneFrame {
        type Data = Bytes;
        type Error = Infallible;

        fn poll_frame(
            mut self: Pin<&mut Self>,
            _: &mut Context<'_>,
        ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
            Poll::Ready(self.0.take().map(|bytes| Ok(Frame::data(bytes))))
        }
    }

    /// Catches messages of health checks and reflection that are kept for a handler that never fetches them,
    /// and empty or large messages of the other methods that their handler does not find in order.
    #[tokio::test]
    async fn messages_wait_only_for_handlers_that_fetch_them() {
        let app = App::new(blobs::open("memory://").unwrap(), Limits::default(), 1).unwrap();
        let app = Arc::new(app);
        let lengths = [0, SMALL_BYTES + 1, 3, 0];
        let messages: Vec<u8> = lengths
            .iter()
            .flat_map(|&length| {
                let [a, b, c, d] = (length as u32).to_be_bytes();
                [vec![0, a, b, c, d], vec![7; length]].concat()
            })
            .collect();
        for (max_bytes, sent, kept) in
            [(1 << 20, &messages[..], &[0, SMALL_BYTES + 1, 0][..]), (1024, &[0; 5000][..], &[][..])]
        {
            let context = CallContext::new(Caller::alone(), app.memory().clone());
            let patience = Duration::from_secs(1);
            let rules = MessageRules { max_bytes, is_single: false, patience };
            let body = OneFrame(Some(Bytes::copy_from_slice(sent)));
            let mut body = MessageBody::new(body, app.clone(), context.clone(), rules);
            let mut frames = 0;
            while let Some(frame) = std::future::poll_fn(|cx| Pin::new(&mut body).poll_frame(cx)).await {
                assert!(frame.unwrap().into_data().is_ok());
                frames += 1;
            }
            assert_eq!(frames, if max_bytes == 1024 { 1000 } else { lengths.len() });
            for &length in kept {
                let message = context.received_message(Bytes::new());
                assert!(
                    matches!(&message, ReceivedMessage::Large(pieces, _) if pieces.len() == usize::from(length > 0))
                );
                assert_eq!(message.len(), length);
            }
            // Nothing more is kept: the passed message itself is returned.
            assert!(
                matches!(context.received_message(Bytes::new()), ReceivedMessage::Small(passed) if passed.is_empty())
            );
        }
        assert_eq!(app.memory().used(), 0);
    }
}

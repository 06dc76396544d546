//! The bodies of the page's answers: its files, and the answers of gRPC-web.
//!
//! An answer that its peer does not read must count in the budget and must end, over HTTP/1.1 as over HTTP/2.

use std::{
    io,
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    task::{Context, Poll},
    time::Duration,
};

use bytes::Bytes;
use futures_util::task::AtomicWaker;
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    sync::watch,
    time::Instant,
};
use tonic::{Status, body::Body};

use super::{call::Taken, cutoff::Cutoff, listener::Connection};
use crate::metrics::Cut;

/// The first byte of the frame in which gRPC-web sends trailers has this bit.
const TRAILERS: u8 = 0x80;

/// A body whose last frame has a cutoff until the transport has sent it.
///
/// Over HTTP/2 the transport forgets a body, and the cutoff with it, as soon as it has taken the body's end, even
/// if it has not sent the frames before. So this body ends only when all its frames are sent.
pub(super) struct PageBody {
    source: Source,
    patience: Duration,
    cutoff: Cutoff,
    /// The cutoff waits for the body's end.
    is_ending: bool,
    has_begun: bool,
    unsent: Arc<Frames>,
}

/// The frames that are not sent yet.
#[derive(Default)]
struct Frames {
    count: AtomicUsize,
    /// Wakes the body that waits for its end.
    waiting: AtomicWaker,
}

enum Source {
    File(Option<Bytes>, Arc<Taken>),
    Call(Body),
}

impl PageBody {
    /// A file or a text, with the memory of its call. Has to be called in the task of the answer's stream.
    pub(super) fn file(text: &'static str, taken: Taken, patience: Duration) -> Self {
        let text = Bytes::from_static(text.as_bytes());
        let mut body = Self::new(Source::File(Some(text), Arc::new(taken)), patience);
        body.end();
        body
    }

    /// The answer of a gRPC-web call. Has to be called in the task of the answer's stream.
    pub(super) fn call(body: Body, patience: Duration) -> Self {
        Self::new(Source::Call(body), patience)
    }

    fn new(source: Source, patience: Duration) -> Self {
        Self {
            source,
            patience,
            cutoff: Cutoff::current(),
            is_ending: false,
            has_begun: false,
            unsent: Arc::default(),
        }
    }

    /// Completes when the transport has sent all frames.
    fn poll_sent(&self, cx: &mut Context<'_>) -> Poll<()> {
        self.unsent.waiting.register(cx.waker());
        if self.unsent.count.load(Ordering::SeqCst) == 0 { Poll::Ready(()) } else { Poll::Pending }
    }

    /// Sets the time by which the rest has to be taken.
    fn end(&mut self) {
        if !self.is_ending {
            self.is_ending = true;
            self.cutoff.queued(1);
        }
        self.cutoff.set((Instant::now() + self.patience, Cut::AnswerNotRead));
    }
}

impl Drop for PageBody {
    fn drop(&mut self) {
        if self.is_ending {
            self.cutoff.freed(1);
        }
    }
}

impl HttpBody for PageBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let this = &mut *self;
        let (bytes, taken) = match &mut this.source {
            Source::File(text, taken) => match text.take() {
                Some(text) => (text, Some(taken.clone())),
                None => return this.poll_sent(cx).map(|()| None),
            },
            Source::Call(body) => match std::task::ready!(Pin::new(body).poll_frame(cx)) {
                Some(Ok(frame)) => match frame.into_data() {
                    Ok(bytes) => (bytes, None),
                    Err(other) => return Poll::Ready(Some(Ok(other))),
                },
                None => return this.poll_sent(cx).map(|()| None),
                failed => return Poll::Ready(failed),
            },
        };
        this.has_begun = true;
        if taken.is_some() || bytes.first().is_some_and(|first| first & TRAILERS != 0) {
            this.end();
        }
        let cutoff = this.cutoff.clone();
        cutoff.queued(bytes.len());
        let frames = this.unsent.clone();
        frames.count.fetch_add(1, Ordering::SeqCst);
        Poll::Ready(Some(Ok(Frame::data(Bytes::from_owner(Unsent { bytes, cutoff, frames, _taken: taken })))))
    }

    fn is_end_stream(&self) -> bool {
        match &self.source {
            Source::File(..) => false,
            Source::Call(body) => !self.has_begun && body.is_end_stream(),
        }
    }

    fn size_hint(&self) -> SizeHint {
        match &self.source {
            Source::File(text, _) => SizeHint::with_exact(text.as_ref().map_or(0, Bytes::len) as u64),
            Source::Call(body) => body.size_hint(),
        }
    }
}

/// Bytes that the transport has not sent yet.
struct Unsent {
    bytes: Bytes,
    cutoff: Cutoff,
    frames: Arc<Frames>,
    _taken: Option<Arc<Taken>>,
}

impl AsRef<[u8]> for Unsent {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for Unsent {
    fn drop(&mut self) {
        self.cutoff.freed(self.bytes.len());
        if self.frames.count.fetch_sub(1, Ordering::SeqCst) == 1 {
            self.frames.waiting.wake();
        }
    }
}

/// Whether the socket of an HTTP/1.1 connection takes no more bytes at the moment.
///
/// The transport buffers the heads of answers without a limit while the socket takes nothing. So the requests
/// of a peer that does not read wait, and the cutoff closes its connection.
#[derive(Clone, Debug)]
pub(super) struct Stall {
    cutoff: Cutoff,
    patience: Duration,
    is_stalled: Arc<watch::Sender<bool>>,
}

impl Stall {
    pub(super) fn new(cutoff: Cutoff, patience: Duration) -> Self {
        Self { cutoff, patience, is_stalled: Arc::new(watch::Sender::new(false)) }
    }

    fn begin(&self) {
        if self.is_stalled.send_replace(true) {
            return;
        }
        // A part of an answer that is not sent has set its own time.
        if self.cutoff.is_all_sent() {
            self.cutoff.set((Instant::now() + self.patience, Cut::AnswerNotRead));
        }
        self.cutoff.queued(1);
    }

    fn end(&self) {
        if self.is_stalled.send_if_modified(std::mem::take) {
            self.cutoff.freed(1);
        }
    }

    /// Waits until the socket has taken everything.
    pub(super) async fn over(&self) {
        let _ = self.is_stalled.subscribe().wait_for(|stalled| !stalled).await;
    }
}

/// An HTTP/1.1 connection that notes when its socket is stalled.
pub(super) struct Noted {
    pub(super) io: Connection,
    pub(super) stall: Stall,
}

impl Noted {
    fn written<T>(&self, result: Poll<T>) -> Poll<T> {
        if result.is_pending() {
            self.stall.begin();
        }
        result
    }
}

impl AsyncRead for Noted {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_read(cx, buffer)
    }
}

impl AsyncWrite for Noted {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let result = Pin::new(&mut self.io).poll_write(cx, bytes);
        self.written(result)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let result = Pin::new(&mut self.io).poll_write_vectored(cx, slices);
        self.written(result)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        // The transport flushes when it has written everything.
        let result = Pin::new(&mut self.io).poll_flush(cx);
        if result.is_ready() {
            self.stall.end();
        }
        result
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(cx)
    }
}

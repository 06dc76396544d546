//! The bodies of answers to browsers: the page's files, other texts, and the answers of gRPC-web.
//!
//! An answer that its peer does not read must count in the budget and must end, over HTTP/1.1 as over HTTP/2.

use std::{
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
    time::Duration,
};

use bytes::Bytes;
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::Instant;
use tonic::{Status, body::Body};

use super::{call::CallResources, cutoff::Cutoff};
use crate::metrics::CutReason;

/// The first byte of the frame in which gRPC-web sends trailers has this bit.
const TRAILERS: u8 = 0x80;

/// A body that sets a cutoff for its last frame, and keeps it until the transport has sent the frame.
///
/// Over HTTP/2 the transport forgets a body, and the cutoff with it, as soon as it has taken the body's end, even
/// if it has not sent the frames before. So this body ends only when all its frames are sent.
pub(super) struct WebBody {
    source: Source,
    patience: Duration,
    cutoff: Cutoff,
    /// Whether the body has counted itself as one unsent byte, so that the cutoff stays until the body ends.
    is_ending: bool,
    has_begun: bool,
}

enum Source {
    File(Option<Bytes>, Arc<CallResources>),
    Call(Body),
}

impl WebBody {
    /// A file or a text, with the memory of its call. Has to be called in the task of the answer's stream.
    pub(super) fn file(text: &'static str, resources: CallResources, patience: Duration) -> Self {
        let text = Bytes::from_static(text.as_bytes());
        let mut body = Self::new(Source::File(Some(text), Arc::new(resources)), patience);
        body.end();
        body
    }

    /// The answer of a gRPC-web call. Has to be called in the task of the answer's stream.
    pub(super) fn call(body: Body, patience: Duration) -> Self {
        Self::new(Source::Call(body), patience)
    }

    fn new(source: Source, patience: Duration) -> Self {
        Self { source, patience, cutoff: Cutoff::current(), is_ending: false, has_begun: false }
    }

    /// Completes when the transport has sent all frames, which the cutoff still waits for.
    fn poll_sent(&mut self, cx: &mut Context<'_>) -> Poll<()> {
        self.release();
        self.cutoff.poll_sent(cx)
    }

    /// Sets the time by which the rest has to be taken.
    fn end(&mut self) {
        if !self.is_ending {
            self.is_ending = true;
            self.cutoff.queued(1);
        }
        self.cutoff.set((Instant::now() + self.patience, CutReason::AnswerNotRead));
    }

    /// Lets the cutoff wait only for the frames, no longer for the body's end.
    fn release(&mut self) {
        if std::mem::take(&mut self.is_ending) {
            self.cutoff.freed(1);
        }
    }
}

impl Drop for WebBody {
    fn drop(&mut self) {
        self.release();
    }
}

impl HttpBody for WebBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let this = &mut *self;
        let (bytes, resources) = match &mut this.source {
            Source::File(text, resources) => match text.take() {
                Some(text) => (text, Some(resources.clone())),
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
        if resources.is_some() || bytes.first().is_some_and(|first| first & TRAILERS != 0) {
            this.end();
        }
        Poll::Ready(Some(Ok(Frame::data(this.cutoff.until_sent(bytes, resources)))))
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

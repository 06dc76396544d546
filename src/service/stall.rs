//! HTTP/1.1 connections whose peer does not read.

use std::{
    io,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
    time::Duration,
};

use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    sync::watch,
    time::Instant,
};

use super::{cutoff::Cutoff, listener::AcceptedConnection};
use crate::metrics::CutReason;

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
            self.cutoff.set((Instant::now() + self.patience, CutReason::AnswerNotRead));
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
pub(super) struct StallDetector {
    pub(super) io: AcceptedConnection,
    pub(super) stall: Stall,
}

impl StallDetector {
    fn written<T>(&self, result: Poll<T>) -> Poll<T> {
        if result.is_pending() {
            self.stall.begin();
        }
        result
    }
}

impl AsyncRead for StallDetector {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_read(cx, buffer)
    }
}

impl AsyncWrite for StallDetector {
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

//! One connection, from its first byte to its end.

use std::{
    convert::Infallible,
    io,
    pin::{Pin, pin},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll},
    time::Duration,
};

use http::{Request, Response};
use hyper::{body::Incoming, server::conn::http2};
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    server::graceful::GracefulConnection,
    service::TowerToHyperService,
};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    sync::{Notify, watch},
    time::{sleep, timeout},
};
use tonic::{body::Body, service::Routes};
use tower::Service;

use super::{
    App, Serving,
    admission::spread,
    cutoff::StreamExecutor,
    listener::Connection,
    middleware::{Closing, Middleware},
    peers::{Address, Peer, Peers},
};
#[cfg(feature = "playground")]
use super::{
    cutoff::Cutoff,
    playground::{self, Page},
};
use crate::log_limit::Repeated;

/// HTTP/2 settings that measurably matter for batches; the defaults are sized for pages.
const FRAME_BYTES: u32 = 1 << 20;

/// A peer that does not answer a ping for this long is gone.
const KEEP_ALIVE: Duration = Duration::from_secs(60);

/// Of one call's headers: tokens and trace contexts fit many times.
pub(super) const HEADER_BYTES: u32 = 16 << 10;

/// Streams that a peer reset before they were looked at, or that were reset for its errors:
/// more, and the connection ends ("rapid reset").
const RESETS: usize = 1024;

/// HTTP/2's preface and the head of the frame behind it.
const GREETING_BYTES: u64 = 24 + 9;

/// What connections have in common.
#[derive(Debug)]
pub(super) struct Connections {
    app: Arc<App>,
    routes: Routes,
    serving: Arc<Serving>,
    peers: Arc<Peers>,
    /// Connections so far: spreads their ages.
    count: AtomicU64,
}

impl Connections {
    pub(super) fn new(app: Arc<App>, routes: Routes, serving: Serving) -> Self {
        let peers = Peers::new(app.clone(), serving.trusted_proxies.clone(), app.limits().shares);
        Self { app, routes, serving: Arc::new(serving), peers: Arc::new(peers), count: AtomicU64::new(0) }
    }

    /// A place for one more connection from `address`; none when there are too many.
    pub(super) fn admit(&self, address: Address) -> Option<Peer> {
        self.peers.admit(address)
    }

    /// HTTP/2 for one connection: its streams run beside their cutoffs.
    fn http2(&self, window: u32, abort: &Arc<Notify>) -> http2::Builder<StreamExecutor> {
        let mut http = http2::Builder::new(StreamExecutor::new(self.app.clone(), abort.clone()));
        http.timer(TokioTimer::new())
            .adaptive_window(false)
            .initial_stream_window_size(window)
            .initial_connection_window_size(window)
            .max_frame_size(FRAME_BYTES.min(window))
            .max_header_list_size(HEADER_BYTES)
            .max_pending_accept_reset_streams(Some(RESETS))
            .max_local_error_reset_streams(Some(RESETS))
            .max_concurrent_streams(self.app.limits().max_streams_per_connection)
            .keep_alive_interval(KEEP_ALIVE)
            .keep_alive_timeout(KEEP_ALIVE);
        http
    }

    /// When a connection that begins now is told to close: nine to eleven tenths of the age,
    /// so that those that began together do not end together.
    fn age(&self) -> Duration {
        let most = self.serving.max_connection_age;
        if most.is_zero() {
            return Duration::MAX;
        }
        most.mul_f64(0.9 + 0.2 * spread(self.count.fetch_add(1, Ordering::Relaxed)))
    }

    /// Serves `io` until the peer leaves. Once `closing` is true or the connection is of age it
    /// is told to (GOAWAY), and what is under way has the time of the drain.
    pub(super) async fn serve(self: Arc<Self>, io: Connection, closing: Closing, peer: Peer) {
        let io = match self.encrypted(io, &peer).await {
            Ok(io) => io,
            Err(error) => return report_handshake(&error),
        };
        let (close, closed) = watch::channel(false);
        let (app, routes, serving) = (self.app.clone(), self.routes.clone(), self.serving.clone());
        let window = peer.window();
        let calls = Middleware::new(app, routes, serving, peer, Closing(closed));
        #[cfg(feature = "playground")]
        if self.serving.playground {
            return self.serve_page(io, calls, window, close, closing).await;
        }
        self.serve_http2(io, calls, window, close, closing).await;
    }

    async fn serve_http2<S>(
        &self,
        io: Connection,
        service: S,
        window: u32,
        close: watch::Sender<bool>,
        closing: Closing,
    ) where
        S: Service<Request<Incoming>, Response = Response<Body>, Error = Infallible> + Clone + Send + 'static,
        S::Future: Send + 'static,
    {
        let read = Arc::new(AtomicU64::new(0));
        let io = TokioIo::new(Counted { io, read: read.clone() });
        let abort = Arc::new(Notify::new());
        let connection = self.http2(window, &abort).serve_connection(io, TowerToHyperService::new(service));
        let end = async {
            tokio::select! {
                () = silence(&read, self.serving.greeting) => "no HTTP/2 from a peer",
                () = abort.notified() => "a peer takes nothing of an answer that was cut",
            }
        };
        self.attend(connection, end, close, closing).await;
    }

    /// The same, and the playground's page: browsers that do not speak TLS speak HTTP/1.1.
    #[cfg(feature = "playground")]
    async fn serve_page(
        &self,
        io: Connection,
        calls: Middleware,
        window: u32,
        close: watch::Sender<bool>,
        mut closing: Closing,
    ) {
        let greeting = self.serving.greeting;
        let speaks_http1 = tokio::select! {
            greeted = timeout(greeting, playground::speaks_http1(&io)) => greeted,
            () = closing.heard() => return,
        };
        match speaks_http1 {
            Ok(Ok(false)) => self.serve_http2(io, Page::over_http2(calls), window, close, closing).await,
            Ok(Ok(true)) => {
                let service = TowerToHyperService::new(Page::over_http1(calls));
                let connection = playground::http1(greeting).serve_connection(TokioIo::new(io), service);
                // Its own timer cuts off who does not say what it wants, and the cutoff who does
                // not read what it asked for.
                let served = self.attend(connection, std::future::pending(), close, closing);
                Cutoff::new(Arc::default()).guard(&self.app, served).await;
            }
            Ok(Err(error)) => tracing::debug!(%error, "connection ended"),
            Err(_) => tracing::debug!("a peer does not say what it speaks"),
        }
    }

    /// Until the connection ends by itself, or `end` says why it ends, or it has to go.
    async fn attend(
        &self,
        connection: impl GracefulConnection<Error = hyper::Error>,
        end: impl Future<Output = &'static str>,
        close: watch::Sender<bool>,
        mut closing: Closing,
    ) {
        let mut connection = pin!(connection);
        tokio::select! {
            ended = connection.as_mut() => return report(ended),
            why = end => return tracing::debug!(why, "closed a connection"),
            () = closing.heard() => {}
            () = sleep(self.age()) => {}
        }
        close.send_replace(true);
        connection.as_mut().graceful_shutdown();
        let Ok(ended) = timeout(self.serving.drain, connection).await else {
            return tracing::warn!("closing a connection that did not drain");
        };
        report(ended);
    }

    async fn encrypted(&self, io: Connection, peer: &Peer) -> io::Result<Connection> {
        match self.serving.security.tls_config() {
            None => Ok(io),
            Some(config) => {
                let busy = || io::Error::other("too many TLS handshakes are under way");
                let _handshake = peer.handshake().ok_or_else(busy)?;
                timeout(self.serving.greeting, io.encrypted(config)).await?
            }
        }
    }
}

fn report_handshake(error: &io::Error) {
    static FAILED: Repeated = Repeated::new();
    if let Some(left_out) = FAILED.due() {
        tracing::info!(%error, left_out, "a TLS handshake failed");
    }
}

fn report(ended: hyper::Result<()>) {
    if let Err(error) = ended {
        tracing::debug!(%error, "connection ended");
    }
}

/// Completes when a peer had time to greet and has not.
async fn silence(read: &AtomicU64, greeting: Duration) {
    sleep(greeting).await;
    if read.load(Ordering::Relaxed) >= GREETING_BYTES {
        std::future::pending().await
    }
}

/// Counts the bytes that were read.
struct Counted {
    io: Connection,
    read: Arc<AtomicU64>,
}

impl AsyncRead for Counted {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let result = Pin::new(&mut self.io).poll_read(cx, buffer);
        self.read.fetch_add((buffer.filled().len() - before) as u64, Ordering::Relaxed);
        result
    }
}

impl AsyncWrite for Counted {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.io).poll_write(cx, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.io).poll_write_vectored(cx, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(cx)
    }
}

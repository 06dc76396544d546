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
    rt::{TokioExecutor, TokioIo, TokioTimer},
    server::graceful::GracefulConnection,
    service::TowerToHyperService,
};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    sync::{OwnedSemaphorePermit, Semaphore, watch},
    time::{sleep, timeout},
};
use tonic::{body::Body, service::Routes};
use tower::Service;

#[cfg(feature = "playground")]
use super::playground::{self, Page};
use super::{
    App, Serving,
    admission::spread,
    edge::{Closing, Edge},
    listener::Connection,
};
use crate::metrics::{Held, Shed};

/// HTTP/2 settings that measurably matter for batches; the defaults are sized for pages.
const FRAME_BYTES: u32 = 1 << 20;
const WINDOW_BYTES: u32 = 8 << 20;

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
    serving: Serving,
    http: http2::Builder<TokioExecutor>,
    room: Arc<Semaphore>,
    /// Connections so far: spreads their ages.
    count: AtomicU64,
}

impl Connections {
    pub(super) fn new(app: Arc<App>, routes: Routes, serving: Serving) -> Self {
        let limits = app.limits();
        let room = Arc::new(Semaphore::new(limits.max_connections as usize));
        let mut http = http2::Builder::new(TokioExecutor::new());
        http.timer(TokioTimer::new())
            .adaptive_window(false)
            .initial_stream_window_size(WINDOW_BYTES)
            .initial_connection_window_size(WINDOW_BYTES)
            .max_frame_size(FRAME_BYTES)
            .max_header_list_size(HEADER_BYTES)
            .max_pending_accept_reset_streams(Some(RESETS))
            .max_local_error_reset_streams(Some(RESETS))
            .max_concurrent_streams(limits.max_streams_per_connection)
            .keep_alive_interval(KEEP_ALIVE)
            .keep_alive_timeout(KEEP_ALIVE);
        Self { app, routes, serving, http, room, count: AtomicU64::new(0) }
    }

    /// A place for one more connection; none when there are too many.
    pub(super) fn admit(&self) -> Option<Place> {
        let Ok(permit) = self.room.clone().try_acquire_owned() else {
            self.app.metrics().shed(Shed::Connection);
            return None;
        };
        Some(Place { _permit: permit, _counted: Held::new(&self.app.metrics().connections, 1) })
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
    pub(super) async fn serve(self: Arc<Self>, io: Connection, closing: Closing, _place: Place) {
        let io = match self.encrypted(io).await {
            Ok(io) => io,
            Err(error) => return tracing::debug!(%error, "no TLS connection"),
        };
        let (close, closed) = watch::channel(false);
        let security = self.serving.security.clone();
        let edge = Edge::new(self.app.clone(), self.routes.clone(), security, Closing(closed));
        #[cfg(feature = "playground")]
        if self.serving.playground {
            return self.serve_page(io, edge, close, closing).await;
        }
        self.serve_http2(io, edge, close, closing).await;
    }

    async fn serve_http2<S>(&self, io: Connection, service: S, close: watch::Sender<bool>, closing: Closing)
    where
        S: Service<Request<Incoming>, Response = Response<Body>, Error = Infallible> + Clone + Send + 'static,
        S::Future: Send + 'static,
    {
        let read = Arc::new(AtomicU64::new(0));
        let io = TokioIo::new(Counted { io, read: read.clone() });
        let connection = self.http.serve_connection(io, TowerToHyperService::new(service));
        self.attend(connection, silence(&read, self.serving.greeting), close, closing).await;
    }

    /// The same, and the playground's page: browsers that do not speak TLS speak HTTP/1.1.
    #[cfg(feature = "playground")]
    async fn serve_page(&self, io: Connection, edge: Edge, close: watch::Sender<bool>, mut closing: Closing) {
        let greeting = self.serving.greeting;
        let speaks_http1 = tokio::select! {
            greeted = timeout(greeting, playground::speaks_http1(&io)) => greeted,
            () = closing.heard() => return,
        };
        match speaks_http1 {
            Ok(Ok(false)) => self.serve_http2(io, Page::over_http2(edge), close, closing).await,
            Ok(Ok(true)) => {
                let service = TowerToHyperService::new(Page::over_http1(edge));
                let connection = playground::http1(greeting).serve_connection(TokioIo::new(io), service);
                // Its own timer cuts off who does not say what it wants.
                self.attend(connection, std::future::pending(), close, closing).await;
            }
            Ok(Err(error)) => tracing::debug!(%error, "connection ended"),
            Err(_) => tracing::debug!("a peer does not say what it speaks"),
        }
    }

    /// Until the connection ends by itself, or `silent` completes, or it has to go.
    async fn attend(
        &self,
        connection: impl GracefulConnection<Error = hyper::Error>,
        silent: impl Future<Output = ()>,
        close: watch::Sender<bool>,
        mut closing: Closing,
    ) {
        let mut connection = pin!(connection);
        tokio::select! {
            ended = connection.as_mut() => return report(ended),
            () = silent => return tracing::debug!("no HTTP/2 from a peer"),
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

    async fn encrypted(&self, io: Connection) -> io::Result<Connection> {
        match self.serving.security.tls_config() {
            None => Ok(io),
            Some(config) => timeout(self.serving.greeting, io.encrypted(config)).await?,
        }
    }
}

/// Of one connection, free again when dropped.
pub(super) struct Place {
    _permit: OwnedSemaphorePermit,
    _counted: Held,
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

//! Serves one connection from its first byte to its end.

use std::{
    convert::Infallible,
    io,
    pin::{Pin, pin},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll, ready},
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
    frames::{Frames, Overhead},
    listener::Connection,
    middleware::{Closing, Middleware},
    peers::{Address, Peer, Peers},
    request_body::per_mebibyte,
    sizes::HEADER_BYTES,
    streams::{Arrived, Readers, Records, StreamExecutor, Streams},
};
#[cfg(feature = "playground")]
use super::{
    cutoff::Cutoff,
    playground::{self, Page},
    stall::{Noted, Stall},
};
use crate::log_limit::limited;

/// The largest HTTP/2 frame. Large frames measurably speed up batches; the default size suits web pages.
const FRAME_BYTES: u32 = 1 << 20;

/// A peer that does not answer a PING within this time is considered gone.
const KEEP_ALIVE: Duration = Duration::from_secs(60);

/// The most streams that the peer may reset before the server handles them, and the most that the server
/// resets because of the peer's errors. With more, the connection is closed ("rapid reset").
const RESETS: usize = 1024;

/// The bytes of the HTTP/2 preface and of the header of the frame after it.
const GREETING_BYTES: u64 = 24 + 9;

/// The state that all connections share.
#[derive(Debug)]
pub(super) struct Connections {
    app: Arc<App>,
    routes: Routes,
    serving: Arc<Serving>,
    peers: Arc<Peers>,
    /// The number of connections so far, from which their ages are spread.
    count: AtomicU64,
    undrained: AtomicU64,
}

impl Connections {
    pub(super) fn new(app: Arc<App>, routes: Routes, serving: Serving) -> Self {
        let peers = Peers::new(app.clone(), serving.trusted_proxies.clone(), app.limits().shares);
        let (serving, peers) = (Arc::new(serving), Arc::new(peers));
        Self { app, routes, serving, peers, count: AtomicU64::new(0), undrained: AtomicU64::new(0) }
    }

    /// The number of connections that were closed because they did not drain in time.
    pub(super) fn undrained(&self) -> u64 {
        self.undrained.load(Ordering::Relaxed)
    }

    /// A place for another connection from `address`, or `None` if there are too many.
    pub(super) fn admit(&self, address: Address) -> Option<Peer> {
        self.peers.admit(address)
    }

    /// Configures HTTP/2 for one connection. Each of its streams has a cutoff.
    fn http2(&self, window: u32, executor: StreamExecutor) -> http2::Builder<StreamExecutor> {
        let mut http = http2::Builder::new(executor);
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

    /// The age at which a new connection is told to close: 0.9 to 1.1 times the configured age, so that
    /// connections that began together do not end together.
    fn age(&self) -> Duration {
        let most = self.serving.max_connection_age;
        if most.is_zero() {
            return Duration::MAX;
        }
        most.mul_f64(0.9 + 0.2 * spread(self.count.fetch_add(1, Ordering::Relaxed)))
    }

    /// The longest time for which received bytes can wait for their call: until the answer to the message
    /// before them has to be taken.
    fn longest_wait(&self) -> Duration {
        self.serving.answer_time + per_mebibyte(self.app.limits().max_message_bytes)
    }

    /// Serves `io` until the peer leaves. When `closing` becomes true or the connection reaches its age,
    /// the peer is told to close (GOAWAY), and calls in progress have the drain time to finish.
    pub(super) async fn serve(self: Arc<Self>, io: Connection, mut closing: Closing, peer: Peer) {
        let encrypted = tokio::select! {
            encrypted = self.encrypted(io, &peer) => encrypted,
            // No call has begun, so nothing has to be drained.
            () = closing.heard() => return,
        };
        let io = match encrypted {
            Ok(io) => io,
            Err(error) => return report_handshake(&error),
        };
        let (close, closed) = watch::channel(false);
        let (app, routes, serving) = (self.app.clone(), self.routes.clone(), self.serving.clone());
        let calls = Middleware::new(app, routes, serving, peer.clone(), Closing(closed));
        #[cfg(feature = "playground")]
        if self.serving.playground {
            return self.serve_page(io, calls, peer, close, closing).await;
        }
        self.serve_http2(io, calls, peer, close, closing).await;
    }

    async fn serve_http2<S>(
        &self,
        io: Connection,
        service: S,
        peer: Peer,
        close: watch::Sender<bool>,
        closing: Closing,
    ) where
        S: Service<Request<Incoming>, Response = Response<Body>, Error = Infallible> + Clone + Send + 'static,
        S::Future: Send + 'static,
    {
        let read = Arc::new(AtomicU64::new(0));
        let window = peer.window();
        let (abort, streams) = (Arc::new(Notify::new()), Arc::<Streams>::default());
        let executor = StreamExecutor::new(self.app.clone(), abort.clone(), streams.clone());
        let frames = Frames::default();
        let counted = Counted {
            io,
            read: read.clone(),
            frames,
            readers: Readers::new(peer.readers()),
            overhead: Overhead::new(peer.clone(), self.longest_wait()),
            records: Records::new(peer),
            streams,
            arrived: Arrived::default(),
        };
        let io = TokioIo::new(counted);
        let connection = self.http2(window, executor).serve_connection(io, TowerToHyperService::new(service));
        let end = async {
            tokio::select! {
                () = silence(&read, self.serving.greeting) => "the peer did not begin HTTP/2 in time",
                () = abort.notified() => "the peer does not read the rest of an answer that was cut",
            }
        };
        self.attend(connection, end, close, closing).await;
    }

    /// Serves HTTP/2, or the playground's page over HTTP/1.1, which browsers use without TLS.
    #[cfg(feature = "playground")]
    async fn serve_page(
        &self,
        io: Connection,
        calls: Middleware,
        peer: Peer,
        close: watch::Sender<bool>,
        mut closing: Closing,
    ) {
        let greeting = self.serving.greeting;
        let speaks_http1 = tokio::select! {
            greeted = timeout(greeting, playground::speaks_http1(&io)) => greeted,
            () = closing.heard() => return,
        };
        match speaks_http1 {
            Ok(Ok(false)) => self.serve_http2(io, Page::over_http2(calls), peer, close, closing).await,
            Ok(Ok(true)) => {
                let cutoff = Cutoff::new();
                let stall = Stall::new(cutoff.clone(), self.serving.answer_time);
                let service = TowerToHyperService::new(Page::over_http1(calls, stall.clone()));
                let io = TokioIo::new(Noted { io, stall });
                let connection = playground::http1(greeting, HEADER_BYTES).serve_connection(io, service);
                // A peer that sends no request is disconnected by HTTP/1.1's own timer; one that does not
                // read its answer, by the cutoff.
                let served = self.attend(connection, std::future::pending(), close, closing);
                cutoff.guard(&self.app, served).await;
            }
            Ok(Err(error)) => tracing::debug!(%error, "connection ended"),
            Err(_) => tracing::debug!("a peer sent too little to tell HTTP/1.1 from HTTP/2"),
        }
    }

    /// Drives the connection until it ends by itself, until `end` returns the reason to close it, or until
    /// it is told to close and has drained.
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
            self.undrained.fetch_add(1, Ordering::Relaxed);
            limited!(warn, "closing a connection that did not drain");
            return;
        };
        report(ended);
    }

    async fn encrypted(&self, io: Connection, peer: &Peer) -> io::Result<Connection> {
        match self.serving.security.tls_config() {
            None => Ok(io),
            Some(config) => {
                let busy = || io::Error::other("too many TLS handshakes are in progress");
                let _handshake = peer.handshake().ok_or_else(busy)?;
                timeout(self.serving.greeting, io.encrypted(config)).await?
            }
        }
    }
}

fn report_handshake(error: &io::Error) {
    limited!(info, %error, "a TLS handshake failed");
}

fn report(ended: hyper::Result<()>) {
    if let Err(error) = ended {
        tracing::debug!(%error, "connection ended");
    }
}

/// Completes if the peer has not begun HTTP/2 within the time for it.
async fn silence(read: &AtomicU64, greeting: Duration) {
    sleep(greeting).await;
    if read.load(Ordering::Relaxed) >= GREETING_BYTES {
        std::future::pending().await
    }
}

/// A connection that counts the bytes read from it, takes memory for its streams and for bytes that no window
/// counts, and is not read while too many of its streams wait.
struct Counted {
    io: Connection,
    read: Arc<AtomicU64>,
    frames: Frames,
    overhead: Overhead,
    records: Records,
    streams: Arc<Streams>,
    readers: Readers,
    arrived: Arrived,
}

impl AsyncRead for Counted {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let this = &mut *self;
        ready!(this.streams.poll_may_read(&mut this.arrived, &mut this.readers, cx));
        let before = buffer.filled().len();
        let Poll::Ready(read) = Pin::new(&mut this.io).poll_read(cx, buffer) else {
            this.streams.release_read_permit();
            return Poll::Pending;
        };
        read?;
        let read = &buffer.filled()[before..];
        this.read.fetch_add(read.len() as u64, Ordering::Relaxed);
        let begun = this.frames.begun();
        this.frames.read(read)?;
        this.arrived.add(this.frames.begun() - begun);
        this.records.charge(this.streams.count(&this.arrived))?;
        Poll::Ready(this.overhead.charge(&this.frames))
    }
}

impl AsyncWrite for Counted {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let this = &mut *self;
        let wrote = Pin::new(&mut this.io).poll_write(cx, bytes);
        this.streams.wrote(wrote.is_pending(), &mut this.readers);
        wrote
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let this = &mut *self;
        let wrote = Pin::new(&mut this.io).poll_write_vectored(cx, slices);
        this.streams.wrote(wrote.is_pending(), &mut this.readers);
        wrote
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

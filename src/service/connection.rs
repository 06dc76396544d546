//! Serves one connection from its first byte to its end.

use std::{
    convert::Infallible,
    future::poll_fn,
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
    App, ServerOptions,
    admission::low_discrepancy,
    frames::{FrameTracker, Overhead},
    listener::AcceptedConnection,
    middleware::{Closing, Middleware},
    peers::{Address, Peer, Peers},
    request_body::per_mebibyte,
    sizes::HEADER_BYTES,
    streams::{PendingStreams, StreamExecutor, StreamRecordMemory, Streams},
};
#[cfg(feature = "grpc-web")]
use super::{
    cutoff::Cutoff,
    stall::{Stall, StallDetector},
    web::{self, Web},
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
    options: Arc<ServerOptions>,
    peers: Arc<Peers>,
    /// The number of connections so far, from which their ages are spread.
    count: AtomicU64,
    undrained: AtomicU64,
}

impl Connections {
    pub(super) fn new(app: Arc<App>, routes: Routes, options: ServerOptions) -> Self {
        let peers = Peers::new(app.clone(), options.trusted_proxies.clone(), app.limits().shares);
        let (options, peers) = (Arc::new(options), Arc::new(peers));
        Self { app, routes, options, peers, count: AtomicU64::new(0), undrained: AtomicU64::new(0) }
    }

    /// The number of connections that were closed because they did not drain in time.
    pub(super) fn undrained(&self) -> u64 {
        self.undrained.load(Ordering::Relaxed)
    }

    /// A slot for another connection from `address`, or `None` if there are too many.
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
        let most = self.options.max_connection_age;
        if most.is_zero() {
            return Duration::MAX;
        }
        most.mul_f64(0.9 + 0.2 * low_discrepancy(self.count.fetch_add(1, Ordering::Relaxed)))
    }

    /// The longest time for which received bytes can wait for their call: until the answer to the message
    /// before them has to be taken.
    fn longest_wait(&self) -> Duration {
        self.options.answer_time + per_mebibyte(self.app.limits().max_message_bytes)
    }

    /// Serves `io` until the peer leaves. When `closing` becomes true or the connection reaches its age,
    /// the peer is told to close (GOAWAY), and calls in progress have the drain time to finish.
    pub(super) async fn serve(self: Arc<Self>, io: AcceptedConnection, mut closing: Closing, peer: Peer) {
        let encrypted = tokio::select! {
            encrypted = self.encrypted(io, &peer) => encrypted,
            // No call has begun, so nothing has to be drained.
            () = closing.announced() => return,
        };
        let io = match encrypted {
            Ok(io) => io,
            Err(error) => return report_handshake(&error),
        };
        let (close, closed) = watch::channel(false);
        let (app, routes, options) = (self.app.clone(), self.routes.clone(), self.options.clone());
        let calls = Middleware::new(app, routes, options, peer.clone(), Closing(closed));
        #[cfg(feature = "grpc-web")]
        if self.options.serves_browsers() {
            return self.serve_browsers(io, calls, peer, close, closing).await;
        }
        self.serve_http2(io, calls, peer, close, closing).await;
    }

    async fn serve_http2<S>(
        &self,
        io: AcceptedConnection,
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
        let (abort, streams) = (Arc::new(Notify::new()), Arc::new(Streams::new(peer.read_permits())));
        let executor = StreamExecutor::new(self.app.clone(), abort.clone(), streams.clone());
        let frames = FrameTracker::default();
        let metered = MeteredConnection {
            io,
            read: read.clone(),
            frames,
            overhead: Overhead::new(peer.clone(), self.longest_wait()),
            records: StreamRecordMemory::new(peer),
            streams: streams.clone(),
            pending: PendingStreams::default(),
        };
        let io = TokioIo::new(metered);
        let connection = self.http2(window, executor).serve_connection(io, TowerToHyperService::new(service));
        let end = async {
            tokio::select! {
                () = no_greeting(&read, self.options.greeting) => "the peer did not begin HTTP/2 in time",
                () = abort.notified() => "the peer does not read the rest of an answer that was cut",
                () = streams.until_overdue(&self.app) => "the peer does not read an answer in time",
            }
        };
        self.drive(connection, Some(&streams), end, close, closing).await;
    }

    /// Serves HTTP/2, or HTTP/1.1, which browsers use without TLS.
    #[cfg(feature = "grpc-web")]
    async fn serve_browsers(
        &self,
        io: AcceptedConnection,
        calls: Middleware,
        peer: Peer,
        close: watch::Sender<bool>,
        mut closing: Closing,
    ) {
        let (options, greeting) = (self.options.clone(), self.options.greeting);
        let speaks_http1 = tokio::select! {
            greeted = timeout(greeting, web::speaks_http1(&io)) => greeted,
            () = closing.announced() => return,
        };
        match speaks_http1 {
            Ok(Ok(false)) => {
                self.serve_http2(io, Web::over_http2(calls, options), peer, close, closing).await
            }
            Ok(Ok(true)) => {
                let cutoff = Cutoff::new();
                let stall = Stall::new(cutoff.clone(), self.options.answer_time);
                let service = TowerToHyperService::new(Web::over_http1(calls, options, stall.clone()));
                let io = TokioIo::new(StallDetector { io, stall });
                let connection = web::http1(greeting, HEADER_BYTES).serve_connection(io, service);
                // A peer that sends no request is disconnected by HTTP/1.1's own timer; one that does not
                // read its answer, by the cutoff.
                let served = self.drive(connection, None, std::future::pending(), close, closing);
                cutoff.guard(&self.app, served).await;
            }
            Ok(Err(error)) => tracing::debug!(%error, "connection ended"),
            Err(_) => tracing::debug!("a peer sent too little to tell HTTP/1.1 from HTTP/2"),
        }
    }

    /// Drives the connection until it ends by itself, until `end` returns the reason to close it, or until
    /// it is told to close and has drained.
    async fn drive(
        &self,
        connection: impl GracefulConnection<Error = hyper::Error>,
        streams: Option<&Streams>,
        end: impl Future<Output = &'static str>,
        close: watch::Sender<bool>,
        mut closing: Closing,
    ) {
        let mut connection = pin!(connection);
        tokio::select! {
            // The connection is polled first, because it sends the answers that `end` would wait for.
            biased;
            ended = polled(connection.as_mut(), streams) => return report(ended),
            why = end => return tracing::debug!(why, "closed a connection"),
            () = closing.announced() => {}
            () = sleep(self.age()) => {}
        }
        close.send_replace(true);
        connection.as_mut().graceful_shutdown();
        let Ok(ended) = timeout(self.options.drain, polled(connection, streams)).await else {
            self.undrained.fetch_add(1, Ordering::Relaxed);
            limited!(warn, "closing a connection that did not drain");
            return;
        };
        report(ended);
    }

    async fn encrypted(&self, io: AcceptedConnection, peer: &Peer) -> io::Result<AcceptedConnection> {
        match self.options.security.tls_config() {
            None => Ok(io),
            Some(config) => {
                let busy = || io::Error::other("too many TLS handshakes are in progress");
                let _handshake = peer.handshake().ok_or_else(busy)?;
                timeout(self.options.greeting, io.encrypted(config)).await?
            }
        }
    }
}

/// Polls a connection to its end.
async fn polled<C: Future>(mut connection: Pin<&mut C>, streams: Option<&Streams>) -> C::Output {
    poll_fn(|cx| match streams {
        Some(streams) => streams.within_poll(|| connection.as_mut().poll(cx)),
        None => connection.as_mut().poll(cx),
    })
    .await
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
async fn no_greeting(read: &AtomicU64, greeting: Duration) {
    sleep(greeting).await;
    if read.load(Ordering::Relaxed) >= GREETING_BYTES {
        std::future::pending().await
    }
}

/// A connection that counts the bytes read from it, takes memory for its streams and for bytes that no window
/// counts, and is not read while too many of its streams wait.
struct MeteredConnection {
    io: AcceptedConnection,
    read: Arc<AtomicU64>,
    frames: FrameTracker,
    overhead: Overhead,
    records: StreamRecordMemory,
    streams: Arc<Streams>,
    pending: PendingStreams,
}

impl MeteredConnection {
    /// Passes on the result of a write. Notes if the socket took nothing.
    fn wrote(&self, result: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        if result.is_pending() {
            self.streams.note_blocked();
        }
        result
    }
}

impl AsyncRead for MeteredConnection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let this = &mut *self;
        ready!(this.streams.poll_may_read(&mut this.pending, cx));
        let before = buffer.filled().len();
        ready!(Pin::new(&mut this.io).poll_read(cx, buffer))?;
        let read = &buffer.filled()[before..];
        this.read.fetch_add(read.len() as u64, Ordering::Relaxed);
        let (count, headers) = (this.frames.count(), this.frames.header_frames());
        this.frames.read(read)?;
        this.streams.count_frames(this.frames.count() - count);
        this.pending.add(this.frames.header_frames() - headers);
        this.records.charge(this.streams.count(&this.pending))?;
        Poll::Ready(this.overhead.charge(&this.frames))
    }
}

impl AsyncWrite for MeteredConnection {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let result = Pin::new(&mut self.io).poll_write(cx, bytes);
        self.wrote(result)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let result = Pin::new(&mut self.io).poll_write_vectored(cx, slices);
        self.wrote(result)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        // TLS takes bytes into a buffer of its own and sends them here.
        let flushed = Pin::new(&mut self.io).poll_flush(cx);
        match &flushed {
            Poll::Pending => self.streams.note_blocked(),
            Poll::Ready(_) => self.streams.note_flushed(),
        }
        flushed
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(cx)
    }
}

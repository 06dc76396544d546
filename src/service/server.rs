//! Runs the services on listeners until the server is told to stop.

use std::{future::Future, net::IpAddr, sync::Arc, time::Duration};

use tokio::{sync::watch, task::JoinSet, time::timeout};
use tonic::service::Routes;
use tonic_health::{ServingStatus, server::HealthReporter};

#[cfg(feature = "grpc-web")]
use super::Origin;
use super::{
    App, Readiness, Security, StartError, connection::Connections, contacts, hulls, info, listener::Listener,
    middleware::Closing,
};
use crate::{
    log_limit::limited,
    proto::{self, contact_service_server, hull_service_server, server_service_server},
    record::Recorder,
    store::StoreError,
};

/// The pause after a failed accept (too many open files), so that the loop does not spin.
pub(super) const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// How a server serves its calls. Its `Limits` say which requests it accepts.
#[derive(Clone, Debug)]
pub struct ServerOptions {
    /// The rules for connecting and calling: TLS and tokens.
    pub security: Arc<Security>,
    /// The interval at which certificates and tokens are read again; the files may change while the
    /// server runs.
    pub reload_every: Duration,
    /// The time for calls in progress to end once their connection is about to close.
    pub drain: Duration,
    /// The approximate age at which a connection is told to close, so that its client finds new
    /// servers; zero stands for never.
    pub max_connection_age: Duration,
    /// The interval at which the store is probed.
    pub probe_every: Duration,
    /// The time for a peer's TLS handshake, and again for its HTTP/2 preface: enough for several
    /// round trips.
    pub greeting: Duration,
    /// The time for a request's message to arrive, plus a second per MiB of it.
    pub message_time: Duration,
    /// The time for a caller to read an answer, plus a second per MiB of it.
    pub answer_time: Duration,
    /// The addresses of proxies: each of their connections is a separate caller.
    pub trusted_proxies: Vec<IpAddr>,
    /// Records calls; `None` records nothing.
    pub recorder: Option<Arc<Recorder>>,
    /// Whether to serve the page that shows contacts, and gRPC-web with it; only with the feature
    /// `playground`.
    #[cfg(feature = "playground")]
    pub playground: bool,
    /// Whether to answer gRPC-web; only with the feature `grpc-web`.
    #[cfg(feature = "grpc-web")]
    pub grpc_web: bool,
    /// The origins of pages of other sites that may call over gRPC-web.
    #[cfg(feature = "grpc-web")]
    pub grpc_web_origins: Vec<Origin>,
}

impl ServerOptions {
    /// Whether connections may be those of browsers.
    #[cfg(feature = "grpc-web")]
    pub(super) fn serves_browsers(&self) -> bool {
        #[cfg(feature = "playground")]
        if self.playground {
            return true;
        }
        self.grpc_web
    }
}

impl Default for ServerOptions {
    fn default() -> Self {
        Self {
            security: Arc::default(),
            reload_every: Duration::from_secs(10),
            drain: Duration::from_secs(10),
            max_connection_age: Duration::ZERO,
            probe_every: Duration::from_secs(10),
            greeting: Duration::from_secs(10),
            message_time: Duration::from_secs(30),
            answer_time: Duration::from_secs(30),
            trusted_proxies: Vec::new(),
            recorder: None,
            #[cfg(feature = "playground")]
            playground: false,
            #[cfg(feature = "grpc-web")]
            grpc_web: false,
            #[cfg(feature = "grpc-web")]
            grpc_web_origins: Vec::new(),
        }
    }
}

/// Serves `app` on `listeners` until `shutdown` completes.
///
/// `shutdown` returns the grace period. During the grace period health reports NOT_SERVING while
/// calls are still accepted, so that load balancers notice before any call is refused. After it no
/// new connection is accepted, open connections are told to close (GOAWAY), streams end after the
/// message in progress, and calls have `options.drain` to finish before their connections are cut.
///
/// # Errors
/// The reflection service could not be built.
pub async fn run(
    listeners: Vec<Listener>,
    app: Arc<App>,
    options: ServerOptions,
    shutdown: impl Future<Output = Duration>,
) -> Result<(), StartError> {
    let (mut reporter, routes) = routes(&app).await?;
    let drain = options.drain;
    // The state is set before the first connection is accepted, and before the probe can find a failing
    // store.
    app.set_readiness(Readiness::Ready);
    let mut beside = JoinSet::new();
    beside.spawn(reload(options.security.clone(), options.reload_every));
    beside.spawn(probe(app.clone(), reporter.clone(), options.probe_every));
    let connections = Arc::new(Connections::new(app.clone(), routes.prepare(), options));
    let (close, closing) = watch::channel(false);
    let closing = Closing(closing);
    let mut accepting = JoinSet::new();
    for listener in listeners {
        accepting.spawn(accept(listener, connections.clone(), closing.clone()));
    }

    let grace = shutdown.await;
    tracing::info!(grace_seconds = grace.as_secs_f64(), drain_seconds = drain.as_secs_f64(), "stopping");
    // Stop the probe, which would report SERVING again.
    beside.shutdown().await;
    app.set_readiness(Readiness::Stopping);
    for service in SERVICES {
        reporter.set_service_status(service, ServingStatus::NotServing).await;
    }
    tokio::time::sleep(grace).await;
    close.send_replace(true);
    // Watchers have received the status by now. End their streams, for which the server would
    // otherwise wait.
    for service in SERVICES {
        reporter.clear_service_status(service).await;
    }
    while accepting.join_next().await.is_some() {}
    tracing::info!(undrained = connections.undrained(), "stopped");
    Ok(())
}

/// The names that health answers for; the empty name stands for the whole server.
const SERVICES: [&str; 4] = [
    "",
    hull_service_server::SERVICE_NAME,
    contact_service_server::SERVICE_NAME,
    server_service_server::SERVICE_NAME,
];

/// The handlers without listeners and middleware, for fuzzing them with bytes.
///
/// # Errors
/// The errors of [`run`].
#[cfg(feature = "testing")]
pub async fn handlers(app: &Arc<App>) -> Result<Routes, StartError> {
    Ok(routes(app).await?.1)
}

async fn routes(app: &Arc<App>) -> Result<(HealthReporter, Routes), StartError> {
    let limit = app.limits().max_message_bytes;
    let (reporter, health) = tonic_health::server::health_reporter();
    for service in SERVICES {
        reporter.set_service_status(service, ServingStatus::Serving).await;
    }
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(proto::FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
            // The types of the error details, so that tools can show them.
            .register_encoded_file_descriptor_set(tonic_types::pb::FILE_DESCRIPTOR_SET)
    };
    let routes = Routes::default()
        .add_service(contacts::service(app.clone()).max_decoding_message_size(limit))
        .add_service(hulls::service(app.clone()).max_decoding_message_size(limit))
        .add_service(info::service(app.clone()))
        .add_service(health)
        .add_service(reflection().build_v1().map_err(StartError::Reflection)?)
        .add_service(reflection().build_v1alpha().map_err(StartError::Reflection)?);
    Ok((reporter, routes))
}

/// Accepts connections until told to stop, then waits for the open ones, which end by themselves.
async fn accept(listener: Listener, connections: Arc<Connections>, mut closing: Closing) {
    let mut open = JoinSet::new();
    let closing_of_connections = closing.clone();
    loop {
        tokio::select! {
            () = closing.announced() => break,
            Some(_) = open.join_next() => {}
            accepted = listener.accept() => match accepted {
                Ok((io, address)) => {
                    // Beyond the limit the connection is closed.
                    if let Some(peer) = connections.admit(address) {
                        open.spawn(connections.clone().serve(io, closing_of_connections.clone(), peer));
                    }
                }
                Err(error) => {
                    limited!(warn, %error, "accept failed");
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
            },
        }
    }
    drop(listener);
    while open.join_next().await.is_some() {}
}

/// The shortest time limit of a probe. A working store answers in milliseconds; a busy machine may
/// take longer.
const SHORTEST_PROBE: Duration = Duration::from_secs(1);

/// Probes the store in an endless loop. While the store cannot be written to, the health of HullService
/// is NOT_SERVING. A probe that is not answered within an interval fails, so that a hung store is
/// noticed within two intervals.
async fn probe(app: Arc<App>, reporter: HealthReporter, every: Duration) {
    let within = every.max(SHORTEST_PROBE);
    let mut well = true;
    loop {
        tokio::time::sleep(every).await;
        let probed = timeout(within, app.registry().probe()).await.unwrap_or_else(|_| {
            let why = format!("a probe was not answered within {} s", within.as_secs_f64());
            Err(StoreError::Hung(why))
        });
        if probed.is_ok() == well {
            continue;
        }
        well = probed.is_ok();
        let (status, readiness) = match probed {
            Ok(()) => {
                tracing::info!("the store can be written to again");
                (ServingStatus::Serving, Readiness::Ready)
            }
            Err(error) => {
                tracing::error!(%error, "the store cannot be written to: degraded");
                (ServingStatus::NotServing, Readiness::Degraded(error.to_string()))
            }
        };
        reporter.set_service_status(hull_service_server::SERVICE_NAME, status).await;
        app.set_readiness(readiness);
    }
}

/// Reads certificates and tokens again at each interval, in an endless loop.
async fn reload(security: Arc<Security>, every: Duration) {
    loop {
        tokio::time::sleep(every).await;
        security.clone().reload_aside().await;
    }
}

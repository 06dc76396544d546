//! Runs the services on listeners until told to stop.

use std::{future::Future, net::IpAddr, sync::Arc, time::Duration};

use tokio::{sync::watch, task::JoinSet, time::timeout};
use tonic::service::Routes;
use tonic_health::{ServingStatus, server::HealthReporter};

use super::{
    App, OpenError, Readiness, Security, connection::Connections, contacts, hulls, info, listener::Listener,
    middleware::Closing,
};
use crate::{log_limit::Repeated, proto, store::StoreError};

/// After a failed accept (too many open files), so that the loop does not spin.
pub(super) const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// How a server serves; what it accepts is its `Limits`.
#[derive(Clone, Debug)]
pub struct Serving {
    /// Who may connect and call.
    pub security: Arc<Security>,
    /// How often certificates and tokens are read again; they may change under the server.
    pub reload_every: Duration,
    /// How long calls under way have to end once their connection is about to close.
    pub drain: Duration,
    /// After about this long a connection is told to close, so that its client finds new
    /// servers; zero: never.
    pub max_connection_age: Duration,
    /// How often the store is tried.
    pub probe_every: Duration,
    /// By then a peer has spoken TLS, and again by then HTTP/2's preface: some round trips.
    pub greeting: Duration,
    /// The time that a request's message has to arrive, beside a second for each MiB of it.
    pub message_time: Duration,
    /// The time that a caller has to take an answer, beside a second for each MiB of it.
    pub answer_time: Duration,
    /// Addresses of proxies: each of their connections counts as a caller of its own.
    pub trusted_proxies: Vec<IpAddr>,
    /// Whether a page that shows contacts is served too, and gRPC-web with it; only with the
    /// feature `playground`.
    #[cfg(feature = "playground")]
    pub playground: bool,
}

impl Default for Serving {
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
            #[cfg(feature = "playground")]
            playground: false,
        }
    }
}

/// Serves `app` on `listeners` until `shutdown` completes.
///
/// It completes with the grace: for so long health says NOT_SERVING and calls are accepted
/// all the same, so that balancers hear of it before anybody is turned away. Then no
/// connection is accepted any more, those that are open are told to close (GOAWAY), streams
/// end after the message under way, and calls have `serving.drain` to finish before their
/// connections are cut.
///
/// # Errors
/// The reflection service could not be built.
pub async fn run(
    listeners: Vec<Listener>,
    app: Arc<App>,
    serving: Serving,
    shutdown: impl Future<Output = Duration>,
) -> Result<(), OpenError> {
    let (mut reporter, routes) = routes(&app).await?;
    let drain = serving.drain;
    // Before anybody is served, and before a failing store is found.
    app.set_readiness(Readiness::Ready);
    let mut beside = JoinSet::new();
    beside.spawn(reload(serving.security.clone(), serving.reload_every));
    beside.spawn(probe(app.clone(), reporter.clone(), serving.probe_every));
    let connections = Arc::new(Connections::new(app.clone(), routes.prepare(), serving));
    let (close, closing) = watch::channel(false);
    let closing = Closing(closing);
    let mut accepting = JoinSet::new();
    for listener in listeners {
        accepting.spawn(accept(listener, connections.clone(), closing.clone()));
    }

    let grace = shutdown.await;
    tracing::info!(grace_seconds = grace.as_secs_f64(), drain_seconds = drain.as_secs_f64(), "stopping");
    // It would say SERVING again.
    beside.shutdown().await;
    app.set_readiness(Readiness::Stopping);
    for service in SERVICES {
        reporter.set_service_status(service, ServingStatus::NotServing).await;
    }
    tokio::time::sleep(grace).await;
    close.send_replace(true);
    // Watchers have heard it: what they wait for ends, or they would be waited for.
    for service in SERVICES {
        reporter.clear_service_status(service).await;
    }
    while accepting.join_next().await.is_some() {}
    tracing::info!("stopped");
    Ok(())
}

/// What health answers for; the empty name is the server as a whole.
const SERVICES: [&str; 4] = ["", HULL_SERVICE, "hullcast.v1.ContactService", "hullcast.v1.ServerService"];

const HULL_SERVICE: &str = "hullcast.v1.HullService";

/// The handlers without listener and middleware: for fuzzing them with bytes.
///
/// # Errors
/// As [`run`].
#[doc(hidden)]
pub async fn handlers(app: &Arc<App>) -> Result<Routes, OpenError> {
    Ok(routes(app).await?.1)
}

async fn routes(app: &Arc<App>) -> Result<(HealthReporter, Routes), OpenError> {
    let limit = app.limits().max_message_bytes;
    let (reporter, health) = tonic_health::server::health_reporter();
    for service in SERVICES {
        reporter.set_service_status(service, ServingStatus::Serving).await;
    }
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(proto::FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
            // What errors carry, so that tools can show it.
            .register_encoded_file_descriptor_set(tonic_types::pb::FILE_DESCRIPTOR_SET)
    };
    let routes = Routes::default()
        .add_service(contacts::service(app.clone()).max_decoding_message_size(limit))
        .add_service(hulls::service(app.clone()).max_decoding_message_size(limit))
        .add_service(info::service(app.clone()))
        .add_service(health)
        .add_service(reflection().build_v1().map_err(OpenError::Reflection)?)
        .add_service(reflection().build_v1alpha().map_err(OpenError::Reflection)?);
    Ok((reporter, routes))
}

static ACCEPT_FAILED: Repeated = Repeated::new();

/// Accepts until told to stop, then waits for its connections, which end by themselves.
async fn accept(listener: Listener, connections: Arc<Connections>, mut closing: Closing) {
    let mut open = JoinSet::new();
    let theirs = closing.clone();
    loop {
        tokio::select! {
            () = closing.heard() => break,
            Some(_) = open.join_next() => {}
            accepted = listener.accept() => match accepted {
                Ok((io, address)) => {
                    // Without a place the peer finds its connection closed.
                    if let Some(peer) = connections.admit(address) {
                        open.spawn(connections.clone().serve(io, theirs.clone(), peer));
                    }
                }
                Err(error) => {
                    if let Some(left_out) = ACCEPT_FAILED.due() {
                        tracing::warn!(%error, left_out, "accept failed");
                    }
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
            },
        }
    }
    drop(listener);
    while open.join_next().await.is_some() {}
}

/// A store that answers takes milliseconds; a machine that is busy may take longer.
const SHORTEST_PROBE: Duration = Duration::from_secs(1);

/// Tries the store, for ever: registering is not served while it cannot be written to. A probe
/// that is not answered within an interval fails, so that a store that hangs is noticed within
/// two.
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
        reporter.set_service_status(HULL_SERVICE, status).await;
        app.set_readiness(readiness);
    }
}

/// Reads certificates and tokens again, for ever.
async fn reload(security: Arc<Security>, every: Duration) {
    loop {
        tokio::time::sleep(every).await;
        let security = security.clone();
        // Files: not on the threads that serve.
        let _ = tokio::task::spawn_blocking(move || security.reload()).await;
    }
}

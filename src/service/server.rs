//! Runs the services on listeners until told to stop.

use std::{future::Future, sync::Arc, time::Duration};

use tokio::{sync::watch, task::JoinSet};
use tonic::service::Routes;
use tonic_health::{ServingStatus, server::HealthReporter};

use super::{
    App, OpenError, Security, connection::Connections, contacts, edge::Closing, hulls, info,
    listener::Listener,
};
use crate::proto;

/// After a failed accept (too many open files), so that the loop does not spin.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// How a server serves; what it accepts is its `Limits`.
#[derive(Clone, Debug)]
pub struct Serving {
    /// Who may connect and call.
    pub security: Arc<Security>,
    /// How often certificates and tokens are read again; they may change under the server.
    pub reload_every: Duration,
    /// How long calls under way have to end once their connection is about to close.
    pub drain: Duration,
}

impl Default for Serving {
    fn default() -> Self {
        Self {
            security: Arc::default(),
            reload_every: Duration::from_secs(10),
            drain: Duration::from_secs(10),
        }
    }
}

/// Serves `app` on `listeners` until `shutdown` completes.
///
/// Then health says NOT_SERVING, no call is accepted any more, streams end after the
/// message under way, and calls have `serving.drain` to finish before their connections
/// are closed.
///
/// # Errors
/// The reflection service could not be built.
pub async fn run(
    listeners: Vec<Listener>,
    app: Arc<App>,
    serving: Serving,
    shutdown: impl Future<Output = ()>,
) -> Result<(), OpenError> {
    let (mut reporter, routes) = routes(&app).await?;
    let mut reloading = JoinSet::new();
    reloading.spawn(reload(serving.security.clone(), serving.reload_every));
    let drain = serving.drain;
    let connections = Arc::new(Connections::new(routes.prepare(), app.limits(), serving));
    let (close, closing) = watch::channel(false);
    let closing = Closing(closing);
    let mut accepting = JoinSet::new();
    for listener in listeners {
        accepting.spawn(accept(listener, connections.clone(), closing.clone()));
    }

    shutdown.await;
    tracing::info!(drain_seconds = drain.as_secs_f64(), "stopping");
    for service in SERVICES {
        reporter.set_service_status(service, ServingStatus::NotServing).await;
    }
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
const SERVICES: [&str; 4] =
    ["", "hullcast.v1.HullService", "hullcast.v1.ContactService", "hullcast.v1.ServerService"];

/// The handlers without listener and edge: for fuzzing them with bytes.
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

/// Accepts until told to stop, then waits for its connections, which end by themselves.
async fn accept(listener: Listener, connections: Arc<Connections>, mut closing: Closing) {
    let mut open = JoinSet::new();
    let theirs = closing.clone();
    loop {
        tokio::select! {
            () = closing.heard() => break,
            Some(_) = open.join_next() => {}
            accepted = listener.accept() => match accepted {
                Ok(io) => {
                    open.spawn(connections.clone().serve(io, theirs.clone()));
                }
                Err(error) => {
                    tracing::warn!(%error, "accept failed");
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
            },
        }
    }
    drop(listener);
    while open.join_next().await.is_some() {}
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

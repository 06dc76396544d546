//! Runs the services on listeners until told to stop.

use std::{future::Future, pin::pin, sync::Arc, time::Duration};

use hyper::server::conn::http2;
use hyper_util::{
    rt::{TokioExecutor, TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use tokio::{sync::watch, task::JoinSet};
use tonic::service::Routes;
use tonic_health::{ServingStatus, server::HealthReporter};

use super::{App, OpenError, contacts, edge::Edge, hulls, info, listener::Listener};
use crate::proto;

/// HTTP/2 settings that measurably matter for batches; the defaults are sized for pages.
const FRAME_BYTES: u32 = 1 << 20;
const WINDOW_BYTES: u32 = 8 << 20;

/// A peer that does not answer a ping for this long is gone.
const KEEP_ALIVE: Duration = Duration::from_secs(60);

/// After a failed accept (too many open files), so that the loop does not spin.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Serves `app` on `listeners` until `shutdown` completes.
///
/// Then health says NOT_SERVING, no call is accepted any more, and calls in
/// flight have `drain` to finish before their connections are closed.
///
/// # Errors
/// The reflection service could not be built.
pub async fn run(
    listeners: Vec<Listener>,
    app: Arc<App>,
    drain: Duration,
    shutdown: impl Future<Output = ()>,
) -> Result<(), OpenError> {
    let (mut reporter, routes) = routes(&app).await?;
    let edge = Edge::new(routes.prepare());
    let streams = app.limits().max_streams_per_connection;
    let (stop, stopped) = watch::channel(());
    let mut accepting = JoinSet::new();
    for listener in listeners {
        accepting.spawn(accept(listener, edge.clone(), streams, drain, stopped.clone()));
    }
    drop(stopped);

    shutdown.await;
    tracing::info!(drain_seconds = drain.as_secs_f64(), "stopping");
    for service in SERVICES {
        reporter.set_service_status(service, ServingStatus::NotServing).await;
    }
    app.stopping.send_replace(true);
    stop.send_replace(());
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

/// Accepts until told to stop, then waits for its connections, at most `drain`.
async fn accept(
    listener: Listener,
    edge: Edge,
    streams: u32,
    drain: Duration,
    mut stopped: watch::Receiver<()>,
) {
    let mut http = http2::Builder::new(TokioExecutor::new());
    http.timer(TokioTimer::new())
        .adaptive_window(false)
        .initial_stream_window_size(WINDOW_BYTES)
        .initial_connection_window_size(WINDOW_BYTES)
        .max_frame_size(FRAME_BYTES)
        .max_concurrent_streams(streams)
        .keep_alive_interval(KEEP_ALIVE)
        .keep_alive_timeout(KEEP_ALIVE);

    let mut connections = JoinSet::new();
    loop {
        tokio::select! {
            _ = stopped.changed() => break,
            Some(_) = connections.join_next() => {}
            accepted = listener.accept() => match accepted {
                Ok(io) => {
                    let service = TowerToHyperService::new(edge.clone());
                    let connection = http.serve_connection(TokioIo::new(io), service);
                    let mut stopped = stopped.clone();
                    connections.spawn(async move {
                        let mut connection = pin!(connection);
                        let ended = tokio::select! {
                            ended = connection.as_mut() => ended,
                            _ = stopped.changed() => {
                                connection.as_mut().graceful_shutdown();
                                connection.await
                            }
                        };
                        if let Err(error) = ended {
                            tracing::debug!(%error, "connection ended");
                        }
                    });
                }
                Err(error) => {
                    tracing::warn!(%error, "accept failed");
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
            },
        }
    }
    drop(listener);
    let drained = async { while connections.join_next().await.is_some() {} };
    if tokio::time::timeout(drain, drained).await.is_err() {
        tracing::warn!(connections = connections.len(), "closing connections that did not drain");
        connections.shutdown().await;
    }
}

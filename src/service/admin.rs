//! The operator's port: `/metrics`, `/livez` and `/readyz` in plain HTTP.

use std::{convert::Infallible, sync::Arc, time::Duration};

use http::{Method, Request, Response, StatusCode, header};
use hyper::{body::Incoming, server::conn::http1, service::service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::{net::TcpListener, time::timeout};

use super::{App, server::ACCEPT_PAUSE};
use crate::{
    budget::{CallerKey, Slots},
    log_limit::limited,
};

/// Connections at a time; scrapers and probes are few. Addresses share them as callers share
/// memory, so that no address shuts out the others.
pub const CONNECTIONS: u64 = 64;

/// The lifetime of a connection, which is enough for several requests.
const CONNECTION_TIME: Duration = Duration::from_secs(60);

/// A peer that has not sent its request's header after this time is disconnected.
const HEADER_TIME: Duration = Duration::from_secs(5);

/// Answers requests on `listener` until the future is dropped.
pub async fn serve_admin(listener: TcpListener, app: Arc<App>) {
    let slots = Slots::new(CONNECTIONS);
    loop {
        let (io, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                limited!(warn, %error, "accept failed on the admin port");
                tokio::time::sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        let caller = app.callers().get(CallerKey::of_address(peer.ip()));
        // Beyond the limit the connection is closed.
        let Some(slot) = slots.take(&caller) else { continue };
        let app = app.clone();
        tokio::spawn(async move {
            let service = service_fn(|request| {
                let response = answer(&app, &request);
                async { Ok::<_, Infallible>(response) }
            });
            let mut http = http1::Builder::new();
            http.timer(TokioTimer::new()).header_read_timeout(HEADER_TIME);
            let connection = http.serve_connection(TokioIo::new(io), service);
            let _ = timeout(CONNECTION_TIME, connection).await;
            drop(slot);
        });
    }
}

fn answer(app: &App, request: &Request<Incoming>) -> Response<String> {
    if !matches!(*request.method(), Method::GET | Method::HEAD) {
        return plain(StatusCode::METHOD_NOT_ALLOWED, "GET or HEAD".into());
    }
    match request.uri().path() {
        "/metrics" => {
            let mut response = Response::new(app.metrics_text());
            let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
            response.headers_mut().insert(header::CONTENT_TYPE, header::HeaderValue::from_static(kind));
            response
        }
        "/livez" => plain(StatusCode::OK, "live\n".into()),
        "/readyz" => {
            let readiness = app.readiness();
            let code =
                if readiness.accepts_calls() { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
            plain(code, format!("{readiness}\n"))
        }
        _ => plain(StatusCode::NOT_FOUND, "not found; the paths are /metrics, /livez and /readyz\n".into()),
    }
}

fn plain(code: StatusCode, text: String) -> Response<String> {
    let mut response = Response::new(text);
    *response.status_mut() = code;
    let kind = header::HeaderValue::from_static("text/plain; charset=utf-8");
    response.headers_mut().insert(header::CONTENT_TYPE, kind);
    response
}

//! The gRPC services. The request's way is wire -> handlers -> batch -> wire.
//!
//! [`wire`] checks requests and writes responses, [`contacts`] with [`find`] and
//! [`steps`], [`hulls`] and [`info`] are the handlers, [`batch`] computes. [`server`] runs it all on
//! [`listener`]s, each [`connection`] behind an [`edge`], which holds for every call and
//! asks [`security`] who may make it.

mod admin;
mod admission;
pub mod batch;
mod call;
mod connection;
mod contacts;
mod context;
mod edge;
mod error;
mod find;
mod hulls;
mod info;
mod injected;
mod limits;
mod listener;
mod outputs;
#[cfg(feature = "playground")]
mod playground;
mod readiness;
mod security;
mod server;
mod steps;
pub mod wire;

use std::{
    fmt,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

pub use admin::serve_admin;
use batch::Engine;
pub use error::{Kind, Place, ServiceError};
pub use limits::Limits;
pub use listener::Listener;
pub use outputs::Outputs;
pub use readiness::Readiness;
pub use security::{LoadError, Security, SecurityFiles};
#[doc(hidden)]
pub use server::handlers;
pub use server::{Serving, run};
use tokio::sync::Semaphore;

use crate::{
    compute::Compute,
    metrics::Metrics,
    store::{BlobStore, Registry, registry::Bounds},
};

/// What every handler shares.
#[derive(Debug)]
pub struct App {
    limits: Limits,
    registry: Registry,
    engine: Engine,
    /// For what streams keep from one message to the next.
    stream_room: Arc<Semaphore>,
    metrics: Arc<Metrics>,
    readiness: Mutex<Readiness>,
}

impl App {
    /// Hulls in `blobs`, computed on `threads` threads (0: one a core).
    ///
    /// # Errors
    /// The limits contradict each other, or the threads could not be started.
    pub fn new(blobs: Arc<dyn BlobStore>, limits: Limits, threads: usize) -> Result<Self, OpenError> {
        if let Some(why) = limits.contradiction() {
            return Err(OpenError::Limits(why));
        }
        let compute = Compute::new(threads).map_err(|error| OpenError::Threads(error.to_string()))?;
        let bounds = Bounds {
            cache_bytes: limits.cache_bytes,
            store_bytes: limits.store_bytes,
            cache_age: Duration::from_secs(limits.cache_age_seconds.into()),
            max_vertices: limits.max_vertices_per_hull as usize,
            max_blob_bytes: limits.max_blob_bytes(),
            store_limit: Duration::from_secs(limits.store_seconds.into()),
            shares: limits.shares,
        };
        let metrics = Arc::new(Metrics::default());
        let (pairs, bytes) = (limits.max_pairs_in_flight, limits.max_message_bytes);
        let engine = Engine::new(compute.clone(), pairs, bytes, metrics.clone());
        let registry = Registry::new(blobs, compute, bounds, metrics.clone());
        let stream_room = steps::room(limits.max_stream_state_bytes);
        let readiness = Mutex::new(Readiness::Starting);
        Ok(Self { limits, registry, engine, stream_room, metrics, readiness })
    }

    /// What the server accepts.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// The hulls.
    pub fn registry(&self) -> &Registry {
        &self.registry
    }

    /// What computes.
    pub fn engine(&self) -> &Engine {
        &self.engine
    }

    /// What was counted.
    pub fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// The same as OpenMetrics text, gauges as they are now.
    pub fn metrics_text(&self) -> String {
        let metrics = &self.metrics;
        metrics.cache_bytes.set(i64::try_from(self.registry.cached_bytes()).unwrap_or(i64::MAX));
        metrics.cache_hulls.set(i64::try_from(self.registry.cached_hulls()).unwrap_or(i64::MAX));
        metrics.ready.set(self.readiness().welcomes().into());
        metrics.text()
    }

    /// Whether new calls are welcome.
    pub fn readiness(&self) -> Readiness {
        self.readiness.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn set_readiness(&self, readiness: Readiness) {
        *self.readiness.lock().unwrap_or_else(PoisonError::into_inner) = readiness;
    }

    /// A response that may be sent.
    fn fitting<M: prost::Message>(&self, response: M) -> Result<tonic::Response<M>, ServiceError> {
        let (bytes, limit) = (response.encoded_len(), self.limits.max_message_bytes);
        if bytes > limit {
            let message =
                format!("the answer has {bytes} bytes, the limit is {limit}: ask for less at a time");
            return Err(ServiceError::refused("RESPONSE_TOO_LARGE", message));
        }
        Ok(tonic::Response::new(response))
    }
}

/// Why a server did not start.
#[derive(Debug)]
pub enum OpenError {
    /// The limits contradict each other.
    Limits(String),
    /// The compute threads could not be started.
    Threads(String),
    /// The reflection service could not read the contract.
    Reflection(tonic_reflection::server::Error),
}

impl fmt::Display for OpenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Limits(why) => write!(f, "limits: {why}"),
            Self::Threads(why) => write!(f, "compute threads: {why}"),
            Self::Reflection(error) => write!(f, "reflection: {error}"),
        }
    }
}

impl std::error::Error for OpenError {}

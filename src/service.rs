//! The gRPC services. A request passes through wire -> handlers -> engine -> wire.
//!
//! [`wire`] checks requests and writes responses. The handlers are [`contacts`] with [`find`] and
//! [`contact_stream`], [`hulls`], and [`info`]; [`engine`] hands batches to the crate `hullcast-batch`. [`server`] runs the services on
//! [`listener`]s. Each [`connection`] passes its calls through the [`middleware`], which applies to
//! every call and asks [`security`] whether the caller may make it.

mod admin;
mod admission;
mod answer;
mod answer_body;
mod call;
mod connection;
mod contact_stream;
mod contacts;
mod context;
mod cutoff;
mod decode;
mod engine;
mod error;
mod find;
mod frames;
mod hulls;
mod info;
mod limits;
mod listener;
mod method;
mod middleware;
mod offload;
mod origin;
mod peers;
#[cfg(feature = "playground")]
mod playground;
mod protocol;
mod read_turn;
mod readiness;
mod reason;
mod recording;
mod records;
mod request_body;
mod scene;
mod security;
mod server;
mod sizes;
mod socket_file;
#[cfg(feature = "grpc-web")]
mod stall;
mod step;
mod streams;
#[cfg(feature = "testing")]
mod test_controls;
#[cfg(feature = "grpc-web")]
mod web;
#[cfg(feature = "grpc-web")]
mod web_body;
pub mod wire;

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

pub use admin::{CONNECTIONS as ADMIN_CONNECTIONS, serve_admin};
pub use engine::{EngineLimits, ServiceEngine};
pub use error::{FaultLocation, ServiceError};
pub use limits::Limits;
pub use listener::Listener;
pub use origin::Origin;
pub use readiness::Readiness;
pub use reason::{HullReason, Reason};
pub use recording::record;
pub use security::{LoadError, Security, SecurityFiles};
#[cfg(feature = "testing")]
pub use server::handlers;
pub use server::{ServerOptions, run};
pub use socket_file::SocketFile;

use thiserror::Error;

use crate::{
    budget::{Caller, Callers, MemoryBudget, Part},
    compute::Compute,
    lock::locked,
    metrics::Metrics,
    store::{BlobStore, Registry, registry::RegistryLimits},
};

/// The state that all handlers share.
#[derive(Debug)]
pub struct App {
    limits: Limits,
    registry: Registry,
    engine: ServiceEngine,
    memory: Arc<MemoryBudget>,
    callers: Arc<Callers>,
    metrics: Arc<Metrics>,
    readiness: Mutex<Readiness>,
}

impl App {
    /// The state of a server that keeps its hulls in `blobs` and computes on `threads` threads (0:
    /// one per core).
    ///
    /// # Errors
    /// The limits contradict each other, or the threads could not be started.
    pub fn new(blobs: Arc<dyn BlobStore>, limits: Limits, threads: usize) -> Result<Self, StartError> {
        if let Some(why) = limits.contradiction() {
            return Err(StartError::Limits(why));
        }
        let compute = Compute::new(threads).map_err(|error| StartError::Threads(error.to_string()))?;
        let registry_limits = RegistryLimits {
            cache_bytes: limits.cache_bytes,
            store_bytes: limits.store_bytes,
            cache_age: Duration::from_secs(limits.cache_age_seconds.into()),
            max_vertices: limits.max_vertices_per_hull as usize,
            max_blob_bytes: limits.max_blob_bytes(),
            store_limit: Duration::from_secs(limits.store_seconds.into()),
            shares: limits.shares,
        };
        let metrics = Arc::new(Metrics::default());
        metrics.memory_limit_bytes.set(i64::try_from(limits.max_memory_bytes).unwrap_or(i64::MAX));
        metrics.cache_limit_bytes.set(i64::try_from(limits.cache_bytes).unwrap_or(i64::MAX));
        let caps = [
            (Part::Arriving, limits.max_request_bytes_in_flight),
            (Part::StreamState, limits.max_stream_state_bytes),
        ];
        let memory = MemoryBudget::new(limits.max_memory_bytes, limits.shares, &caps);
        let engine_limits = EngineLimits {
            max_pairs_in_flight: limits.max_pairs_in_flight,
            shares: limits.shares,
            max_answer_bytes: limits.max_message_bytes,
        };
        let engine = ServiceEngine::new(compute.clone(), engine_limits, metrics.clone());
        let registry = Registry::new(blobs, compute, registry_limits, memory.clone(), metrics.clone());
        let readiness = Mutex::new(Readiness::Starting);
        let callers = Arc::default();
        Ok(Self { limits, registry, engine, memory, callers, metrics, readiness })
    }

    /// The limits of the server.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// The registry of hulls.
    pub fn registry(&self) -> &Registry {
        &self.registry
    }

    /// The engine that computes batches.
    pub fn engine(&self) -> &ServiceEngine {
        &self.engine
    }

    /// The budget of the memory that callers can make the server hold.
    pub fn memory(&self) -> &Arc<MemoryBudget> {
        &self.memory
    }

    /// The metrics.
    pub fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// The callers.
    pub fn callers(&self) -> &Arc<Callers> {
        &self.callers
    }

    /// The metrics as OpenMetrics text, with current gauges.
    pub fn metrics_text(&self) -> String {
        let metrics = &self.metrics;
        metrics.cache_bytes.set(i64::try_from(self.registry.cached_bytes()).unwrap_or(i64::MAX));
        metrics.cache_hulls.set(i64::try_from(self.registry.cached_hulls()).unwrap_or(i64::MAX));
        for &part in Part::ALL {
            metrics.set_memory(part.name(), self.memory.used_by(part));
        }
        let held = |caller: Caller| (caller.key().to_string(), self.memory.held(&caller));
        metrics.set_token_memory(self.callers.named().into_iter().map(held));
        metrics.callers.set(self.callers.count() as i64);
        metrics.request_bytes_in_flight.set(self.memory.used_by(Part::Arriving) as i64);
        metrics.ready.set(self.readiness().accepts_calls().into());
        metrics.text()
    }

    /// Whether the server accepts new calls.
    pub fn readiness(&self) -> Readiness {
        locked(&self.readiness).clone()
    }

    fn set_readiness(&self, readiness: Readiness) {
        *locked(&self.readiness) = readiness;
    }
}

/// The reason why a server did not start.
#[derive(Debug, Error)]
pub enum StartError {
    /// The limits contradict each other.
    #[error("limits: {0}")]
    Limits(String),
    /// The compute threads could not be started.
    #[error("compute threads: {0}")]
    Threads(String),
    /// The reflection service could not read the contract.
    #[error("reflection: {0}")]
    Reflection(tonic_reflection::server::Error),
}

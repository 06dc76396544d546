//! Certified contact manifolds of convex hulls.
//!
//! [`contact`] is the geometry: pure, synchronous, with no network in it; begin
//! there. With the feature `server` (default) `service` answers batches of queries
//! over gRPC: `proto` is the contract, `store` keeps the registered hulls,
//! `broad_phase` finds pairs, `compute` has the threads, `metrics` and `trace` say
//! what goes on, `log_limit` keeps callers from filling the log. [`workload`] generates pairs for load tests and benchmarks.
//!
//! Conventions: units are the caller's (metres in the documentation), angles
//! radians; right-handed; quaternions `x, y, z, w`. A pose maps the hull's own
//! frame to the world. The contact normal is unit, in the world frame, from A
//! to B; separations and distances are negative when overlapping.

// Here and not in Cargo.toml: modules shared by tests are `pub` for nobody's sake.
#![warn(unreachable_pub)]

#[cfg(feature = "server")]
pub mod broad_phase;
#[cfg(feature = "server")]
pub mod budget;
#[cfg(feature = "server")]
pub mod compute;
pub mod contact;
#[cfg(feature = "server")]
mod lock;
#[cfg(feature = "server")]
pub mod log_limit;
#[cfg(feature = "server")]
pub mod metrics;
#[cfg(feature = "server")]
pub mod proto;
#[cfg(feature = "server")]
pub mod service;
#[cfg(feature = "server")]
pub mod store;
#[cfg(feature = "server")]
pub mod trace;
pub mod workload;

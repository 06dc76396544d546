//! Certified contact manifolds of convex hulls.
//!
//! Begin with [`contact`], the geometry: it is pure and synchronous, and uses no network. These
//! modules need the feature `server`, which is on by default:
//!
//! - `service` answers batches of queries over gRPC, by the contract in `proto`.
//! - `store` keeps the registered hulls.
//! - `broad_phase` finds pairs.
//! - `compute` runs the compute threads; `budget` limits the memory that callers make the server hold.
//! - `small_file` reads settings, tokens and certificates.
//! - `metrics` and `trace` report the server's activity; `log_limit` keeps callers from filling the log.
//!
//! [`workload`], which needs no feature, generates pairs for load tests and benchmarks.
//!
//! Conventions: lengths are in the caller's units (metres in the documentation), angles in radians.
//! Frames are right-handed, and quaternions are `x, y, z, w`. A pose maps the hull's own frame to the
//! world. The contact normal is a unit vector in the world frame that points from A to B. Separations
//! and distances are negative for overlapping hulls.

// This lint is not in Cargo.toml, because it would then apply to the tests too, whose shared modules
// have `pub` items that are not exported.
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
pub mod small_file;
#[cfg(feature = "server")]
pub mod store;
#[cfg(feature = "server")]
pub mod trace;
pub mod workload;

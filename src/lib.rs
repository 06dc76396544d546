//! Certified contact manifolds of convex hulls, as a service over gRPC.
//!
//! Begin with [`contact`], the geometry: the crate [`hullcast_contact`], which is pure and
//! synchronous and uses no network. The modules of this crate are the server around it:
//!
//! - `service` answers batches of queries over gRPC, by the contract in `proto`.
//! - `store` keeps the registered hulls.
//! - [`batch`] computes many pairs, and finds pairs: the crate [`hullcast_batch`], which knows no network.
//! - `compute` names the jobs of the service's callers; `budget` limits the memory that callers make the server hold.
//! - `small_file` reads settings, tokens and certificates; `size` prints sizes.
//! - `record` writes and reads records of calls.
//! - `metrics` and `trace` report the server's activity; `log_limit` keeps callers from filling the log.
//!
//! [`workload`] generates pairs for load tests and benchmarks.
//!
//! Conventions: lengths are in the caller's units (metres in the documentation), angles in radians.
//! Frames are right-handed, and quaternions are `x, y, z, w`. A pose maps the hull's own frame to the
//! world. The contact normal is a unit vector in the world frame that points from A to B. Separations
//! and distances are negative for overlapping hulls.

// This lint is not in Cargo.toml, because it would then apply to the tests too, whose shared modules
// have `pub` items that are not exported.
#![warn(unreachable_pub)]

pub mod budget;
pub mod compute;
pub mod log_limit;
pub mod metrics;
pub mod record;
pub mod service;
pub mod size;
pub mod small_file;
pub mod store;
pub mod trace;

pub use hullcast_batch as batch;
use hullcast_batch::lock;
pub use hullcast_contact as contact;
pub use hullcast_contact::workload;
pub use hullcast_proto as proto;

//! The durable registry of hulls, and the bounded cache before it.
//!
//! [`identity`] names a hull. [`blobs`] is the interface to the stores of bytes: `directory` (on
//! `file_threads`) and `objects`. `scheduled` lets callers use it in `turns` and notices when it
//! hangs. [`registry`] answers for hulls, with a `reader` for each request; `cache` has hulls in
//! memory, and `lease` says how much of it requests may use. Nothing here knows the wire.

pub mod blobs;
mod building;
mod cache;
mod directory;
mod file_threads;
pub mod identity;
mod lease;
mod objects;
mod quota;
mod reader;
pub mod registry;
#[cfg(feature = "remote")]
mod remote;
mod scheduled;
mod turns;

pub use blobs::{BlobStore, Opened, StoreError, StoredBlob};
pub use identity::{HullDefinition, HullId};
pub use lease::{Hulls, Lease, LeaseError};
pub use reader::Reader;
pub use registry::{AT_A_TIME, Missing, RegisterError, Registered, Registry};

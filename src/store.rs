//! The durable registry of hulls, with a bounded cache in front.
//!
//! [`identity`] names a hull. [`BlobStore`] is the interface to a store of bytes, implemented by
//! `directory` (on `file_threads`) and `objects`; [`blobs`] opens a store. `scheduled` lets callers use a store by turns (`fair_slots`)
//! and notices when it hangs. [`registry`] answers requests for hulls, with a `reader` per request.
//! `cache` keeps hulls in memory, and `lease` limits how much of the cache requests may use.
//! Nothing here depends on the wire format.

mod blob_store;
pub mod blobs;
mod building;
mod cache;
mod directory;
mod fair_slots;
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

pub use blob_store::{BlobStore, SharedBlobStore, StoreError, StoredBlob};
pub(crate) use building::building_bytes;
pub use identity::{HullDefinition, HullId};
pub use lease::{Lease, LeaseError};
pub use reader::Reader;
pub use registry::{AT_A_TIME, RegisterError, Registered, Registry};

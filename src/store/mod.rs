//! The durable registry of hulls, and the bounded cache before it.
//!
//! [`identity`] is what a hull is called, [`blobs`] keeps its bytes,
//! [`registry`] answers for it. Nothing here knows the wire.

pub mod blobs;
mod cache;
pub mod identity;
mod quota;
pub mod registry;
#[cfg(feature = "remote")]
mod remote;

pub use blobs::{BlobStore, Opened, StoreError, StoredBlob};
pub use cache::{Hold, Hulls, NoRoom};
pub use identity::{HullDefinition, HullId};
pub use registry::{AT_A_TIME, Missing, RegisterError, Registered, Registry};

//! The computation of many pairs, without a network and without protobuf.
//!
//! - [`broad_phase`] finds the pairs of a scene that may meet.
//! - [`compute`] runs the compute threads.
//! - [`outputs`] lists the parts of an answer that are computed.
//! - [`lock`] locks values whose holders may panic, and [`ById`] is a table whose keys this process chose.

#![warn(unreachable_pub)]

pub mod broad_phase;
mod by_id;
pub mod compute;
pub mod lock;
pub mod outputs;

pub use by_id::{ById, IdHasher};

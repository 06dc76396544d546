//! The computation of many pairs, without a network and without protobuf.
//!
//! - [`broad_phase`] finds the pairs of a scene that may meet.
//! - [`compute`] runs the compute threads.
//! - [`outputs`] lists the parts of an answer that are computed.
//! - [`scene_file`] reads scene files, and [`counted`] writes counts into messages.
//! - [`lock`] locks values whose holders may panic, and [`ById`] is a table whose keys this process chose.

#![warn(unreachable_pub)]

pub mod broad_phase;
mod by_id;
pub mod compute;
mod counted;
pub mod lock;
pub mod outputs;
pub mod scene_file;

pub use by_id::{ById, IdHasher};
pub use counted::counted;

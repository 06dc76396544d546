//! The computation of many pairs, without a network and without protobuf.
//!
//! - [`broad_phase`] finds the pairs of a scene that may meet.
//! - [`compute`] runs the compute threads.
//! - [`outputs`] lists the parts of an answer that are computed.
//! - [`lock`] locks values whose holders may panic.

#![warn(unreachable_pub)]

pub mod broad_phase;
pub mod compute;
pub mod lock;
pub mod outputs;

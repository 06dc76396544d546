//! Benchmarks of hullcast and parry3d, in one process and one thread.

pub mod cells;
pub mod ours;
pub mod parry;
pub mod questions;
pub mod report;
pub mod rounds;
#[cfg(feature = "service")]
pub mod service;

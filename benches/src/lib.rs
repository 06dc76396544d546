//! Benchmarks of hullcast and parry3d, in one process and one thread.

pub mod cells;
pub mod ours;
pub mod parry;
#[path = "../../crates/lab/src/tradeoff/peer_files.rs"]
pub mod peer_files;
pub mod report;
pub mod rounds;
#[cfg(feature = "service")]
pub mod service;

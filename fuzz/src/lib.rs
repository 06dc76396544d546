//! Makes hulls, poses and queries from a fuzzer's bytes.

mod bytes;
mod poses;
mod scene;
#[cfg(feature = "service")]
pub mod seeds;
mod shape;

pub use scene::{Cloud, PairScene, Question, UNLIMITED};

//! Makes hulls, poses and queries from a fuzzer's bytes.

mod bytes;
mod place;
mod scene;
#[cfg(feature = "service")]
pub mod seeds;
mod shape;

pub use scene::{Cloud, Question, Scene, UNLIMITED};

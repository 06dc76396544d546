//! Hulls, places and questions from a fuzzer's bytes.

mod bytes;
mod place;
mod scene;
#[cfg(feature = "service")]
pub mod seeds;
mod shape;

pub use scene::{Cloud, Question, Scene, UNLIMITED};

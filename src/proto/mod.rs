//! The wire contract, generated from `proto/hullcast/v1`.

#![allow(missing_docs, unreachable_pub, clippy::all)]

mod codec;

pub use codec::Codec;

tonic::include_proto!("hullcast.v1");

/// The contract's descriptor set, for reflection and for breaking-change checks.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/hullcast.v1.binpb"));

//! The format of a file of records.
//!
//! A file begins with [`MAGIC`]. Entries follow. Each has a head of 16 bytes (the length of the compressed entry, the
//! length of the entry, both as u32, and a check, as u64, little-endian), and then one zstd frame. The check is the first
//! 8 bytes of the SHA-256 of both lengths and the frame, so a change of any byte of head or frame is noticed before
//! anything is decompressed. The frame holds one protobuf message, [`Entry`].
//!
//! The first entry is a [`Header`]. The hulls of a call come before the call, once per file.

use bytes::Bytes;
use prost::Message;
use sha2::{Digest, Sha256};

/// The first bytes of a file: the name and the version of the format.
pub(super) const MAGIC: &[u8; 8] = b"hullrec1";

/// The bytes of the head of an entry.
pub(super) const HEAD_BYTES: usize = 16;

/// The most bytes of an entry, compressed or not. A reader takes at most twice this memory.
pub const MAX_ENTRY_BYTES: usize = 64 << 20;

/// The bytes of a digest.
pub const DIGEST_BYTES: usize = 32;

/// zstd's fastest ordinary level.
const LEVEL: i32 = 1;

/// One entry of a file.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Entry {
    #[prost(oneof = "Content", tags = "1, 2, 3")]
    pub(super) content: Option<Content>,
}

/// The content of an entry.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum Content {
    /// The server that wrote the file.
    #[prost(message, tag = "1")]
    Header(Header),
    /// The identity bytes of a hull (docs/identity.md), whose SHA-256 is the hull's id.
    #[prost(bytes = "bytes", tag = "2")]
    Hull(Bytes),
    /// A call.
    #[prost(message, tag = "3")]
    Call(Call),
}

/// The server that wrote a file.
#[derive(Clone, PartialEq, Message)]
pub struct Header {
    /// The version of the server.
    #[prost(string, tag = "1")]
    pub version: String,
    /// The instruction set that it used: "avx512", "avx2" or "scalar".
    #[prost(string, tag = "2")]
    pub instruction_set: String,
    /// The number of its contract (`CONTRACT` of the package `hullcast-proto`).
    #[prost(uint32, tag = "3")]
    pub contract: u32,
}

/// One call.
#[derive(Clone, PartialEq, Message)]
pub struct Call {
    /// The method: its path without the leading slash.
    #[prost(string, tag = "1")]
    pub method: String,
    /// The time at which the call began, in nanoseconds since 1970 (UTC).
    #[prost(uint64, tag = "2")]
    pub started_unix_ns: u64,
    /// The time that the call took, in nanoseconds.
    #[prost(uint64, tag = "3")]
    pub took_ns: u64,
    /// The gRPC code with which the call ended.
    #[prost(uint32, tag = "4")]
    pub code: u32,
    /// The messages of the request, each after gRPC's five bytes: a flag, and the length as big-endian u32.
    #[prost(bytes = "bytes", tag = "5")]
    pub request: Bytes,
    /// The SHA-256 of each message of the answer, in order, one after the other.
    #[prost(bytes = "bytes", tag = "6")]
    pub digests: Bytes,
    /// Whether the record ends before the call did, because the request of a stream became too long.
    #[prost(bool, tag = "7")]
    pub cut: bool,
    /// The number of the request's hulls that the server did not have when it wrote the record.
    #[prost(uint32, tag = "8")]
    pub missing_hulls: u32,
    /// The reason why the call was recorded: its index in [`REASONS`](super::REASONS).
    #[prost(uint32, tag = "9")]
    pub reason: u32,
}

impl Call {
    /// The messages of the request.
    ///
    /// # Errors
    /// The request does not consist of whole messages.
    pub fn messages(&self) -> Result<Vec<Bytes>, &'static str> {
        let mut rest = self.request.clone();
        let mut messages = Vec::new();
        while !rest.is_empty() {
            let Some(&[0, ref length @ ..]) = rest.first_chunk::<5>() else {
                return Err("the request has a message without a plain head of five bytes");
            };
            let length = u32::from_be_bytes(*length) as usize;
            if rest.len() - 5 < length {
                return Err("the last message of the request is cut off");
            }
            let mut message = rest.split_to(5 + length);
            messages.push(message.split_off(5));
        }
        Ok(messages)
    }
}

/// The SHA-256 of a message.
pub fn digest(message: &[u8]) -> [u8; DIGEST_BYTES] {
    Sha256::digest(message).into()
}

/// The check of an entry.
pub(super) fn check(lengths: [u8; 8], frame: &[u8]) -> [u8; 8] {
    let digest = Sha256::new().chain_update(lengths).chain_update(frame).finalize();
    let mut check = [0; 8];
    check.copy_from_slice(&digest[..8]);
    check
}

/// Appends an entry to `out`. Returns false, and appends nothing, if it is longer than [`MAX_ENTRY_BYTES`].
pub(super) fn append(content: Content, out: &mut Vec<u8>) -> bool {
    let plain = Entry { content: Some(content) }.encode_to_vec();
    let Ok(frame) = compressed(&plain) else { return false };
    if plain.len().max(frame.len()) > MAX_ENTRY_BYTES {
        return false;
    }
    let mut lengths = [0; 8];
    lengths[..4].copy_from_slice(&(frame.len() as u32).to_le_bytes());
    lengths[4..].copy_from_slice(&(plain.len() as u32).to_le_bytes());
    out.extend_from_slice(&lengths);
    out.extend_from_slice(&check(lengths, &frame));
    out.extend_from_slice(&frame);
    true
}

/// One zstd frame, with zstd's own checksum.
fn compressed(plain: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut compressor = zstd::bulk::Compressor::new(LEVEL)?;
    compressor.include_checksum(true)?;
    compressor.compress(plain)
}

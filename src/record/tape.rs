//! The record of a call while the call is under way.

use std::{
    sync::Arc,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use bytes::Bytes;
use sha2::{Digest, Sha256};

use super::{
    format::Call,
    writer::{Recorder, Room},
};

/// The most bytes of a request in a record. A longer stream is recorded up to here; another call is not recorded.
pub const MAX_REQUEST_BYTES: usize = 16 << 20;

/// The bytes of gRPC before each message.
const HEAD_BYTES: usize = 5;

/// The memory of a tape besides its request and digests.
const TAPE_BYTES: u64 = 1 << 10;

/// The memory by which a tape grows at least, so that small pieces seldom ask for room.
const GROWTH_BYTES: u64 = 4 << 10;

/// The record of a call under way.
#[derive(Debug)]
pub struct Tape {
    recorder: Arc<Recorder>,
    method: &'static str,
    is_stream: bool,
    /// Whether the call is recorded whatever happens to it.
    is_chosen: bool,
    started: Instant,
    started_unix: Duration,
    /// `None` once the record is complete or given up.
    open: Option<OpenTape>,
}

/// The parts of a tape that grow.
#[derive(Debug)]
struct OpenTape {
    room: Room,
    request: Vec<u8>,
    /// The length of the whole messages at the front of `request`.
    whole: usize,
    answer: AnswerDigests,
}

/// Digests the messages of an answer, in pieces of any size.
#[derive(Debug, Default)]
struct AnswerDigests {
    digests: Vec<u8>,
    head: [u8; HEAD_BYTES],
    head_bytes: usize,
    missing: usize,
    message: Sha256,
}

impl Tape {
    /// A tape for a call that begins now, or `None` if there is no room.
    pub(super) fn begin(
        recorder: Arc<Recorder>,
        method: &'static str,
        is_stream: bool,
        is_chosen: bool,
    ) -> Option<Self> {
        let room = recorder.room(TAPE_BYTES)?;
        let (request, answer) = (Vec::new(), AnswerDigests::default());
        Some(Self {
            recorder,
            method,
            is_stream,
            is_chosen,
            started: Instant::now(),
            started_unix: SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default(),
            open: Some(OpenTape { room, request, whole: 0, answer }),
        })
    }

    /// Adds bytes of the request.
    pub fn request(&mut self, bytes: &[u8]) {
        let Some(open) = &mut self.open else { return };
        if open.request.len() + bytes.len() > MAX_REQUEST_BYTES {
            if self.is_stream && self.is_chosen && open.whole > 0 {
                self.submit(0, 1, true);
            } else {
                self.recorder.count_too_large();
                self.open = None;
            }
            return;
        }
        if !open.fits(bytes.len()) {
            self.recorder.count_dropped();
            self.open = None;
            return;
        }
        open.request.extend_from_slice(bytes);
        while let Some(&[_, ref length @ ..]) =
            open.request.get(open.whole..).and_then(<[u8]>::first_chunk::<HEAD_BYTES>)
        {
            let end = open.whole + HEAD_BYTES + u32::from_be_bytes(*length) as usize;
            if end > open.request.len() {
                break;
            }
            open.whole = end;
        }
    }

    /// Adds bytes of the answer.
    pub fn answer(&mut self, bytes: &[u8]) {
        let Some(open) = &mut self.open else { return };
        open.answer.add(bytes);
        if !open.fits(0) {
            self.recorder.count_dropped();
            self.open = None;
        }
    }

    /// Ends the tape with the call, whose gRPC code is `code`. `is_flagged` tells whether it has a pair that is not
    /// certified.
    pub fn end(mut self, code: u32, is_flagged: bool) {
        let options = self.recorder.options();
        let reason = if self.is_chosen {
            1
        } else if options.failed && code != 0 && code != CANCELLED {
            2
        } else if options.flagged && is_flagged {
            3
        } else if !self.is_stream && options.slow.is_some_and(|slow| self.started.elapsed() >= slow) {
            4
        } else {
            return;
        };
        self.submit(code, reason, false);
    }

    fn submit(&mut self, code: u32, reason: u32, cut: bool) {
        let Some(mut open) = self.open.take() else { return };
        open.request.truncate(open.whole);
        let call = Call {
            method: self.method.into(),
            started_unix_ns: self.started_unix.as_nanos() as u64,
            took_ns: self.started.elapsed().as_nanos() as u64,
            code,
            request: Bytes::from(open.request),
            digests: Bytes::from(open.answer.digests),
            cut,
            missing_hulls: 0,
            reason,
        };
        self.recorder.submit(call, open.room);
    }
}

/// gRPC's code of a call that its caller gave up.
const CANCELLED: u32 = 1;

impl OpenTape {
    /// Takes room for `more` bytes of the request or of digests, if it is not there yet.
    fn fits(&mut self, more: usize) -> bool {
        // A vector that grows may have twice the memory of its content.
        let needed = TAPE_BYTES + 2 * (self.request.len() + self.answer.digests.len() + more) as u64;
        let missing = needed.saturating_sub(self.room.bytes());
        missing == 0 || self.room.grow(missing.max(GROWTH_BYTES))
    }
}

impl AnswerDigests {
    fn add(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            if self.head_bytes < HEAD_BYTES {
                let (head, rest) = bytes.split_at(bytes.len().min(HEAD_BYTES - self.head_bytes));
                self.head[self.head_bytes..self.head_bytes + head.len()].copy_from_slice(head);
                self.head_bytes += head.len();
                bytes = rest;
                if self.head_bytes < HEAD_BYTES {
                    return;
                }
                let [_, length @ ..] = self.head;
                self.missing = u32::from_be_bytes(length) as usize;
            }
            let (part, rest) = bytes.split_at(bytes.len().min(self.missing));
            self.message.update(part);
            self.missing -= part.len();
            bytes = rest;
            if self.missing == 0 {
                self.digests.extend_from_slice(&self.message.finalize_reset());
                self.head_bytes = 0;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::digest;

    /// Catches digests that depend on the pieces in which an answer leaves, and an empty message without a digest.
    #[test]
    fn digests_are_of_messages_however_they_are_cut() {
        let messages: [&[u8]; 4] = [b"one", b"", b"three", &[7; 300]];
        let framed = |message: &&[u8]| [&[0][..], &(message.len() as u32).to_be_bytes(), message].concat();
        let bytes: Vec<u8> = messages.iter().flat_map(framed).collect();
        let expected: Vec<u8> = messages.iter().flat_map(|message| digest(message)).collect();
        for piece in 1..=bytes.len() {
            let mut answer = AnswerDigests::default();
            bytes.chunks(piece).for_each(|part| answer.add(part));
            assert_eq!(answer.digests, expected, "pieces of {piece}");
        }
    }
}

//! Charges a connection for the bytes that pin memory without being counted by HTTP/2's windows.
//!
//! h2 reads into buffers of some kilobytes, and hands on the payload of a DATA frame as a part of its buffer.
//! The whole buffer therefore stays in memory until that payload is used. The windows count the payload only.
//! A peer can fill the rest of each buffer with frames that no window counts: frames of an unknown type,
//! PING, SETTINGS, or long headers. While a payload waits behind an answer that nobody reads, a window of
//! 8 MiB could pin thirty times its size in that way.
//!
//! All buffers that a connection pins have at most as many bytes as the peer has sent. The bytes of DATA are
//! within the window, whose memory the connection has taken. [`FrameTracker`] counts the other bytes as
//! *overhead* by looking at the frames' heads. [`Overhead`] takes memory for the overhead from the budget, and
//! keeps this memory for as long as a payload can wait. If the budget has no room, the connection is closed.
//! Short headers are free: they begin calls, which take memory of their own.
//!
//! ```text
//! length (3 bytes) | type | flags | stream (4 bytes) | payload: DATA free; HEADERS free up to 1 KiB; rest counted
//! ```
//!
//! [`FrameTracker`] also refuses headers that cost h2 more time than they are worth: a frame of headers several
//! times as long as the longest list of headers, and more than two changes of the size of HPACK's table at the
//! beginning of a block. No peer needs more than two (RFC 7541, section 4.2). And it refuses many SETTINGS and
//! GOAWAY frames, because h2 visits all streams of the connection for each of them. RFC 9113, sections 4.1 and
//! 6, defines the format of the frames.

use std::{collections::VecDeque, io, time::Duration};

use tokio::time::Instant;

use super::{peers::Peer, sizes::HEADER_BYTES};
use crate::budget::Permit;

const PREFACE_BYTES: usize = 24;
const HEAD_BYTES: usize = 9;

const DATA: u8 = 0;
const HEADERS: u8 = 1;
const SETTINGS: u8 = 4;
const GOAWAY: u8 = 7;
const CONTINUATION: u8 = 9;
const ACK: u8 = 0x1;
const PADDED: u8 = 0x8;
const PRIORITY: u8 = 0x20;

/// The most bytes of a frame's padding, with the byte that has its length.
const PADDING_BYTES: usize = 256;
/// The bytes of a priority in a frame.
const PRIORITY_BYTES: usize = 5;

/// The most bytes of a frame of headers. A call whose headers are longer than [`HEADER_BYTES`] is refused by
/// itself; only headers that are far longer cost the connection.
const MOST_HEADER_BYTES: usize = 4 * HEADER_BYTES as usize;

/// The headers of a call up to this size count as part of the call.
const FREE_HEADER_BYTES: usize = 1 << 10;

/// The most changes of the size of HPACK's table at the beginning of a block of headers.
const MOST_RESIZES: u32 = 2;

/// The SETTINGS and GOAWAY frames that a peer may send at once, and per second after that. Clients send one
/// SETTINGS frame at the beginning; some send another each time that they estimate the network anew.
const SWEEPS_AT_ONCE: f64 = 64.0;
const SWEEPS_PER_SECOND: f64 = 8.0;

/// Memory is taken in steps of this size.
const STEP_BYTES: u64 = 64 << 10;

/// Follows the frames that a peer sends.
#[derive(Debug, Default)]
pub(super) struct FrameTracker {
    /// The number of bytes of the preface that have arrived.
    preface: usize,
    /// The current frame's head, and the number of its bytes that have arrived.
    head: [u8; HEAD_BYTES],
    head_bytes: usize,
    /// The number of bytes of the current frame's payload that have not arrived yet.
    rest: usize,
    block: Option<BlockBegin>,
    /// The number of bytes that no window counts, since the connection began.
    overhead: u64,
    /// The number of frames, since the connection began.
    count: u64,
    /// The number of frames of headers, since the connection began.
    header_frames: u64,
    /// The number of frames for which h2 visits all streams, and the time of the first of them.
    sweeps: f64,
    first_sweep: Option<Instant>,
}

/// The beginning of a block of headers, which may contain changes of the table's size.
#[derive(Debug)]
struct BlockBegin {
    /// The number of bytes before the block that have not arrived yet.
    skipped: usize,
    /// Whether the new size, which may take several bytes, continues in the next byte.
    is_number: bool,
    resizes: u32,
}

impl FrameTracker {
    /// Looks at the next bytes of the connection.
    ///
    /// # Errors
    /// The peer sends headers, or a number of SETTINGS or GOAWAY frames, that no client needs.
    pub(super) fn read(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            let used = if self.preface < PREFACE_BYTES {
                let used = bytes.len().min(PREFACE_BYTES - self.preface);
                self.preface += used;
                used
            } else if self.rest > 0 {
                let used = bytes.len().min(self.rest);
                self.rest -= used;
                self.count_resizes(&bytes[..used])?;
                used
            } else {
                let used = bytes.len().min(HEAD_BYTES - self.head_bytes);
                self.head[self.head_bytes..][..used].copy_from_slice(&bytes[..used]);
                self.head_bytes += used;
                if self.head_bytes == HEAD_BYTES {
                    self.begin()?;
                }
                used
            };
            bytes = &bytes[used..];
        }
        Ok(())
    }

    /// The number of frames of headers that have begun. At most as many streams have begun: each of these
    /// frames begins a stream or ends one.
    pub(super) fn header_frames(&self) -> u64 {
        self.header_frames
    }

    /// The number of frames that have begun.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// Begins the frame whose head has arrived.
    fn begin(&mut self) -> io::Result<()> {
        self.head_bytes = 0;
        self.count += 1;
        let [a, b, c, kind, flags, ..] = self.head;
        let length = u32::from_be_bytes([0, a, b, c]) as usize;
        (self.rest, self.block) = (length, None);
        let padding = if flags & PADDED != 0 { PADDING_BYTES.min(length) } else { 0 };
        let counted = match kind {
            DATA => padding,
            HEADERS | CONTINUATION => {
                if length > MOST_HEADER_BYTES {
                    let why = format!(
                        "a frame of headers has {length} bytes, at most {MOST_HEADER_BYTES} are allowed"
                    );
                    return Err(refused(why));
                }
                if kind == HEADERS {
                    self.header_frames += 1;
                    let padded = usize::from(flags & PADDED != 0);
                    let priority = if flags & PRIORITY != 0 { PRIORITY_BYTES } else { 0 };
                    let skipped = padded + priority;
                    self.block = Some(BlockBegin { skipped, is_number: false, resizes: 0 });
                }
                length.saturating_sub(FREE_HEADER_BYTES)
            }
            _ => {
                if kind == GOAWAY || (kind == SETTINGS && flags & ACK == 0) {
                    self.count_sweep()?;
                }
                HEAD_BYTES + length
            }
        };
        self.overhead += counted as u64;
        Ok(())
    }

    /// Counts a frame for which h2 visits all streams.
    fn count_sweep(&mut self) -> io::Result<()> {
        self.sweeps += 1.0;
        let age = self.first_sweep.get_or_insert_with(Instant::now).elapsed().as_secs_f64();
        if self.sweeps > SWEEPS_AT_ONCE + SWEEPS_PER_SECOND * age {
            return Err(refused(format!("more than {SWEEPS_AT_ONCE} SETTINGS or GOAWAY frames")));
        }
        Ok(())
    }

    /// Counts the changes of the table's size in the next bytes of the current frame's payload.
    fn count_resizes(&mut self, bytes: &[u8]) -> io::Result<()> {
        let Some(block) = &mut self.block else { return Ok(()) };
        for &byte in bytes {
            if block.skipped > 0 {
                block.skipped -= 1;
            } else if block.is_number {
                block.is_number = byte & 0x80 != 0;
            } else if byte & 0xe0 == 0x20 {
                block.resizes += 1;
                if block.resizes > MOST_RESIZES {
                    return Err(refused(format!(
                        "headers change the size of HPACK's table more than {MOST_RESIZES} times"
                    )));
                }
                block.is_number = byte & 0x1f == 0x1f;
            } else {
                self.block = None;
                break;
            }
        }
        Ok(())
    }
}

fn refused(why: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, why)
}

/// The memory that a connection holds for its overhead.
#[derive(Debug)]
pub(super) struct Overhead {
    peer: Peer,
    /// The time for which a payload can wait.
    wait: Duration,
    /// The overhead for which memory has been taken so far.
    taken: u64,
    /// The memory taken, with the times at which it was taken.
    held: VecDeque<(Instant, Permit)>,
}

impl Overhead {
    pub(super) fn new(peer: Peer, wait: Duration) -> Self {
        Self { peer, wait, taken: 0, held: VecDeque::new() }
    }

    /// Takes memory for the overhead of `frames`.
    ///
    /// # Errors
    /// The budget has no room for it.
    pub(super) fn charge(&mut self, frames: &FrameTracker) -> io::Result<()> {
        while frames.overhead - self.taken >= STEP_BYTES {
            let now = Instant::now();
            while self.held.front().is_some_and(|(taken, _)| now.duration_since(*taken) > self.wait) {
                self.held.pop_front();
            }
            let memory = self.peer.take(STEP_BYTES).ok_or_else(|| {
                refused("the memory budget has no room for frames that carry no message".into())
            })?;
            self.held.push_back((now, memory));
            self.taken += STEP_BYTES;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(kind: u8, flags: u8, payload: &[u8]) -> Vec<u8> {
        let mut frame = (payload.len() as u32).to_be_bytes()[1..].to_vec();
        frame.extend([kind, flags, 0, 0, 0, 1]);
        frame.extend(payload);
        frame
    }

    fn connection(frames: &[Vec<u8>]) -> Vec<u8> {
        [vec![b'P'; PREFACE_BYTES], frames.concat()].concat()
    }

    /// Catches a frame whose bytes are counted twice, not at all, or differently when they arrive in pieces,
    /// and padding that no window counts.
    #[test]
    fn bytes_that_no_window_counts_are_overhead() {
        let bytes = connection(&[
            frame(HEADERS, 4, &[0x82; 1000]),
            frame(DATA, 0, &[1; 5000]),
            frame(DATA, PADDED, &[200; 300]),
            frame(DATA, 0, &[]),
            frame(0xfa, 0, &[7; 8300]),
            frame(HEADERS, 4, &[0x82; 2000]),
            frame(6, 0, b"pingpong"),
        ]);
        let expected = 256 + (9 + 8300) + (2000 - 1024) + (9 + 8);
        for piece in [1, 2, 7, 9, 4096, bytes.len()] {
            let mut frames = FrameTracker::default();
            bytes.chunks(piece).for_each(|piece| frames.read(piece).expect("ordinary frames"));
            assert_eq!((frames.overhead, frames.rest, frames.head_bytes), (expected, 0, 0), "{piece}");
        }
    }

    /// Catches headers whose decoding costs far more than their call, and ordinary clients' headers that are
    /// mistaken for such: those may change the table's size twice, and may be padded and have a priority.
    #[test]
    fn headers_that_no_client_needs_are_refused() {
        let read = |frames: &[Vec<u8>]| {
            let mut state = FrameTracker::default();
            connection(frames).chunks(5).try_for_each(|piece| state.read(piece))
        };
        let resize = [0x3f, 0xe1, 0x1f];
        let (twice, thrice) = (resize.repeat(2), resize.repeat(3));
        let after = |begin: &[u8], block: &[u8]| [begin, block, &[0x82, 0x20, 0x20, 0x20]].concat();
        assert!(read(&[frame(HEADERS, 4, &vec![0x82; MOST_HEADER_BYTES])]).is_ok());
        assert!(read(&[frame(HEADERS, 4, &after(&[], &twice)), frame(HEADERS, 4, &twice)]).is_ok());
        assert!(read(&[frame(HEADERS, 0x2c, &after(&[0x20; 6], &twice))]).is_ok());
        for block in [vec![0x82; MOST_HEADER_BYTES + 1], thrice, vec![0x20; 3]] {
            assert!(read(&[frame(HEADERS, 4, &block)]).is_err(), "{} bytes", block.len());
        }
        assert!(read(&[frame(HEADERS, 0x24, &[&[0; 5][..], &[0x20; 3]].concat())]).is_err());
        assert!(
            read(&[frame(HEADERS, 0, &[0x82]), frame(CONTINUATION, 4, &vec![0; MOST_HEADER_BYTES + 1])])
                .is_err()
        );
    }

    /// Catches SETTINGS and GOAWAY frames without end: with 1,000 open streams, two connections that sent them
    /// kept both threads busy for seconds. Acknowledgements, and settings that change now and then, are free.
    #[tokio::test(start_paused = true)]
    async fn frames_that_visit_all_streams_are_few() {
        for (kind, flags, is_counted) in [(SETTINGS, 0, true), (GOAWAY, 0, true), (SETTINGS, ACK, false)] {
            let mut frames = FrameTracker::default();
            frames.read(&connection(&[])).unwrap();
            let one = frame(kind, flags, &[0; 8]);
            let taken = (0..10_000).take_while(|_| frames.read(&one).is_ok()).count();
            assert_eq!(taken, if is_counted { 64 } else { 10_000 }, "{kind}");
        }
        let mut frames = FrameTracker::default();
        frames.read(&connection(&[])).unwrap();
        for _ in 0..1000 {
            frames.read(&frame(SETTINGS, 0, &[0; 6])).expect("one per second");
            tokio::time::advance(Duration::from_secs(1)).await;
        }
    }
}

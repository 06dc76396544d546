//! Records of calls, from which anyone can compute the calls again, to the bit.
//!
//! A record has the request of one call as it arrived, and the SHA-256 of each message of its answer. The file that it
//! is in also has every hull that the request names, as the bytes whose hash is the hull's id, and the version and
//! instruction set of the server. So a file needs nothing else: `hullcast replay` registers its hulls with a server that
//! has none, sends the requests again, and compares the digests. A record has no header of the call, so it has no token,
//! no address and no id of the caller.
//!
//! While a call is under way, its [`Tape`] copies the request as it arrives and digests the answer as it leaves. When the
//! call ends, the tape is queued for the one thread that writes ([`writer`]). Tapes and the queue share [`QUEUE_BYTES`];
//! a call for which there is no room is not recorded, and is counted. So a slow or full disk costs records and never
//! delays a call.
//!
//! A [file](format) is a sequence of entries, each compressed by itself and with its own checksum. Each group of entries
//! is one write at the end of the file, so a process that is killed loses at most the group that it was writing. The
//! [reader] trusts nothing: it checks lengths against fixed limits before it takes memory for them.

mod format;
mod reader;
mod tape;
mod writer;

pub use format::{Call, Content, DIGEST_BYTES, Header, MAX_ENTRY_BYTES, digest};
pub use reader::{Damage, Entries, files};
pub use tape::{MAX_REQUEST_BYTES, Tape};
pub use writer::{QUEUE_BYTES, Recorder};

use std::{path::PathBuf, time::Duration};

/// The calls that a server records, and where.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordOptions {
    /// The directory of the files. It is created if it is missing.
    pub directory: PathBuf,
    /// The most bytes of the directory's files. The oldest files make room for new ones.
    pub max_bytes: u64,
    /// The share of the calls that are recorded whatever happens to them, 0 to 1. They are spread evenly.
    pub share: f64,
    /// Calls that take at least this long are recorded too; `None` means that the time does not matter. Streams last as
    /// long as their callers want, so they are never slow.
    pub slow: Option<Duration>,
    /// Whether calls that end with an error are recorded too. A call that its caller cancels has not failed.
    pub failed: bool,
    /// Whether calls with a pair that is not certified (flag ESTIMATED or GAP_OPEN) are recorded too.
    pub flagged: bool,
}

/// The reason why a call was recorded, by its number in the file.
pub const REASONS: [&str; 5] = ["", "share", "failed", "flagged", "slow"];

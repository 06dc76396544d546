//! The memory that the server takes for each connection, call, hull and page.
//!
//! These sizes are in a file of their own, because [`limits`](super::limits) computes from them the least
//! memory budget, and the modules that take the memory depend on the limits.

/// The most bytes of one call's headers, several times the size of a token and a trace context.
pub(super) const HEADER_BYTES: u32 = 16 << 10;

/// The memory of a header besides its text: its places in the table of headers. 180 bytes were measured.
pub(super) const HEADER_RECORD_BYTES: usize = 192;

/// The most memory of one call's headers. HTTP/2 counts a header as its text and 32 bytes (RFC 9113, section
/// 6.5.2), so [`HEADER_BYTES`] bound the number of headers too.
pub(super) const MOST_HEADER_MEMORY: u64 =
    HEADER_BYTES as u64 + HEADER_BYTES as u64 / 32 * HEADER_RECORD_BYTES as u64;

/// The memory of an open connection besides its window: the state of HTTP/2, read and write
/// buffers, the buffers of TLS, and the health checks that are answered without asking the budget.
pub(super) const CONNECTION_BYTES: u64 = 128 << 10;

/// The HTTP/2 window of a connection that may receive large messages at full speed.
pub(super) const LARGE_WINDOW: u32 = 8 << 20;

/// Messages up to this size, in either direction, pass through tonic's buffers. A call takes the memory for
/// them once ([`CALL_BYTES`]), and not for each message, so that a stream of hundreds of thousands of
/// small messages per second locks nothing.
///
/// Larger messages wait in the [`CallContext`](super::context::CallContext) and tonic passes an empty message
/// in their place, because tonic keeps its buffers, as large as the largest message, until the call ends.
pub(super) const SMALL_BYTES: usize = 4 << 10;

/// A received frame may hold this many bytes of messages that tonic has not asked for yet.
pub(super) const FRAME_BYTES: u64 = 8 << 10;

/// The memory that each call takes when it begins: its own state, [`FRAME_BYTES`] of a received frame, and
/// [`SMALL_BYTES`] of messages as they arrive, decoded, and as answers.
pub(super) const CALL_BYTES: usize = 32 << 10;

/// The memory of the hulls of a request that are built at a time, unless a single hull takes more. About
/// 50,000 points keep all threads busy.
pub(super) const GROUP_BYTES: usize = 64 << 20;

/// Bytes of memory per hull on a page of `ListHulls`: the store's entry, and the answer twice.
pub(super) const LISTED_BYTES: usize = 320;

/// The memory of a request's hull besides its points, or of an id: its entries in lists and tables
/// of ids, and the error if the hull is refused.
pub(super) const HULL_BYTES: usize = 512;

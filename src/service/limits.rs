//! The limits of a server. `GetServerInfo` publishes them, and docs/operations.md states the reason
//! for each.

use super::sizes::{
    CALL_BYTES, CONNECTION_BYTES, GROUP_BYTES, HULL_BYTES, LARGE_WINDOW, LISTED_BYTES, MOST_HEADER_MEMORY,
};
use crate::{size::ByteSize, store::building_bytes};

/// The limits of a server. Each is inclusive: a request at the limit is accepted, a request one
/// past it is refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Encoded bytes of a message, in either direction.
    pub max_message_bytes: usize,
    /// Pairs in one request.
    pub max_pairs_per_request: u32,
    /// Bodies in one request.
    pub max_bodies_per_request: u32,
    /// Hulls in one request of any kind.
    pub max_hulls_per_request: u32,
    /// Extreme vertices of one hull.
    pub max_vertices_per_hull: u32,
    /// Points in the definition of one hull. They determine the cost of building and simplifying
    /// it.
    pub max_points_per_hull: u32,
    /// Pairs of one caller that are accepted and not answered yet. All callers together may have
    /// less than twice as many.
    pub max_pairs_in_flight: u32,
    /// Bytes of memory that all callers together can make the server hold. The cached hulls
    /// (`cache_bytes`) are not included.
    pub max_memory_bytes: u64,
    /// Whether callers share memory, leases on hulls and compute threads fairly.
    pub shares: bool,
    /// Bytes of requests that have arrived and are not decoded yet, over all calls. This is the cap on the
    /// part `arriving` of the memory.
    pub max_request_bytes_in_flight: u64,
    /// The longest time of a call, except for streams. A longer deadline is shortened to this.
    pub max_deadline_seconds: u32,
    /// Bytes that all streams together keep from one message to the next.
    pub max_stream_state_bytes: u64,
    /// Heap bytes of all cached hulls. Hulls that a request uses are in the cache, so a request whose hulls
    /// need more than its caller's share of the cache is refused.
    pub cache_bytes: u64,
    /// Total bytes of the blobs in the store; 0 stands for no limit.
    pub store_bytes: u64,
    /// Connections that are open at a time. A further connection is closed at once.
    pub max_connections: u32,
    /// Concurrent calls on one connection.
    pub max_streams_per_connection: u32,
    /// Hulls in one page of `ListHulls`.
    pub max_page_size: u32,
    /// The time for which a hull that another server on the same store has deleted may still be
    /// used.
    pub cache_age_seconds: u32,
    /// The time that an operation of the store may take before the store counts as hung. It is not
    /// published: clients only see that the store is unavailable.
    pub store_seconds: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_message_bytes: 64 << 20,
            max_pairs_per_request: 131_072,
            max_bodies_per_request: 131_072,
            max_hulls_per_request: 16_384,
            max_vertices_per_hull: 16_384,
            max_points_per_hull: 262_144,
            max_pairs_in_flight: 1 << 20,
            max_memory_bytes: 2 << 30,
            shares: true,
            max_request_bytes_in_flight: 1 << 30,
            max_deadline_seconds: 300,
            max_stream_state_bytes: 1 << 28,
            cache_bytes: 1 << 30,
            store_bytes: 0,
            max_connections: 10_000,
            max_streams_per_connection: 1024,
            max_page_size: 10_000,
            cache_age_seconds: 60,
            store_seconds: 20,
        }
    }
}

/// The largest `max_message_bytes`. The length of a gRPC message has 32 bits, and a server that
/// accepts more than 2 GiB at a time is misconfigured.
const MOST_MESSAGE_BYTES: u64 = 2 << 30;

/// The largest value of any other size, so that sums of sizes do not overflow.
const MOST_BYTES: u64 = 1 << 50;

/// The least `max_memory_bytes`: enough for many connections, small requests and their answers.
const LEAST_MEMORY_BYTES: u64 = 256 << 20;

/// The memory of the largest query, in units of `max_message_bytes`: one for the arriving message, two for
/// the decoded request, and two for the answer (as a message and encoded).
const QUERY_MESSAGES: u64 = 1 + 2 + 2;

/// The memory of the largest registration besides its building, in units of `max_message_bytes`: the
/// decoded request. The arrived message is freed before the first hull is built.
const REGISTRATION_MESSAGES: u64 = 2;

/// The largest `store_seconds`. With a longer limit callers would wait too long for a store that
/// does not answer.
const MOST_STORE_SECONDS: u64 = 3600;

/// The bytes of a blob besides its points, rounded up (docs/identity.md).
const BLOB_HEAD_BYTES: u64 = 64;

/// The bytes of a point: three doubles.
const POINT_BYTES: u64 = 24;

impl Limits {
    /// The bytes of the largest blob that a registration can produce: its points are within
    /// `max_points_per_hull` and arrived in one message.
    pub fn max_blob_bytes(&self) -> u64 {
        let points = POINT_BYTES * u64::from(self.max_points_per_hull);
        points.min(self.max_message_bytes as u64) + BLOB_HEAD_BYTES
    }

    /// The points of the largest definition that can be registered: it arrives in one message.
    fn largest_definition(&self) -> u64 {
        u64::from(self.max_points_per_hull).min(self.max_message_bytes as u64 / POINT_BYTES)
    }

    /// The most memory that a single request takes from the budget, with the connection on which it
    /// arrives: that of the largest query, registration or page of a listing.
    ///
    /// Building a hull takes 1,280 bytes per point of its definition. The other hulls of the same request
    /// are built before and after it.
    pub fn largest_request_bytes(&self) -> u64 {
        let message = self.max_message_bytes as u64;
        let connection = CONNECTION_BYTES + u64::from(LARGE_WINDOW);
        let call = CALL_BYTES as u64 + MOST_HEADER_MEMORY;
        let hulls = HULL_BYTES as u64 * u64::from(self.max_hulls_per_request).min(message);
        let building = building_bytes(self.largest_definition() as usize).max(GROUP_BYTES) as u64;
        let query = QUERY_MESSAGES * message;
        let registration = REGISTRATION_MESSAGES * message + building;
        let listing = LISTED_BYTES as u64 * u64::from(self.max_page_size);
        connection + call + hulls + query.max(registration).max(listing)
    }

    /// The least `max_memory_bytes` for the other limits, in whole MiB. One caller may hold half of the
    /// budget, so a budget of less than twice the largest request would refuse that request for ever.
    pub fn least_memory_bytes(&self) -> u64 {
        (2 * self.largest_request_bytes()).next_multiple_of(1 << 20).max(LEAST_MEMORY_BYTES)
    }
}

impl Limits {
    /// The values that the limit called `name` may have. None if there is no such limit, or any
    /// value is allowed.
    pub fn range(name: &str) -> Option<(u64, u64)> {
        let ranges = Self::default().ranges();
        ranges.into_iter().find(|&(limit, ..)| limit == name).map(|(_, _, least, most)| (least, most))
    }

    /// The range of the limit called `name`, for messages: `1 to 4294967295`, `1 KiB to 2 GiB`.
    pub fn shown_range(name: &str) -> Option<String> {
        let (least, most) = Self::range(name)?;
        Some(format!("{} to {}", shown(name, least), shown(name, most)))
    }

    /// Each limit's name and value, and the least and the most that it may be.
    fn ranges(&self) -> [(&'static str, u64, u64, u64); 18] {
        let count = |name, value: u32| (name, u64::from(value), 1, u64::from(u32::MAX));
        let size = |name, value, least| (name, value, least, MOST_BYTES);
        [
            ("max_message_bytes", self.max_message_bytes as u64, 1024, MOST_MESSAGE_BYTES),
            count("max_pairs_per_request", self.max_pairs_per_request),
            count("max_bodies_per_request", self.max_bodies_per_request),
            count("max_hulls_per_request", self.max_hulls_per_request),
            // No hull has fewer than 4 vertices.
            ("max_vertices_per_hull", self.max_vertices_per_hull.into(), 4, u32::MAX.into()),
            ("max_points_per_hull", self.max_points_per_hull.into(), 4, u32::MAX.into()),
            count("max_pairs_in_flight", self.max_pairs_in_flight),
            size("max_memory_bytes", self.max_memory_bytes, LEAST_MEMORY_BYTES),
            size("max_request_bytes_in_flight", self.max_request_bytes_in_flight, 1),
            count("max_deadline_seconds", self.max_deadline_seconds),
            // With 0, streams keep nothing.
            size("max_stream_state_bytes", self.max_stream_state_bytes, 0),
            size("cache_bytes", self.cache_bytes, 1),
            // 0: no limit.
            size("store_bytes", self.store_bytes, 0),
            count("max_connections", self.max_connections),
            count("max_streams_per_connection", self.max_streams_per_connection),
            count("max_page_size", self.max_page_size),
            // With 0, hulls are looked up in the store each time.
            ("cache_age_seconds", self.cache_age_seconds.into(), 0, u32::MAX.into()),
            ("store_seconds", self.store_seconds.into(), 1, MOST_STORE_SECONDS),
        ]
    }

    /// Describes the fault of these limits: a value outside its range, or two values that contradict
    /// each other. `None` if the limits have no fault.
    pub fn contradiction(&self) -> Option<String> {
        for (name, value, least, most) in self.ranges() {
            if !(least..=most).contains(&value) {
                let [value, least, most] = [value, least, most].map(|value| shown(name, value));
                return Some(format!("{name} is {value}, must be {least} to {most}"));
            }
        }
        let message = self.max_message_bytes as u64;
        let counts = format!(
            "twice the largest request, which takes {} by max_message_bytes ({}), max_points_per_hull ({}), \
             max_hulls_per_request ({}) and max_page_size ({})",
            ByteSize(self.largest_request_bytes()),
            ByteSize(message),
            self.max_points_per_hull,
            self.max_hulls_per_request,
            self.max_page_size,
        );
        let at_least = [
            (
                ("max_pairs_in_flight", u64::from(self.max_pairs_in_flight)),
                ("max_pairs_per_request", u64::from(self.max_pairs_per_request)),
                "the largest request would never run",
            ),
            (
                ("max_points_per_hull", u64::from(self.max_points_per_hull)),
                ("max_vertices_per_hull", u64::from(self.max_vertices_per_hull)),
                "a hull of that many vertices could not be defined",
            ),
            (
                ("max_request_bytes_in_flight", self.max_request_bytes_in_flight),
                ("twice max_message_bytes", 2 * message),
                "one caller may hold half of it, and the largest message has to arrive",
            ),
            (
                ("max_memory_bytes", self.max_memory_bytes),
                (&counts, self.least_memory_bytes()),
                "one caller may hold half of it; raise it, or lower one of the others",
            ),
        ];
        let below = at_least.into_iter().find(|((_, value), (_, least), _)| value < least);
        below.map(|((name, value), (other, least), why)| {
            let [value, least] = [value, least].map(|value| shown(name, value));
            format!("{name} is {value}, must be at least {least} ({other}): {why}")
        })
    }
}

/// The value of the limit called `name`, for messages.
fn shown(name: &str, value: u64) -> String {
    if name.contains("bytes") { ByteSize(value).to_string() } else { value.to_string() }
}

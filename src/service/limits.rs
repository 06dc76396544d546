//! A limit on everything, in one place: what `GetServerInfo` publishes and the
//! request's way enforces. Why each is what it is: docs/operations.md.

/// What a server accepts. Each is inclusive: at the limit is accepted, one past it refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Encoded size of a message, either way.
    pub max_message_bytes: usize,
    /// Pairs in one request.
    pub max_pairs_per_request: u32,
    /// Bodies in one request.
    pub max_bodies_per_request: u32,
    /// Hulls in one request of any kind.
    pub max_hulls_per_request: u32,
    /// Extreme vertices of one hull.
    pub max_vertices_per_hull: u32,
    /// Points in the definition of one hull. They bound what building and simplifying costs.
    pub max_points_per_hull: u32,
    /// Pairs accepted and not yet answered, over all calls.
    pub max_pairs_in_flight: u32,
    /// Memory that all callers together can make the server hold, in bytes; the cached hulls
    /// (`cache_bytes`) are not part of it.
    pub max_memory_bytes: u64,
    /// Whether callers share memory, leases on hulls and compute threads fairly.
    pub shares: bool,
    /// Bytes of requests that have come and are not yet answered, over all calls: the cap of
    /// that part of the memory.
    pub max_request_bytes_in_flight: u64,
    /// How long a call may take, but for streams; one that gives itself longer gets this.
    pub max_deadline_seconds: u32,
    /// What streams keep from one message to the next, all together.
    pub max_stream_state_bytes: u64,
    /// Heap of hulls: what is cached, and of that what requests use. One that needs more for
    /// its own hulls is refused.
    pub cache_bytes: u64,
    /// Blobs of the store, summed; 0: unbounded.
    pub store_bytes: u64,
    /// Connections open at a time; one more is closed at once.
    pub max_connections: u32,
    /// Concurrent calls on one connection.
    pub max_streams_per_connection: u32,
    /// Hulls in one page of `ListHulls`.
    pub max_page_size: u32,
    /// Within this a hull deleted by another server on the same store may still be answered for.
    pub cache_age_seconds: u32,
    /// How long an operation of the store may take before the store is taken to hang.
    pub store_seconds: u32,
    /// Whether callers share the cache and the store by dynamic thresholds, so that none of
    /// them leaves nothing for the others.
    pub shares: bool,
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
            shares: true,
        }
    }
}

/// The largest `max_message_bytes`: an HTTP/2 gRPC message's length is 32 bits, and a
/// server that answers for 2 GiB at a time is misconfigured.
const MOST_MESSAGE_BYTES: usize = 2 << 30;

/// The largest `store_seconds`: for longer, callers would wait for a store that does not answer.
const MOST_STORE_SECONDS: u32 = 3600;

/// The bytes of a blob beside its points, rounded up (docs/identity.md).
const BLOB_HEAD_BYTES: u64 = 64;

impl Limits {
    /// The bytes of the largest blob: a message has at least as many bytes as the points in it.
    pub fn max_blob_bytes(&self) -> u64 {
        self.max_message_bytes as u64 + BLOB_HEAD_BYTES
    }

    /// What makes these limits contradict each other, for people; none when they do not.
    pub fn contradiction(&self) -> Option<String> {
        let positive = [
            ("max_pairs_per_request", self.max_pairs_per_request),
            ("max_bodies_per_request", self.max_bodies_per_request),
            ("max_hulls_per_request", self.max_hulls_per_request),
            ("max_connections", self.max_connections),
            ("max_streams_per_connection", self.max_streams_per_connection),
            ("max_deadline_seconds", self.max_deadline_seconds),
            ("max_page_size", self.max_page_size),
        ];
        if let Some((name, _)) = positive.iter().find(|(_, value)| *value == 0) {
            return Some(format!("{name} is 0"));
        }
        if self.cache_bytes == 0 {
            return Some("cache_bytes is 0: no query would have its hulls".into());
        }
        if !(1024..=MOST_MESSAGE_BYTES).contains(&self.max_message_bytes) {
            return Some(format!(
                "max_message_bytes is {}, outside 1024 to {MOST_MESSAGE_BYTES}",
                self.max_message_bytes
            ));
        }
        if !(1..=MOST_STORE_SECONDS).contains(&self.store_seconds) {
            return Some(format!(
                "store_seconds is {}, outside 1 to {MOST_STORE_SECONDS}",
                self.store_seconds
            ));
        }
        if self.max_vertices_per_hull < 4 {
            return Some("max_vertices_per_hull is below 4: no hull has fewer".into());
        }
        if self.max_pairs_in_flight < self.max_pairs_per_request {
            return Some(format!(
                "max_pairs_in_flight ({}) is below max_pairs_per_request ({}): such a request would never run",
                self.max_pairs_in_flight, self.max_pairs_per_request
            ));
        }
        // The gRPC frame's head comes with a message.
        if self.max_request_bytes_in_flight < self.max_message_bytes as u64 + FRAME_HEAD_BYTES {
            return Some(format!(
                "max_request_bytes_in_flight ({}) is below max_message_bytes ({}) and {FRAME_HEAD_BYTES}: \
                 such a message would never arrive",
                self.max_request_bytes_in_flight, self.max_message_bytes
            ));
        }
        None
    }
}

/// Of a message on the wire: whether it is compressed, and its length.
const FRAME_HEAD_BYTES: u64 = 5;

//! The declaration of every setting: its flag, its environment variable, its key in the file, its default and the
//! values that it may have.

use std::{net::IpAddr, path::PathBuf};

use clap::ValueEnum;
use hullcast::{
    service::{Limits, Origin},
    size::ByteSize,
};
use serde::Serialize;

use crate::cli::{
    memory::MemorySize,
    serve_values::{
        admin_address, bytes, collector, limit, listen_address, log_filter, proxy, record_size, size,
        store_url,
    },
    values::{count, number},
};

/// The directory of the hulls if no store is set.
pub(crate) const DEFAULT_STORE: &str = "hullcast-store";

/// The shortest time between two runs of a loop, in seconds.
pub(super) const SHORTEST_LOOP: f64 = 0.01;

/// The shortest time limit, in seconds.
pub(super) const SHORTEST_TIME: f64 = 0.001;

/// The longest time of a setting: about thirty years, which overflows no clock.
pub(super) const LONGEST: f64 = 1e9;

/// Largest number of compute threads.
pub(crate) const MOST_THREADS: usize = 4096;

/// How logs are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub(crate) enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object per line.
    Json,
}

/// The values of `shares`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Switch {
    /// Callers share fairly.
    On,
    /// All callers have one common budget, first come, first served.
    Off,
}

/// Declares every setting once, with its flag, its environment variable, its key in the file and its
/// default.
macro_rules! settings {
    ($($(#[doc = $doc:literal])* $name:ident: $kind:ty = $default:expr, $env:literal, $value:literal
        $([$($arg:tt)*])?;)*) => {
        /// Settings that a file, the environment or flags give; absent ones are left to the next.
        #[derive(Clone, Debug, Default, clap::Args)]
        pub(crate) struct PartialSettings {
            $($(#[doc = $doc])* #[arg(long, env = $env, value_name = $value, allow_negative_numbers = true $(, $($arg)*)?)]
            pub(super) $name: Option<$kind>,)*
        }

        /// The complete settings.
        #[derive(Clone, Debug, PartialEq, Serialize)]
        pub(crate) struct Settings {
            $($(#[doc = $doc])* pub(crate) $name: $kind,)*
            /// The settings whose values come from the file.
            #[serde(skip)]
            pub(super) of_file: Vec<&'static str>,
        }

        impl PartialSettings {
            /// These settings, of flags and the environment. A setting that is absent here comes from `file`, or
            /// is the default.
            pub(crate) fn or(self, file: Self) -> Settings {
                let limits = Limits::default();
                let mut of_file = Vec::new();
                $(if self.$name.is_none() && file.$name.is_some() {
                    of_file.push(stringify!($name));
                })*
                $(let $name = self.$name.or(file.$name);)*
                settings!(@complete limits of_file $($name = $default;)*)
            }
        }

        /// The names of all settings.
        pub(crate) const NAMES: &[&str] = &[$(stringify!($name)),*];
    };
    (@complete $limits:ident $of_file:ident $($name:ident = $default:expr;)*) => {
        Settings { $($name: $name.unwrap_or_else(|| ($default)(&$limits)),)* $of_file }
    };
}

settings! {
    /// Address to listen on: host:port (port 0 means any free port) or unix:PATH; may be repeated
    listen: Vec<String> = |_: &Limits| vec!["127.0.0.1:50051".into()],
        "HULLCAST_LISTEN", "ADDR" [value_delimiter = ',', value_parser = listen_address];
    /// Where hulls are kept: a directory, file://PATH, memory:// (only until the server ends), or, in a
    /// build with the feature, s3://BUCKET/PREFIX, gs:// or az:// (docs/durability.md)
    store: String = |_: &Limits| DEFAULT_STORE.into(), "HULLCAST_STORE", "URL" [value_parser = store_url];
    /// Threads that compute; 0 means one per core
    compute_threads: usize = |_: &Limits| 0, "HULLCAST_COMPUTE_THREADS", "N"
        [value_parser = count(0, MOST_THREADS)];
    /// Seconds after SIGTERM during which health checks report NOT_SERVING and calls are still accepted
    grace_seconds: f64 = |_: &Limits| 3.0, "HULLCAST_GRACE_SECONDS", "S"
        [value_parser = number(0.0, LONGEST)];
    /// Approximate age in seconds at which a connection is told to close; 0 means never
    max_connection_age_seconds: f64 = |_: &Limits| 0.0, "HULLCAST_MAX_CONNECTION_AGE_SECONDS", "S"
        [value_parser = number(0.0, LONGEST)];
    /// Seconds between two tests whether the store can be written to
    probe_seconds: f64 = |_: &Limits| 10.0, "HULLCAST_PROBE_SECONDS", "S"
        [value_parser = number(SHORTEST_LOOP, LONGEST)];
    /// Seconds for calls in flight to finish when the server stops
    drain_seconds: f64 = |_: &Limits| 10.0, "HULLCAST_DRAIN_SECONDS", "S"
        [value_parser = number(0.0, LONGEST)];
    /// PEM file of the server's certificate, followed by its chain; empty means no TLS
    tls_certificate: PathBuf = |_: &Limits| PathBuf::new(), "HULLCAST_TLS_CERTIFICATE", "FILE";
    /// PEM file of the certificate's private key
    tls_key: PathBuf = |_: &Limits| PathBuf::new(), "HULLCAST_TLS_KEY", "FILE";
    /// PEM file of authorities, one of which must have signed a client's certificate; empty means that
    /// clients need no certificate
    tls_client_ca: PathBuf = |_: &Limits| PathBuf::new(), "HULLCAST_TLS_CLIENT_CA", "FILE";
    /// Accept connections from other machines without TLS, for example behind a proxy that terminates
    /// TLS
    allow_plaintext: bool = |_: &Limits| false, "HULLCAST_ALLOW_PLAINTEXT", "BOOL"
        [num_args = 0..=1, default_missing_value = "true"];
    /// Serve a page that shows contacts on the same addresses, and print its URL (docs/playground.md)
    playground: bool = |_: &Limits| false, "HULLCAST_PLAYGROUND", "BOOL"
        [num_args = 0..=1, default_missing_value = "true"];
    /// Answer gRPC-web, for pages in browsers, on the same addresses (docs/operations.md)
    grpc_web: bool = |_: &Limits| false, "HULLCAST_GRPC_WEB", "BOOL"
        [num_args = 0..=1, default_missing_value = "true"];
    /// Origins of the pages of other sites that may call over gRPC-web, as in https://app.example.org
    grpc_web_origins: Vec<Origin> = |_: &Limits| Vec::new(), "HULLCAST_GRPC_WEB_ORIGINS", "ORIGIN"
        [value_delimiter = ',', value_parser = str::parse::<Origin>];
    /// File of the tokens that may query, one per line. If there is neither list, calls need no token
    query_tokens: PathBuf = |_: &Limits| PathBuf::new(), "HULLCAST_QUERY_TOKENS", "FILE";
    /// File of the tokens that may also register and delete, one per line
    register_tokens: PathBuf = |_: &Limits| PathBuf::new(), "HULLCAST_REGISTER_TOKENS", "FILE";
    /// Seconds between two readings of the files with certificates and tokens
    reload_seconds: f64 = |_: &Limits| 10.0, "HULLCAST_RELOAD_SECONDS", "S"
        [value_parser = number(SHORTEST_LOOP, LONGEST)];
    /// Address of /metrics, /livez and /readyz in plain HTTP; empty means no such port
    admin_listen: String = |_: &Limits| String::new(), "HULLCAST_ADMIN_LISTEN", "ADDR"
        [value_parser = admin_address];
    /// Collector that receives traces (OTLP over gRPC): http://HOST:PORT or https://HOST:PORT; empty
    /// means no traces. Needs a build with the feature otlp (docs/operations.md)
    otlp_endpoint: String = |_: &Limits| String::new(), "HULLCAST_OTLP_ENDPOINT", "URL"
        [value_parser = collector];
    /// Fraction of calls that are traced, 0 to 1, if the caller does not decide it
    otlp_share: f64 = |_: &Limits| 1.0, "HULLCAST_OTLP_SHARE", "SHARE"
        [value_parser = number(0.0, 1.0)];
    /// Directory that receives records of calls, for hullcast replay; empty means no records (docs/records.md)
    record: PathBuf = |_: &Limits| PathBuf::new(), "HULLCAST_RECORD", "DIR";
    /// Most bytes of the records; the oldest make room for new ones
    record_bytes: ByteSize = |_: &Limits| ByteSize(1 << 30), "HULLCAST_RECORD_BYTES", "SIZE"
        [value_parser = record_size];
    /// Fraction of calls that are recorded, 0 to 1
    record_share: f64 = |_: &Limits| 0.01, "HULLCAST_RECORD_SHARE", "SHARE"
        [value_parser = number(0.0, 1.0)];
    /// Calls of this many seconds or more are recorded too, except for streams; 0 means that the time does not
    /// matter
    record_slow_seconds: f64 = |_: &Limits| 0.0, "HULLCAST_RECORD_SLOW_SECONDS", "S"
        [value_parser = number(0.0, LONGEST)];
    /// Record calls that end with an error too
    record_failed: bool = |_: &Limits| false, "HULLCAST_RECORD_FAILED", "BOOL"
        [num_args = 0..=1, default_missing_value = "true"];
    /// Record calls with a pair that is flagged as estimated or as having an open gap too
    record_flagged: bool = |_: &Limits| false, "HULLCAST_RECORD_FLAGGED", "BOOL"
        [num_args = 0..=1, default_missing_value = "true"];
    /// Level of the log: error, warn, info, debug (every request), trace or off; or a filter such as
    /// debug,h2=debug. A level without a filter leaves out the frames that the HTTP/2 library logs
    log: String = |_: &Limits| "info".into(), "HULLCAST_LOG", "FILTER"
        [value_parser = log_filter];
    /// How logs are written
    log_format: LogFormat = |_: &Limits| LogFormat::Text, "HULLCAST_LOG_FORMAT", "FORMAT" [value_enum];
    /// Most bytes of a message, in either direction
    max_message_bytes: ByteSize = |l: &Limits| ByteSize(l.max_message_bytes as u64), "HULLCAST_MAX_MESSAGE_BYTES", "SIZE"
        [value_parser = bytes("max_message_bytes")];
    /// Most pairs in a request
    max_pairs_per_request: u32 = |l: &Limits| l.max_pairs_per_request,
        "HULLCAST_MAX_PAIRS_PER_REQUEST", "N"
        [value_parser = limit::<u32>("max_pairs_per_request")];
    /// Most bodies in a request
    max_bodies_per_request: u32 = |l: &Limits| l.max_bodies_per_request,
        "HULLCAST_MAX_BODIES_PER_REQUEST", "N"
        [value_parser = limit::<u32>("max_bodies_per_request")];
    /// Most hulls in a request
    max_hulls_per_request: u32 = |l: &Limits| l.max_hulls_per_request,
        "HULLCAST_MAX_HULLS_PER_REQUEST", "N"
        [value_parser = limit::<u32>("max_hulls_per_request")];
    /// Most extreme vertices of a hull
    max_vertices_per_hull: u32 = |l: &Limits| l.max_vertices_per_hull,
        "HULLCAST_MAX_VERTICES_PER_HULL", "N"
        [value_parser = limit::<u32>("max_vertices_per_hull")];
    /// Most points in the definition of a hull
    max_points_per_hull: u32 = |l: &Limits| l.max_points_per_hull, "HULLCAST_MAX_POINTS_PER_HULL", "N"
        [value_parser = limit::<u32>("max_points_per_hull")];
    /// Most pairs of one caller that are accepted and not yet answered. Several callers together may
    /// have less than twice as many, or this number if --shares is off
    max_pairs_in_flight: u32 = |l: &Limits| l.max_pairs_in_flight, "HULLCAST_MAX_PAIRS_IN_FLIGHT", "N"
        [value_parser = limit::<u32>("max_pairs_in_flight")];
    /// Most memory that all callers together can make the server hold, without the cached hulls: bytes,
    /// or a percentage of the memory that the process may use, such as 25%
    max_memory_bytes: MemorySize = |l: &Limits| MemorySize::Bytes(l.max_memory_bytes),
        "HULLCAST_MAX_MEMORY_BYTES", "SIZE"
        [value_parser = size("max_memory_bytes")];
    /// Whether callers share memory, cached hulls and compute threads fairly
    shares: Switch = |_: &Limits| Switch::On, "HULLCAST_SHARES", "SWITCH" [value_enum];
    /// Addresses of proxies; each connection of a proxy counts as a separate caller
    trusted_proxies: Vec<IpAddr> = |_: &Limits| Vec::new(), "HULLCAST_TRUSTED_PROXIES", "ADDR"
        [value_delimiter = ',', value_parser = proxy];
    /// Seconds within which a request's message has to arrive, plus one second per MiB of it
    message_seconds: f64 = |_: &Limits| 30.0, "HULLCAST_MESSAGE_SECONDS", "S"
        [value_parser = number(SHORTEST_TIME, LONGEST)];
    /// Seconds within which a caller has to take an answer, plus one second per MiB of it
    answer_seconds: f64 = |_: &Limits| 30.0, "HULLCAST_ANSWER_SECONDS", "S"
        [value_parser = number(SHORTEST_TIME, LONGEST)];
    /// Most bytes of requests that have arrived and are not yet decoded, over all calls
    max_request_bytes_in_flight: ByteSize = |l: &Limits| ByteSize(l.max_request_bytes_in_flight),
        "HULLCAST_MAX_REQUEST_BYTES_IN_FLIGHT", "SIZE"
        [value_parser = bytes("max_request_bytes_in_flight")];
    /// Most seconds that a call may take, except for streams
    max_deadline_seconds: u32 = |l: &Limits| l.max_deadline_seconds, "HULLCAST_MAX_DEADLINE_SECONDS", "S"
        [value_parser = limit::<u32>("max_deadline_seconds")];
    /// Most connections
    max_connections: u32 = |l: &Limits| l.max_connections, "HULLCAST_MAX_CONNECTIONS", "N"
        [value_parser = limit::<u32>("max_connections")];
    /// Most bytes that all streams together keep from one message to the next
    max_stream_state_bytes: ByteSize = |l: &Limits| ByteSize(l.max_stream_state_bytes),
        "HULLCAST_MAX_STREAM_STATE_BYTES", "SIZE"
        [value_parser = bytes("max_stream_state_bytes")];
    /// Most memory for hulls, cached and in use: bytes, or a percentage of the memory that the process may
    /// use, such as 25%
    cache_bytes: MemorySize = |l: &Limits| MemorySize::Bytes(l.cache_bytes), "HULLCAST_CACHE_BYTES", "SIZE"
        [value_parser = size("cache_bytes")];
    /// Most bytes in the store; 0 means no limit
    store_bytes: ByteSize = |l: &Limits| ByteSize(l.store_bytes), "HULLCAST_STORE_BYTES", "SIZE"
        [value_parser = bytes("store_bytes")];
    /// Most concurrent calls on a connection
    max_streams_per_connection: u32 = |l: &Limits| l.max_streams_per_connection,
        "HULLCAST_MAX_STREAMS_PER_CONNECTION", "N"
        [value_parser = limit::<u32>("max_streams_per_connection")];
    /// Most hulls in a page of a listing
    max_page_size: u32 = |l: &Limits| l.max_page_size, "HULLCAST_MAX_PAGE_SIZE", "N"
        [value_parser = limit::<u32>("max_page_size")];
    /// Seconds for which the server may still use a hull that another server has deleted
    cache_age_seconds: u32 = |l: &Limits| l.cache_age_seconds, "HULLCAST_CACHE_AGE_SECONDS", "S"
        [value_parser = limit::<u32>("cache_age_seconds")];
    /// Seconds that an operation of the store may take; after that the store counts as hung until the
    /// operation returns (1 to 3600)
    store_seconds: u32 = |l: &Limits| l.store_seconds, "HULLCAST_STORE_SECONDS", "S"
        [value_parser = limit::<u32>("store_seconds")];
}

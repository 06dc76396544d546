//! The metrics of a server, for Prometheus.
//!
//! Code that counts holds the counter itself, so there is no look-up by name, and only histograms have a
//! lock. [`Metrics::text`] is the answer of `/metrics`; its `# HELP` lines explain each metric.

use std::fmt;

use prometheus_client::{
    encoding::{EncodeLabelSet, text::encode},
    metrics::{
        counter::Counter,
        family::Family,
        gauge::Gauge,
        histogram::{Histogram, exponential_buckets},
    },
    registry::{Metric, Registry},
};

/// The method of a call, and the code with which it ended.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct CallLabels {
    /// `Service/Method` as in the contract; `other` for every other path.
    pub method: &'static str,
    /// The name of the gRPC code.
    pub code: &'static str,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct MethodLabel {
    method: &'static str,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct OutcomeLabel {
    outcome: &'static str,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct FlagLabel {
    flag: &'static str,
}

/// The label of a metric that is counted per token.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct TokenLabel {
    token: String,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct PartLabel {
    part: &'static str,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct ReasonLabel {
    reason: &'static str,
}

/// The names of the outcomes, in the order of their numbers on the wire, which begin at 1.
const OUTCOMES: [&str; 4] = ["contact", "separated", "undecided", "invalid"];

/// The names of the flags, in the order of their bits on the wire.
pub(crate) const FLAGS: [&str; 7] =
    ["estimated", "coincident", "gap_open", "reduced", "unknown_hull", "hull_unavailable", "invalid_body"];

/// The resource for lack of which a call or connection was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shed {
    Pairs,
    RequestBytes,
    Connection,
    Hulls,
    Memory,
    Store,
}

/// The reasons and their names, in the order of the enum.
const SHEDS: [(Shed, &str); 6] = [
    (Shed::Pairs, "pairs_in_flight"),
    (Shed::RequestBytes, "request_bytes_in_flight"),
    (Shed::Connection, "connections"),
    (Shed::Hulls, "held_bytes"),
    (Shed::Memory, "memory"),
    (Shed::Store, "store_operations"),
];

/// The reason why the server cut a call whose answer was ready.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CutReason {
    /// The peer did not take the answer in time.
    AnswerNotRead,
    /// The call's deadline passed while the peer was taking the answer.
    Deadline,
}

/// The names of the reasons, in the order of the enum.
const CUTS: [&str; 2] = ["answer_not_read", "deadline"];

impl CutReason {
    /// All reasons, in the order of the enum.
    pub(crate) const ALL: [Self; 2] = [Self::AnswerNotRead, Self::Deadline];

    /// The reason's name in metrics and logs.
    pub(crate) fn name(self) -> &'static str {
        CUTS[self as usize]
    }
}

/// What became of a record of a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RecordFate {
    Written,
    /// There was no room in the queue.
    Dropped,
    /// The request, or the request with its hulls, was too large.
    TooLarge,
    /// The file could not be written.
    Failed,
}

/// The names of the fates, in the order of the enum.
const RECORD_FATES: [&str; 4] = ["written", "dropped", "too_large", "failed"];

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct FateLabel {
    fate: &'static str,
}

/// Counters, gauges and histograms of one server.
pub struct Metrics {
    registry: Registry,
    requests: Family<CallLabels, Counter>,
    request_seconds: Family<MethodLabel, Histogram, fn() -> Histogram>,
    pub(crate) requests_in_flight: Gauge,
    pub(crate) request_bytes_in_flight: Gauge,
    pub(crate) connections: Gauge,
    pairs: [Counter; 4],
    flags: [Counter; 7],
    pub(crate) pairs_in_flight: Gauge,
    pub(crate) pairs_queued: Gauge,
    pub(crate) queue_seconds: Histogram,
    pub(crate) compute_seconds: Histogram,
    pub(crate) solver_iterations: Counter,
    steps: Counter,
    largest_steps_between_looks: Gauge,
    sheds: [Counter; SHEDS.len()],
    cuts: [Counter; 2],
    memory_bytes: Family<PartLabel, Gauge>,
    token_memory_bytes: Family<TokenLabel, Gauge>,
    pub(crate) callers: Gauge,
    pub(crate) memory_limit_bytes: Gauge,
    pub(crate) cache_limit_bytes: Gauge,
    pub(crate) cache_bytes: Gauge,
    pub(crate) cache_hulls: Gauge,
    pub(crate) held_bytes: Gauge,
    pub(crate) cache_hits: Counter,
    pub(crate) cache_misses: Counter,
    pub(crate) cache_evictions: Counter,
    pub(crate) load_seconds: Histogram,
    pub(crate) registered: Counter,
    pub(crate) deleted: Counter,
    pub(crate) quarantined: Counter,
    pub(crate) store_errors: Counter,
    records: [Counter; RECORD_FATES.len()],
    pub(crate) record_bytes: Gauge,
    pub(crate) record_queue_bytes: Gauge,
    pub(crate) ready: Gauge,
    resident_bytes: Gauge,
}

impl fmt::Debug for Metrics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Metrics").finish_non_exhaustive()
    }
}

/// A histogram of times, with buckets from 10 us to 84 s.
fn seconds() -> Histogram {
    Histogram::new(exponential_buckets(1e-5, 2.0, 24))
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix("hullcast");
        let r = &mut registry;
        let outcomes = add::<Family<OutcomeLabel, Counter>>(r, "pairs", "Pairs answered, by outcome");
        let flags = add::<Family<FlagLabel, Counter>>(r, "pair_flags", "Pairs answered, by flag");
        let help = "Calls and connections refused for want of room, by reason";
        let sheds = add::<Family<ReasonLabel, Counter>>(r, "sheds", help);
        let help = "Calls cut although their answer was ready, by reason";
        let cuts = add::<Family<ReasonLabel, Counter>>(r, "cuts", help);
        let help = "Calls that were to be recorded, by what became of the record";
        let records = add::<Family<FateLabel, Counter>>(r, "records", help);
        let request_seconds: Family<MethodLabel, Histogram, fn() -> Histogram> =
            Family::new_with_constructor(seconds);
        r.register("request_seconds", "From a call's headers to its end", request_seconds.clone());
        let mut histogram = |name: &str, help: &str| {
            let histogram = seconds();
            r.register(name, help, histogram.clone());
            histogram
        };
        let queue_seconds = histogram("queue_seconds", "A batch's wait for its turn to be computed");
        let compute_seconds = histogram("compute_seconds", "A batch's computation, turns of others included");
        let load_seconds = histogram("load_seconds", "Reading and building a hull that was not cached");
        Self {
            requests: add(r, "requests", "Calls ended, by method and gRPC code"),
            request_seconds,
            requests_in_flight: add(r, "requests_in_flight", "Calls under way"),
            request_bytes_in_flight: add(r, "request_bytes_in_flight", "Bytes of requests under way"),
            connections: add(r, "connections", "Connections open"),
            pairs: OUTCOMES.map(|outcome| outcomes.get_or_create(&OutcomeLabel { outcome }).clone()),
            flags: FLAGS.map(|flag| flags.get_or_create(&FlagLabel { flag }).clone()),
            pairs_in_flight: add(r, "pairs_in_flight", "Pairs accepted and not yet answered"),
            pairs_queued: add(r, "pairs_queued", "Pairs accepted whose batch waits for its turn"),
            queue_seconds,
            compute_seconds,
            solver_iterations: add(r, "solver_iterations", "Iterations of the solver, summed over pairs"),
            steps: add(r, "steps", "Elementary steps of calls, each about a nanosecond"),
            largest_steps_between_looks: add(
                r,
                "largest_steps_between_looks",
                "The most steps that a call did between two looks at its stop flag",
            ),
            sheds: SHEDS.map(|(_, reason)| sheds.get_or_create(&ReasonLabel { reason }).clone()),
            cuts: CUTS.map(|reason| cuts.get_or_create(&ReasonLabel { reason }).clone()),
            token_memory_bytes: add(
                r,
                "token_memory_bytes",
                "Memory that a token's calls hold, by the token's name",
            ),
            callers: add(r, "callers", "Callers that share the server at the moment"),
            memory_bytes: add(r, "memory_bytes", "Memory that callers make the server hold, by part"),
            memory_limit_bytes: add(r, "memory_limit_bytes", "The budget of memory_bytes: max_memory_bytes"),
            cache_limit_bytes: add(
                r,
                "cache_limit_bytes",
                "The budget of cached hulls: the setting cache_bytes",
            ),
            cache_bytes: add(r, "cache_bytes", "Heap of cached hulls"),
            cache_hulls: add(r, "cache_hulls", "Hulls cached"),
            held_bytes: add(r, "held_bytes", "Heap of the hulls that calls under way use"),
            cache_hits: add(r, "cache_hits", "Hulls of requests that were cached"),
            cache_misses: add(r, "cache_misses", "Hulls of requests that were not"),
            cache_evictions: add(r, "cache_evictions", "Hulls that made room for others"),
            load_seconds,
            registered: add(r, "registered", "Hulls written to the store"),
            deleted: add(r, "deleted", "Hulls deleted"),
            quarantined: add(r, "quarantined", "Blobs set aside: not what their name says"),
            store_errors: add(r, "store_errors", "Reads and writes of the store that failed"),
            records: RECORD_FATES.map(|fate| records.get_or_create(&FateLabel { fate }).clone()),
            record_bytes: add(r, "record_bytes", "Bytes of the files of records"),
            record_queue_bytes: add(r, "record_queue_bytes", "Memory of records that are not written yet"),
            ready: add(r, "ready", "1 while new calls are welcome"),
            resident_bytes: add(r, "resident_bytes", "Memory of the process"),
            registry,
        }
    }
}

fn add<M: Metric + Default + Clone>(registry: &mut Registry, name: &str, help: &str) -> M {
    let metric = M::default();
    registry.register(name, help, metric.clone());
    metric
}

impl Metrics {
    /// All metrics as OpenMetrics text.
    pub fn text(&self) -> String {
        if let Some(bytes) = resident_bytes() {
            self.resident_bytes.set(bytes);
        }
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = encode(&mut text, &self.registry);
        text
    }

    /// Counts a call that has ended.
    pub(crate) fn ended(&self, call: &CallLabels, seconds: f64) {
        self.requests.get_or_create(call).inc();
        self.request_seconds.get_or_create(&MethodLabel { method: call.method }).observe(seconds);
    }

    /// Counts answered pairs by outcome and by flag.
    pub(crate) fn answered(&self, outcomes: [usize; 4], flags: &[u8]) {
        for (counter, count) in self.pairs.iter().zip(outcomes) {
            counter.inc_by(count as u64);
        }
        // Few pairs have flags.
        let mut counts = [0; 8];
        for flags in flags.iter().filter(|flags| **flags != 0) {
            for (bit, count) in counts.iter_mut().enumerate() {
                *count += u64::from(flags >> bit & 1);
            }
        }
        for (counter, count) in self.flags.iter().zip(counts) {
            counter.inc_by(count);
        }
    }

    /// Counts a call that was cut although its answer was ready.
    pub(crate) fn cut(&self, why: CutReason) {
        self.cuts[why as usize].inc();
    }

    /// Sets the memory that callers hold for one part of the budget.
    pub(crate) fn set_memory(&self, part: &'static str, bytes: u64) {
        self.memory_bytes.get_or_create(&PartLabel { part }).set(i64::try_from(bytes).unwrap_or(i64::MAX));
    }

    /// Sets the memory that the calls of each token hold, by the token's name.
    pub(crate) fn set_token_memory(&self, held: impl IntoIterator<Item = (String, u64)>) {
        self.token_memory_bytes.clear();
        for (token, bytes) in held {
            let bytes = i64::try_from(bytes).unwrap_or(i64::MAX);
            self.token_memory_bytes.get_or_create(&TokenLabel { token }).set(bytes);
        }
    }

    /// Adds the elementary steps of a call. `largest` is the most steps that it did between two checks of
    /// its stop flag.
    pub(crate) fn metered(&self, steps: u64, largest: u64) {
        self.steps.inc_by(steps);
        let largest = i64::try_from(largest).unwrap_or(i64::MAX);
        // If two calls end at once, the smaller value may stay; the next call corrects it.
        if largest > self.largest_steps_between_looks.get() {
            self.largest_steps_between_looks.set(largest);
        }
    }

    /// Counts a record.
    pub(crate) fn recorded(&self, fate: RecordFate) {
        self.records[fate as usize].inc();
    }

    /// Counts a refusal for lack of room.
    pub(crate) fn shed(&self, what: Shed) {
        self.sheds[what as usize].inc();
    }
}

/// The resident memory of this process in bytes, or `None` if the system does not report it.
pub(crate) fn resident_bytes() -> Option<i64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kib: i64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

/// An amount added to a gauge, which is subtracted again when this is dropped.
#[derive(Debug)]
pub(crate) struct GaugeGuard {
    gauge: Gauge,
    amount: i64,
}

impl GaugeGuard {
    pub(crate) fn new(gauge: &Gauge, amount: usize) -> Self {
        let amount = i64::try_from(amount).unwrap_or(i64::MAX);
        gauge.inc_by(amount);
        Self { gauge: gauge.clone(), amount }
    }
}

impl Drop for GaugeGuard {
    fn drop(&mut self) {
        self.gauge.dec_by(self.amount);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches an outcome or flag that is counted under another name.
    #[test]
    fn outcomes_and_flags_have_their_names() {
        use crate::proto::{Flag, Outcome};
        for (i, name) in OUTCOMES.into_iter().enumerate() {
            let outcome = Outcome::try_from(i as i32 + 1).unwrap();
            assert_eq!(outcome.as_str_name(), format!("OUTCOME_{}", name.to_uppercase()));
        }
        for (bit, name) in FLAGS.into_iter().enumerate() {
            let flag = Flag::try_from(1 << bit).unwrap();
            assert_eq!(flag.as_str_name(), format!("FLAG_{}", name.to_uppercase()));
        }
        let metrics = Metrics::default();
        metrics.answered([1, 2, 3, 4], &[0, 0b100_0001, 0b1]);
        let text = metrics.text();
        for line in [
            r#"hullcast_pairs_total{outcome="undecided"} 3"#,
            r#"hullcast_pair_flags_total{flag="estimated"} 2"#,
            r#"hullcast_pair_flags_total{flag="invalid_body"} 1"#,
            r#"hullcast_pair_flags_total{flag="reduced"} 0"#,
        ] {
            assert!(text.lines().any(|l| l == line), "{line} in {text}");
        }
    }
}

//! The counts of a load run.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::Duration;

use hdrhistogram::Histogram;

use super::levels::Level;
use super::sheet::LevelResult;
use crate::cli::values::counted;

/// What the loops of batches count.
pub(crate) const BATCH: &str = "batch";
/// What the loops of sessions count.
pub(crate) const STEP: &str = "step";

/// Counts of one loop, or of all loops together.
#[derive(Debug)]
pub(crate) struct Tally {
    /// Nanoseconds per batch, to three digits.
    latency: Histogram<u64>,
    pairs: u64,
    sent: u64,
    shed: u64,
    lost: u64,
    checked_batches: u64,
    checked_pairs: u64,
    wrong_batches: u64,
    /// Number of failed calls by their message.
    errors: BTreeMap<String, u64>,
}

impl Default for Tally {
    fn default() -> Self {
        let latency = Histogram::new(3).unwrap_or_else(|_| unreachable!("3 digits are allowed"));
        Self {
            latency,
            pairs: 0,
            sent: 0,
            shed: 0,
            lost: 0,
            checked_batches: 0,
            checked_pairs: 0,
            wrong_batches: 0,
            errors: BTreeMap::new(),
        }
    }
}

impl Tally {
    /// Counts a batch that is sent for the first time.
    pub(crate) fn sent(&mut self) {
        self.sent += 1;
    }

    /// Counts a batch that a busy server refused.
    pub(crate) fn shed(&mut self) {
        self.shed += 1;
    }

    /// Counts a server that was lost while it had a batch. The batch is sent again.
    pub(crate) fn lost(&mut self) {
        self.lost += 1;
    }

    /// Counts a batch that was answered.
    ///
    /// # Errors
    /// The histogram cannot get memory.
    pub(crate) fn answered(&mut self, pairs: u64, took: Duration) -> Result<(), hdrhistogram::RecordError> {
        self.pairs += pairs;
        self.latency.record(took.as_nanos() as u64)
    }

    /// Counts an answer that was checked.
    pub(crate) fn checked(&mut self, pairs: u64, right: bool) {
        self.checked_batches += 1;
        self.checked_pairs += pairs;
        self.wrong_batches += u64::from(!right);
    }

    /// Counts a call that failed.
    pub(crate) fn failed(&mut self, error: String) {
        *self.errors.entry(error).or_default() += 1;
    }

    /// Adds another loop's counts.
    ///
    /// # Errors
    /// The histogram cannot get memory.
    pub(crate) fn add(&mut self, other: Self) -> Result<(), hdrhistogram::AdditionError> {
        self.latency.add(other.latency)?;
        self.pairs += other.pairs;
        self.sent += other.sent;
        self.shed += other.shed;
        self.lost += other.lost;
        self.checked_batches += other.checked_batches;
        self.checked_pairs += other.checked_pairs;
        self.wrong_batches += other.wrong_batches;
        for (error, count) in other.errors {
            *self.errors.entry(error).or_default() += count;
        }
        Ok(())
    }

    /// The counts as text for display. `unit` is what is counted: a batch or a step.
    pub(crate) fn text(&self, title: &str, unit: &str, elapsed: Duration) -> String {
        let mut text = String::new();
        let seconds = elapsed.as_secs_f64();
        let milli = |quantile| self.latency.value_at_quantile(quantile) as f64 / 1e6;
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{title}");
        let _ = writeln!(
            text,
            "{}, {} in {seconds:.2} s: {:.0} pairs/s",
            counted(self.latency.len(), unit),
            counted(self.pairs, "pair"),
            self.pairs as f64 / seconds
        );
        let _ = writeln!(
            text,
            "latency ms: p50 {:.3}  p95 {:.3}  p99 {:.3}  max {:.3}",
            milli(0.5),
            milli(0.95),
            milli(0.99),
            self.latency.max() as f64 / 1e6
        );
        let _ = writeln!(
            text,
            "checked {}: {}, {}; {} wrong",
            if unit == STEP { "against new searches" } else { "bit for bit" },
            counted(self.checked_batches, unit),
            counted(self.checked_pairs, "pair"),
            self.wrong_batches
        );
        if self.shed > 0 {
            let _ = writeln!(text, "shed by a busy server: {}", self.shed);
        }
        if self.lost > 0 {
            let _ = writeln!(text, "sent again, their server lost: {}", self.lost);
        }
        let _ = writeln!(text, "errors: {}", self.errors.values().sum::<u64>());
        for (error, count) in &self.errors {
            let _ = writeln!(text, "  {count} x {error}");
        }
        text
    }

    /// The counts as one JSON object.
    ///
    /// # Errors
    /// No error is expected.
    pub(crate) fn json(&self, title: &str, elapsed: Duration) -> serde_json::Result<String> {
        let nanos = |quantile| self.latency.value_at_quantile(quantile);
        serde_json::to_string(&serde_json::json!({
            "title": title,
            "seconds": elapsed.as_secs_f64(),
            "batches": self.latency.len(),
            "pairs": self.pairs,
            "pairs_per_second": self.pairs as f64 / elapsed.as_secs_f64(),
            "latency_nanoseconds": {
                "p50": nanos(0.5), "p95": nanos(0.95), "p99": nanos(0.99), "max": self.latency.max(),
            },
            "checked_batches": self.checked_batches,
            "checked_pairs": self.checked_pairs,
            "wrong_batches": self.wrong_batches,
            "sent": self.sent,
            "shed": self.shed,
            "lost": self.lost,
            "errors": self.errors,
        }))
    }

    /// The row for a table of levels. `percentile` is the percentile by which the level is judged.
    pub(crate) fn row(&self, level: Level, elapsed: Duration, percentile: f64) -> LevelResult {
        let seconds = elapsed.as_secs_f64();
        let milli = |percent: f64| self.latency.value_at_percentile(percent) as f64 / 1e6;
        LevelResult {
            level,
            offered: self.sent as f64 / seconds,
            answered: self.latency.len() as f64 / seconds,
            pairs: self.pairs as f64 / seconds,
            latency: [50.0, 90.0, 95.0, 99.0, percentile].map(milli),
            shed: self.shed,
            errors: self.errors.values().sum(),
        }
    }

    /// Whether the run was clean.
    ///
    /// # Errors
    /// A description of the failures.
    pub(crate) fn verdict(&self) -> Result<(), String> {
        let errors: u64 = self.errors.values().sum();
        match (errors, self.wrong_batches, self.latency.len()) {
            (0, 0, 1..) => Ok(()),
            (0, 0, _) => Err("no batch was answered".into()),
            (errors, differing, _) => {
                Err(format!("{} failed, {} wrong", counted(errors, "call"), counted(differing, "answer")))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches counts that are lost when the loops' counts are added.
    #[test]
    fn loops_add_up() {
        let mut all = Tally::default();
        for millis in [1, 2, 30] {
            let mut one = Tally::default();
            one.answered(10, Duration::from_millis(millis)).unwrap();
            one.checked(10, true);
            all.add(one).unwrap();
        }
        let text = all.text("t", BATCH, Duration::from_secs(2));
        assert!(text.contains("3 batches, 30 pairs in 2.00 s: 15 pairs/s"), "{text}");
        assert!(text.contains("p50 2.0") && text.contains("3 batches, 30 pairs; 0 wrong"), "{text}");
        assert_eq!(all.verdict(), Ok(()));
    }

    /// Catches a run that counts as a success although a call failed, an answer was wrong, or no
    /// answer came.
    #[test]
    fn the_verdict_is_clean_only_when_all_was() {
        assert!(Tally::default().verdict().is_err());
        let mut wrong = Tally::default();
        wrong.answered(10, Duration::from_millis(1)).unwrap();
        wrong.checked(10, false);
        assert_eq!(wrong.verdict(), Err("0 calls failed, 1 answer wrong".into()));
        let mut failed = Tally::default();
        failed.answered(10, Duration::from_millis(1)).unwrap();
        failed.failed("Unavailable: busy".into());
        assert!(
            failed.verdict().is_err()
                && failed.text("t", BATCH, Duration::from_secs(1)).contains("1 x Unavailable")
        );
    }
}

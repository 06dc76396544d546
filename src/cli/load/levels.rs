//! The levels of load to measure: a range, or a search for the highest that is answered in time.

use std::str::FromStr;

/// `start:end:step`, as perf_analyzer writes it; end and step may be left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LevelRange {
    start: f64,
    end: f64,
    step: f64,
}

impl LevelRange {
    /// A range of a single level.
    pub(crate) fn one(value: u32) -> Self {
        Self { start: value.into(), end: value.into(), step: 1.0 }
    }
}

impl FromStr for LevelRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            "expected start:end:step or start:end or start: numbers above 0, end at least start, \
             10000 steps at most"
                .to_owned()
        };
        let numbers: Result<Vec<f64>, _> = text.split(':').map(str::parse).collect();
        let (start, end, step) = match numbers.map_err(|_| wrong())?[..] {
            [start] => (start, start, 1.0),
            [start, end] => (start, end, 1.0),
            [start, end, step] => (start, end, step),
            _ => return Err(wrong()),
        };
        let good = start > 0.0 && end >= start && step > 0.0 && end.is_finite();
        let most = (end - start) / step <= 10_000.0;
        if good && most { Ok(Self { start, end, step }) } else { Err(wrong()) }
    }
}

/// The load of one measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Level {
    /// The number of batches in flight at once. The next batch is sent when one is answered.
    Concurrency(u32),
    /// Batches per second, sent whether or not earlier ones are answered.
    Rate(f64),
}

impl Level {
    /// The number for tables.
    pub(crate) fn value(self) -> f64 {
        match self {
            Self::Concurrency(count) => f64::from(count),
            Self::Rate(rate) => rate,
        }
    }

    /// The name for tables.
    pub(crate) fn kind(self) -> &'static str {
        match self {
            Self::Concurrency(_) => "concurrency",
            Self::Rate(_) => "request rate",
        }
    }
}

/// The levels to measure, in order. Each may depend on the result of the previous one.
#[derive(Clone, Debug)]
pub(crate) enum Plan {
    /// The levels of a range, up to the first that is too slow.
    Sweep { make: fn(f64) -> Level, range: LevelRange, next: f64 },
    /// A search between the highest level that was in time and the lowest that was not.
    Search { make: fn(f64) -> Level, step: f64, good: f64, bad: f64, first: bool },
    /// No more levels.
    Done,
}

impl Plan {
    pub(crate) fn new(make: fn(f64) -> Level, range: LevelRange, binary_search: bool) -> Self {
        if !binary_search {
            return Self::Sweep { make, range, next: range.start };
        }
        Self::Search { make, step: range.step, good: range.start, bad: range.end, first: true }
    }

    /// The next level, or `None` at the end.
    pub(crate) fn level(&self) -> Option<Level> {
        match *self {
            // The end may be exceeded by half a step, because rounding must not lose the last
            // level.
            Self::Sweep { make, range, next } => (next <= range.end + range.step / 2.0).then(|| make(next)),
            Self::Search { make, good, first: true, .. } => Some(make(good)),
            Self::Search { make, step, good, bad, .. } => {
                let steps = ((bad - good) / step).floor();
                (steps >= 1.0).then(|| make(good + step * (steps / 2.0).ceil()))
            }
            Self::Done => None,
        }
    }

    /// Records whether the level that was measured was in time.
    pub(crate) fn went(&mut self, level: Level, in_time: bool) {
        match self {
            Self::Sweep { range, next, .. } if in_time => *next += range.step,
            // If the first level is too slow, the search ends, because there is no lower level.
            Self::Search { first, .. } if *first && in_time => *first = false,
            Self::Search { good, first: false, .. } if in_time => *good = level.value(),
            Self::Search { bad, step, first: false, .. } => *bad = level.value() - *step,
            _ => *self = Self::Done,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rates(plan: &mut Plan, limit: f64) -> Vec<f64> {
        let mut measured = Vec::new();
        while let Some(level) = plan.level() {
            measured.push(level.value());
            plan.went(level, level.value() <= limit);
            assert!(measured.len() < 100, "{measured:?}");
        }
        measured
    }

    fn range(text: &str) -> LevelRange {
        text.parse().unwrap()
    }

    /// Catches a sweep that misses its end, or goes on once it is too slow.
    #[test]
    fn sweeps_go_to_their_end_or_to_the_limit() {
        let sweep = |text| Plan::new(Level::Rate, range(text), false);
        assert_eq!(rates(&mut sweep("1:2:0.1"), 9.0).len(), 11);
        assert_eq!(rates(&mut sweep("5"), 9.0), [5.0]);
        assert_eq!(rates(&mut sweep("1:3"), 9.0), [1.0, 2.0, 3.0]);
        assert_eq!(rates(&mut sweep("10:100:10"), 25.0), [10.0, 20.0, 30.0]);
        for bad in ["", "0", "3:1", "1:2:0", "1:inf", "a", "1:2:3:4", "1:1e9:0.001"] {
            assert!(bad.parse::<LevelRange>().is_err(), "{bad}");
        }
    }

    /// Catches a search that ends next to the answer, measures a level twice, or never ends.
    #[test]
    fn searches_find_the_most_that_is_in_time() {
        for limit in 10..=200 {
            let mut search = Plan::new(Level::Rate, range("10:170:10"), true);
            let measured = rates(&mut search, f64::from(limit));
            let best = measured.iter().copied().filter(|rate| *rate <= f64::from(limit)).fold(0.0, f64::max);
            assert_eq!(best, f64::from((limit / 10 * 10).min(170)), "{measured:?}");
            assert!(measured.len() <= 7, "{measured:?}");
            let mut once = measured.clone();
            once.sort_by(f64::total_cmp);
            once.dedup();
            assert_eq!(once.len(), measured.len(), "{measured:?}");
        }
        assert_eq!(rates(&mut Plan::new(Level::Rate, range("10:170:10"), true), 5.0), [10.0]);
    }
}

//! Sorting that looks at a stop flag: runs that are sorted by themselves, then merged pair by
//! pair. It takes O(n log n) steps and room for the keys twice.

use crate::contact::{Stop, Stopped};

/// Keys that are sorted without a look: about 1 ms.
const RUN: usize = 1 << 15;

/// Steps of sorting a key within its run, and of merging it once.
const RUN_STEPS: u64 = 25;
const MERGE_STEPS: u64 = 4;

/// The estimated steps of sorting a number of keys.
pub(super) fn steps(keys: usize) -> u64 {
    let merges = u64::from(keys.div_ceil(RUN).next_power_of_two().ilog2());
    keys as u64 * (RUN_STEPS + MERGE_STEPS * merges)
}

/// The distinct keys, in ascending order.
pub(super) fn sorted(mut keys: Vec<u64>, stop: &Stop) -> Result<Vec<u64>, Stopped> {
    for run in keys.chunks_mut(RUN) {
        run.sort_unstable();
        stop.spend(run.len() as u64 * RUN_STEPS)?;
    }
    let mut merged = Vec::new();
    let mut length = RUN;
    while length < keys.len() {
        merged.clear();
        merged.reserve_exact(keys.len());
        for two in keys.chunks(2 * length) {
            let (one, other) = two.split_at(length.min(two.len()));
            merge(one, other, &mut merged, stop)?;
        }
        std::mem::swap(&mut keys, &mut merged);
        length *= 2;
    }
    drop(merged);
    keys.dedup();
    Ok(keys)
}

/// Appends two sorted runs to `merged`.
fn merge(mut one: &[u64], mut other: &[u64], merged: &mut Vec<u64>, stop: &Stop) -> Result<(), Stopped> {
    while !one.is_empty() || !other.is_empty() {
        let before = merged.len();
        let (mut i, mut j) = (0, 0);
        while i + j < RUN {
            match (one.get(i), other.get(j)) {
                (Some(&a), Some(&b)) if a <= b => (merged.push(a), i += 1),
                (Some(&a), None) => (merged.push(a), i += 1),
                (_, Some(&b)) => (merged.push(b), j += 1),
                (None, None) => break,
            };
        }
        (one, other) = (&one[i..], &other[j..]);
        stop.spend((merged.len() - before) as u64 * MERGE_STEPS)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches keys that are lost, doubled or out of order where runs meet, and a run that is too
    /// long to be stopped.
    #[test]
    fn runs_of_any_length_are_sorted() {
        for count in [0, 1, 2, RUN - 1, RUN, RUN + 1, 3 * RUN, 5 * RUN + 17] {
            let keys: Vec<u64> =
                (0..count as u64).map(|i| i.wrapping_mul(0x9E37_79B9_7F4A_7C15) % 100_003).collect();
            let mut expected = keys.clone();
            expected.sort_unstable();
            expected.dedup();
            let stop = Stop::default();
            assert_eq!(sorted(keys.clone(), &stop), Ok(expected), "{count}");
            assert!(stop.largest_between_looks() <= RUN as u64 * RUN_STEPS);
            assert!(stop.steps() <= steps(count), "{count}: {stop:?}");
            stop.stop();
            assert_eq!(sorted(keys, &stop).is_err(), count > 0);
        }
    }
}

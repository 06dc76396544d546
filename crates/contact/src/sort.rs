//! A sort that can be stopped.
//!
//! The sort of the standard library cannot be interrupted, and it takes milliseconds for 100,000
//! points. So a long list is sorted in runs, and the runs are merged two by two (bottom-up merge
//! sort; D. E. Knuth, *The Art of Computer Programming*, volume 3, section 5.2.4). The meter is
//! checked between the runs and while they are merged. The sort takes `O(n log n)` time and memory
//! for a second list.

use std::cmp::Ordering;

use super::stop::{Meter, Stopped};

/// The number of items that are sorted without a check. Sorting them takes well below a millisecond.
const RUN: usize = 4096;
/// Steps to compare and move items whose keys are looked up in another list, as for points.
pub const COMPARISON: u64 = 6;

/// The estimated steps to sort `items` items, if a comparison and the moves that it causes take
/// `comparison` steps. The broad phase uses this estimate.
pub fn steps(items: usize, comparison: u64) -> u64 {
    let merges = items.div_ceil(RUN).next_power_of_two().ilog2();
    comparison * items as u64 * u64::from(RUN.ilog2() + merges)
}

/// Sorts `items` by `order`, in which no two different items may be equal. `comparison` is the
/// number of steps of one comparison and the moves that it causes.
///
/// # Errors
/// The computation was stopped. The items are then in no particular order.
pub fn sort<T: Copy>(
    items: &mut Vec<T>,
    meter: &Meter<'_>,
    comparison: u64,
    order: impl Fn(&T, &T) -> Ordering,
) -> Result<(), Stopped> {
    for run in items.chunks_mut(RUN) {
        meter.spend(comparison * run.len() as u64 * u64::from(run.len().ilog2()))?;
        run.sort_unstable_by(&order);
    }
    let mut merged = Vec::new();
    let mut length = RUN;
    while length < items.len() {
        merged.clear();
        merged.reserve_exact(items.len());
        for two in items.chunks(2 * length) {
            let (mut left, mut right) = two.split_at(length.min(two.len()));
            while let (Some(first), Some(second)) = (left.first(), right.first()) {
                meter.spend(comparison)?;
                if order(first, second).is_le() {
                    merged.push(*first);
                    left = &left[1..];
                } else {
                    merged.push(*second);
                    right = &right[1..];
                }
            }
            merged.extend_from_slice(left);
            merged.extend_from_slice(right);
        }
        std::mem::swap(items, &mut merged);
        length *= 2;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stop::{STEPS_BETWEEN_LOOKS, Stop};
    use crate::workload::Random;

    /// Catches a run that is left out, merged twice or merged in the wrong order, and a sort that is
    /// never interrupted. The lengths are around the boundaries between runs.
    #[test]
    fn long_lists_are_sorted_and_the_sort_can_be_stopped() {
        let mut random = Random::new(1);
        for length in [0, 1, 2, RUN - 1, RUN, RUN + 1, 2 * RUN, 2 * RUN + 1, 5 * RUN + 7, 40 * RUN] {
            let mut items: Vec<(u64, u32)> = (0..length as u32).map(|i| (random.bits() % 1000, i)).collect();
            let mut expected = items.clone();
            expected.sort_unstable();
            let stop = Stop::default();
            assert_eq!(sort(&mut items, &Meter::new(&stop), COMPARISON, Ord::cmp), Ok(()));
            assert!(stop.steps() <= steps(length, COMPARISON), "{length}: {stop:?}");
            assert_eq!(items, expected);
            assert!(stop.largest_between_looks() <= STEPS_BETWEEN_LOOKS);
            if length > 5 * RUN {
                let stop = Stop::default();
                stop.stop();
                assert_eq!(sort(&mut items, &Meter::new(&stop), COMPARISON, Ord::cmp), Err(Stopped));
                assert!(stop.steps() <= 2 * STEPS_BETWEEN_LOOKS);
            }
        }
    }
}

//! Estimates the cost of a batch's pairs before they are computed.

use super::Batch;
use crate::contact::estimated_steps;

/// Steps of a pair in addition to its computation. A pair that is not computed, because a hull or
/// a pose is missing, takes only these.
pub(super) const LEAST_STEPS: u64 = 50;

impl Batch {
    /// The estimated steps of a pair.
    pub(super) fn pair_steps(&self, pair: usize) -> u64 {
        let hull = |side: usize| {
            let body = self.pairs()[2 * pair + side];
            self.hulls[self.setting.body_hulls[body as usize] as usize].as_ref().ok()
        };
        match (hull(0), hull(1)) {
            (Some(a), Some(b)) => estimated_steps(a, b),
            _ => LEAST_STEPS,
        }
    }

    /// The estimated steps of the most expensive pair that the hulls can form. No pair costs more
    /// than the most expensive hull with itself.
    pub(super) fn most_steps(&self) -> u64 {
        let hulls = self.hulls.iter().filter_map(|hull| hull.as_ref().ok());
        hulls.map(|hull| estimated_steps(hull, hull)).max().unwrap_or(LEAST_STEPS)
    }
}

//! Reduces the points of a patch to a few.
//!
//! The points are the corners of a convex polygon. The first one kept is the deepest. Then the method
//! repeatedly keeps the point that adds the most area to the polygon of the points kept so far.
//!
//! ```text
//!       2 . . . 3         Kept: 0 and 3. The gap from 0 to 3 holds 1 and 2; 2 is farther from the
//!      .        |         line 0-3 and is that gap's best. Keeping it splits the gap into 0-2,
//!     1         |         which holds 1, and 2-3, which is empty.
//!      .        |
//!        0 ---- 4
//! ```
//!
//! On a convex outline a point adds area only to its own *gap*, between the kept points before and
//! after it. So each gap stores its best point, the gaps wait in a heap, and keeping a point splits
//! one gap in two. Only those two search for their best points again. Splitting at the farthest point
//! is the idea of D. H. Douglas and T. K. Peucker, *Algorithms for the reduction of the number of
//! points required to represent a digitized line or its caricature*, 1973,
//! doi:10.3138/FM57-6770-U75U-7727.
//!
//! Keeping `k` of `n` points typically takes `O(n log k)` time, and `O(n k)` in the worst case.

use std::{cmp::Ordering, collections::BinaryHeap};

use super::intersection::PlanePoint;

/// Buffers, reused from pair to pair.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    kept: Vec<bool>,
    gaps: BinaryHeap<Gap>,
    /// Points examined since the last [`Scratch::take_looked_at`].
    looked_at: u64,
}

impl Scratch {
    pub(crate) fn take_looked_at(&mut self) -> u64 {
        std::mem::take(&mut self.looked_at)
    }
}

/// The points between two neighbouring kept points, and the best of them.
#[derive(Debug)]
struct Gap {
    /// Twice the area that the best point adds. With only one kept point it is the squared distance
    /// from that point.
    area: f64,
    best: usize,
    from: usize,
    to: usize,
}

impl PartialEq for Gap {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Gap {}

impl PartialOrd for Gap {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Gap {
    /// Compares the areas. With equal areas the gap whose best point has the lower index is greater.
    fn cmp(&self, other: &Self) -> Ordering {
        self.area.total_cmp(&other.area).then(other.best.cmp(&self.best))
    }
}

/// Keeps `max` of the points, without changing their order, and returns the fraction of the polygon's
/// area that is left (1 if the polygon has no area).
///
/// The first point kept is the deepest; among points within `rounding` of it the one with the lowest
/// id. The second is the one farthest from the first. Each further one is the point that adds the most
/// area to the polygon of those kept.
pub(crate) fn reduce(points: &mut Vec<PlanePoint>, max: usize, rounding: f64, scratch: &mut Scratch) -> f64 {
    let whole = doubled_area(points);
    let depth = |p: &PlanePoint| p.height_b - p.height_a;
    let deepest = points.iter().map(depth).fold(f64::INFINITY, f64::min);
    let first = (0..points.len())
        .filter(|&i| depth(&points[i]) <= deepest + rounding)
        .min_by_key(|&i| points[i].id)
        .unwrap_or(0);
    let Scratch { kept, gaps, looked_at } = scratch;
    kept.clear();
    kept.resize(points.len(), false);
    kept[first] = true;
    gaps.clear();
    gaps.extend(gap(points, first, first, looked_at));
    for _ in 1..max {
        let Some(Gap { best, from, to, .. }) = gaps.pop() else { break };
        kept[best] = true;
        gaps.extend(gap(points, from, best, looked_at));
        gaps.extend(gap(points, best, to, looked_at));
    }
    let mut index = 0..;
    points.retain(|_| index.next().is_some_and(|i: usize| kept[i]));
    if whole > 0.0 { (doubled_area(points) / whole).clamp(0.0, 1.0) } else { 1.0 }
}

/// The gap between two kept points, or the gap around a single one if `from` is `to`. None if there
/// are no points in it.
fn gap(points: &[PlanePoint], from: usize, to: usize, looked_at: &mut u64) -> Option<Gap> {
    let (p, q) = (points[from].at, points[to].at);
    let added = |i: usize| {
        let at = points[i].at;
        if from == to { at.distance_squared(p) } else { (q - p).perp_dot(at - p).abs() }
    };
    let following = |i: usize| if i + 1 == points.len() { 0 } else { i + 1 };
    let mut best: Option<Gap> = None;
    let mut i = following(from);
    while i != to {
        *looked_at += 1;
        let here = Gap { area: added(i), best: i, from, to };
        if best.as_ref().is_none_or(|best| here > *best) {
            best = Some(here);
        }
        i = following(i);
    }
    best
}

/// Twice the area of a convex polygon whose corners are given in order.
fn doubled_area(points: &[PlanePoint]) -> f64 {
    let [first, rest @ ..] = points else { return 0.0 };
    rest.windows(2).map(|two| (two[0].at - first.at).perp_dot(two[1].at - first.at)).sum::<f64>().abs()
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;
    use crate::manifold::Element;
    use crate::workload::Random;

    /// The definition: every round compares every point.
    fn reduce_slowly(points: &[PlanePoint], max: usize) -> Vec<u32> {
        let at = |i: usize| points[i].at;
        let mut kept = vec![0];
        while kept.len() < max.min(points.len()) {
            let added = |i: usize| {
                let after = kept.iter().position(|&k| k > i).unwrap_or(0);
                let before = (after + kept.len() - 1) % kept.len();
                let (p, q) = (at(kept[before]), at(kept[after]));
                if kept.len() == 1 { at(i).distance_squared(p) } else { (q - p).perp_dot(at(i) - p).abs() }
            };
            let rest = (0..points.len()).filter(|i| !kept.contains(i));
            let better = |&i: &usize, &j: &usize| added(i).total_cmp(&added(j)).then(j.cmp(&i));
            let Some(next) = rest.max_by(better) else { break };
            kept.push(next);
            kept.sort_unstable();
        }
        kept.iter().map(|&i| i as u32).collect()
    }

    /// Catches a gap that is searched on the wrong side, a gap that is lost or not split, and a tie that
    /// goes to another point. On regular polygons every round has ties.
    #[test]
    fn gaps_keep_the_points_that_comparing_all_keeps() {
        let mut random = Random::new(41);
        let mut scratch = Scratch::default();
        let mut dropped = 0;
        for round in 0..600 {
            let count = 5 + random.below(60);
            let point = |i: usize| {
                let jitter = if round % 2 == 0 { 0.0 } else { random.within(-0.2, 0.2) };
                let angle = std::f64::consts::TAU * (i as f64 + jitter) / count as f64;
                let at = DVec2::from_angle(angle) * DVec2::new(4.0, 3.0);
                // The first point is the deepest.
                let height_b = if i == 0 { -1.0 } else { 0.0 };
                PlanePoint { at, height_a: 0.0, height_b, id: [Element::Vertex(i as u32), Element::Inside] }
            };
            let mut points: Vec<PlanePoint> = (0..count).map(point).collect();
            let max = 1 + random.below(count);
            let expected = reduce_slowly(&points, max);
            let share = reduce(&mut points, max, 1e-12, &mut scratch);
            let kept: Vec<u32> =
                points.iter().map(|p| if let Element::Vertex(v) = p.id[0] { v } else { u32::MAX }).collect();
            assert_eq!(kept, expected);
            assert!((0.0..=1.0).contains(&share));
            dropped += count - kept.len();
        }
        assert!(dropped > 5000, "{dropped}");
        assert!(scratch.take_looked_at() > 0);
    }
}

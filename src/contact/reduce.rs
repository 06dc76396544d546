//! Reduction of a patch to a few points.
//!
//! Points are kept one at a time, always the one that adds most area to the polygon of those
//! kept. On a convex outline a point adds area to the one gap that it is in: between the kept
//! point before it and the one after it. So each gap knows its best point, the gaps wait in a
//! heap, and a new point only splits its own gap in two, which look for their best points again
//! (the Douglas-Peucker idea of cutting at the farthest point; doi:10.3138/FM57-6770-U75U-7727).
//! `n` points of which `k` are kept take about `n log k`, and `n k` at worst.

use std::{cmp::Ordering, collections::BinaryHeap};

use super::intersection::PlanePoint;

/// Buffers.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    kept: Vec<bool>,
    gaps: BinaryHeap<Gap>,
    /// Points that were looked at since they were last taken.
    looked_at: u64,
}

impl Scratch {
    pub(crate) fn take_looked_at(&mut self) -> u64 {
        std::mem::take(&mut self.looked_at)
    }
}

/// The points between two kept ones, and the best of them.
#[derive(Debug)]
struct Gap {
    /// The area that the best adds, doubled; with one kept point its distance squared.
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
    /// If two are equal, the lower point is the better.
    fn cmp(&self, other: &Self) -> Ordering {
        self.area.total_cmp(&other.area).then(other.best.cmp(&self.best))
    }
}

/// Keeps `max` of more points, in their order: the deepest (within `rounding` of
/// it the lowest id), then, one at a time, the one that adds most area to the
/// polygon of those kept; the second is the one farthest from the first.
/// The share of the polygon's area that is left; 1 where it has none.
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

/// The gap between two kept points, or around the only one; none without points in it.
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

/// The doubled area of a convex polygon, its corners in order.
fn doubled_area(points: &[PlanePoint]) -> f64 {
    let [first, rest @ ..] = points else { return 0.0 };
    rest.windows(2).map(|two| (two[0].at - first.at).perp_dot(two[1].at - first.at)).sum::<f64>().abs()
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;
    use crate::contact::manifold::Element;
    use crate::workload::Random;

    /// The definition: every point is compared in every round.
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

    /// Catches a gap that is looked for on the wrong side, one lost or not split, and a tie that
    /// goes to another point: on regular polygons every round ties.
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
                // The first is the deepest.
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

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
    /// Of equals the lower point is the better.
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

/// Of a convex polygon, its corners in order.
fn doubled_area(points: &[PlanePoint]) -> f64 {
    let [first, rest @ ..] = points else { return 0.0 };
    rest.windows(2).map(|two| (two[0].at - first.at).perp_dot(two[1].at - first.at)).sum::<f64>().abs()
}

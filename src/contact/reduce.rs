//! Reduction of a patch to a few points.

use super::intersection::PlanePoint;

/// Keeps `max` of more points, in their order: the deepest (within `rounding` of
/// it the lowest id), then, one at a time, the one that adds most area to the
/// polygon of those kept; the second is the one farthest from the first.
/// `kept` is a buffer. The share of the polygon's area that is left; 1 where it has none.
pub(crate) fn reduce(points: &mut Vec<PlanePoint>, max: usize, rounding: f64, kept: &mut Vec<usize>) -> f64 {
    let whole = doubled_area(points);
    let depth = |p: &PlanePoint| p.height_b - p.height_a;
    let deepest = points.iter().map(depth).fold(f64::INFINITY, f64::min);
    let first = (0..points.len())
        .filter(|&i| depth(&points[i]) <= deepest + rounding)
        .min_by_key(|&i| points[i].id)
        .unwrap_or(0);
    kept.clear();
    kept.push(first);
    while kept.len() < max {
        let rest = (0..points.len()).filter(|i| !kept.contains(i));
        let next = rest.max_by(|&i, &j| {
            // Of equals the lower index: max_by keeps the last.
            added_area(points, kept, i).total_cmp(&added_area(points, kept, j)).then(j.cmp(&i))
        });
        let Some(next) = next else { break };
        kept.push(next);
        kept.sort_unstable();
    }
    let mut index = 0..;
    points.retain(|_| index.next().is_some_and(|i| kept.contains(&i)));
    if whole > 0.0 { (doubled_area(points) / whole).clamp(0.0, 1.0) } else { 1.0 }
}

/// Of a convex polygon, its corners in order.
fn doubled_area(points: &[PlanePoint]) -> f64 {
    let [first, rest @ ..] = points else { return 0.0 };
    rest.windows(2).map(|two| (two[0].at - first.at).perp_dot(two[1].at - first.at)).sum::<f64>().abs()
}

/// Doubled area that point `i` adds to the polygon of the kept points, all on
/// one convex outline in index order; with one kept point the distance squared.
fn added_area(points: &[PlanePoint], kept: &[usize], i: usize) -> f64 {
    let after = kept.iter().position(|&k| k > i).unwrap_or(0);
    let before = (after + kept.len() - 1) % kept.len();
    let (p, q) = (points[kept[before]].at, points[kept[after]].at);
    let at = points[i].at;
    if kept.len() == 1 { at.distance_squared(p) } else { (q - p).perp_dot(at - p).abs() }
}

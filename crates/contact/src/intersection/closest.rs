//! The estimated contact point of two projected features that miss each other.
//!
//! The point is midway between the closest points of both projections. One of the closest points can
//! always be taken at a corner, so they are found among all pairs of a corner of one projection and a
//! side of the other. If several pairs are equally near (parallel sides), the point is in the middle of
//! the closest set, so that it moves continuously with the bodies.
//!
//! ```text
//! small: candidates = all corners and sides
//! large: u = direction from A to B, by GJK in the plane
//!        candidates = corners and sides that may belong to the closest pair, given u
//! the closest pairs of a corner and a side of the candidates; the middle of the closest set
//! ```
//!
//! The bound for large polygons: let `gap` be the distance of the polygons along the unit direction
//! `u`. A corner of A that is `x` below A's farthest, and a side of B that is `y` beyond B's nearest,
//! are at least `gap + x + y` apart. So a pair with a larger sum than the closest distance known cannot
//! be the closest, whatever `u` is; the better `u` is, the fewer pairs are left. GJK (E. G. Gilbert,
//! D. W. Johnson and S. S. Keerthi, 1988, doi:10.1109/56.2083) finds a good `u` in a few rounds of
//! `O(n + m)`.

use glam::DVec2;

use super::PlanePoint;
use super::clip::are_large;
use super::outline::{Corner, Outline};
use crate::manifold::Element;
use crate::tolerance::{MERGE, U};

/// A pair of near points, one on A and one on B, with the features that they lie on.
#[derive(Clone, Copy, Debug)]
struct NearPoints {
    a: DVec2,
    b: DVec2,
    height_a: f64,
    height_b: f64,
    id: [Element; 2],
}

/// The result of the search.
pub(super) struct Closest {
    /// The point midway between the closest points.
    pub(super) point: PlanePoint,
    /// The distance between the projections.
    pub(super) gap: f64,
    /// The number of pairs and corners that were examined.
    pub(super) looked_at: u64,
}

/// The point midway between the closest points of both projections, or the middle of the closest set
/// if that is not unique. Each witness is lifted onto its own feature.
pub(super) fn estimate(a: &Outline, b: &Outline, eps: f64, scratch: &mut Scratch) -> Closest {
    let Scratch { nearest, candidates } = scratch;
    if !are_large(a, b) {
        candidates.all(a, b);
        return among(a, b, eps, nearest, candidates);
    }
    let mut looked_at = 0;
    let (u, distance) = direction(a, b, &mut looked_at);
    looked_at += candidates.choose(a, b, u, distance + eps);
    let mut closest = among(a, b, eps, nearest, candidates);
    if closest.gap > distance + eps {
        // The polygons overlap slightly, so no corner is as near to a side as the distance found.
        looked_at += closest.looked_at + candidates.choose(a, b, u, closest.gap + eps);
        closest = among(a, b, eps, nearest, candidates);
    }
    Closest { looked_at: closest.looked_at + looked_at, ..closest }
}

/// The estimated point among all pairs of candidates.
fn among(
    a: &Outline,
    b: &Outline,
    eps: f64,
    nearest: &mut Vec<NearPoints>,
    candidates: &Candidates,
) -> Closest {
    nearest.clear();
    let mut least = f64::INFINITY;
    let mut looked_at = 0;
    each_pair(a, b, candidates, |near| {
        looked_at += 1;
        let distance = near.a.distance(near.b);
        if distance < least - eps {
            nearest.clear();
        }
        if distance <= least + eps {
            nearest.push(near);
        }
        least = least.min(distance);
    });
    nearest.retain(|near| near.a.distance(near.b) <= least + eps);
    // If several pairs are equally near, take the two ends of the closest set.
    let across = nearest.first().map_or(DVec2::X, |near| (near.b - near.a).perp());
    let key = |near: &&NearPoints| across.dot(near.a + near.b);
    let first = nearest.iter().min_by(|p, q| key(p).total_cmp(&key(q)));
    let last = nearest.iter().max_by(|p, q| key(p).total_cmp(&key(q)));
    let point = match (first, last) {
        (Some(p), Some(q)) => PlanePoint {
            at: 0.25 * (p.a + p.b + q.a + q.b),
            height_a: 0.5 * (p.height_a + q.height_a),
            height_b: 0.5 * (p.height_b + q.height_b),
            id: p.id.min(q.id),
        },
        _ => PlanePoint {
            at: 0.5 * (a.corners[0].at + b.corners[0].at),
            height_a: a.corners[0].height,
            height_b: b.corners[0].height,
            id: [Element::Vertex(a.corners[0].vertex), Element::Vertex(b.corners[0].vertex)],
        },
    };
    Closest { point, gap: least, looked_at }
}

/// Buffers, reused from pair to pair.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    nearest: Vec<NearPoints>,
    candidates: Candidates,
}

/// The corners and sides of A and of B whose pairs are examined, in ascending order.
#[derive(Debug, Default)]
struct Candidates {
    corners: [Vec<usize>; 2],
    sides: [Vec<usize>; 2],
    /// How far each corner is below the farthest one.
    depths: Vec<f64>,
}

/// The largest number of corners, and of sides, of a large polygon that are examined. Only polygons of
/// about the size of the merge distance have more that are as near.
const MOST: usize = 64;

impl Candidates {
    fn all(&mut self, a: &Outline, b: &Outline) {
        for (outline, i) in [(a, 0), (b, 1)] {
            self.corners[i].clear();
            self.corners[i].extend(0..outline.corners.len());
            self.sides[i].clear();
            self.sides[i].extend(0..outline.side_count());
        }
    }

    /// Chooses the corners and sides of two large polygons that may belong to a pair within `distance` of
    /// each other. The choice is valid for any unit direction `u` from A to B. Returns the number of
    /// corners that it examined.
    #[cold]
    fn choose(&mut self, a: &Outline, b: &Outline, u: DVec2, distance: f64) -> u64 {
        let top = |outline: &Outline, u: DVec2| {
            outline.corners.iter().map(|c| u.dot(c.at)).fold(f64::NEG_INFINITY, f64::max)
        };
        let (top_a, top_b) = (top(a, u), top(b, -u));
        // Each height has an error of a few roundoffs.
        let rounding = MERGE * U * (top_a.abs() + top_b.abs() + distance);
        let most = distance + (top_a + top_b) + rounding;
        for (outline, u, top, i) in [(a, u, top_a, 0), (b, -u, top_b, 1)] {
            self.depths.clear();
            self.depths.extend(outline.corners.iter().map(|c| top - u.dot(c.at)));
            let depth = |i: usize| self.depths[i];
            choose(&mut self.corners[i], self.depths.len(), most, depth);
            let side_depth = |i: usize| depth(i).min(depth(outline.next(i)));
            choose(&mut self.sides[i], self.depths.len(), most, side_depth);
        }
        4 * (a.corners.len() + b.corners.len()) as u64
    }
}

/// Chooses those of `count` items whose depth is at most `most`. If there are more than [`MOST`], chooses
/// the [`MOST`] items of least depth. The chosen items are in ascending order.
fn choose(chosen: &mut Vec<usize>, count: usize, most: f64, depth: impl Fn(usize) -> f64) {
    chosen.clear();
    chosen.extend((0..count).filter(|&i| depth(i) <= most));
    if chosen.len() > MOST {
        chosen.select_nth_unstable_by(MOST, |&i, &j| depth(i).total_cmp(&depth(j)).then(i.cmp(&j)));
        chosen.truncate(MOST);
        chosen.sort_unstable();
    }
}

/// Largest number of rounds of the search for the direction. It ends as soon as a round brings no
/// improvement.
const ROUNDS: u32 = 64;

/// A unit direction from A to B along which their distance is nearly the true one, and the distance
/// between two of their points.
fn direction(a: &Outline, b: &Outline, looked_at: &mut u64) -> (DVec2, f64) {
    let farthest = |outline: &Outline, u: DVec2| {
        let higher = |best: DVec2, c: &Corner| if u.dot(c.at) > u.dot(best) { c.at } else { best };
        outline.corners.iter().fold(outline.corners[0].at, higher)
    };
    // The points are B's minus A's. `nearest` is the point nearest to the origin on the last segment.
    let mut nearest = b.corners[0].at - a.corners[0].at;
    let mut segment = [nearest; 2];
    for _ in 0..ROUNDS {
        *looked_at += (a.corners.len() + b.corners.len()) as u64;
        let u = nearest.normalize_or(DVec2::X);
        let new = farthest(b, -u) - farthest(a, u);
        let (_, foot, end) = segment
            .map(|end| (end, foot(end, new)))
            .map(|(end, foot)| (foot.length_squared(), foot, end))
            .into_iter()
            .fold((f64::INFINITY, nearest, new), |best, next| if next.0 < best.0 { next } else { best });
        if !(foot.length_squared() < nearest.length_squared()) {
            break;
        }
        (nearest, segment) = (foot, [end, new]);
    }
    (nearest.normalize_or(DVec2::X), nearest.length())
}

/// The point of a segment nearest to the origin.
fn foot(from: DVec2, to: DVec2) -> DVec2 {
    let whole = to - from;
    let share = (-from.dot(whole) / whole.length_squared()).clamp(0.0, 1.0);
    if share.is_nan() { from } else { from + share * whole }
}

/// Visits, for each candidate corner of one outline, its nearest point on each candidate side of the
/// other (or on its only corner).
fn each_pair(a: &Outline, b: &Outline, candidates: &Candidates, mut visit: impl FnMut(NearPoints)) {
    let Candidates { corners: [corners_a, corners_b], sides: [sides_a, sides_b], .. } = candidates;
    for c in corners_a.iter().map(|&i| &a.corners[i]) {
        each_nearest(b, sides_b, c.at, |at, height, id| {
            let id = [Element::Vertex(c.vertex), id];
            visit(NearPoints { a: c.at, b: at, height_a: c.height, height_b: height, id });
        });
    }
    for c in corners_b.iter().map(|&i| &b.corners[i]) {
        each_nearest(a, sides_a, c.at, |at, height, id| {
            let id = [id, Element::Vertex(c.vertex)];
            visit(NearPoints { a: at, b: c.at, height_a: height, height_b: c.height, id });
        });
    }
}

fn each_nearest(outline: &Outline, sides: &[usize], from: DVec2, mut visit: impl FnMut(DVec2, f64, Element)) {
    if let [only] = outline.corners.as_slice() {
        visit(only.at, only.height, Element::Vertex(only.vertex));
    }
    for &i in sides {
        let [p, q] = outline.side(i);
        let whole = q.at - p.at;
        let share = ((from - p.at).dot(whole) / whole.length_squared()).clamp(0.0, 1.0);
        if !(share > 0.0) {
            visit(p.at, p.height, Element::Vertex(p.vertex));
        } else if share < 1.0 {
            visit(p.at + share * whole, p.height + share * (q.height - p.height), outline.side_name(i));
        } else {
            visit(q.at, q.height, Element::Vertex(q.vertex));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::intersection::outline::random_polygon;
    use crate::workload::Random;

    /// Polygons that are apart, with parallel sides and opposite corners among them: the chosen pairs must
    /// give the result of all pairs, bit for bit. Catches a direction so wrong that the closest pair is left
    /// out, and a bound that does not allow for rounding.
    #[test]
    fn few_pairs_give_what_all_pairs_give() {
        let mut random = Random::new(31);
        let mut scratch = Scratch::default();
        let (mut compared, mut looked_at, mut all) = (0, 0, 0);
        for round in 0..2000 {
            let [of_a, of_b] = [(); 2].map(|()| 40 + random.below(80));
            let (a, mut b) = (random_polygon(&mut random, of_a, 0), random_polygon(&mut random, of_b, 1000));
            if round % 2 == 0 {
                // The polygon is A rotated by half a turn, so that opposite sides are parallel.
                b.corners.clone_from(&a.corners);
                b.corners.iter_mut().for_each(|c| c.at = -c.at);
            }
            let away = DVec2::from_angle(random.within(0.0, 6.3)) * random.within(6.9, 9.0);
            b.corners.iter_mut().for_each(|c| c.at += away);
            b.set_sides();
            let few = estimate(&a, &b, 1e-13, &mut scratch);
            looked_at += few.looked_at;
            let Scratch { nearest, candidates } = &mut scratch;
            candidates.all(&a, &b);
            let everything = among(&a, &b, 1e-13, nearest, candidates);
            all += everything.looked_at;
            assert_eq!(few.gap.to_bits(), everything.gap.to_bits());
            let (p, q) = (few.point, everything.point);
            assert_eq!((p.at, p.height_a, p.height_b, p.id), (q.at, q.height_a, q.height_b, q.id));
            compared += usize::from(few.gap > 0.0);
        }
        assert!(compared > 1500 && looked_at < all / 4, "{compared} {looked_at} {all}");
    }
}

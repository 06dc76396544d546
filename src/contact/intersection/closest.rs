//! The estimated point where two projected features miss each other.
//!
//! It is midway between the closest points of both projections. These are found among all pairs
//! of a corner of one with a side of the other. Large polygons look only at the pairs that may
//! be the closest: along a unit direction `u` from A to B a corner of A that is `x` below A's
//! farthest, and a side of B that is `y` beyond B's nearest, are at least `gap + x + y` apart,
//! `gap` the distance of the polygons along `u`. Whatever `u` is, no other pair is as close as
//! the closest known one; the better `u` is, the fewer pairs are left. GJK finds it (Gilbert,
//! Johnson and Keerthi, 1988, doi:10.1109/56.2083), in a few rounds of `O(n + m)`.

use glam::DVec2;

use super::PlanePoint;
use super::clip::are_large;
use super::outline::{Corner, Outline};
use crate::contact::manifold::Element;

/// A pair of nearest points: on A, on B, what they lie on.
#[derive(Clone, Copy, Debug)]
struct Near {
    a: DVec2,
    b: DVec2,
    height_a: f64,
    height_b: f64,
    id: [Element; 2],
}

/// The closest points.
pub(super) struct Closest {
    /// Midway between them.
    pub(super) point: PlanePoint,
    /// How far apart the projections are.
    pub(super) gap: f64,
    /// Pairs, and corners, that were looked at.
    pub(super) looked_at: u64,
}

/// The point midway between the closest points of both projections (the middle
/// of the closest set where it is not unique), each lifted to its own feature.
pub(super) fn estimate(a: &Outline, b: &Outline, eps: f64, scratch: &mut Scratch) -> Closest {
    let Scratch { nearest, candidates } = scratch;
    nearest.clear();
    let mut least = f64::INFINITY;
    let mut looked_at = 0;
    if are_large(a, b) {
        candidates.choose(a, b, eps, &mut looked_at);
    } else {
        candidates.all(a, b);
    }
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
    // Of several equally near pairs the two ends of the closest set.
    let across = nearest.first().map_or(DVec2::X, |near| (near.b - near.a).perp());
    let key = |near: &&Near| across.dot(near.a + near.b);
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

/// Buffers.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    nearest: Vec<Near>,
    candidates: Candidates,
}

/// The corners and sides of A and of B whose pairs are looked at, ascending.
#[derive(Debug, Default)]
struct Candidates {
    corners: [Vec<usize>; 2],
    sides: [Vec<usize>; 2],
    /// How far each corner is below the farthest.
    depths: Vec<f64>,
}

/// Corners, or sides, of a large polygon that are looked at: beyond them only polygons of about
/// the size of the merge distance have as near ones.
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

    /// Of two large polygons, those of which a pair may be closest to within `eps`.
    #[cold]
    fn choose(&mut self, a: &Outline, b: &Outline, eps: f64, looked_at: &mut u64) {
        let (u, distance) = direction(a, b, looked_at);
        let top = |outline: &Outline, u: DVec2| {
            outline.corners.iter().map(|c| u.dot(c.at)).fold(f64::NEG_INFINITY, f64::max)
        };
        let (top_a, top_b) = (top(a, u), top(b, -u));
        // Each height is rounded by a few roundoffs, a share of `eps`.
        let most = distance + 3.0 * eps + (top_a + top_b);
        for (outline, u, top, i) in [(a, u, top_a, 0), (b, -u, top_b, 1)] {
            self.depths.clear();
            self.depths.extend(outline.corners.iter().map(|c| top - u.dot(c.at)));
            let depth = |i: usize| self.depths[i];
            choose(&mut self.corners[i], self.depths.len(), most, depth);
            let side_depth = |i: usize| depth(i).min(depth(outline.next(i)));
            choose(&mut self.sides[i], self.depths.len(), most, side_depth);
            *looked_at += 4 * self.depths.len() as u64;
        }
    }
}

/// Those of `count` whose depth is at most `most`, the [`MOST`] of the least depth, ascending.
fn choose(chosen: &mut Vec<usize>, count: usize, most: f64, depth: impl Fn(usize) -> f64) {
    chosen.clear();
    chosen.extend((0..count).filter(|&i| depth(i) <= most));
    if chosen.len() > MOST {
        chosen.select_nth_unstable_by(MOST, |&i, &j| depth(i).total_cmp(&depth(j)).then(i.cmp(&j)));
        chosen.truncate(MOST);
        chosen.sort_unstable();
    }
}

/// Rounds of the search for the direction; it ends sooner where it no longer improves.
const ROUNDS: u32 = 64;

/// A unit direction from A to B along which they are nearly as far apart as they are, and the
/// distance of two of their points.
fn direction(a: &Outline, b: &Outline, looked_at: &mut u64) -> (DVec2, f64) {
    let farthest = |outline: &Outline, u: DVec2| {
        let higher = |best: DVec2, c: &Corner| if u.dot(c.at) > u.dot(best) { c.at } else { best };
        outline.corners.iter().fold(outline.corners[0].at, higher)
    };
    // From A's points to B's: the nearest of their hull to the origin, on the last segment.
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

/// The point of a segment that is nearest to the origin.
fn foot(from: DVec2, to: DVec2) -> DVec2 {
    let whole = to - from;
    let share = (-from.dot(whole) / whole.length_squared()).clamp(0.0, 1.0);
    if share.is_nan() { from } else { from + share * whole }
}

/// Each corner of one with its nearest point of each side (or of the corner) of
/// the other, of the candidates.
fn each_pair(a: &Outline, b: &Outline, candidates: &Candidates, mut visit: impl FnMut(Near)) {
    let Candidates { corners: [corners_a, corners_b], sides: [sides_a, sides_b], .. } = candidates;
    for c in corners_a.iter().map(|&i| &a.corners[i]) {
        each_nearest(b, sides_b, c.at, |at, height, id| {
            let id = [Element::Vertex(c.vertex), id];
            visit(Near { a: c.at, b: at, height_a: c.height, height_b: height, id });
        });
    }
    for c in corners_b.iter().map(|&i| &b.corners[i]) {
        each_nearest(a, sides_a, c.at, |at, height, id| {
            let id = [id, Element::Vertex(c.vertex)];
            visit(Near { a: at, b: c.at, height_a: height, height_b: c.height, id });
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

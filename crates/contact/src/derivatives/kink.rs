//! Whether the gradient is unique.
//!
//! Let `F` be the vertices of `K` in the plane of the facet to within rounding, and `A_F`, `B_F` the vertices
//! of A and of B in it. `F` is the difference of the two, so the facet is the polygon `conv A_F - conv B_F`.
//!
//! - If the ray meets the facet on a side or in a corner, the planes of the neighbours are optimal too.
//! - If it meets the inside, the plane is the only one. Under rotation the facet keeps its plane if one of
//!   the sets is a single vertex, or if both are segments that cross: the facet is then a face of one body,
//!   moved, or the parallelogram of two edges. Otherwise (a face on a face, an edge on a face) it breaks up.
//!
//! So three questions decide, and neither weights that are zero nor more than three coplanar vertices are a
//! kink by themselves: both happen inside the parallelogram of two edges.
//!
//! ```text
//! sides of A_F and -B_F, merged by direction, bound the facet:
//!
//!     A_F = segment, B_F = segment           A_F = triangle, B_F = vertex
//!          .------.                                 .
//!         /  .x  /      no kink                    / \        no kink if x is inside
//!        '------'                                 /.x_\
//! ```
//!
//! The outline of each set takes time `n log n` for `n` vertices, and merging the sides linear time (M. de
//! Berg and others, *Computational Geometry*, 2008, section 13.3).

use glam::{DVec2, DVec3};

use super::Facet;
use crate::gauss_map::{self, Direction};
use crate::pair::{Pair, Support};
use crate::tolerance::{MERGE, U};

/// Buffers of [`derivatives`](super::derivatives), reused from pair to pair.
#[derive(Debug, Default)]
pub struct KinkScratch {
    gauss_map: gauss_map::Scratch,
    /// The outlines of `A_F` and of `-B_F` in the contact plane, anticlockwise.
    outlines: [Vec<DVec2>; 2],
    corners: Vec<DVec2>,
    /// Vertices examined since the last [`KinkScratch::take_steps`].
    counted: u64,
}

impl KinkScratch {
    /// The elementary steps ([`Stop`](crate::Stop)) of the derivatives computed since the last call.
    pub fn take_steps(&mut self) -> u64 {
        std::mem::take(&mut self.counted)
    }
}

/// Whether the gradient at this facet is not unique.
pub(super) fn is_kink(pair: &Pair<'_>, facet: &Facet, scratch: &mut KinkScratch) -> bool {
    let n = facet.n;
    let (e1, e2) = n.any_orthonormal_pair();
    let flat = |v: DVec3| DVec2::new(v.dot(e1), v.dot(e2));
    let depth = MERGE * U * pair.circumradius;
    let KinkScratch { gauss_map, outlines: [outline_a, outline_b], corners, counted } = scratch;
    *counted += crate::cost::PAIR;
    let mut outline = |hull, n, depth, known: fn(&Support) -> u32, vertex: &dyn Fn(u32) -> DVec2, out| {
        let known = facet.triple.each_ref().map(known);
        let direction = Direction { n, known: &known, depth, sine: 0.0, cosine: 1.0 };
        let set = gauss_map.support_set(hull, &direction);
        *counted += crate::cost::SIDE * set.len() as u64;
        corners.clear();
        corners.extend(set.iter().map(|&v| vertex(v)));
        outline_of(corners, out);
        set.len()
    };
    let a = outline(pair.a, n, depth / pair.scale_a, |u| u.a, &|v| flat(pair.vertex_a(v)), outline_a);
    let in_b = -pair.direction_in_b(n);
    let b = outline(pair.b, in_b, depth / pair.scale_b, |u| u.b, &|v| flat(-pair.vertex_b(v)), outline_b);
    let tolerance = MERGE * U * (pair.circumradius + pair.ray_m / facet.growth);
    let keeps_plane = a == 1 || b == 1 || (a == 2 && b == 2);
    !(keeps_plane && holds(outline_a, outline_b, flat(facet.x), tolerance))
}

/// The convex outline of `points`, anticlockwise from the point with the lowest x (then y); by A. M. Andrew's
/// monotone chain (doi:10.1016/0020-0190(79)90072-3). Corners within rounding of a side may stay or go.
fn outline_of(points: &mut Vec<DVec2>, outline: &mut Vec<DVec2>) {
    points.sort_unstable_by(|p, q| p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)));
    points.dedup();
    outline.clear();
    let mut half = |points: &mut dyn Iterator<Item = &DVec2>| {
        let first = outline.len();
        for &p in points {
            while outline.len() >= first + 2 {
                let [u, v] = [outline[outline.len() - 2], outline[outline.len() - 1]];
                if (v - u).perp_dot(p - u) > 0.0 {
                    break;
                }
                outline.pop();
            }
            outline.push(p);
        }
        // The last point begins the other half.
        outline.pop();
    };
    half(&mut points.iter());
    half(&mut points.iter().rev());
    if let ([p], true) = (points.as_slice(), outline.is_empty()) {
        outline.push(*p);
    }
}

/// Whether the sum of two convex outlines has `x` inside, by more than `tolerance` from each side.
fn holds(p: &[DVec2], q: &[DVec2], x: DVec2, tolerance: f64) -> bool {
    let side = |outline: &[DVec2], i: usize| outline[(i + 1) % outline.len()] - outline[i];
    // A single point has no sides.
    let count = |outline: &[DVec2]| if outline.len() > 1 { outline.len() } else { 0 };
    let (count_p, count_q) = (count(p), count(q));
    let (mut i, mut j) = (0, 0);
    let Some(mut at) = p.first().zip(q.first()).map(|(p, q)| p + q) else { return false };
    while i < count_p || j < count_q {
        // Of both next sides the one that comes first anticlockwise. Of two parallel ones that is q's, so a
        // side of q that points back follows the side of p.
        let from_p = j == count_q
            || (i < count_p && {
                let (u, v) = (side(p, i), side(q, j));
                let turn = u.perp_dot(v);
                turn > 0.0 || (turn == 0.0 && u.dot(v) < 0.0)
            });
        let along = if from_p { side(p, i) } else { side(q, j) };
        (i, j) = if from_p { (i + 1, j) } else { (i, j + 1) };
        if !(along.perp_dot(x - at) > tolerance * along.length()) {
            return false;
        }
        at += along;
    }
    count_p + count_q > 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::workload::Random;

    /// The sum of two outlines holds a point exactly if, along each direction perpendicular to a side, the
    /// point is below the sum of both support values. Catches a side that is skipped, or merged in a wrong
    /// place, for polygons, segments and points.
    #[test]
    fn a_sum_holds_what_its_sides_leave() {
        let mut random = Random::new(4);
        let mut held = 0;
        for _ in 0..20_000 {
            let mut outlines = [Vec::new(), Vec::new()];
            for outline in &mut outlines {
                let mut points: Vec<DVec2> = (0..=random.below(7))
                    .map(|_| DVec2::new(random.below(9) as f64 - 4.0, random.below(9) as f64 - 4.0))
                    .collect();
                points.dedup();
                outline_of(&mut points, outline);
            }
            let x = DVec2::new(random.within(-4.0, 4.0), random.within(-4.0, 4.0));
            let [p, q] = &outlines;
            let highest = |m: DVec2| {
                let of = |o: &[DVec2]| o.iter().map(|v| m.dot(*v)).fold(f64::NEG_INFINITY, f64::max);
                of(p) + of(q)
            };
            let sides = [p, q].map(|o| {
                let ends = |i: usize| [o[i], o[(i + 1) % o.len()]];
                (0..o.len())
                    .map(|i| ends(i)[1] - ends(i)[0])
                    .filter(|e| *e != DVec2::ZERO)
                    .collect::<Vec<_>>()
            });
            let sides = sides.concat();
            let expected = !sides.is_empty() && sides.iter().all(|e| -e.perp().dot(x) < highest(-e.perp()));
            assert_eq!(holds(p, q, x, 0.0), expected, "{p:?} {q:?} {x}");
            held += usize::from(expected);
        }
        assert!(held > 2000, "{held}");
    }
}

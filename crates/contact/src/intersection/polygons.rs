//! The intersection of two small convex polygons in general position, by a walk around both.
//!
//! Applies if no corner is within `eps` of the line of a side of the other polygon. Then the signs of
//! all distances are certain, and they determine which sides cross. The walk (after K. Weiler and P.
//! Atherton, *Hidden Surface Removal Using Polygon Area Sorting*, 1977, doi:10.1145/563858.563896) goes
//! around A, and where A leaves B it follows B as long as B is inside A:
//!
//! ```text
//!          A0 ----------- A3
//!           |              |     Side A0-A1 enters B at x and leaves it at y.
//!      B0 --x------- B3    |     From y on, B's corners follow while they are inside A:
//!       |   |         |    |     B2 and B3 do, B0 is outside. The walk around A goes on.
//!      B1 --y------- B2    |     The intersection: x, y, B2, B3.
//!           |              |
//!          A1 ----------- A2
//!
//! for each corner Ai of A:
//!     Ai is inside B: append it
//!     the side from Ai enters B: append the crossing
//!     the side from Ai leaves B: append the crossing, then B's next corners while inside A
//! nothing crosses and B is inside A: append all corners of B
//! ```
//!
//! Two tables of signed distances and a bit set per row hold all that the walk needs to know: A's
//! corners against B's sides, and A's sides against B's corners. For polygons of at most 8 corners a
//! bit set is one byte, and filling a row has no branches. Filling them takes `O(n m)` time and the
//! walk `O(n + m)`. That is faster than clipping, which handles all other cases.

use std::array;

use glam::DVec2;

use super::PlanePoint;
use super::outline::{Corner, Outline, height_on};
use crate::manifold::Element;
use crate::tolerance::TURN;

/// Corners of the largest polygons. The work grows with the product of the numbers of corners.
const MOST: usize = 8;

/// Signed distances between A's corners and B's sides, or between A's sides and B's corners. Row `i`
/// belongs to A's corner or side `i`, column `k` to B's side or corner `k`.
#[derive(Debug, Default)]
struct Table {
    /// Positive inside. The unit is that of the side's inward direction, which need not have length 1.
    distances: [[f64; MOST]; MOST],
    /// Bit `k` of row `i` is set if distance `k` of the row is negative: the corner is outside.
    outside: [u8; MOST],
}

impl Table {
    /// Sets row `i` to `x * columns[0] + y * columns[1] - columns[2]` for `at = (x, y)`. Returns whether
    /// no distance of the row is within `eps` of 0.
    #[inline]
    fn set<const N: usize>(&mut self, i: usize, at: DVec2, columns: &[[f64; N]; 3], eps: f64) -> bool {
        let [x, y, offset] = columns;
        let row: [f64; N] = array::from_fn(|k| at.x * x[k] + at.y * y[k] - offset[k]);
        self.distances[i][..N].copy_from_slice(&row);
        self.outside[i] = (0..N).fold(0, |bits, k| bits | u8::from(row[k] < 0.0) << k);
        // A distance from a side of no length is NaN, which makes this false too.
        (0..N).fold(true, |clear, k| clear & (row[k].abs() > eps))
    }
}

/// The two tables.
#[derive(Debug, Default)]
pub(super) struct Polygons {
    /// A's corners against B's sides.
    corners: Table,
    /// A's sides against B's corners.
    sides: Table,
}

impl Polygons {
    /// Appends the vertices of the intersection of `a` and `b`, anticlockwise. The sides of `b` must be
    /// set. Appends nothing and returns false if a corner is on a line or the polygons are not small.
    pub(super) fn find(&mut self, a: &Outline, b: &Outline, eps: f64, points: &mut Vec<PlanePoint>) -> bool {
        let [of_a, of_b] = [a, b].map(|outline| outline.corners.len());
        let clear = match of_b {
            3..=4 if (3..=MOST).contains(&of_a) => self.measure::<4>(a, b, eps),
            5..=MOST if (3..=MOST).contains(&of_a) => self.measure::<MOST>(a, b, eps),
            _ => false,
        };
        if clear {
            self.walk(a, b, points);
        }
        clear
    }

    /// Fills the tables. Returns whether A is strictly convex and no corner is on a line, with certainty.
    fn measure<const N: usize>(&mut self, a: &Outline, b: &Outline, eps: f64) -> bool {
        // Columns beyond the last one repeat it.
        let last = b.corners.len() - 1;
        let columns = |of: &dyn Fn(usize) -> f64| array::from_fn(|k| of(k.min(last)));
        let lines = [
            columns(&|j| b.sides[j].inward.x),
            columns(&|j| b.sides[j].inward.y),
            columns(&|j| b.sides[j].offset),
        ];
        let corners = [columns(&|j| b.corners[j].at.x), columns(&|j| b.corners[j].at.y)];
        let mut before = along(a, a.corners.len() - 1);
        (0..a.corners.len()).all(|i| {
            let (at, along) = (a.corners[i].at, along(a, i));
            let [inward, length] = [along.perp(), along.abs()];
            let sure = TURN * before.abs().element_sum() * length.element_sum();
            let convex = std::mem::replace(&mut before, along).perp_dot(along) > sure;
            let [x, y] = corners;
            convex
                & self.corners.set(i, at, &lines, eps)
                & self.sides.set(i, inward, &[x, y, [inward.dot(at); N]], eps * length.element_sum())
        })
    }

    /// Appends the vertices of the intersection by the walk, from the bits of the tables.
    fn walk(&self, a: &Outline, b: &Outline, points: &mut Vec<PlanePoint>) {
        let (of_a, of_b) = (a.corners.len(), b.corners.len());
        let corner_of_b = |j: usize| {
            let Corner { at, height, vertex } = b.corners[j];
            let id = [Element::Inside, Element::Vertex(vertex)];
            PlanePoint { at, height_a: a.height(at), height_b: height, id }
        };
        // One bit for each of B's corners or sides; the repeated columns beyond them are masked off.
        let all = (1_u32 << of_b) - 1;
        // B's corners that are outside A, that is outside any side of A.
        let outside = self.sides.outside[..of_a].iter().fold(0, |all, bits| all | u32::from(*bits));
        let mut crossed = false;
        for (i, &Corner { at, height, vertex }) in a.corners.iter().enumerate() {
            // The sides of B outside which this corner of A lies, and those for the next corner.
            let [out, out_next] = [i, a.next(i)].map(|i| u32::from(self.corners.outside[i]) & all);
            if out == 0 {
                let id = [Element::Vertex(vertex), Element::Inside];
                points.push(PlanePoint { at, height_a: height, height_b: b.height(at), id });
            }
            // Bit j is set if B's corner j is outside the line of this side of A. Rotating the bits by one
            // moves corner j + 1 to place j, so the exclusive or is set for the sides of B whose two ends
            // lie on opposite sides of the line.
            let beyond = u32::from(self.sides.outside[i]) & all;
            let across = beyond ^ (beyond >> 1 | beyond << (of_b - 1) & all);
            // Side j of B is crossed by this side of A if each has its ends on opposite sides of the other.
            // A enters B if its first end is outside side j, and leaves B if its second end is. A line
            // enters and leaves a convex polygon at most once, so each set has at most one bit.
            let (enters, leaves) = (out & !out_next & across, out_next & !out & across);
            crossed |= enters | leaves != 0;
            if enters != 0 {
                points.push(self.crossing(a, b, i, enters.trailing_zeros() as usize));
            }
            if leaves != 0 {
                let j = leaves.trailing_zeros() as usize;
                points.push(self.crossing(a, b, i, j));
                let mut corner = b.next(j);
                while outside >> corner & 1 == 0 && corner != j {
                    points.push(corner_of_b(corner));
                    corner = b.next(corner);
                }
            }
        }
        if !crossed && outside == 0 {
            points.extend((0..of_b).map(corner_of_b));
        }
    }

    /// The crossing of side `i` of A and side `j` of B.
    fn crossing(&self, a: &Outline, b: &Outline, i: usize, j: usize) -> PlanePoint {
        let [from, to] = [i, a.next(i)].map(|i| self.corners.distances[i][j]);
        let share = from / (from - to);
        let [p, q] = a.side(i);
        let at = p.at + share * (q.at - p.at);
        PlanePoint {
            at,
            height_a: p.height + share * (q.height - p.height),
            // Rounding moves the crossing of nearly parallel sides along them, so lift B's side at the
            // same place.
            height_b: height_on(b.side(j), at),
            id: [a.side_name(i), b.side_name(j)],
        }
    }
}

/// The vector from corner `i` to the next.
fn along(outline: &Outline, i: usize) -> DVec2 {
    let [from, to] = outline.side(i);
    to.at - from.at
}

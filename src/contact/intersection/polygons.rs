//! Two polygons of which no corner is within `eps` of the line of a side of the other: which
//! sides cross is beyond doubt, and what they share follows from signs, by a walk around A
//! and, from where it leaves B, around B (after Weiler and Atherton, *Hidden Surface Removal
//! Using Polygon Area Sorting*, 1977).

use std::array;

use glam::DVec2;

use super::PlanePoint;
use super::outline::{Corner, Outline, height_on};
use crate::contact::manifold::Element;
use crate::contact::tolerance::TURN;

/// Corners of the largest polygons: each is measured from each side of the other.
const MOST: usize = 8;

/// A table of A's corners or sides and of B's: how far one is from the line of the other.
#[derive(Debug, Default)]
struct Table {
    /// For each of A, of each of B: positive inside, in a unit of the side's.
    distances: [[f64; MOST]; MOST],
    /// For each of A, bits of those of B with which it is outside.
    outside: [u8; MOST],
}

impl Table {
    /// Sets the row of A's `i`: `x * columns[0] + y * columns[1] - columns[2]`. Whether none is
    /// within `eps` of 0.
    #[inline]
    fn set<const N: usize>(&mut self, i: usize, at: DVec2, columns: &[[f64; N]; 3], eps: f64) -> bool {
        let [x, y, offset] = columns;
        let row: [f64; N] = array::from_fn(|k| at.x * x[k] + at.y * y[k] - offset[k]);
        self.distances[i][..N].copy_from_slice(&row);
        self.outside[i] = (0..N).fold(0, |bits, k| bits | u8::from(row[k] < 0.0) << k);
        // False for a side of no length (NaN) too.
        (0..N).fold(true, |clear, k| clear & (row[k].abs() > eps))
    }
}

/// Buffers.
#[derive(Debug, Default)]
pub(super) struct Polygons {
    /// A's corners and B's sides.
    corners: Table,
    /// A's sides and B's corners.
    sides: Table,
}

impl Polygons {
    /// Appends the vertices of what `a` and `b`, whose sides are set, share, anticlockwise.
    /// False, and nothing, where a corner is on a line, and for others than small polygons.
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

    /// Whether A is strictly convex and no corner on a line, all beyond doubt.
    fn measure<const N: usize>(&mut self, a: &Outline, b: &Outline, eps: f64) -> bool {
        // The last once more where there are fewer.
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

    fn walk(&self, a: &Outline, b: &Outline, points: &mut Vec<PlanePoint>) {
        let (of_a, of_b) = (a.corners.len(), b.corners.len());
        let corner_of_b = |j: usize| {
            let Corner { at, height, vertex } = b.corners[j];
            let id = [Element::Inside, Element::Vertex(vertex)];
            PlanePoint { at, height_a: a.height(at), height_b: height, id }
        };
        let all = (1_u32 << of_b) - 1;
        let outside = self.sides.outside[..of_a].iter().fold(0, |all, bits| all | u32::from(*bits));
        let mut crossed = false;
        for (i, &Corner { at, height, vertex }) in a.corners.iter().enumerate() {
            let [out, out_next] = [i, a.next(i)].map(|i| u32::from(self.corners.outside[i]) & all);
            if out == 0 {
                let id = [Element::Vertex(vertex), Element::Inside];
                points.push(PlanePoint { at, height_a: height, height_b: b.height(at), id });
            }
            // Sides of B from one side of this line to the other.
            let beyond = u32::from(self.sides.outside[i]) & all;
            let across = beyond ^ (beyond >> 1 | beyond << (of_b - 1) & all);
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

    /// Where side `i` of A crosses side `j` of B.
    fn crossing(&self, a: &Outline, b: &Outline, i: usize, j: usize) -> PlanePoint {
        let [from, to] = [i, a.next(i)].map(|i| self.corners.distances[i][j]);
        let share = from / (from - to);
        let [p, q] = a.side(i);
        let at = p.at + share * (q.at - p.at);
        PlanePoint {
            at,
            height_a: p.height + share * (q.height - p.height),
            // Of nearly parallel sides rounding moves the crossing along them: at one place.
            height_b: height_on(b.side(j), at),
            id: [a.side_name(i), b.side_name(j)],
        }
    }
}

/// From corner `i` to the next.
fn along(outline: &Outline, i: usize) -> DVec2 {
    let [from, to] = outline.side(i);
    to.at - from.at
}

//! Step 3 for two faces: the intersection of two rectangles, seen along the normal.
//!
//! This is the walk of `intersection/polygons`, in two parts. In lanes, everything that any walk may
//! need is computed: the 4 corners of each face, the 16 crossings of their sides, and for each corner
//! the sides of the other face outside which it lies. The walk itself then only reads bits and copies
//! points, one lane after another.
//!
//! Points of A's face have plain coordinates `(u, v)`, and B's corners are lowered onto its plane along
//! the normal, which is where witnesses on A are. A's corners are raised onto B's plane in the same way.
//! Both faces are numbered anticlockwise about the normal:
//!
//! ```text
//!    1 ---- side 0 ---- 0        v
//!    |                  |        |
//!  side 1            side 3      +-- u      side k goes from corner k to the next
//!    |                  |
//!    2 ---- side 2 ---- 3
//! ```
//!
//! A lane is sure if no corner is near the line of a side of the other face, compared with the distance
//! within which points merge. Then all signs are certain, and no two vertices of the intersection are
//! near each other. Only two sides that are nearly parallel could cross in a vertex that hardly turns;
//! the walk gives up if it meets such a crossing.

use super::axes::Direction;
use super::features::Feature;
use super::frame::Frame;
use super::simd::{Lanes, Row, WIDTH};
use super::vector::Vector;
use crate::tolerance::{LANE_CLEAR, LANE_TURN};

/// The signs of a face's corners along its axes u and v.
const CORNERS: [(f64, f64); 4] = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)];

/// Where a group's points begin: A's corners, B's corners, crossings.
const OF_B: usize = 4;
const CROSSINGS: usize = 8;

/// The points that the rectangles of a group may share, and the bits that decide between them.
#[derive(Debug)]
pub(super) struct Rectangles {
    /// The witness on A in the world (three numbers) and the distance, of each of the 24 points; caller's
    /// units. The crossing of A's side `i` and B's side `j` is point `8 + 4 i + j`.
    points: [[Row; 4]; 24],
    /// Bit `4 k + j` is set if corner `k` is outside side `j` of the other face; as a number.
    outside: [Row; 2],
    /// Bit 0: sides of equal parity are nearly parallel. Bit 1: sides of different parity are.
    parallel: Row,
}

impl Default for Rectangles {
    fn default() -> Self {
        Self { points: [[[0.0; WIDTH]; 4]; 24], outside: [[0.0; WIDTH]; 2], parallel: [0.0; WIDTH] }
    }
}

/// A corner: coordinates on the plane of the other face, and how far away that is along the normal.
#[derive(Clone, Copy)]
struct Corner<L> {
    u: L,
    v: L,
    gap: L,
}

/// The two axes of a face, right-handed about the contact normal, in the box's own axes.
#[derive(Clone, Copy)]
struct Axes<L> {
    u: Vector<L>,
    v: Vector<L>,
}

impl<L: Lanes> Axes<L> {
    /// The axes of A's face, whose outward normal is nearly the contact normal.
    #[inline(always)]
    fn of_a(face: &Feature<L>) -> Self {
        let size = face.signs.abs();
        let sign = face.signs.x + face.signs.y + face.signs.z;
        // The next axis in cyclic order, and the one after that.
        let u = Vector::new(size.z, size.x, size.y);
        let v = Vector::new(size.y, size.z, size.x);
        Self { u, v: v.scale(sign) }
    }

    /// The axes of B's face, whose outward normal is nearly the opposite.
    #[inline(always)]
    fn of_b(face: &Feature<L>) -> Self {
        let Self { u, v } = Self::of_a(face);
        Self { u: -u, v }
    }
}

impl Rectangles {
    /// Computes the points of a group's lanes from `at` on. Returns the lanes that are sure.
    #[inline(always)]
    pub(super) fn measure<L: Lanes>(
        &mut self,
        frame: &Frame<L>,
        direction: &Direction<L>,
        [a, b]: [&Feature<L>; 2],
        at: usize,
    ) -> L::Mask {
        let Frame { half_a, half_b, rotation, d, .. } = *frame;
        let Direction { n, n_in_b, .. } = *direction;
        let (axes_a, axes_b) = (Axes::of_a(a), Axes::of_b(b));
        let size_a = [axes_a.u.abs().dot(half_a), axes_a.v.abs().dot(half_a)];
        let size_b = [axes_b.u.abs().dot(half_b), axes_b.v.abs().dot(half_b)];
        let side_a = [axes_a.u.scale(size_a[0]), axes_a.v.scale(size_a[1])];
        let side_b = [axes_b.u.scale(size_b[0]), axes_b.v.scale(size_b[1])];

        // B's corners lowered onto A's plane: its middle and its half sides, each in coordinates.
        let middle_b = rotation * b.signs.times(half_b) + d;
        let to_a = Projection { face: a.signs, axes: axes_a, n };
        let offset_a = a.signs.abs().dot(half_a);
        let middle = to_a.lowered(middle_b, offset_a);
        let along_u = to_a.lowered(rotation * side_b[0], L::splat(0.0));
        let along_v = to_a.lowered(rotation * side_b[1], L::splat(0.0));
        let corners_b = corners(middle, along_u, along_v);
        // A's corners raised onto B's plane.
        let middle_a = rotation.transposed_times(a.signs.times(half_a) - d);
        let to_b = Projection { face: b.signs, axes: axes_b, n: n_in_b };
        let offset_b = b.signs.abs().dot(half_b);
        let corners_a = corners(
            to_b.lowered(middle_a, offset_b),
            to_b.lowered(rotation.transposed_times(side_a[0]), L::splat(0.0)),
            to_b.lowered(rotation.transposed_times(side_a[1]), L::splat(0.0)),
        );

        let mut clear = L::splat(f64::INFINITY);
        let outside_a = outside(&corners_a, size_b, &mut clear);
        let outside_b = outside(&corners_b, size_a, &mut clear);
        outside_a.store(&mut self.outside[0], at);
        outside_b.store(&mut self.outside[1], at);
        parallel(along_u, along_v).store(&mut self.parallel, at);

        let lift = Lift::new(frame, a, axes_a);
        for k in 0..4 {
            let (p, q) = CORNERS[k];
            let (u, v) = (L::splat(p) * size_a[0], L::splat(q) * size_a[1]);
            // The gap of a raised corner is negative: from A's corner B's plane is ahead.
            lift.store(Corner { u, v, gap: -corners_a[k].gap }, &mut self.points[k], at);
            lift.store(corners_b[k], &mut self.points[OF_B + k], at);
        }
        for j in 0..4 {
            let (p, q) = (corners_b[j], corners_b[(j + 1) % 4]);
            let (along_u, along_v, along_gap) = (q.u - p.u, q.v - p.v, q.gap - p.gap);
            for i in 0..4 {
                // A's side i lies on the line of one coordinate.
                let limit = if i == 0 {
                    size_a[1]
                } else if i == 1 {
                    -size_a[0]
                } else if i == 2 {
                    -size_a[1]
                } else {
                    size_a[0]
                };
                let crossing = if i % 2 == 0 {
                    let share = (limit - p.v) / along_v;
                    Corner { u: p.u + share * along_u, v: limit, gap: p.gap + share * along_gap }
                } else {
                    let share = (limit - p.u) / along_u;
                    Corner { u: limit, v: p.v + share * along_v, gap: p.gap + share * along_gap }
                };
                lift.store(crossing, &mut self.points[CROSSINGS + 4 * i + j], at);
            }
        }
        a.is_face & b.is_face & clear.gt(L::splat(LANE_CLEAR) * frame.merge_distance)
    }
}

/// A projection along the normal onto the plane of a face.
#[derive(Clone, Copy)]
struct Projection<L> {
    /// The face's outward normal.
    face: Vector<L>,
    axes: Axes<L>,
    n: Vector<L>,
}

impl<L: Lanes> Projection<L> {
    /// Where the line of a point along the normal meets the plane at `offset`. The gap is how far the
    /// point is beyond that, along the normal.
    #[inline(always)]
    fn lowered(&self, point: Vector<L>, offset: L) -> Corner<L> {
        let gap = (self.face.dot(point) - offset) / self.face.dot(self.n);
        Corner {
            u: self.axes.u.dot(point) - gap * self.axes.u.dot(self.n),
            v: self.axes.v.dot(point) - gap * self.axes.v.dot(self.n),
            gap,
        }
    }
}

/// The corners of a rectangle from its middle and its half sides.
#[inline(always)]
fn corners<L: Lanes>(middle: Corner<L>, u: Corner<L>, v: Corner<L>) -> [Corner<L>; 4] {
    let mut corners = [middle; 4];
    for k in 0..4 {
        let (p, q) = (L::splat(CORNERS[k].0), L::splat(CORNERS[k].1));
        corners[k] = Corner {
            u: middle.u + (p * u.u + q * v.u),
            v: middle.v + (p * u.v + q * v.v),
            gap: middle.gap + (p * u.gap + q * v.gap),
        };
    }
    corners
}

/// The bits of the sides outside which each corner lies, as a number. Lowers `clear` to the smallest
/// distance from a line.
#[inline(always)]
fn outside<L: Lanes>(corners: &[Corner<L>; 4], size: [L; 2], clear: &mut L) -> L {
    let zero = L::splat(0.0);
    let mut bits = zero;
    let mut bit = 1_u32;
    for Corner { u, v, .. } in corners {
        for inside in [size[1] - *v, size[0] + *u, size[1] + *v, size[0] - *u] {
            bits = bits + L::select(zero.gt(inside), L::splat(f64::from(bit)), zero);
            *clear = inside.abs().min(*clear);
            bit <<= 1;
        }
    }
    bits
}

/// Which sides of A and B are nearly parallel, from B's half sides in A's plane; see
/// [`Rectangles::parallel`].
#[inline(always)]
fn parallel<L: Lanes>(u: Corner<L>, v: Corner<L>) -> L {
    let little = L::splat(LANE_TURN);
    let (zero, one, two) = (L::splat(0.0), L::splat(1.0), L::splat(2.0));
    let alike = (little * u.u.abs()).gt(u.v.abs()) | (little * v.v.abs()).gt(v.u.abs());
    let across = (little * u.v.abs()).gt(u.u.abs()) | (little * v.u.abs()).gt(v.v.abs());
    L::select(alike, one, zero) + L::select(across, two, zero)
}

/// From A's face to the world.
#[derive(Clone, Copy)]
struct Lift<L> {
    u: Vector<L>,
    v: Vector<L>,
    middle: Vector<L>,
    translation: Vector<L>,
    unit: L,
}

impl<L: Lanes> Lift<L> {
    #[inline(always)]
    fn new(frame: &Frame<L>, face: &Feature<L>, axes: Axes<L>) -> Self {
        let Frame { half_a, unit, rotation_a, translation_a, centre_a, .. } = *frame;
        Self {
            u: (rotation_a * axes.u).scale(unit),
            v: (rotation_a * axes.v).scale(unit),
            middle: centre_a + (rotation_a * face.signs.times(half_a)).scale(unit),
            translation: translation_a,
            unit,
        }
    }

    #[inline(always)]
    fn store(&self, point: Corner<L>, rows: &mut [Row; 4], at: usize) {
        let aside = self.u.scale(point.u) + self.v.scale(point.v);
        let witness = self.translation + (self.middle + aside);
        witness.x.store(&mut rows[0], at);
        witness.y.store(&mut rows[1], at);
        witness.z.store(&mut rows[2], at);
        (point.gap * self.unit).store(&mut rows[3], at);
    }
}

/// A vertex of the intersection: its witness on A and its distance, and the parts that make it.
pub(super) struct Shared {
    pub(super) witness: [f64; 3],
    pub(super) distance: f64,
    pub(super) made: Made,
}

/// The corners or sides, by their numbers, that make a vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Made {
    CornerOfA(usize),
    CornerOfB(usize),
    Crossing(usize, usize),
}

impl Rectangles {
    /// Visits the vertices of one lane's intersection, anticlockwise about the normal. Returns whether the
    /// intersection is certain and not empty.
    pub(super) fn walk(&self, lane: usize, mut visit: impl FnMut(Shared)) -> bool {
        let [of_a, of_b] = [0, 1].map(|side| self.outside[side][lane] as u32);
        let parallel = self.parallel[lane] as usize;
        let mut count = 0;
        let mut point = |at: usize, made: Made| {
            let [x, y, z, distance] = self.points[at].each_ref().map(|row| row[lane]);
            count += 1;
            visit(Shared { witness: [x, y, z], distance, made });
        };
        // B's corners that are outside A.
        let outside = (0..4).fold(0, |bits, k| bits | u32::from(of_b >> (4 * k) & 15 != 0) << k);
        let (mut crossed, mut turns) = (false, true);
        for i in 0..4 {
            let [out, out_next] = [i, (i + 1) % 4].map(|k| of_a >> (4 * k) & 15);
            if out == 0 {
                point(i, Made::CornerOfA(i));
            }
            // B's corners outside the line of A's side i, and B's sides that cross this line.
            let beyond = (0..4).fold(0, |bits, k| bits | (of_b >> (4 * k + i) & 1) << k);
            let across = beyond ^ (beyond >> 1 | beyond << 3 & 15);
            let (enters, leaves) = (out & !out_next & across, out_next & !out & across);
            for side in [enters, leaves].into_iter().filter(|&side| side != 0) {
                let j = side.trailing_zeros() as usize;
                crossed = true;
                turns &= parallel >> ((i + j) % 2) & 1 == 0;
                point(CROSSINGS + 4 * i + j, Made::Crossing(i, j));
            }
            if leaves != 0 {
                let first = leaves.trailing_zeros() as usize;
                let inside = (1..4).map(|step| (first + step) % 4).take_while(|k| outside >> k & 1 == 0);
                inside.for_each(|k| point(OF_B + k, Made::CornerOfB(k)));
            }
        }
        if !crossed && outside == 0 {
            (0..4).for_each(|k| point(OF_B + k, Made::CornerOfB(k)));
        }
        turns && count > 0
    }
}

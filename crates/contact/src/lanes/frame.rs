//! A group of pairs of boxes in lanes: each pair in the frame of its box A.
//!
//! This is [`Pair`](crate::pair::Pair) for boxes: A's axes and centre, and lengths in pair units, a
//! power of two of the caller's units that brings the larger box to about 1.

use super::BoxPair;
use super::simd::{Lanes, Row, WIDTH};
use super::vector::{Matrix, Vector};
use crate::body::Pose;
use crate::tolerance::{BAND, COINCIDENT, LANE_RANGE, LENGTH_ABOVE, MERGE, NOISE, OFF_BOX, U};

/// The numbers of a group, one row for each number of a pair.
pub(super) struct Group<'a> {
    /// The boxes A and the boxes B of all pairs.
    boxes: [[&'a Row; WIDTH]; 2],
    /// The poses of A and of B: rotation by columns, then translation, in two rows. The margin of the pair
    /// follows.
    poses: [[[Row; 2]; WIDTH]; 2],
}

impl<'a> Group<'a> {
    /// The group of these pairs, at least one and at most [`WIDTH`]. The last pair is repeated in the
    /// lanes that are left.
    pub(super) fn new(pairs: &[BoxPair<'a>]) -> Self {
        let of = |lane: usize| &pairs[lane.min(pairs.len() - 1)];
        let mut group = Self {
            boxes: [0, 1].map(|side| std::array::from_fn(|lane| of(lane).rows[side].numbers())),
            poses: [[[[0.0; WIDTH]; 2]; WIDTH]; 2],
        };
        for lane in 0..WIDTH {
            for side in 0..2 {
                let BoxPair { bodies, margin, .. } = of(lane);
                let Pose { rotation, translation: t } = bodies[side].pose;
                let [x, y, z] = rotation.to_cols_array_2d();
                group.poses[side][lane] = [
                    [x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1]],
                    [z[2], t.x, t.y, t.z, *margin, 0.0, 0.0, 0.0],
                ];
            }
        }
        group
    }
}

/// A box at its pose, in each lane.
#[derive(Clone, Copy)]
struct PosedBox<L> {
    half: Vector<L>,
    centre: Vector<L>,
    scale: L,
    /// Distance of the centre from the origin of the hull frame.
    reach: L,
    rotation: Matrix<L>,
    translation: Vector<L>,
    /// The margin of the pair, in the caller's units.
    margin: L,
}

impl<L: Lanes> PosedBox<L> {
    #[inline(always)]
    fn load(boxes: &[&Row; WIDTH], poses: &[[Row; 2]; WIDTH], at: usize) -> Self {
        let [hx, hy, hz, cx, cy, cz, scale, reach] = L::transposed(boxes, at);
        // Written out, because a closure would not be compiled for the lanes' instructions.
        let [p0, p1, p2, p3, p4, p5, p6, p7] = poses;
        let first = [&p0[0], &p1[0], &p2[0], &p3[0], &p4[0], &p5[0], &p6[0], &p7[0]];
        let second = [&p0[1], &p1[1], &p2[1], &p3[1], &p4[1], &p5[1], &p6[1], &p7[1]];
        let [xx, xy, xz, yx, yy, yz, zx, zy] = L::transposed(&first, at);
        let [zz, tx, ty, tz, margin, ..] = L::transposed(&second, at);
        Self {
            half: Vector::new(hx, hy, hz),
            centre: Vector::new(cx, cy, cz),
            scale,
            reach,
            rotation: Matrix {
                x: Vector::new(xx, xy, xz),
                y: Vector::new(yx, yy, yz),
                z: Vector::new(zx, zy, zz),
            },
            translation: Vector::new(tx, ty, tz),
            margin,
        }
    }
}

/// Two boxes in the axes and about the centre of A, lengths in pair units. The names are those of
/// [`Pair`](crate::pair::Pair).
#[derive(Clone, Copy)]
pub(super) struct Frame<L: Lanes> {
    /// Half extents.
    pub(super) half_a: Vector<L>,
    pub(super) half_b: Vector<L>,
    /// B's axes in A's.
    pub(super) rotation: Matrix<L>,
    /// The offset of B's centre.
    pub(super) d: Vector<L>,
    pub(super) m: L,
    pub(super) margin: L,
    /// Sum of the circumradii, rounded up.
    pub(super) circumradius: L,
    /// Sum of the inradii of the hulls, rounded down and rounded up.
    pub(super) inradius: L,
    pub(super) inradius_above: L,
    /// The noise of an end of the bracket that does not scale with `d`: rounding, and the distance of
    /// the hulls' corners from those of the boxes.
    pub(super) noise: L,
    pub(super) rounding_band: L,
    pub(super) merge_distance: L,
    pub(super) unit: L,
    pub(super) rotation_a: Matrix<L>,
    pub(super) translation_a: Vector<L>,
    /// From the origin of A's hull frame to A's centre; world axes, caller's units.
    pub(super) centre_a: Vector<L>,
    /// Lanes whose lengths are so far apart that a product might overflow or underflow, or whose centres
    /// coincide, are not set.
    pub(super) usable: L::Mask,
}

impl<L: Lanes> Frame<L> {
    #[inline(always)]
    pub(super) fn load(group: &Group<'_>, at: usize) -> Self {
        let a = PosedBox::<L>::load(&group.boxes[0], &group.poses[0], at);
        let b = PosedBox::<L>::load(&group.boxes[1], &group.poses[1], at);
        let unit = a.scale.max(b.scale);
        let per_unit = L::splat(1.0) / unit;
        let (scale_a, scale_b) = (a.scale * per_unit, b.scale * per_unit);
        let (half_a, half_b) = (a.half.scale(scale_a), b.half.scale(scale_b));

        let centre_a = a.rotation * a.centre;
        let between = b.translation - a.translation;
        let offset = between + (b.rotation * b.centre - centre_a);
        let d = a.rotation.transposed_times(offset.scale(per_unit));
        let distance = d.length();
        let m = between.scale(per_unit).length() + (a.reach + b.reach) * per_unit;

        let circumradius = (half_a.length() + half_b.length()) * L::splat(LENGTH_ABOVE);
        let noise = L::splat((NOISE + OFF_BOX) * U) * circumradius;
        let inradius = half_a.min_element() + half_b.min_element();
        let band = L::splat(BAND) * (circumradius + distance) + L::splat(NOISE) * m;

        let far = L::splat(LANE_RANGE).ge(m) & m.ge(L::splat(1.0 / LANE_RANGE));
        let alike = scale_a.min(scale_b).ge(L::splat(1.0 / LANE_RANGE));
        let apart = distance.gt(L::splat(COINCIDENT * U) * m);
        Self {
            half_a,
            half_b,
            rotation: a.rotation.transposed_times_matrix(b.rotation),
            d,
            m,
            margin: a.margin / unit,
            circumradius,
            inradius: inradius - noise,
            inradius_above: inradius + noise,
            noise,
            rounding_band: L::splat(U) * band,
            merge_distance: L::splat(MERGE * U) * (circumradius + m),
            unit,
            rotation_a: a.rotation,
            translation_a: a.translation,
            centre_a,
            usable: far & alike & apart,
        }
    }
}

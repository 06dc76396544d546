//! Step 2: the feature of a box that a direction touches, by the Gauss map.
//!
//! These are the rules of `gauss_map`, for a box in its own axes. The six faces are 90 degrees apart, so
//! at most one is within the feature angle (which is at most 0.5 rad) of the direction `n`:
//!
//! ```text
//! face with normal i    n is within the angle of the axis i: n_j^2 + n_k^2 <= sin^2
//! edge along k          otherwise, n is within the angle of the plane across k: |n_k| <= sin;
//!                       of two such edges the one with the smaller |n_k|
//! vertex                otherwise
//! ```
//!
//! A face or an edge is touched too if all its vertices are within the *depth* of the farthest one. A
//! lane is unsure if a quantity is so near to its limit that rounding, or the distance of the hull's
//! corners from those of the box, could decide; if two edges tie; and if the depth reaches beyond the
//! feature that the angle names.

use super::simd::Lanes;
use super::vector::Vector;
use crate::tolerance::{LONE, MERGE, U};

/// The feature angle, in the form in which the rules need it.
#[derive(Clone, Copy, Debug)]
pub(super) struct FeatureAngle {
    sine: f64,
    /// Half the width of the band around the sine, and around its square, in which a lane is unsure.
    sine_band: f64,
    square_band: f64,
}

impl FeatureAngle {
    pub(super) fn new(sine: f64) -> Self {
        let square_band = LONE * sine * sine + MERGE * U * sine;
        Self { sine, sine_band: LONE * sine + MERGE * U, square_band }
    }
}

/// A feature in each lane.
#[derive(Clone, Copy)]
pub(super) struct Feature<L: Lanes> {
    /// Whether it is a face, an edge, a vertex: one of them in each lane that is sure.
    pub(super) is_face: L::Mask,
    pub(super) is_edge: L::Mask,
    /// The sign of each coordinate of its points, 1 or -1; 0 for the axes along which it extends.
    pub(super) signs: Vector<L>,
    pub(super) sure: L::Mask,
}

impl<L: Lanes> Feature<L> {
    /// The feature that `n` (outward, unit, the box's own axes) touches. `depth` is a length in the unit of
    /// `half`.
    #[inline(always)]
    pub(super) fn touched(n: Vector<L>, half: Vector<L>, depth: L, angle: FeatureAngle) -> Self {
        let size = n.abs();
        let square = n.times(n);
        // Twice how far a face's or an edge's points differ in height.
        let span = size.times(half).scale(L::splat(4.0));
        let deep = L::splat(4.0) * depth;
        let x = Tilt::face(square.y + square.z, span.y + span.z, depth, deep, angle);
        let y = Tilt::face(square.z + square.x, span.z + span.x, depth, deep, angle);
        let z = Tilt::face(square.x + square.y, span.x + span.y, depth, deep, angle);
        let is_face = x.within | y.within | z.within;
        let two_faces = (x.within & y.within) | (y.within & z.within) | (z.within & x.within);
        let unsure_face = x.unsure | y.unsure | z.unsure | two_faces;

        let along_x = Tilt::edge(size.x, span.x, depth, deep, angle);
        let along_y = Tilt::edge(size.y, span.y, depth, deep, angle);
        let along_z = Tilt::edge(size.z, span.z, depth, deep, angle);
        // An edge that is not within counts as far off, for the comparison of those that are.
        let far = L::splat(2.0);
        let tilt_x = L::select(along_x.within, size.x, far);
        let tilt_y = L::select(along_y.within, size.y, far);
        let tilt_z = L::select(along_z.within, size.z, far);
        let least = tilt_x.min(tilt_y).min(tilt_z);
        let is_x = least.ge(tilt_x);
        let is_y = least.ge(tilt_y) & !is_x;
        let is_z = !(is_x | is_y);
        let tied = L::splat(MERGE * U) + least;
        let second = L::select(is_x, tilt_y.min(tilt_z), tilt_x.min(L::select(is_y, tilt_z, tilt_y)));
        let is_edge = (along_x.within | along_y.within | along_z.within) & !is_face;
        let unsure_edge = along_x.unsure | along_y.unsure | along_z.unsure | (is_edge & tied.ge(second));

        let sign = Vector::splat(L::splat(1.0)).copysign(n);
        let zero = L::splat(0.0);
        Self {
            is_face,
            is_edge,
            signs: Vector {
                x: L::select((is_face & !x.within) | (is_edge & is_x), zero, sign.x),
                y: L::select((is_face & !y.within) | (is_edge & is_y), zero, sign.y),
                z: L::select((is_face & !z.within) | (is_edge & is_z), zero, sign.z),
            },
            sure: !(unsure_face | (unsure_edge & !is_face)),
        }
    }

    #[inline(always)]
    pub(super) fn is_vertex(&self) -> L::Mask {
        !(self.is_face | self.is_edge)
    }

    /// 1 along each axis along which the feature extends, otherwise 0.
    #[inline(always)]
    pub(super) fn extent(&self) -> Vector<L> {
        Vector::splat(L::splat(1.0)) - self.signs.abs()
    }

    /// A number from 0 to 26 that names the feature: the signs as digits of base 3.
    #[inline(always)]
    pub(super) fn code(&self) -> L {
        let digits = self.signs + Vector::splat(L::splat(1.0));
        digits.x + L::splat(3.0) * digits.y + L::splat(9.0) * digits.z
    }
}

/// Whether a face or an edge is within the angle, or the depth, of a direction.
#[derive(Clone, Copy)]
struct Tilt<L: Lanes> {
    within: L::Mask,
    unsure: L::Mask,
}

impl<L: Lanes> Tilt<L> {
    #[inline(always)]
    fn face(square: L, span: L, depth: L, deep: L, angle: FeatureAngle) -> Self {
        let limit = angle.sine * angle.sine;
        let (low, high) = (limit - angle.square_band, limit + angle.square_band);
        Self::of(square, [low, high], span, depth, deep)
    }

    #[inline(always)]
    fn edge(tilt: L, span: L, depth: L, deep: L, angle: FeatureAngle) -> Self {
        let (low, high) = (angle.sine - angle.sine_band, angle.sine + angle.sine_band);
        Self::of(tilt, [low, high], span, depth, deep)
    }

    /// `span` is twice the difference of the heights: surely within the depth up to `depth`, and surely not
    /// beyond `deep`, which is four times as much.
    #[inline(always)]
    fn of(tilt: L, [low, high]: [f64; 2], span: L, depth: L, deep: L) -> Self {
        let within = L::splat(low).ge(tilt) | depth.ge(span);
        let maybe = L::splat(high).ge(tilt) | deep.ge(span);
        Self { within, unsure: maybe & !within }
    }
}

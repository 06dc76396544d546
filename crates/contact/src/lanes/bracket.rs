//! Step 1, the bracket: a direction below, and a point that both grown boxes hold above.
//!
//! The direction proves `alpha >= n.d / h(n)`, as everywhere (`growth`). For the upper end let `p` be any
//! point, relative to A's centre. The *gauge* of a box is the factor at which its surface reaches a
//! point. At the scale `g`, the larger one of A's gauge of `p` and B's gauge of `p - d`, both grown
//! boxes hold `p`, so they meet: `alpha <= g`. The point is a witness; it needs no trust in how it was
//! found. These are tried:
//!
//! ```text
//! of a face   the grown corner of the other box that touches the face's plane
//! of edges    the point of A's grown edge that is nearest to B's grown edge
//! between     for parallel faces, between the centres of both, or as near to B's as A's face allows
//! ```
//!
//! Rounding: `p` is exact by definition. If the computed `p - d` is off by a vector `x`, `d` lies
//! within `|x|` of `g K`, and because `K` contains a ball of radius `r`, in `(g + |x| / r) K`. The same
//! argument covers hulls whose corners are up to `e` from those of the box: `K` of the boxes lies
//! within `e_A + e_B` of the hulls' `K`, so `alpha <= g (1 + (e_A + e_B) / r)`. Hulls take part only if
//! `e` is at most [`OFF_BOX`](crate::tolerance::OFF_BOX) roundoffs of the circumradius, which leaves
//! the bracket inside the published budget. (The bound in terms of each box's own half extents, which
//! has no Minkowski difference in it, is wider: a big thin plate would spoil that of a small cube.)

use super::axes::Direction;
use super::frame::Frame;
use super::simd::Lanes;
use super::vector::Vector;
use crate::tolerance::{LANE_BRACKET, NOISE, PARALLEL_FACES, U};

/// Growth scale and bracket, with the point that proves the upper end.
#[derive(Clone, Copy)]
pub(super) struct Bracket<L: Lanes> {
    pub(super) alpha: L,
    pub(super) upper: L,
    /// The witness point by the axes of A about A's centre, and of B about B's, divided by the half
    /// extents: 1 or -1 on a face of the box itself.
    pub(super) in_a: Vector<L>,
    pub(super) in_b: Vector<L>,
    /// Whether it is the point between parallel faces.
    pub(super) between: L::Mask,
    /// Whether the bracket is as tight as it can be asked for.
    pub(super) closed: L::Mask,
}

impl<L: Lanes> Bracket<L> {
    #[inline(always)]
    pub(super) fn new(frame: &Frame<L>, direction: &Direction<L>) -> Self {
        let Frame { half_a, half_b, rotation, d, .. } = *frame;
        let Direction { n, n_in_b, along, reach_a, reach, of_edges, of_b, .. } = *direction;
        let lower = lower_bound(frame, direction);
        let alpha = along / reach;
        let inverses = [half_a.inverses(), half_b.inverses()];
        let [inverse_a, inverse_b] = inverses;

        // The point of edges or of a face. The grown corners that touch the plane across n, and for edges their
        // middle:
        let axis_a = direction.axis_a;
        let corner_a = half_a.copysign(n);
        let corner_b = half_b.copysign(-n_in_b);
        let middle_a = corner_a - axis_a.times(corner_a);
        let middle_b = corner_b - direction.axis_b.times(corner_b);
        let b_in_a = rotation * Vector::select(of_edges, middle_b, corner_b);
        let of_a_face = d + b_in_a.scale(alpha);
        let across_b = direction.axis_b_in_a.cross(n);
        let rest = of_a_face - middle_a.scale(alpha);
        let on_edge = rest.dot(across_b) / axis_a.dot(across_b);
        let of_edge = middle_a.scale(alpha) + axis_a.scale(on_edge);
        let of_face = Vector::select(of_b, corner_a.scale(alpha), of_a_face);
        let p = Vector::select(of_edges, of_edge, of_face);
        let first = Witness::new(frame, inverses, p);

        // Between parallel faces, if they are: on the plane of A's grown face, at the share of the offset that
        // A's gauge leaves to it, or at the point of the face that is nearest to the centre of B.
        let aside = d - n.scale(along);
        let aside_b = rotation.transposed_times(aside);
        let gauge_a = aside.times(inverse_a).abs().max_element();
        let gauge_b = aside_b.times(inverse_b).abs().max_element();
        let whole = gauge_a + gauge_b;
        let share = L::select(whole.gt(L::splat(0.0)), gauge_b / whole, L::splat(0.5));
        let middle = n.scale(alpha * reach_a);
        let shared = Witness::new(frame, inverses, middle + aside.scale(share));
        let nearest = half_a.scale(alpha).min(aside.abs()).copysign(aside);
        let nearest = Witness::new(frame, inverses, middle + nearest);
        let between_faces = Witness::better(shared, nearest);
        let own = Vector::select(of_b, n, n_in_b).abs();
        let tilt = own.x + own.y + own.z - own.max_element();
        let between = first.gauge.gt(between_faces.gauge) & L::splat(PARALLEL_FACES).ge(tilt) & !of_edges;
        let witness = Witness::select(between, between_faces, first);

        let gauge = witness.gauge.max(alpha);
        let error = L::splat(NOISE * U) * frame.m + frame.noise * gauge;
        let upper = (gauge + error / frame.inradius).next_up();
        let allowed = upper * (L::splat(LANE_BRACKET * U) * frame.circumradius / frame.inradius_above)
            + L::splat(2.0 * NOISE * U) * frame.m / frame.inradius_above;
        Self {
            alpha: alpha.max(lower).min(upper),
            upper,
            in_a: witness.in_a,
            in_b: witness.in_b,
            between,
            closed: allowed.ge(upper - lower) & lower.gt(L::splat(0.0)),
        }
    }
}

/// A point that both boxes hold at the scale `gauge`; the coordinates are those of [`Bracket`].
#[derive(Clone, Copy)]
struct Witness<L> {
    in_a: Vector<L>,
    in_b: Vector<L>,
    gauge: L,
}

impl<L: Lanes> Witness<L> {
    #[inline(always)]
    fn new(frame: &Frame<L>, [inverse_a, inverse_b]: [Vector<L>; 2], p: Vector<L>) -> Self {
        let in_a = p.times(inverse_a);
        let in_b = frame.rotation.transposed_times(p - frame.d).times(inverse_b);
        Self { in_a, in_b, gauge: in_a.abs().max_element().max(in_b.abs().max_element()) }
    }

    #[inline(always)]
    fn select(mask: L::Mask, yes: Self, no: Self) -> Self {
        Self {
            in_a: Vector::select(mask, yes.in_a, no.in_a),
            in_b: Vector::select(mask, yes.in_b, no.in_b),
            gauge: L::select(mask, yes.gauge, no.gauge),
        }
    }

    /// The one with the smaller gauge.
    #[inline(always)]
    fn better(a: Self, b: Self) -> Self {
        Self::select(a.gauge.gt(b.gauge), b, a)
    }
}

/// The lower bound of alpha that a direction proves, rounded down; 0 if it proves none.
#[inline(always)]
pub(super) fn lower_bound<L: Lanes>(frame: &Frame<L>, direction: &Direction<L>) -> L {
    let along = direction.along - L::splat(NOISE * U) * frame.m;
    let zero = L::splat(0.0);
    L::select(along.gt(zero), (along / (direction.reach + frame.noise)).next_down(), zero)
}

/// Whether a direction certifies that the boxes are farther apart than the margin.
#[inline(always)]
pub(super) fn separates<L: Lanes>(frame: &Frame<L>, direction: &Direction<L>) -> L::Mask {
    (direction.along - direction.reach).gt(frame.margin + frame.rounding_band)
}

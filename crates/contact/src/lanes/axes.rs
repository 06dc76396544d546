//! Step 1, the direction: the separating axis of two boxes with the largest growth scale.
//!
//! The Minkowski difference of two boxes has facets with 15 pairs of normals: A's three axes, B's
//! three, and the cross products of an axis of A and one of B (S. Gottschalk, M. C. Lin and D.
//! Manocha, *OBBTree*, 1996, doi:10.1145/237170.237244). The growth scale is the largest
//! `n.d / h(n)` over these normals, where `h(n)` is how far the difference reaches along `n`.
//!
//! Fractions are compared by cross-multiplication, so nothing is divided before the axis is known. A
//! face wins against an edge pair if they are equal to rounding. Edges that are nearly parallel have
//! no axis. Nothing rests on this choice: the bracket is proved for the direction that was chosen.

use super::frame::Frame;
use super::simd::{Lanes, Mask};
use super::vector::Vector;
use crate::tolerance::{LANE_SAME_AXIS, PARALLEL_EDGES};

/// A direction from A to B, and the axes that made it.
#[derive(Clone, Copy)]
pub(super) struct Direction<L: Lanes> {
    /// Unit; A's axes and B's.
    pub(super) n: Vector<L>,
    pub(super) n_in_b: Vector<L>,
    /// How far the centres are apart along `n`, and how far the difference of the boxes reaches.
    pub(super) along: L,
    pub(super) reach_a: L,
    pub(super) reach: L,
    /// Whether it is the cross product of two edges, and whether it is an axis of B. Otherwise it is an
    /// axis of A, or the line of centres.
    pub(super) of_edges: L::Mask,
    pub(super) of_b: L::Mask,
    /// The axes of A and of B that made it: 1 at the axis and 0 elsewhere.
    pub(super) axis_a: Vector<L>,
    pub(super) axis_b: Vector<L>,
    /// The axis of B, in A's axes.
    pub(super) axis_b_in_a: Vector<L>,
}

/// A candidate: the fraction `along / reach`, and a number that names the axis: 0 to 2 for A's, 3 to 5
/// for B's, `6 + 3 j + i` for A's axis `i` and B's axis `j`.
#[derive(Clone, Copy)]
struct Candidate<L> {
    along: L,
    reach: L,
    name: L,
}

/// The name of the line of centres, for bodies that are far apart.
const LINE: f64 = 15.0;

impl<L: Lanes> Candidate<L> {
    #[inline(always)]
    fn new(along: L, reach: L, name: usize) -> Self {
        Self { along, reach, name: L::splat(name as f64) }
    }

    /// The larger fraction; `self` if they are equal.
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        let better = (other.along * self.reach).gt(self.along * other.reach);
        Self {
            along: L::select(better, other.along, self.along),
            reach: L::select(better, other.reach, self.reach),
            name: L::select(better, other.name, self.name),
        }
    }

    /// Chooses by `along - reach` instead.
    #[inline(always)]
    fn or_farther(self, other: Self) -> Self {
        let better = (other.along - other.reach).gt(self.along - self.reach);
        Self {
            along: L::select(better, other.along, self.along),
            reach: L::select(better, other.reach, self.reach),
            name: L::select(better, other.name, self.name),
        }
    }
}

impl<L: Lanes> Direction<L> {
    /// A face normal along which the boxes are apart by more than the margin, if there is one. Otherwise
    /// the line of centres if the circumscribed spheres are apart, and otherwise the axis with the
    /// largest growth scale.
    #[inline(always)]
    pub(super) fn choose(frame: &Frame<L>) -> Self {
        let Frame { half_a, half_b, rotation, d, .. } = *frame;
        let size = rotation.abs();
        let along_a = d.abs();
        let along_b = rotation.transposed_times(d).abs();
        let reach_a = half_a + size * half_b;
        let reach_b = half_b + size.transposed_times(half_a);
        let a0 = Candidate::new(along_a.x, reach_a.x, 0);
        let a1 = Candidate::new(along_a.y, reach_a.y, 1);
        let a2 = Candidate::new(along_a.z, reach_a.z, 2);
        let b0 = Candidate::new(along_b.x, reach_b.x, 3);
        let b1 = Candidate::new(along_b.y, reach_b.y, 4);
        let b2 = Candidate::new(along_b.z, reach_b.z, 5);

        let apart = frame.margin + frame.rounding_band;
        let farthest = a0.or_farther(a1).or_farther(a2).or_farther(b0.or_farther(b1).or_farther(b2));
        let is_face_apart = (farthest.along - farthest.reach).gt(apart);
        let others = !is_face_apart;
        if !others.any() {
            // Every lane has its direction. This only saves time, above all for single pairs.
            return Self::named(frame, farthest.name);
        }

        let mut best = a0.or(a1).or(a2).or(b0.or(b1).or(b2));
        // A tie to rounding is the face's: its share is raised by that much.
        best.along = best.along * L::splat(1.0 + LANE_SAME_AXIS);
        let e0 = edges(frame, rotation.x, size.x, [half_b.y, half_b.z], [size.y, size.z], 6);
        let e1 = edges(frame, rotation.y, size.y, [half_b.z, half_b.x], [size.z, size.x], 9);
        let e2 = edges(frame, rotation.z, size.z, [half_b.x, half_b.y], [size.x, size.y], 12);
        let best = best.or(e0.or(e1).or(e2));

        let is_far = (d.length() - frame.circumradius).gt(apart);
        let name = L::select(is_far, L::splat(LINE), best.name);
        Self::named(frame, L::select(is_face_apart, farthest.name, name))
    }

    /// The direction of an axis by its name.
    #[inline(always)]
    fn named(frame: &Frame<L>, name: L) -> Self {
        let Frame { half_a, half_b, rotation, d, .. } = *frame;
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let is_line = name.ge(L::splat(LINE));
        let of_edges = name.ge(L::splat(6.0)) & !is_line;
        let of_b = name.ge(L::splat(3.0)) & !of_edges & !is_line;
        // The number j of an edge pair `6 + 3 j + i`, then i.
        let third =
            L::select(name.ge(L::splat(9.0)), one, zero) + L::select(name.ge(L::splat(12.0)), one, zero);
        let j = L::select(of_edges, third, name - L::splat(3.0));
        let i = L::select(of_edges, name - L::splat(6.0) - L::splat(3.0) * third, name);
        let axis_a = one_hot(i);
        let axis_b = one_hot(j);
        let axis_b_in_a = rotation * axis_b;
        let face = Vector::select(of_b, axis_b_in_a, axis_a);
        let along = Vector::select(of_edges, axis_a.cross(axis_b_in_a), Vector::select(is_line, d, face));
        let n = along.scale(one.copysign(along.dot(d)) / along.length());
        let n_in_b = rotation.transposed_times(n);
        let reach_a = n.abs().dot(half_a);
        Self {
            n,
            n_in_b,
            along: n.dot(d),
            reach_a,
            reach: reach_a + n_in_b.abs().dot(half_b),
            of_edges,
            of_b,
            axis_a,
            axis_b,
            axis_b_in_a,
        }
    }
}

/// 1 at the axis with this number, and 0 elsewhere.
#[inline(always)]
fn one_hot<L: Lanes>(axis: L) -> Vector<L> {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let (from_y, from_z) = (axis.ge(one), axis.ge(L::splat(2.0)));
    Vector {
        x: L::select(from_y, zero, one),
        y: L::select(from_z, zero, L::select(from_y, one, zero)),
        z: L::select(from_z, one, zero),
    }
}

/// The best of the cross products of one axis of B, `axis`, with A's three. `half` and `size_of` are the
/// half extents of B along its other two axes and the magnitudes of these axes, in cyclic order.
#[inline(always)]
fn edges<L: Lanes>(
    frame: &Frame<L>,
    axis: Vector<L>,
    size: Vector<L>,
    half: [L; 2],
    size_of: [Vector<L>; 2],
    first_name: usize,
) -> Candidate<L> {
    let half_a = frame.half_a;
    let along = axis.cross(frame.d).abs();
    let across_a = Vector {
        x: half_a.y * size.z + half_a.z * size.y,
        y: half_a.z * size.x + half_a.x * size.z,
        z: half_a.x * size.y + half_a.y * size.x,
    };
    let reach = across_a + (size_of[1].scale(half[0]) + size_of[0].scale(half[1]));
    // Nearly parallel edges get the fraction 0.
    let most = L::splat(PARALLEL_EDGES);
    let zero = L::splat(0.0);
    let x = L::select(most.gt(size.x), along.x, zero);
    let y = L::select(most.gt(size.y), along.y, zero);
    let z = L::select(most.gt(size.z), along.z, zero);
    let c0 = Candidate::new(x, reach.x, first_name);
    let c1 = Candidate::new(y, reach.y, first_name + 1);
    let c2 = Candidate::new(z, reach.z, first_name + 2);
    c0.or(c1).or(c2)
}

//! Step 3 for two features that meet in one point: a face and a vertex, or two edges.
//!
//! ```text
//! face of A, vertex of B    lower the vertex along n onto the face's plane
//! vertex of A, face of B    raise the vertex along n onto the face's plane
//! edge, edge                their crossing, seen along n
//! ```
//!
//! The point counts if it is inside the face, or inside both edges, by more than a few merge distances.
//! Any other lane is unsure: its projections may miss each other, or meet in a corner.

use super::axes::Direction;
use super::features::Feature;
use super::frame::Frame;
use super::simd::Lanes;
use super::vector::Vector;
use crate::tolerance::LANE_INSIDE;

/// The contact point of each lane that has exactly one.
#[derive(Clone, Copy)]
pub(super) struct Single<L: Lanes> {
    /// The witness on A: A's axes, about A's centre, pair units.
    pub(super) witness: Vector<L>,
    /// Along the normal, pair units.
    pub(super) distance: L,
    /// The lanes whose point is certain.
    pub(super) sure: L::Mask,
}

impl<L: Lanes> Single<L> {
    #[inline(always)]
    pub(super) fn new(frame: &Frame<L>, direction: &Direction<L>, a: &Feature<L>, b: &Feature<L>) -> Self {
        let Frame { half_a, half_b, rotation, d, .. } = *frame;
        let Direction { n, n_in_b, .. } = *direction;
        // A point of each feature: the vertex, or the middle.
        let on_a = a.signs.times(half_a);
        let on_b = b.signs.times(half_b);
        let on_b_in_a = rotation * on_b + d;
        let on_a_in_b = rotation.transposed_times(on_a - d);

        let offset_a = a.signs.abs().dot(half_a);
        let fall = (a.signs.dot(on_b_in_a) - offset_a) / a.signs.dot(n);
        let lowered = on_b_in_a - n.scale(fall);
        let offset_b = b.signs.abs().dot(half_b);
        let rise = (offset_b - b.signs.dot(on_a_in_b)) / b.signs.dot(n_in_b);
        let raised_in_b = on_a_in_b + n_in_b.scale(rise);

        let (along_a, along_b_in_b) = (a.extent(), b.extent());
        let along_b = rotation * along_b_in_b;
        let between = on_b_in_a - on_a;
        let (past_b, past_a) = (along_b.cross(n), along_a.cross(n));
        let sine = along_a.dot(past_b);
        let at_a = between.dot(past_b) / sine;
        let at_b = -(between.dot(past_a) / along_b.dot(past_a));
        let crossing = on_a + along_a.scale(at_a);
        let gap = n.dot(between + along_b.scale(at_b));

        let inside_a = inside(lowered, half_a, along_a);
        let inside_b = inside(raised_in_b, half_b, along_b_in_b);
        let ends = (along_a.dot(half_a) - at_a.abs()).min(along_b_in_b.dot(half_b) - at_b.abs());
        let inside_both = ends * sine.abs();

        let lower = a.is_face & b.is_vertex();
        let raise = a.is_vertex() & b.is_face;
        let cross = a.is_edge & b.is_edge;
        let by = L::select(lower, inside_a, L::select(raise, inside_b, inside_both));
        let least = L::splat(LANE_INSIDE) * frame.merge_distance;
        Self {
            witness: Vector::select(lower, lowered, Vector::select(raise, on_a, crossing)),
            distance: L::select(lower, fall, L::select(raise, rise, gap)),
            sure: (lower | raise | cross) & by.gt(least),
        }
    }

    /// Whether any lane may have a single point.
    #[inline(always)]
    pub(super) fn possible(a: &Feature<L>, b: &Feature<L>) -> L::Mask {
        (a.is_face & b.is_vertex()) | (a.is_vertex() & b.is_face) | (a.is_edge & b.is_edge)
    }
}

/// How far a point is inside a box's face, along the axes along which the face extends.
#[inline(always)]
fn inside<L: Lanes>(point: Vector<L>, half: Vector<L>, extent: Vector<L>) -> L {
    let depth = half - point.abs();
    let (zero, far) = (L::splat(0.0), L::splat(f64::INFINITY));
    let x = L::select(extent.x.gt(zero), depth.x, far);
    let y = L::select(extent.y.gt(zero), depth.y, far);
    let z = L::select(extent.z.gt(zero), depth.z, far);
    x.min(y).min(z)
}

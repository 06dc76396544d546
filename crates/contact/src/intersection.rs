//! Step 3: from the two touching features to the contact points.
//!
//! After Silcowitz, Niebe and Erleben (SCA 2010, section 5). Both features are projected along the
//! normal onto the *contact plane* and intersected there. Every vertex of the intersection is lifted
//! back onto both features and becomes a contact point with two witnesses:
//!
//! ```text
//!            B
//!      ______b________         project both features onto the plane across n
//!            :       :  n      intersect the two outlines in that plane
//!            :       :  ^      lift each vertex along n: to a, at height_a on A,
//!       _____a_______a__|_         and to b, at height_b on B
//!            A                 distance of the point = height_b - height_a
//! ```
//!
//! The witnesses of a point differ only along the normal. Each point has an id of the parts of A and B
//! that made it, so that a simulation can recognise it in the next step.
//!
//! | features | intersection | where |
//! |---|---|---|
//! | face, face | convex polygon, segment or point | `polygons` if small and in general position, or `clip` |
//! | face, edge | up to two points | `clip` |
//! | face, vertex | up to one point | `clip` |
//! | edge, edge | the crossing, or the ends that lie on the other edge | `overlap` |
//! | edge, vertex; vertex, vertex | up to one point | `overlap` |
//! | features that miss each other | one estimated point between the closest points | `closest` |
//!
//! All inside tests include points within the merge distance. Corners and sides are lifted along the
//! hull's own vertices, and points inside a face are lifted onto the face's plane. Features of `n` and
//! `m` sides take `O(n m)` time if small, and `O(n + m)` if large.
//!
//! Departure from the paper: projections may miss each other although the hulls overlap, so there is
//! always at least one point. Such a point is flagged as estimated.

mod clip;
mod closest;
mod outline;
mod overlap;
mod polygons;

use glam::{DVec2, DVec3};

use super::cost::{LOOK, POINT, SIDE};
use super::manifold::Element;
use super::pair::Pair;
use outline::{Outline, View};

pub(crate) use super::gauss_map::Touched;

/// A contact point in the pair's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlanePoint {
    /// Coordinates on the contact plane, pair units.
    pub(crate) at: DVec2,
    /// Heights of the witnesses on A and on B, along the normal.
    pub(crate) height_a: f64,
    pub(crate) height_b: f64,
    pub(crate) id: [Element; 2],
}

/// The contact points found, and buffers.
#[derive(Debug, Default)]
pub(crate) struct Intersection {
    a: Outline,
    b: Outline,
    polygons: polygons::Polygons,
    clip: clip::Clip,
    closest: closest::Scratch,
    /// Contact points in order, anticlockwise about the normal.
    pub(crate) points: Vec<PlanePoint>,
    /// Index of the point with the lowest id, with which answers begin.
    pub(crate) first: usize,
    /// Whether the projections miss each other, so that the one point is an estimate.
    pub(crate) estimated: bool,
    /// How far below their faces' planes the corners of both features may lie, in sum; pair units.
    pub(crate) planarity: f64,
    /// Right-handed axes, A's frame: two in the contact plane, and the normal.
    axes: [DVec3; 3],
}

impl Intersection {
    /// Intersects the features of `pair` that `normal` (unit, A's frame) touches, and fills in the fields.
    pub(crate) fn find(&mut self, pair: &Pair<'_>, normal: DVec3, [feature_a, feature_b]: [Touched; 2]) {
        let (e1, e2) = normal.any_orthonormal_pair();
        let axes = [e1, e2, normal];
        self.axes = axes;
        let from_a =
            View { axes: axes.map(|axis| axis * pair.scale_a), centre: DVec3::ZERO, scale: pair.scale_a };
        let from_b = View {
            axes: axes.map(|axis| pair.direction_in_b(axis) * pair.scale_b),
            centre: DVec3::new(e1.dot(pair.d), e2.dot(pair.d), normal.dot(pair.d)),
            scale: pair.scale_b,
        };
        self.a.project(pair.a, feature_a, &from_a);
        self.b.project(pair.b, feature_b, &from_b);
        self.planarity = self.a.planarity + self.b.planarity;
        self.b.set_sides();
        if self.b.corners.len() <= 2 || clip::are_large(&self.a, &self.b) {
            self.a.set_sides();
        }
        let sides = self.a.corners.len() + self.b.corners.len();
        pair.count.add(SIDE * sides as u64);

        let eps = pair.merge_distance();
        self.points.clear();
        self.first =
            overlap::find(&self.a, &self.b, eps, &mut self.polygons, &mut self.clip, &mut self.points);
        pair.count.add(LOOK * self.clip.take_looked_at() + POINT * self.points.len() as u64);
        self.estimated = self.points.is_empty();
        if self.estimated {
            let closest = closest::estimate(&self.a, &self.b, eps, &mut self.closest);
            let closest::Closest { point, gap, looked_at } = closest;
            pair.count.add(LOOK * looked_at);
            self.points.push(point);
            // At a sharp corner, clipping may cut off a point that is beyond the corner although the
            // projections meet to within eps. Such a point is not an estimate.
            self.estimated = gap > eps;
        }
    }

    /// Right-handed axes in the pair's frame: two in the contact plane, and the normal. A point's witness
    /// on A has the coordinates `[at.x, at.y, height_a]` along them.
    pub(crate) fn axes(&self) -> [DVec3; 3] {
        self.axes
    }
}

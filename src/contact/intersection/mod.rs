//! Step 3: from the two features to the contact points (Silcowitz et al. 2010,
//! section 5).
//!
//! Both features are projected along the normal on the contact plane and
//! intersected there; every vertex of the intersection, lifted back onto both
//! features, is a contact point. Inside tests are inclusive by the merge
//! distance. Corners and sides lift along the hull's own vertices, the inside
//! of a face along its plane.

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
    /// On the contact plane.
    pub(crate) at: DVec2,
    /// Of the witnesses on A and on B, along the normal.
    pub(crate) height_a: f64,
    pub(crate) height_b: f64,
    pub(crate) id: [Element; 2],
}

/// Buffers, and the points found.
#[derive(Debug, Default)]
pub(crate) struct Intersection {
    a: Outline,
    b: Outline,
    polygons: polygons::Polygons,
    clip: clip::Clip,
    closest: closest::Scratch,
    /// Anticlockwise about the normal.
    pub(crate) points: Vec<PlanePoint>,
    /// Which of them has the lowest id: answers begin there.
    pub(crate) first: usize,
    /// The projections miss each other; the one point is an estimate.
    pub(crate) estimated: bool,
    /// How far below their planes the corners of both features may lie; pair units.
    pub(crate) planarity: f64,
    /// Right-handed: two of the contact plane, and the normal.
    axes: [DVec3; 3],
}

impl Intersection {
    /// Intersects the features of `pair` that `normal` (unit, A's frame) touches.
    pub(crate) fn find(&mut self, pair: &Pair<'_>, normal: DVec3, [feature_a, feature_b]: [Touched; 2]) {
        let (e1, e2) = normal.any_orthonormal_pair();
        let axes = [e1, e2, normal];
        self.axes = axes;
        let from_a =
            View { axes: axes.map(|axis| axis * pair.scale_a), center: DVec3::ZERO, scale: pair.scale_a };
        let from_b = View {
            axes: axes.map(|axis| pair.direction_in_b(axis) * pair.scale_b),
            center: DVec3::new(e1.dot(pair.d), e2.dot(pair.d), normal.dot(pair.d)),
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
            // Near a sharp corner what clipping cuts may be farther out than the corner is.
            self.estimated = gap > eps;
        }
    }

    /// Of the contact plane with the normal, right-handed: a point's witness on A
    /// is `[at.x, at.y, height_a]` along them, in the pair's frame.
    pub(crate) fn axes(&self) -> [DVec3; 3] {
        self.axes
    }
}

//! A feature projected on the contact plane.

use glam::{DVec2, DVec3};

use super::Touched;
use crate::contact::ConvexHull;
use crate::contact::manifold::Element;

/// A corner of a projected feature.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    pub(super) at: DVec2,
    /// Along the normal.
    pub(super) height: f64,
    /// As registered.
    pub(super) vertex: u32,
}

/// A projected feature: one corner, two, or a convex polygon anticlockwise
/// about the normal.
#[derive(Debug, Default)]
pub(super) struct Outline {
    pub(super) corners: Vec<Corner>,
    /// Of a face: height above the contact plane as `slope . at + base`.
    plane: Option<(DVec2, f64)>,
    lowest: f64,
    highest: f64,
    /// How far below its plane a corner of the face may lie; pair units.
    pub(super) planarity: f64,
}

impl Outline {
    /// Projects the feature's corners; `project` gives plane position and height
    /// of a vertex by the hull's own index.
    pub(super) fn fill(
        &mut self,
        hull: &ConvexHull,
        feature: Touched,
        project: impl Fn(u32) -> (DVec2, f64),
    ) {
        let corner = |v: u32| {
            let (at, height) = project(v);
            Corner { at, height, vertex: hull.registered_indices()[v as usize] }
        };
        self.corners.clear();
        match feature {
            Touched::Vertex(v) => self.corners.push(corner(v)),
            Touched::Edge(e) => self.corners.extend(hull.edge_vertices()[e as usize].map(corner)),
            Touched::Face(f) => self.corners.extend(hull.outline(f as usize).iter().map(|&v| corner(v))),
        }
        if doubled_area(&self.corners) < 0.0 {
            self.corners.reverse();
        }
        self.lowest = self.corners.iter().map(|c| c.height).fold(f64::INFINITY, f64::min);
        self.highest = self.corners.iter().map(|c| c.height).fold(f64::NEG_INFINITY, f64::max);
    }

    /// Keeps the plane of a face. `project` turns a direction of the hull's
    /// frame, `center` is where the contraction point is in that frame.
    pub(super) fn set_plane(
        &mut self,
        hull: &ConvexHull,
        feature: Touched,
        project: impl Fn(DVec3) -> (DVec2, f64),
        scale: f64,
        center: DVec3,
    ) {
        (self.plane, self.planarity) = (None, 0.0);
        if let Touched::Face(f) = feature {
            let m = hull.face_normals()[f as usize];
            let offset = hull.face_offsets()[f as usize] * scale + m.dot(center);
            let (across, along) = project(m);
            self.plane = Some((-across / along, offset / along));
            self.planarity = hull.face_planarity()[f as usize] * scale / along.abs();
        }
    }

    /// Side `i`, from corner `i` to the next; two corners make one side.
    pub(super) fn sides(&self) -> usize {
        match self.corners.len() {
            0 | 1 => 0,
            2 => 1,
            n => n,
        }
    }

    pub(super) fn side(&self, i: usize) -> [Corner; 2] {
        [self.corners[i], self.corners[(i + 1) % self.corners.len()]]
    }

    /// The side's name.
    pub(super) fn side_id(&self, i: usize) -> Element {
        let [a, b] = self.side(i).map(|c| c.vertex);
        Element::Edge([a.min(b), a.max(b)])
    }

    /// Height of the feature over a point of its projection.
    pub(super) fn height(&self, at: DVec2) -> f64 {
        let height = match (self.plane, self.corners.as_slice()) {
            (Some((slope, base)), _) => slope.dot(at) + base,
            (None, &[a, b]) => {
                let (whole, part) = (b.at - a.at, at - a.at);
                let share = (part.dot(whole) / whole.length_squared()).clamp(0.0, 1.0);
                if share.is_nan() { a.height } else { a.height + share * (b.height - a.height) }
            }
            (None, _) => self.lowest,
        };
        // A face seen edge-on has no height of its own over a point.
        if height.is_nan() { self.lowest } else { height.clamp(self.lowest, self.highest) }
    }
}

fn doubled_area(corners: &[Corner]) -> f64 {
    let Some(first) = corners.first() else { return 0.0 };
    corners.windows(2).map(|w| (w[0].at - first.at).perp_dot(w[1].at - first.at)).sum()
}

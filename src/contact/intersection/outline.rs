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

/// The line of a side.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side {
    /// Unit, inward; NaN for a side of no length.
    inward: DVec2,
    offset: f64,
}

impl Side {
    /// Of a point from the line, positive inside.
    #[inline]
    pub(super) fn distance(&self, at: DVec2) -> f64 {
        self.inward.dot(at) - self.offset
    }
}

/// What of an outline makes a vertex of an intersection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Part {
    Corner(u16),
    Side(u16),
    Inside,
}

/// A projected feature: one corner, two, or a convex polygon anticlockwise
/// about the normal.
#[derive(Debug, Default)]
pub(super) struct Outline {
    pub(super) corners: Vec<Corner>,
    /// Side `i` goes from corner `i` to the next; two corners make one side.
    pub(super) sides: Vec<Side>,
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
        (self.lowest, self.highest) =
            self.corners.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), c| {
                (low.min(c.height), high.max(c.height))
            });
        let sides = if self.corners.len() < 3 { self.corners.len() - 1 } else { self.corners.len() };
        self.sides.clear();
        for i in 0..sides {
            let (from, to) = (self.corners[i].at, self.corners[self.next(i)].at);
            let inward = (to - from).perp() / (to - from).length();
            self.sides.push(Side { inward, offset: inward.dot(from) });
        }
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

    /// The corner after corner `i`.
    #[inline]
    pub(super) fn next(&self, i: usize) -> usize {
        if i + 1 == self.corners.len() { 0 } else { i + 1 }
    }

    /// The ends of a side.
    pub(super) fn side(&self, i: usize) -> [Corner; 2] {
        [self.corners[i], self.corners[self.next(i)]]
    }

    /// A part's name, in vertices as registered.
    pub(super) fn named(&self, part: Part) -> Element {
        match part {
            Part::Corner(i) => Element::Vertex(self.corners[i as usize].vertex),
            Part::Side(i) => {
                let [a, b] = self.side(i as usize).map(|c| c.vertex);
                Element::Edge([a.min(b), a.max(b)])
            }
            Part::Inside => Element::Inside,
        }
    }

    /// Height of a part over a point of its projection.
    pub(super) fn height(&self, part: Part, at: DVec2) -> f64 {
        match (part, self.plane, self.corners.as_slice()) {
            (Part::Corner(i), ..) => self.corners[i as usize].height,
            (Part::Side(i), ..) => {
                height_on([self.corners[i as usize], self.corners[self.next(i as usize)]], at)
            }
            (Part::Inside, Some((slope, base)), _) => {
                let height = slope.dot(at) + base;
                // A face seen edge-on has no height of its own over a point.
                if height.is_nan() { self.lowest } else { height.clamp(self.lowest, self.highest) }
            }
            (Part::Inside, None, &[a, b]) => height_on([a, b], at),
            (Part::Inside, None, _) => self.lowest,
        }
    }
}

/// Height of a segment over the point of its projection nearest to `at`.
fn height_on([a, b]: [Corner; 2], at: DVec2) -> f64 {
    let whole = b.at - a.at;
    let share = ((at - a.at).dot(whole) / whole.length_squared()).clamp(0.0, 1.0);
    if share.is_nan() { a.height } else { a.height + share * (b.height - a.height) }
}

fn doubled_area(corners: &[Corner]) -> f64 {
    let Some(first) = corners.first() else { return 0.0 };
    corners.windows(2).map(|w| (w[0].at - first.at).perp_dot(w[1].at - first.at)).sum()
}

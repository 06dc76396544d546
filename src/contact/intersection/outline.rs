//! A feature projected on the contact plane.

use glam::{DVec2, DVec3};

use super::Touched;
use crate::contact::ConvexHull;
use crate::contact::manifold::Element;

/// Rise along the normal over length across it of a side's steepest direction.
/// Faces within the largest feature angle, 0.5 rad, stay below 0.55; of others
/// that touch all corners are within the merge distance of one height, and a
/// steep one is no wider than some of it: a segment.
const STEEPEST: f64 = 8.0;

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
    pub(super) inward: DVec2,
    offset: f64,
}

impl Side {
    /// Of a point from the line, positive inside.
    #[inline]
    pub(super) fn distance(&self, at: DVec2) -> f64 {
        self.inward.dot(at) - self.offset
    }
}

/// How a hull is seen from the contact plane: takes hull units of its own frame
/// to the plane's axes and the normal.
pub(super) struct View {
    /// The plane's axes and the normal, in the hull's frame, as long as a hull
    /// unit is in pair units.
    pub(super) axes: [DVec3; 3],
    /// Where the contraction point is seen.
    pub(super) center: DVec3,
    /// Pair units per hull unit.
    pub(super) scale: f64,
}

impl View {
    /// Of a direction: pair units.
    #[inline]
    fn direction(&self, v: DVec3) -> (DVec2, f64) {
        let [x, y, n] = self.axes.map(|axis| axis.dot(v));
        (DVec2::new(x, y), n)
    }

    /// Of a point: pair units.
    #[inline]
    fn point(&self, v: DVec3) -> (DVec2, f64) {
        let (at, height) = self.direction(v);
        (at + self.center.truncate(), height + self.center.z)
    }
}

/// A projected feature: one corner, two, or a convex polygon anticlockwise
/// about the normal.
#[derive(Debug, Default)]
pub(super) struct Outline {
    pub(super) corners: Vec<Corner>,
    /// Of an outline that others are measured against.
    pub(super) sides: Vec<Side>,
    /// The corners run against the hull's outline.
    reversed: bool,
    /// Of a face: height above the contact plane as `slope . at + base`.
    plane: Option<(DVec2, f64)>,
    lowest: f64,
    highest: f64,
    /// How far below its plane a corner of the face may lie; pair units.
    pub(super) planarity: f64,
}

impl Outline {
    /// Projects a feature of `hull`; its sides are left to [`Outline::set_sides`].
    pub(super) fn project(&mut self, hull: &ConvexHull, feature: Touched, view: &View) {
        let corner = |&v: &u32| {
            let (at, height) = view.point(hull.vertices()[v as usize]);
            Corner { at, height, vertex: hull.registered_indices()[v as usize] }
        };
        self.corners.clear();
        self.corners.extend(vertices(hull, &feature).iter().map(corner));
        self.reversed = doubled_area(&self.corners) < 0.0;
        if self.reversed {
            self.corners.reverse();
        }
        (self.lowest, self.highest) = (f64::INFINITY, f64::NEG_INFINITY);
        for corner in &self.corners {
            // As plain comparisons: no height is NaN, which min and max would mind.
            self.lowest = if corner.height < self.lowest { corner.height } else { self.lowest };
            self.highest = if corner.height > self.highest { corner.height } else { self.highest };
        }
        self.set_plane(hull, feature, view);
    }

    /// How many sides: side `i` goes from corner `i` to the next; two corners
    /// make one side.
    pub(super) fn side_count(&self) -> usize {
        if self.corners.len() > 2 { self.corners.len() } else { self.corners.len().saturating_sub(1) }
    }

    /// The lines of the sides. One shorter than `long` has the direction of the
    /// hull's own side: projected corners are rounded, and a side between them that
    /// is no longer than that has no direction, so that it would cut anywhere.
    pub(super) fn set_sides(&mut self, hull: &ConvexHull, feature: Touched, view: &View, long: f64) {
        let vertices = vertices(hull, &feature);
        let last = vertices.len() - 1;
        let vertex = |i: usize| hull.vertices()[vertices[if self.reversed { last - i } else { i }] as usize];
        self.sides.clear();
        self.sides.reserve(vertices.len());
        let (mut along_first, mut doubled_area) = (DVec2::ZERO, 0.0);
        for i in 0..self.side_count() {
            let [from, to] = self.side(i);
            let (mut along, mut rise) = (to.at - from.at, to.height - from.height);
            if along.length_squared() < long * long {
                (along, rise) = view.direction(vertex(self.next(i)) - vertex(i));
            }
            let length = length(along);
            if rise.abs() > STEEPEST * length {
                return self.flatten();
            }
            doubled_area += along_first.perp_dot(along);
            along_first += along;
            let inward = along.perp() / length;
            self.sides.push(Side { inward, offset: inward.dot(from.at) });
        }
        if doubled_area < 0.0 {
            // Thinner than its corners' rounding, which turned it round.
            for side in &mut self.sides {
                (side.inward, side.offset) = (-side.inward, -side.offset);
            }
        }
    }

    /// The segment between the two corners farthest apart.
    #[cold]
    fn flatten(&mut self) {
        let farthest = |from: DVec2| {
            let distance = |c: &&Corner| c.at.distance_squared(from);
            *self
                .corners
                .iter()
                .max_by(|c, e| distance(c).total_cmp(&distance(e)))
                .unwrap_or(&self.corners[0])
        };
        let from = farthest(self.corners[0].at);
        let to = farthest(from.at);
        self.corners.clear();
        self.corners.extend([from, to]);
        let along = to.at - from.at;
        let inward = along.perp() / length(along);
        self.sides.clear();
        self.sides.push(Side { inward, offset: inward.dot(from.at) });
    }

    fn set_plane(&mut self, hull: &ConvexHull, feature: Touched, view: &View) {
        (self.plane, self.planarity) = (None, 0.0);
        if let Touched::Face(f) = feature {
            let m = hull.face_normals()[f as usize];
            // A point of the plane, and the plane's normal.
            let (point, height) = view.point(m * hull.face_offsets()[f as usize]);
            let (across, along) = view.direction(m);
            let slope = -across / along;
            self.plane = Some((slope, height - slope.dot(point)));
            self.planarity = hull.face_planarity()[f as usize] * view.scale * view.scale / along.abs();
        }
    }

    /// The corner after corner `i`.
    #[inline]
    pub(super) fn next(&self, i: usize) -> usize {
        if i + 1 == self.corners.len() { 0 } else { i + 1 }
    }

    /// The ends of a side.
    #[inline]
    pub(super) fn side(&self, i: usize) -> [&Corner; 2] {
        [&self.corners[i], &self.corners[self.next(i)]]
    }

    /// A side's name, in vertices as registered.
    pub(super) fn side_name(&self, i: usize) -> Element {
        let [a, b] = self.side(i).map(|c| c.vertex);
        Element::Edge([a.min(b), a.max(b)])
    }

    /// Height of the feature over a point of its projection: of a face its
    /// plane's, within its corners'.
    pub(super) fn height(&self, at: DVec2) -> f64 {
        match (self.plane, self.corners.as_slice()) {
            (Some((slope, base)), _) => {
                let height = slope.dot(at) + base;
                // A face seen edge-on has no height of its own over a point.
                if height.is_nan() { self.lowest } else { height.clamp(self.lowest, self.highest) }
            }
            (None, [a, b]) => height_on([a, b], at),
            (None, _) => self.lowest,
        }
    }
}

/// Height of a segment over the point of its projection nearest to `at`.
pub(super) fn height_on([a, b]: [&Corner; 2], at: DVec2) -> f64 {
    let whole = b.at - a.at;
    let share = ((at - a.at).dot(whole) / whole.length_squared()).clamp(0.0, 1.0);
    if share.is_nan() { a.height } else { a.height + share * (b.height - a.height) }
}

/// The vertices that make a feature.
#[inline]
fn vertices<'a>(hull: &'a ConvexHull, feature: &'a Touched) -> &'a [u32] {
    match feature {
        Touched::Vertex(v) => std::slice::from_ref(v),
        Touched::Edge(e) => &hull.edge_vertices()[*e as usize],
        Touched::Face(f) => hull.outline(*f as usize),
    }
}

/// The length of a vector whose square may underflow; 0 for no length.
#[inline]
fn length(v: DVec2) -> f64 {
    let squared = v.length_squared();
    if squared > f64::MIN_POSITIVE { squared.sqrt() } else { small_length(v) }
}

#[cold]
fn small_length(v: DVec2) -> f64 {
    let size = v.abs().max_element();
    if size > 0.0 { size * (v / size).length() } else { 0.0 }
}

fn doubled_area(corners: &[Corner]) -> f64 {
    let Some(first) = corners.first() else { return 0.0 };
    corners.windows(2).map(|w| (w[0].at - first.at).perp_dot(w[1].at - first.at)).sum()
}

//! A feature projected on the contact plane.

use glam::{DVec2, DVec3};

use super::Touched;
use crate::contact::ConvexHull;
use crate::contact::manifold::Element;

/// Cosine of the angle of a face to the contact plane below which it counts as
/// seen edge-on. Within the largest feature angle, 0.5 rad, it is above 0.87; of
/// other faces that touch every corner supports, and one as steep is narrower
/// than the merge distance, by which its lifted points would be off several times.
const EDGE_ON: f64 = 0.5;

/// A corner of a projected feature.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    pub(super) at: DVec2,
    /// Along the normal.
    pub(super) height: f64,
    /// As registered.
    pub(super) vertex: u32,
    /// As the hull numbers it.
    own: u32,
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
        let corner = |v: u32| {
            let (at, height) = view.point(hull.vertices()[v as usize]);
            Corner { at, height, vertex: hull.registered_indices()[v as usize], own: v }
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
    pub(super) fn set_sides(&mut self, hull: &ConvexHull, view: &View, long: f64) {
        let vertex = |i: usize| hull.vertices()[self.corners[i].own as usize];
        self.sides.clear();
        self.sides.reserve(self.corners.len());
        let (mut along_first, mut doubled_area) = (DVec2::ZERO, 0.0);
        for i in 0..self.side_count() {
            let [from, to] = self.side(i).map(|c| c.at);
            let mut along = to - from;
            if along.length_squared() < long * long {
                along = view.direction(vertex(self.next(i)) - vertex(i)).0;
            }
            doubled_area += along_first.perp_dot(along);
            along_first += along;
            let inward = along.perp() / length(along);
            self.sides.push(Side { inward, offset: inward.dot(from) });
        }
        if doubled_area < 0.0 {
            // Thinner than its corners' rounding, which turned it round.
            for side in &mut self.sides {
                (side.inward, side.offset) = (-side.inward, -side.offset);
            }
        }
    }

    fn set_plane(&mut self, hull: &ConvexHull, feature: Touched, view: &View) {
        (self.plane, self.planarity) = (None, 0.0);
        if let Touched::Face(f) = feature {
            let m = hull.face_normals()[f as usize];
            // A point of the plane, and the plane's normal.
            let (point, height) = view.point(m * hull.face_offsets()[f as usize]);
            let (across, along) = view.direction(m);
            if along.abs() < EDGE_ON * view.scale {
                return self.flatten();
            }
            let slope = -across / along;
            self.plane = Some((slope, height - slope.dot(point)));
            self.planarity = hull.face_planarity()[f as usize] * view.scale * view.scale / along.abs();
        }
    }

    /// Leaves the two corners farthest apart.
    #[cold]
    fn flatten(&mut self) {
        let farthest = |from: &Corner| {
            let place = |c: &Corner| c.at.extend(c.height);
            let distance = |c: &&Corner| place(c).distance_squared(place(from));
            let farther = |c: &&Corner, e: &&Corner| distance(c).total_cmp(&distance(e));
            *self.corners.iter().max_by(farther).unwrap_or(from)
        };
        let from = farthest(&self.corners[0]);
        let to = farthest(&from);
        self.corners.clear();
        self.corners.extend([from, to]);
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
                height.clamp(self.lowest, self.highest)
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

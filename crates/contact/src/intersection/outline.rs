//! A feature projected onto the contact plane: its corners, sides and heights.

use std::convert::Infallible;

use glam::{DVec2, DVec3};

use super::Touched;
use crate::ConvexHull;
use crate::exact::orient2d;
use crate::manifold::Element;
use crate::monotone_chain::convex_polygon;
use crate::tolerance::{EDGE_ON, TURN};

/// A corner of a projected feature.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    pub(super) at: DVec2,
    /// Height above the contact plane, along the normal.
    pub(super) height: f64,
    /// Index of the vertex as registered.
    pub(super) vertex: u32,
}

/// The line through a side.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side {
    /// Unit, inward; NaN for a side of no length.
    pub(super) inward: DVec2,
    pub(super) offset: f64,
}

impl Side {
    /// Signed distance of a point from the line, positive inside.
    #[inline]
    pub(super) fn distance(&self, at: DVec2) -> f64 {
        self.inward.dot(at) - self.offset
    }
}

/// The projection of a hull: maps hull units in the hull's own frame to coordinates along the contact
/// plane's axes and the normal, in pair units.
pub(super) struct View {
    /// The plane's axes and the normal, in the hull's frame. Their length is that of a hull unit in pair
    /// units.
    pub(super) axes: [DVec3; 3],
    /// Coordinates of the contraction point.
    pub(super) centre: DVec3,
    /// Pair units per hull unit.
    pub(super) scale: f64,
}

impl View {
    /// Projects a direction: coordinates on the plane, and along the normal; pair units.
    #[inline]
    fn direction(&self, v: DVec3) -> (DVec2, f64) {
        let [x, y, n] = self.axes.map(|axis| axis.dot(v));
        (DVec2::new(x, y), n)
    }

    /// Projects a point: coordinates on the plane, and height; pair units.
    #[inline]
    fn point(&self, v: DVec3) -> (DVec2, f64) {
        let (at, height) = self.direction(v);
        (at + self.centre.truncate(), height + self.centre.z)
    }
}

/// A projected feature: one corner, two corners, or a convex polygon whose corners run anticlockwise
/// about the normal.
#[derive(Debug, Default)]
pub(super) struct Outline {
    pub(super) corners: Vec<Corner>,
    /// The lines of the sides, once [`Outline::set_sides`] has set them.
    pub(super) sides: Vec<Side>,
    /// For a face, its height above the contact plane as `slope . at + base`.
    plane: Option<(DVec2, f64)>,
    lowest: f64,
    highest: f64,
    /// How far below the face's plane a corner of it may lie; pair units.
    pub(super) planarity: f64,
}

impl Outline {
    /// Projects a feature of `hull`. [`Outline::set_sides`] sets its sides.
    pub(super) fn project(&mut self, hull: &ConvexHull, feature: Touched, view: &View) {
        let corner = |v: u32| {
            let (at, height) = view.point(hull.vertex(v));
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
        (self.lowest, self.highest) = (f64::INFINITY, f64::NEG_INFINITY);
        for corner in &self.corners {
            // Plain comparisons suffice: no height is NaN, for which min and max would need extra work.
            self.lowest = if corner.height < self.lowest { corner.height } else { self.lowest };
            self.highest = if corner.height > self.highest { corner.height } else { self.highest };
        }
        self.set_plane(hull, feature, view);
    }

    /// The number of sides. Side `i` goes from corner `i` to the next; two corners make one side.
    pub(super) fn side_count(&self) -> usize {
        if self.corners.len() > 2 { self.corners.len() } else { self.corners.len().saturating_sub(1) }
    }

    /// Sets the lines of the sides, and first makes the projected polygon strictly convex if it is not.
    ///
    /// A face's outline is strictly convex in its own plane. But corners that are closer together than
    /// their rounding, or than their distance from the face's plane, may be projected in any order. A side
    /// between such corners would cut in an arbitrary direction.
    pub(super) fn set_sides(&mut self) {
        if !self.measure_sides() {
            self.make_convex();
            self.measure_sides();
        }
    }

    /// Sets the lines of the sides. Returns whether the polygon is certainly strictly convex.
    fn measure_sides(&mut self) -> bool {
        self.sides.clear();
        self.sides.reserve(self.corners.len());
        for i in 0..self.side_count() {
            let [from, to] = self.side(i).map(|c| c.at);
            let inward = (to - from).perp() / (to - from).length();
            self.sides.push(Side { inward, offset: inward.dot(from) });
        }
        let Some(last) = self.sides.last().filter(|_| self.sides.len() > 1) else { return true };
        let (mut before, mut convex) = (last.inward, true);
        for side in &self.sides {
            convex &= before.perp_dot(side.inward) > TURN;
            before = side.inward;
        }
        convex
    }

    /// Keeps the corners of the convex hull of all corners; two if they are on one line.
    #[cold]
    fn make_convex(&mut self) {
        let key = |c: &Corner| c.at.to_array();
        let order = |a: &Corner, b: &Corner| {
            let ([ax, ay], [bx, by]) = (key(a), key(b));
            ax.total_cmp(&bx).then(ay.total_cmp(&by)).then(a.vertex.cmp(&b.vertex))
        };
        let mut sorted = std::mem::take(&mut self.corners);
        sorted.sort_unstable_by(order);
        // Two corners are one point if the length of their difference underflows.
        sorted.dedup_by(|a, b| a.at.distance_squared(b.at) < f64::MIN_POSITIVE);
        let turn = |[a, b, c]: [&Corner; 3]| Ok::<_, Infallible>(orient2d(key(a), key(b), key(c)));
        let Ok(()) = convex_polygon(&sorted, &mut self.corners, turn);
    }

    fn set_plane(&mut self, hull: &ConvexHull, feature: Touched, view: &View) {
        (self.plane, self.planarity) = (None, 0.0);
        if let Touched::Face(f) = feature {
            let m = hull.faces()[f as usize].normal;
            // A point of the face's plane, and the plane's normal, both projected.
            let (point, height) = view.point(m * hull.faces()[f as usize].offset);
            let (across, along) = view.direction(m);
            if along.abs() < EDGE_ON * view.scale {
                return self.flatten();
            }
            let slope = -across / along;
            self.plane = Some((slope, height - slope.dot(point)));
            self.planarity = hull.faces()[f as usize].planarity * view.scale * view.scale / along.abs();
        }
    }

    /// Keeps only the two corners that are farthest apart.
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

    /// The index of the corner after corner `i`.
    #[inline]
    pub(super) fn next(&self, i: usize) -> usize {
        if i + 1 == self.corners.len() { 0 } else { i + 1 }
    }

    /// The two ends of side `i`.
    #[inline]
    pub(super) fn side(&self, i: usize) -> [&Corner; 2] {
        [&self.corners[i], &self.corners[self.next(i)]]
    }

    /// The side between whose ends a point near the line of side `i` lies. Several sides may continue
    /// along one line, to within the merge distance. Then only one of them cuts, and its crossing may be
    /// far beyond its own ends.
    #[inline]
    pub(super) fn side_beside(&self, i: u32, at: DVec2) -> u32 {
        let [from, to] = self.side(i as usize).map(|c| c.at);
        let (along, whole) = ((at - from).dot(to - from), (to - from).length_squared());
        if (0.0..=whole).contains(&along) { i } else { self.side_beyond(i, at) }
    }

    #[cold]
    fn side_beyond(&self, i: u32, at: DVec2) -> u32 {
        let mut i = i as usize;
        // Walk forwards, then backwards, each at most once around.
        for onwards in [true, false] {
            for _ in 0..self.sides.len() {
                let [from, to] = self.side(i).map(|c| c.at);
                let (end, along) = if onwards { (to, to - from) } else { (from, from - to) };
                if (at - end).dot(along) <= 0.0 {
                    break;
                }
                let other =
                    if onwards { self.next(i) } else { i.checked_sub(1).unwrap_or(self.sides.len() - 1) };
                let [next_from, next_to] = self.side(other).map(|c| c.at);
                let along = if onwards { next_to - next_from } else { next_from - next_to };
                if (at - end).dot(along) <= 0.0 {
                    break;
                }
                i = other;
            }
        }
        i as u32
    }

    /// The name of side `i`, in vertices as registered.
    pub(super) fn side_name(&self, i: usize) -> Element {
        let [a, b] = self.side(i).map(|c| c.vertex);
        Element::Edge([a.min(b), a.max(b)])
    }

    /// Height of the feature above a point of its projection. The height of a face is that of its plane,
    /// limited to the range of its corners' heights.
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

/// Height of a segment at the point of its projection that is nearest to `at`.
pub(super) fn height_on([a, b]: [&Corner; 2], at: DVec2) -> f64 {
    let whole = b.at - a.at;
    let share = ((at - a.at).dot(whole) / whole.length_squared()).clamp(0.0, 1.0);
    if share.is_nan() { a.height } else { a.height + share * (b.height - a.height) }
}

fn doubled_area(corners: &[Corner]) -> f64 {
    let Some(first) = corners.first() else { return 0.0 };
    corners.windows(2).map(|w| (w[0].at - first.at).perp_dot(w[1].at - first.at)).sum()
}

/// A strictly convex polygon with its corners on an ellipse, anticlockwise.
#[cfg(test)]
pub(super) fn random_polygon(random: &mut crate::workload::Random, count: usize, name: u32) -> Outline {
    let mut angles: Vec<f64> = (0..count).map(|_| random.within(0.0, std::f64::consts::TAU)).collect();
    angles.sort_by(f64::total_cmp);
    let centre = DVec2::new(random.within(-1.0, 1.0), random.within(-1.0, 1.0));
    let (size, turn) = (random.within(0.1, 2.0), random.within(0.0, 3.0));
    let corner = |(angle, vertex): (f64, u32)| {
        let (sin, cos) = angle.sin_cos();
        let at = centre + DVec2::from_angle(turn).rotate(DVec2::new(size * cos, 0.6 * size * sin));
        Corner { at, height: angle.sin() - at.y, vertex: name + vertex }
    };
    let mut outline = Outline::default();
    outline.corners.extend(angles.into_iter().zip(0..).map(corner));
    outline.set_sides();
    outline
}

//! The exact facts about a pair, computed in double-double arithmetic from the file only.

use super::double_double::{Dd, Dd3, dot, minus, narrow, plus, rotate, rotation, wide};
use super::format::{Hull, Pair};
use super::polygon::{self, Point};

/// The default feature angle of a query, in radians.
const FEATURE_ANGLE: f64 = 0.01;

/// A hull at its pose.
struct Placed<'a> {
    hull: &'a Hull,
    rows: [Dd3; 3],
    centre: Dd3,
    /// The vertices relative to the contraction point, in world axes.
    vertices: Vec<Dd3>,
}

impl Placed<'_> {
    /// The largest `n.v` over the vertices.
    fn support(&self, n: Dd3) -> Dd {
        let larger = |best: Dd, value: Dd| if f64::from(value - best) > 0.0 { value } else { best };
        self.vertices.iter().map(|v| dot(n, *v)).reduce(larger).unwrap_or_default()
    }

    fn normal(&self, [x, y, z, _]: [f64; 4]) -> [f64; 3] {
        narrow(rotate(&self.rows, [x, y, z]))
    }

    /// The signed distance of a world point from the plane; positive outside.
    fn height(&self, plane: [f64; 4], point: [f64; 3]) -> f64 {
        let from = minus(wide(point), self.centre);
        let normal = rotate(&self.rows, [plane[0], plane[1], plane[2]]);
        f64::from(dot(normal, from) + plane[3].into())
    }

    /// The corners of the face whose normal is nearest to `n`, projected along `n`, or `None` if that
    /// normal is off `n` by more than the feature angle.
    fn face_along(&self, n: [f64; 3], merge: f64, project: &dyn Fn(Dd3) -> Point) -> Option<Vec<Point>> {
        let cosine = |plane: &[f64; 4]| f64::from(dot(wide(self.normal(*plane)), wide(n)));
        let plane = self.hull.planes.iter().max_by(|a, b| cosine(a).total_cmp(&cosine(b)))?;
        let sine = norm(cross(n, self.normal(*plane)));
        if cosine(plane) <= 0.0 || sine > FEATURE_ANGLE.sin() {
            return None;
        }
        let on_plane =
            |v: &&[f64; 3]| (plane[0] * v[0] + plane[1] * v[1] + plane[2] * v[2] + plane[3]).abs() <= merge;
        let corners = self.hull.vertices.iter().filter(on_plane);
        let corners: Vec<Point> =
            corners.map(|&v| project(plus(self.centre, rotate(&self.rows, v)))).collect();
        Some(polygon::convex_hull(&corners))
    }
}

/// A pair, with the lengths that the error budgets use.
pub(crate) struct Truth<'a> {
    placed: [Placed<'a>; 2],
    offset: Dd3,
    pub(crate) alpha: f64,
    pub(crate) normal: [f64; 3],
    /// Sum of the inradii about the contraction points.
    pub(crate) inner: f64,
    /// Sum of the circumradii.
    pub(crate) outer: f64,
    /// The distance of the centres.
    pub(crate) distance: f64,
}

impl<'a> Truth<'a> {
    pub(crate) fn new(hulls: &'a [Hull], pair: &Pair) -> Self {
        let placed = [0, 1].map(|side| {
            let (hull, pose) = (&hulls[pair.hulls[side]], pair.poses[side]);
            let rows = rotation(pose.rotation);
            let vertices = hull.vertices.iter().map(|&v| rotate(&rows, v)).collect();
            Placed { hull, rows, centre: wide(pose.position), vertices }
        });
        let offset = minus(placed[1].centre, placed[0].centre);
        let inner = |hull: &Hull| hull.planes.iter().map(|p| -p[3]).fold(f64::INFINITY, f64::min);
        let outer = |hull: &Hull| hull.vertices.iter().map(|&v| norm(v)).fold(0.0, f64::max);
        Self {
            inner: placed.iter().map(|p| inner(p.hull)).sum(),
            outer: placed.iter().map(|p| outer(p.hull)).sum(),
            distance: norm(narrow(offset)),
            alpha: pair.alpha,
            normal: pair.normal,
            placed,
            offset,
        }
    }

    /// `n.d` and the support value of the centred Minkowski difference.
    fn along(&self, n: [f64; 3]) -> (Dd, Dd) {
        let (n, [a, b]) = (wide(n), &self.placed);
        (dot(n, self.offset), a.support(n) + b.support(n.map(std::ops::Neg::neg)))
    }

    /// The exact growth scale minus the lower bound that direction `n` proves.
    pub(crate) fn optimality_gap(&self, n: [f64; 3]) -> f64 {
        let (offset, support) = self.along(n);
        f64::from(Dd::from(self.alpha) - offset / support)
    }

    /// The signed separation along `n`.
    pub(crate) fn separation(&self, n: [f64; 3]) -> f64 {
        let (offset, support) = self.along(n);
        f64::from(offset - support)
    }

    /// How far a world point is from the surface of A (0) or B (1).
    pub(crate) fn off_surface(&self, side: usize, point: [f64; 3]) -> f64 {
        let placed = &self.placed[side];
        let heights = placed.hull.planes.iter().map(|&plane| placed.height(plane, point));
        heights.fold(f64::NEG_INFINITY, f64::max).abs()
    }

    /// The projection of world points along `n` to 2D coordinates in its plane, about A's centre.
    pub(crate) fn projection(&self, n: [f64; 3]) -> impl Fn(Dd3) -> Point + '_ {
        let least = (0..3).min_by(|&i, &j| n[i].abs().total_cmp(&n[j].abs())).unwrap_or(0);
        let mut axis = [0.0; 3];
        axis[least] = 1.0;
        let first = cross(n, axis);
        let first = first.map(|c| c / norm(first));
        let second = cross(n, first);
        move |point| {
            let from = minus(point, self.placed[0].centre);
            [f64::from(dot(wide(first), from)), f64::from(dot(wide(second), from))]
        }
    }

    /// The convex hull of some vertices of A (0) or B (1), projected along `n`.
    pub(crate) fn outline(&self, side: usize, vertices: &[u32], n: [f64; 3]) -> Vec<Point> {
        let (placed, project) = (&self.placed[side], self.projection(n));
        let corner = |&v: &u32| project(plus(placed.centre, placed.vertices[v as usize]));
        polygon::convex_hull(&vertices.iter().map(corner).collect::<Vec<_>>())
    }

    /// The exact patch of two touching faces: their intersection, projected along the normal. None if
    /// no two faces point towards each other, or if the intersection is so small that rounding could
    /// hide it.
    pub(crate) fn patch(&self) -> Option<Vec<Point>> {
        let project = self.projection(self.normal);
        let merge = 1e-9 * self.outer;
        let [a, b] = &self.placed;
        let face_a = a.face_along(self.normal, merge, &project)?;
        let face_b = b.face_along(self.normal.map(std::ops::Neg::neg), merge, &project)?;
        let patch = polygon::intersection(&face_a, &face_b, 1e-14 * self.outer);
        (polygon::area(&patch) > merge * self.outer).then_some(patch)
    }
}

pub(crate) fn norm(v: [f64; 3]) -> f64 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

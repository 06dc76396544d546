//! GJK's simplex: at most four points of `K`, and the point of their convex hull that is closest to a
//! target.
//!
//! [`Simplex::closest_to`] also drops the points that do not determine the closest point. With the
//! target as the origin, the cases are (C. Ericson, *Real-Time Collision Detection*, 2005, section
//! 5.1):
//!
//! ```text
//! 1 point:   the point itself
//! 2 points:  the origin's projection on the segment, or the nearer end
//! 3 points:  the foot of the triangle's normal if it is inside all three sides;
//!            otherwise the nearest of the three segments' points
//! 4 points:  the origin if it is inside; otherwise the nearest of the four triangles' points
//! ```
//!
//! All cases take constant time. In double precision the result is unreliable once the target is
//! within rounding of the simplex. [`Simplex::wide_closest_to`] then does the same in double-double
//! arithmetic: it computes the foot of the origin on every vertex, edge and triangle and takes the
//! nearest.

use glam::DVec3;

use super::exact::{Dd, Dd3, dd_cross, dd_dot, exact_difference};
use super::pair::Support;
use super::tolerance::THIN;

/// A simplex of at most four points.
#[derive(Default)]
pub(crate) struct Simplex {
    points: [Support; 4],
    len: usize,
    /// Whether the last point was added after the simplex was last reduced.
    grown: bool,
}

impl Simplex {
    pub(crate) fn from_points(points: &[Support]) -> Self {
        let mut simplex = Self::default();
        for p in points.iter().take(3) {
            if !simplex.contains(p) {
                simplex.push(*p);
            }
        }
        simplex.grown = false;
        simplex
    }

    pub(crate) fn points(&self) -> &[Support] {
        &self.points[..self.len]
    }

    /// Whether the simplex has four points. After a reduction that means that the target is inside.
    pub(crate) fn is_full(&self) -> bool {
        self.len == 4
    }

    /// Whether the simplex is a triangle so thin that in double precision its computed closest point
    /// may be far from it.
    pub(crate) fn is_thin(&self) -> bool {
        let &[u0, u1, u2] = self.points() else { return false };
        let (e1, e2) = (u1.point - u0.point, u2.point - u0.point);
        THIN * e1.cross(e2).length_squared() < e1.length_squared() * e2.length_squared()
    }

    pub(crate) fn contains(&self, w: &Support) -> bool {
        self.points().iter().any(|p| p.same(w))
    }

    /// Adds `w`, a point beyond the plane through the closest point. A simplex of four stays unchanged.
    pub(crate) fn push(&mut self, w: Support) {
        if self.len < 4 {
            self.points[self.len] = w;
            self.len += 1;
            self.grown = true;
        }
    }

    /// The vector from `target` to the closest point of the simplex. Keeps only the points that
    /// determine the closest point.
    pub(crate) fn closest_to(&mut self, target: DVec3) -> DVec3 {
        let at = |i: usize| self.points[i].point - target;
        let (vector, kept) = match self.len {
            0 => (DVec3::ZERO, Kept::default()),
            1 => (at(0), Kept::of(&[0])),
            2 => segment(&[at(0), at(1)], [0, 1]),
            3 => triangle(&[at(0), at(1), at(2)], [0, 1, 2]),
            _ => tetrahedron(&[at(0), at(1), at(2), at(3)]),
        };
        self.keep(&kept);
        vector
    }

    /// [`Simplex::closest_to`] in wide arithmetic. The direction is correct even if the target is
    /// nearer to the simplex than the points' roundoff.
    #[cold]
    pub(crate) fn wide_closest_to(&mut self, target: DVec3) -> DVec3 {
        let points: Vec<Dd3> = self.points().iter().map(|p| exact_difference(p.point, target)).collect();
        if self.is_full() && surrounded(&points) {
            return DVec3::ZERO;
        }
        // The closest point of a grown simplex lies on a face that contains the new point. If that
        // point gains no more than a rounding, the simplex without it could seem nearest, be kept, and
        // be grown by the same point again, without end.
        let has_new = |set: &&&[usize]| !self.grown || set.contains(&(self.len - 1));
        let subsets = SUBSETS.iter().filter(|set| set.iter().all(|&i| i < self.len)).filter(has_new);
        let feet = subsets.filter_map(|set| Some((foot(&points, set)?, Kept::of(set))));
        // The comparison is in wide arithmetic as well. A thin triangle and one of its sides are almost
        // equally near. In doubles the side would win the tie, and the corner that is dropped would be
        // found again, without end.
        let length = |p: &Dd3| dd_dot(*p, *p);
        let nearest = feet.min_by(|(p, _), (q, _)| (length(p) - length(q)).value().total_cmp(&0.0));
        let (vector, kept) = nearest.unwrap_or_default();
        self.keep(&kept);
        DVec3::from_array(vector.map(Dd::value))
    }

    fn keep(&mut self, kept: &Kept) {
        let before = self.points;
        (self.len, self.grown) = (kept.len, false);
        for (i, &k) in kept.indices[..kept.len].iter().enumerate() {
            self.points[i] = before[k];
        }
    }
}

/// The vertices, edges and triangles of four points, by the points' indices.
const SUBSETS: [&[usize]; 14] = [
    &[0],
    &[1],
    &[2],
    &[3],
    &[0, 1],
    &[0, 2],
    &[0, 3],
    &[1, 2],
    &[1, 3],
    &[2, 3],
    &[0, 1, 2],
    &[0, 1, 3],
    &[0, 2, 3],
    &[1, 2, 3],
];

fn minus(a: Dd3, b: Dd3) -> Dd3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// The foot of the perpendicular from the origin on a vertex, edge or triangle of the points, if it
/// lies inside.
fn foot(points: &[Dd3], face: &[usize]) -> Option<Dd3> {
    let times = |v: Dd3, by: Dd| v.map(|x| x * by);
    let over = |v: Dd3, by: Dd| v.map(|x| x / by);
    match *face {
        [i] => Some(points[i]),
        [i, j] => {
            let (p, edge) = (points[i], minus(points[j], points[i]));
            let (whole, share) = (dd_dot(edge, edge), -dd_dot(p, edge));
            let inside = share.value() > 0.0 && (whole - share).value() > 0.0;
            let [a, b] = [times(p, whole), times(edge, share)];
            inside.then(|| over([a[0] + b[0], a[1] + b[1], a[2] + b[2]], whole))
        }
        [i, j, k] => {
            let mut corners = [i, j, k].map(|i| points[i]);
            // Take the sides from the corner nearest to the origin. In a needle whose base is near the
            // origin the two sides from the tip are nearly parallel, and their cross product loses
            // twice as many bits.
            let length = |p: &Dd3| dd_dot(*p, *p).value();
            let nearest = (0..3).min_by(|&a, &b| length(&corners[a]).total_cmp(&length(&corners[b])));
            corners.rotate_left(nearest.unwrap_or(0));
            let [p, q, r] = corners;
            let n = dd_cross(minus(q, p), minus(r, p));
            let inside = |u: Dd3, v: Dd3| dd_dot(n, dd_cross(u, v)).value() > 0.0;
            (inside(p, q) && inside(q, r) && inside(r, p)).then(|| over(times(n, dd_dot(n, p)), dd_dot(n, n)))
        }
        _ => None,
    }
}

/// Whether the origin is inside the tetrahedron of four points.
fn surrounded(points: &[Dd3]) -> bool {
    [[0, 1, 2, 3], [0, 1, 3, 2], [0, 2, 3, 1], [1, 2, 3, 0]].iter().all(|&[i, j, k, other]| {
        let n = dd_cross(minus(points[j], points[i]), minus(points[k], points[i]));
        let (origin, apex) =
            (-dd_dot(n, points[i]).value(), dd_dot(n, minus(points[other], points[i])).value());
        (origin > 0.0 && apex > 0.0) || (origin < 0.0 && apex < 0.0)
    })
}

/// The indices of the points that determine the closest point.
#[derive(Clone, Copy, Default)]
struct Kept {
    indices: [usize; 4],
    len: usize,
}

impl Kept {
    fn of(which: &[usize]) -> Self {
        let mut kept = Self { indices: [0; 4], len: which.len() };
        kept.indices[..which.len()].copy_from_slice(which);
        kept
    }
}

fn segment(p: &[DVec3], [i, j]: [usize; 2]) -> (DVec3, Kept) {
    let (a, b) = (p[i], p[j]);
    let ab = b - a;
    let (t, whole) = (-a.dot(ab), ab.length_squared());
    if !(t > 0.0) {
        (a, Kept::of(&[i]))
    } else if t >= whole {
        (b, Kept::of(&[j]))
    } else {
        (a + ab * (t / whole), Kept::of(&[i, j]))
    }
}

fn triangle(p: &[DVec3], [i, j, k]: [usize; 3]) -> (DVec3, Kept) {
    let (a, b, c) = (p[i], p[j], p[k]);
    let n = (b - a).cross(c - a);
    // Inside all three sides the closest point is the foot of the normal. Otherwise it is on a side.
    let inside = [(a, b), (b, c), (c, a)].iter().all(|&(u, v)| n.dot(u.cross(v)) > 0.0);
    if inside && n.length_squared() > 0.0 {
        return (n * (n.dot(a) / n.length_squared()), Kept::of(&[i, j, k]));
    }
    nearest([segment(p, [i, j]), segment(p, [j, k]), segment(p, [k, i])])
}

fn tetrahedron(p: &[DVec3; 4]) -> (DVec3, Kept) {
    const FACES: [[usize; 4]; 4] = [[0, 1, 2, 3], [0, 1, 3, 2], [0, 2, 3, 1], [1, 2, 3, 0]];
    let inside = FACES.iter().all(|&[i, j, k, other]| {
        let n = (p[j] - p[i]).cross(p[k] - p[i]);
        let (origin, apex) = (-n.dot(p[i]), n.dot(p[other] - p[i]));
        (origin > 0.0 && apex > 0.0) || (origin < 0.0 && apex < 0.0)
    });
    if inside {
        return (DVec3::ZERO, Kept::of(&[0, 1, 2, 3]));
    }
    nearest(FACES.map(|[i, j, k, _]| triangle(p, [i, j, k])))
}

fn nearest<const N: usize>(candidates: [(DVec3, Kept); N]) -> (DVec3, Kept) {
    let mut best = candidates[0];
    for candidate in &candidates[1..] {
        if candidate.0.length_squared() < best.0.length_squared() {
            best = *candidate;
        }
    }
    best
}

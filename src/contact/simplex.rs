//! GJK's simplex: at most four points of `K`, reduced to the fewest whose hull
//! holds the point closest to a target (Ericson, *Real-Time Collision
//! Detection*, 2005, section 5.1, for the regions of a triangle).

use glam::DVec3;

use super::exact::{Dd, Dd3, dd_cross, dd_dot, exact_difference};
use super::pair::Support;
use super::tolerance::THIN;

/// At most four points.
#[derive(Default)]
pub(crate) struct Simplex {
    points: [Support; 4],
    len: usize,
    /// Whether the last point came after the closest point of the others was found.
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

    /// Whether the target was inside all four.
    pub(crate) fn is_full(&self) -> bool {
        self.len == 4
    }

    /// Whether it is a triangle so thin that in double precision the closest point may
    /// be far from it.
    pub(crate) fn is_thin(&self) -> bool {
        let &[u0, u1, u2] = self.points() else { return false };
        let (e1, e2) = (u1.point - u0.point, u2.point - u0.point);
        THIN * e1.cross(e2).length_squared() < e1.length_squared() * e2.length_squared()
    }

    pub(crate) fn contains(&self, w: &Support) -> bool {
        self.points().iter().any(|p| p.same(w))
    }

    /// Adds a point to at most three: one beyond their closest point's plane.
    pub(crate) fn push(&mut self, w: Support) {
        if self.len < 4 {
            self.points[self.len] = w;
            self.len += 1;
            self.grown = true;
        }
    }

    /// The vector from `target` to the closest point of the simplex, which is
    /// reduced to the points that hold it.
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

    /// The same in wide arithmetic: the direction holds where the target is
    /// nearer than roundoffs of the points.
    #[cold]
    pub(crate) fn wide_closest_to(&mut self, target: DVec3) -> DVec3 {
        let points: Vec<Dd3> = self.points().iter().map(|p| exact_difference(p.point, target)).collect();
        if self.is_full() && surrounded(&points) {
            return DVec3::ZERO;
        }
        // The new point holds the closest one; where it gains a rounding alone, the simplex
        // without it would be measured as near, kept, and grown by it again, without end.
        let has_new = |set: &&&[usize]| !self.grown || set.contains(&(self.len - 1));
        let subsets = SUBSETS.iter().filter(|set| set.iter().all(|&i| i < self.len)).filter(has_new);
        let feet = subsets.filter_map(|set| Some((foot(&points, set)?, Kept::of(set))));
        // Widely too: of a thin triangle and its side nearly as near the side would
        // win a tie, the corner beyond it be dropped and found again, without end.
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

/// The faces of every dimension of four points.
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

/// The foot of the origin on a face of the points, if it is inside.
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
            // From the corner nearest to the origin: of a needle whose base is there the
            // sides from its tip are nearly one, and their product loses twice as much.
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

/// Whether the origin is inside four points.
fn surrounded(points: &[Dd3]) -> bool {
    [[0, 1, 2, 3], [0, 1, 3, 2], [0, 2, 3, 1], [1, 2, 3, 0]].iter().all(|&[i, j, k, other]| {
        let n = dd_cross(minus(points[j], points[i]), minus(points[k], points[i]));
        let (origin, apex) =
            (-dd_dot(n, points[i]).value(), dd_dot(n, minus(points[other], points[i])).value());
        (origin > 0.0 && apex > 0.0) || (origin < 0.0 && apex < 0.0)
    })
}

/// Indices of the points that hold the closest point.
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
    // Inside all three sides: the foot of the normal; else on one of the sides.
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

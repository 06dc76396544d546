//! Two boxes: a start for the portal from the closed form over the 15 separating axes.
//!
//! `K` of two boxes has facets with only 15 pairs of normals: A's three face normals, B's three, and
//! the cross products of an edge direction of A and one of B (S. Gottschalk, M. C. Lin and D. Manocha,
//! *OBBTree: A Hierarchical Structure for Rapid Interference Detection*, 1996,
//! doi:10.1145/237170.237244). Hence `alpha` is the largest `n.d / h_K(n)` over these 15 axes, and the
//! ray leaves `K` through the facet of that axis. The facet is a parallelogram, or an octagon if a
//! face of A is parallel to a face of B. (Other parallel features are treated as if they were not.)
//!
//! ```text
//! seeds: n = axis of the largest growth scale;  x = ray / growth scale, on the facet
//!        triangulate the facet of n; return the three vertices of K of the triangle that holds x
//! ```
//!
//! The result is never an answer, only a place to start, so nothing rests on its rounding: either a
//! face normal along which the boxes seem apart by more than the margin, or three seeds. Support
//! points certify the normal, and the portal certifies the seeds, usually in one step. If rounding or
//! a tie named the wrong facet, the portal goes on from there. The cost is constant.

use glam::{DMat3, DVec2, DVec3, Vec3Swizzles};

use crate::hull::{BoxShape, octant};
use crate::pair::{Pair, Support, shift};
use crate::tolerance::SAME_AXIS;

/// Both boxes in the axes of A's box.
pub(crate) struct Boxes<'a> {
    a: &'a BoxShape,
    b: &'a BoxShape,
    /// Half extents, pair units.
    half_a: DVec3,
    half_b: DVec3,
    /// The axes of B's box in those of A's, as columns.
    axes: DMat3,
    /// Their absolute values.
    size: DMat3,
    ray: DVec3,
    /// For A's three face normals and for B's: the length of the ray along each, and how far `K`
    /// reaches along it.
    along: [DVec3; 2],
    reach: [DVec3; 2],
}

/// The separating axis with the largest growth scale, by the features that define it.
#[derive(Clone, Copy)]
enum Kind {
    FaceOfA(usize),
    FaceOfB(usize),
    /// A face of A and a face of B that are parallel to rounding.
    Faces(usize, usize),
    Edges(usize, usize),
}

impl<'a> Boxes<'a> {
    /// Both boxes of a pair. None if a hull is not a box.
    pub(crate) fn of(pair: &Pair<'a>) -> Option<Self> {
        let (a, b) = (pair.a.box_shape()?, pair.b.box_shape()?);
        let (half_a, half_b) = (a.half * pair.scale_a, b.half * pair.scale_b);
        let axes = a.axes.transpose() * (pair.rotation * b.axes);
        let ray = a.axes.transpose() * pair.ray;
        let size = axes.abs();
        let along = [ray.abs(), (axes.transpose() * ray).abs()];
        let reach = [half_a + size * half_b, half_b + size.transpose() * half_a];
        Some(Self { a, b, half_a, half_b, axes, size, ray, along, reach })
    }

    /// The face normal, A's frame, along which the boxes seem farthest apart. None if they do not seem apart
    /// by more than the margin (pair units).
    pub(crate) fn seem_apart(&self, pair: &Pair<'_>, margin: f64) -> Option<DVec3> {
        let mut best = (margin, 0, 0);
        for (hull, (along, reach)) in self.along.iter().zip(&self.reach).enumerate() {
            let gaps = along.map(|along| shift(along, pair.alpha_exponent)) - reach;
            for (i, gap) in gaps.to_array().into_iter().enumerate() {
                if gap > best.0 {
                    best = (gap, hull, i);
                }
            }
        }
        let (gap, hull, i) = best;
        let axis = if hull == 0 { DVec3::AXES[i] } else { self.axes.col(i) };
        (gap > margin).then(|| self.a.axes * (axis * axis.dot(self.ray).signum()))
    }

    /// Three vertices of `K` for the portal to start from.
    pub(crate) fn seeds(&self, pair: &Pair<'_>) -> [Support; 3] {
        let (scale, kind) = self.best_axis();
        let crossed = self.ray / scale;
        match kind {
            Kind::FaceOfA(i) => self.face_of_a(i, crossed),
            Kind::FaceOfB(j) => self.face_of_b(j, crossed),
            Kind::Faces(i, j) => self.octagon().triangle(i, j, crossed),
            Kind::Edges(i, j) => self.edges(i, j, crossed),
        }
        .map(|[a, b]| pair.support_of(self.a.corner(a), self.b.corner(b)))
    }

    /// The largest growth scale of the 15 axes, and its axis.
    fn best_axis(&self) -> (f64, Kind) {
        let [of_a, of_b] = [0, 1].map(|hull| (self.along[hull] / self.reach[hull]).to_array());
        // One axis of B after another, each with A's three: element 3 j + i is A's i and B's j.
        let (half_a, half_b) = (self.half_a, self.half_b.to_array());
        let of_edges = [0, 1, 2].map(|j| {
            let (j1, j2) = ((j + 1) % 3, (j + 2) % 3);
            let size = self.size.col(j);
            let along = self.axes.col(j).cross(self.ray).abs();
            let across_a = half_a.yzx() * size.zxy() + half_a.zxy() * size.yzx();
            let across_b = half_b[j1] * self.size.col(j2) + half_b[j2] * self.size.col(j1);
            (along / (across_a + across_b)).to_array()
        });
        let (i, a) = largest(&of_a);
        let (j, b) = largest(&of_b);
        let (e, edges) = largest(of_edges.as_flattened());
        let faces = a.max(b);
        if edges * (1.0 - SAME_AXIS) > faces {
            (edges, Kind::Edges(e % 3, e / 3))
        } else if a.min(b) > faces * (1.0 - SAME_AXIS) {
            (faces, Kind::Faces(i, j))
        } else if a > b {
            (a, Kind::FaceOfA(i))
        } else {
            (b, Kind::FaceOfB(j))
        }
    }

    fn octagon(&self) -> Octagon {
        Octagon { half_a: self.half_a, half_b: self.half_b, axes: self.axes, ray: self.ray }
    }

    /// A's face `i` against the corner of B that is farthest towards it.
    fn face_of_a(&self, i: usize, crossed: DVec3) -> [[usize; 2]; 3] {
        let n = DVec3::AXES[i] * self.ray[i].signum();
        let b = self.b_signs(-n);
        let on_face = (crossed + self.axes * (b * self.half_b)) / self.half_a;
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        triangle(on_face[j], on_face[k]).map(|(x, y)| {
            let mut a = n;
            (a[j], a[k]) = (x, y);
            [octant(a), octant(b)]
        })
    }

    /// B's face `j` against the corner of A that is farthest towards it.
    fn face_of_b(&self, j: usize, crossed: DVec3) -> [[usize; 2]; 3] {
        let towards = self.axes.col(j).dot(self.ray).signum();
        let a = signs(self.axes.col(j) * towards);
        let on_face = (self.axes.transpose() * (a * self.half_a - crossed)) / self.half_b;
        let (k, l) = ((j + 1) % 3, (j + 2) % 3);
        triangle(on_face[k], on_face[l]).map(|(x, y)| {
            let mut b = DVec3::ZERO;
            (b[j], b[k], b[l]) = (-towards, x, y);
            [octant(a), octant(b)]
        })
    }

    /// A's edge along axis `i` against B's edge along axis `j`.
    fn edges(&self, i: usize, j: usize, crossed: DVec3) -> [[usize; 2]; 3] {
        let (along_a, along_b) = (DVec3::AXES[i], self.axes.col(j));
        let across = along_a.cross(along_b);
        let n = across * across.dot(self.ray).signum();
        let (mut a, mut b) = (signs(n), self.b_signs(-n));
        (a[i], b[j]) = (0.0, 0.0);
        // Solve crossed = (a + x along_a) - (b + y along_b) for x and y, in the plane across n.
        let rest = crossed - a * self.half_a + self.axes * (b * self.half_b);
        let (past_b, past_a) = (along_b.cross(n), along_a.cross(n));
        let x = rest.dot(past_b) / (self.half_a[i] * along_a.dot(past_b));
        let y = -rest.dot(past_a) / (self.half_b[j] * along_b.dot(past_a));
        triangle(x, y).map(|(x, y)| {
            (a[i], b[j]) = (x, y);
            [octant(a), octant(b)]
        })
    }

    /// The signs, in the axes of B's box, of its corner farthest along `n`.
    fn b_signs(&self, n: DVec3) -> DVec3 {
        signs(self.axes.transpose() * n)
    }
}

/// Two boxes of which a face of A and a face of B are parallel, in the axes of A's box. The facet of `K`
/// is an octagon.
pub(crate) struct Octagon {
    /// Half extents, pair units.
    pub(crate) half_a: DVec3,
    pub(crate) half_b: DVec3,
    /// The axes of B's box, as columns.
    pub(crate) axes: DMat3,
    pub(crate) ray: DVec3,
}

impl Octagon {
    /// A's face `i` on B's face `j`, which are parallel. The facet of `K` is the octagon that the sides of
    /// both faces make. Returns the corners of its triangle around the ray.
    ///
    /// The octagon is the sum of four segments, the half sides `x` and `y` of A's face and two of B's.
    /// Sorted by angle they are `x`, `early` (B's in the first quadrant), `y`, and `late` (B's in the second
    /// quadrant). From its first corner on, where all four are subtracted, each following corner adds
    /// twice the next half side; after four of them comes the opposite corner:
    ///
    /// ```text
    /// corner   signs of x, early, y, late   name
    /// 0        - - - -                      start of the fan
    /// 1        + - - -
    /// 2        + + - -                      second
    /// 3        + + + -                      third
    /// 4        + + + +                      opposite of 0, at the end of the diagonal
    /// ```
    pub(crate) fn triangle(&self, i: usize, j: usize, crossed: DVec3) -> [[usize; 2]; 3] {
        let (half_a, half_b) = (self.half_a.to_array(), self.half_b.to_array());
        let columns = self.axes.to_cols_array_2d();
        let (i1, i2) = ((i + 1) % 3, (i + 2) % 3);
        let (j1, j2) = ((j + 1) % 3, (j + 2) % 3);
        let on_face = |v: [f64; 3]| DVec2::new(v[i1], v[i2]);
        let upper_a = self.ray.to_array()[i] > 0.0;
        let upper_b = upper_a != (columns[j][i] > 0.0);
        // Sort B's half sides by angle. Each is first turned into the upper half plane (`f_half`,
        // `g_half`); `up_f` and `up_g` note whether that kept its direction. K is A - B, so the sign of
        // a half side in B's corner is the opposite of its sign in the octagon: hence the XOR below.
        let (f, g) = (on_face(columns[j1]), on_face(columns[j2]));
        let is_up = |v: DVec2| v.y > 0.0 || (v.y == 0.0 && v.x > 0.0);
        let (up_f, up_g) = (is_up(f), is_up(g));
        let f_half = f * if up_f { half_b[j1] } else { -half_b[j1] };
        let g_half = g * if up_g { half_b[j2] } else { -half_b[j2] };
        let f_first = f_half.perp_dot(g_half) > 0.0;
        let (early, late) = if f_first { (f_half, g_half) } else { (g_half, f_half) };
        let (along_x, along_y) = (DVec2::new(half_a[i1], 0.0), DVec2::new(0.0, half_a[i2]));
        // The crossed point relative to the middle of the octagon. If the point is left of the
        // diagonal, the octagon is rotated by half a turn, which brings the point to its right. The
        // corners found are then those opposite to the corners sought.
        let height = if upper_b { half_b[j] } else { -half_b[j] };
        let at = on_face(crossed.to_array()) + on_face(columns[j]) * height;
        let end = along_x + early + along_y + late;
        let turned = end.perp_dot(at) > 0.0;
        let from_start = end + if turned { -at } else { at };
        let second = 2.0 * (along_x + early);
        let third = second + 2.0 * along_y;
        // The diagonal and the corners 0 to 4 bound three triangles, a fan from corner 0. The side of
        // the lines from corner 0 to `second` and to `third` on which the point lies tells which of
        // them holds it. Its corners are 0, 1, 2, or 0, 2, 3, or 0, 3, 4: the rows below are their signs.
        let past_second = second.perp_dot(from_start) > 0.0;
        let past_third = third.perp_dot(from_start) > 0.0;
        let corners =
            [[false; 4], [true, past_second, past_third, false], [true, true, past_second, past_third]];
        corners.map(|signs| {
            let [x, early, y, late] = signs.map(usize::from);
            let a = usize::from(upper_a) << i | x << i1 | y << i2;
            let (of_f, of_g) = if f_first { (early, late) } else { (late, early) };
            let b = usize::from(upper_b) << j
                | (of_f ^ usize::from(up_f)) << j1
                | (of_g ^ usize::from(up_g)) << j2;
            // Undo the half turn: invert the two signs on the face, and keep the one along its normal.
            let flip = |kept: usize| if turned { 7 ^ 1 << kept } else { 0 };
            [a ^ flip(i), b ^ flip(j)]
        })
    }
}

/// The index of the largest scale, and the scale. Computed without branches, because they would be
/// unpredictable. Parallel edges have no axis: their scale is 0 / 0, which is never larger.
fn largest(scales: &[f64]) -> (usize, f64) {
    let (mut best, mut largest) = (0, 0.0);
    for (k, &scale) in scales.iter().enumerate() {
        let better = scale > largest;
        best = if better { k } else { best };
        largest = if better { scale } else { largest };
    }
    (best, largest)
}

fn signs(v: DVec3) -> DVec3 {
    DVec3::new(v.x.signum(), v.y.signum(), v.z.signum())
}

/// The square from -1 to 1 is divided by its rising diagonal. Returns the corners of the half that
/// holds the point.
pub(crate) fn triangle(x: f64, y: f64) -> [(f64, f64); 3] {
    let third = if x > y { (1.0, -1.0) } else { (-1.0, 1.0) };
    [(-1.0, -1.0), third, (1.0, 1.0)]
}

#[cfg(test)]
mod tests {
    use crate::pair::Pair;
    use crate::workload::{Family, Regime, Workload};
    use crate::{Body, Columns, ConvexHull, Pose, Query, Steps};

    /// A start that misses the ray costs steps and has no other effect, so only this test notices it.
    /// Catches a sign that is lost in the closed form and a wrong corner of the octagon.
    #[test]
    fn the_start_is_the_facet_that_the_ray_crosses() {
        for regime in [Regime::Shallow, Regime::Resting] {
            let workload = Workload::generate(Family::Box, regime, 500, 7).expect("a workload");
            let hulls: Vec<ConvexHull> =
                workload.hulls.iter().map(|points| ConvexHull::new(points).expect("a hull")).collect();
            let (mut steps, mut turned) = (Steps::default(), Columns::default());
            let mut at_once = 0;
            for pair in &workload.pairs {
                let body = |i: usize| {
                    let pose = Pose::new(pair.positions[i], pair.rotations[i]).expect("a pose");
                    Body::new(&hulls[pair.hulls[i]], pose)
                };
                let query = Query { margin: f64::INFINITY, ..Query::default() };
                // The path for all hulls, although lanes would answer these pairs.
                steps.answer(&mut Pair::new(&body(0), &body(1)), &query, None, &mut turned);
                at_once += usize::from(steps.manifold.iterations == 1);
            }
            assert!(at_once >= 495, "{regime:?}: {at_once}");
        }
    }
}

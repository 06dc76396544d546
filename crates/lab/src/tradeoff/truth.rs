//! The true values that answers are compared with: support values and the least translation, by brute
//! force over the whole hulls.

use glam::{DMat3, DVec3};

use super::cases::{Case, HullPose};
use hullcast_contact::ConvexHull;

/// Two whole hulls in the world's axes. Lengths are in the caller's units.
pub(super) struct WorldPair<'a> {
    hulls: [WorldHull<'a>; 2],
    /// The vector from A's contraction point to B's.
    pub(super) d: DVec3,
    /// Sum of the circumradii.
    pub(super) size: f64,
}

struct WorldHull<'a> {
    hull: &'a ConvexHull,
    rotation: DMat3,
    /// Vertices relative to the contraction point, world axes.
    vertices: Vec<DVec3>,
}

impl<'a> WorldHull<'a> {
    fn new(hull: &'a ConvexHull, placement: &HullPose) -> Self {
        let rotation = DMat3::from_quat(placement.rotation);
        let vertices = hull.vertices().iter().map(|&v| rotation * (v * hull.scale())).collect();
        Self { hull, rotation, vertices }
    }

    fn reach(&self, n: DVec3) -> f64 {
        self.vertices.iter().map(|v| n.dot(*v)).fold(f64::NEG_INFINITY, f64::max)
    }

    fn normals(&self) -> Vec<DVec3> {
        self.hull.faces().iter().map(|face| self.rotation * face.normal).collect()
    }
}

impl<'a> WorldPair<'a> {
    pub(super) fn new(a: &'a ConvexHull, b: &'a ConvexHull, case: &Case) -> Self {
        let centre = |hull: &ConvexHull, at: &HullPose| at.rotation * hull.contraction_point();
        let d = case.b.position - case.a.position + (centre(b, &case.b) - centre(a, &case.a));
        let size = a.circumradius() + b.circumradius();
        Self { hulls: [WorldHull::new(a, &case.a), WorldHull::new(b, &case.b)], d, size }
    }

    /// The support value of the centred Minkowski difference along a unit direction.
    pub(super) fn reach(&self, n: DVec3) -> f64 {
        self.hulls[0].reach(n) + self.hulls[1].reach(-n)
    }

    /// The growth scale that a direction proves.
    pub(super) fn proven(&self, n: DVec3) -> f64 {
        n.dot(self.d) / self.reach(n)
    }

    /// The signed separation along a unit direction.
    pub(super) fn separation(&self, n: DVec3) -> f64 {
        n.dot(self.d) - self.reach(n)
    }

    /// The depth and direction of the least translation that separates overlapping hulls. It is exact up to
    /// the planarity of merged faces. The search goes over all normals of the Minkowski difference: those of
    /// the faces, and those of pairs of edges whose arcs on the Gauss map cross (D. Gregorius, *The
    /// Separating Axis Test between Convex Polyhedra*, GDC 2013).
    pub(super) fn least_translation(&self) -> (f64, DVec3) {
        let [a, b] = &self.hulls;
        let normals = [a.normals(), b.normals().into_iter().map(|n| -n).collect()];
        let mut least = (f64::INFINITY, DVec3::ZERO);
        let mut at_most = |depth: f64, n: DVec3| {
            if depth < least.0 {
                least = (depth, n);
            }
        };
        for &n in normals.iter().flatten() {
            at_most(-self.separation(n), n);
        }
        let arcs = |side: &WorldHull<'_>, normals: &[DVec3]| -> Vec<Arc> {
            let edges = side.hull.edge_vertices().iter().zip(side.hull.edge_faces());
            let arc = |(ends, faces): (&[u32; 2], &[u32; 2])| {
                let [tail, tip] = ends.map(|v| side.vertices[v as usize]);
                let [left, right] = faces.map(|face| normals[face as usize]);
                Arc { tail, edge: tip - tail, left, right, across: right.cross(left) }
            };
            edges.map(arc).collect()
        };
        let arcs_b = arcs(b, &normals[1]);
        for of_a in arcs(a, &normals[0]) {
            for of_b in arcs_b.iter().filter(|of_b| of_a.crosses(of_b)) {
                let n = of_a.edge.cross(of_b.edge);
                // Parallel edges add no normal: the faces that they bound have it.
                if n.length_squared() < 1e-16 * of_a.edge.length_squared() * of_b.edge.length_squared() {
                    continue;
                }
                let n = n.normalize();
                let n = if n.dot(of_a.left + of_a.right) < 0.0 { -n } else { n };
                at_most(n.dot(of_a.tail - of_b.tail) - n.dot(self.d), n);
            }
        }
        least
    }
}

/// An edge and its arc on the Gauss map.
struct Arc {
    tail: DVec3,
    edge: DVec3,
    left: DVec3,
    right: DVec3,
    across: DVec3,
}

impl Arc {
    fn crosses(&self, other: &Self) -> bool {
        let ends = [other.left.dot(self.across), other.right.dot(self.across)];
        let own = [self.left.dot(other.across), self.right.dot(other.across)];
        // The ends of each arc lie on opposite sides of the other's plane, in one half of the sphere.
        ends[0] * ends[1] < 0.0 && own[0] * own[1] < 0.0 && ends[0] * own[1] > 0.0
    }
}

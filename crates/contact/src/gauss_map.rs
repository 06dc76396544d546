//! Step 2: from the contact normal to the feature that it touches, by the Gauss map.
//!
//! After Silcowitz, Niebe and Erleben (SCA 2010, section 4). The Gauss map tiles the unit sphere of
//! directions by a hull's features: a face is a point (its normal), an edge is the arc between the
//! normals of its two faces, and a vertex is the region between the arcs of its edges. The direction
//! `n` touches the feature on whose tile it lies:
//!
//! ```text
//!      f ------e------ g         f, g, h  faces
//!       `.    .n     .'          e        edge between the faces f and g
//!         `.   v   .'            v        vertex of the three faces
//!           `.   .'              n        here the direction touches v; within the feature angle
//!             `h'                         of the arc e it touches the edge e
//! ```
//!
//! A computed direction almost never hits a point or an arc exactly. So faces and edges are expanded by
//! the *feature angle*: a face within this angle of `n` beats an edge, and an edge within it beats a
//! vertex.
//!
//! ```text
//! touched_feature(hull, n):
//!     a vertex, edge or face at the support point stands apart from all others: take it
//!     S = vertices within rounding of the farthest one along n
//!     faces within the angle of n, reached from S: the nearest
//!     otherwise faces with all corners in S: the nearest
//!     otherwise edges at S within the angle whose arc holds n, or edges with both ends in S:
//!         the one most nearly perpendicular to n
//!     otherwise the vertex of S with the lowest index
//! ```
//!
//! Ties go to the larger face, then to the lowest index, so the result depends neither on the order of
//! the search nor on that of the basis. The first line is a shortcut that takes time linear in the
//! number of features at one or two vertices, and it gives the same result as the search. The search
//! takes time linear in the number of features at `S` and of faces within the angle.
//!
//! For B the direction is `-n`, in B's frame.

use glam::DVec3;

use super::ConvexHull;
use super::tolerance::{LONE, TIE, U};

/// A feature, by the hull's own indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Touched {
    Vertex(u32),
    Edge(u32),
    Face(u32),
}

/// The direction to look up in a Gauss map, and the tolerances.
pub(crate) struct Direction<'s> {
    /// The outward direction: unit, hull frame. It is the normal for A and its opposite for B.
    pub(crate) n: DVec3,
    /// Vertices known to be farthest along it: first the support point, then those of the basis.
    pub(crate) known: &'s [u32],
    /// How far below the farthest vertex another one still counts as supporting; hull units.
    pub(crate) depth: f64,
    /// Sine and cosine of the feature angle.
    pub(crate) sine: f64,
    pub(crate) cosine: f64,
}

/// Buffers of the search.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    vertices: Marks,
    support: Vec<u32>,
    faces: Marks,
    near: Vec<Candidate>,
}

/// A candidate feature and how near it is to the direction.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    feature: u32,
    /// For a face, the cosine of the angle between its normal and the direction. For an edge, the sine of
    /// the angle by which it is off the perpendicular.
    measure: f64,
}

/// A set of indices that is emptied in constant time: an index is in the set if it has the current
/// stamp.
#[derive(Debug, Default)]
struct Marks {
    stamps: Vec<u32>,
    stamp: u32,
}

impl Marks {
    fn clear(&mut self, len: usize) {
        if self.stamps.len() < len {
            self.stamps.resize(len, 0);
        }
        self.stamp = self.stamp.wrapping_add(1);
        if self.stamp == 0 {
            self.stamps.fill(0);
            self.stamp = 1;
        }
    }

    /// Adds `i`. Returns whether it was not in the set before.
    #[inline]
    fn insert(&mut self, i: u32) -> bool {
        let slot = &mut self.stamps[i as usize];
        let new = *slot != self.stamp;
        *slot = self.stamp;
        new
    }

    #[inline]
    fn contains(&self, i: u32) -> bool {
        self.stamps[i as usize] == self.stamp
    }
}

/// The feature of `hull` that a support plane perpendicular to the direction touches.
pub(crate) fn touched_feature(
    hull: &ConvexHull,
    direction: &Direction<'_>,
    scratch: &mut Scratch,
) -> Touched {
    if let Some(feature) = lone_feature(hull, direction) {
        return feature;
    }
    scratch.search(hull, direction)
}

/// The touched feature, if it is a vertex, edge or face of the known vertices that stands apart so far
/// that no other feature has to be examined.
fn lone_feature(hull: &ConvexHull, direction: &Direction<'_>) -> Option<Touched> {
    let v = direction.known[0];
    // The basis of a vertex names it three times. The vertices that a basis of an edge names may
    // also belong to a face, and faces are touched far more often, so the face is tried first.
    if direction.known.iter().fold(true, |all, &u| all & (u == v)) && stands_out(hull, v, v, direction) {
        return Some(Touched::Vertex(v));
    }
    if let Some(face) = lone_face(hull, direction) {
        return Some(Touched::Face(face));
    }
    let mut others = direction.known.iter().copied().filter(|&u| u != v);
    let w = others.next()?;
    if others.all(|u| u == w) { lone_edge(hull, [v, w], direction) } else { None }
}

/// The edge between two vertices, if both ends support to within `depth` and all other edges at its
/// ends fall away from the direction.
fn lone_edge(hull: &ConvexHull, [v, w]: [u32; 2], direction: &Direction<'_>) -> Option<Touched> {
    let ends = [v.min(w), v.max(w)];
    let edge = hull.vertex_edges(v as usize).iter().find(|&&e| hull.edge_vertices()[e as usize] == ends)?;
    let rise = direction.n.dot(hull.vertex(w) - hull.vertex(v));
    let level = rise.abs() <= direction.depth;
    (level && stands_out(hull, v, w, direction) && stands_out(hull, w, v, direction))
        .then_some(Touched::Edge(*edge))
}

/// Whether every triangle side at vertex `v`, except the one to `except`, falls away from the direction
/// by more than the feature angle and the hull's merge error.
///
/// Then none of these sides is touched, and neither are the vertices at their other ends. No face at
/// `v` is touched either. It has a triangle at `v`, and at least one side of that triangle falls away.
/// Along a touched face it would fall by no more than the feature angle and the face's planarity. An
/// edge that runs through merged vertices also begins with such a side.
fn stands_out(hull: &ConvexHull, v: u32, except: u32, direction: &Direction<'_>) -> bool {
    let at = hull.vertex(v);
    let sine_squared = direction.sine * direction.sine * (1.0 + LONE);
    hull.vertex_neighbours(v as usize).iter().all(|&w| {
        let along = hull.vertex(w) - at;
        let fall = -direction.n.dot(along);
        let least = fall - hull.merge_error();
        let steep = (least > 0.0) & (least * least > sine_squared * along.length_squared());
        (w == except) | (steep & (fall > direction.depth + LONE))
    })
}

/// The touched face at the support point, if it stands apart so far that no other face is within the
/// feature angle of the direction and only its own vertices support. Then nothing else has to be
/// examined.
fn lone_face(hull: &ConvexHull, direction: &Direction<'_>) -> Option<u32> {
    let Direction { n, known, depth, sine, cosine } = *direction;
    let normal = |f: u32| hull.faces()[f as usize].normal;
    let (mut face, mut along) = (0, 0.0);
    for &f in hull.vertex_faces(known[0] as usize) {
        // Computed without branches, because they would be unpredictable.
        let m_dot_n = normal(f).dot(n);
        let nearer = m_dot_n > along;
        face = if nearer { f } else { face };
        along = if nearer { m_dot_n } else { along };
    }
    let across_squared = n.cross(normal(face)).length_squared();
    if !(along > 0.0 && across_squared <= sine * sine) {
        return None;
    }
    let (across, apart) = (across_squared.sqrt(), hull.faces()[face as usize].isolation);
    // Let a be the angle from the direction to this face's normal, b the feature angle, and c the
    // angle from this face to the next. The next face is out of reach if cos(a + b) > cos(c).
    let next_is_far = along * cosine - across * sine > apart.cosine + LONE;
    // All vertices are within 1 of the centre, so turning the direction by a changes the height of
    // a vertex by at most sin a, and the difference of two heights by at most twice that.
    let others_are_low = along * apart.gap - 2.0 * across > depth + LONE;
    (next_is_far && others_are_low).then_some(face)
}

impl Scratch {
    /// Finds the touched feature by its definition.
    fn search(&mut self, hull: &ConvexHull, direction: &Direction<'_>) -> Touched {
        self.find_support(hull, direction);
        if let Some(face) = self.touched_face(hull, direction) {
            return Touched::Face(face);
        }
        if let Some(edge) = self.touched_edge(hull, direction) {
            return Touched::Edge(edge);
        }
        Touched::Vertex(self.support.iter().copied().min().unwrap_or(0))
    }

    /// All vertices within `depth` of the farthest.
    pub(crate) fn support_set(&mut self, hull: &ConvexHull, direction: &Direction<'_>) -> &[u32] {
        self.find_support(hull, direction);
        &self.support
    }

    /// Collects all vertices within `depth` of the farthest. They are connected along the hull's edges,
    /// as is every part that a half space cuts off a convex polytope.
    fn find_support(&mut self, hull: &ConvexHull, direction: &Direction<'_>) {
        let Self { vertices: marks, support, .. } = self;
        let height = |v: u32| direction.n.dot(hull.vertex(v));
        marks.clear(hull.vertices().len());
        support.clear();
        let mut highest = f64::NEG_INFINITY;
        for &v in direction.known {
            if marks.insert(v) {
                highest = highest.max(height(v));
                support.push(v);
            }
        }
        let mut next = 0;
        while let Some(&v) = support.get(next) {
            next += 1;
            for &w in hull.vertex_neighbours(v as usize) {
                if !marks.contains(w) && height(w) >= highest - direction.depth && marks.insert(w) {
                    support.push(w);
                }
            }
        }
    }

    /// The touched face. Candidates are the faces within the feature angle that are reached from the
    /// support set through such faces. If there are none, they are the faces whose corners are all in the
    /// support set. The candidate nearest to the direction wins; among equals the larger, then the one
    /// with the lower index.
    fn touched_face(&mut self, hull: &ConvexHull, direction: &Direction<'_>) -> Option<u32> {
        let Self { vertices: supports, support, faces: seen, near } = self;
        let n = direction.n;
        let cosine = |f: u32| hull.faces()[f as usize].normal.dot(n);
        let within = |f: u32| {
            cosine(f) > 0.0
                && n.cross(hull.faces()[f as usize].normal).length_squared()
                    <= direction.sine * direction.sine
        };
        let at_support = || support.iter().flat_map(|&v| hull.vertex_faces(v as usize)).copied();
        seen.clear(hull.face_count());
        near.clear();
        for f in at_support() {
            if seen.insert(f) && within(f) {
                near.push(Candidate { feature: f, measure: cosine(f) });
            }
        }
        let mut next = 0;
        while let Some(&Candidate { feature, .. }) = near.get(next) {
            next += 1;
            for &g in hull.face_neighbours(feature as usize) {
                if seen.insert(g) && within(g) {
                    near.push(Candidate { feature: g, measure: cosine(g) });
                }
            }
        }
        // A face that lies in the support plane is touched even if rounding of its few heights tilts it
        // out of the feature angle.
        if near.is_empty() && support.len() >= 3 {
            let flat =
                |f: &u32| cosine(*f) > 0.0 && hull.outline(*f as usize).iter().all(|&v| supports.contains(v));
            // Test each face once: a face has many corners, and the test goes through all of them.
            seen.clear(hull.face_count());
            for f in at_support() {
                if seen.insert(f) && flat(&f) {
                    near.push(Candidate { feature: f, measure: cosine(f) });
                }
            }
        }
        if let &[only] = near.as_slice() {
            return Some(only.feature);
        }
        let nearest = near.iter().map(|f| f.measure).fold(f64::NEG_INFINITY, f64::max);
        let tied = near.iter().filter(|f| f.measure >= nearest - TIE * U).map(|f| f.feature);
        let area = |f: u32| hull.faces()[f as usize].area;
        tied.min_by(|&f, &g| area(g).total_cmp(&area(f)).then(f.cmp(&g)))
    }

    /// The touched edge. Candidates are the edges at the support set that are perpendicular to the
    /// direction to within the feature angle and whose arc holds its projection, and the edges with both
    /// ends in the set. The one most nearly perpendicular wins; among equals the one with the lowest index.
    fn touched_edge(&mut self, hull: &ConvexHull, direction: &Direction<'_>) -> Option<u32> {
        let Self { vertices: supports, support, near, .. } = self;
        near.clear();
        for &e in support.iter().flat_map(|&v| hull.vertex_edges(v as usize)) {
            let [v, w] = hull.edge_vertices()[e as usize];
            let along = hull.vertex(w) - hull.vertex(v);
            let (rise, length_squared) = (direction.n.dot(along), along.length_squared());
            let across = rise * rise <= direction.sine * direction.sine * length_squared;
            let both = supports.contains(v) && supports.contains(w);
            if both || (across && arc_holds(hull, e, along, direction.n)) {
                near.push(Candidate { feature: e, measure: rise.abs() / length_squared.sqrt() });
            }
        }
        if let &[only] = near.as_slice() {
            return Some(only.feature);
        }
        let least = near.iter().map(|e| e.measure).fold(f64::INFINITY, f64::min);
        near.iter().filter(|e| e.measure <= least + TIE * U).map(|e| e.feature).min()
    }
}

/// Whether `n`, projected on the plane perpendicular to the edge, lies between the normals of the
/// edge's two faces.
fn arc_holds(hull: &ConvexHull, edge: u32, along: DVec3, n: DVec3) -> bool {
    let [m0, m1] = hull.edge_faces()[edge as usize].map(|f| hull.faces()[f as usize].normal);
    let side = m0.cross(m1).dot(along).signum();
    side * m0.cross(n).dot(along) >= 0.0 && side * n.cross(m1).dot(along) >= 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::HullOptions;
    use crate::workload::Random;

    /// Tries directions on and around the faces, edges and vertices of hulls with flat and fine parts.
    /// Catches a feature that counts as standing apart although the whole search finds another one.
    #[test]
    fn a_lone_feature_is_what_the_whole_search_finds() {
        let boxes = |half: [f64; 3]| {
            let sign = |i: usize, k: usize| if i >> k & 1 == 0 { -1.0 } else { 1.0 };
            (0..8).map(|i| std::array::from_fn(|k| sign(i, k) * half[k])).collect::<Vec<[f64; 3]>>()
        };
        let ring = |n: usize, r: f64, z: f64| {
            (0..n).map(move |i| {
                let (sin, cos) = (std::f64::consts::TAU * i as f64 / n as f64).sin_cos();
                [r * cos, r * sin, z]
            })
        };
        let clouds = [
            boxes([1.0, 0.5, 0.2]),
            boxes([1.0, 1.0, 1e-6]),
            ring(7, 1.0, -0.5).chain(ring(7, 1.0, 0.5)).collect(),
            ring(300, 1.0, -0.5).chain(ring(300, 0.999, 0.5)).collect(),
            ring(40, 1.0, 0.0).chain(ring(40, 0.9, 0.004)).chain(ring(3, 0.1, -1.0)).collect(),
            // A cone that is flat enough to merge into one face, although its tip is steep.
            ring(40, 1.0, -0.5)
                .chain(ring(40, 1.0, 0.5))
                .chain([[0.0, 0.0, 0.508]])
                .chain(ring(9, 0.003, 0.5077))
                .collect(),
        ];
        let (mut lone, mut other, mut generator) = ([0; 3], 0, Random::new(1));
        let mut random = || generator.within(-1.0, 1.0);
        let mut scratch = Scratch::default();
        // With a coarse merge tolerance, faces do not lie where their triangles are.
        let planarities = [None, Some(1e-3), Some(0.01)];
        for (points, planarity) in clouds.iter().flat_map(|points| planarities.map(|p| (points, p))) {
            let options = HullOptions { planarity, ..HullOptions::default() };
            let hull = ConvexHull::with_options(points, &options).expect("a hull");
            for round in 0..4000 {
                let tilt = 10_f64.powi(-(round % 8));
                // The direction is along a face's normal, perpendicular to an edge, or arbitrary, and
                // slightly perturbed.
                let edge = round as usize % hull.edge_count();
                let [f, g] = hull.edge_faces()[edge].map(|f| hull.faces()[f as usize].normal);
                let share = [0.0, 0.5, 0.3][round as usize / 32 % 3];
                let n = (f + share * (g - f) + tilt * DVec3::new(random(), random(), random())).normalize();
                let off_edge = share != 0.0 && round % 5 < 3;
                let along = hull.edge_vertices()[edge].map(|v| hull.vertex(v));
                let along = (along[1] - along[0]).normalize();
                let n = if off_edge { (n - along * n.dot(along)).normalize() } else { n };
                let known = if off_edge && hull.edge_vertices()[edge].contains(&hull.support(n)) {
                    hull.edge_vertices()[edge].to_vec()
                } else {
                    vec![hull.support(n)]
                };
                let angle: f64 = [0.0, 1e-3, 0.01, 0.3][round as usize / 8 % 4];
                let (sine, cosine) = angle.sin_cos();
                let direction = Direction { n, known: &known, depth: 64.0 * U, sine, cosine };
                match lone_feature(&hull, &direction) {
                    Some(feature) => {
                        assert_eq!(scratch.search(&hull, &direction), feature);
                        lone[match feature {
                            Touched::Vertex(_) => 0,
                            Touched::Edge(_) => 1,
                            Touched::Face(_) => 2,
                        }] += 1;
                    }
                    None => other += 1,
                }
            }
        }
        assert!(lone.iter().all(|&count| count > 1000) && other > 3000, "{lone:?} {other}");
    }
}

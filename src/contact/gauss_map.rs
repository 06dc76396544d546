//! Step 2: from the normal to the feature it touches (Silcowitz et al. 2010,
//! section 4).
//!
//! The Gauss map tiles the unit sphere with a hull's normals: a face is a
//! point, an edge the arc between its two faces, a vertex the region between
//! its edges. Near-parallel faces and edges count as touched within the feature
//! angle: a face within it of the normal beats an edge, an edge beats a vertex.

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

/// What is asked of a Gauss map.
pub(crate) struct Direction<'s> {
    /// Unit, hull frame, outward: the normal for A, its opposite for B.
    pub(crate) n: DVec3,
    /// Vertices known to be farthest along it: the support point and the basis.
    pub(crate) known: &'s [u32],
    /// How far below the farthest a vertex still supports; hull units.
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
    near: Vec<Near>,
}

/// A candidate and how near it is to the direction.
#[derive(Clone, Copy, Debug)]
struct Near {
    feature: u32,
    /// Cosine of a face's normal, sine of an edge.
    measure: f64,
}

/// A set of indices, emptied at no cost.
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

    /// Whether `i` was new.
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

/// The feature of `hull` that a plane across the direction touches.
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

/// What the direction touches, where it stands so far apart that nothing else
/// has to be looked at: the vertex, the edge or the face of the known vertices.
fn lone_feature(hull: &ConvexHull, direction: &Direction<'_>) -> Option<Touched> {
    let v = direction.known[0];
    // The basis of a vertex names it three times. What an edge's names may also be
    // a face's, which is far more often touched.
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

/// The edge between two vertices, if it lies across the direction and all others
/// at its ends fall away.
fn lone_edge(hull: &ConvexHull, [v, w]: [u32; 2], direction: &Direction<'_>) -> Option<Touched> {
    let ends = [v.min(w), v.max(w)];
    let edge = hull.vertex_edges(v as usize).iter().find(|&&e| hull.edge_vertices()[e as usize] == ends)?;
    let rise = direction.n.dot(hull.vertex(w) - hull.vertex(v));
    let level = rise.abs() <= direction.depth;
    (level && stands_out(hull, v, w, direction) && stands_out(hull, w, v, direction))
        .then_some(Touched::Edge(*edge))
}

/// Whether from a vertex all sides of triangles but the one to `except` fall away, by more than
/// the feature angle and the hull's merge error: then none of them is touched, nor their other
/// ends. No face at the vertex is touched either, since it has a triangle there, of whose sides
/// one at least falls away; along a touched face it would fall by no more than the feature angle
/// and the face's planarity. An edge through merged vertices begins with such a side too.
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

/// The face that the direction touches, where it stands so far apart that no
/// other face is within the feature angle of the direction and no vertex but its
/// own supports: then nothing else has to be looked at.
fn lone_face(hull: &ConvexHull, direction: &Direction<'_>) -> Option<u32> {
    let Direction { n, known, depth, sine, cosine } = *direction;
    let normal = |f: u32| hull.faces()[f as usize].normal;
    let (mut face, mut along) = (0, 0.0);
    for &f in hull.vertex_faces(known[0] as usize) {
        // Without branches: which is nearest is anyone's guess.
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
    // cos(a + b) > cos(c) for the angle a to this face, the feature angle b and
    // the angle c to the next face.
    let next_is_far = along * cosine - across * sine > apart.cosine + LONE;
    // Turned by the angle a, vertices within 1 of the centre rise by sin a at most.
    let others_are_low = along * apart.gap - 2.0 * across > depth + LONE;
    (next_is_far && others_are_low).then_some(face)
}

impl Scratch {
    /// By the definition.
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

    /// All vertices within `depth` of the farthest: connected along the hull's
    /// edges, since what a half space cuts off a convex polytope is.
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

    /// Of the faces within the feature angle, reached from the support set through
    /// such faces, and of those all of whose corners support, the one nearest the
    /// direction; of equals the larger, then the lower index.
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
                near.push(Near { feature: f, measure: cosine(f) });
            }
        }
        let mut next = 0;
        while let Some(&Near { feature, .. }) = near.get(next) {
            next += 1;
            for &g in hull.face_neighbours(feature as usize) {
                if seen.insert(g) && within(g) {
                    near.push(Near { feature: g, measure: cosine(g) });
                }
            }
        }
        // A face that lies in the support plane is nearer than none, however its
        // few roundoffs of height tilt it.
        if near.is_empty() && support.len() >= 3 {
            let flat =
                |f: &u32| cosine(*f) > 0.0 && hull.outline(*f as usize).iter().all(|&v| supports.contains(v));
            // Each once: a face has many corners, and it takes a look at all to see it is flat.
            seen.clear(hull.face_count());
            for f in at_support() {
                if seen.insert(f) && flat(&f) {
                    near.push(Near { feature: f, measure: cosine(f) });
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

    /// Of the edges at the support set that are across the direction to within the
    /// feature angle and whose arc holds its projection, and of those with both
    /// ends in the set, the one most across; of equals the lowest index.
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
                near.push(Near { feature: e, measure: rise.abs() / length_squared.sqrt() });
            }
        }
        if let &[only] = near.as_slice() {
            return Some(only.feature);
        }
        let least = near.iter().map(|e| e.measure).fold(f64::INFINITY, f64::min);
        near.iter().filter(|e| e.measure <= least + TIE * U).map(|e| e.feature).min()
    }
}

/// Whether `n`, projected across the edge, lies between the normals of its faces.
fn arc_holds(hull: &ConvexHull, edge: u32, along: DVec3, n: DVec3) -> bool {
    let [m0, m1] = hull.edge_faces()[edge as usize].map(|f| hull.faces()[f as usize].normal);
    let side = m0.cross(m1).dot(along).signum();
    side * m0.cross(n).dot(along) >= 0.0 && side * n.cross(m1).dot(along) >= 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::HullOptions;

    /// Directions on and around the faces, edges and vertices of hulls with flat
    /// and fine parts. Catches a feature called lone that another one outdoes.
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
            // A cone flat enough to be one face, whose tip is steep.
            ring(40, 1.0, -0.5)
                .chain(ring(40, 1.0, 0.5))
                .chain([[0.0, 0.0, 0.508]])
                .chain(ring(9, 0.003, 0.5077))
                .collect(),
        ];
        let (mut lone, mut other, mut state) = ([0; 3], 0, 1_u64);
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        };
        let mut scratch = Scratch::default();
        // Merged coarsely, so that faces are not where their triangles are.
        let planarities = [None, Some(1e-3), Some(0.01)];
        for (points, planarity) in clouds.iter().flat_map(|points| planarities.map(|p| (points, p))) {
            let options = HullOptions { planarity, ..HullOptions::default() };
            let hull = ConvexHull::with_options(points, &options).expect("a hull");
            for round in 0..4000 {
                let tilt = 10_f64.powi(-(round % 8));
                // Along a face's normal, across an edge, or anywhere, and a little off.
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

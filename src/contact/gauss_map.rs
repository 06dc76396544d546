//! Step 2: from the normal to the feature it touches (Silcowitz et al. 2010,
//! section 4).
//!
//! The Gauss map tiles the unit sphere with a hull's normals: a face is a
//! point, an edge the arc between its two faces, a vertex the region between
//! its edges. Near-parallel faces and edges count as touched within the feature
//! angle: a face within it of the normal beats an edge, an edge beats a vertex.

use glam::DVec3;

use super::ConvexHull;
use super::tolerance::{TIE, U};

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
    /// Sine of the feature angle.
    pub(crate) sine: f64,
}

/// Buffers of the search.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    vertices: Marked,
    faces: Marked,
}

/// Indices, in the order found, each once.
#[derive(Debug, Default)]
struct Marked {
    stamps: Vec<u32>,
    stamp: u32,
    found: Vec<u32>,
}

impl Marked {
    fn clear(&mut self, len: usize) {
        self.found.clear();
        if self.stamps.len() < len {
            self.stamps.resize(len, 0);
        }
        self.stamp = self.stamp.wrapping_add(1);
        if self.stamp == 0 {
            self.stamps.fill(0);
            self.stamp = 1;
        }
    }

    fn insert(&mut self, i: u32) {
        let slot = &mut self.stamps[i as usize];
        if *slot != self.stamp {
            *slot = self.stamp;
            self.found.push(i);
        }
    }

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
    support_set(hull, direction, &mut scratch.vertices);
    let support = &scratch.vertices;
    if let Some(face) = touched_face(hull, direction, support, &mut scratch.faces) {
        return Touched::Face(face);
    }
    if let Some(edge) = touched_edge(hull, direction, support) {
        return Touched::Edge(edge);
    }
    Touched::Vertex(support.found.iter().copied().min().unwrap_or(0))
}

/// All vertices within `depth` of the farthest: connected along the hull's
/// edges, since what a half space cuts off a convex polytope is.
fn support_set(hull: &ConvexHull, direction: &Direction<'_>, set: &mut Marked) {
    let height = |v: u32| direction.n.dot(hull.vertices()[v as usize]);
    set.clear(hull.vertices().len());
    direction.known.iter().for_each(|&v| set.insert(v));
    let lowest =
        direction.known.iter().map(|&v| height(v)).fold(f64::NEG_INFINITY, f64::max) - direction.depth;
    let mut next = 0;
    while let Some(&v) = set.found.get(next) {
        next += 1;
        for &w in hull.vertex_neighbours(v as usize) {
            if height(w) >= lowest {
                set.insert(w);
            }
        }
    }
}

/// Of the faces within the feature angle, reached from the support set through
/// such faces, and of those all of whose corners support, the one nearest the
/// direction; of equals the larger, then the lower index.
fn touched_face(
    hull: &ConvexHull,
    direction: &Direction<'_>,
    support: &Marked,
    faces: &mut Marked,
) -> Option<u32> {
    let normal = |f: u32| hull.face_normals()[f as usize];
    let within = |f: u32| {
        let m = normal(f);
        m.dot(direction.n) > 0.0 && direction.n.cross(m).length_squared() <= direction.sine * direction.sine
    };
    faces.clear(hull.face_normals().len());
    for &v in &support.found {
        for &f in hull.vertex_faces(v as usize) {
            let supports =
                || support.found.len() >= 3 && hull.outline(f as usize).iter().all(|&v| support.contains(v));
            if within(f) || supports() {
                faces.insert(f);
            }
        }
    }
    let mut next = 0;
    while let Some(&f) = faces.found.get(next) {
        next += 1;
        if within(f) {
            for &g in hull.face_neighbours(f as usize) {
                if within(g) {
                    faces.insert(g);
                }
            }
        }
    }
    let cosine = |f: u32| normal(f).dot(direction.n);
    let nearest = faces.found.iter().map(|&f| cosine(f)).fold(f64::NEG_INFINITY, f64::max);
    let area = |f: u32| hull.face_areas()[f as usize];
    let tied = faces.found.iter().copied().filter(|&f| cosine(f) >= nearest - TIE * U);
    tied.min_by(|&f, &g| area(g).total_cmp(&area(f)).then(f.cmp(&g)))
}

/// Of the edges at the support set that are across the direction to within the
/// feature angle and whose arc holds its projection, and of those with both
/// ends in the set, the one most across; of equals the lowest index.
fn touched_edge(hull: &ConvexHull, direction: &Direction<'_>, support: &Marked) -> Option<u32> {
    let along = |e: u32| {
        let [v, w] = hull.edge_vertices()[e as usize].map(|v| hull.vertices()[v as usize]);
        (w - v).normalize()
    };
    let slope = |e: u32| direction.n.dot(along(e)).abs();
    let candidate = |e: u32| {
        let ends_support = hull.edge_vertices()[e as usize].iter().all(|&v| support.contains(v));
        ends_support || (slope(e) <= direction.sine && arc_holds(hull, e, along(e), direction.n))
    };
    let edges = || support.found.iter().flat_map(|&v| hull.vertex_edges(v as usize)).copied();
    let lowest = edges().filter(|&e| candidate(e)).map(slope).fold(f64::INFINITY, f64::min);
    edges().filter(|&e| candidate(e) && slope(e) <= lowest + TIE * U).min()
}

/// Whether `n`, projected across the edge, lies between the normals of its faces.
fn arc_holds(hull: &ConvexHull, edge: u32, along: DVec3, n: DVec3) -> bool {
    let [m0, m1] = hull.edge_faces()[edge as usize].map(|f| hull.face_normals()[f as usize]);
    let side = m0.cross(m1).dot(along).signum();
    side * m0.cross(n).dot(along) >= 0.0 && side * n.cross(m1).dot(along) >= 0.0
}

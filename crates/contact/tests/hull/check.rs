//! Checks a hull against the definitions only: no step of the build is used, except that the
//! triangulation is read.

use std::collections::{BTreeSet, HashMap};

use glam::DVec3;
use hullcast_contact::hull::{ConvexHull, Triangulation, triangulate};
use robust::{Coord, Coord3D};

/// Unit roundoff.
const U: f64 = f64::EPSILON / 2.0;

/// Counts of the cases that the checks met, so that a sweep can show that it was not vacuous.
#[derive(Debug, Default)]
pub(crate) struct CheckCounts {
    pub(crate) hulls: usize,
    pub(crate) triangles: usize,
    pub(crate) coplanar_sides: usize,
    pub(crate) dropped_points: usize,
    pub(crate) merged_faces: usize,
    pub(crate) inexact_faces: usize,
    pub(crate) vertices_without_edges: usize,
    pub(crate) ordered_edges: usize,
}

/// Panics if the hull of `points` breaks a definition.
pub(crate) fn check(points: &[[f64; 3]], hull: &ConvexHull, counts: &mut CheckCounts) {
    let surface = triangulate(points).unwrap();
    counts.hulls += 1;
    counts.triangles += surface.triangles.len();
    counts.dropped_points += points.len() - hull.vertex_count();
    check_surface(points, &surface, hull, counts);
    check_sizes(points, &surface, hull);
    check_faces(hull, counts);
    check_outlines(hull);
    check_edges(hull, counts);
    check_adjacency(&surface, hull);
}

/// Positive if `p` is below the triangle; the sign is exact.
fn below(points: &[[f64; 3]], triangle: [u32; 3], p: [f64; 3]) -> f64 {
    let coord = |[x, y, z]: [f64; 3]| Coord3D { x, y, z };
    let [a, b, c] = triangle.map(|v| coord(points[v as usize]));
    robust::orient3d(a, b, c, coord(p))
}

/// The surface is closed and convex, has the Euler characteristic of a sphere, contains every point,
/// and each of its vertices is extreme. Catches a lost vertex, a hole, a fold and a flat vertex.
fn check_surface(points: &[[f64; 3]], surface: &Triangulation, hull: &ConvexHull, counts: &mut CheckCounts) {
    let triangles = &surface.triangles;
    let sides: HashMap<[u32; 2], usize> = triangles
        .iter()
        .enumerate()
        .flat_map(|(t, &[a, b, c])| [([a, b], t), ([b, c], t), ([c, a], t)])
        .collect();
    assert_eq!(sides.len(), 3 * triangles.len(), "a side occurs twice");
    let used: BTreeSet<u32> = triangles.iter().flatten().copied().collect();
    assert!(used.iter().eq(hull.registered_indices()), "vertices of hull and triangulation differ");
    assert_eq!(triangles.len() + 4, 2 * used.len(), "Euler's formula");
    let mut creases: HashMap<u32, usize> = HashMap::new();
    for (t, &corners) in triangles.iter().enumerate() {
        for i in 0..3 {
            let (from, to) = (corners[i], corners[(i + 1) % 3]);
            let across = sides[&[to, from]];
            assert_eq!(surface.neighbours[t][i] as usize, across);
            let apex = *triangles[across].iter().find(|v| ![from, to].contains(v)).unwrap();
            let bend = below(points, corners, points[apex as usize]);
            assert!(bend >= 0.0, "a reflex side");
            counts.coplanar_sides += usize::from(bend == 0.0);
            *creases.entry(from).or_default() += usize::from(bend > 0.0);
        }
    }
    assert!(used.iter().all(|v| creases[v] >= 3), "a vertex that is not extreme");
    for &corners in triangles {
        assert!(points.iter().all(|&p| below(points, corners, p) >= 0.0), "a point outside");
    }
}

/// The vertices in hull units are the given points, and both radii are bounds, though tight ones.
fn check_sizes(points: &[[f64; 3]], surface: &Triangulation, hull: &ConvexHull) {
    let (centre, scale) = (hull.contraction_point(), hull.scale());
    assert_eq!(scale.to_bits() & ((1 << 52) - 1), 0, "the scale is not a power of two");
    assert!((0.5..1.0).contains(&hull.unit_circumradius()));
    assert!(hull.unit_inradius() > 0.0);
    for (&v, &i) in hull.vertices().iter().zip(hull.registered_indices()) {
        // Exact, except for differences that are subnormal in hull units.
        let lost = (v * scale - (DVec3::from_array(points[i as usize]) - centre)).abs().max_element();
        assert!(lost <= f64::MIN_POSITIVE * scale, "a vertex moved by {lost:e}");
        assert!(v.length() <= hull.unit_circumradius());
    }
    let farthest = hull.vertices().iter().map(|v| v.length()).fold(0.0, f64::max);
    assert!(hull.unit_circumradius() <= farthest * (1.0 + 16.0 * U));
    // The ball of the inradius reaches beyond no triangle. This is checked at sample points of the
    // triangles, because the distance to the plane of a sliver is mostly rounding.
    let place: HashMap<u32, usize> = hull.registered_indices().iter().copied().zip(0..).collect();
    for triangle in &surface.triangles {
        let [a, b, c] = triangle.map(|v| hull.vertices()[place[&v]]);
        for (s, t) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (0.5, 0.0), (0.0, 0.5), (0.33, 0.33)] {
            let p = a + s * (b - a) + t * (c - a);
            assert!(p.length() >= hull.unit_inradius() - 8.0 * U, "the inradius is too large");
        }
    }
    let nearest = hull.faces().iter().map(|face| face.offset).fold(f64::INFINITY, f64::min);
    let slack = hull.faces().iter().map(|face| face.planarity).fold(0.0, f64::max);
    assert!(
        hull.unit_inradius() >= nearest * (1.0 - 8.0 * U) - 2.0 * slack - 16.0 * U,
        "the inradius is too small"
    );
}

/// No vertex is above the plane of a face, and the vertices of the face are near the plane.
fn check_faces(hull: &ConvexHull, counts: &mut CheckCounts) {
    let inner = (hull.unit_inradius() / 64.0).max(64.0 * U);
    let tolerance = (hull.planarity() * hull.unit_circumradius()).min(inner).max(64.0 * U) + 16.0 * U;
    for face in 0..hull.face_count() {
        let (normal, offset) = (hull.faces()[face].normal, hull.faces()[face].offset);
        let planarity = hull.faces()[face].planarity;
        assert!((normal.length() - 1.0).abs() <= 4.0 * U);
        assert!(planarity <= tolerance, "planarity {planarity:e} over {tolerance:e}");
        counts.inexact_faces += usize::from(planarity > 64.0 * U);
        let highest = hull.vertices().iter().map(|v| v.dot(normal)).fold(f64::NEG_INFINITY, f64::max);
        assert_eq!(highest, offset, "a vertex above the plane of face {face}");
    }
    for (v, point) in hull.vertices().iter().enumerate() {
        assert!(!hull.vertex_faces(v).is_empty());
        for &face in hull.vertex_faces(v) {
            let (normal, offset) = (hull.faces()[face as usize].normal, hull.faces()[face as usize].offset);
            assert!(normal.dot(*point) >= offset - hull.faces()[face as usize].planarity);
            let out = beyond_outline(hull, face as usize, *point);
            assert!(out <= 4.0 * tolerance, "vertex {v} is {out:e} beyond the outline of face {face}");
        }
    }
}

/// Outlines are strictly convex polygons, anticlockwise seen from outside.
fn check_outlines(hull: &ConvexHull) {
    for face in 0..hull.face_count() {
        let (outline, normal) = (hull.outline(face), hull.faces()[face].normal);
        assert!(outline.len() >= 3);
        let size = normal.abs().to_array();
        let axis = (0..3).fold(0, |best, i| if size[i] > size[best] { i } else { best });
        let flat = |v: u32| {
            let p = hull.vertices()[v as usize].to_array();
            Coord { x: p[(axis + 1) % 3], y: p[(axis + 2) % 3] }
        };
        for i in 0..outline.len() {
            let [a, b, c] = [0, 1, 2].map(|k| flat(outline[(i + k) % outline.len()]));
            let turn = robust::orient2d(a, b, c) * normal.to_array()[axis];
            assert!(turn > 0.0, "face {face} is not convex at {i}: {outline:?} {normal:?}");
            assert!(hull.vertex_faces(outline[i] as usize).contains(&(face as u32)));
        }
        check_area(hull, face);
    }
}

/// How far a point is outside the outline of a face, seen along the normal of the face; 0 if inside.
fn beyond_outline(hull: &ConvexHull, face: usize, point: DVec3) -> f64 {
    let (outline, normal) = (hull.outline(face), hull.faces()[face].normal);
    let sides = (0..outline.len()).map(|i| {
        let [from, to] =
            [i, (i + 1) % outline.len()].map(|k| hull.vertices()[outline[k] as usize].reject_from(normal));
        (point.reject_from(normal) - from, to - from)
    });
    if sides.clone().all(|(at, along)| along.cross(normal).dot(at) <= 0.0) {
        return 0.0;
    }
    let distance = |(at, along): (DVec3, DVec3)| {
        (at - along * (at.dot(along) / along.length_squared()).clamp(0.0, 1.0)).length()
    };
    sides.map(distance).fold(f64::INFINITY, f64::min)
}

/// The area of a face is that of its outline as seen along the normal, up to the planarity of the
/// face and the rounding of its corners. (For a needle that is thinner than the rounding of its
/// vertices, these two are as large as the face, and the outline may run either way about the exact
/// normal of the face.)
fn check_area(hull: &ConvexHull, face: usize) {
    let (outline, normal) = (hull.outline(face), hull.faces()[face].normal);
    let corners: Vec<DVec3> = outline.iter().map(|&v| hull.vertices()[v as usize]).collect();
    let sides = || corners.iter().zip(corners.iter().cycle().skip(1));
    let seen = 0.5 * sides().map(|(a, b)| (a - corners[0]).cross(b - corners[0]).dot(normal)).sum::<f64>();
    let around: f64 = sides().map(|(a, b)| a.distance(*b)).sum();
    let slack = around * (hull.faces()[face].planarity + 16.0 * U);
    let area = hull.faces()[face].area;
    assert!((area - seen).abs() <= slack && area >= 0.0, "area {area:e} of face {face}, seen {seen:e}");
}

/// Whether two faces fold back along an edge: they share another edge that lies within `slack` of a
/// part of this edge, or of which this edge lies within `slack` of a part. One side of such a fold
/// runs against the outlines.
fn folds_back(hull: &ConvexHull, edge: [u32; 2], faces: [u32; 2], slack: f64) -> bool {
    let lies_on = |part: [u32; 2], [from, to]: [u32; 2]| {
        let [from, to] = [from, to].map(|v| hull.vertices()[v as usize]);
        part.iter().all(|&v| {
            let (p, along) = (hull.vertices()[v as usize] - from, to - from);
            p.distance((p.dot(along) / along.length_squared()).clamp(0.0, 1.0) * along) <= slack
        })
    };
    let mut others = hull.edge_vertices().iter().zip(hull.edge_faces());
    others.any(|(&ends, &[f, g])| {
        let same_faces = [f, g] == faces || [g, f] == faces;
        ends != edge && same_faces && (lies_on(ends, edge) || lies_on(edge, ends))
    })
}

/// Edges are sorted, each is between two faces that contain both its ends, and the numbers of
/// corners, edges and faces satisfy Euler's formula.
fn check_edges(hull: &ConvexHull, counts: &mut CheckCounts) {
    assert!(hull.edge_vertices().windows(2).all(|w| w[0] < w[1]), "edges are repeated or not ascending");
    for (&[from, to], &[left, right]) in hull.edge_vertices().iter().zip(hull.edge_faces()) {
        assert!(from < to && left != right);
        for face in [left, right] {
            assert!([from, to].iter().all(|&v| hull.vertex_faces(v as usize).contains(&face)));
        }
        // If the outlines run along the edge, they run in the right direction.
        let runs = |face: u32, a: u32, b: u32| {
            let outline = hull.outline(face as usize);
            (0..outline.len()).any(|i| outline[i] == a && outline[(i + 1) % outline.len()] == b)
        };
        // (The outlines of faces that are nearly in one plane, or nearly on one line, may overlap and
        // have their corners in another order. The overlap is within the merge tolerance of any
        // face at the ends of the edge, or at vertices as near to the edge as its ends are to each
        // other.)
        let length = (hull.vertices()[to as usize] - hull.vertices()[from as usize]).length();
        let near = |v: &usize| hull.vertices()[*v].distance(hull.vertices()[from as usize]) <= 2.0 * length;
        let around = (0..hull.vertex_count()).filter(near).flat_map(|v| hull.vertex_faces(v));
        let planarity = around.map(|&face| hull.faces()[face as usize].planarity).fold(0.0, f64::max);
        let [n, m] = [left, right].map(|f| hull.faces()[f as usize].normal);
        let slack = 16.0 * planarity / hull.unit_inradius();
        if length * n.cross(m).length() > slack && !folds_back(hull, [from, to], [left, right], slack) {
            counts.ordered_edges += 1;
            assert!(
                !runs(left, to, from) && !runs(right, from, to),
                "the left and right faces of an edge are exchanged"
            );
        }
    }
    let corners = (0..hull.vertex_count()).filter(|&v| !hull.vertex_edges(v).is_empty()).count();
    counts.vertices_without_edges += hull.vertex_count() - corners;
    counts.merged_faces += 2 * hull.vertex_count() - 4 - hull.face_count();
    assert_eq!(corners + hull.face_count(), hull.edge_count() + 2, "Euler's formula of the faces");
}

/// The adjacency lists agree with the triangles, the edges and the faces.
fn check_adjacency(surface: &Triangulation, hull: &ConvexHull) {
    let registered = |v: u32| hull.registered_indices()[v as usize];
    let mut sides: BTreeSet<[u32; 2]> = BTreeSet::new();
    for v in 0..hull.vertex_count() as u32 {
        let row = hull.vertex_neighbours(v as usize);
        assert!(row.windows(2).all(|w| w[0] < w[1]));
        sides.extend(row.iter().map(|&w| [registered(v), registered(w)]));
        for &edge in hull.vertex_edges(v as usize) {
            assert!(hull.edge_vertices()[edge as usize].contains(&v));
        }
    }
    let expected: BTreeSet<[u32; 2]> =
        surface.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
    assert_eq!(sides, expected);
    let edges: usize = (0..hull.vertex_count()).map(|v| hull.vertex_edges(v).len()).sum();
    assert_eq!(edges, 2 * hull.edge_count());
    let mut across: BTreeSet<[u32; 2]> = BTreeSet::new();
    across.extend(hull.edge_faces().iter().flat_map(|&[f, g]| [[f, g], [g, f]]));
    let listed = |f: usize| hull.face_neighbours(f).iter().map(move |&g| [f as u32, g]);
    let listed: Vec<[u32; 2]> = (0..hull.face_count()).flat_map(listed).collect();
    assert!(listed.iter().eq(&across), "face neighbours");
}

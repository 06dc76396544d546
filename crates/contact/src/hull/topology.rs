//! Derives edges and outlines of the faces from groups of triangles.
//!
//! ```text
//! edges:    the boundaries between groups, straightened; if no triangles were merged,
//!           simply the sides of the triangles
//! corners:  for each face, the ends of its edges
//! outlines: for each face, the convex polygon of its corners, seen along its normal
//! ```
//!
//! An outline is not traced along the edges. The corners of a merged face are off its plane by up to
//! the tolerance, so the traced polygon could be slightly concave. Instead the corners are
//! projected on a coordinate plane, which is exact, and their convex hull is computed with exact
//! orientation tests (`monotone_chain`). So every outline is strictly convex. Outline and edges of a
//! face can then differ in a corner by the tolerance.
//!
//! All lists together take `O(n log n)` time for `n` triangles: edges and corners are sorted.

use std::cmp::Ordering;

use glam::DVec3;

use super::boundary::Boundary;
use super::edge::{Edge, sort_edges};
use super::merge::{Groups, Surface};
use super::triangulation::Triangulation;
use crate::csr::{Csr, LISTED};
use crate::exact::{orient2d, orient2d_steps};
use crate::monotone_chain::convex_polygon;
use crate::sort::{COMPARISON, sort};
use crate::stop::{Meter, Stopped};

/// Steps per side of a triangle, or per corner of an outline, besides orientation tests.
const CORNER: u64 = 10;

/// The edges and outlines of the faces.
pub(super) struct Topology {
    pub(super) edge_vertices: Vec<[u32; 2]>,
    pub(super) edge_faces: Vec<[u32; 2]>,
    pub(super) outlines: Csr,
    pub(super) face_areas: Vec<f64>,
    /// The largest distance of a vertex that was straightened away from the line of its edge; hull
    /// units.
    pub(super) straightened: f64,
}

/// Derives edges and outlines from the groups. Returns `None` if a face has no outline at double
/// precision, which happens for needles of an aspect beyond 1e13.
pub(super) fn topology(
    surface: &Surface<'_>,
    groups: &Groups,
    meter: &Meter<'_>,
) -> Result<Option<Topology>, Stopped> {
    meter.spend(LISTED * 3 * groups.of.len() as u64)?;
    let (edges, corners, straightened) = if groups.planes.len() == groups.of.len() {
        (triangles_edges(surface, groups, meter)?, triangles_corners(surface, groups), 0.0)
    } else {
        let (edges, straightened) = Boundary::new(surface, groups, meter).edges()?;
        let corners = Csr::from_pairs(
            groups.planes.len(),
            surface.vertices.len(),
            edges.iter().flat_map(|&([u, v], [f, g])| [(f, u), (f, v), (g, u), (g, v)]),
        );
        (edges, corners, straightened)
    };
    let mut sweep = Sweep::default();
    let mut outlines = Csr::with_capacity(groups.planes.len(), corners.items.len());
    for (face, plane) in groups.planes.iter().enumerate() {
        outlines.push_row(sweep.outline(surface.vertices, corners.row(face), plane.normal, meter)?);
    }
    if (0..groups.planes.len()).any(|face| outlines.row(face).len() < 3) {
        return Ok(None);
    }
    meter.spend(CORNER * outlines.items.len() as u64)?;
    // The area is the length of the vector area, not its component along the normal: if the outline
    // is thinner than the rounding of its vertices, the vector may point anywhere.
    let area = |face: usize| {
        let corner = |i: usize| surface.vertices[outlines.row(face)[i] as usize];
        let first = corner(0);
        let fan = |i| (corner(i) - first).cross(corner(i + 1) - first);
        0.5 * (1..outlines.row(face).len() - 1).map(fan).sum::<DVec3>().length()
    };
    let face_areas = (0..groups.planes.len()).map(area).collect();
    let (edge_vertices, edge_faces) = edges.into_iter().unzip();
    Ok(Some(Topology { edge_vertices, edge_faces, outlines, face_areas, straightened }))
}

/// The edges if every face is one triangle, as on rounded bodies: the sides of the triangles.
fn triangles_edges(surface: &Surface<'_>, groups: &Groups, meter: &Meter<'_>) -> Result<Vec<Edge>, Stopped> {
    meter.spend(CORNER * 3 * groups.of.len() as u64)?;
    let Triangulation { triangles, neighbours } = surface.triangulation;
    let mut edges = Vec::with_capacity(3 * triangles.len() / 2);
    for ((corners, across), &left) in triangles.iter().zip(neighbours).zip(&groups.of) {
        for side in 0..3 {
            let (from, to) = (corners[side], corners[(side + 1) % 3]);
            if from < to {
                edges.push(([from, to], [left, groups.of[across[side] as usize]]));
            }
        }
    }
    sort_edges(&mut edges, meter)?;
    Ok(edges)
}

/// The corners of each face if every face is one triangle.
fn triangles_corners(surface: &Surface<'_>, groups: &Groups) -> Csr {
    let corners = surface.triangulation.triangles.iter().zip(&groups.of);
    Csr::from_ordered_pairs(
        groups.planes.len(),
        corners.flat_map(|(corners, &face)| corners.map(|v| (face, v))),
    )
}

/// A corner projected on a coordinate plane, and its vertex.
type ProjectedVertex = ([f64; 2], u32);

/// Computes outlines. Keeps its buffers from one outline to the next.
#[derive(Default)]
struct Sweep {
    sorted: Vec<ProjectedVertex>,
    polygon: Vec<ProjectedVertex>,
    outline: Vec<u32>,
}

impl Sweep {
    /// The strictly convex polygon of `corners`, anticlockwise as seen against `normal`. It has fewer
    /// than three corners if the face is thinner than the rounding of its vertices.
    fn outline(
        &mut self,
        vertices: &[DVec3],
        corners: &[u32],
        normal: DVec3,
        meter: &Meter<'_>,
    ) -> Result<&[u32], Stopped> {
        // Dropping the coordinate in which the normal is largest keeps the other two exact.
        let size = normal.abs();
        let flat = |v: u32| {
            let p = vertices[v as usize];
            let (point, height) = if size.x >= size.y && size.x >= size.z {
                ([p.y, p.z], normal.x)
            } else if size.y >= size.z {
                ([p.z, p.x], normal.y)
            } else {
                ([p.x, p.y], normal.z)
            };
            if height > 0.0 { point } else { [point[1], point[0]] }
        };
        let Self { sorted, polygon, outline } = self;
        outline.clear();
        if let &[u, v, w] = corners {
            // For a triangle, the two chains are the triangle itself.
            let [a, b, c] = [u, v, w].map(|v| (flat(v), v));
            let first = |p: &ProjectedVertex, q: &ProjectedVertex| along(p, q).is_lt();
            let [a, b, c] = match (first(&a, &b), first(&b, &c), first(&c, &a)) {
                (true, _, false) => [a, b, c],
                (false, true, _) => [b, c, a],
                _ => [c, a, b],
            };
            let turn = orient2d(a.0, b.0, c.0);
            meter.spend(CORNER + orient2d_steps([a.0, b.0, c.0], turn))?;
            match turn {
                turn if turn > 0.0 => outline.extend([a.1, b.1, c.1]),
                turn if turn < 0.0 => outline.extend([a.1, c.1, b.1]),
                _ => {}
            }
            return Ok(outline);
        }
        meter.spend(CORNER * corners.len() as u64)?;
        sorted.clear();
        sorted.extend(corners.iter().map(|&v| (flat(v), v)));
        sort(sorted, meter, COMPARISON, along)?;
        sorted.dedup_by_key(|(p, _)| *p);
        convex_polygon(sorted, polygon, |corners| {
            let corners = corners.map(|&(p, _)| p);
            let turn = orient2d(corners[0], corners[1], corners[2]);
            meter.spend(CORNER + orient2d_steps(corners, turn))?;
            Ok(turn)
        })?;
        outline.extend(polygon.iter().map(|(_, v)| *v));
        Ok(outline)
    }
}

/// The order in which [`convex_polygon`] takes the corners.
fn along((p, v): &ProjectedVertex, (q, w): &ProjectedVertex) -> Ordering {
    p[0].total_cmp(&q[0]).then(p[1].total_cmp(&q[1])).then(v.cmp(w))
}

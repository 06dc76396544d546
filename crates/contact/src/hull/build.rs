//! Builds a hull from points: calls the steps of this module in order.

use glam::{DMat3, DVec3};

use super::error::plain;
use super::face::Face;
use super::isolation::{Isolation, isolation};
use super::mass::mass;
use super::merge::{Plane, Surface, groups};
use super::solid::{Centred, Solid};
use super::topology::topology;
use super::triangulation::Triangulation;
use super::{ABSENT_PLANARITY, BuildError, ConvexHull, HullError, HullErrorKind, HullOptions};
use super::{BoxRow, BoxShape};
use crate::csr::{Csr, LISTED};
use crate::exact::TriangleNormal;
use crate::stop::{Meter, Stopped};
use crate::support::{Columns, SupportMap};

pub(super) fn build(
    given: &[[f64; 3]],
    options: &HullOptions,
    meter: &Meter<'_>,
) -> Result<ConvexHull, BuildError> {
    let solid = Solid::new(given, meter)?;
    if solid.points.len() > options.max_vertices {
        return Err(too_many_vertices(solid.points.len(), options.max_vertices).into());
    }
    let (normals, areas) = solid.normals(meter)?;
    let mass = mass(&solid.scaled, &solid.triangulation.triangles, &areas, meter)?;
    // The factors are powers of two. They are applied one at a time, so that no intermediate
    // product leaves the range of doubles.
    let [length, area] = [solid.unit, solid.unit * solid.unit];
    let center_of_mass = mass.centre * length;
    let given_center = options.contraction_point.map(DVec3::from_array);
    let contraction_point = given_center.unwrap_or(center_of_mass) + 0.0;
    let refused = || given_center.map_or_else(not_representable, not_inside);
    let centred = solid.centred(contraction_point, &normals, meter)?.ok_or_else(refused)?;
    let planarity = options.planarity.unwrap_or(ABSENT_PLANARITY);
    let shell = Shell::new(&solid.triangulation, &centred, &normals, planarity, meter)?;
    let shell = shell.ok_or_else(not_representable)?;
    let largest_face = shell.outlines.longest_row() as u32;
    let mut hull = ConvexHull {
        outlines: shell.outlines,
        largest_face,
        face_neighbours: shell.face_neighbours,
        edge_vertices: shell.edge_vertices,
        edge_faces: shell.edge_faces,
        vertex_faces: shell.vertex_faces,
        vertex_edges: shell.vertex_edges,
        support_map: SupportMap::new(&centred.vertices, &shell.vertex_neighbours, meter)?,
        vertex_neighbours: shell.vertex_neighbours,
        box_shape: BoxShape::recognise(&centred.vertices, &shell.faces),
        box_row: None,
        merge_error: shell.merge_error,
        faces: shell.faces,
        columns: Columns::new(&centred.vertices),
        vertices: centred.vertices,
        registered: solid.registered,
        registered_count: given.len() as u32,
        deviation: 0.0,
        planarity,
        scale: centred.scale,
        contraction_point,
        contraction_distance: length_of(contraction_point),
        inradius: centred.inradius,
        circumradius: centred.circumradius,
        volume: mass.volume * area * length,
        center_of_mass,
        inertia: scaled(mass.inertia, area, length),
    };
    hull.box_row = BoxRow::of(&hull);
    Ok(hull)
}

/// The length of `v`, without overflow or underflow of the squares of its coordinates.
fn length_of(v: DVec3) -> f64 {
    let size = v.abs().max_element();
    if size > 0.0 { (v / size).length() * size } else { 0.0 }
}

/// Multiplies `inertia` by `length` to the fifth power; `area` is the square of `length`.
fn scaled(inertia: DMat3, area: f64, length: f64) -> DMat3 {
    inertia * length * area * area
}

fn too_many_vertices(count: usize, limit: usize) -> HullError {
    let detail = format!(
        "the hull has {count} extreme vertices, at most {limit} are allowed: simplify it by max_vertices \
         or max_deviation"
    );
    HullError { kind: HullErrorKind::TooManyVertices, index: None, detail }
}

fn not_inside(point: DVec3) -> HullError {
    let DVec3 { x, y, z } = point;
    let [x, y, z] = [x, y, z].map(plain);
    let detail = format!("({x}, {y}, {z}) is not inside the hull by more than rounding");
    HullError { kind: HullErrorKind::ContractionPointNotInside, index: None, detail }
}

fn not_representable() -> HullError {
    let detail = "the hull is too thin to have an inside, or faces, at double precision".to_owned();
    HullError { kind: HullErrorKind::NotRepresentable, index: None, detail }
}

/// Faces, edges and adjacency: the fields of [`ConvexHull`] that have the same names.
struct Shell {
    faces: Vec<Face>,
    outlines: Csr,
    face_neighbours: Csr,
    edge_vertices: Vec<[u32; 2]>,
    edge_faces: Vec<[u32; 2]>,
    vertex_faces: Csr,
    vertex_edges: Csr,
    vertex_neighbours: Csr,
    merge_error: f64,
}

impl Shell {
    /// Groups the triangles into faces and derives edges and adjacency. Returns `None` if a face
    /// has no outline at double precision.
    fn new(
        triangulation: &Triangulation,
        centred: &Centred,
        normals: &[TriangleNormal],
        planarity: f64,
        meter: &Meter<'_>,
    ) -> Result<Option<Self>, Stopped> {
        let Centred { vertices, circumradius, inradius, .. } = centred;
        let triangles = &triangulation.triangles;
        meter.spend(LISTED * 3 * triangles.len() as u64)?;
        let sides = triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
        let vertex_neighbours = Csr::from_pairs(vertices.len(), vertices.len(), sides);
        let surface = Surface {
            vertices,
            triangulation,
            normals,
            neighbours: &vertex_neighbours,
            circumradius: *circumradius,
            inradius: *inradius,
        };
        let groups = groups(&surface, planarity, meter)?;
        let Some(topology) = topology(&surface, &groups, meter)? else { return Ok(None) };
        let planes = &groups.planes;
        meter.spend(LISTED * 3 * triangles.len() as u64)?;
        let across = topology.edge_faces.iter().flat_map(|&[f, g]| [(f, g), (g, f)]);
        let ends = topology.edge_vertices.iter().zip(0..).flat_map(|(&[u, v], edge)| [(u, edge), (v, edge)]);
        let at_corners = triangles.iter().zip(&groups.of).flat_map(|(t, &group)| t.map(|v| (v, group)));
        let vertex_faces = Csr::from_pairs(vertices.len(), planes.len(), at_corners);
        let isolation = isolation(planes, &vertex_faces, meter)?;
        meter.spend(LISTED * 2 * topology.edge_faces.len() as u64)?;
        let face = |((plane, &area), isolation): ((&Plane, &f64), Isolation)| Face {
            normal: plane.normal,
            offset: plane.offset,
            area,
            planarity: plane.planarity,
            isolation,
        };
        let merge_error = planes.iter().map(|plane| plane.planarity).fold(topology.straightened, f64::max);
        let face_neighbours = Csr::from_pairs(planes.len(), planes.len(), across);
        meter.spend(LISTED * 2 * topology.edge_faces.len() as u64)?;
        Ok(Some(Self {
            merge_error,
            faces: planes.iter().zip(&topology.face_areas).zip(isolation).map(face).collect(),
            face_neighbours,
            vertex_edges: Csr::from_ordered_pairs(vertices.len(), ends),
            outlines: topology.outlines,
            edge_vertices: topology.edge_vertices,
            edge_faces: topology.edge_faces,
            vertex_faces,
            vertex_neighbours,
        }))
    }
}

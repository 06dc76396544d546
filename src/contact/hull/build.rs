//! From points to a hull: the steps in order.

use glam::{DMat3, DVec3};

use super::BoxShape;
use super::cloud::Cloud;
use super::csr::Csr;
use super::face::Face;
use super::isolation::{Isolation, isolation};
use super::mass::mass;
use super::merge::{Groups, Plane, Surface, groups};
use super::quickhull::{Triangulation, triangulate};
use super::topology::{Topology, topology};
use super::{ConvexHull, HullError, HullErrorKind, HullOptions};
use crate::contact::exact::{
    Dd3, ROUNDOFF, TriangleNormal, VectorArea, depth_below, exact_difference, exponent_above, normal_of,
    orient3d, power_of_two,
};
use crate::contact::support::{Coarse, Columns};

pub(super) fn build(given: &[[f64; 3]], options: &HullOptions) -> Result<ConvexHull, HullError> {
    let solid = Solid::new(given)?;
    if solid.points.len() > options.max_vertices {
        let detail =
            format!("{} extreme vertices, at most {} allowed", solid.points.len(), options.max_vertices);
        return Err(HullError { kind: HullErrorKind::TooManyVertices, index: None, detail });
    }
    let (normals, areas) = solid.normals();
    let mass = mass(&solid.scaled, &solid.triangulation.triangles, &areas);
    // Powers of two, one at a time: no product of them is out of range before the end.
    let [length, area] = [solid.unit, solid.unit * solid.unit];
    let center_of_mass = mass.center * length;
    let given_center = options.contraction_point.map(DVec3::from_array);
    let contraction_point = given_center.unwrap_or(center_of_mass) + 0.0;
    let Some(centred) = solid.centred(contraction_point, &normals) else {
        return Err(not_inside(given_center));
    };
    let triangulation = &solid.triangulation;
    let vertex_neighbours = Csr::from_pairs(
        centred.vertices.len(),
        centred.vertices.len(),
        triangulation.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]),
    );
    let surface = Surface {
        vertices: &centred.vertices,
        triangulation,
        normals: &normals,
        neighbours: &vertex_neighbours,
        circumradius: centred.circumradius,
        inradius: centred.inradius,
    };
    let groups = groups(&surface);
    let Some(topology) = topology(&surface, &groups) else { return Err(not_representable()) };
    let adjacency = Adjacency::new(triangulation, &groups, &topology, centred.vertices.len());
    let planes = &groups.planes;
    let isolation = isolation(planes, &adjacency.vertex_faces);
    let face = |((plane, area), isolation): ((&Plane, f64), Isolation)| Face {
        normal: plane.normal,
        offset: plane.offset,
        area,
        planarity: plane.planarity,
        isolation,
    };
    let faces: Vec<Face> = planes.iter().zip(topology.face_areas).zip(isolation).map(face).collect();
    Ok(ConvexHull {
        outlines: topology.outlines,
        face_neighbours: adjacency.face_neighbours,
        edge_vertices: topology.edge_vertices,
        edge_faces: topology.edge_faces,
        vertex_faces: adjacency.vertex_faces,
        vertex_edges: adjacency.vertex_edges,
        vertex_neighbours,
        box_shape: BoxShape::recognise(&centred.vertices, &faces),
        faces,
        columns: Columns::new(&centred.vertices),
        coarse: Coarse::new(&centred.vertices),
        vertices: centred.vertices,
        registered: solid.registered,
        registered_count: given.len() as u32,
        deviation: 0.0,
        scale: centred.scale,
        contraction_point,
        contraction_distance: length_of(contraction_point),
        inradius: centred.inradius,
        circumradius: centred.circumradius,
        volume: mass.volume * area * length,
        center_of_mass,
        inertia: scaled(mass.inertia, area, length),
    })
}

/// Whatever the size of the coordinates.
fn length_of(v: DVec3) -> f64 {
    let size = v.abs().max_element();
    if size > 0.0 { (v / size).length() * size } else { 0.0 }
}

/// Times a length to the fifth.
fn scaled(inertia: DMat3, area: f64, length: f64) -> DMat3 {
    inertia * length * area * area
}

fn not_inside(given: Option<DVec3>) -> HullError {
    let (kind, detail) = match given {
        Some(p) => (
            HullErrorKind::ContractionPointNotInside,
            format!("({:e}, {:e}, {:e}) is not inside by more than rounding", p.x, p.y, p.z),
        ),
        None => return not_representable(),
    };
    HullError { kind, index: None, detail }
}

fn not_representable() -> HullError {
    let detail = "the hull is too thin to have an inside, or faces, at double precision".to_owned();
    HullError { kind: HullErrorKind::NotRepresentable, index: None, detail }
}

/// The exact hull of the points, vertices in registered order.
pub(super) struct Solid {
    /// Caller's units.
    pub(super) points: Vec<DVec3>,
    pub(super) registered: Vec<u32>,
    pub(super) triangulation: Triangulation,
    /// Divided by `unit`.
    scaled: Vec<DVec3>,
    unit: f64,
}

/// Of the circumradius: about a contraction point no deeper inside alpha would be
/// known to a thousandth alone (`64 u R/r`), and ten times nearer the vertices'
/// roundings are as large as what keeps faces apart, a share of the inradius.
const THINNEST: f64 = 65536.0 * ROUNDOFF;

/// A hull about its contraction point, in hull units.
struct Centred {
    vertices: Vec<DVec3>,
    scale: f64,
    inradius: f64,
    circumradius: f64,
}

impl Solid {
    pub(super) fn new(given: &[[f64; 3]]) -> Result<Self, HullError> {
        let (cloud, mut triangulation) = triangulate(Cloud::new(given)?)?;
        let mut order: Vec<u32> = (0..cloud.points.len() as u32).collect();
        order.sort_unstable_by_key(|&i| cloud.registered[i as usize]);
        let mut place = vec![0; order.len()];
        order.iter().zip(0..).for_each(|(&old, new)| place[old as usize] = new);
        triangulation.triangles.iter_mut().flatten().for_each(|v| *v = place[*v as usize]);
        Ok(Self {
            points: order.iter().map(|&i| cloud.points[i as usize]).collect(),
            scaled: order.iter().map(|&i| cloud.scaled[i as usize]).collect(),
            registered: order.iter().map(|&i| cloud.registered[i as usize]).collect(),
            triangulation,
            unit: cloud.unit,
        })
    }

    fn corners(&self, t: usize) -> [DVec3; 3] {
        self.triangulation.triangles[t].map(|v| self.points[v as usize])
    }

    /// Of each triangle, and twice its vector area where the unit is `unit`.
    fn normals(&self) -> (Vec<TriangleNormal>, Vec<Dd3>) {
        // A power of two has its own exponent below the one above it.
        let unit = exponent_above(self.unit) - 1;
        let both = |t| {
            let [a, b, c] = self.corners(t);
            let area = VectorArea::new(a, b, c);
            (normal_of(&area, a, b, c), area.value(unit))
        };
        (0..self.triangulation.triangles.len()).map(both).unzip()
    }

    /// About `center`, which must be strictly inside by more than rounding.
    fn centred(&self, center: DVec3, normals: &[TriangleNormal]) -> Option<Centred> {
        let is_inside = |t: usize| {
            let [a, b, c] = self.corners(t);
            let below = a - center;
            // A unit normal is good to 4 roundoffs, difference and product to 4 more.
            normals[t].unit.dot(below) > 16.0 * ROUNDOFF * below.length() || orient3d(a, b, c, center) > 0.0
        };
        if !center.is_finite() || !(0..normals.len()).all(is_inside) {
            return None;
        }
        // Each difference is rounded once: what it loses moves the surface.
        let (mut radius, mut moved) = (0.0_f64, 0.0_f64);
        let mut vertices = Vec::with_capacity(self.points.len());
        for &point in &self.points {
            let [x, y, z] = exact_difference(point, center);
            let vertex = DVec3::new(x.hi, y.hi, z.hi);
            radius = radius.max(vertex.length());
            moved = moved.max(DVec3::new(x.lo, y.lo, z.lo).length());
            vertices.push(vertex);
        }
        let radius = radius * (1.0 + 8.0 * ROUNDOFF);
        let exponent = exponent_above(radius);
        let shrink = power_of_two(-exponent);
        vertices.iter_mut().for_each(|v| *v *= shrink);
        // What is left for the surface through the rounded vertices: it is nearer
        // by no more than these moved, and by what scaling underflows.
        let inradius = self.depth(center, normals, &vertices, shrink)
            - (1.0 + 8.0 * ROUNDOFF) * moved * shrink
            - f64::MIN_POSITIVE;
        let (scale, circumradius) = (power_of_two(exponent), radius * shrink);
        (inradius > THINNEST * circumradius).then_some(Centred { vertices, scale, inradius, circumradius })
    }
}

impl Solid {
    /// How far `center` is below the nearest plane, rounded down; hull units.
    fn depth(&self, center: DVec3, normals: &[TriangleNormal], vertices: &[DVec3], shrink: f64) -> f64 {
        // To the rounding of unit normal, vertex and product …
        const ERROR: f64 = 16.0 * ROUNDOFF;
        let depth = |t: usize| normals[t].unit.dot(vertices[self.triangulation.triangles[t][0] as usize]);
        let nearest = (0..normals.len()).map(depth).fold(f64::INFINITY, f64::min);
        // … and again more finely for the planes that may be the nearest.
        let refined = |t: usize| {
            let [a, b, c] = self.corners(t);
            depth_below(a, b, c, center).map_or(depth(t) - ERROR, |d| d * shrink)
        };
        let candidates = (0..normals.len()).filter(|&t| depth(t) <= nearest + 2.0 * ERROR);
        candidates.map(refined).fold(f64::INFINITY, f64::min)
    }
}

/// What is next to what.
struct Adjacency {
    face_neighbours: Csr,
    vertex_faces: Csr,
    vertex_edges: Csr,
}

impl Adjacency {
    fn new(triangulation: &Triangulation, groups: &Groups, topology: &Topology, vertices: usize) -> Self {
        let at_corners = |(corners, &group): (&[u32; 3], &u32)| corners.map(|v| (v, group));
        let ends = |([u, v], edge): (&[u32; 2], u32)| [(*u, edge), (*v, edge)];
        Self {
            face_neighbours: Csr::from_pairs(
                groups.planes.len(),
                groups.planes.len(),
                topology.edge_faces.iter().flat_map(|&[f, g]| [(f, g), (g, f)]),
            ),
            vertex_faces: Csr::from_pairs(
                vertices,
                groups.planes.len(),
                triangulation.triangles.iter().zip(&groups.of).flat_map(at_corners),
            ),
            vertex_edges: Csr::from_ordered_pairs(
                vertices,
                topology.edge_vertices.iter().zip(0..).flat_map(ends),
            ),
        }
    }
}

//! The exact hull of a cloud, and the same about its contraction point.

use glam::DVec3;

use super::HullError;
use super::cloud::Cloud;
use super::quickhull::{Triangulation, triangulate};
use crate::contact::exact::{
    Dd3, TriangleNormal, VectorArea, depth_below, exact_difference, exponent_above, normal_of, orient3d,
    power_of_two,
};
use crate::contact::tolerance::U;

/// Of the circumradius: about a contraction point no deeper inside alpha would be
/// known to a thousandth alone (`64 u R/r`), and ten times nearer the vertices'
/// roundings are as large as what keeps faces apart, a share of the inradius.
const THINNEST: f64 = 65536.0 * U;

/// The exact hull of the points, vertices in registered order.
pub(super) struct Solid {
    /// Caller's units.
    pub(super) points: Vec<DVec3>,
    pub(super) registered: Vec<u32>,
    pub(super) triangulation: Triangulation,
    /// Divided by `unit`.
    pub(super) scaled: Vec<DVec3>,
    pub(super) unit: f64,
}

/// A hull about its contraction point, in hull units.
pub(super) struct Centred {
    pub(super) vertices: Vec<DVec3>,
    pub(super) scale: f64,
    pub(super) inradius: f64,
    pub(super) circumradius: f64,
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
    pub(super) fn normals(&self) -> (Vec<TriangleNormal>, Vec<Dd3>) {
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
    pub(super) fn centred(&self, center: DVec3, normals: &[TriangleNormal]) -> Option<Centred> {
        let is_inside = |t: usize| {
            let [a, b, c] = self.corners(t);
            let below = a - center;
            // A unit normal is good to 4 roundoffs, difference and product to 4 more.
            normals[t].unit.dot(below) > 16.0 * U * below.length() || orient3d(a, b, c, center) > 0.0
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
        let radius = radius * (1.0 + 8.0 * U);
        let exponent = exponent_above(radius);
        let shrink = power_of_two(-exponent);
        for v in &mut vertices {
            *v *= shrink;
        }
        // What is left for the surface through the rounded vertices: it is nearer
        // by no more than these moved, and by what scaling underflows.
        let inradius = self.depth(center, normals, &vertices, shrink)
            - (1.0 + 8.0 * U) * moved * shrink
            - f64::MIN_POSITIVE;
        let (scale, circumradius) = (power_of_two(exponent), radius * shrink);
        (inradius > THINNEST * circumradius).then_some(Centred { vertices, scale, inradius, circumradius })
    }

    /// How far `center` is below the nearest plane, rounded down; hull units.
    fn depth(&self, center: DVec3, normals: &[TriangleNormal], vertices: &[DVec3], shrink: f64) -> f64 {
        // To the rounding of unit normal, vertex and product …
        const ERROR: f64 = 16.0 * U;
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

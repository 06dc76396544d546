//! The exact hull of a cloud, and its move to the contraction point.
//!
//! [`Solid`] is exact: its vertices are given points, and its triangles are decided by exact
//! predicates. [`Centred`] is that hull in hull units. Each vertex is the difference of a point
//! and the contraction point, rounded once, and divided by a power of two, which rounds nothing
//! but subnormal numbers.
//!
//! The two radii are certified. The circumradius is the largest distance of a vertex, rounded up. The
//! inradius is the smallest depth of the contraction point below the exact planes of the triangles,
//! less the distance by which rounding moved a vertex, rounded down. Both take linear time: depths
//! are computed in double precision first, and with higher precision only for the planes that may be
//! the nearest.

use glam::DVec3;

use super::BuildError;
use super::cloud::Cloud;
use super::quickhull::triangulate;

use super::triangulation::Triangulation;
use crate::exact::{
    Dd3, TriangleNormal, VectorArea, counted_orient3d, depth_below, exact_difference, exponent_above,
    normal_of, power_of_two,
};
use crate::sort::{COMPARISON, sort};
use crate::stop::{Meter, Stopped};
use crate::tolerance::{LENGTH_ABOVE, PLANE_HEIGHT, THINNEST, TWO_INRADII};

/// Steps to move a vertex or a triangle from one list to another.
const MOVE: u64 = 12;
/// Steps to compute the normal or the depth of a triangle in double-double numbers.
const NORMAL: u64 = 100;

/// The exact hull of a cloud, with its vertices in registered order.
pub(super) struct Solid {
    /// The extreme vertices; hull frame, caller's units.
    pub(super) points: Vec<DVec3>,
    /// For each vertex, its index among the given points; ascending.
    pub(super) registered: Vec<u32>,
    pub(super) triangulation: Triangulation,
    /// The vertices divided by `unit`.
    pub(super) scaled: Vec<DVec3>,
    /// A power of two; see `Cloud::unit`.
    pub(super) unit: f64,
}

/// The vertices and radii of a hull about its contraction point, in hull units.
pub(super) struct Centred {
    pub(super) vertices: Vec<DVec3>,
    /// A power of two: caller's units per hull unit.
    pub(super) scale: f64,
    pub(super) inradius: f64,
    pub(super) circumradius: f64,
}

impl Solid {
    pub(super) fn new(given: &[[f64; 3]], meter: &Meter<'_>) -> Result<Self, BuildError> {
        let (cloud, mut triangulation) = triangulate(Cloud::new(given, meter)?, meter)?;
        let mut order: Vec<u32> = (0..cloud.points.len() as u32).collect();
        sort(&mut order, meter, COMPARISON, |&i, &j| {
            cloud.registered[i as usize].cmp(&cloud.registered[j as usize])
        })?;
        let mut place = vec![0; order.len()];
        order.iter().zip(0..).for_each(|(&old, new)| place[old as usize] = new);
        for triangle in &mut triangulation.triangles {
            meter.spend(MOVE)?;
            triangle.iter_mut().for_each(|v| *v = place[*v as usize]);
        }
        let cloud = cloud.subset(&order, meter)?;
        let Cloud { points, scaled, registered, unit, .. } = cloud;
        Ok(Self { points, scaled, registered, triangulation, unit })
    }

    fn corners(&self, t: usize) -> [DVec3; 3] {
        self.triangulation.triangles[t].map(|v| self.points[v as usize])
    }

    /// For each triangle, its normal, and its doubled vector area in units of `unit` squared.
    pub(super) fn normals(&self, meter: &Meter<'_>) -> Result<(Vec<TriangleNormal>, Vec<Dd3>), Stopped> {
        // For a power of two, `exponent_above` is one more than its exponent.
        let unit = exponent_above(self.unit) - 1;
        let count = self.triangulation.triangles.len();
        let (mut normals, mut areas) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for t in 0..count {
            let [a, b, c] = self.corners(t);
            let area = VectorArea::new(a, b, c);
            meter.spend(NORMAL + area.normal_steps())?;
            normals.push(normal_of(&area, a, b, c));
            areas.push(area.value(unit));
        }
        Ok((normals, areas))
    }

    /// Moves the hull to the contraction point `centre`. Returns `None` unless `centre` is strictly
    /// inside by more than rounding: the inradius must exceed [`THINNEST`] of the circumradius.
    pub(super) fn centred(
        &self,
        centre: DVec3,
        normals: &[TriangleNormal],
        meter: &Meter<'_>,
    ) -> Result<Option<Centred>, Stopped> {
        let centred = self.about(centre, normals, meter)?;
        Ok(centred.filter(|c| c.inradius > THINNEST * c.circumradius))
    }

    /// Whether [`Solid::centred`] can succeed for this solid, or for a solid of fewer of its
    /// vertices that has the same farthest vertex from `centre`.
    ///
    /// The distance between the surface and `centre` does not grow when vertices are left out, and
    /// an inradius is that distance to a few dozen roundoffs. So an inradius that is too small by
    /// more than [`TWO_INRADII`] is also too small with fewer vertices.
    pub(super) fn may_surround(
        &self,
        centre: DVec3,
        normals: &[TriangleNormal],
        meter: &Meter<'_>,
    ) -> Result<bool, Stopped> {
        let centred = self.about(centre, normals, meter)?;
        Ok(centred.is_some_and(|c| c.inradius + TWO_INRADII > THINNEST * c.circumradius))
    }

    /// Moves the hull to the contraction point `centre`. Returns `None` unless `centre` is finite and
    /// strictly inside. The inradius can be negative if rounding moved a vertex too far.
    fn about(
        &self,
        centre: DVec3,
        normals: &[TriangleNormal],
        meter: &Meter<'_>,
    ) -> Result<Option<Centred>, Stopped> {
        if !centre.is_finite() || !self.surrounds(centre, normals, meter)? {
            return Ok(None);
        }
        // Each vertex is rounded once. The part that is lost moves the surface.
        let (mut radius, mut moved) = (0.0_f64, 0.0_f64);
        let mut vertices = Vec::with_capacity(self.points.len());
        for &point in &self.points {
            meter.spend(MOVE)?;
            let [x, y, z] = exact_difference(point, centre);
            let vertex = DVec3::new(x.hi, y.hi, z.hi);
            radius = radius.max(vertex.length());
            moved = moved.max(DVec3::new(x.lo, y.lo, z.lo).length());
            vertices.push(vertex);
        }
        let radius = radius * LENGTH_ABOVE;
        let exponent = exponent_above(radius);
        let shrink = power_of_two(-exponent);
        for v in &mut vertices {
            *v *= shrink;
        }
        // The surface through the rounded vertices is nearer than the exact surface by at most the
        // largest move of a vertex, and by the underflow of scaling.
        let inradius = self.depth(centre, normals, &vertices, shrink, meter)?
            - LENGTH_ABOVE * moved * shrink
            - f64::MIN_POSITIVE;
        let (scale, circumradius) = (power_of_two(exponent), radius * shrink);
        Ok(Some(Centred { vertices, scale, inradius, circumradius }))
    }

    /// Whether `centre` is strictly inside the hull, decided exactly.
    fn surrounds(
        &self,
        centre: DVec3,
        normals: &[TriangleNormal],
        meter: &Meter<'_>,
    ) -> Result<bool, Stopped> {
        for (t, normal) in normals.iter().enumerate() {
            meter.spend(MOVE)?;
            let [a, b, c] = self.corners(t);
            let below = a - centre;
            if normal.unit.dot(below) > PLANE_HEIGHT * below.length() {
                continue;
            }
            if !(counted_orient3d([a, b, c, centre], f64::INFINITY, meter) > 0.0) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// How far `centre` is below the nearest plane of a triangle, rounded down; hull units.
    fn depth(
        &self,
        centre: DVec3,
        normals: &[TriangleNormal],
        vertices: &[DVec3],
        shrink: f64,
        meter: &Meter<'_>,
    ) -> Result<f64, Stopped> {
        let depth = |t: usize| normals[t].unit.dot(vertices[self.triangulation.triangles[t][0] as usize]);
        let mut nearest = f64::INFINITY;
        for t in 0..normals.len() {
            meter.spend(MOVE)?;
            nearest = nearest.min(depth(t));
        }
        // Compute the depth again with higher precision for the planes that may be the nearest.
        let mut refined = f64::INFINITY;
        for t in (0..normals.len()).filter(|&t| depth(t) <= nearest + 2.0 * PLANE_HEIGHT) {
            meter.spend(NORMAL)?;
            let [a, b, c] = self.corners(t);
            refined =
                refined.min(depth_below(a, b, c, centre).map_or(depth(t) - PLANE_HEIGHT, |d| d * shrink));
        }
        Ok(refined)
    }
}

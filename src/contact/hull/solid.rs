//! The exact hull of a cloud, and the same about its contraction point.

use glam::DVec3;

use super::BuildError;
use super::cloud::Cloud;
use super::quickhull::triangulate;

use super::triangulation::Triangulation;
use crate::contact::exact::{
    Dd3, TriangleNormal, VectorArea, counted_orient3d, depth_below, exact_difference, exponent_above,
    normal_of, power_of_two,
};
use crate::contact::sort::{COMPARISON, sort};
use crate::contact::stop::{Meter, Stopped};
use crate::contact::tolerance::U;

/// Steps of moving a vertex or a triangle from one list to another.
const MOVE: u64 = 12;
/// Steps of a triangle's normal or depth in double-double numbers.
const NORMAL: u64 = 100;

/// Of the circumradius: about a contraction point no deeper inside alpha would be
/// known to a thousandth alone (`64 u R/r`), and ten times nearer the vertices'
/// roundings are as large as what keeps faces apart, a share of the inradius.
const THINNEST: f64 = 65536.0 * U;

/// Hull units: more than the rounding of two inradii.
const SURELY: f64 = 256.0 * U;

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

    /// Of each triangle, and twice its vector area where the unit is `unit`.
    pub(super) fn normals(&self, meter: &Meter<'_>) -> Result<(Vec<TriangleNormal>, Vec<Dd3>), Stopped> {
        // A power of two has its own exponent below the one above it.
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

    /// About `center`, which must be strictly inside by more than rounding.
    pub(super) fn centred(
        &self,
        center: DVec3,
        normals: &[TriangleNormal],
        meter: &Meter<'_>,
    ) -> Result<Option<Centred>, Stopped> {
        let centred = self.about(center, normals, meter)?;
        Ok(centred.filter(|c| c.inradius > THINNEST * c.circumradius))
    }

    /// Whether [`Solid::centred`] may succeed for this solid, or for one of fewer of its vertices
    /// of which the farthest from `center` is the same.
    ///
    /// The true distance of the surface from `center` does not grow when vertices are left out,
    /// and an inradius is that distance to a few dozen roundoffs. So an inradius that is too
    /// small by more than [`SURELY`] is too small with fewer vertices, too.
    pub(super) fn may_surround(
        &self,
        center: DVec3,
        normals: &[TriangleNormal],
        meter: &Meter<'_>,
    ) -> Result<bool, Stopped> {
        let centred = self.about(center, normals, meter)?;
        Ok(centred.is_some_and(|c| c.inradius + SURELY > THINNEST * c.circumradius))
    }

    /// About `center`, which must be strictly inside.
    fn about(
        &self,
        center: DVec3,
        normals: &[TriangleNormal],
        meter: &Meter<'_>,
    ) -> Result<Option<Centred>, Stopped> {
        if !center.is_finite() || !self.surrounds(center, normals, meter)? {
            return Ok(None);
        }
        // Each difference is rounded once: what it loses moves the surface.
        let (mut radius, mut moved) = (0.0_f64, 0.0_f64);
        let mut vertices = Vec::with_capacity(self.points.len());
        for &point in &self.points {
            meter.spend(MOVE)?;
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
        let inradius = self.depth(center, normals, &vertices, shrink, meter)?
            - (1.0 + 8.0 * U) * moved * shrink
            - f64::MIN_POSITIVE;
        let (scale, circumradius) = (power_of_two(exponent), radius * shrink);
        Ok(Some(Centred { vertices, scale, inradius, circumradius }))
    }

    /// Whether `center` is strictly inside, exactly.
    fn surrounds(
        &self,
        center: DVec3,
        normals: &[TriangleNormal],
        meter: &Meter<'_>,
    ) -> Result<bool, Stopped> {
        for (t, normal) in normals.iter().enumerate() {
            meter.spend(MOVE)?;
            let [a, b, c] = self.corners(t);
            let below = a - center;
            // A unit normal is good to 4 roundoffs, difference and product to 4 more.
            if normal.unit.dot(below) > 16.0 * U * below.length() {
                continue;
            }
            if !(counted_orient3d([a, b, c, center], f64::INFINITY, meter) > 0.0) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// How far `center` is below the nearest plane, rounded down; hull units.
    fn depth(
        &self,
        center: DVec3,
        normals: &[TriangleNormal],
        vertices: &[DVec3],
        shrink: f64,
        meter: &Meter<'_>,
    ) -> Result<f64, Stopped> {
        // To the rounding of unit normal, vertex and product …
        const ERROR: f64 = 16.0 * U;
        let depth = |t: usize| normals[t].unit.dot(vertices[self.triangulation.triangles[t][0] as usize]);
        let mut nearest = f64::INFINITY;
        for t in 0..normals.len() {
            meter.spend(MOVE)?;
            nearest = nearest.min(depth(t));
        }
        // … and again more finely for the planes that may be the nearest.
        let mut refined = f64::INFINITY;
        for t in (0..normals.len()).filter(|&t| depth(t) <= nearest + 2.0 * ERROR) {
            meter.spend(NORMAL)?;
            let [a, b, c] = self.corners(t);
            refined = refined.min(depth_below(a, b, c, center).map_or(depth(t) - ERROR, |d| d * shrink));
        }
        Ok(refined)
    }
}

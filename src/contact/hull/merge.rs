//! Triangles into faces.
//!
//! Exactly coplanar triangles are not enough: a box turned in space has
//! rounded corners in no common plane. So a face is a connected group of
//! triangles whose vertices lie within a tolerance of one plane. No vertex moves.

use std::ops::Range;

use glam::DVec3;

use super::csr::Csr;

use super::triangulation::Triangulation;
use crate::contact::exact::{Dd, TriangleNormal};
use crate::contact::sort::{COMPARISON, sort};
use crate::contact::stop::{Meter, Stopped};
use crate::contact::tolerance::U;

/// Steps of one triangle of a group that is gathered, fitted or moved.
const TRIANGLE: u64 = 20;
/// Steps of the height of one vertex along a normal.
const HEIGHT: u64 = 3;

/// Whatever planarity is asked for, vertices of a face lie within this share of the inradius
/// of its plane, so that the two sides of a thin plate, or its sides and its rim, never become
/// one face.
const PLANARITY_PER_INRADIUS: f64 = 1.0 / 64.0;
/// The tolerance is at least this, hull units: the rounding of the vertices, which remains
/// where a planarity of 0 is asked for or the contraction point is very near a face.
const LEAST_PLANARITY: f64 = 64.0 * U;
/// Vertices whose heights differ by less may be as high as each other; hull units.
const PLATEAU: f64 = 64.0 * U;
/// How often a group that fits no plane is gathered anew with a quarter of the
/// tolerance before its largest triangle becomes a face by itself.
const ATTEMPTS: usize = 6;
/// Not a group.
const NONE: u32 = u32::MAX;

/// A triangulated hull in hull units.
pub(super) struct Surface<'a> {
    pub(super) vertices: &'a [DVec3],
    pub(super) triangulation: &'a Triangulation,
    /// Per triangle.
    pub(super) normals: &'a [TriangleNormal],
    /// Per vertex, along the triangulation.
    pub(super) neighbours: &'a Csr,
    pub(super) circumradius: f64,
    pub(super) inradius: f64,
}

/// A face's plane: every vertex `v` of the hull has `normal . v <= offset`, and
/// the face's own have at least `offset - planarity`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub(super) normal: DVec3,
    pub(super) offset: f64,
    /// Rounded up.
    pub(super) planarity: f64,
    /// How much lower than all of the face's own vertices every other one lies, by convexity
    /// a neighbour of one of them.
    pub(super) gap: f64,
}

/// Faces, largest triangle first.
pub(super) struct Groups {
    /// Per triangle its face.
    pub(super) of: Vec<u32>,
    pub(super) planes: Vec<Plane>,
    /// How far vertices of a face may be from its plane; hull units.
    pub(super) tolerance: f64,
}

/// Groups the triangles, each group around its largest. The planarity is a share of the
/// circumradius.
pub(super) fn groups(surface: &Surface<'_>, planarity: f64, meter: &Meter<'_>) -> Result<Groups, Stopped> {
    let tolerance = (planarity * surface.circumradius)
        .min(PLANARITY_PER_INRADIUS * surface.inradius)
        .max(LEAST_PLANARITY);
    let mut merger = Merger::new(surface, tolerance, meter);
    // Sizes are not negative, so that their bits are in the same order.
    let size = |normal: &TriangleNormal| normal.double_area.to_bits();
    let mut order: Vec<(u64, u32)> = surface.normals.iter().map(size).zip(0..).collect();
    sort(&mut order, meter, COMPARISON, |(size, t), (other, u)| other.cmp(size).then(t.cmp(u)))?;
    for (_, seed) in order {
        if merger.of[seed as usize] == NONE {
            merger.gather(seed)?;
        }
    }
    merger.absorb_thin_groups()?;
    let Merger { of, planes, .. } = merger;
    Ok(Groups { of, planes, tolerance })
}

struct Merger<'a> {
    surface: &'a Surface<'a>,
    tolerance: f64,
    of: Vec<u32>,
    planes: Vec<Plane>,
    /// Per group its triangles: a range of `members`.
    ranges: Vec<Range<usize>>,
    members: Vec<u32>,
    /// Per triangle and per vertex: the last search that met it.
    triangle_met: Vec<u32>,
    vertex_met: Vec<u32>,
    searches: u32,
    queue: Vec<u32>,
    meter: &'a Meter<'a>,
}

impl<'a> Merger<'a> {
    fn new(surface: &'a Surface<'a>, tolerance: f64, meter: &'a Meter<'a>) -> Self {
        let triangles = surface.normals.len();
        Self {
            surface,
            tolerance,
            of: vec![NONE; triangles],
            planes: Vec::with_capacity(triangles),
            ranges: Vec::with_capacity(triangles),
            members: Vec::with_capacity(triangles),
            triangle_met: vec![0; triangles],
            vertex_met: vec![0; surface.vertices.len()],
            searches: 0,
            queue: Vec::with_capacity(16),
            meter,
        }
    }

    /// Makes a face around `seed`.
    fn gather(&mut self, seed: u32) -> Result<(), Stopped> {
        // Half the tolerance, as the fitted plane is not quite the seed's.
        let mut reach = 0.5 * self.tolerance;
        let mut members = std::mem::take(&mut self.members);
        let start = members.len();
        let mut attempts = 0;
        let plane = loop {
            members.truncate(start);
            members.push(seed);
            if attempts < ATTEMPTS {
                self.flood(&mut members, start, reach)?;
            }
            let plane = self.fit(&members[start..])?;
            if members.len() == start + 1 || plane.planarity <= self.tolerance {
                break plane;
            }
            attempts += 1;
            reach *= 0.25;
        };
        let group = self.planes.len() as u32;
        members[start..].iter().for_each(|&t| self.of[t as usize] = group);
        self.planes.push(plane);
        self.ranges.push(start..members.len());
        self.members = members;
        Ok(())
    }

    /// Adds the free triangles connected to the seed, `members[start]`, whose vertices
    /// are within `reach` of its plane. Those turned away from it must be thin.
    fn flood(&mut self, members: &mut Vec<u32>, start: usize, reach: f64) -> Result<(), Stopped> {
        let seed = members[start];
        let normal = self.surface.normals[seed as usize].unit;
        let floor = self.lowest(&[seed], normal) - reach;
        self.searches += 1;
        self.triangle_met[seed as usize] = self.searches;
        let mut done = start;
        while done < members.len() {
            self.meter.spend(2 * TRIANGLE)?;
            for t in self.surface.triangulation.neighbours[members[done] as usize] {
                let known = std::mem::replace(&mut self.triangle_met[t as usize], self.searches);
                if known != self.searches
                    && self.of[t as usize] == NONE
                    && self.lowest(&[t], normal) >= floor
                    && (self.surface.normals[t as usize].unit.dot(normal) > 0.0 || self.is_thin(t))
                {
                    members.push(t);
                }
            }
            done += 1;
        }
        Ok(())
    }

    /// Smallest `normal . v` over the triangles' vertices.
    fn lowest(&self, triangles: &[u32], normal: DVec3) -> f64 {
        let corners = triangles.iter().flat_map(|&t| self.surface.triangulation.triangles[t as usize]);
        corners.map(|v| normal.dot(self.surface.vertices[v as usize])).fold(f64::INFINITY, f64::min)
    }

    /// The plane whose normal is the triangles' mean, weighted by area, so that
    /// slivers weigh nothing, and which no vertex of the hull is above.
    fn fit(&mut self, triangles: &[u32]) -> Result<Plane, Stopped> {
        let normals = self.surface.normals;
        let normal = if let [alone] = triangles {
            normals[*alone as usize].unit
        } else {
            // Relative to the first, the largest, so that nothing underflows, and
            // in double-double: thousands of equal roundings tilt a plane.
            let first = normals[triangles[0] as usize];
            let mut sum = [Dd::default(); 3];
            for &t in triangles {
                self.meter.spend(TRIANGLE)?;
                let TriangleNormal { unit, double_area } = normals[t as usize];
                let weighted = (unit * (double_area / first.double_area)).to_array();
                sum.iter_mut().zip(weighted).for_each(|(s, w)| *s = *s + w);
            }
            DVec3::from_array(sum.map(Dd::value)).normalize_or(first.unit)
        };
        self.plane(triangles, normal)
    }

    fn plane(&mut self, triangles: &[u32], normal: DVec3) -> Result<Plane, Stopped> {
        let Self { surface, vertex_met, searches, queue, meter, .. } = self;
        let height = |v: u32| normal.dot(surface.vertices[v as usize]);
        *searches += 1;
        queue.clear();
        let (mut lowest, mut highest) = (f64::INFINITY, f64::NEG_INFINITY);
        for v in triangles.iter().flat_map(|&t| surface.triangulation.triangles[t as usize]) {
            meter.spend(HEIGHT)?;
            if std::mem::replace(&mut vertex_met[v as usize], *searches) != *searches {
                lowest = lowest.min(height(v));
                highest = highest.max(height(v));
                queue.push(v);
            }
        }
        let mut others = f64::NEG_INFINITY;
        for &v in queue.iter() {
            meter.spend(HEIGHT * surface.neighbours.row(v as usize).len() as u64)?;
            for &w in surface.neighbours.row(v as usize) {
                // Selected without branches, because the branch would be unpredictable.
                let own = vertex_met[w as usize] == *searches;
                let height = if own { f64::NEG_INFINITY } else { height(w) };
                others = if height > others { height } else { others };
            }
        }
        let offset = if others >= highest - PLATEAU { self.climb(normal, highest)? } else { highest };
        // Both ends carry a dot product's rounding, at lengths below 1.
        let planarity = (offset - lowest) + 8.0 * U;
        Ok(Plane { normal, offset, planarity, gap: offset - planarity - others })
    }

    /// Largest `normal . v` over all vertices: climbs from those in the queue, the highest of
    /// them at `best`, through neighbours as high as the highest so far to rounding, so that a
    /// plateau or a dent of rounding does not end the climb.
    fn climb(&mut self, normal: DVec3, mut best: f64) -> Result<f64, Stopped> {
        while let Some(v) = self.queue.pop() {
            self.meter.spend(HEIGHT * self.surface.neighbours.row(v as usize).len() as u64)?;
            for &w in self.surface.neighbours.row(v as usize) {
                if std::mem::replace(&mut self.vertex_met[w as usize], self.searches) != self.searches {
                    let height = normal.dot(self.surface.vertices[w as usize]);
                    if height >= best - PLATEAU {
                        best = best.max(height);
                        self.queue.push(w);
                    }
                }
            }
        }
        Ok(best)
    }

    /// Whether a triangle's smallest height is below the tolerance. (Of one whose
    /// corners are one point about the contraction point all is 0.)
    fn is_thin(&self, t: u32) -> bool {
        let [a, b, c] =
            self.surface.triangulation.triangles[t as usize].map(|v| self.surface.vertices[v as usize]);
        let [ab, bc, ca] = [b - a, c - b, a - c];
        let longest = ab.length_squared().max(bc.length_squared()).max(ca.length_squared()).sqrt();
        // These are the centred vertices, which have the same unit as the tolerance.
        ab.cross(ca).length() <= self.tolerance * longest
    }

    /// Groups that consist of thin triangles join a neighbour whose plane they fit:
    /// a sliver is no face.
    fn absorb_thin_groups(&mut self) -> Result<(), Stopped> {
        for group in (0..self.planes.len()).rev() {
            self.meter.spend(TRIANGLE * self.members_of(group).len() as u64)?;
            if !self.members_of(group).iter().all(|&t| self.is_thin(t)) {
                continue;
            }
            let Some(host) = self.host(group) else { continue };
            let moved = std::mem::take(&mut self.ranges[group]);
            let mut members = std::mem::take(&mut self.members);
            members[moved.clone()].iter().for_each(|&t| self.of[t as usize] = host);
            let host = host as usize;
            let start = members.len();
            members.extend_from_within(self.ranges[host].clone());
            members.extend_from_within(moved);
            self.planes[host] = self.plane(&members[start..], self.planes[host].normal)?;
            self.ranges[host] = start..members.len();
            self.members = members;
        }
        self.drop_empty_groups();
        Ok(())
    }

    fn members_of(&self, group: usize) -> &[u32] {
        &self.members[self.ranges[group].clone()]
    }

    /// The first neighbour of `group` in whose plane it lies.
    fn host(&self, group: usize) -> Option<u32> {
        let members = self.members_of(group);
        let across = members.iter().flat_map(|&t| self.surface.triangulation.neighbours[t as usize]);
        let mut hosts: Vec<u32> =
            across.map(|t| self.of[t as usize]).filter(|&g| g as usize != group).collect();
        hosts.sort_unstable();
        hosts.dedup();
        hosts.into_iter().find(|&g| {
            let Plane { normal, offset, .. } = self.planes[g as usize];
            offset - self.lowest(members, normal) <= self.tolerance
        })
    }

    fn drop_empty_groups(&mut self) {
        let mut place = Vec::with_capacity(self.planes.len());
        let mut kept = 0;
        for range in &self.ranges {
            place.push(kept);
            kept += u32::from(!range.is_empty());
        }
        let mut ranges = self.ranges.iter();
        self.planes.retain(|_| ranges.next().is_some_and(|range| !range.is_empty()));
        self.of.iter_mut().for_each(|g| *g = place[*g as usize]);
    }
}

//! Merges triangles into faces.
//!
//! Merging triangles that are exactly coplanar is not enough: a box that is turned in space has
//! rounded corners, of which no four are in one plane. (A box with a grid of 30 cells per edge
//! has 221 exact facets after a rotation.) So a face is a connected group of triangles whose
//! vertices lie within a tolerance of one plane. Groups grow around the largest triangles:
//!
//! ```text
//! for each triangle, the largest first, that is in no group yet (the seed):
//!     reach = tolerance / 2
//!     repeat:
//!         group = the free triangles connected to the seed, all of whose vertices are at most
//!                 `reach` below the seed's plane (a flood over neighbours)
//!         plane = the mean normal of the group, weighted by area; its offset is the largest
//!                 height over all vertices of the hull
//!         accept the group if its lowest vertex is at most `tolerance` below the plane;
//!         otherwise reach = reach / 4, and after some attempts group = the seed only
//! for each group that consists of slivers only, the smallest first:
//!     join it to a neighbour whose plane it fits
//! ```
//!
//! The flood measures all heights from the plane of the seed, not from neighbour to neighbour.
//! So a finely triangulated sphere does not become one face. Large triangles come first and slivers
//! have almost no weight in the mean, because the plane of a sliver says little about the shape.
//!
//! No vertex moves, and every extreme vertex stays in the support mapping. Alpha, the normal and
//! the separation therefore do not depend on the tolerance. Quickhull as published merges facets
//! while the hull is built; here the exact surface is finished first, so that merging cannot
//! lose a vertex.
//!
//! For `n` triangles, sorting takes `O(n log n)`. Each flood takes time proportional to its
//! group, so grouping is linear as long as few groups have to be gathered again.

use std::ops::Range;

use glam::DVec3;

use super::triangulation::Triangulation;
use crate::csr::Csr;
use crate::exact::{Dd, TriangleNormal};
use crate::sort::{COMPARISON, sort};
use crate::stop::{Meter, Stopped};
use crate::tolerance::{HEIGHT_DIFFERENCE, LEAST_PLANARITY, PLANARITY_PER_INRADIUS, PLATEAU};

/// Steps to gather, fit or move one triangle of a group.
const TRIANGLE: u64 = 20;
/// Steps to compute the height of one vertex along a normal.
const HEIGHT: u64 = 3;

/// The number of times that a group is flooded before its seed becomes a face by itself. Each
/// flood has a quarter of the reach of the flood before.
const ATTEMPTS: usize = 6;
/// Marks a triangle that is in no group.
const NONE: u32 = u32::MAX;

/// A triangulated hull in hull units.
pub(super) struct Surface<'a> {
    pub(super) vertices: &'a [DVec3],
    pub(super) triangulation: &'a Triangulation,
    /// The normal of each triangle.
    pub(super) normals: &'a [TriangleNormal],
    /// For each vertex, its neighbours along the triangulation.
    pub(super) neighbours: &'a Csr,
    pub(super) circumradius: f64,
    pub(super) inradius: f64,
}

/// The plane of a face. Every vertex `v` of the hull has `normal . v <= offset`, and the vertices
/// of the face have `normal . v >= offset - planarity`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub(super) normal: DVec3,
    pub(super) offset: f64,
    /// How far the lowest vertex of the face is below the plane, rounded up; hull units.
    pub(super) planarity: f64,
    /// The height difference between the lowest vertex of the face and the highest vertex that
    /// is not of the face. By convexity the latter is a neighbour of a vertex of the face.
    pub(super) gap: f64,
}

/// The faces, ordered by their largest triangles, the largest first.
pub(super) struct Groups {
    /// For each triangle, the face that it belongs to.
    pub(super) of: Vec<u32>,
    pub(super) planes: Vec<Plane>,
    /// How far the vertices of a face may be from its plane; hull units.
    pub(super) tolerance: f64,
}

/// Groups the triangles of a surface into faces. `planarity` is a fraction of the circumradius.
pub(super) fn groups(surface: &Surface<'_>, planarity: f64, meter: &Meter<'_>) -> Result<Groups, Stopped> {
    let tolerance = (planarity * surface.circumradius)
        .min(PLANARITY_PER_INRADIUS * surface.inradius)
        .max(LEAST_PLANARITY);
    let mut merger = Merger::new(surface, tolerance, meter);
    // Areas are not negative, so their bit patterns have the same order as the areas.
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
    /// For each group, the range of `members` that holds its triangles.
    ranges: Vec<Range<usize>>,
    members: Vec<u32>,
    /// For each triangle, and for each vertex, the number of the last search that reached it.
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
        // Half the tolerance, because the fitted plane differs from the plane of the seed.
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

    /// Adds the free triangles that are connected to the seed, `members[start]`, and whose
    /// vertices are within `reach` of its plane. A triangle that faces away from the seed is
    /// added only if it is thin.
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

    /// The smallest `normal . v` over the vertices of the triangles.
    fn lowest(&self, triangles: &[u32], normal: DVec3) -> f64 {
        let corners = triangles.iter().flat_map(|&t| self.surface.triangulation.triangles[t as usize]);
        corners.map(|v| normal.dot(self.surface.vertices[v as usize])).fold(f64::INFINITY, f64::min)
    }

    /// The plane of a group: its normal is the mean of the triangles' normals, weighted by area,
    /// so that slivers hardly count. No vertex of the hull is above it.
    fn fit(&mut self, triangles: &[u32]) -> Result<Plane, Stopped> {
        let normals = self.surface.normals;
        let normal = if let [alone] = triangles {
            normals[*alone as usize].unit
        } else {
            // Areas are relative to the first triangle, which is the largest, so that the sum does
            // not underflow. The sum is in double-double numbers, because thousands of equal
            // roundings would tilt the plane.
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

    /// The plane with this normal for a group of triangles: offset, planarity and gap.
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
        let planarity = (offset - lowest) + HEIGHT_DIFFERENCE;
        Ok(Plane { normal, offset, planarity, gap: offset - planarity - others })
    }

    /// The largest `normal . v` over all vertices of the hull. Climbs from the vertices in the
    /// queue, whose largest height is `best`, over neighbours that are not lower than the best
    /// height so far by more than rounding. The climb therefore crosses plateaus and dents that
    /// rounding makes.
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

    /// Whether the smallest height of the triangle is at most the tolerance. (If the corners of a
    /// triangle coincide in hull units, both sides of the comparison are 0 and it is thin.)
    fn is_thin(&self, t: u32) -> bool {
        let [a, b, c] =
            self.surface.triangulation.triangles[t as usize].map(|v| self.surface.vertices[v as usize]);
        let [ab, bc, ca] = [b - a, c - b, a - c];
        let longest = ab.length_squared().max(bc.length_squared()).max(ca.length_squared()).sqrt();
        // The vertices are in hull units, as the tolerance is.
        ab.cross(ca).length() <= self.tolerance * longest
    }

    /// Joins each group that consists of thin triangles only to a neighbour whose plane it fits,
    /// because a sliver should not be a face.
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

    /// The neighbour with the lowest index whose plane the vertices of `group` are near, if any.
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

    /// Removes the groups that were joined to others, and renumbers the rest.
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

//! Triangles into faces.
//!
//! Exactly coplanar triangles are not enough: a box turned in space has
//! rounded corners in no common plane. So a face is a connected group of
//! triangles whose vertices lie within a tolerance of one plane. No vertex moves.

use glam::DVec3;

use super::csr::Csr;
use super::quickhull::Triangulation;
use crate::contact::exact::{Dd, ROUNDOFF, TriangleNormal};

/// Vertices of a face lie within this share of the circumradius of its plane …
const PLANARITY_PER_CIRCUMRADIUS: f64 = 1e-6;
/// … and within this share of the inradius, so that the two sides of a thin
/// plate, or its sides and its rim, never become one face.
const PLANARITY_PER_INRADIUS: f64 = 1.0 / 64.0;
/// … but not less than rounding, hull units, however near the contraction point
/// is to a face.
const LEAST_PLANARITY: f64 = 64.0 * ROUNDOFF;
/// How often a group that fits no plane is gathered anew with a quarter of the
/// tolerance before its largest triangle stands alone.
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
}

/// Faces, largest triangle first.
pub(super) struct Groups {
    /// Per triangle its face.
    pub(super) of: Vec<u32>,
    pub(super) planes: Vec<Plane>,
    /// How far vertices of a face may be from its plane; hull units.
    pub(super) tolerance: f64,
}

/// Groups the triangles, each group around its largest.
pub(super) fn groups(surface: &Surface<'_>) -> Groups {
    let tolerance = (PLANARITY_PER_CIRCUMRADIUS * surface.circumradius)
        .min((PLANARITY_PER_INRADIUS * surface.inradius).max(LEAST_PLANARITY));
    let mut merger = Merger::new(surface, tolerance);
    let mut order: Vec<u32> = (0..surface.normals.len() as u32).collect();
    let area = |t: &u32| surface.normals[*t as usize].double_area;
    order.sort_unstable_by(|s, t| area(t).total_cmp(&area(s)).then(s.cmp(t)));
    for seed in order {
        if merger.of[seed as usize] == NONE {
            merger.gather(seed);
        }
    }
    merger.absorb_thin_groups();
    let Merger { of, planes, .. } = merger;
    Groups { of, planes, tolerance }
}

struct Merger<'a> {
    surface: &'a Surface<'a>,
    tolerance: f64,
    of: Vec<u32>,
    planes: Vec<Plane>,
    members: Vec<Vec<u32>>,
    /// Per triangle and per vertex: the last search that met it.
    triangle_met: Vec<u32>,
    vertex_met: Vec<u32>,
    searches: u32,
    queue: Vec<u32>,
}

impl<'a> Merger<'a> {
    fn new(surface: &'a Surface<'a>, tolerance: f64) -> Self {
        let triangles = surface.normals.len();
        Self {
            surface,
            tolerance,
            of: vec![NONE; triangles],
            planes: Vec::new(),
            members: Vec::new(),
            triangle_met: vec![0; triangles],
            vertex_met: vec![0; surface.vertices.len()],
            searches: 0,
            queue: Vec::new(),
        }
    }

    /// Makes a face around `seed`.
    fn gather(&mut self, seed: u32) {
        // Half the tolerance, as the fitted plane is not quite the seed's.
        let mut reach = 0.5 * self.tolerance;
        for _ in 0..ATTEMPTS {
            let members = self.flood(seed, reach);
            let plane = self.fit(&members);
            if members.len() == 1 || plane.planarity <= self.tolerance {
                return self.add(members, plane);
            }
            reach *= 0.25;
        }
        let alone = vec![seed];
        let plane = self.fit(&alone);
        self.add(alone, plane);
    }

    fn add(&mut self, members: Vec<u32>, plane: Plane) {
        let group = self.planes.len() as u32;
        members.iter().for_each(|&t| self.of[t as usize] = group);
        self.planes.push(plane);
        self.members.push(members);
    }

    /// Free triangles connected to `seed` whose vertices are within `reach` of
    /// its plane. Those turned away from it must be thin.
    fn flood(&mut self, seed: u32, reach: f64) -> Vec<u32> {
        let normal = self.surface.normals[seed as usize].unit;
        let floor = self.lowest(&[seed], normal) - reach;
        self.searches += 1;
        self.triangle_met[seed as usize] = self.searches;
        let mut members = vec![seed];
        let mut done = 0;
        while done < members.len() {
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
        members
    }

    /// Smallest `normal . v` over the triangles' vertices.
    fn lowest(&self, triangles: &[u32], normal: DVec3) -> f64 {
        let corners = triangles.iter().flat_map(|&t| self.surface.triangulation.triangles[t as usize]);
        corners.map(|v| normal.dot(self.surface.vertices[v as usize])).fold(f64::INFINITY, f64::min)
    }

    /// The plane whose normal is the triangles' mean, weighted by area, so that
    /// slivers weigh nothing, and which no vertex of the hull is above.
    fn fit(&mut self, triangles: &[u32]) -> Plane {
        let normals = self.surface.normals;
        let normal = if let [alone] = triangles {
            normals[*alone as usize].unit
        } else {
            // Relative to the first, the largest, so that nothing underflows, and
            // in double-double: thousands of equal roundings tilt a plane.
            let first = normals[triangles[0] as usize];
            let mut sum = [Dd::default(); 3];
            for &t in triangles {
                let TriangleNormal { unit, double_area } = normals[t as usize];
                let weighted = (unit * (double_area / first.double_area)).to_array();
                sum.iter_mut().zip(weighted).for_each(|(s, w)| *s = *s + Dd::from(w));
            }
            DVec3::from_array(sum.map(Dd::value)).normalize_or(first.unit)
        };
        self.plane(triangles, normal)
    }

    fn plane(&mut self, triangles: &[u32], normal: DVec3) -> Plane {
        let offset = self.support(triangles, normal);
        // Both ends carry a dot product's rounding, at lengths below 1.
        let planarity = (offset - self.lowest(triangles, normal)) + 8.0 * ROUNDOFF;
        Plane { normal, offset, planarity }
    }

    /// Largest `normal . v` over all vertices: climbs from the triangles' own,
    /// through neighbours as high as the highest so far to rounding, so that a
    /// plateau or a dent of rounding does not end the climb.
    fn support(&mut self, triangles: &[u32], normal: DVec3) -> f64 {
        self.searches += 1;
        self.queue.clear();
        let mut best = f64::NEG_INFINITY;
        for v in triangles.iter().flat_map(|&t| self.surface.triangulation.triangles[t as usize]) {
            if std::mem::replace(&mut self.vertex_met[v as usize], self.searches) != self.searches {
                best = best.max(normal.dot(self.surface.vertices[v as usize]));
                self.queue.push(v);
            }
        }
        while let Some(v) = self.queue.pop() {
            for &w in self.surface.neighbours.row(v as usize) {
                if std::mem::replace(&mut self.vertex_met[w as usize], self.searches) != self.searches {
                    let height = normal.dot(self.surface.vertices[w as usize]);
                    if height >= best - 64.0 * ROUNDOFF {
                        best = best.max(height);
                        self.queue.push(w);
                    }
                }
            }
        }
        best
    }

    /// Whether a triangle's smallest height is below the tolerance. (Of one whose
    /// corners are one point about the contraction point all is 0.)
    fn is_thin(&self, t: u32) -> bool {
        let [a, b, c] =
            self.surface.triangulation.triangles[t as usize].map(|v| self.surface.vertices[v as usize]);
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        // Of the vertices as centred, to be of one unit with the tolerance.
        (b - a).cross(c - a).length() <= self.tolerance * longest
    }

    /// Groups of thin triangles alone join a neighbour whose plane they fit:
    /// a sliver is no face.
    fn absorb_thin_groups(&mut self) {
        for group in (0..self.planes.len()).rev() {
            if !self.members[group].iter().all(|&t| self.is_thin(t)) {
                continue;
            }
            let Some(host) = self.host(group) else { continue };
            let moved = std::mem::take(&mut self.members[group]);
            moved.iter().for_each(|&t| self.of[t as usize] = host);
            let host = host as usize;
            self.members[host].extend(moved);
            let all = std::mem::take(&mut self.members[host]);
            self.planes[host] = self.plane(&all, self.planes[host].normal);
            self.members[host] = all;
        }
        self.drop_empty_groups();
    }

    /// The first neighbour of `group` in whose plane it lies.
    fn host(&self, group: usize) -> Option<u32> {
        let members = &self.members[group];
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
        for members in &self.members {
            place.push(kept);
            kept += u32::from(!members.is_empty());
        }
        let mut members = self.members.iter();
        self.planes.retain(|_| members.next().is_some_and(|m| !m.is_empty()));
        self.of.iter_mut().for_each(|g| *g = place[*g as usize]);
    }
}

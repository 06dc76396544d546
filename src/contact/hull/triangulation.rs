//! A triangulated convex surface, and the vertices that are extreme in it.

use super::BuildError;
use super::cloud::Cloud;
use super::quickhull::{COMPARISON, NONE, inconsistent};
use crate::contact::exact::{counted_orient3d, sure_orient3d};
use crate::contact::stop::{Meter, Stopped};

/// A closed, exactly convex surface. Every vertex is extreme; coplanar
/// triangles stay apart.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Triangulation {
    /// Three vertices each, anticlockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Per triangle: the triangle across the side from corner `i` to the next.
    pub neighbours: Vec<[u32; 3]>,
}

impl Triangulation {
    pub(super) fn with_capacity(triangles: usize) -> Self {
        Self { triangles: Vec::with_capacity(triangles), neighbours: Vec::with_capacity(triangles) }
    }

    /// Number of different vertices, all below `limit`.
    pub(super) fn vertex_count(&self, limit: usize, meter: &Meter<'_>) -> Result<usize, Stopped> {
        let mut used = vec![false; limit];
        let mut count = 0;
        for triangle in &self.triangles {
            meter.spend(COMPARISON)?;
            for &v in triangle {
                count += usize::from(!std::mem::replace(&mut used[v as usize], true));
            }
        }
        Ok(count)
    }

    /// The slot of `corner` in triangle `t`.
    pub(super) fn slot(&self, t: u32, corner: u32) -> usize {
        let [a, b, _] = self.triangles[t as usize];
        if a == corner {
            0
        } else if b == corner {
            1
        } else {
            2
        }
    }

    /// The corner of the triangle across side `side` of `t` that is not on it.
    fn opposite(&self, t: u32, side: usize) -> u32 {
        let across = self.neighbours[t as usize][side];
        let start = self.triangles[t as usize][side];
        // Across, the side runs the other way: its start comes second.
        self.triangles[across as usize][(self.slot(across, start) + 1) % 3]
    }
}

/// Vertices numbered by their place in `kept`.
pub(super) fn renumbered(
    mut surface: Triangulation,
    kept: &[u32],
    limit: usize,
    meter: &Meter<'_>,
) -> Result<Triangulation, Stopped> {
    let mut place = vec![NONE; limit];
    kept.iter().zip(0..).for_each(|(&v, i)| place[v as usize] = i);
    for triangle in &mut surface.triangles {
        meter.spend(COMPARISON)?;
        triangle.iter_mut().for_each(|v| *v = place[*v as usize]);
    }
    Ok(surface)
}

/// The vertices that are on at least three different planes, ascending: on a
/// convex surface, those that are no mixture of others. Checks on the way that
/// the surface is convex.
pub(super) fn extreme_points(
    cloud: &Cloud,
    surface: &Triangulation,
    meter: &Meter<'_>,
) -> Result<Vec<u32>, BuildError> {
    let sure = sure_orient3d(cloud.unit);
    let mut creases = vec![0_u32; cloud.points.len()];
    for (t, corners) in (0..).zip(&surface.triangles) {
        for side in 0..3 {
            if surface.neighbours[t as usize][side] < t {
                continue;
            }
            let [a, b, c] = corners.map(|v| cloud.points[v as usize]);
            let across = cloud.points[surface.opposite(t, side) as usize];
            meter.spend(COMPARISON)?;
            let bend = counted_orient3d([a, b, c, across], sure, meter);
            if bend < 0.0 {
                return Err(inconsistent("the surface is not convex"));
            }
            if bend > 0.0 {
                creases[corners[side] as usize] += 1;
                creases[corners[(side + 1) % 3] as usize] += 1;
            }
        }
    }
    let mut extreme = Vec::with_capacity(creases.len());
    extreme.extend((0..).zip(&creases).filter(|(_, n)| **n >= 3).map(|(v, _)| v));
    Ok(extreme)
}

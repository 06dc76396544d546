//! A triangulated convex surface, and the search for its extreme vertices.

use super::cloud::Cloud;
use super::{BuildError, HullError, HullErrorKind};
use crate::exact::{counted_orient3d, sure_orient3d};
use crate::stop::{Meter, Stopped};

/// Marks the absence of an index.
pub(super) const NONE: u32 = u32::MAX;

/// Steps of one rounded comparison of a point with a triangle's plane.
pub(super) const COMPARISON: u64 = 4;

/// A closed, exactly convex surface of triangles. Every vertex is extreme. Coplanar triangles are
/// not merged.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Triangulation {
    /// The three vertices of each triangle, anticlockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// For each triangle and each `i`, the triangle across the side from corner `i` to the next.
    pub neighbours: Vec<[u32; 3]>,
}

impl Triangulation {
    pub(super) fn with_capacity(triangles: usize) -> Self {
        Self { triangles: Vec::with_capacity(triangles), neighbours: Vec::with_capacity(triangles) }
    }

    /// The number of different vertices. All vertices are below `limit`.
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

    /// The index, from 0 to 2, of the vertex `corner` in triangle `t`.
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

    /// The corner that the triangle across side `side` of `t` does not share with `t`.
    fn opposite(&self, t: u32, side: usize) -> u32 {
        let across = self.neighbours[t as usize][side];
        let start = self.triangles[t as usize][side];
        // In the triangle across, the side runs the other way, so its start comes second.
        self.triangles[across as usize][(self.slot(across, start) + 1) % 3]
    }
}

/// Renumbers the vertices of a surface by their position in `kept`.
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

/// Returns the extreme vertices of a convex surface, ascending. Fails if the surface is not convex.
///
/// A vertex is extreme if at least three *creases* end in it, sides at which the surface bends. A
/// vertex with no crease is inside a flat face, and a vertex with two is inside a straight edge.
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

/// The error for a state that exact arithmetic rules out. It is checked and reported all the same.
pub(super) fn inconsistent(what: &str) -> BuildError {
    HullError { kind: HullErrorKind::NotRepresentable, index: None, detail: format!("internal: {what}") }
        .into()
}

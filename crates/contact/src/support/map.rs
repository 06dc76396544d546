//! The map of directions, by which the support mapping of a large hull takes constant time for most
//! directions.
//!
//! The faces of a cube about the origin are divided into square cells. Every direction goes through
//! one cell. For each cell the map lists the *candidates*, the few vertices that may be farthest
//! along some direction through the cell. A query compares only these.
//!
//! ```text
//! build: for each cell:
//!            top = the vertex farthest along the middle of the cell,
//!                  by hill climbing from the top of the cell before
//!            flood from top over neighbouring vertices; discard a vertex, and do not go on from
//!                  it, if some vertex found is higher along all four corners of the cell
//!            candidates = the vertices that are left, or none if they are more than 32
//! query: compare the candidates of the cell that n goes through;
//!        if there are none, scan all vertices
//! ```
//!
//! The candidates are complete for two reasons. A direction through a cell is a sum of the
//! directions through its four corners with weights that are not negative. So a vertex that is
//! lower than another along all four corners is lower along every direction of the cell. And the
//! vertices that are farthest somewhere in the cell are connected: their regions in the Gauss map
//! of the hull tile the cell, and neighbouring regions belong to neighbouring vertices. Rounding is
//! covered by an allowance, so the answer is bit for bit that of a scan.
//!
//! A hull of `n` vertices has about `n / 3.3` cells. For a round hull each cell has a bounded number
//! of candidates, so building takes `O(n)` time and memory, and a query takes constant time. Hill
//! climbing without a map needs no memory, but it takes more and less predictable steps per
//! query, and it needs a proof that its last vertex is the farthest, with the same tie rule.

use std::hint::select_unpredictable;

use glam::DVec3;

use crate::csr::Csr;
use crate::stop::{Meter, Stopped};
use crate::tolerance::MAPPED;

/// Hulls with more vertices than this have a map. For smaller hulls, scanning all vertices costs
/// about as much.
const ABOVE: usize = 256;

/// The approximate number of vertices per cell. With fewer cells the map would be built sooner, but
/// each cell would have more candidates.
const VERTICES_A_CELL: f64 = 3.3;

/// The largest number of candidates of a cell. A cell through which the normal of a face with many
/// corners goes has more; there, scanning all vertices is as fast.
const MOST: usize = 32;

/// Steps to examine one neighbour of a vertex: to compute its heights and compare them with the
/// highest ones.
const NEIGHBOUR: u64 = 10;

/// For each direction, the vertices that may be farthest along it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SupportMap {
    /// The number of cells along an edge of the cube.
    side: usize,
    /// The candidates of each cell, ascending; empty if there are too many. The cells are in the
    /// order of the cube's faces, and row by row on each face.
    candidates: Csr,
}

impl SupportMap {
    /// Builds the map for vertices in hull units and their neighbours along a triangulation. Returns
    /// `None` for small hulls.
    pub(crate) fn new(
        vertices: &[DVec3],
        neighbours: &Csr,
        meter: &Meter<'_>,
    ) -> Result<Option<Self>, Stopped> {
        if vertices.len() <= ABOVE {
            return Ok(None);
        }
        let side = (vertices.len() as f64 / VERTICES_A_CELL / 6.0).sqrt().ceil() as usize;
        let cells = 6 * side * side;
        let mut candidates = Csr::with_capacity(cells, cells * MOST / 2);
        let mut search = Search::new(vertices, neighbours);
        let (mut near, mut row) = (0, Vec::new());
        for place in 0..cells {
            let cell = Cell::new(place / (side * side), [place % side, place / side % side], side);
            near = search.find(&cell, near, meter)?;
            row.clear();
            if search.found.len() <= MOST {
                row.extend(search.found.iter().map(|found| found.0));
                row.sort_unstable();
            }
            candidates.push_row(&row);
        }
        candidates.items.shrink_to_fit();
        Ok(Some(Self { side, candidates }))
    }

    /// The vertex farthest along `n`; the lowest index if several tie. `None` if the cell has no
    /// list of candidates, or if `n` is zero or not finite.
    #[inline]
    pub(crate) fn farthest(&self, vertices: &[DVec3], n: DVec3) -> Option<u32> {
        let (mut farthest, mut largest) = (u32::MAX, f64::NEG_INFINITY);
        for &v in self.candidates.row(self.cell(n)?) {
            let p = vertices[v as usize];
            let value = n.x * p.x + n.y * p.y + n.z * p.z;
            let better = value > largest;
            farthest = select_unpredictable(better, v, farthest);
            largest = select_unpredictable(better, value, largest);
        }
        (farthest != u32::MAX).then_some(farthest)
    }

    /// The index of the cell that the direction goes through, up to rounding. `None` if `n` is
    /// zero, nearly so, or not finite.
    #[inline]
    fn cell(&self, n: DVec3) -> Option<usize> {
        let size = n.abs();
        let axis = select_unpredictable(size.z > size.x.max(size.y), 2, usize::from(size.y > size.x));
        let turned = [n.x, n.y, n.z, n.x, n.y];
        let (along, x, y) = (turned[axis], turned[axis + 1], turned[axis + 2]);
        let half = 0.5 * self.side as f64;
        let scale = half / along.abs();
        let place = |x: f64| ((x * scale + half) as usize).min(self.side - 1);
        let face = 2 * axis + usize::from(along < 0.0);
        (scale > 0.0 && scale < f64::INFINITY).then(|| (face * self.side + place(y)) * self.side + place(x))
    }

    pub(crate) fn heap_bytes(&self) -> usize {
        self.candidates.heap_bytes()
    }
}

/// A cell of the cube's surface. A direction through the cell is a sum, with weights that are not
/// negative, of the directions through its corners.
struct Cell {
    /// The axis that the cell's face of the cube is perpendicular to.
    axis: usize,
    /// The coordinate of the face along the axis: 1 or -1.
    along: f64,
    /// The ends of the cell in the next two coordinates.
    x: [f64; 2],
    y: [f64; 2],
}

/// The heights of a vertex along the directions through the four corners of a cell.
type Heights = [f64; 4];

impl Cell {
    fn new(face: usize, [x, y]: [usize; 2], side: usize) -> Self {
        let ends = |place: usize| [place, place + 1].map(|end| 2.0 * end as f64 / side as f64 - 1.0);
        Self { axis: face / 2, along: [1.0, -1.0][face % 2], x: ends(x), y: ends(y) }
    }

    #[inline]
    fn heights(&self, v: DVec3) -> Heights {
        let v = v.to_array();
        let (along, across, up) = (self.along * v[self.axis], v[(self.axis + 1) % 3], v[(self.axis + 2) % 3]);
        let ([x0, x1], [y0, y1]) = (self.x.map(|x| along + x * across), self.y.map(|y| y * up));
        [x0 + y0, x1 + y0, x0 + y1, x1 + y1]
    }
}

/// Finds the candidates of one cell after another.
struct Search<'a> {
    vertices: &'a [DVec3],
    neighbours: &'a Csr,
    /// For each vertex, the number of the cell for which it was last examined.
    seen: Vec<u32>,
    /// The number of cells so far.
    cells: u32,
    /// The vertices found for the current cell.
    found: Vec<(u32, Heights)>,
}

impl<'a> Search<'a> {
    fn new(vertices: &'a [DVec3], neighbours: &'a Csr) -> Self {
        Self { vertices, neighbours, seen: vec![0; vertices.len()], cells: 0, found: Vec::new() }
    }

    /// Finds the vertices that may be farthest along a direction of the cell, or some number above
    /// [`MOST`] of them if they are many. Returns the vertex farthest along the middle of the cell.
    /// `near` is a vertex from which the climb to that vertex is short.
    fn find(&mut self, cell: &Cell, near: u32, meter: &Meter<'_>) -> Result<u32, Stopped> {
        let top = self.climb(cell, near, meter)?;
        let Self { vertices, neighbours, seen, cells, found } = self;
        *cells += 1;
        seen[top as usize] = *cells;
        found.clear();
        found.push((top, cell.heights(vertices[top as usize])));
        // The heights of the vertices that are highest at each corner and in the middle.
        let mut highest = [found[0].1; 5];
        let mut next = 0;
        while next < found.len() && found.len() <= 4 * MOST {
            meter.spend(NEIGHBOUR * neighbours.row(found[next].0 as usize).len() as u64)?;
            for &v in neighbours.row(found[next].0 as usize) {
                if std::mem::replace(&mut seen[v as usize], *cells) == *cells {
                    continue;
                }
                let at = cell.heights(vertices[v as usize]);
                if is_below(&at, &highest) {
                    continue;
                }
                found.push((v, at));
                for corner in 0..4 {
                    if at[corner] > highest[corner][corner] {
                        highest[corner] = at;
                    }
                }
            }
            next += 1;
        }
        found.retain(|(_, at)| !is_below(at, &highest));
        Ok(top)
    }

    /// The vertex farthest along the middle of a cell, by hill climbing. On a convex hull, a vertex
    /// that is higher than all its neighbours is the highest of all, up to rounding.
    fn climb(&self, cell: &Cell, near: u32, meter: &Meter<'_>) -> Result<u32, Stopped> {
        let height = |v: u32| {
            let at = cell.heights(self.vertices[v as usize]);
            at[0] + at[3]
        };
        let (mut top, mut most) = (near, height(near));
        loop {
            let from = top;
            meter.spend(NEIGHBOUR / 2 * self.neighbours.row(from as usize).len() as u64)?;
            for &v in self.neighbours.row(from as usize) {
                let height = height(v);
                let higher = height > most;
                top = select_unpredictable(higher, v, top);
                most = select_unpredictable(higher, height, most);
            }
            if top == from {
                return Ok(top);
            }
        }
    }
}

/// Whether one of `highest` is higher at all four corners, by more than rounding.
#[inline]
fn is_below(at: &Heights, highest: &[Heights; 5]) -> bool {
    let at = at.map(|height| height + MAPPED);
    highest.iter().fold(false, |any, high| any | (0..4).fold(true, |all, k| all & (high[k] > at[k])))
}

#[cfg(test)]
mod tests {
    use glam::Vec3Swizzles;

    use super::*;
    use crate::ConvexHull;
    use crate::support::farthest;
    use crate::workload::Random;

    fn hulls() -> Vec<ConvexHull> {
        let mut random = Random::new(3);
        let mut sphere = |count: usize| (0..count).map(|_| random.direction()).collect::<Vec<_>>();
        let stretched = |points: Vec<DVec3>, by: [f64; 3]| {
            points.iter().map(|p| *p * DVec3::from_array(by)).collect::<Vec<_>>()
        };
        let ring = |n: usize, z: f64| {
            (0..n).map(move |i| {
                let (sin, cos) = (std::f64::consts::TAU * i as f64 / n as f64).sin_cos();
                DVec3::new(cos, sin, z)
            })
        };
        let bowl = |n: i32| {
            let all = (-n..=n).flat_map(move |x| (-n..=n).map(move |y| (x, y)));
            all.map(|(x, y)| DVec3::new(f64::from(x), f64::from(y), -0.01 * f64::from(x * x + y * y)))
        };
        [
            sphere(600),
            sphere(3000),
            stretched(sphere(1000), [1.0, 1e-3, 1.0]),
            stretched(sphere(1000), [1.0, 1e-7, 1e-3]),
            // A prism with two faces of 1,000 corners, then a ring of 400 corners around a sphere.
            ring(1000, -0.3).chain(ring(1000, 0.3)).collect(),
            ring(400, -0.3).chain(sphere(900).iter().map(|p| *p * 0.9)).collect(),
            // Vertices that are extreme by little more than rounding.
            stretched(bowl(14).collect(), [0.1, 0.1, 1e-9]),
        ]
        .iter()
        .map(|points| {
            let points: Vec<[f64; 3]> = points.iter().map(|p| p.to_array()).collect();
            ConvexHull::new(&points).expect("a hull")
        })
        .collect()
    }

    /// Catches a candidate that is left out, a cell that is confused with another, and a tie that
    /// goes to a higher index: every answer is compared with a scan over all vertices.
    #[test]
    fn the_farthest_candidate_is_the_farthest_vertex() {
        let (mut mapped, mut plain) = (0, 0);
        for hull in hulls() {
            let map = hull.support_map.as_ref().expect("a map");
            let mut random = Random::new(7);
            let mut check = |n: DVec3| {
                let expected = farthest(&hull.columns, n);
                match map.farthest(&hull.vertices, n) {
                    Some(v) => {
                        assert_eq!(v, expected, "{} vertices, along {n}", hull.vertex_count());
                        mapped += 1;
                    }
                    None => plain += 1,
                }
                assert_eq!(hull.support(n), expected);
            };
            for face in hull.faces() {
                // Along a normal all corners of the face tie. The second direction is slightly off.
                check(face.normal);
                check(face.normal + 1e-15 * random.direction());
            }
            for round in 0..20_000 {
                let n = random.direction();
                check(n * 10_f64.powi(round % 400 - 200));
                // Directions through the borders of cells and through the corners of cells.
                let place = |x: f64| (x * map.side as f64).round() / map.side as f64;
                let on_border =
                    DVec3::new(place(n.x), n.y.signum(), if round % 2 == 0 { n.z } else { place(n.z) });
                check([on_border, on_border.yzx(), on_border.zxy()][round as usize % 3]);
            }
            for none in [DVec3::ZERO, DVec3::NAN, DVec3::splat(f64::from_bits(1)), DVec3::INFINITY] {
                assert_eq!(map.farthest(&hull.vertices, none), None);
                check(none);
            }
        }
        assert!(mapped > 250_000 && plain > 100, "{mapped} {plain}");
    }

    /// Catches a map whose cells have no lists or long lists: otherwise only the time of queries
    /// would show it.
    #[test]
    fn candidates_are_few() {
        let hull = &hulls()[1];
        let map = hull.support_map.as_ref().expect("a map");
        let counts: Vec<usize> = (0..6 * map.side * map.side).map(|i| map.candidates.row(i).len()).collect();
        let sum: usize = counts.iter().sum();
        assert!(counts.iter().all(|&count| count > 0), "{counts:?}");
        assert!(sum < 16 * counts.len(), "{sum} in {} cells", counts.len());
        assert!(map.heap_bytes() < 24 * hull.vertex_count());
    }
}

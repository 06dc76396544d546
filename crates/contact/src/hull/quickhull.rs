//! The triangulated convex hull of a cloud, by quickhull on exact predicates.
//!
//! The hull grows from a tetrahedron. Each triangle (*face* in this file) keeps a list of the
//! points above it, that is, strictly outside its plane; every point that may still be outside
//! the hull is in exactly one list. Each insertion takes the farthest point of a list, removes
//! all triangles that this point sees, and closes the hole with a cone of new triangles:
//!
//! ```text
//! faces = a tetrahedron of points that are far apart
//! give every other point to the first face that it is above; a point above none is inside
//! for each face with a non-empty list, new faces included:
//!     apex = the farthest point of the list
//!     seen = the faces that apex is above, found by a walk over neighbours from this face
//!     rim  = the sides between seen and unseen faces, ordered into one cycle (the horizon)
//!     add one triangle (side, apex) for each side of the rim
//!     remove the seen faces and give their points to the new triangles in the same way
//! ```
//!
//! The algorithm is that of C. B. Barber, D. P. Dobkin and H. Huhdanpaa, *The Quickhull Algorithm
//! for Convex Hulls*, ACM Transactions on Mathematical Software 22(4), 1996,
//! doi:10.1145/235815.235821. It departs from the paper in how it treats rounding. The paper
//! merges facets that rounding has made non-convex. Here every decision to keep or discard a
//! point is an exact predicate, and rounded arithmetic chooses only which point comes next. So
//! the surface is exactly convex, contains every point, and has every extreme point as a vertex.
//!
//! A point in the plane of a triangle counts as not seeing it. Three facts follow. The triangles
//! that a point sees form a disc, whose rim is one simple cycle. No new triangle is degenerate:
//! if the apex were on the line of a rim side, it would lie in the plane of the seen triangle at
//! that side. And a point of a removed triangle that is still outside sees one of the new
//! triangles, so no extreme point is ever lost.
//!
//! If the insertions split the lists evenly, `n` points of which `v` are inserted take
//! `O(n log v)` time, as in the paper. The worst case is `O(n^2)`. Most predicates are decided by
//! a rounded value and its error bound; only points that are nearly in a triangle's plane need
//! exact arithmetic.

use glam::DVec3;

use super::cloud::Cloud;
use super::triangulation::{COMPARISON, NONE, Triangulation, extreme_points, inconsistent, renumbered};
use super::{BuildError, HullError, HullErrorKind};
use crate::exact::{collinear, counted_orient3d, sure_orient3d};
use crate::stop::{Meter, Stopped};
use crate::tolerance::{HEIGHT_ABOVE, U};

/// The mark of a triangle that is no longer part of the hull.
const REMOVED: u32 = u32::MAX;
/// Steps of an exact test for collinearity.
const COLLINEAR: u64 = 1000;
/// Steps of making, linking or moving one triangle.
const TRIANGLE: u64 = 20;

/// Triangulates the hull of `cloud`. Returns the cloud of its extreme points, and triangles that
/// index this smaller cloud.
pub(super) fn triangulate(cloud: Cloud, meter: &Meter<'_>) -> Result<(Cloud, Triangulation), BuildError> {
    let surface = Quickhull::new(&cloud, meter)?.run()?;
    let extreme = extreme_points(&cloud, &surface, meter)?;
    let kept = cloud.subset(&extreme, meter)?;
    if extreme.len() == surface.vertex_count(cloud.points.len(), meter)? {
        return Ok((kept, renumbered(surface, &extreme, cloud.points.len(), meter)?));
    }
    // The surface has corners inside a flat face or on a straight edge, which are not extreme.
    // Triangulate again without them: all points that are left are extreme.
    let surface = Quickhull::new(&kept, meter)?.run()?;
    if extreme_points(&kept, &surface, meter)?.len() != kept.points.len() {
        return Err(inconsistent("an extreme point is missing from its hull"));
    }
    Ok((kept, surface))
}

/// A triangle of the growing hull.
struct Facet {
    corners: [u32; 3],
    /// Neighbour `i` is the face across the side from corner `i` to the next corner.
    neighbours: [u32; 3],
    /// The outward normal in scaled units. It is not normalised.
    normal: DVec3,
    /// An upper bound of the rounding error of `normal . (p - corner 0)` over all points `p` of
    /// the cloud.
    noise: f64,
    /// The head of the list of points assigned to this face. All of them are strictly above it.
    first: u32,
    /// The farthest point of the list.
    farthest: u32,
    /// The height of the farthest point above the face, times the length of the normal.
    height: f64,
    /// The last insertion that looked at this face: twice its number, plus 1 if the apex did not
    /// see the face.
    mark: u32,
}

/// One side of the rim of the faces that a point sees. The rim runs anticlockwise seen from
/// outside.
struct Rim {
    from: u32,
    to: u32,
    /// The face on the other side, which the point does not see and which stays.
    beyond: u32,
}

struct Quickhull<'a> {
    cloud: &'a Cloud,
    meter: &'a Meter<'a>,
    /// The value from [`sure_orient3d`] for the extent of this cloud.
    sure: f64,
    faces: Vec<Facet>,
    /// For each point, the next point in the list of its face.
    next: Vec<u32>,
    /// For each point, the rim side that starts at it; `NONE` between insertions.
    rim_at: Vec<u32>,
    seen: Vec<u32>,
    rim: Vec<Rim>,
    insertions: u32,
}

impl<'a> Quickhull<'a> {
    /// Starts with a tetrahedron of points that are far apart, and assigns all other points.
    fn new(cloud: &'a Cloud, meter: &'a Meter<'a>) -> Result<Self, BuildError> {
        let count = cloud.points.len();
        let mut hull = Self {
            cloud,
            meter,
            sure: sure_orient3d(cloud.unit),
            faces: Vec::with_capacity(4 * count.min(1 << 16)),
            next: vec![NONE; count],
            rim_at: vec![NONE; count],
            seen: Vec::with_capacity(32),
            rim: Vec::with_capacity(32),
            insertions: 0,
        };
        let [a, b, c, d] = first_tetrahedron(cloud, meter)?;
        hull.add_face([a, b, c], [1, 2, 3]);
        hull.add_face([b, a, d], [0, 3, 2]);
        hull.add_face([c, b, d], [0, 1, 3]);
        hull.add_face([a, c, d], [0, 2, 1]);
        for point in (0..count as u32).filter(|p| ![a, b, c, d].contains(p)) {
            hull.assign(point, 0)?;
        }
        Ok(hull)
    }

    /// Inserts the farthest point above each face until no face has a point above it.
    fn run(mut self) -> Result<Triangulation, BuildError> {
        let mut face = 0;
        // The loop ends: each insertion takes one point off the lists, and no point comes back.
        // Faces are only appended, and a removed face is never used again.
        while face < self.faces.len() {
            if self.faces[face].first != NONE {
                self.insert(face as u32)?;
            }
            self.meter.spend(1)?;
            face += 1;
        }
        Ok(self.surface()?)
    }

    fn add_face(&mut self, corners: [u32; 3], neighbours: [u32; 3]) {
        let [a, b, c] = corners.map(|v| self.cloud.scaled[v as usize]);
        let (ab, ac) = (b - a, c - a);
        let (p, q) = (ab.abs(), ac.abs());
        // For each component of the cross product, the sum of the sizes of its products.
        let size = DVec3::new(p.y * q.z + p.z * q.y, p.z * q.x + p.x * q.z, p.x * q.y + p.y * q.x);
        // The constant covers underflow.
        let noise = HEIGHT_ABOVE * U * size.dot(self.cloud.extent) + f64::MIN_POSITIVE;
        let normal = ab.cross(ac);
        self.faces.push(Facet {
            corners,
            neighbours,
            normal,
            noise,
            first: NONE,
            farthest: NONE,
            height: f64::NEG_INFINITY,
            mark: 0,
        });
    }

    /// The height of `point` above `face`, times the length of the normal, or `None` if the point
    /// is not strictly above. Whether it is above is exact; the height is rounded.
    fn height_above(&self, face: &Facet, point: u32) -> Option<f64> {
        let scaled = &self.cloud.scaled;
        let height = face.normal.dot(scaled[point as usize] - scaled[face.corners[0] as usize]);
        let above = if height.abs() > face.noise {
            height > 0.0
        } else {
            let [a, b, c] = face.corners.map(|v| self.cloud.points[v as usize]);
            let d = self.cloud.points[point as usize];
            counted_orient3d([a, b, c, d], self.sure, self.meter) < 0.0
        };
        above.then_some(height)
    }

    /// Gives `point` to the first face, from index `start` on, that the point is above. A point
    /// above no face is inside the hull and is dropped.
    fn assign(&mut self, point: u32, start: usize) -> Result<(), Stopped> {
        for index in start..self.faces.len() {
            self.meter.spend(COMPARISON)?;
            if let Some(height) = self.height_above(&self.faces[index], point) {
                let face = &mut self.faces[index];
                self.next[point as usize] = face.first;
                face.first = point;
                if height > face.height {
                    (face.farthest, face.height) = (point, height);
                }
                return Ok(());
            }
        }
        Ok(())
    }

    /// Inserts the farthest point above `face`.
    fn insert(&mut self, face: u32) -> Result<(), BuildError> {
        let apex = self.faces[face as usize].farthest;
        self.insertions += 1;
        self.find_seen(face, apex)?;
        self.sort_rim()?;
        let start = self.faces.len();
        self.raise_cone(apex)?;
        for i in 0..self.seen.len() {
            let seen = self.seen[i] as usize;
            let mut point = self.faces[seen].first;
            self.faces[seen].first = NONE;
            self.faces[seen].mark = REMOVED;
            while point != NONE {
                let following = self.next[point as usize];
                if point != apex {
                    self.assign(point, start)?;
                }
                point = following;
            }
        }
        Ok(())
    }

    /// Collects the faces that `apex` sees, by a walk from `face`, and the sides of their rim.
    fn find_seen(&mut self, face: u32, apex: u32) -> Result<(), Stopped> {
        let (is_seen, is_not) = (2 * self.insertions, 2 * self.insertions + 1);
        self.seen.clear();
        self.rim.clear();
        self.seen.push(face);
        self.faces[face as usize].mark = is_seen;
        let mut done = 0;
        while done < self.seen.len() {
            self.meter.spend(TRIANGLE)?;
            let current = self.seen[done] as usize;
            done += 1;
            for side in 0..3 {
                let across = self.faces[current].neighbours[side];
                let mark = self.faces[across as usize].mark;
                if mark == is_seen {
                    continue;
                }
                if mark != is_not && self.height_above(&self.faces[across as usize], apex).is_some() {
                    self.faces[across as usize].mark = is_seen;
                    self.seen.push(across);
                } else {
                    self.faces[across as usize].mark = is_not;
                    let corners = self.faces[current].corners;
                    self.rim.push(Rim { from: corners[side], to: corners[(side + 1) % 3], beyond: across });
                }
            }
        }
        Ok(())
    }

    /// Puts the sides of the rim in order. Fails if they are not one simple cycle.
    fn sort_rim(&mut self) -> Result<(), BuildError> {
        self.meter.spend(COMPARISON * self.rim.len() as u64)?;
        let mut simple = true;
        for (i, side) in (0..).zip(&self.rim) {
            let place = &mut self.rim_at[side.from as usize];
            simple &= *place == NONE;
            *place = i;
        }
        for i in 1..self.rim.len() {
            // The side that follows side `i - 1`. An earlier swap may have moved it.
            let next = self.rim_at[self.rim[i - 1].to as usize] as usize;
            if !(i..self.rim.len()).contains(&next) {
                simple = false;
                break;
            }
            self.rim_at[self.rim[i].from as usize] = next as u32;
            self.rim.swap(i, next);
            self.rim_at[self.rim[i].from as usize] = i as u32;
        }
        for side in &self.rim {
            self.rim_at[side.from as usize] = NONE;
        }
        let closed = self.rim.len() >= 3 && self.rim[self.rim.len() - 1].to == self.rim[0].from;
        if simple && closed { Ok(()) } else { Err(inconsistent("the horizon is not one simple cycle")) }
    }

    /// Adds the triangles that join each side of the rim to `apex`.
    fn raise_cone(&mut self, apex: u32) -> Result<(), BuildError> {
        let (start, count) = (self.faces.len() as u32, self.rim.len() as u32);
        if u64::from(start) + u64::from(count) >= u64::from(NONE) {
            return Err(inconsistent("more triangles on the way than indices of 32 bits can name"));
        }
        for i in 0..count {
            self.meter.spend(TRIANGLE)?;
            let Rim { from, to, beyond } = self.rim[i as usize];
            let (next, previous) = (start + (i + 1) % count, start + (i + count - 1) % count);
            self.add_face([from, to, apex], [beyond, next, previous]);
            let beyond = &mut self.faces[beyond as usize];
            for side in 0..3 {
                if beyond.corners[side] == to && beyond.corners[(side + 1) % 3] == from {
                    beyond.neighbours[side] = start + i;
                }
            }
        }
        Ok(())
    }

    /// The faces that were not removed, renumbered.
    fn surface(&self) -> Result<Triangulation, Stopped> {
        let mut place = vec![NONE; self.faces.len()];
        let mut count = 0;
        for (face, place) in self.faces.iter().zip(&mut place) {
            self.meter.spend(COMPARISON)?;
            if face.mark != REMOVED {
                *place = count;
                count += 1;
            }
        }
        let mut surface = Triangulation::with_capacity(2 * self.cloud.points.len());
        for face in &self.faces {
            self.meter.spend(COMPARISON)?;
            if face.mark != REMOVED {
                surface.triangles.push(face.corners);
                surface.neighbours.push(face.neighbours.map(|n| place[n as usize]));
            }
        }
        Ok(surface)
    }
}

/// Finds four points that are not in one plane, decided exactly. They are far apart as far as
/// rounded arithmetic can tell. The fourth point is below the triangle of the other three.
fn first_tetrahedron(cloud: &Cloud, meter: &Meter<'_>) -> Result<[u32; 4], BuildError> {
    let (points, scaled) = (&cloud.points, &cloud.scaled);
    let a = 0;
    let b = farthest(scaled, meter, |p| (p - scaled[a]).length_squared())?;
    let along = scaled[b] - scaled[a];
    let mut c = farthest(scaled, meter, |p| along.cross(p - scaled[a]).length_squared())?;
    // The choice above is rounded, so check it exactly. If it is on the line, take the first
    // point that is off the line.
    let on_line = |i: usize| {
        meter.count(COLLINEAR);
        collinear(points[a], points[b], points[i])
    };
    if on_line(c) {
        c = 0;
        while c < points.len() && on_line(c) {
            meter.spend(COMPARISON)?;
            c += 1;
        }
    }
    if c == points.len() {
        let detail = format!("all {} distinct points lie on one line", points.len());
        return Err(HullError { kind: HullErrorKind::Collinear, index: None, detail }.into());
    }
    let normal = along.cross(scaled[c] - scaled[a]);
    let mut d = farthest(scaled, meter, |p| normal.dot(p - scaled[a]).abs())?;
    let sure = sure_orient3d(cloud.unit);
    let side = |i: usize| counted_orient3d([points[a], points[b], points[c], points[i]], sure, meter);
    if side(d) == 0.0 {
        d = 0;
        while d < points.len() && side(d) == 0.0 {
            meter.spend(COMPARISON)?;
            d += 1;
        }
    }
    if d == points.len() {
        let detail = format!("all {} distinct points lie in one plane", points.len());
        return Err(HullError { kind: HullErrorKind::Coplanar, index: None, detail }.into());
    }
    let (b, c) = if side(d) > 0.0 { (b, c) } else { (c, b) };
    Ok([a, b, c, d].map(|i| i as u32))
}

/// The index of the point with the largest `distance`; the lowest index if several tie.
fn farthest(points: &[DVec3], meter: &Meter<'_>, distance: impl Fn(DVec3) -> f64) -> Result<usize, Stopped> {
    let mut best = (0, f64::NEG_INFINITY);
    for (i, &p) in points.iter().enumerate() {
        meter.spend(COMPARISON)?;
        let d = distance(p);
        best = if d > best.1 { (i, d) } else { best };
    }
    Ok(best.0)
}

//! Triangulated convex hull of a cloud.
//!
//! C. B. Barber, D. P. Dobkin and H. Huhdanpaa, *The Quickhull Algorithm for
//! Convex Hulls* (1996), with every keep-or-discard decision an exact
//! predicate in place of that paper's facet merging. Rounded arithmetic chooses
//! only which point comes next.
//!
//! A point in a triangle's plane counts as not seeing it. What a point sees is
//! then a disc whose rim is one simple cycle without collinear triangles, and
//! an outside point of a removed triangle that is still outside sees one of the
//! new triangles, so that no extreme point is ever lost.

use glam::DVec3;

use super::cloud::Cloud;
use super::{BuildError, HullError, HullErrorKind};
use crate::contact::exact::{collinear, counted_orient3d, sure_orient3d};
use crate::contact::stop::{Meter, Stopped};
use crate::contact::tolerance::U;

/// Not an index.
const NONE: u32 = u32::MAX;
/// Mark of a triangle that is no longer part of the hull.
const REMOVED: u32 = u32::MAX;
/// Steps of one rounded comparison of a point with a triangle's plane.
const COMPARISON: u64 = 4;
/// Steps of an exact test for collinearity.
const COLLINEAR: u64 = 1000;
/// Steps of making, linking or moving one triangle.
const TRIANGLE: u64 = 20;

/// A closed, exactly convex surface. Every vertex is extreme; coplanar
/// triangles stay apart.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Triangulation {
    /// Three vertices each, anticlockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Per triangle: the triangle across the side from corner `i` to the next.
    pub neighbours: Vec<[u32; 3]>,
}

/// Triangulates the hull of `cloud`. Returned is the cloud of its extreme
/// points alone, which the triangles index.
pub(super) fn triangulate(cloud: Cloud, meter: &Meter<'_>) -> Result<(Cloud, Triangulation), BuildError> {
    let surface = Quickhull::new(&cloud, meter)?.run()?;
    let extreme = extreme_points(&cloud, &surface, meter)?;
    let kept = cloud.subset(&extreme, meter)?;
    if extreme.len() == surface.vertex_count(cloud.points.len(), meter)? {
        return Ok((kept, renumbered(surface, &extreme, cloud.points.len(), meter)?));
    }
    // Points inside a flat face or a straight edge were corners on the way:
    // anew without them. All that are left are extreme.
    let surface = Quickhull::new(&kept, meter)?.run()?;
    if extreme_points(&kept, &surface, meter)?.len() != kept.points.len() {
        return Err(inconsistent("an extreme point is missing from its hull"));
    }
    Ok((kept, surface))
}

impl Triangulation {
    fn with_capacity(triangles: usize) -> Self {
        Self { triangles: Vec::with_capacity(triangles), neighbours: Vec::with_capacity(triangles) }
    }

    /// Number of different vertices, all below `limit`.
    fn vertex_count(&self, limit: usize, meter: &Meter<'_>) -> Result<usize, Stopped> {
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
fn renumbered(
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
fn extreme_points(cloud: &Cloud, surface: &Triangulation, meter: &Meter<'_>) -> Result<Vec<u32>, BuildError> {
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

/// A triangle of the growing hull.
struct Face {
    corners: [u32; 3],
    /// Across the side from corner `i` to the next.
    neighbours: [u32; 3],
    /// Outward, scaled units; not unit.
    normal: DVec3,
    /// Bound of the rounding error of `normal . (p - corner 0)` over the cloud.
    noise: f64,
    /// First of the points assigned to this face, all strictly above it.
    first: u32,
    /// The farthest of these, and how far, times the normal's length.
    farthest: u32,
    height: f64,
    /// Of the last insertion that looked at this face: its number doubled, plus
    /// 1 where the face was not seen.
    mark: u32,
}

/// One side of the rim of what a point sees, anticlockwise from outside.
struct Rim {
    from: u32,
    to: u32,
    /// The face beyond, which stays.
    beyond: u32,
}

struct Quickhull<'a> {
    cloud: &'a Cloud,
    meter: &'a Meter<'a>,
    /// See [`sure_orient3d`].
    sure: f64,
    faces: Vec<Face>,
    /// Per point: the next of its face's list.
    next: Vec<u32>,
    /// Per point: the rim side that starts there; `NONE` between insertions.
    rim_at: Vec<u32>,
    seen: Vec<u32>,
    rim: Vec<Rim>,
    insertions: u32,
}

impl<'a> Quickhull<'a> {
    /// Starts from a tetrahedron of far apart points.
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

    /// Takes in, face by face, the farthest point above it until none is left.
    fn run(mut self) -> Result<Triangulation, BuildError> {
        let mut face = 0;
        // Faces are appended and never revived, and each step takes in a point
        // for good: bounded by the number of points.
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
        // Sum of the sizes of the products of each component.
        let size = DVec3::new(p.y * q.z + p.z * q.y, p.z * q.x + p.x * q.z, p.x * q.y + p.y * q.x);
        // Each term of normal . (p - a) went through at most 8 roundings; one
        // more covers those of this bound, the constant those of underflow.
        let noise = 9.0 * U * size.dot(self.cloud.extent) + f64::MIN_POSITIVE;
        let normal = ab.cross(ac);
        self.faces.push(Face {
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

    /// How far `point` is above `face` times the normal's length, if strictly above.
    fn height_above(&self, face: &Face, point: u32) -> Option<f64> {
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

    /// Gives `point` to the first face from `start` on that it is above; one
    /// above none is inside.
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

    /// Takes in the farthest point above `face`.
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

    /// Collects the faces that `apex` sees, from `face` on, and their rim.
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

    /// Orders the rim's sides along the rim, which must be one simple cycle.
    fn sort_rim(&mut self) -> Result<(), BuildError> {
        self.meter.spend(COMPARISON * self.rim.len() as u64)?;
        let mut simple = true;
        for (i, side) in (0..).zip(&self.rim) {
            let place = &mut self.rim_at[side.from as usize];
            simple &= *place == NONE;
            *place = i;
        }
        for i in 1..self.rim.len() {
            // The side that follows the one before; its place may have moved on.
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

    /// Joins every side of the rim to `apex`.
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

    /// The faces that are left.
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

/// Four points that are exactly not in one plane, far apart where rounding can
/// tell, with the fourth below the other three.
fn first_tetrahedron(cloud: &Cloud, meter: &Meter<'_>) -> Result<[u32; 4], BuildError> {
    let (points, scaled) = (&cloud.points, &cloud.scaled);
    let a = 0;
    let b = farthest(scaled, meter, |p| (p - scaled[a]).length_squared())?;
    let along = scaled[b] - scaled[a];
    let mut c = farthest(scaled, meter, |p| along.cross(p - scaled[a]).length_squared())?;
    // Exactly, where rounding was wrong; then the first point that is off the line will do.
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

/// The first index of the largest value.
fn farthest(points: &[DVec3], meter: &Meter<'_>, distance: impl Fn(DVec3) -> f64) -> Result<usize, Stopped> {
    let mut best = (0, f64::NEG_INFINITY);
    for (i, &p) in points.iter().enumerate() {
        meter.spend(COMPARISON)?;
        let d = distance(p);
        best = if d > best.1 { (i, d) } else { best };
    }
    Ok(best.0)
}

/// What exact arithmetic rules out: reported, never trusted.
fn inconsistent(what: &str) -> BuildError {
    HullError { kind: HullErrorKind::NotRepresentable, index: None, detail: format!("internal: {what}") }
        .into()
}

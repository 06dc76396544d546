//! An inner hull of fewer vertices, and how far from the whole it is at most.
//!
//! Vertices are taken one at a time, always the one farthest from the hull of those taken.
//! The Hausdorff distance of the two hulls is that of the farthest vertex left out, since the
//! distance to a convex set is a convex function; every distance here is that to a point of
//! the inner hull that is known, so that it is an upper bound whatever the search for the
//! nearest point is worth. Distances only fall while vertices are taken: one computed earlier
//! still bounds, and is computed again only when it is the largest.

use std::{cmp::Ordering, collections::BinaryHeap};

use glam::DVec3;

use super::{BuildError, ConvexHull, HullError, HullErrorKind, HullOptions, build};
use crate::contact::stop::{Meter, Stopped};
use crate::contact::tolerance::{DISTANCE_ITERATIONS, NOISE, U};

/// What a hull may be simplified to; a bound that is absent does not bind.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Simplification {
    /// At most so many vertices, at least 4.
    pub max_vertices: Option<u32>,
    /// The Hausdorff distance to the whole hull is at most this; caller's units.
    pub max_deviation: Option<f64>,
}

impl Simplification {
    fn check(&self) -> Result<(), HullError> {
        let refused =
            |detail| HullError { kind: HullErrorKind::SimplificationOutOfRange, index: None, detail };
        if let Some(vertices) = self.max_vertices.filter(|&vertices| vertices < 4) {
            return Err(refused(format!("max_vertices is {vertices}: no hull has fewer than 4")));
        }
        match self.max_deviation {
            Some(deviation) if !(deviation >= 0.0) => {
                Err(refused(format!("max_deviation is {deviation}, must be at least 0")))
            }
            _ => Ok(()),
        }
    }
}

/// The hull of some of `given`'s vertices, about the contraction point of the whole.
///
/// Where the deviation would allow a hull that is flat, or does not have the contraction
/// point inside, more vertices are taken.
pub(super) fn simplified(
    given: &[[f64; 3]],
    options: &HullOptions,
    wanted: &Simplification,
    meter: &Meter<'_>,
) -> Result<ConvexHull, BuildError> {
    wanted.check()?;
    // The limit is for the hull that is kept, which is the simplified one.
    let whole = build::build(given, &HullOptions { max_vertices: usize::MAX, ..*options }, meter)?;
    let most = wanted.max_vertices.map_or(usize::MAX, |most| most as usize);
    let limit = options.max_vertices;
    let too_many = || HullError {
        kind: HullErrorKind::TooManyVertices,
        index: None,
        detail: format!(
            "the simplified hull needs more than {limit} vertices, at most {limit} are allowed: \
             ask for fewer, or for a larger deviation"
        ),
    };
    if wanted.max_deviation.is_none() && most.min(whole.vertices().len()) > limit {
        return Err(too_many().into());
    }
    let mut inner = Inner::new(whole.vertices());
    loop {
        if inner.taken.len() > limit {
            return Err(too_many().into());
        }
        // Bounds are of the vertices of the whole, each rounded once.
        let deviation = match inner.farthest(meter)? {
            None => 0.0,
            Some(distance) => (distance + NOISE * U) * whole.scale(),
        };
        let enough = wanted.max_deviation.is_none_or(|limit| deviation <= limit);
        let unbounded = wanted.max_deviation.is_none() && inner.taken.len() < most;
        let complete = inner.farthest(meter)?.is_none();
        if !complete && (!enough || unbounded) && inner.taken.len() < most {
            inner.take(meter)?;
            continue;
        }
        if !enough {
            let detail = format!("{most} vertices leave a deviation of {deviation:e}");
            return Err(
                HullError { kind: HullErrorKind::SimplificationNotPossible, index: None, detail }.into()
            );
        }
        match of_some(given, &whole, &inner.taken, deviation, limit, meter) {
            Err(BuildError::Hull(_)) if !complete && inner.taken.len() < most => inner.take(meter)?,
            result => return result,
        }
    }
}

/// The hull of these vertices of `whole`, named as `whole` names them.
fn of_some(
    given: &[[f64; 3]],
    whole: &ConvexHull,
    taken: &[u32],
    deviation: f64,
    max_vertices: usize,
    meter: &Meter<'_>,
) -> Result<ConvexHull, BuildError> {
    let mut registered: Vec<u32> = taken.iter().map(|&v| whole.registered[v as usize]).collect();
    registered.sort_unstable();
    let points: Vec<[f64; 3]> = registered.iter().map(|&i| given[i as usize]).collect();
    let contraction_point = Some(whole.contraction_point.to_array());
    let planarity = Some(whole.planarity);
    let options = HullOptions { contraction_point, max_vertices, planarity, simplification: None };
    let mut hull = build::build(&points, &options, meter)?;
    hull.registered.iter_mut().for_each(|v| *v = registered[*v as usize]);
    hull.registered_count = whole.registered_count;
    hull.deviation = deviation;
    Ok(hull)
}

/// A vertex left out: at most so far from the hull of those taken.
struct Left {
    distance: f64,
    vertex: u32,
    /// How many had been taken when it was computed.
    at: usize,
}

impl PartialEq for Left {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Left {}

impl PartialOrd for Left {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Left {
    /// Of equals the lower vertex is the larger, to be taken first.
    fn cmp(&self, other: &Self) -> Ordering {
        self.distance.total_cmp(&other.distance).then(other.vertex.cmp(&self.vertex))
    }
}

/// The inner hull, being made.
struct Inner<'a> {
    vertices: &'a [DVec3],
    taken: Vec<u32>,
    points: Vec<DVec3>,
    left: BinaryHeap<Left>,
}

impl<'a> Inner<'a> {
    /// With the vertex farthest from the centre.
    fn new(vertices: &'a [DVec3]) -> Self {
        let farther = |&v: &usize, &w: &usize| {
            vertices[v].length_squared().total_cmp(&vertices[w].length_squared()).then(w.cmp(&v))
        };
        let first = (0..vertices.len()).max_by(farther).unwrap_or(0);
        let rest = (0..vertices.len()).filter(|&v| v != first);
        let left = rest.map(|v| Left { distance: f64::INFINITY, vertex: v as u32, at: 0 }).collect();
        Self { vertices, taken: vec![first as u32], points: vec![vertices[first]], left }
    }

    /// Upper bound of the distance of the farthest vertex left out; none when none is.
    fn farthest(&mut self, meter: &Meter<'_>) -> Result<Option<f64>, Stopped> {
        loop {
            let Some(mut top) = self.left.peek_mut() else { return Ok(None) };
            if top.at == self.taken.len() {
                return Ok(Some(top.distance));
            }
            let bound = distance(self.vertices[top.vertex as usize], &self.points, meter)?;
            // A bound from before holds too.
            top.distance = top.distance.min(bound);
            top.at = self.taken.len();
        }
    }

    /// Takes the farthest.
    fn take(&mut self, meter: &Meter<'_>) -> Result<(), Stopped> {
        if self.farthest(meter)?.is_some()
            && let Some(left) = self.left.pop()
        {
            self.taken.push(left.vertex);
            self.points.push(self.vertices[left.vertex as usize]);
        }
        Ok(())
    }
}

/// Upper bound of the distance of `target` from the hull of `points`, hull units: that to a
/// point of it, found as GJK does (Gilbert, Johnson and Keerthi, 1988).
fn distance(target: DVec3, points: &[DVec3], meter: &Meter<'_>) -> Result<f64, Stopped> {
    let mut simplex = Corners::default().with(points[0]);
    let mut shortest = f64::INFINITY;
    for _ in 0..DISTANCE_ITERATIONS {
        meter.spend(300 + points.len() as u64)?;
        let (nearest, kept) = nearest(target, &simplex);
        let away = target - nearest;
        // Less would be rounding: the bound is what was reached.
        if !(away.length() < shortest * (1.0 - NOISE * U)) {
            break;
        }
        shortest = away.length();
        let height = |p: DVec3| away.dot(p);
        let next = points.iter().fold(points[0], |best, &p| if height(p) > height(best) { p } else { best });
        if height(next) <= height(nearest) || kept.has(next) {
            break;
        }
        simplex = kept.with(next);
    }
    // Points are within 1 of the centre, weights sum to 1 within rounding.
    Ok(shortest + NOISE * U)
}

/// At most four points.
#[derive(Clone, Copy, Default)]
struct Corners {
    points: [DVec3; 4],
    len: usize,
}

impl Corners {
    fn points(&self) -> &[DVec3] {
        &self.points[..self.len]
    }

    fn has(&self, p: DVec3) -> bool {
        self.points().contains(&p)
    }

    /// With another, of at most three.
    fn with(mut self, p: DVec3) -> Self {
        self.points[self.len] = p;
        self.len += 1;
        self
    }
}

/// The point of the hull of some points that is nearest to `target`, and those whose hull it
/// is in.
fn nearest(target: DVec3, simplex: &Corners) -> (DVec3, Corners) {
    let mut best = (simplex.points[0], Corners::default().with(simplex.points[0]));
    // The faces of every dimension.
    for face in 1_u32..1 << simplex.len {
        let chosen = simplex.points().iter().enumerate().filter(|(i, _)| face >> i & 1 == 1);
        let corners = chosen.fold(Corners::default(), |corners, (_, &p)| corners.with(p));
        if let Some(foot) = foot(target, corners.points())
            && foot.distance_squared(target) < best.0.distance_squared(target)
        {
            best = (foot, corners);
        }
    }
    // Four points that surround the target leave no room for a fifth, and need none.
    if best.1.len == 4 {
        best.1.len = 3;
    }
    best
}

/// The foot of the perpendicular from `target`, where it is inside; of four points `target`
/// itself, where they surround it. Whatever rounding does to the weights, they are not
/// negative and sum to 1: the foot is a point of the hull.
fn foot(target: DVec3, corners: &[DVec3]) -> Option<DVec3> {
    let weights = match *corners {
        [_] => [1.0, 0.0, 0.0, 0.0],
        [a, b] => {
            let (ab, at) = (b - a, target - a);
            let t = at.dot(ab) / ab.length_squared();
            [1.0 - t, t, 0.0, 0.0]
        }
        [a, b, c] => {
            let n = (b - a).cross(c - a);
            let part = |u: DVec3, v: DVec3| n.dot((u - target).cross(v - target)) / n.length_squared();
            [part(b, c), part(c, a), part(a, b), 0.0]
        }
        [a, b, c, d] => {
            let volume = |p: DVec3, q: DVec3, r: DVec3, s: DVec3| (q - p).cross(r - p).dot(s - p);
            let whole = volume(a, b, c, d);
            let parts = [
                volume(target, b, c, d),
                volume(a, target, c, d),
                volume(a, b, target, d),
                volume(a, b, c, target),
            ];
            parts.map(|part| part / whole)
        }
        _ => return None,
    };
    let sum: f64 = weights.iter().sum();
    let inside = weights.iter().all(|&w| w >= 0.0) && sum > 0.0 && sum.is_finite();
    inside.then(|| corners.iter().zip(&weights).map(|(&p, &w)| p * (w / sum)).sum())
}

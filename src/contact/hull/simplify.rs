//! An inner hull of fewer vertices, and how far from the whole it is at most.
//!
//! Vertices are taken one at a time, always the one farthest from the hull of those taken.
//! The Hausdorff distance of the two hulls is that of the farthest vertex left out, since the
//! distance to a convex set is a convex function. Every distance here is the distance to a
//! known point of the inner hull, so it is an upper bound even if the search for the nearest
//! point ends early. Distances only fall while vertices are taken: a distance that was computed
//! earlier still bounds, and is computed again only when it is the largest (a lazy priority
//! queue; M. Minoux, *Accelerated greedy algorithms for maximizing submodular set functions*,
//! 1978, doi:10.1007/BFb0006528).
//!
//! ```text
//! taken = [the vertex farthest from the centre]
//! while more vertices are wanted: take the farthest one left out
//! while no hull can be built of the taken ones about the contraction point: take the farthest
//! ```
//!
//! A vertex left out is computed some five times, each time by some ten questions to a tree of
//! points ([`points`]). So `n` vertices take about `n` times the time of a question, which
//! grows more slowly than the square root of `n`.
//!
//! The second loop does not build a hull for every vertex. While the contraction point is not
//! inside the hull of `k` vertices by more than rounding, it is not inside the hull of any
//! earlier ones either. So the last such `k` is found by doubling and halving, and hulls are
//! built only from there on.

use std::{cmp::Ordering, collections::BinaryHeap};

use super::solid::Solid;
use super::{BuildError, ConvexHull, HullError, HullErrorKind, HullOptions, build};
use crate::contact::stop::{Meter, Stopped};
use crate::contact::tolerance::{NOISE, U};
use distance::{Trace, distance};
use points::PointTree;

mod distance;
mod points;

/// The bounds of a simplified hull; an absent bound does not bind.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Simplification {
    /// The most vertices, at least 4.
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
    let limit = options.max_vertices;
    let within_limit = |count: usize| if count <= limit { Ok(()) } else { Err(too_many_vertices(limit)) };
    let all = whole.vertex_count();
    let most = wanted.max_vertices.map_or(all, |most| all.min(most as usize));
    let mut inner = Inner::new(given, &whole, meter)?;
    // As many as the options ask for.
    let is_enough = |deviation: f64| wanted.max_deviation.is_none_or(|limit| deviation <= limit);
    let mut count = if wanted.max_deviation.is_none() { most } else { 1 };
    within_limit(count)?;
    let mut deviation = inner.deviation(count, meter)?;
    while count < most && !is_enough(deviation) {
        count += 1;
        within_limit(count)?;
        deviation = inner.deviation(count, meter)?;
    }
    if !is_enough(deviation) {
        let detail = format!("{most} vertices leave a deviation of {deviation:e}");
        return Err(HullError { kind: HullErrorKind::SimplificationNotPossible, index: None, detail }.into());
    }
    // As many more as a hull about the contraction point needs.
    let mut skipped = false;
    loop {
        within_limit(count)?;
        match inner.hull(count, meter) {
            Err(BuildError::Hull(_)) if count < most => {}
            result => return result,
        }
        if !skipped {
            count = inner.last_without_hull(count, most, meter)?;
            skipped = true;
        }
        count += 1;
    }
}

fn too_many_vertices(limit: usize) -> HullError {
    HullError {
        kind: HullErrorKind::TooManyVertices,
        index: None,
        detail: format!(
            "the simplified hull needs more than {limit} vertices, at most {limit} are allowed: \
             ask for fewer, or for a larger deviation"
        ),
    }
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
    /// If two are equal, the lower vertex is the larger, to be taken first.
    fn cmp(&self, other: &Self) -> Ordering {
        self.distance.total_cmp(&other.distance).then(other.vertex.cmp(&self.vertex))
    }
}

/// The inner hull, being made.
struct Inner<'a> {
    given: &'a [[f64; 3]],
    whole: &'a ConvexHull,
    /// Vertices of the whole, in the order in which they were taken.
    taken: Vec<u32>,
    /// For each number of vertices, less one, the deviation that they leave; caller's units.
    deviations: Vec<f64>,
    points: PointTree,
    /// The traces of the vertices, by their indices.
    traces: Vec<Trace>,
    left: BinaryHeap<Left>,
}

impl<'a> Inner<'a> {
    /// With the vertex farthest from the centre.
    fn new(given: &'a [[f64; 3]], whole: &'a ConvexHull, meter: &Meter<'_>) -> Result<Self, Stopped> {
        let vertices = whole.vertices();
        let farther = |&v: &usize, &w: &usize| {
            vertices[v].length_squared().total_cmp(&vertices[w].length_squared()).then(w.cmp(&v))
        };
        let first = (0..vertices.len()).max_by(farther).unwrap_or(0);
        let rest = (0..vertices.len()).filter(|&v| v != first);
        let left = rest.map(|v| Left { distance: f64::INFINITY, vertex: v as u32, at: 0 }).collect();
        let points = PointTree::new(vertices, first as u32, meter)?;
        let (taken, traces) = (vec![first as u32], vec![Trace::default(); vertices.len()]);
        Ok(Self { given, whole, taken, deviations: Vec::new(), points, traces, left })
    }

    /// How far the hull of the first `count` vertices taken is from the whole at most.
    fn deviation(&mut self, count: usize, meter: &Meter<'_>) -> Result<f64, Stopped> {
        while self.deviations.len() < count {
            if self.taken.len() == self.deviations.len()
                && let Some(left) = self.left.pop()
            {
                self.points.add(left.vertex);
                self.taken.push(left.vertex);
            }
            // Bounds are of the vertices of the whole, each rounded once.
            let deviation = match self.farthest(meter)? {
                None => 0.0,
                Some(distance) => (distance + NOISE * U) * self.whole.scale(),
            };
            self.deviations.push(deviation);
        }
        Ok(self.deviations[count - 1])
    }

    /// Upper bound of the distance of the farthest vertex left out; none if none is left out.
    fn farthest(&mut self, meter: &Meter<'_>) -> Result<Option<f64>, Stopped> {
        loop {
            let Some(mut top) = self.left.peek_mut() else { return Ok(None) };
            if top.at == self.taken.len() {
                return Ok(Some(top.distance));
            }
            let vertex = top.vertex as usize;
            let trace = &mut self.traces[vertex];
            let bound = distance(self.whole.vertices()[vertex], &self.points, trace, meter)?;
            // A bound from before holds too.
            top.distance = top.distance.min(bound);
            top.at = self.taken.len();
        }
    }

    /// The registered indices of the first `count` vertices taken, ascending, and their points.
    fn registered(&mut self, count: usize, meter: &Meter<'_>) -> Result<(Vec<u32>, Vec<[f64; 3]>), Stopped> {
        self.deviation(count, meter)?;
        let mut registered: Vec<u32> =
            self.taken[..count].iter().map(|&v| self.whole.registered[v as usize]).collect();
        registered.sort_unstable();
        let points = registered.iter().map(|&i| self.given[i as usize]).collect();
        Ok((registered, points))
    }

    /// The hull of the first `count` vertices taken, named as the whole names them.
    fn hull(&mut self, count: usize, meter: &Meter<'_>) -> Result<ConvexHull, BuildError> {
        let (registered, points) = self.registered(count, meter)?;
        let contraction_point = Some(self.whole.contraction_point.to_array());
        let planarity = Some(self.whole.planarity);
        let options =
            HullOptions { contraction_point, planarity, max_vertices: usize::MAX, simplification: None };
        let mut hull = build::build(&points, &options, meter)?;
        hull.registered.iter_mut().for_each(|v| *v = registered[*v as usize]);
        hull.registered_count = self.whole.registered_count;
        hull.deviation = self.deviation(count, meter)?;
        Ok(hull)
    }

    /// The last number of vertices, from `count` to below `most`, of which certainly no hull can
    /// be built: by doubling the step while there is none, and then by halving it.
    fn last_without_hull(
        &mut self,
        count: usize,
        most: usize,
        meter: &Meter<'_>,
    ) -> Result<usize, BuildError> {
        let (mut without, mut open) = (count, most);
        let mut step = 1;
        while without + step < open {
            if self.certainly_has_none(without + step, meter)? {
                without += step;
                step *= 2;
            } else {
                open = without + step;
            }
        }
        while without + 1 < open {
            let middle = usize::midpoint(without, open);
            if self.certainly_has_none(middle, meter)? { without = middle } else { open = middle }
        }
        Ok(without)
    }

    /// Whether certainly no hull can be built of the first `count` vertices taken, nor of fewer:
    /// they are flat, or the contraction point is not inside.
    fn certainly_has_none(&mut self, count: usize, meter: &Meter<'_>) -> Result<bool, BuildError> {
        let (_, points) = self.registered(count, meter)?;
        match Solid::new(&points, meter) {
            Ok(solid) => {
                let (normals, _) = solid.normals(meter)?;
                Ok(!solid.may_surround(self.whole.contraction_point, &normals, meter)?)
            }
            Err(BuildError::Hull(error)) => Ok(matches!(
                error.kind,
                HullErrorKind::TooFewPoints
                    | HullErrorKind::Collinear
                    | HullErrorKind::Coplanar
                    | HullErrorKind::SizeOutOfRange
            )),
            Err(BuildError::Stopped) => Err(BuildError::Stopped),
        }
    }
}

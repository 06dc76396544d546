//! Simplification: an inner hull of fewer vertices, and a bound of how far it is from the whole.
//!
//! Vertices are taken greedily, one at a time: always the vertex that is farthest from the hull
//! of the vertices taken so far.
//!
//! ```text
//! taken = [the vertex farthest from the contraction point]
//! while the limits ask for more vertices:
//!     take the vertex farthest from the hull of `taken`
//! while no hull of `taken` can be built about the contraction point:
//!     take the vertex farthest from the hull of `taken`
//! ```
//!
//! The Hausdorff distance between the two hulls (the *deviation*) is the distance of the farthest
//! vertex that was left out: the distance to a convex set is a convex function, so its largest
//! value over the whole hull is at a vertex. Each distance is computed as the distance to a known
//! point of the inner hull ([`mod@distance`]). So it is an upper bound even if the search for the
//! nearest point ends early. The greedy order gives nested hulls and a deviation after every vertex,
//! so one pass serves both limits.
//!
//! Distances only fall while vertices are taken. A distance that was computed earlier is therefore
//! still an upper bound, and is computed again only when it is the largest of all: a lazy priority
//! queue (M. Minoux, *Accelerated greedy algorithms for maximizing submodular set functions*,
//! 1978, doi:10.1007/BFb0006528). The distance of a vertex is computed about five times, and each
//! computation asks a tree of points ([`points`]) about ten questions. So simplifying `n` vertices
//! takes about `n` times the time of one question, which grows more slowly than the square root of
//! `n`. Without the queue and the tree the time would grow with the cube of `n`.
//!
//! The second loop does not try to build a hull after every vertex. If the contraction point is
//! not inside the hull of the first `k` vertices by more than rounding, it is not inside the hull
//! of fewer vertices either. So the last such `k` is found by doubling and halving the step, and
//! hulls are built only from there on.

use std::{cmp::Ordering, collections::BinaryHeap};

use super::error::plain;
use super::solid::Solid;
use super::{BoxRow, BuildError, ConvexHull, HullError, HullErrorKind, HullOptions, build};
use crate::stop::{Meter, Stopped};
use crate::tolerance::{NOISE, U};
use distance::{Trace, distance};
use points::PointTree;

mod distance;
mod points;

/// The limits of a simplified hull. A limit that is absent does not apply.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Simplification {
    /// The largest number of vertices; at least 4.
    pub max_vertices: Option<u32>,
    /// The largest Hausdorff distance to the whole hull; caller's units, at least 0.
    pub max_deviation: Option<f64>,
}

impl Simplification {
    fn check(&self) -> Result<(), HullError> {
        let refused =
            |detail| HullError { kind: HullErrorKind::SimplificationOutOfRange, index: None, detail };
        if let Some(vertices) = self.max_vertices.filter(|&vertices| vertices < 4) {
            return Err(refused(format!("max_vertices is {vertices}, must be at least 4")));
        }
        match self.max_deviation {
            Some(deviation) if !(deviation >= 0.0) => {
                Err(refused(format!("max_deviation is {}, must be at least 0", plain(deviation))))
            }
            _ => Ok(()),
        }
    }
}

/// Builds the simplified hull of the points `given`, about the contraction point of the whole hull.
///
/// If the vertices that satisfy the deviation make a flat hull, or a hull that does not have the
/// contraction point inside, more vertices are taken.
pub(super) fn simplified(
    given: &[[f64; 3]],
    options: &HullOptions,
    wanted: &Simplification,
    meter: &Meter<'_>,
) -> Result<ConvexHull, BuildError> {
    wanted.check()?;
    // The vertex limit applies to the simplified hull, so the whole hull has none.
    let whole = build::build(given, &HullOptions { max_vertices: usize::MAX, ..*options }, meter)?;
    let limit = options.max_vertices;
    let within_limit = |count: usize| if count <= limit { Ok(()) } else { Err(too_many_vertices(limit)) };
    let all = whole.vertex_count();
    let most = wanted.max_vertices.map_or(all, |most| all.min(most as usize));
    let mut inner = Inner::new(given, &whole, meter)?;
    // Take as many vertices as the limits ask for.
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
        let deviation = plain(deviation);
        let detail = format!(
            "with {most} vertices the deviation is {deviation}: allow more vertices or a larger deviation"
        );
        return Err(HullError { kind: HullErrorKind::SimplificationNotPossible, index: None, detail }.into());
    }
    // Take as many more as a hull about the contraction point needs.
    let mut skipped = false;
    loop {
        within_limit(count)?;
        match inner.hull(count, meter) {
            Err(BuildError::Hull(_)) if count < most => {}
            // The whole hull could be built, so the fault is that too few of its vertices are left.
            Err(BuildError::Hull(error)) if most < all => return Err(too_few_vertices(error, most).into()),
            result => return result,
        }
        if !skipped {
            count = inner.last_without_hull(count, most, meter)?;
            skipped = true;
        }
        count += 1;
    }
}

fn too_few_vertices(error: HullError, most: usize) -> HullError {
    let detail = format!("with {most} vertices, as max_vertices asks, {}: allow more vertices", error.detail);
    HullError { detail, ..error }
}

fn too_many_vertices(limit: usize) -> HullError {
    HullError {
        kind: HullErrorKind::TooManyVertices,
        index: None,
        detail: format!(
            "the simplified hull needs more than the {limit} vertices that are allowed: \
             set max_vertices, or allow a larger deviation"
        ),
    }
}

/// A vertex that is left out so far.
struct Left {
    /// An upper bound of its distance from the hull of the vertices taken; hull units.
    distance: f64,
    vertex: u32,
    /// The number of vertices that had been taken when the bound was computed.
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
    /// If two distances are equal, the vertex with the lower index counts as larger, so that it is
    /// taken first.
    fn cmp(&self, other: &Self) -> Ordering {
        self.distance.total_cmp(&other.distance).then(other.vertex.cmp(&self.vertex))
    }
}

/// The inner hull while vertices are taken.
struct Inner<'a> {
    given: &'a [[f64; 3]],
    whole: &'a ConvexHull,
    /// Vertices of the whole hull, in the order in which they were taken.
    taken: Vec<u32>,
    /// `deviations[k]` is the deviation that the first `k + 1` vertices leave; caller's units.
    deviations: Vec<f64>,
    points: PointTree,
    /// For each vertex of the whole hull, the trace of its last distance.
    traces: Vec<Trace>,
    left: BinaryHeap<Left>,
}

impl<'a> Inner<'a> {
    /// Starts with the vertex farthest from the contraction point.
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

    /// The deviation that the first `count` vertices leave, an upper bound; caller's units. Takes
    /// vertices until there are `count`.
    fn deviation(&mut self, count: usize, meter: &Meter<'_>) -> Result<f64, Stopped> {
        while self.deviations.len() < count {
            if self.taken.len() == self.deviations.len()
                && let Some(left) = self.left.pop()
            {
                self.points.add(left.vertex);
                self.taken.push(left.vertex);
            }
            // The distances are between vertices in hull units, each of which was rounded once.
            let deviation = match self.farthest(meter)? {
                None => 0.0,
                Some(distance) => (distance + NOISE * U) * self.whole.scale(),
            };
            self.deviations.push(deviation);
        }
        Ok(self.deviations[count - 1])
    }

    /// An upper bound of the distance of the farthest vertex left out; hull units. `None` if no
    /// vertex is left out.
    fn farthest(&mut self, meter: &Meter<'_>) -> Result<Option<f64>, Stopped> {
        loop {
            let Some(mut top) = self.left.peek_mut() else { return Ok(None) };
            if top.at == self.taken.len() {
                return Ok(Some(top.distance));
            }
            let vertex = top.vertex as usize;
            let trace = &mut self.traces[vertex];
            let bound = distance(self.whole.vertices()[vertex], &self.points, trace, meter)?;
            // The earlier bound still holds, so keep the smaller one.
            top.distance = top.distance.min(bound);
            top.at = self.taken.len();
        }
    }

    /// The registered indices of the first `count` vertices taken, ascending, and the given points
    /// of these indices.
    fn registered(&mut self, count: usize, meter: &Meter<'_>) -> Result<(Vec<u32>, Vec<[f64; 3]>), Stopped> {
        self.deviation(count, meter)?;
        let mut registered: Vec<u32> =
            self.taken[..count].iter().map(|&v| self.whole.registered[v as usize]).collect();
        registered.sort_unstable();
        let points = registered.iter().map(|&i| self.given[i as usize]).collect();
        Ok((registered, points))
    }

    /// Builds the hull of the first `count` vertices taken. Its registered indices are those of the
    /// whole hull.
    fn hull(&mut self, count: usize, meter: &Meter<'_>) -> Result<ConvexHull, BuildError> {
        let (registered, points) = self.registered(count, meter)?;
        let contraction_point = Some(self.whole.contraction_point.to_array());
        let planarity = Some(self.whole.planarity);
        let options =
            HullOptions { contraction_point, planarity, max_vertices: usize::MAX, simplification: None };
        let mut hull = build::build(&points, &options, meter)?;
        hull.registered.iter_mut().for_each(|v| *v = registered[*v as usize]);
        hull.registered_count = self.whole.registered_count;
        hull.box_row = BoxRow::of(&hull);
        hull.deviation = self.deviation(count, meter)?;
        Ok(hull)
    }

    /// The largest number of vertices, from `count` to below `most`, for which certainly no hull
    /// can be built. The search doubles its step while there is no hull, and then bisects.
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

    /// Whether certainly no hull can be built from the first `count` vertices taken, nor from
    /// fewer, because they are flat or the contraction point is not inside.
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

//! A scene: hulls, bodies and pairs, and the checks that make it safe to compute.
//!
//! [`Scene`] is the form in which a program states a scene. [`Scene::batch`] checks it completely. A service
//! that keeps parts of a scene from one query to the next checks and keeps the parts by themselves:
//! [`SceneTemplate`] is everything except the poses, [`Poses`] are the poses, and [`Bodies`] are both with their
//! hulls.

mod fault;
mod poses;

use std::sync::Arc;

use hullcast_contact::{Accuracy, Body, Bounds, ConvexHull, Pose, Query, Stop, approach, stop::Meter};

pub use self::{
    fault::{FaultKind, SceneError, SceneFault},
    poses::Poses,
};
use crate::{
    batch::Batch,
    motion::{MotionColumns, Motions, check_margins},
    outputs::Outputs,
};

/// Indices that are compared between two checks of the stop flag.
const AT_A_TIME: usize = 1 << 16;

/// The margin with which bounds are computed is at most this. Positions are within 1e100, so that bounds with
/// a larger margin meet all others too.
const LARGEST_MARGIN: f64 = 1e101;

/// The reason why a hull is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missing {
    /// There is no such hull. The caller should register it (again).
    Unknown,
    /// The hull could not be read. The caller should retry.
    Unavailable,
}

/// The hulls of a scene. A missing hull makes only the pairs of its bodies INVALID.
pub type Hulls = Vec<Result<Arc<ConvexHull>, Missing>>;

/// A scene as a program states it. Its default is an empty scene with the default accuracy and outputs.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// The hulls.
    pub hulls: Hulls,
    /// For each body, an index into `hulls`.
    pub body_hulls: Vec<u32>,
    /// For each body, the world position of its hull's frame: 3 numbers.
    pub positions: Vec<f64>,
    /// For each body, its rotation as a quaternion `x, y, z, w`: 4 numbers. It need not be normalised.
    pub rotations: Vec<f64>,
    /// The pairs to compute, as 2 indices of bodies each. Empty for a search for pairs.
    pub pairs: Vec<u32>,
    /// Empty, or the bases of an earlier answer for the same pairs: 6 numbers per pair. They change only the
    /// time that the computation takes.
    pub warm_starts: Vec<u32>,
    /// Contact points are computed for hulls within this distance, in the caller's units.
    pub margin: f64,
    /// Empty, or for each body a length, 0 to 1e100. The margin of a pair is `margin` plus those of its bodies.
    pub margins: Vec<f64>,
    /// The motion of the bodies. It widens the margin of each pair by the largest distance by which its bodies
    /// approach each other in the time step.
    pub motion: MotionColumns,
    /// Settings that trade accuracy for speed.
    pub accuracy: Accuracy,
    /// The parts of the answer to compute.
    pub outputs: Outputs,
}

/// Checks that a column has `expected` entries. `rule` says why.
///
/// # Errors
/// The column has another number of entries.
pub fn has_length(found: usize, expected: usize, field: &'static str, rule: &str) -> Result<(), SceneFault> {
    if found == expected {
        return Ok(());
    }
    let message = format!("got {found} entries, expected {expected} ({rule})");
    Err(SceneFault::new(FaultKind::Length, field, message))
}

/// Checks the lengths of the columns of poses.
///
/// # Errors
/// A column has another number of entries than the bodies need.
pub fn pose_lengths(bodies: usize, positions: &[f64], rotations: &[f64]) -> Result<(), SceneFault> {
    has_length(positions.len(), 3 * bodies, "positions", "3 per body")?;
    has_length(rotations.len(), 4 * bodies, "rotations", "4 per body")
}

/// Checks the lengths of the columns of pairs and of their warm starts.
///
/// # Errors
/// There is half a pair, or the warm starts are not those of these pairs.
pub fn pair_lengths(pairs: &[u32], warm_starts: &[u32]) -> Result<(), SceneFault> {
    has_length(pairs.len(), pairs.len() & !1, "pairs", "2 per pair")?;
    if warm_starts.is_empty() {
        return Ok(());
    }
    has_length(warm_starts.len(), 3 * pairs.len(), "warm_starts", "none or 6 per pair")
}

/// Checks a margin.
///
/// # Errors
/// The margin is negative or NaN.
pub fn check_margin(margin: f64) -> Result<(), SceneFault> {
    if margin >= 0.0 { Ok(()) } else { Err(SceneFault::out_of_range("margin", margin, "at least 0")) }
}

/// Checks the margin of a search for pairs.
///
/// # Errors
/// The margin is infinite.
pub fn check_finite(margin: f64) -> Result<(), SceneFault> {
    if margin != f64::INFINITY {
        return Ok(());
    }
    Err(SceneFault::out_of_range("margin", margin, "finite, otherwise every pair would be found"))
}

fn check_accuracy(accuracy: &Accuracy) -> Result<(), SceneFault> {
    let Accuracy { relative_tolerance, feature_angle, max_iterations, .. } = *accuracy;
    if !(0.0..=1.0).contains(&relative_tolerance) {
        return Err(SceneFault::out_of_range("accuracy.relative_tolerance", relative_tolerance, "0 to 1"));
    }
    if !(0.0..=0.5).contains(&feature_angle) {
        return Err(SceneFault::out_of_range("accuracy.feature_angle", feature_angle, "0 to 0.5"));
    }
    if max_iterations == 0 {
        return Err(SceneFault::out_of_range("accuracy.max_iterations", 0.0, "at least 1"));
    }
    Ok(())
}

fn all_below(
    column: &[u32],
    count: usize,
    field: &'static str,
    [one, many]: [&str; 2],
    meter: &Meter<'_>,
) -> Result<(), SceneError> {
    for (first, some) in (0..).step_by(AT_A_TIME).zip(column.chunks(AT_A_TIME)) {
        meter.spend(some.len() as u64)?;
        // Every index of every scene is compared, so the largest is found with a loop that the compiler
        // vectorises.
        let largest = some.iter().fold(0, |largest, &index| largest.max(index));
        if (largest as usize) < count {
            continue;
        }
        if let Some(at) = some.iter().position(|&index| index as usize >= count) {
            let noun = if count == 1 { one } else { many };
            let message = format!("{one} index {} is out of range: the scene has {count} {noun}", some[at]);
            let fault = SceneFault::new(FaultKind::Index, field, message);
            return Err(SceneFault { index: Some(first + at), ..fault }.into());
        }
    }
    Ok(())
}

/// A scene without its hulls and poses: the part that does not change while bodies move.
#[derive(Clone, Debug)]
pub struct SceneTemplate {
    hull_count: usize,
    body_hulls: Vec<u32>,
    pairs: Vec<u32>,
    /// Empty, or the margin of each body.
    margins: Vec<f64>,
    query: Query,
    outputs: Outputs,
}

impl SceneTemplate {
    /// Bodies of a scene with `hulls` hulls, and pairs of these bodies. The query is the default one.
    ///
    /// # Errors
    /// There is half a pair, an index is too large, or the check was stopped.
    pub fn new(
        hulls: usize,
        body_hulls: Vec<u32>,
        pairs: Vec<u32>,
        meter: &Meter<'_>,
    ) -> Result<Self, SceneError> {
        pair_lengths(&pairs, &[])?;
        all_below(&body_hulls, hulls, "body_hulls", ["hull", "hulls"], meter)?;
        all_below(&pairs, body_hulls.len(), "pairs", ["body", "bodies"], meter)?;
        let (margins, query, outputs) = (Vec::new(), Query::default(), Outputs::default());
        Ok(Self { hull_count: hulls, body_hulls, pairs, margins, query, outputs })
    }

    /// The same template with these margins of the bodies: none, or one per body.
    ///
    /// # Errors
    /// There is another number of margins, a margin is outside 0 to 1e100, or the check was stopped.
    pub fn with_margins(self, margins: Vec<f64>, meter: &Meter<'_>) -> Result<Self, SceneError> {
        check_margins(&margins, self.body_count(), meter)?;
        Ok(Self { margins, ..self })
    }

    /// The same template with this query for every pair.
    ///
    /// # Errors
    /// The margin or a field of the accuracy is outside its range.
    pub fn with_query(self, margin: f64, accuracy: Accuracy, outputs: Outputs) -> Result<Self, SceneFault> {
        check_margin(margin)?;
        check_accuracy(&accuracy)?;
        let query = Query { margin, accuracy, wanted: outputs.wanted() };
        Ok(Self { query, outputs, ..self })
    }

    /// For each body, the index of its hull.
    pub fn body_hulls(&self) -> &[u32] {
        &self.body_hulls
    }

    /// The number of bodies.
    pub fn body_count(&self) -> usize {
        self.body_hulls.len()
    }

    /// 2 indices of bodies per pair.
    pub fn pairs(&self) -> &[u32] {
        &self.pairs
    }

    /// The number of pairs.
    pub fn pair_count(&self) -> usize {
        self.pairs.len() / 2
    }

    /// The bodies of a pair.
    pub(crate) fn pair(&self, index: usize) -> [u32; 2] {
        [self.pairs[2 * index], self.pairs[2 * index + 1]]
    }

    /// Whether the pairs of another template are answered in the same way, apart from the margins of bodies.
    pub fn has_options_of(&self, other: &Self) -> bool {
        self.query == other.query && self.outputs == other.outputs
    }

    /// The margin of each body, or nothing if bodies have no margins of their own.
    pub fn margins(&self) -> &[f64] {
        &self.margins
    }

    /// The query for each pair. Its margin is the one that all pairs share.
    pub fn query(&self) -> &Query {
        &self.query
    }

    /// The parts of the answer that are asked for.
    pub fn outputs(&self) -> Outputs {
        self.outputs
    }

    /// The bytes of the template's columns.
    pub fn heap_bytes(&self) -> usize {
        size_of_val(&self.body_hulls[..]) + size_of_val(&self.pairs[..]) + size_of_val(&self.margins[..])
    }
}

/// The bodies of a scene: hulls at poses. Clones share them.
#[derive(Clone, Debug)]
pub struct Bodies {
    template: Arc<SceneTemplate>,
    hulls: Arc<Hulls>,
    poses: Arc<Poses>,
}

impl Bodies {
    /// Bodies with these hulls and poses.
    ///
    /// # Errors
    /// The numbers of hulls or of poses are not those of the template.
    pub fn new(
        template: Arc<SceneTemplate>,
        hulls: Arc<Hulls>,
        poses: Arc<Poses>,
    ) -> Result<Self, SceneFault> {
        has_length(hulls.len(), template.hull_count, "hulls", "as many as the bodies were checked with")?;
        has_length(poses.count(), template.body_count(), "positions", "one pose per body")?;
        Ok(Self { template, hulls, poses })
    }

    /// The template.
    pub fn template(&self) -> &Arc<SceneTemplate> {
        &self.template
    }

    /// The hulls.
    pub fn hulls(&self) -> &Hulls {
        &self.hulls
    }

    /// The number of bodies.
    pub fn count(&self) -> usize {
        self.template.body_count()
    }

    /// A body, or the first reason why it cannot be computed.
    pub(crate) fn hull(&self, body: u32) -> &Result<Arc<ConvexHull>, Missing> {
        &self.hulls[self.template.body_hulls[body as usize] as usize]
    }

    pub(crate) fn pose(&self, body: u32) -> Option<Pose> {
        self.poses.get(body as usize)
    }

    /// A body, or `None` if its hull is missing or its pose is not usable.
    pub(crate) fn body(&self, body: u32) -> Option<Body<'_>> {
        let hull = self.hull(body).as_ref().ok()?;
        Some(Body::new(hull, self.pose(body)?))
    }

    /// The query for a pair of bodies: that of the template, with the pair's own margin (see
    /// [`motion`](crate::motion)).
    pub(crate) fn query(&self, pair: [u32; 2], [a, b]: [&Body<'_>; 2]) -> Query {
        let mut query = *self.template.query();
        let margins = &self.template.margins[..];
        if !margins.is_empty() {
            let [a, b] = pair.map(|body| margins[body as usize]);
            query.margin += a + b;
        }
        let motions = self.poses.motions();
        if let Some(step) = motions.step() {
            let [of_a, of_b] = pair.map(|body| motions.get(body as usize).unwrap_or_default());
            let bound = approach((a.hull, &of_a), (b.hull, &of_b), step);
            if bound > 0.0 {
                query.margin = (query.margin + bound).next_up();
            }
        }
        query
    }

    /// A box around everything that a body may be in contact with, or `None` if the body is in no pair. Pairs
    /// of bodies whose boxes do not meet are SEPARATED at their margins.
    pub(crate) fn bounds(&self, index: u32) -> Option<Bounds> {
        let body = self.body(index)?;
        let mut reach = self.template.margins.get(index as usize).copied().unwrap_or_default();
        let motions = self.poses.motions();
        if let Some(step) = motions.step() {
            reach += motions.get(index as usize)?.reach(body.hull, step);
        }
        let margin = self.template.query().margin + 2.0 * reach;
        Some(body.bounds(margin.min(LARGEST_MARGIN)))
    }
}

impl Scene {
    /// The bodies of the scene, and the indices of the bodies without a usable pose.
    ///
    /// # Errors
    /// The first fault that is found, or that the check was stopped.
    pub fn bodies(self, stop: &Stop) -> Result<(Bodies, Vec<u32>), SceneError> {
        let meter = &Meter::new(stop);
        let template = SceneTemplate::new(self.hulls.len(), self.body_hulls, self.pairs, meter)?;
        let template = template.with_query(self.margin, self.accuracy, self.outputs)?;
        let template = template.with_margins(self.margins, meter)?;
        let bodies = template.body_count();
        let motions = Motions::new(bodies, self.motion)?;
        let (poses, invalid) = Poses::moving(bodies, self.positions, self.rotations, motions, meter)?;
        Ok((Bodies::new(Arc::new(template), Arc::new(self.hulls), Arc::new(poses))?, invalid))
    }

    /// The batch of the scene's pairs. Pairs of a missing hull or of a body without a usable pose have the
    /// outcome INVALID.
    ///
    /// # Errors
    /// The first fault that is found, or that the check was stopped.
    pub fn batch(mut self, stop: &Stop) -> Result<Batch, SceneError> {
        let warm_starts = std::mem::take(&mut self.warm_starts);
        let (bodies, _) = self.bodies(stop)?;
        Ok(Batch::new(bodies, warm_starts)?)
    }
}

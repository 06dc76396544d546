//! A scene: hulls, bodies and pairs, and the checks that make it safe to compute.
//!
//! [`Scene`] is the form in which a program states a scene. [`Scene::batch`] checks it completely. A service
//! that keeps parts of a scene from one query to the next checks and keeps the parts by themselves:
//! [`SceneTemplate`] is everything except the poses, [`Poses`] are the poses, and [`Bodies`] are both with their
//! hulls.

use std::sync::Arc;

use hullcast_contact::{Accuracy, Body, ConvexHull, Pose, Query, Stop, Stopped, stop::Meter};
use thiserror::Error;

use crate::{batch::Batch, outputs::Outputs};

/// Indices that are compared between two checks of the stop flag.
const AT_A_TIME: usize = 1 << 16;

/// Elementary steps of checking a pose.
const POSE_STEPS: u64 = 10;

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
    /// Settings that trade accuracy for speed.
    pub accuracy: Accuracy,
    /// The parts of the answer to compute.
    pub outputs: Outputs,
}

/// A fault of a scene.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{field}{}: {message}", .index.map(|index| format!("[{index}]")).unwrap_or_default())]
pub struct SceneFault {
    /// The kind of fault.
    pub kind: FaultKind,
    /// The field at fault; a dotted path for a field of the accuracy.
    pub field: &'static str,
    /// The index of the element at fault, if a single element is.
    pub index: Option<usize>,
    /// The value that was found and the values that are allowed.
    pub message: String,
}

/// The kinds of faults of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultKind {
    /// A column does not have one entry, or as many as are needed, for each body or pair.
    Length,
    /// An index is too large.
    Index,
    /// A number is outside its range.
    Value,
}

/// The reason why a scene cannot be computed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SceneError {
    /// The scene has a fault.
    #[error(transparent)]
    Fault(SceneFault),
    /// The check was stopped.
    #[error("{}", Stopped)]
    Stopped,
}

impl SceneFault {
    fn new(kind: FaultKind, field: &'static str, message: String) -> Self {
        Self { kind, field, index: None, message }
    }

    /// The fault of a number outside its range.
    pub fn out_of_range(field: &'static str, value: f64, rule: &str) -> Self {
        Self::new(FaultKind::Value, field, format!("got {value}, must be {rule}"))
    }
}

impl From<SceneFault> for SceneError {
    fn from(fault: SceneFault) -> Self {
        Self::Fault(fault)
    }
}

impl From<Stopped> for SceneError {
    fn from(_: Stopped) -> Self {
        Self::Stopped
    }
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
        let outputs = Outputs::default();
        Ok(Self { hull_count: hulls, body_hulls, pairs, query: Query::default(), outputs })
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

    /// Whether the pairs of another template are answered in the same way.
    pub fn has_options_of(&self, other: &Self) -> bool {
        self.query == other.query && self.outputs == other.outputs
    }

    /// The query for each pair.
    pub fn query(&self) -> &Query {
        &self.query
    }

    /// The parts of the answer that are asked for.
    pub fn outputs(&self) -> Outputs {
        self.outputs
    }

    /// The bytes of the template's columns.
    pub fn heap_bytes(&self) -> usize {
        size_of_val(&self.body_hulls[..]) + size_of_val(&self.pairs[..])
    }
}

/// Poses as they arrived. A body's pose is converted when one of its pairs is computed. So compute
/// threads do this work, and until then a pose takes 56 bytes instead of 104.
#[derive(Clone, Debug, Default)]
pub struct Poses {
    positions: Vec<f64>,
    rotations: Vec<f64>,
}

impl Poses {
    /// The poses of `bodies` bodies, and the indices of the bodies without a usable pose, in ascending order.
    /// Such a body makes only its own pairs INVALID.
    ///
    /// # Errors
    /// A column has another number of entries than the bodies need, or the check was stopped.
    pub fn new(
        bodies: usize,
        positions: Vec<f64>,
        rotations: Vec<f64>,
        meter: &Meter<'_>,
    ) -> Result<(Self, Vec<u32>), SceneError> {
        pose_lengths(bodies, &positions, &rotations)?;
        let bodies = positions.as_chunks::<3>().0.iter().zip(rotations.as_chunks::<4>().0);
        let unusable =
            |(position, rotation): (&[f64; 3], &[f64; 4])| Pose::check(*position, *rotation).is_err();
        // The unusable poses are counted first, so that the list is allocated once.
        let mut count = 0;
        for body in bodies.clone() {
            meter.spend(POSE_STEPS)?;
            count += usize::from(unusable(body));
        }
        let mut invalid = Vec::with_capacity(count);
        if count > 0 {
            let unusable = bodies.enumerate().filter(|(_, body)| unusable(*body));
            for (body, _) in unusable {
                meter.spend(POSE_STEPS)?;
                invalid.push(body as u32);
            }
        }
        Ok((Self { positions, rotations }, invalid))
    }

    /// The number of poses.
    pub fn count(&self) -> usize {
        self.positions.len() / 3
    }

    /// The bytes of the poses.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.positions[..]) + size_of_val(&self.rotations[..])
    }

    /// Whether a body and a body of `other` have poses with the same bits.
    pub(crate) fn is_same(&self, body: usize, other: &Self, its: usize) -> bool {
        let same =
            |one: &[f64], other: &[f64]| one.iter().zip(other).all(|(a, b)| a.to_bits() == b.to_bits());
        same(&self.positions[3 * body..][..3], &other.positions[3 * its..][..3])
            && same(&self.rotations[4 * body..][..4], &other.rotations[4 * its..][..4])
    }

    /// Exchanges the pose of a body with a pose of `other`. Returns whether they had different bits.
    pub(crate) fn exchange(&mut self, body: usize, other: &mut Self, its: usize) -> bool {
        let differ = !self.is_same(body, other, its);
        self.positions[3 * body..][..3].swap_with_slice(&mut other.positions[3 * its..][..3]);
        self.rotations[4 * body..][..4].swap_with_slice(&mut other.rotations[4 * its..][..4]);
        differ
    }

    /// The pose of a body, or `None` if it is not usable.
    pub fn get(&self, body: usize) -> Option<Pose> {
        let (positions, _) = self.positions.as_chunks::<3>();
        let (rotations, _) = self.rotations.as_chunks::<4>();
        Pose::new(positions[body], rotations[body]).ok()
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
        let (poses, invalid) = Poses::new(template.body_count(), self.positions, self.rotations, meter)?;
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

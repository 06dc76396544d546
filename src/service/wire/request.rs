//! Checks a query completely.

use std::{collections::HashSet, sync::Arc};

use crate::{
    budget::Permit,
    contact::{Accuracy, Pose, Query, Solver, Stop, stop::Meter},
    proto,
    service::{Outputs, error::ServiceError, limits::Limits},
    store::HullId,
};

/// Indices that are compared between two checks of the stop flag.
const AT_A_TIME: usize = 1 << 16;

/// Elementary steps of looking up a hull's id in a table.
const ID_STEPS: u64 = 100;

/// Elementary steps of checking a pose.
const POSE_STEPS: u64 = 10;

/// A checked request: all lengths fit, all indices are in range, all options are known.
#[derive(Debug)]
pub struct Scene {
    /// The request's id, which the answer repeats.
    pub request_id: u64,
    /// The hulls, bodies, pairs and options.
    pub setting: Arc<Setting>,
    /// The poses of the bodies.
    pub poses: Poses,
    /// The bodies without a usable pose, in ascending order.
    pub invalid_bodies: Vec<u32>,
    /// Empty, or 6 vertex indices per pair, unchecked.
    pub warm_starts: Vec<u32>,
    /// The memory that the scene takes from its call's budget. None if the scene belongs to no
    /// call.
    pub memory: Option<Permit>,
}

/// Poses as they arrived. A body's pose is converted when one of its pairs is computed. So compute
/// threads do this work, and until then a pose takes 56 bytes instead of 104.
#[derive(Clone, Debug, Default)]
pub struct Poses {
    positions: Vec<f64>,
    rotations: Vec<f64>,
}

/// The part of a scene that the next message of a stream may inherit: everything except the poses.
#[derive(Clone, Debug)]
pub struct Setting {
    /// The hulls, each listed once.
    pub hull_ids: Vec<HullId>,
    /// For each body, an index into `hull_ids`.
    pub body_hulls: Vec<u32>,
    /// 2 body indices per pair.
    pub pairs: Vec<u32>,
    /// The query for each pair.
    pub query: Query,
    /// The outputs that are sent.
    pub outputs: Outputs,
}

/// Checks a request that inherits nothing.
///
/// # Errors
/// The first fault found, with field and index.
pub fn scene(request: proto::QueryContactsRequest, limits: &Limits) -> Result<Scene, ServiceError> {
    stoppable_scene(request, limits, &Stop::default())
}

/// Checks a request that inherits nothing; `stop` ends the work.
///
/// # Errors
/// The first fault found, with field and index, or that the work was stopped.
pub(in crate::service) fn stoppable_scene(
    request: proto::QueryContactsRequest,
    limits: &Limits,
    stop: &Stop,
) -> Result<Scene, ServiceError> {
    let meter = &Meter::new(stop);
    if request.inherit {
        let why = "`inherit` is only valid on StreamContacts: send the scene in full";
        return Err(ServiceError::invalid("FIELD_NOT_ALLOWED", "inherit", why));
    }
    let accuracy = request.accuracy.unwrap_or_default();
    refuse_foreign(&request.worlds, "worlds")?;
    refuse_foreign(&request.groups, "groups")?;
    refuse_foreign(&request.ignored_groups, "ignored_groups")?;

    let bodies = request.body_hulls.len();
    let pairs = request.pairs.len() / 2;
    at_most(request.hull_ids.len(), limits.max_hulls_per_request, "TOO_MANY_HULLS", "hull_ids")?;
    at_most(bodies, limits.max_bodies_per_request, "TOO_MANY_BODIES", "body_hulls")?;
    at_most(pairs, limits.max_pairs_per_request, "TOO_MANY_PAIRS", "pairs")?;
    pose_lengths(&request, bodies)?;
    has_length(request.pairs.len(), 2 * pairs, "pairs", "2 per pair")?;
    if !request.warm_starts.is_empty() {
        has_length(request.warm_starts.len(), 6 * pairs, "warm_starts", "none or 6 per pair")?;
    }
    all_below(&request.body_hulls, request.hull_ids.len(), "body_hulls", ["hull", "hulls"], meter)?;
    all_below(&request.pairs, bodies, "pairs", ["body", "bodies"], meter)?;

    let hull_ids = distinct_ids(&request.hull_ids, meter)?;
    let outputs = outputs(&request.outputs);
    let query = Query {
        margin: margin(request.margin)?,
        accuracy: checked_accuracy(&accuracy)?,
        wanted: outputs.wanted(),
    };
    let (poses, invalid_bodies) = Poses::of(request.positions, request.rotations, meter)?;
    let (body_hulls, pairs) = (request.body_hulls, request.pairs);
    Ok(Scene {
        request_id: request.request_id,
        setting: Arc::new(Setting { hull_ids, body_hulls, pairs, query, outputs }),
        poses,
        invalid_bodies,
        warm_starts: request.warm_starts,
        memory: None,
    })
}

/// Checks a request that sends only poses, inherits `setting`, and starts from `bases`.
///
/// # Errors
/// The first fault found, with the field, or that the work was stopped.
pub(in crate::service) fn inherited(
    request: proto::QueryContactsRequest,
    setting: Arc<Setting>,
    bases: Vec<u32>,
    stop: &Stop,
) -> Result<Scene, ServiceError> {
    let given = [
        (!request.hull_ids.is_empty(), "hull_ids"),
        (!request.body_hulls.is_empty(), "body_hulls"),
        (!request.pairs.is_empty(), "pairs"),
        (!request.worlds.is_empty(), "worlds"),
        (!request.groups.is_empty(), "groups"),
        (!request.ignored_groups.is_empty(), "ignored_groups"),
        (request.margin != 0.0, "margin"),
        (request.accuracy.is_some(), "accuracy"),
        (!request.outputs.is_empty(), "outputs"),
        (!request.warm_starts.is_empty(), "warm_starts"),
    ];
    if let Some((_, field)) = given.into_iter().find(|(given, _)| *given) {
        let why = "must not be set together with `inherit`: it is inherited from the previous message";
        return Err(ServiceError::invalid("FIELD_NOT_ALLOWED", field, why));
    }
    pose_lengths(&request, setting.body_hulls.len())?;
    let meter = &Meter::new(stop);
    let (poses, invalid_bodies) = Poses::of(request.positions, request.rotations, meter)?;
    let request_id = request.request_id;
    Ok(Scene { request_id, setting, poses, invalid_bodies, warm_starts: bases, memory: None })
}

fn pose_lengths(request: &proto::QueryContactsRequest, bodies: usize) -> Result<(), ServiceError> {
    has_length(request.positions.len(), 3 * bodies, "positions", "3 per body")?;
    has_length(request.rotations.len(), 4 * bodies, "rotations", "4 per body")
}

impl Setting {
    /// The number of pairs.
    pub fn pair_count(&self) -> usize {
        self.pairs.len() / 2
    }

    /// The bytes that a stream keeps of the setting and of its bases.
    pub fn kept_bytes(&self) -> usize {
        size_of_val(&self.hull_ids[..])
            + size_of_val(&self.body_hulls[..])
            + size_of_val(&self.pairs[..])
            + self.pair_count() * size_of::<[u32; 6]>()
    }
}

fn refuse_foreign(column: &[u32], field: &'static str) -> Result<(), ServiceError> {
    if column.is_empty() {
        return Ok(());
    }
    let message = format!("`{field}` is only valid on FindContacts");
    Err(ServiceError::invalid("FIELD_NOT_ALLOWED", field, message))
}

pub(super) fn at_most(
    count: usize,
    limit: u32,
    reason: &'static str,
    field: &'static str,
) -> Result<(), ServiceError> {
    if count <= limit as usize {
        return Ok(());
    }
    let message = format!("got {count}, at most {limit} are allowed: send fewer per request");
    Err(ServiceError::invalid(reason, field, message))
}

pub(super) fn has_length(
    found: usize,
    expected: usize,
    field: &'static str,
    rule: &str,
) -> Result<(), ServiceError> {
    if found == expected {
        return Ok(());
    }
    let message = format!("got {found} entries, expected {expected} ({rule})");
    Err(ServiceError::invalid("LENGTH_MISMATCH", field, message))
}

fn all_below(
    column: &[u32],
    count: usize,
    field: &'static str,
    [one, many]: [&str; 2],
    meter: &Meter<'_>,
) -> Result<(), ServiceError> {
    for (first, some) in (0..).step_by(AT_A_TIME).zip(column.chunks(AT_A_TIME)) {
        meter.spend(some.len() as u64)?;
        // Every index of every request is compared, so the largest is found with a loop that the
        // compiler vectorises.
        let largest = some.iter().fold(0, |largest, &index| largest.max(index));
        if (largest as usize) < count {
            continue;
        }
        if let Some(at) = some.iter().position(|&index| index as usize >= count) {
            let noun = if count == 1 { one } else { many };
            let message = format!("{one} index {} is out of range: the scene has {count} {noun}", some[at]);
            return Err(ServiceError::invalid_at("INDEX_OUT_OF_RANGE", field, first + at, message));
        }
    }
    Ok(())
}

/// Up to this many ids are compared with each other, which takes less time than a table.
const FEW_IDS: usize = 8;

/// The ids, each listed once. The hash function of the table has a random key, so that a sender
/// cannot choose ids that make it slow.
fn distinct_ids<B: AsRef<[u8]>>(ids: &[B], meter: &Meter<'_>) -> Result<Vec<HullId>, ServiceError> {
    let mut distinct: Vec<HullId> = Vec::with_capacity(ids.len());
    let mut seen = HashSet::new();
    if ids.len() > FEW_IDS {
        seen.reserve(ids.len());
    }
    for (index, bytes) in ids.iter().enumerate() {
        meter.spend(ID_STEPS)?;
        let id = hull_id(bytes.as_ref(), "hull_ids", index)?;
        let is_new = if ids.len() > FEW_IDS { seen.insert(bytes.as_ref()) } else { !distinct.contains(&id) };
        if !is_new {
            let message = format!("hull {id} was listed before: list each hull once");
            return Err(ServiceError::invalid_at("DUPLICATE_HULL", "hull_ids", index, message));
        }
        distinct.push(id);
    }
    Ok(distinct)
}

pub(super) fn hull_id(bytes: &[u8], field: &'static str, index: usize) -> Result<HullId, ServiceError> {
    let id = bytes.try_into().map(HullId);
    id.map_err(|_| {
        let message = format!("got {} bytes, expected the 32 bytes of a hull id", bytes.len());
        ServiceError::invalid_at("MALFORMED_ID", field, index, message)
    })
}

fn margin(margin: f64) -> Result<f64, ServiceError> {
    if margin >= 0.0 {
        return Ok(margin);
    }
    Err(out_of_range("margin", margin, "at least 0"))
}

pub(super) fn out_of_range(field: &'static str, value: f64, rule: &str) -> ServiceError {
    ServiceError::invalid("VALUE_OUT_OF_RANGE", field, format!("got {value}, must be {rule}"))
}

fn checked_accuracy(accuracy: &proto::Accuracy) -> Result<Accuracy, ServiceError> {
    let defaults = Accuracy::default();
    let solver = match proto::Solver::try_from(accuracy.solver) {
        Ok(proto::Solver::Unspecified | proto::Solver::Portal) => Solver::Portal,
        Ok(proto::Solver::GjkRayCast) => Solver::GjkRayCast,
        Err(_) => return Err(unknown_value("accuracy.solver", accuracy.solver)),
    };
    let relative_tolerance = accuracy.relative_tolerance;
    if !(0.0..=1.0).contains(&relative_tolerance) {
        return Err(out_of_range("accuracy.relative_tolerance", relative_tolerance, "0 to 1"));
    }
    let feature_angle = accuracy.feature_angle.unwrap_or(defaults.feature_angle);
    if !(0.0..=0.5).contains(&feature_angle) {
        return Err(out_of_range("accuracy.feature_angle", feature_angle, "0 to 0.5"));
    }
    let max_points = accuracy.max_points;
    Ok(Accuracy { solver, relative_tolerance, feature_angle, max_points, ..defaults })
}

/// The error for an unknown option. If the server ignored it, the answer would be wrong, since
/// another computation was requested.
fn unknown_value(field: &'static str, value: i32) -> ServiceError {
    let message = format!("got {value}, which this version of the server does not know");
    ServiceError::invalid("UNKNOWN_VALUE", field, message)
}

/// The set of requested outputs. Unknown values come from newer clients, which can do without those
/// outputs.
fn outputs(values: &[i32]) -> Outputs {
    if values.is_empty() {
        return Outputs::default();
    }
    let mut outputs = Outputs::OUTCOME;
    for &value in values {
        match proto::Output::try_from(value) {
            Ok(proto::Output::Unspecified | proto::Output::Outcome) | Err(_) => {}
            Ok(proto::Output::Alpha) => outputs.alpha = true,
            Ok(proto::Output::Normal) => outputs.normal = true,
            Ok(proto::Output::Points) => outputs.points = true,
            Ok(proto::Output::WitnessB) => outputs.witness_b = true,
            Ok(proto::Output::Features) => outputs.features = true,
            Ok(proto::Output::Bases) => outputs.bases = true,
            Ok(proto::Output::Diagnostics) => outputs.diagnostics = true,
        }
    }
    outputs
}

impl Poses {
    /// The poses, and the bodies without a usable pose.
    fn of(
        positions: Vec<f64>,
        rotations: Vec<f64>,
        meter: &Meter<'_>,
    ) -> Result<(Self, Vec<u32>), ServiceError> {
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

    /// The pose of a body, or `None` if it is not usable.
    pub fn get(&self, body: usize) -> Option<Pose> {
        let (positions, _) = self.positions.as_chunks::<3>();
        let (rotations, _) = self.rotations.as_chunks::<4>();
        Pose::new(positions[body], rotations[body]).ok()
    }
}

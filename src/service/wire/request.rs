//! Checks a query completely.

use std::{collections::HashSet, sync::Arc};

use crate::{
    batch::{
        MotionColumns, Motions, Output, Outputs,
        motion::margin_lengths,
        scene::{
            FaultKind, Poses, SceneError, SceneFault, SceneTemplate, check_margin, pair_lengths, pose_lengths,
        },
    },
    contact::{Accuracy, Solver, Stop, stop::Meter},
    proto,
    service::{Reason, error::ServiceError, limits::Limits},
    store::HullId,
};

/// Elementary steps of looking up a hull's id in a table.
pub(super) const ID_STEPS: u64 = 100;

/// A checked request: all lengths fit, all indices are in range, all options are known.
#[derive(Debug)]
pub struct CheckedScene {
    /// The request's id, which the answer repeats.
    pub request_id: u64,
    /// The hulls, each listed once.
    pub hull_ids: Arc<Vec<HullId>>,
    /// The bodies, pairs and options.
    pub template: Arc<SceneTemplate>,
    /// The poses of the bodies.
    pub poses: Poses,
    /// The bodies without a usable pose, in ascending order.
    pub invalid_bodies: Vec<u32>,
    /// Empty, or 6 vertex indices per pair, unchecked.
    pub warm_starts: Vec<u32>,
}

impl From<SceneFault> for ServiceError {
    fn from(SceneFault { kind, field, index, message }: SceneFault) -> Self {
        let reason = match kind {
            FaultKind::Length => Reason::LengthMismatch,
            FaultKind::Index => Reason::IndexOutOfRange,
            FaultKind::Value => Reason::ValueOutOfRange,
        };
        match index {
            Some(index) => Self::in_entry(reason, field, index, message),
            None => Self::in_field(reason, field, message),
        }
    }
}

impl From<SceneError> for ServiceError {
    fn from(error: SceneError) -> Self {
        match error {
            SceneError::Fault(fault) => fault.into(),
            SceneError::Stopped => Self::deadline_exceeded(),
        }
    }
}

/// Checks a request that inherits nothing.
///
/// # Errors
/// The first fault found, with field and index.
pub fn scene(request: proto::QueryContactsRequest, limits: &Limits) -> Result<CheckedScene, ServiceError> {
    stoppable_scene(request, limits, &Stop::default())
}

/// Checks a request of `QueryContacts`; `stop` ends the work.
///
/// # Errors
/// The first fault found, with field and index, or that the work was stopped.
pub(in crate::service) fn stoppable_scene(
    request: proto::QueryContactsRequest,
    limits: &Limits,
    stop: &Stop,
) -> Result<CheckedScene, ServiceError> {
    refuse_of_streams(&request)?;
    whole_scene(request, limits, stop)
}

/// Checks a request of any method that inherits nothing, except for the fields of steps.
pub(super) fn whole_scene(
    mut request: proto::QueryContactsRequest,
    limits: &Limits,
    stop: &Stop,
) -> Result<CheckedScene, ServiceError> {
    let meter = &Meter::new(stop);
    let accuracy = request.accuracy.unwrap_or_default();
    refuse_foreign(&request.worlds, "worlds")?;
    refuse_foreign(&request.groups, "groups")?;
    refuse_foreign(&request.ignored_groups, "ignored_groups")?;

    let bodies = request.body_hulls.len();
    let pairs = request.pairs.len() / 2;
    at_most(request.hull_ids.len(), limits.max_hulls_per_request, Reason::TooManyHulls, "hull_ids")?;
    at_most(bodies, limits.max_bodies_per_request, Reason::TooManyBodies, "body_hulls")?;
    at_most(pairs, limits.max_pairs_per_request, Reason::TooManyPairs, "pairs")?;
    // The lengths come first, so that the first fault that is found does not depend on the other columns.
    pose_lengths(bodies, &request.positions, &request.rotations)?;
    pair_lengths(&request.pairs, &request.warm_starts)?;
    margin_lengths(&request.margins, bodies)?;
    let motion = motion(&mut request);
    motion.check_lengths(bodies, "none or 3 per body")?;
    let template = SceneTemplate::new(request.hull_ids.len(), request.body_hulls, request.pairs, meter)?;
    let hull_ids = Arc::new(distinct_ids(&request.hull_ids, meter)?);
    check_margin(request.margin)?;
    let template =
        template.with_query(request.margin, known_accuracy(&accuracy)?, outputs(&request.outputs))?;
    let template = template.with_margins(request.margins, meter)?;
    let motions = Motions::new(bodies, motion)?;
    let (poses, invalid_bodies) =
        Poses::moving(bodies, request.positions, request.rotations, motions, meter)?;
    let (request_id, warm_starts) = (request.request_id, request.warm_starts);
    Ok(CheckedScene {
        request_id,
        hull_ids,
        template: Arc::new(template),
        poses,
        invalid_bodies,
        warm_starts,
    })
}

/// Refuses the fields that belong to the steps of a stream.
pub(super) fn refuse_of_streams(request: &proto::QueryContactsRequest) -> Result<(), ServiceError> {
    let matches = request.outputs.contains(&proto::Output::Matches.into());
    let given = [
        (request.inherit, "inherit"),
        (request.find, "find"),
        (!request.moved.is_empty(), "moved"),
        (!request.previous_bodies.is_empty(), "previous_bodies"),
        (matches, "outputs"),
    ];
    let Some((_, field)) = given.into_iter().find(|(given, _)| *given) else { return Ok(()) };
    let message = match field {
        "outputs" => "the output MATCHES is only valid on StreamContacts".into(),
        "inherit" => "`inherit` is only valid on StreamContacts: send the scene in full".into(),
        _ => format!("`{field}` is only valid on StreamContacts"),
    };
    Err(ServiceError::in_field(Reason::FieldNotAllowed, field, message))
}

/// Takes the columns of motion out of a request, unchecked.
pub(super) fn motion(request: &mut proto::QueryContactsRequest) -> MotionColumns {
    MotionColumns {
        linear_velocities: std::mem::take(&mut request.linear_velocities),
        angular_velocities: std::mem::take(&mut request.angular_velocities),
        turning_points: std::mem::take(&mut request.turning_points),
        time_step: request.time_step,
    }
}

fn refuse_foreign(column: &[u32], field: &'static str) -> Result<(), ServiceError> {
    if column.is_empty() {
        return Ok(());
    }
    let message = format!("`{field}` is only valid on FindContacts, and with `find` on StreamContacts");
    Err(ServiceError::in_field(Reason::FieldNotAllowed, field, message))
}

pub(super) fn at_most(
    count: usize,
    limit: u32,
    reason: Reason,
    field: &'static str,
) -> Result<(), ServiceError> {
    if count <= limit as usize {
        return Ok(());
    }
    let message = format!("got {count}, at most {limit} are allowed: send fewer per request");
    Err(ServiceError::in_field(reason, field, message))
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
            return Err(ServiceError::in_entry(Reason::DuplicateHull, "hull_ids", index, message));
        }
        distinct.push(id);
    }
    Ok(distinct)
}

pub(super) fn hull_id(bytes: &[u8], field: &'static str, index: usize) -> Result<HullId, ServiceError> {
    let id = bytes.try_into().map(HullId);
    id.map_err(|_| {
        let message = format!("got {} bytes, expected the 32 bytes of a hull id", bytes.len());
        ServiceError::in_entry(Reason::MalformedId, field, index, message)
    })
}

/// The accuracy in the library's terms. Its numbers are not checked yet.
fn known_accuracy(accuracy: &proto::Accuracy) -> Result<Accuracy, ServiceError> {
    let defaults = Accuracy::default();
    let solver = match proto::Solver::try_from(accuracy.solver) {
        Ok(proto::Solver::Unspecified | proto::Solver::Portal) => Solver::Portal,
        Ok(proto::Solver::GjkRayCast) => Solver::GjkRayCast,
        Err(_) => return Err(unknown_value("accuracy.solver", accuracy.solver)),
    };
    let relative_tolerance = accuracy.relative_tolerance;
    let feature_angle = accuracy.feature_angle.unwrap_or(defaults.feature_angle);
    let max_points = accuracy.max_points;
    Ok(Accuracy { solver, relative_tolerance, feature_angle, max_points, ..defaults })
}

/// The error for an unknown option. If the server ignored it, the answer would be wrong, since
/// another computation was requested.
fn unknown_value(field: &'static str, value: i32) -> ServiceError {
    let message = format!("got {value}, which this version of the server does not know");
    ServiceError::in_field(Reason::UnknownValue, field, message)
}

/// The set of requested outputs. Unknown values come from newer clients, which can do without those
/// outputs.
fn outputs(values: &[i32]) -> Outputs {
    if values.is_empty() {
        return Outputs::default();
    }
    Outputs::of(values.iter().filter_map(|&value| Output::from_number(value)))
}

//! Checks the messages of a stream, which may take parts of the scene from the message before.

use std::{collections::HashMap, sync::Arc};

use super::{
    find::found_scene,
    request::{CheckedScene, ID_STEPS, motion, whole_scene},
};
use crate::{
    batch::{
        Motions,
        broad_phase::Rules,
        codes::NO_INDEX,
        scene::{Poses, SceneTemplate, has_length},
        steps::{Changes, bodies_now},
    },
    contact::{Stop, stop::Meter},
    proto,
    service::{Reason, error::ServiceError, limits::Limits},
    store::HullId,
};

/// The parts of the message before that the next message may take.
#[derive(Debug)]
pub(in crate::service) struct Before {
    pub(in crate::service) hull_ids: Arc<Vec<HullId>>,
    pub(in crate::service) template: Arc<SceneTemplate>,
    /// The rules of a search for pairs; `None` if the pairs are named.
    pub(in crate::service) rules: Option<Arc<Rules>>,
    pub(in crate::service) poses: Arc<Poses>,
    pub(in crate::service) invalid_bodies: Vec<u32>,
}

/// A checked message of a stream.
#[derive(Debug)]
pub(in crate::service) struct CheckedStep {
    pub(in crate::service) scene: CheckedScene,
    /// The poses of the scene. Those in `scene` are empty.
    pub(in crate::service) poses: Arc<Poses>,
    /// The rules of a search for pairs; `None` if the pairs are named.
    pub(in crate::service) rules: Option<Arc<Rules>>,
    pub(in crate::service) start: StepStart,
    /// Whether only a client that knows steps sends such a message.
    pub(in crate::service) uses_steps: bool,
}

/// What a message has in common with the message before.
#[derive(Debug)]
pub(in crate::service) enum StepStart {
    /// Nothing.
    Anew,
    /// Everything but the poses that have changed.
    Inherited(Changes),
    /// Some of the bodies.
    Bodies {
        changes: Changes,
        /// The number of each old body now, or [`NO_INDEX`].
        bodies_now: Vec<u32>,
        /// For each hull, its index in the message before, or [`NO_INDEX`].
        hulls_before: Vec<u32>,
        /// Whether the pairs are found.
        is_search: bool,
    },
}

/// Checks a message of a stream. `before` is the state of the message before. The check takes memory from `grow`
/// before it allocates what is not proportional to the message.
///
/// # Errors
/// The first fault found, with field and index; there is no memory; or the work was stopped.
pub(in crate::service) fn step(
    request: proto::QueryContactsRequest,
    before: Option<Before>,
    limits: &Limits,
    stop: &Stop,
    grow: impl FnMut(usize) -> Result<(), ServiceError>,
) -> Result<CheckedStep, ServiceError> {
    match before {
        Some(before) if request.inherit => inherited(request, before, stop, grow),
        before => whole(request, before, limits, stop, grow),
    }
}

/// Checks a message that has the whole scene.
fn whole(
    mut request: proto::QueryContactsRequest,
    before: Option<Before>,
    limits: &Limits,
    stop: &Stop,
    mut grow: impl FnMut(usize) -> Result<(), ServiceError>,
) -> Result<CheckedStep, ServiceError> {
    if !request.moved.is_empty() {
        let why = "`moved` is only valid with `inherit`: the message has all poses";
        return Err(ServiceError::in_field(Reason::FieldNotAllowed, "moved", why));
    }
    let previous_bodies = std::mem::take(&mut request.previous_bodies);
    let uses_steps = request.find;
    let (mut scene, rules) = if request.find {
        let (scene, rules) = found_scene(request, limits, stop)?;
        (scene, Some(Arc::new(rules)))
    } else {
        (whole_scene(request, limits, stop)?, None)
    };
    let poses = std::mem::take(&mut scene.poses);
    let start = match before {
        Some(before) if !previous_bodies.is_empty() => {
            let (bodies, bodies_before) = (scene.template.body_count(), before.template.body_count());
            grow(5 * (bodies + bodies_before) + size_of::<u32>() * scene.hull_ids.len())?;
            common_bodies(&previous_bodies, &scene, &poses, &before, rules.is_some(), stop)?
        }
        _ => StepStart::Anew,
    };
    Ok(CheckedStep { scene, poses: Arc::new(poses), rules, start, uses_steps })
}

/// The bodies that a message has in common with the message before.
fn common_bodies(
    previous_bodies: &[u32],
    scene: &CheckedScene,
    poses: &Poses,
    before: &Before,
    is_search: bool,
    stop: &Stop,
) -> Result<StepStart, ServiceError> {
    let meter = &Meter::new(stop);
    let (bodies, bodies_before) = (scene.template.body_count(), before.template.body_count());
    let mut bodies_now = bodies_now(previous_bodies, bodies, bodies_before, meter)?;
    let mut known = HashMap::with_capacity(before.hull_ids.len());
    for (id, index) in before.hull_ids.iter().zip(0..) {
        meter.spend(ID_STEPS)?;
        known.insert(id, index);
    }
    let mut hulls_before = Vec::with_capacity(scene.hull_ids.len());
    for id in scene.hull_ids.iter() {
        meter.spend(ID_STEPS)?;
        hulls_before.push(known.get(id).copied().unwrap_or(NO_INDEX));
    }
    // A body whose hull has changed is new.
    for (now, &hull) in bodies_now.iter_mut().zip(before.template.body_hulls()) {
        meter.spend(3)?;
        if *now != NO_INDEX && hulls_before[scene.template.body_hulls()[*now as usize] as usize] != hull {
            *now = NO_INDEX;
        }
    }
    let mut changes = Changes::of_poses(&before.poses, poses, Some(&bodies_now), meter)?;
    changes.add_margins(&before.template, &scene.template, &bodies_now, meter)?;
    Ok(StepStart::Bodies { changes, bodies_now, hulls_before, is_search })
}

/// Checks a message that inherits.
fn inherited(
    mut request: proto::QueryContactsRequest,
    before: Before,
    stop: &Stop,
    mut grow: impl FnMut(usize) -> Result<(), ServiceError>,
) -> Result<CheckedStep, ServiceError> {
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
        (request.find, "find"),
        (!request.margins.is_empty(), "margins"),
        (!request.previous_bodies.is_empty(), "previous_bodies"),
    ];
    if let Some((_, field)) = given.into_iter().find(|(given, _)| *given) {
        let why = "must not be set together with `inherit`: it is inherited from the previous message";
        return Err(ServiceError::in_field(Reason::FieldNotAllowed, field, why));
    }
    let meter = &Meter::new(stop);
    let Before { hull_ids, template, rules, poses, invalid_bodies } = before;
    let sent_motion = motion(&mut request);
    let proto::QueryContactsRequest { request_id, moved, positions, rotations, .. } = request;
    let bodies = template.body_count();
    let none_moved = moved.is_empty() && positions.is_empty() && rotations.is_empty();
    let uses_steps = none_moved || !moved.is_empty();
    let some = Some(&moved[..]).filter(|moved| !moved.is_empty());
    if some.is_some() {
        grow(Motions::next_bytes(bodies, &sent_motion))?;
    }
    let motions_before = poses.motions().clone();
    let motions = motions_before.next(bodies, some, sent_motion, meter)?;
    let is_still = none_moved && motions.is_kept_from(&motions_before);
    if !is_still {
        // For each body: whether it has changed, and its index if it is invalid.
        grow(5 * bodies)?;
    }
    let (poses, invalid_bodies, changes) = if is_still {
        (poses, invalid_bodies, Changes::none())
    } else if moved.is_empty() && !none_moved {
        let (sent, invalid) = Poses::moving(bodies, positions, rotations, motions, meter)?;
        let changes = Changes::of_poses(&poses, &sent, None, meter)?;
        (Arc::new(sent), invalid, changes)
    } else {
        has_length(positions.len(), 3 * moved.len(), "positions", "3 per entry of `moved`")?;
        has_length(rotations.len(), 4 * moved.len(), "rotations", "4 per entry of `moved`")?;
        let (sent, unusable) = Poses::new(moved.len(), positions, rotations, meter)?;
        // Nobody else has the poses, since the answer before is complete.
        let mut all = Arc::unwrap_or_clone(poses).with_motions(motions);
        // With motions, a body may have become invalid, or valid, by more than its pose.
        let by_poses = if all.motions().is_absent() {
            Some(with_moved(&invalid_bodies, &moved, &unusable, meter)?)
        } else {
            None
        };
        let mut changes = Changes::of_moved(&mut all, moved, sent, meter)?;
        changes.add_motions(bodies, &motions_before, all.motions(), meter)?;
        let invalid = match by_poses {
            Some(invalid) => invalid,
            None => all.unusable(meter)?,
        };
        (Arc::new(all), invalid, changes)
    };
    let scene = CheckedScene {
        request_id,
        hull_ids,
        template,
        poses: Poses::default(),
        invalid_bodies,
        warm_starts: Vec::new(),
    };
    Ok(CheckedStep { scene, poses, rules, start: StepStart::Inherited(changes), uses_steps })
}

/// The unusable bodies after some have moved. `unusable` are the places in `moved` of those whose new poses are
/// unusable.
fn with_moved(
    before: &[u32],
    moved: &[u32],
    unusable: &[u32],
    meter: &Meter<'_>,
) -> Result<Vec<u32>, ServiceError> {
    let mut invalid = Vec::with_capacity(before.len() + unusable.len());
    for &body in before {
        meter.spend(20)?;
        // If `moved` is not in order, the message is refused afterwards.
        if moved.binary_search(&body).is_err() {
            invalid.push(body);
        }
    }
    invalid.extend(unusable.iter().map(|&at| moved[at as usize]));
    meter.spend(2 * invalid.len() as u64)?;
    invalid.sort_unstable();
    Ok(invalid)
}

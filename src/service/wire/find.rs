//! Checks a request whose pairs the server finds: a scene without pairs, and the rules for which bodies may
//! meet.

use super::request::{CheckedScene, refuse_of_streams, whole_scene};
use crate::{
    batch::{broad_phase::Rules, scene::check_finite},
    contact::Stop,
    proto,
    service::{Reason, error::ServiceError, limits::Limits},
};

/// Checks a request of `FindContacts`.
///
/// # Errors
/// The first fault found, with field and index, or that the work was stopped.
pub(in crate::service) fn find(
    request: proto::QueryContactsRequest,
    limits: &Limits,
    stop: &Stop,
) -> Result<(CheckedScene, Rules), ServiceError> {
    refuse_of_streams(&request)?;
    found_scene(request, limits, stop)
}

/// Checks a request of `FindContacts` or with `find`, except for the fields of steps.
pub(super) fn found_scene(
    mut request: proto::QueryContactsRequest,
    limits: &Limits,
    stop: &Stop,
) -> Result<(CheckedScene, Rules), ServiceError> {
    for (column, field) in [(&request.pairs, "pairs"), (&request.warm_starts, "warm_starts")] {
        if !column.is_empty() {
            let message = format!("the server finds the pairs itself: leave `{field}` empty");
            return Err(ServiceError::in_field(Reason::FieldNotAllowed, field, message));
        }
    }
    check_finite(request.margin)?;
    let [worlds, groups, ignored] =
        [&mut request.worlds, &mut request.groups, &mut request.ignored_groups].map(std::mem::take);
    let scene = whole_scene(request, limits, stop)?;
    let rules = Rules::checked(scene.template.body_count(), worlds, groups, ignored)?;
    Ok((scene, rules))
}

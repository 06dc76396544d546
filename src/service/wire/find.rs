//! Checks a request of `FindContacts`: a scene without pairs, and the rules for which bodies may
//! meet.

use super::request::{CheckedScene, stoppable_scene};
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
    mut request: proto::QueryContactsRequest,
    limits: &Limits,
    stop: &Stop,
) -> Result<(CheckedScene, Rules), ServiceError> {
    for (column, field) in [(&request.pairs, "pairs"), (&request.warm_starts, "warm_starts")] {
        if !column.is_empty() {
            let message = format!("FindContacts finds the pairs itself: leave `{field}` empty");
            return Err(ServiceError::in_field(Reason::FieldNotAllowed, field, message));
        }
    }
    check_finite(request.margin)?;
    let [worlds, groups, ignored] =
        [&mut request.worlds, &mut request.groups, &mut request.ignored_groups].map(std::mem::take);
    let scene = stoppable_scene(request, limits, stop)?;
    let rules = Rules::checked(scene.template.body_count(), worlds, groups, ignored)?;
    Ok((scene, rules))
}

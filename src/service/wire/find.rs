//! Checks a request of `FindContacts`: a scene without pairs, and the rules for which bodies may
//! meet.

use super::{
    Scene,
    request::{has_length, out_of_range, stoppable_scene},
};
use crate::{
    broad_phase::Rules,
    contact::Stop,
    proto,
    service::{error::ServiceError, limits::Limits},
};

/// Checks a request of `FindContacts`.
///
/// # Errors
/// The first fault found, with field and index, or that the work was stopped.
pub(in crate::service) fn find(
    mut request: proto::QueryContactsRequest,
    limits: &Limits,
    stop: &Stop,
) -> Result<(Scene, Rules), ServiceError> {
    for (column, field) in [(&request.pairs, "pairs"), (&request.warm_starts, "warm_starts")] {
        if !column.is_empty() {
            let message = format!("{field}: FindContacts finds the pairs");
            return Err(ServiceError::invalid("FIELD_NOT_ALLOWED", field, message));
        }
    }
    if request.margin == f64::INFINITY {
        return Err(out_of_range("margin", request.margin, "finite: every pair would be found"));
    }
    let [worlds, groups, ignored] =
        [&mut request.worlds, &mut request.groups, &mut request.ignored_groups].map(std::mem::take);
    let scene = stoppable_scene(request, limits, stop)?;
    let bodies = scene.setting.body_hulls.len();
    for (column, field) in [(&worlds, "worlds"), (&groups, "groups")] {
        if !column.is_empty() {
            has_length(column.len(), bodies, field, "none or one per body")?;
        }
    }
    has_length(ignored.len(), ignored.len() & !1, "ignored_groups", "2 per entry")?;
    if let Some(at) = ignored.iter().position(|&group| group == 0) {
        let message = "0 is no group";
        return Err(ServiceError::invalid_at("VALUE_OUT_OF_RANGE", "ignored_groups", at, message));
    }
    Ok((scene, Rules::new(worlds, groups, ignored)))
}

//! The columns that compare an answer of a session with the answer before it: their checks, and their values
//! for an answer that did not change.

use hullcast_proto::{Outcome, Output, QueryContactsRequest, QueryContactsResponse};

use crate::checked::Malformed;
use crate::columns::Outputs;

/// The index of a row or point that has no predecessor.
const NONE: u32 = u32::MAX;

/// Whether a row with this outcome may have a predecessor and a successor.
fn is_live(outcome: u8) -> bool {
    [Outcome::Contact as u8, Outcome::Undecided as u8].contains(&outcome)
}

/// Checks the matches of an answer with the answer before it; `before` is `None` if the stream has begun anew.
///
/// # Errors
/// The first defect found, with its column.
pub(crate) fn check(
    request: &QueryContactsRequest,
    answer: &QueryContactsResponse,
    before: Option<&QueryContactsResponse>,
) -> Result<(), Malformed> {
    if !Outputs::of(request).has(Output::Matches) {
        return Ok(());
    }
    let malformed = |text: String| Err(Malformed::new(text));
    if !answer.ended_pairs.len().is_multiple_of(2) {
        return malformed(format!(
            "ended_pairs has {} entries, expected 2 per pair",
            answer.ended_pairs.len()
        ));
    }
    let Some(before) = before else {
        let is_none = |column: &[u32]| column.iter().all(|&index| index == NONE);
        let is_empty = is_none(&answer.previous_pairs) && is_none(&answer.previous_points);
        return match is_empty && answer.ended_pairs.is_empty() {
            true => Ok(()),
            false => malformed("the first answer of a stream has matches with an answer before it".into()),
        };
    };
    let mut is_taken = vec![false; before.outcomes.len()];
    let mut point = 0;
    for (row, &count) in answer.point_counts.iter().enumerate() {
        let points = point..point + count as usize;
        point = points.end;
        // A server of the first version of the contract does not send these columns.
        let old = answer.previous_pairs.get(row).copied().unwrap_or(NONE);
        let places = answer.previous_points.get(points).unwrap_or_default();
        if old == NONE {
            if places.iter().any(|&place| place != NONE) {
                return malformed(format!("previous_points matches points of row {row}, which is new"));
            }
            continue;
        }
        let old_outcome = before.outcomes.get(old as usize).copied();
        if !is_live(answer.outcomes[row]) || !old_outcome.is_some_and(is_live) {
            return malformed(format!("previous_pairs[{row}] is {old}, which is no row that can match"));
        }
        if std::mem::replace(&mut is_taken[old as usize], true) {
            return malformed(format!("previous_pairs has row {old} twice"));
        }
        let mut known: Vec<u32> = places.iter().copied().filter(|&place| place != NONE).collect();
        known.sort_unstable();
        let old_count = before.point_counts.get(old as usize).copied().unwrap_or_default();
        if known.last().is_some_and(|&place| place >= old_count) {
            return malformed(format!("previous_points has a point that row {old} did not have"));
        }
        if known.windows(2).any(|two| two[0] == two[1]) {
            return malformed(format!("previous_points has a point of row {old} twice"));
        }
    }
    Ok(())
}

/// Sets the matches of an answer that is equal to the answer before it.
pub(crate) fn make_identical(request: &QueryContactsRequest, answer: &mut QueryContactsResponse) {
    answer.ended_pairs.clear();
    answer.previous_pairs.clear();
    answer.previous_points.clear();
    if !Outputs::of(request).has(Output::Matches) {
        return;
    }
    for ((row, &outcome), &count) in (0..).zip(&answer.outcomes).zip(&answer.point_counts) {
        let is_matched = is_live(outcome);
        answer.previous_pairs.push(if is_matched { row } else { NONE });
        answer.previous_points.extend((0..count).map(|place| if is_matched { place } else { NONE }));
    }
}

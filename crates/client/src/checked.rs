//! Checks a server's answers before any part of an answer is used.
//!
//! Another implementation of the server, a proxy or a cache may send the answer to another request, or
//! columns that do not fit together. The Python client makes the same checks
//! (`client/src/hullcast/_checked.py`).

use std::error::Error as StdError;
use std::fmt;

use hullcast::batch::{
    Output, Outputs,
    columns::{Per, Values},
};
use hullcast::proto::{self, Flag, Outcome};
use hullcast::service::wire::response_columns;
use hullcast::store::HullId;

/// The flags that explain why a pair is INVALID.
const REASONS: u8 = Flag::UnknownHull as u8 | Flag::HullUnavailable as u8 | Flag::InvalidBody as u8;
/// The flags of INVALID pairs that blame a hull.
const HULL_REASONS: u8 = Flag::UnknownHull as u8 | Flag::HullUnavailable as u8;
/// The bits of `Flag` that this version knows.
const KNOWN_FLAGS: u8 = 127;
/// A normal's squared length may differ from 1 by this much.
const NORMAL_ERROR: f64 = 1e-6;

/// An answer that no correct server gives to the request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Malformed(String);

impl fmt::Display for Malformed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the server's answer is malformed: {}", self.0)
    }
}

impl StdError for Malformed {}

fn malformed<T>(text: impl Into<String>) -> Result<T, Malformed> {
    Err(Malformed(text.into()))
}

/// Checks the answer to a query.
///
/// # Errors
/// The first defect found, with its column and index.
pub(crate) fn answer(
    request: &proto::QueryContactsRequest,
    response: &proto::QueryContactsResponse,
) -> Result<(), Malformed> {
    if response.request_id != request.request_id {
        return malformed(format!(
            "request_id is {}, expected {}: it answers another request",
            response.request_id, request.request_id
        ));
    }
    let asked = asked(request);
    lengths(asked, request.pairs.len() / 2, response)?;
    ascending("missing_hulls", &response.missing_hulls, request.hull_ids.len())?;
    ascending("invalid_bodies", &response.invalid_bodies, request.body_hulls.len())?;
    for pair in 0..response.outcomes.len() {
        outcome(request, response, pair)?;
        numbers(asked, response, pair)?;
    }
    for (column, values) in response_columns(response) {
        if let (Per::Point, Values::F64(values)) = (column.per, values)
            && let Some(at) = values.iter().position(|value| !value.is_finite())
        {
            return malformed(format!("{}[{at}] is {}, expected a finite number", column.name, values[at]));
        }
    }
    Ok(())
}

/// The outputs that a request asks for.
fn asked(request: &proto::QueryContactsRequest) -> Outputs {
    if request.outputs.is_empty() {
        return Outputs::default();
    }
    Outputs::of(request.outputs.iter().filter_map(|&output| Output::from_number(output)))
}

/// Checks every column's length.
fn lengths(asked: Outputs, pairs: usize, response: &proto::QueryContactsResponse) -> Result<(), Malformed> {
    let points: usize = response.point_counts.iter().map(|&count| count as usize).sum();
    for (column, values) in response_columns(response) {
        // A server of the first version of the contract does not send a later column.
        let lacks = column.is_later && values.is_empty();
        let rows = if column.per == Per::Point { points } else { pairs };
        let wanted = if column.is_sent(asked) && !lacks { rows * column.width } else { 0 };
        if values.len() != wanted {
            return malformed(format!("{} has {} entries, expected {wanted}", column.name, values.len()));
        }
    }
    Ok(())
}

fn ascending(name: &str, column: &[u32], count: usize) -> Result<(), Malformed> {
    if let Some(at) = column.iter().position(|&index| index as usize >= count) {
        return malformed(format!("{name}[{at}] is {}, but the request has {count}", column[at]));
    }
    match column.windows(2).position(|two| two[0] >= two[1]) {
        None => Ok(()),
        Some(at) => malformed(format!("{name}[{}] is not above the entry before it", at + 1)),
    }
}

/// Checks a pair's outcome against its flags, its bodies and its number of points.
fn outcome(
    request: &proto::QueryContactsRequest,
    response: &proto::QueryContactsResponse,
    pair: usize,
) -> Result<(), Malformed> {
    let (outcome, flags) = (i32::from(response.outcomes[pair]), response.flags[pair]);
    if !(Outcome::Contact as i32..=Outcome::Invalid as i32).contains(&outcome) {
        return malformed(format!("outcomes[{pair}] is {outcome}, expected 1 to 4"));
    }
    let invalid = outcome == Outcome::Invalid as i32;
    let explained = flags & (REASONS | !KNOWN_FLAGS) != 0;
    if invalid != (flags & REASONS != 0) && !(invalid && explained) {
        return malformed(format!("flags[{pair}] is {flags}, which does not fit outcome {outcome}"));
    }
    let bodies = [request.pairs[2 * pair], request.pairs[2 * pair + 1]];
    let unusable = bodies.iter().any(|body| response.invalid_bodies.binary_search(body).is_ok());
    if unusable != (flags & Flag::InvalidBody as u8 != 0) {
        return malformed(format!("flags[{pair}] does not fit invalid_bodies"));
    }
    let lacks = |&body: &u32| {
        let hull = request.body_hulls.get(body as usize);
        hull.is_some_and(|hull| response.missing_hulls.binary_search(hull).is_ok())
    };
    if flags & HULL_REASONS != 0 && !bodies.iter().any(lacks) {
        return malformed(format!("flags[{pair}] blames a hull that missing_hulls does not have"));
    }
    let answered = outcome == Outcome::Contact as i32 || outcome == Outcome::Undecided as i32;
    match response.point_counts.get(pair) {
        Some(&count) if count > 0 && !answered => {
            malformed(format!("point_counts[{pair}] is {count}, but outcome {outcome} has no points"))
        }
        _ => Ok(()),
    }
}

/// Checks that a pair's numbers are finite and in order, unless the pair is INVALID.
fn numbers(asked: Outputs, response: &proto::QueryContactsResponse, pair: usize) -> Result<(), Malformed> {
    if asked.features {
        for (side, kind) in response.feature_kinds[2 * pair..][..2].iter().enumerate() {
            if *kind > proto::FeatureKind::Face as u8 {
                return malformed(format!("feature_kinds[{}] is {kind}, expected 0 to 3", 2 * pair + side));
            }
        }
    }
    if i32::from(response.outcomes[pair]) == Outcome::Invalid as i32 {
        return Ok(());
    }
    if asked.alpha {
        let (alpha, lower, upper) =
            (response.alphas[pair], response.alpha_lowers[pair], response.alpha_uppers[pair]);
        if !(alpha.is_finite() && 0.0 <= lower && lower <= alpha && alpha <= upper) {
            return malformed(format!("alphas[{pair}] is {alpha}, outside its bracket {lower} to {upper}"));
        }
    }
    if asked.normal {
        let separation = response.separations[pair];
        if !separation.is_finite() {
            return malformed(format!("separations[{pair}] is {separation}, expected a finite number"));
        }
        let squared: f64 = response.normals[3 * pair..][..3].iter().map(|c| c * c).sum();
        if !((squared - 1.0).abs() <= NORMAL_ERROR) {
            return malformed(format!("normals[{}] begins a normal that is not a unit vector", 3 * pair));
        }
    }
    match response.kept_areas.get(pair) {
        Some(kept) if !(0.0..=1.0).contains(kept) => {
            malformed(format!("kept_areas[{pair}] is {kept}, expected 0 to 1"))
        }
        _ => Ok(()),
    }
}

/// Checks the id that a server gives to a hull against the hash of the hull's content.
///
/// # Errors
/// The server gave a different id.
pub(crate) fn registered(hull: usize, content: HullId, id: &[u8]) -> Result<HullId, Malformed> {
    if id == content.0 {
        return Ok(content);
    }
    malformed(format!("the id of hulls[{hull}] is not the hash of the hull's content, {content}"))
}

/// Checks the number of results of a registration.
///
/// # Errors
/// Their number differs from that of the hulls.
pub(crate) fn registrations(hulls: usize, results: usize) -> Result<(), Malformed> {
    if hulls == results {
        return Ok(());
    }
    malformed(format!("{results} results for {hulls} hulls"))
}

#[cfg(test)]
mod tests {
    use super::*;

    type Defect = (&'static str, fn(&mut proto::QueryContactsResponse));

    fn asked() -> proto::QueryContactsRequest {
        proto::QueryContactsRequest {
            request_id: 7,
            hull_ids: vec![vec![0; 32], vec![1; 32]],
            body_hulls: vec![0, 1, 0],
            pairs: vec![0, 2, 0, 1],
            outputs: Output::ALL.iter().map(|&output| output as i32).collect(),
            ..Default::default()
        }
    }

    /// The answer for two pairs: a contact with one point, and a pair whose hull is missing and whose body
    /// is unusable.
    fn good() -> proto::QueryContactsResponse {
        let nan = f64::NAN;
        proto::QueryContactsResponse {
            request_id: 7,
            outcomes: vec![1, 4],
            flags: vec![0, 16 | 64],
            alphas: vec![0.5, nan],
            alpha_lowers: vec![0.5, nan],
            alpha_uppers: vec![0.6, nan],
            separations: vec![-1.0, nan],
            normals: vec![0.0, 0.0, 1.0, nan, nan, nan],
            point_counts: vec![1, 0],
            witness_as: vec![1.0; 3],
            distances: vec![-1.0],
            witness_bs: vec![1.0; 3],
            feature_kinds: vec![3, 1, 0, 0],
            feature_indices: vec![0; 8],
            point_ids: vec![0; 4],
            bases: vec![0; 12],
            missing_hulls: vec![1],
            invalid_bodies: vec![1],
            iterations: vec![1, 0],
            support_calls: vec![1, 0],
            kept_areas: vec![1.0, 1.0],
            ..Default::default()
        }
    }

    /// Catches a defect of an answer that is not noticed before the answer is printed, written or indexed.
    #[test]
    fn every_defect_is_named() {
        assert_eq!(answer(&asked(), &good()), Ok(()));
        let defects: &[Defect] = &[
            ("request_id", |r| r.request_id = 8),
            ("outcomes", |r| r.outcomes.truncate(1)),
            ("flags", |r| r.flags.push(0)),
            ("alphas", |r| r.alphas.clear()),
            ("normals", |r| r.normals.truncate(5)),
            ("point_counts", |r| r.point_counts.push(0)),
            ("witness_as", |r| r.point_counts[0] = 4_000_000_000),
            ("distances", |r| r.distances.push(0.0)),
            ("witness_bs", |r| r.witness_bs.clear()),
            ("point_ids", |r| r.point_ids.truncate(3)),
            ("bases", |r| r.bases.truncate(11)),
            ("pairs", |r| r.pairs.push(1)),
            ("kept_areas", |r| r.kept_areas.truncate(1)),
            ("outcomes[0]", |r| r.outcomes[0] = 0),
            ("outcomes[1]", |r| r.outcomes[1] = 9),
            ("flags[0]", |r| r.flags[0] = 64),
            ("flags[1]", |r| r.flags[1] = 0),
            ("invalid_bodies", |r| r.invalid_bodies.clear()),
            ("missing_hulls", |r| r.missing_hulls.clear()),
            ("missing_hulls[0]", |r| r.missing_hulls[0] = 2),
            ("invalid_bodies[1]", |r| r.invalid_bodies.push(1)),
            ("point_counts[0]", |r| r.outcomes[0] = 2),
            ("alphas[0]", |r| r.alphas[0] = f64::NAN),
            ("alphas[0]", |r| r.alpha_lowers[0] = 0.7),
            ("alphas[0]", |r| r.alpha_uppers[0] = 0.4),
            ("separations[0]", |r| r.separations[0] = f64::INFINITY),
            ("normals[0]", |r| r.normals[2] = 0.5),
            ("witness_as[1]", |r| r.witness_as[1] = f64::NAN),
            ("distances[0]", |r| r.distances[0] = f64::NAN),
            ("witness_bs[2]", |r| r.witness_bs[2] = f64::INFINITY),
            ("feature_kinds[1]", |r| r.feature_kinds[1] = 4),
            ("kept_areas[0]", |r| r.kept_areas[0] = 1.5),
        ];
        for (name, spoil) in defects {
            let mut response = good();
            spoil(&mut response);
            let error = answer(&asked(), &response).expect_err(name);
            assert!(error.0.contains(name), "{name}: {error}");
        }
        assert_eq!(defects.len(), 32);
    }

    /// Catches a newer server's answer that is refused for a flag that this version does not know, and an
    /// older server's answer that is refused for a column that it does not have.
    #[test]
    fn other_versions_are_read() {
        let mut newer = good();
        newer.flags[0] = 128;
        assert_eq!(answer(&asked(), &newer), Ok(()));
        let mut older = good();
        older.kept_areas.clear();
        assert_eq!(answer(&asked(), &older), Ok(()));
    }

    /// Catches a hull that is mistaken for another.
    #[test]
    fn ids_are_the_contents_hash() {
        let content = HullId([3; 32]);
        assert_eq!(registered(0, content, &[3; 32]), Ok(content));
        assert!(registered(5, content, &[4; 32]).expect_err("another").0.contains("hulls[5]"));
        assert!(registered(5, content, &[3; 31]).is_err());
        assert!(registrations(2, 1).is_err() && registrations(2, 2).is_ok());
    }
}

//! Checks a server's answers before any part of an answer is used.
//!
//! Another implementation of the server, a proxy or a cache may send the answer to another request, or
//! columns that do not fit together. The Python client makes the same checks
//! (`client/src/hullcast/_checked.py`).

use hullcast_proto::{FeatureKind, Flag, Outcome, Output, QueryContactsRequest, QueryContactsResponse};

use crate::columns::{Outputs, Per, lengths};

/// The flags that explain why a pair is INVALID.
const REASONS: u8 = Flag::UnknownHull as u8 | Flag::HullUnavailable as u8 | Flag::InvalidBody as u8;
/// The flags of INVALID pairs that blame a hull.
const HULL_REASONS: u8 = Flag::UnknownHull as u8 | Flag::HullUnavailable as u8;
/// The bits of `Flag` that this version knows.
const KNOWN_FLAGS: u8 = 255;
/// A normal's squared length may differ from 1 by this much.
const NORMAL_ERROR: f64 = 1e-6;

/// An answer that no correct server gives to the request. The text names the column and the index at fault.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the server's answer is malformed: {0}")]
pub struct Malformed(String);

impl Malformed {
    pub(crate) fn new(text: impl Into<String>) -> Self {
        Self(text.into())
    }

    /// Returns an error unless the answer has one result for each element of the request.
    pub(crate) fn unless_one_each(name: &str, found: usize, asked: usize) -> Result<(), Self> {
        if found == asked {
            return Ok(());
        }
        malformed(format!("{name} has {found} entries, expected {asked}"))
    }
}

fn malformed<T>(text: impl Into<String>) -> Result<T, Malformed> {
    Err(Malformed(text.into()))
}

/// Checks the answer to a query.
///
/// # Errors
/// The first defect found, with its column and index.
pub(crate) fn answer(
    request: &QueryContactsRequest,
    response: &QueryContactsResponse,
) -> Result<(), Malformed> {
    checked(&Asked::of(request, &request.pairs, false), response)
}

/// The state of the checks from one message of a search to the next.
#[derive(Clone, Debug, Default)]
pub(crate) struct Found {
    /// The last pair of the messages so far; `None` before the first pair.
    last: Option<[u32; 2]>,
    /// Whether a message was checked before.
    has_begun: bool,
}

impl Found {
    /// Checks the next message of a search for pairs.
    ///
    /// # Errors
    /// The first defect found, with its column and index.
    pub(crate) fn check(
        &mut self,
        request: &QueryContactsRequest,
        response: &QueryContactsResponse,
    ) -> Result<(), Malformed> {
        let (pairs, rest) = response.pairs.as_chunks::<2>();
        if !rest.is_empty() {
            return malformed(format!("pairs has {} entries, expected 2 per pair", response.pairs.len()));
        }
        for (at, &[a, b]) in pairs.iter().enumerate() {
            if a >= b || b as usize >= request.body_hulls.len() {
                let bodies = request.body_hulls.len();
                return malformed(format!(
                    "pairs[{at}] is {a}, {b}: expected two bodies of {bodies}, the lower first"
                ));
            }
            if self.last.is_some_and(|last| last >= [a, b]) {
                return malformed(format!("pairs[{at}] is not after the pair before it"));
            }
            self.last = Some([a, b]);
        }
        if self.has_begun && !(response.missing_hulls.is_empty() && response.invalid_bodies.is_empty()) {
            return malformed("missing_hulls or invalid_bodies is in a message after the first");
        }
        self.has_begun = true;
        checked(&Asked::of(request, &response.pairs, true), response)?;
        let is_near = |&outcome: &u8| [Outcome::Contact as u8, Outcome::Undecided as u8].contains(&outcome);
        match response.outcomes.iter().position(|outcome| !is_near(outcome)) {
            None => Ok(()),
            Some(at) => malformed(format!(
                "outcomes[{at}] is {}, expected 1 or 3 of a found pair",
                response.outcomes[at]
            )),
        }
    }
}

/// The request and the pairs that an answer has to fit.
struct Asked<'a> {
    request: &'a QueryContactsRequest,
    outputs: Outputs,
    /// The bodies of the pairs that are answered, 2 per pair.
    pairs: &'a [u32],
    /// Whether the server found the pairs.
    is_search: bool,
}

impl<'a> Asked<'a> {
    fn of(request: &'a QueryContactsRequest, pairs: &'a [u32], is_search: bool) -> Self {
        Self { request, outputs: Outputs::of(request), pairs, is_search }
    }
}

/// Checks that an answer has the number of its request.
pub(crate) fn request_id(found: u64, expected: u64) -> Result<(), Malformed> {
    if found == expected {
        return Ok(());
    }
    malformed(format!("request_id is {found}, expected {expected}: it answers another request"))
}

fn checked(asked: &Asked<'_>, response: &QueryContactsResponse) -> Result<(), Malformed> {
    let request = asked.request;
    request_id(response.request_id, request.request_id)?;
    sizes(asked, response)?;
    ascending("missing_hulls", &response.missing_hulls, request.hull_ids.len())?;
    ascending("invalid_bodies", &response.invalid_bodies, request.body_hulls.len())?;
    for pair in 0..response.outcomes.len() {
        outcome(asked, response, pair)?;
        numbers(asked.outputs, response, pair)?;
    }
    for (name, values) in [
        ("witness_as", &response.witness_as),
        ("distances", &response.distances),
        ("witness_bs", &response.witness_bs),
    ] {
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            return malformed(format!("{name}[{at}] is {}, expected a finite number", values[at]));
        }
    }
    Ok(())
}

/// Checks every column's length.
fn sizes(asked: &Asked<'_>, response: &QueryContactsResponse) -> Result<(), Malformed> {
    let points: usize = response.point_counts.iter().map(|&count| count as usize).sum();
    for (column, length) in lengths(response) {
        // A server of the first version of the contract does not send a later column.
        let lacks = column.is_later && length == 0;
        let rows = if column.per == Per::Point { points } else { asked.pairs.len() / 2 };
        let is_sent = column.is_sent(asked.outputs, asked.is_search) && !lacks;
        let wanted = if is_sent { rows * column.width } else { 0 };
        if length != wanted {
            return malformed(format!("{} has {length} entries, expected {wanted}", column.name));
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
fn outcome(asked: &Asked<'_>, response: &QueryContactsResponse, pair: usize) -> Result<(), Malformed> {
    let (outcome, flags) = (i32::from(response.outcomes[pair]), response.flags[pair]);
    if !(Outcome::Contact as i32..=Outcome::Invalid as i32).contains(&outcome) {
        return malformed(format!("outcomes[{pair}] is {outcome}, expected 1 to 4"));
    }
    let fits = match outcome == Outcome::Invalid as i32 {
        // The reason may be a flag of a newer version.
        true => flags & (REASONS | !KNOWN_FLAGS) != 0,
        false => flags & REASONS == 0,
    };
    if !fits {
        return malformed(format!("flags[{pair}] is {flags}, which does not fit outcome {outcome}"));
    }
    let bodies = [asked.pairs[2 * pair], asked.pairs[2 * pair + 1]];
    let unusable = bodies.iter().any(|body| response.invalid_bodies.binary_search(body).is_ok());
    if unusable != (flags & Flag::InvalidBody as u8 != 0) {
        return malformed(format!("flags[{pair}] does not fit invalid_bodies"));
    }
    let lacks = |&body: &u32| {
        let hull = asked.request.body_hulls.get(body as usize);
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
fn numbers(outputs: Outputs, response: &QueryContactsResponse, pair: usize) -> Result<(), Malformed> {
    if outputs.has(Output::Features) {
        for (side, kind) in response.feature_kinds[2 * pair..][..2].iter().enumerate() {
            if *kind > FeatureKind::Face as u8 {
                return malformed(format!("feature_kinds[{}] is {kind}, expected 0 to 3", 2 * pair + side));
            }
        }
    }
    if i32::from(response.outcomes[pair]) == Outcome::Invalid as i32 {
        return Ok(());
    }
    if outputs.has(Output::Alpha) {
        let (alpha, lower, upper) =
            (response.alphas[pair], response.alpha_lowers[pair], response.alpha_uppers[pair]);
        if !(alpha.is_finite() && 0.0 <= lower && lower <= alpha && alpha <= upper) {
            return malformed(format!("alphas[{pair}] is {alpha}, outside its bracket {lower} to {upper}"));
        }
    }
    if outputs.has(Output::Normal) {
        let separation = response.separations[pair];
        if !separation.is_finite() {
            return malformed(format!("separations[{pair}] is {separation}, expected a finite number"));
        }
        let squared: f64 = response.normals[3 * pair..][..3].iter().map(|c| c * c).sum();
        if !((squared - 1.0).abs() <= NORMAL_ERROR) {
            return malformed(format!("normals[{}] begins a normal that is not a unit vector", 3 * pair));
        }
    }
    // A pair without a basis has no derivatives: its error is NaN.
    if let Some(error) = response.gradient_errors.get(pair)
        && *error < 0.0
    {
        return malformed(format!("gradient_errors[{pair}] is {error}, expected at least 0"));
    }
    match response.kept_areas.get(pair) {
        Some(kept) if !(0.0..=1.0).contains(kept) => {
            malformed(format!("kept_areas[{pair}] is {kept}, expected 0 to 1"))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type Defect = (&'static str, fn(&mut QueryContactsResponse));

    fn asked() -> QueryContactsRequest {
        QueryContactsRequest {
            request_id: 7,
            hull_ids: vec![vec![0; 32], vec![1; 32]],
            body_hulls: vec![0, 1, 0],
            pairs: vec![0, 2, 0, 1],
            outputs: (Output::Outcome as i32..=Output::NormalJacobian as i32).collect(),
            ..Default::default()
        }
    }

    /// The answer for two pairs: a contact with one point, and a pair whose hull is missing and whose body
    /// is unusable.
    fn good() -> QueryContactsResponse {
        let nan = f64::NAN;
        QueryContactsResponse {
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
            alpha_gradients: vec![0.5; 18],
            separation_gradients: vec![0.5; 18],
            normal_jacobians: vec![0.5; 54],
            gradient_errors: vec![1e-12, nan],
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
            ("alpha_gradients", |r| r.alpha_gradients.truncate(17)),
            ("separation_gradients", |r| r.separation_gradients.truncate(9)),
            ("normal_jacobians", |r| r.normal_jacobians.truncate(27)),
            ("gradient_errors", |r| r.gradient_errors.truncate(1)),
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
            ("gradient_errors[0]", |r| r.gradient_errors[0] = -1.0),
        ];
        for (name, spoil) in defects {
            let mut response = good();
            spoil(&mut response);
            let error = answer(&asked(), &response).expect_err(name);
            assert!(error.0.contains(name), "{name}: {error}");
        }
        assert_eq!(defects.len(), 37);
    }

    /// Catches a newer server's answer that is refused for a flag that this version does not know, and an
    /// older server's answer that is refused for a column that it does not have.
    #[test]
    fn other_versions_are_read() {
        let mut newer = good();
        newer.flags[0] = 128; // KINK; no flag is left that this version does not know.
        assert_eq!(answer(&asked(), &newer), Ok(()));
        let mut older = good();
        older.kept_areas.clear();
        older.alpha_gradients.clear();
        older.gradient_errors.clear();
        assert_eq!(answer(&asked(), &older), Ok(()));
    }

    /// Catches a search whose pairs are repeated, out of order or out of range, or are not near each other.
    #[test]
    fn every_defect_of_a_search_is_named() {
        let request = QueryContactsRequest { pairs: vec![], ..asked() };
        let first = || {
            let mut first = good();
            for column in [&mut first.outcomes, &mut first.flags] {
                column.truncate(1);
            }
            for column in [
                &mut first.alphas,
                &mut first.alpha_lowers,
                &mut first.alpha_uppers,
                &mut first.separations,
                &mut first.kept_areas,
                &mut first.gradient_errors,
            ] {
                column.truncate(1);
            }
            first.normals.truncate(3);
            first.alpha_gradients.truncate(9);
            first.separation_gradients.truncate(9);
            first.normal_jacobians.truncate(27);
            first.point_counts.truncate(1);
            first.feature_kinds.truncate(2);
            first.feature_indices.truncate(4);
            first.bases.truncate(6);
            first.iterations.truncate(1);
            first.support_calls.truncate(1);
            first.missing_hulls.clear();
            first.invalid_bodies.clear();
            QueryContactsResponse { pairs: vec![0, 2], ..first }
        };
        let next = || QueryContactsResponse { pairs: vec![1, 2], ..first() };
        let checked = |messages: &[QueryContactsResponse]| {
            let mut found = Found::default();
            messages.iter().try_for_each(|message| found.check(&request, message))
        };
        assert_eq!(checked(&[first(), next()]), Ok(()));
        let defects: &[Defect] = &[
            ("request_id", |r| r.request_id = 8),
            ("pairs has 1", |r| r.pairs.truncate(1)),
            ("pairs[0] is 2, 1", |r| r.pairs = vec![2, 1]),
            ("pairs[0] is 1, 3", |r| r.pairs = vec![1, 3]),
            ("pairs[0] is not after", |r| r.pairs = vec![0, 2]),
            ("pairs[0] is not after", |r| r.pairs = vec![0, 1]),
            ("missing_hulls", |r| r.missing_hulls = vec![1]),
            ("invalid_bodies", |r| r.invalid_bodies = vec![0]),
            ("outcomes[0]", |r| (r.outcomes, r.point_counts) = (vec![2], vec![0])),
            ("outcomes has 0", |r| r.outcomes.clear()),
        ];
        for (name, spoil) in defects {
            let mut message = next();
            spoil(&mut message);
            // A separated pair has no points.
            if message.point_counts == [0] {
                for column in [&mut message.witness_as, &mut message.witness_bs, &mut message.distances] {
                    column.clear();
                }
                message.point_ids.clear();
            }
            let error = checked(&[first(), message]).expect_err(name);
            assert!(error.0.contains(name), "{name}: {error}");
        }
    }
}

//! Queries of listed pairs.

use hullcast_proto::{QueryContactsRequest, QueryContactsResponse};

use crate::client::Deadline;
use crate::columns::BASIS;
use crate::{Client, Error, Hull, append, checked};

/// The most registrations within one query, because another caller may delete a hull again and again.
pub(crate) const MAX_REGISTRATIONS: usize = 3;

/// The reasons of refusals after which a query of fewer of the pairs may be accepted.
const TOO_LARGE: &[&str] = &["RESPONSE_TOO_LARGE", "MESSAGE_TOO_LARGE", "MEMORY_TOO_LARGE"];

impl Client {
    /// Answers each pair that the request lists, in order.
    ///
    /// The request is a scene of bodies, and pairs of them; [`Scene`](crate::Scene) builds one. The answer is
    /// columnar, and [`pairs`](crate::pairs) reads it pair by pair. A request with more pairs than the server
    /// accepts, or whose answer would be too large, is sent in parts; the answer is the same. Its
    /// `request_id` is that of the request.
    ///
    /// A pair whose hull the server lacks, or whose body has an unusable pose, has the outcome INVALID; this
    /// is not an error. [`Client::query_registering`] registers such hulls.
    ///
    /// # Errors
    /// [`Error::Refused`] if the request is malformed or over a limit. [`Error::TimedOut`] if the timeout ends
    /// before all parts are answered.
    pub async fn query(&self, request: &QueryContactsRequest) -> Result<QueryContactsResponse, Error> {
        self.query_by(self.deadline(), request).await
    }

    /// Answers each pair as [`Client::query`] does, and registers those of `hulls` that the server lacks.
    ///
    /// This is for servers that may have lost their hulls, for example because they keep them in memory and
    /// were restarted. Hulls are sent only if the answer names them as missing.
    ///
    /// # Errors
    /// Those of [`Client::query`] and [`Client::register`].
    pub async fn query_registering(
        &self,
        request: &QueryContactsRequest,
        hulls: &[Hull],
    ) -> Result<QueryContactsResponse, Error> {
        let deadline = self.deadline();
        let mut answer = self.query_by(deadline, request).await?;
        for _ in 0..MAX_REGISTRATIONS {
            if !self.restored(deadline, request, &answer, hulls).await? {
                break;
            }
            answer = self.query_by(deadline, request).await?;
        }
        Ok(answer)
    }

    /// Registers those of `hulls` that the answer names as missing. Returns whether there were any.
    pub(crate) async fn restored(
        &self,
        deadline: Deadline,
        request: &QueryContactsRequest,
        answer: &QueryContactsResponse,
        hulls: &[Hull],
    ) -> Result<bool, Error> {
        if answer.missing_hulls.is_empty() || hulls.is_empty() {
            return Ok(false);
        }
        let missing: Vec<&[u8]> =
            answer.missing_hulls.iter().map(|&hull| request.hull_ids[hull as usize].as_slice()).collect();
        let ids: Vec<_> = hulls.iter().map(Hull::id).collect();
        let places: Vec<usize> =
            (0..hulls.len()).filter(|&hull| missing.contains(&&ids[hull].0[..])).collect();
        self.put_by(deadline, hulls, &ids, &places).await?;
        Ok(!places.is_empty())
    }

    /// Sends a request as one message, once: it is neither split nor repeated.
    ///
    /// This is for callers that do both themselves, such as a load generator. The answer is checked as that of
    /// [`Client::query`].
    ///
    /// # Errors
    /// Those of [`Client::query`]; [`Error::retry_after`] states when a busy server wants to be asked again.
    pub async fn query_once(&self, request: &QueryContactsRequest) -> Result<QueryContactsResponse, Error> {
        self.query_message(self.deadline(), request.clone(), false).await
    }

    async fn query_by(
        &self,
        deadline: Deadline,
        request: &QueryContactsRequest,
    ) -> Result<QueryContactsResponse, Error> {
        let pairs = request.pairs.len() / 2;
        let mut most = (self.limits(deadline).await?.max_pairs_per_request as usize).max(1);
        let mut whole: Option<QueryContactsResponse> = None;
        let mut begin = 0;
        loop {
            let end = pairs.min(begin + most);
            let answer = match self.query_message(deadline, part(request, begin, end), true).await {
                Err(error) if end - begin > 1 && error.is_for(TOO_LARGE) => {
                    most = (end - begin) / 2;
                    continue;
                }
                answer => answer?,
            };
            match &mut whole {
                None => whole = Some(answer),
                Some(whole) => append(whole, answer),
            }
            begin = end;
            if begin >= pairs {
                return Ok(whole.unwrap_or_default());
            }
        }
    }

    /// Sends one message and checks its answer.
    async fn query_message(
        &self,
        deadline: Deadline,
        mut request: QueryContactsRequest,
        may_repeat: bool,
    ) -> Result<QueryContactsResponse, Error> {
        let callers = std::mem::replace(&mut request.request_id, Self::next_request_id());
        let send = |request| {
            let mut stub = self.contacts();
            async move { stub.query_contacts(request).await }
        };
        let mut answer = match may_repeat {
            true => self.call(deadline, &request, send).await?,
            false => crate::client::once(deadline, request.clone(), send).await?,
        };
        self.check_contract(deadline, &request, &answer).await?;
        checked::answer(&request, &answer)?;
        answer.request_id = callers;
        Ok(answer)
    }
}

/// The request for the pairs from `begin` to `end`. A malformed request is returned whole, so that the server
/// names its fault.
fn part(request: &QueryContactsRequest, begin: usize, end: usize) -> QueryContactsRequest {
    let pairs = request.pairs.len() / 2;
    let is_whole = begin == 0 && end == pairs;
    let has_warm_starts = !request.warm_starts.is_empty();
    if is_whole
        || !request.pairs.len().is_multiple_of(2)
        || (has_warm_starts && request.warm_starts.len() != BASIS * pairs)
    {
        return request.clone();
    }
    let warm_starts = if has_warm_starts { &request.warm_starts[BASIS * begin..BASIS * end] } else { &[] };
    QueryContactsRequest {
        request_id: request.request_id,
        inherit: request.inherit,
        hull_ids: request.hull_ids.clone(),
        body_hulls: request.body_hulls.clone(),
        positions: request.positions.clone(),
        rotations: request.rotations.clone(),
        pairs: request.pairs[2 * begin..2 * end].to_vec(),
        worlds: request.worlds.clone(),
        groups: request.groups.clone(),
        ignored_groups: request.ignored_groups.clone(),
        margin: request.margin,
        accuracy: request.accuracy,
        outputs: request.outputs.clone(),
        warm_starts: warm_starts.to_vec(),
        find: request.find,
        moved: request.moved.clone(),
        margins: request.margins.clone(),
        linear_velocities: request.linear_velocities.clone(),
        angular_velocities: request.angular_velocities.clone(),
        time_step: request.time_step,
        turning_points: request.turning_points.clone(),
        previous_bodies: request.previous_bodies.clone(),
    }
}

//! Answers a query with the library in this process, or asks a server.
//!
//! Both take a request in the wire format and return a response in it. In this process the request goes
//! through the service's own batch engine, without the network and without a store.

use std::collections::{HashMap, HashSet};
use std::error::Error as StdError;
use std::iter;
use std::sync::Arc;
use std::time::Duration;

use tonic::{Code, Status};
use tonic_types::StatusExt;

use super::Error;
use super::checked;
use super::exit::Exit;
use super::options::QueryOptions;
use super::progress::Progress;
use super::remote::{Connection, RemoteArgs, root_cause};
use super::scene::{Frame, HullPoints, SceneFile};
use super::values::counted;
use hullcast::batch::{Batch, Missing, scene::Bodies};
use hullcast::budget::{Caller, Part, Permit};
use hullcast::compute::{Compute, Job};
use hullcast::contact::ConvexHull;
use hullcast::proto;
use hullcast::proto::register_hull_result::Result as Registered;
use hullcast::service::{EngineLimits, Limits, Reason, ServiceEngine, ServiceError, wire};
use hullcast::store::identity::id_of;
use hullcast::store::{HullDefinition, HullId};

/// Limit on the size of an answer that is computed in this process and never becomes a message.
const MAX_ANSWER_BYTES: usize = 2 << 30;
/// Hulls per registration message. For ordinary hulls that is at most some megabytes.
const HULLS_PER_MESSAGE: usize = 256;

/// The source of answers.
#[derive(Clone, Debug)]
pub(crate) enum Answerer {
    /// The library, called in this process.
    Local(Arc<Local>),
    /// A server.
    Remote(Connection),
}

/// The service's batch engine, with the hulls of the scene.
#[derive(Debug)]
pub(crate) struct Local {
    engine: ServiceEngine,
    limits: Limits,
    hulls: HashMap<HullId, Arc<ConvexHull>>,
}

/// The error for a hull of the scene that was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("hulls[{hull}].{field}{}: {reason}", .index.map(|index| format!("[{index}]")).unwrap_or_default())]
pub(crate) struct HullRefused {
    hull: usize,
    field: String,
    index: Option<usize>,
    reason: String,
}

/// The error for a query that was not answered.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub(crate) struct Refusal {
    /// The reason, in words.
    pub(crate) text: String,
    /// How long to wait before asking again, if the server was too busy.
    pub(crate) retry_after: Option<Duration>,
    /// Whether the server or the connection was lost, so that another server may be able to answer.
    pub(crate) lost: bool,
    /// The exit code for this error.
    pub(crate) exit: Exit,
}

impl From<ServiceError> for Refusal {
    fn from(error: ServiceError) -> Self {
        let exit = match error.reason.code() {
            Code::InvalidArgument => Exit::Input,
            _ => Exit::Refused,
        };
        Self { text: error.to_string(), retry_after: error.retry_after, lost: false, exit }
    }
}

impl From<checked::Malformed> for Refusal {
    fn from(error: checked::Malformed) -> Self {
        Self { text: error.to_string(), retry_after: None, lost: false, exit: Exit::Refused }
    }
}

impl From<Status> for Refusal {
    fn from(status: Status) -> Self {
        let retry_after = status.get_details_retry_info().and_then(|info| info.retry_delay);
        // A status with a cause was made by tonic in this process, not sent by a server.
        let is_made_here = status.source().is_some() && !is_cut(&status);
        let lost = retry_after.is_none() && (status.code() == Code::Unavailable || is_made_here);
        let exit = match status.code() {
            _ if lost => Exit::Unreachable,
            Code::InvalidArgument => Exit::Input,
            _ => Exit::Refused,
        };
        Self { text: described(&status), retry_after, lost, exit }
    }
}

impl Answerer {
    /// Answers in this process, on `threads` threads (0: one per core), for these hulls. Also returns the
    /// ids of the hulls.
    ///
    /// # Errors
    /// A hull is refused, or the system cannot start the threads.
    pub(crate) fn local(hulls: &[HullPoints], threads: usize) -> Result<(Self, Vec<HullId>), Error> {
        let limits = Limits::default();
        let mut built = HashMap::new();
        let mut ids = Vec::with_capacity(hulls.len());
        let progress = Progress::new("building hulls", hulls.len());
        for (i, points) in hulls.iter().enumerate() {
            progress.add(1);
            let definition = definition(points);
            let id = id_of(&definition.identity_bytes());
            let hull = definition.build(limits.max_vertices_per_hull as usize).map_err(|e| HullRefused {
                hull: i,
                field: e.kind.field().into(),
                index: e.index,
                reason: format!("{}: {}", e.kind.reason(), e.detail),
            })?;
            built.insert(id, Arc::new(hull));
            ids.push(id);
        }
        let compute = Compute::new(threads)?;
        let bounds = EngineLimits {
            max_pairs_in_flight: limits.max_pairs_in_flight,
            shares: false,
            max_answer_bytes: MAX_ANSWER_BYTES,
        };
        let engine = ServiceEngine::new(compute, bounds, Arc::default());
        Ok((Self::Local(Arc::new(Local { engine, limits, hulls: built })), ids))
    }

    /// Connects to the server at `address` and registers the hulls there. Also returns their ids.
    ///
    /// # Errors
    /// No server answers at the address, or the server refuses a hull or fails.
    pub(crate) async fn remote(
        address: &str,
        args: &RemoteArgs,
        hulls: &[HullPoints],
    ) -> Result<(Self, Vec<HullId>), Error> {
        let connection = Connection::open(address, args).await?;
        let content: Vec<HullId> = hulls.iter().map(|h| id_of(&definition(h).identity_bytes())).collect();
        // A caller that may only query can use hulls that others have registered.
        let lacking = lacking(&connection, &content).await?;
        let progress = Progress::new("registering hulls", lacking.len());
        let mut service = connection.hulls();
        for part in lacking.chunks(HULLS_PER_MESSAGE) {
            let definitions = part.iter().map(|&hull| wire_definition(&hulls[hull])).collect();
            let request = proto::RegisterHullsRequest { hulls: definitions };
            let answer = service.register_hulls(request).await;
            let results = answer.map_err(|s| not_registered(&s, lacking.len(), hulls.len()))?.into_inner();
            checked::registrations(part.len(), results.results.len())?;
            for (&hull, result) in part.iter().zip(results.results) {
                registered(hull, content[hull], result)?;
            }
            progress.add(part.len());
        }
        Ok((Self::Remote(connection), content))
    }

    /// Answers a request.
    ///
    /// # Errors
    /// The request is refused, or the server fails.
    pub(crate) async fn answer(
        &self,
        request: proto::QueryContactsRequest,
    ) -> Result<proto::QueryContactsResponse, Refusal> {
        match self {
            Self::Local(local) => local.answer(request).await.map_err(Into::into),
            Self::Remote(remote) => {
                let asked =
                    proto::QueryContactsRequest { request_id: Connection::next_request_id(), ..request };
                let mut response = remote.contacts().query_contacts(asked.clone()).await?.into_inner();
                checked::answer(&asked, &response)?;
                response.request_id = request.request_id;
                Ok(response)
            }
        }
    }
}

impl Local {
    async fn answer(
        &self,
        request: proto::QueryContactsRequest,
    ) -> Result<proto::QueryContactsResponse, ServiceError> {
        let scene = wire::scene(request, &self.limits)?;
        let job = Job::new(Caller::alone());
        let (pairs, outputs) = (scene.template.pair_count(), scene.template.outputs());
        let admission = self.engine.admit(pairs, outputs, &job.caller)?;
        let known = |id| self.hulls.get(id).cloned().ok_or(Missing::Unknown);
        let hulls = scene.hull_ids.iter().map(known).collect();
        let (request_id, invalid_bodies) = (scene.request_id, scene.invalid_bodies);
        let bodies = Bodies::new(scene.template, Arc::new(hulls), Arc::new(scene.poses))?;
        let batch = Batch::new(bodies, scene.warm_starts)?;
        let memory = Permit::unbounded(Part::Answers);
        let (columns, _memory) = self.engine.compute(batch, None, admission, &job, memory).await?;
        Ok(wire::response(request_id, columns, Vec::new(), invalid_bodies))
    }
}

/// Another connection to the server at `address`, where the hulls are registered already.
///
/// # Errors
/// No server answers at the address.
pub(crate) async fn another_connection(address: &str, args: &RemoteArgs) -> Result<Answerer, Error> {
    Ok(Answerer::Remote(Connection::open(address, args).await?))
}

/// The hull's definition as the store identifies it.
pub(crate) fn definition(points: &HullPoints) -> HullDefinition {
    HullDefinition {
        points: points.vertices.clone(),
        contraction_point: points.contraction_point,
        simplification: None,
        planarity: points.planarity,
    }
}

fn wire_definition(points: &HullPoints) -> proto::HullDefinition {
    proto::HullDefinition {
        vertices: points.vertices.as_flattened().to_vec(),
        contraction_point: points.contraction_point.map(Vec::from).unwrap_or_default(),
        simplification: None,
        planarity: points.planarity,
    }
}

/// The indices in `ids` of the hulls that the server does not have, without repetitions.
async fn lacking(connection: &Connection, ids: &[HullId]) -> Result<Vec<usize>, Error> {
    let mut seen = HashSet::new();
    let distinct: Vec<usize> = (0..ids.len()).filter(|&hull| seen.insert(ids[hull])).collect();
    let mut service = connection.hulls();
    let mut lacking = Vec::new();
    for part in distinct.chunks(HULLS_PER_MESSAGE) {
        let request = proto::HasHullsRequest { ids: part.iter().map(|&hull| ids[hull].0.to_vec()).collect() };
        let present = service.has_hulls(request).await.map_err(Refusal::from)?.into_inner().present;
        checked::registrations(part.len(), present.len())?;
        lacking.extend(part.iter().zip(present).filter(|(_, present)| !present).map(|(&hull, _)| hull));
    }
    Ok(lacking)
}

/// The error that `lacking` of the hulls were not registered.
fn not_registered(status: &Status, lacking: usize, hulls: usize) -> Error {
    let refusal = Refusal::from(status.clone());
    if status.code() != Code::PermissionDenied {
        return refusal.into();
    }
    refusal.exit.error(format!(
        "the server lacks {lacking} of {}, and the token may not register them ({refusal}); \
         register them first, with a token of the server's --register-tokens",
        counted(hulls, "hull")
    ))
}

fn registered(hull: usize, content: HullId, result: proto::RegisterHullResult) -> Result<HullId, Error> {
    match result.result {
        Some(Registered::Hull(info)) => Ok(checked::registered(hull, content, &info.id)?),
        Some(Registered::Error(e)) => {
            let reason = format!("{}: {}", e.reason, e.message);
            Err(HullRefused { hull, field: e.field, index: e.index.map(|i| i as usize), reason }.into())
        }
        None => Err(Exit::Refused.error("the server gave a result that this version does not know")),
    }
}

/// An error about a hull, with the scene file that has the hull.
pub(crate) fn in_scene(error: Error, scene: &str) -> Error {
    match error.downcast::<HullRefused>() {
        Ok(refused) => Exit::Input.error(format!("{scene}: {refused}")),
        Err(other) => other,
    }
}

/// An error of a query, with the server's address if its connection was lost.
pub(crate) fn at_server(error: Error, address: &str) -> Error {
    match error.downcast::<Refusal>() {
        Ok(refusal) if refusal.lost => {
            let text = format!("the connection to {address} was lost: {}", refusal.text);
            Refusal { text, ..*refusal }.into()
        }
        Ok(refusal) => refusal,
        Err(other) => other,
    }
}

/// Whether the server reset the call: it does so if the answer is not read in time (docs/errors.md).
fn is_cut(status: &Status) -> bool {
    // Nothing in this process cancels a call and then reads its status. hyper cancels the calls that wait on
    // a connection which breaks.
    let mut causes = iter::successors(status.source(), |&cause| cause.source());
    let is_broken = causes.any(|cause| cause.downcast_ref().is_some_and(hyper::Error::is_canceled));
    status.code() == Code::Cancelled && !is_broken
}

/// A status as a sentence.
fn described(status: &Status) -> String {
    match status.code() {
        _ if is_cut(status) => {
            "Cancelled: the server reset the call, because the answer was not read in time; the server's \
             settings answer_seconds and max_deadline_seconds decide how long that is"
                .into()
        }
        Code::Unauthenticated => {
            let reason = status.get_details_error_info().map(|info| info.reason).unwrap_or_default();
            let hint = match reason.as_str() {
                reason if reason == Reason::MissingToken.name() => {
                    ": give a file with a token by --token-file"
                }
                reason if reason == Reason::UnknownToken.name() => ": --token-file needs another token",
                _ => "",
            };
            format!("Unauthenticated: {}{hint}", status.message())
        }
        // For its own failures, the cause says more than tonic's message.
        Code::Unknown | Code::Unavailable if status.source().is_some() => root_cause(status),
        code => format!("{code:?}: {}", status.message()),
    }
}

/// The request for a frame of a scene. `ids` are the ids of the scene's hulls.
pub(crate) fn request(
    scene: &SceneFile,
    frame: &Frame,
    ids: &[HullId],
    options: &QueryOptions,
) -> proto::QueryContactsRequest {
    // The wire format names each hull once, but a scene may contain the same points twice.
    let mut place = HashMap::new();
    let mut distinct = Vec::new();
    let hulls: Vec<u32> = ids
        .iter()
        .map(|id| {
            *place.entry(*id).or_insert_with(|| {
                distinct.push(id.0.to_vec());
                distinct.len() as u32 - 1
            })
        })
        .collect();
    proto::QueryContactsRequest {
        hull_ids: distinct,
        body_hulls: scene.body_hulls.iter().map(|&h| hulls[h as usize]).collect(),
        positions: frame.positions.clone(),
        rotations: frame.rotations.clone(),
        pairs: scene.pairs.clone(),
        margin: options.margin,
        accuracy: Some(options.accuracy),
        outputs: options.outputs.clone(),
        ..Default::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a call that the server cut and that looks like a lost server: another server would be asked,
    /// and the reader would not learn the reason.
    #[test]
    fn a_call_that_was_cut_says_why() {
        let refusal = Refusal::from(Status::cancelled("h2 protocol error: stream error received"));
        assert!(
            refusal.text.contains("not read in time") && refusal.text.contains("answer_seconds"),
            "{refusal}"
        );
        assert_eq!((refusal.lost, refusal.exit), (false, Exit::Refused));
        let refusal = Refusal::from(Status::unavailable("gone"));
        assert!(refusal.lost && !refusal.text.contains("answer_seconds"), "{refusal}");
    }
}

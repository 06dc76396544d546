//! Answers a query with the library in this process, or asks a server.
//!
//! Both take a request in the wire format and return a response in it. In this process the request goes
//! through the service's own batch engine, without the network and without a store.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use hullcast_client::{Client, Error as CallError, Hull, HullRefused};
use tonic::Code;

use super::Error;
use super::exit::Exit;
use super::options::QueryOptions;
use super::progress::Progress;
use super::remote::RemoteArgs;
use super::scene::{Frame, HullPoints, SceneFile};
use super::values::counted;
use hullcast::batch::{Batch, Missing, scene::Bodies};
use hullcast::budget::{Caller, Part, Permit};
use hullcast::compute::{Compute, Job};
use hullcast::contact::ConvexHull;
use hullcast::proto;
use hullcast::service::{EngineLimits, Limits, Reason, ServiceEngine, ServiceError, wire};
use hullcast::store::identity::id_of;
use hullcast::store::{HullDefinition, HullId};

/// Limit on the size of an answer that is computed in this process and never becomes a message.
const MAX_ANSWER_BYTES: usize = 2 << 30;
/// Hulls per registration, after which the progress is shown.
const HULLS_PER_STEP: usize = 256;

/// The source of answers.
#[derive(Clone, Debug)]
pub(crate) enum Answerer {
    /// The library, called in this process.
    Local(Arc<Local>),
    /// A server.
    Remote(Client),
}

/// The service's batch engine, with the hulls of the scene.
#[derive(Debug)]
pub(crate) struct Local {
    engine: ServiceEngine,
    limits: Limits,
    hulls: HashMap<HullId, Arc<ConvexHull>>,
}

/// The error for a query that was not answered.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub(crate) struct QueryRefusal {
    /// The reason, in words.
    pub(crate) text: String,
    /// How long to wait before asking again, if the server was too busy.
    pub(crate) retry_after: Option<Duration>,
    /// Whether the server or the connection was lost, so that another server may be able to answer.
    pub(crate) lost: bool,
    /// The exit code for this error.
    pub(crate) exit: Exit,
}

impl From<ServiceError> for QueryRefusal {
    fn from(error: ServiceError) -> Self {
        let exit = match error.reason.code() {
            Code::InvalidArgument => Exit::Input,
            _ => Exit::Refused,
        };
        Self { text: error.to_string(), retry_after: error.retry_after, lost: false, exit }
    }
}

impl From<CallError> for QueryRefusal {
    fn from(error: CallError) -> Self {
        let exit = match &error {
            CallError::Unreachable(_) | CallError::Lost(_) => Exit::Unreachable,
            CallError::Address(_) | CallError::Setting(_) | CallError::HullsRefused(_) => Exit::Input,
            CallError::Refused(refusal) if refusal.code == Code::InvalidArgument => Exit::Input,
            _ => Exit::Refused,
        };
        let lost = matches!(error, CallError::Lost(_));
        let text = format!("{error}{}", hint(&error));
        Self { text, retry_after: error.retry_after(), lost, exit }
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
                reason: e.kind.reason().into(),
                message: e.detail,
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
        let client = args.connect(address).await?;
        let content: Vec<HullId> = hulls.iter().map(|h| id_of(&definition(h).identity_bytes())).collect();
        let ids: Vec<_> = content.iter().map(|id| hullcast_client::HullId(id.0)).collect();
        // A caller that may only query can use hulls that others have registered.
        let missing = client.missing(&ids).await.map_err(QueryRefusal::from)?;
        let progress = Progress::new("registering hulls", missing.len());
        for part in missing.chunks(HULLS_PER_STEP) {
            let definitions: Vec<Hull> = part.iter().map(|&hull| client_hull(&hulls[hull])).collect();
            if let Err(error) = client.put(&definitions).await {
                return Err(not_registered(error, part, missing.len(), hulls.len()));
            }
            progress.add(part.len());
        }
        Ok((Self::Remote(client), content))
    }

    /// Answers a request.
    ///
    /// # Errors
    /// The request is refused, or the server fails.
    pub(crate) async fn answer(
        &self,
        request: proto::QueryContactsRequest,
    ) -> Result<proto::QueryContactsResponse, QueryRefusal> {
        match self {
            Self::Local(local) => local.answer(request).await.map_err(Into::into),
            Self::Remote(client) => Ok(client.query_once(&request).await?),
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
    Ok(Answerer::Remote(args.connect(address).await?))
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

/// The hull's definition as the client registers it.
pub(crate) fn client_hull(points: &HullPoints) -> Hull {
    Hull {
        points: points.vertices.clone(),
        contraction_point: points.contraction_point,
        simplification: None,
        planarity: points.planarity,
    }
}

/// The error that hulls were not registered. `part` has the places of the hulls that were sent, of `missing`
/// in all.
fn not_registered(error: CallError, part: &[usize], missing: usize, hulls: usize) -> Error {
    match error {
        CallError::HullsRefused(refused) => match refused.into_iter().next() {
            Some(first) => HullRefused { hull: part[first.hull], ..first }.into(),
            None => Exit::Refused.error("no hull was refused"),
        },
        CallError::Refused(refusal) if refusal.code == Code::PermissionDenied => {
            Exit::Refused.error(format!(
                "the server lacks {missing} of {}, and the token may not register them ({refusal}); \
                 register them first, with a token of the server's --register-tokens",
                counted(hulls, "hull")
            ))
        }
        error => QueryRefusal::from(error).into(),
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
    match error.downcast::<QueryRefusal>() {
        Ok(refusal) if refusal.lost => {
            let text = format!("the connection to {address} was lost: {}", refusal.text);
            QueryRefusal { text, ..*refusal }.into()
        }
        Ok(refusal) => refusal,
        Err(other) => other,
    }
}

/// The option that a refused call needs, if it is about the caller's token.
fn hint(error: &CallError) -> &'static str {
    match error {
        CallError::Refused(refusal) if refusal.reason == Reason::MissingToken.name() => {
            ": give a file with a token by --token-file"
        }
        CallError::Refused(refusal) if refusal.reason == Reason::UnknownToken.name() => {
            ": --token-file needs another token"
        }
        _ => "",
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
        margins: scene.margins.clone(),
        accuracy: Some(options.accuracy),
        outputs: options.outputs.clone(),
        ..Default::default()
    }
}

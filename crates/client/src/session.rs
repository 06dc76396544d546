//! Loops over the same bodies, in which every step sends only the poses that changed.

use hullcast_proto::{QueryContactsRequest, QueryContactsResponse};
use tokio::sync::mpsc;
use tokio_stream::{StreamExt, wrappers::ReceiverStream};
use tonic::{Code, Request, Streaming};

use crate::checked::{self, Found, Malformed};
use crate::client::{Deadline, by};
use crate::columns::BASIS;
use crate::contract::{LOOP_CONTRACT, needed};
use crate::query::MAX_REGISTRATIONS;
use crate::{Client, Error, Hull, append, matches};

/// The reasons for which a server refuses a message that inherits: it does not have the state of the session.
const STATE_IS_GONE: &[&str] = &["NOTHING_TO_INHERIT", "STATE_NOT_KEPT"];
/// The reason with which a server that is about to stop ends its streams.
const STOPPING: &[&str] = &["STOPPING"];

/// Steps of a simulation: the same bodies, with new poses in each step ([`Client::session`]).
///
/// The first step sends the whole request. Each later step sends the poses, and velocities if they are new, of the
/// bodies that have changed since the step before it, and the server starts the solver from the bases of that
/// step. If the request has `find`, the server finds the pairs in each step, and [`Session::update`] adds and
/// removes bodies.
///
/// If the server has dropped the state of the session, or is lost or stopping, the step is repeated on a new
/// stream with the whole request, and [`Session::has_restarted`] is true; after the loss or the stop of a server
/// only if the client repeats calls ([`Builder::retries`](crate::Builder::retries)). With given pairs, its bases
/// are then those of the last answer if the request asks for the output BASES; otherwise the server starts
/// without bases, which may change the last digits of an answer.
///
/// A session makes one step at a time. Several sessions may share a [`Client`]. Dropping a session ends its
/// stream.
#[derive(Debug)]
pub struct Session {
    client: Client,
    request: QueryContactsRequest,
    hulls: Vec<Hull>,
    /// The open stream. It is `None` during a step, and after a step that failed or was dropped.
    stream: Option<Stream>,
    /// The last answer, which the next one may repeat or refer to.
    last: Option<QueryContactsResponse>,
    has_restarted: bool,
}

#[derive(Debug)]
struct Stream {
    requests: mpsc::Sender<QueryContactsRequest>,
    answers: Streaming<QueryContactsResponse>,
    /// The poses and velocities that the server has. It is `None` if the server keeps nothing of the last message.
    sent: Option<Sent>,
    /// The contract number of the last answer; 0 before the first.
    contract: u32,
}

/// The poses and velocities of all bodies, flattened. Velocities may be empty, which means 0.
#[derive(Debug)]
struct Sent {
    positions: Vec<f64>,
    rotations: Vec<f64>,
    linear_velocities: Vec<f64>,
    angular_velocities: Vec<f64>,
}

impl Sent {
    /// Those of a request.
    fn of(request: &QueryContactsRequest) -> Self {
        Self {
            positions: request.positions.clone(),
            rotations: request.rotations.clone(),
            linear_velocities: request.linear_velocities.clone(),
            angular_velocities: request.angular_velocities.clone(),
        }
    }
}

/// Whether the entries of a body in two columns have other bits. The server compares bits too: NaN is the same
/// value, and -0.0 another one. A column that is empty has zeros.
fn differs<const N: usize>(body: usize, one: &[f64], other: &[f64]) -> bool {
    let [one, other] =
        [one, other].map(|column| column.as_chunks::<N>().0.get(body).copied().unwrap_or([0.0; N]));
    one.map(f64::to_bits) != other.map(f64::to_bits)
}

impl Client {
    /// Begins a session with the bodies, pairs and options of `request`; its poses are replaced by those of
    /// the first step. Nothing is sent before the first step.
    ///
    /// If `request.find` is set, the request has no pairs, and the server finds them in each step as
    /// [`Client::find`] does, with its worlds and groups.
    ///
    /// `hulls` are registered again if the server has lost them, for example because it was restarted with an
    /// empty store; the list may be empty. The number of pairs is bounded by the server's
    /// `max_pairs_per_request`, and that of bodies by `max_bodies_per_request`: use several sessions for more.
    pub fn session(&self, request: QueryContactsRequest, hulls: Vec<Hull>) -> Session {
        Session { client: self.clone(), request, hulls, stream: None, last: None, has_restarted: true }
    }
}

impl Session {
    /// Sets the velocities of the bodies for the following steps. They widen the margin of each pair by the
    /// largest distance by which its bodies can approach each other within `time_step`.
    ///
    /// `linear` are the velocities of the bodies' turning points and `angular` their rates of turn in radians
    /// per unit of time, both along the world's axes; each is empty, which means 0, or has one entry per body.
    /// The turning points are those of the session's request. With a time step of 0 nothing moves.
    ///
    /// # Errors
    /// [`Error::WrongLength`] if there is neither nothing nor one velocity per body.
    pub fn set_velocities(
        &mut self,
        linear: &[[f64; 3]],
        angular: &[[f64; 3]],
        time_step: f64,
    ) -> Result<(), Error> {
        let bodies = self.request.body_hulls.len();
        for (field, found) in [("linear_velocities", linear.len()), ("angular_velocities", angular.len())] {
            if found != 0 && found != bodies {
                return Err(Error::WrongLength { field, found, expected: bodies });
            }
        }
        // A message that inherits keeps the velocities that it does not send, so none are sent as zeros.
        let column = |given: &[[f64; 3]]| match given {
            [] => vec![0.0; 3 * bodies],
            given => given.as_flattened().to_vec(),
        };
        self.request.linear_velocities = column(linear);
        self.request.angular_velocities = column(angular);
        self.request.time_step = time_step;
        Ok(())
    }

    /// Moves the bodies and answers the pairs.
    ///
    /// `positions` are the world positions of the hulls' origins, and `rotations` the quaternions x, y, z, w:
    /// one each per body. The answer has the columns of [`Client::query`], or with `find` those of
    /// [`Client::find_all`]; its `request_id` is that of the session's request. With the output MATCHES, its
    /// columns `previous_pairs`, `previous_points` and `ended_pairs` refer to the answer of the step before.
    ///
    /// # Errors
    /// [`Error::WrongLength`] if there is not one pose per body; [`Error::Refused`] if the request is malformed
    /// or over a limit; [`Error::TooOld`] if the server does not know a field of the request;
    /// [`Error::TimedOut`] or [`Error::Lost`] if no server answers in time. The session can be used again after
    /// any error.
    pub async fn step(
        &mut self,
        positions: &[[f64; 3]],
        rotations: &[[f64; 4]],
    ) -> Result<QueryContactsResponse, Error> {
        let bodies = self.request.body_hulls.len();
        for (field, found) in [("positions", positions.len()), ("rotations", rotations.len())] {
            if found != bodies {
                return Err(Error::WrongLength { field, found, expected: bodies });
            }
        }
        self.request.positions = positions.as_flattened().to_vec();
        self.request.rotations = rotations.as_flattened().to_vec();
        self.stepped(None).await
    }

    /// Makes a step with other bodies, pairs and options: `request` replaces that of the session, and its poses
    /// are those of the step. `hulls` replaces the hulls that are registered again if the server has lost them.
    ///
    /// `previous_bodies` has for each body its index in the step before, or `u32::MAX` for a new body; an index
    /// may be there once, and a body with another hull is new. If it is empty, all bodies are new.
    ///
    /// # Errors
    /// Those of [`Session::step`]; [`Error::WrongLength`] if `previous_bodies` is neither empty nor one per
    /// body.
    pub async fn update(
        &mut self,
        request: QueryContactsRequest,
        hulls: Vec<Hull>,
        previous_bodies: &[u32],
    ) -> Result<QueryContactsResponse, Error> {
        let (found, expected) = (previous_bodies.len(), request.body_hulls.len());
        if found != 0 && found != expected {
            return Err(Error::WrongLength { field: "previous_bodies", found, expected });
        }
        (self.request, self.hulls) = (request, hulls);
        self.stepped(Some(previous_bodies)).await
    }

    /// Whether the last answer was computed without the one before it, so that it has no matches: in the first
    /// step, and after a server or its state was lost, a step failed, or an update had only new bodies.
    pub fn has_restarted(&self) -> bool {
        self.has_restarted
    }

    /// Makes a step; `previous` is `Some` if the request has other bodies than in the step before.
    async fn stepped(&mut self, previous: Option<&[u32]>) -> Result<QueryContactsResponse, Error> {
        let deadline = self.client.deadline();
        let mut answer = self.answered(deadline, previous).await?;
        for _ in 0..MAX_REGISTRATIONS {
            let client = self.client.clone();
            if !client.restored(deadline, &self.request, &answer, &self.hulls).await? {
                break;
            }
            // The whole request is sent again, because a message that inherits would start from the bases of
            // pairs without an answer.
            self.stream = None;
            answer = self.answered(deadline, previous).await?;
        }
        if !answer.bases.is_empty() && !self.request.find {
            self.request.warm_starts.clone_from(&answer.bases);
        }
        Ok(answer)
    }

    /// Makes one step. If the open stream or its state is gone, the step is repeated once, at once, on a new
    /// stream. Unless only the state is gone, this and all other repetitions follow the settings of the
    /// connection.
    async fn answered(
        &mut self,
        deadline: Deadline,
        previous: Option<&[u32]>,
    ) -> Result<QueryContactsResponse, Error> {
        let mut losses = 0;
        loop {
            let inherits = self.stream.is_some();
            let error = match by(deadline, self.attempt(previous)).await? {
                Ok(answer) => return Ok(answer),
                Err(error) => error,
            };
            // A server that drains ends its streams between two steps, so there is no pause here.
            let is_ended = error.is_for(STOPPING) || matches!(error, Error::Lost(_));
            if inherits && (error.is_for(STATE_IS_GONE) || (is_ended && self.client.retries())) {
                continue;
            }
            let is_argument =
                matches!(&error, Error::Refused(refusal) if refusal.code == Code::InvalidArgument);
            if let Error::TooOld { contract, needed, .. } = error {
                let version = self.client.info_by(deadline).await?.version;
                return Err(Error::TooOld { version, contract, needed });
            }
            if !inherits && is_argument && needed(&self.request) > 0 {
                // An old server ignores `find`, and refuses the worlds and groups that come with it.
                self.check_contract(deadline).await?;
            }
            self.client.wait_to_repeat(deadline, error, &mut losses).await?;
        }
    }

    /// Asks the server for its contract number.
    ///
    /// # Errors
    /// [`Error::TooOld`] if the server does not know a field that the request needs.
    async fn check_contract(&self, deadline: Deadline) -> Result<(), Error> {
        let info = self.client.info_by(deadline).await?;
        let needed = needed(&self.request);
        if info.contract >= needed {
            return Ok(());
        }
        Err(Error::TooOld { version: info.version, contract: info.contract, needed })
    }

    /// Sends one message and reads its answer. The stream stays only if both succeed.
    async fn attempt(&mut self, previous: Option<&[u32]>) -> Result<QueryContactsResponse, Error> {
        let request_id = Client::next_request_id();
        let mut stream = if let Some(mut stream) = self.stream.take() {
            let message = match (stream.sent.take(), previous) {
                (Some(sent), None) => self.moved(&sent, stream.contract),
                (Some(_), Some(bodies)) => {
                    QueryContactsRequest { previous_bodies: bodies.to_vec(), ..self.whole() }
                }
                (None, _) => self.whole(),
            };
            self.has_restarted = !message.inherit && message.previous_bodies.is_empty();
            // If the stream has ended, its receiving half has the reason.
            let _ = stream.requests.send(QueryContactsRequest { request_id, ..message }).await;
            stream
        } else {
            self.has_restarted = true;
            self.open(request_id).await?
        };
        let answer = self.received(&mut stream, request_id).await?;
        if !answer.state_dropped {
            stream.sent = Some(Sent::of(&self.request));
        }
        // A server of the first contract neither repeats an answer nor refers to one.
        self.last = (stream.contract >= LOOP_CONTRACT).then(|| answer.clone());
        self.stream = Some(stream);
        Ok(answer)
    }

    /// Reads and checks all messages of the answer to the message `request_id`, and joins them. The answer has
    /// the number of the session's request.
    async fn received(&self, stream: &mut Stream, request_id: u64) -> Result<QueryContactsResponse, Error> {
        let mut found = Found::default();
        let mut whole: Option<QueryContactsResponse> = None;
        let (needed, before) = (needed(&self.request), self.last.as_ref().filter(|_| !self.has_restarted));
        loop {
            let message = stream.answers.message().await?;
            let mut message = message.ok_or_else(|| Error::Lost("the server ended the session".into()))?;
            checked::request_id(message.request_id, request_id)?;
            message.request_id = self.request.request_id;
            stream.contract = message.contract;
            if message.contract < needed {
                return Err(Error::TooOld { version: String::new(), contract: message.contract, needed });
            }
            if message.unchanged {
                let (Some(before), None) = (before, &whole) else {
                    return Err(Malformed::new("unchanged is set, but there is no answer before it").into());
                };
                let mut answer = QueryContactsResponse {
                    state_dropped: message.state_dropped,
                    unchanged: true,
                    ..before.clone()
                };
                matches::make_identical(&self.request, &mut answer);
                return Ok(answer);
            }
            if self.request.find {
                found.check(&self.request, &message)?;
            } else if message.more {
                return Err(Malformed::new("more is set, but the request names its pairs").into());
            } else {
                checked::answer(&self.request, &message)?;
            }
            let has_more = message.more;
            match &mut whole {
                None => whole = Some(message),
                Some(whole) => {
                    // Only the first message has these lists, and only the last one has the rest.
                    let missing = std::mem::take(&mut whole.missing_hulls);
                    let invalid = std::mem::take(&mut whole.invalid_bodies);
                    whole.ended_pairs.clone_from(&message.ended_pairs);
                    (whole.state_dropped, whole.more) = (message.state_dropped, has_more);
                    append(whole, message);
                    (whole.missing_hulls, whole.invalid_bodies) = (missing, invalid);
                }
            }
            if !has_more {
                let answer = whole.unwrap_or_default();
                matches::check(&self.request, &answer, before)?;
                return Ok(answer);
            }
        }
    }

    /// The message that inherits all but the poses and velocities that differ from those that the server has.
    fn moved(&self, sent: &Sent, contract: u32) -> QueryContactsRequest {
        let Self { request, .. } = self;
        let bodies = 0..request.body_hulls.len();
        let sends_linear = bodies
            .clone()
            .any(|body| differs::<3>(body, &request.linear_velocities, &sent.linear_velocities));
        let sends_angular = bodies
            .clone()
            .any(|body| differs::<3>(body, &request.angular_velocities, &sent.angular_velocities));
        let inheriting =
            QueryContactsRequest { inherit: true, time_step: request.time_step, ..Default::default() };
        let whole = || {
            let column = |sends: bool, column: &Vec<f64>| if sends { column.clone() } else { Vec::new() };
            QueryContactsRequest {
                positions: request.positions.clone(),
                rotations: request.rotations.clone(),
                linear_velocities: column(sends_linear, &request.linear_velocities),
                angular_velocities: column(sends_angular, &request.angular_velocities),
                ..inheriting.clone()
            }
        };
        if contract < LOOP_CONTRACT {
            return whole();
        }
        let mut message = inheriting.clone();
        for body in bodies.clone() {
            let has_moved = differs::<3>(body, &request.positions, &sent.positions)
                || differs::<4>(body, &request.rotations, &sent.rotations)
                || differs::<3>(body, &request.linear_velocities, &sent.linear_velocities)
                || differs::<3>(body, &request.angular_velocities, &sent.angular_velocities);
            if !has_moved {
                continue;
            }
            message.moved.push(body as u32);
            message.positions.extend(&request.positions[3 * body..][..3]);
            message.rotations.extend(&request.rotations[4 * body..][..4]);
            if sends_linear {
                message.linear_velocities.extend(&request.linear_velocities[3 * body..][..3]);
            }
            if sends_angular {
                message.angular_velocities.extend(&request.angular_velocities[3 * body..][..3]);
            }
        }
        // A body takes 56 bytes without velocities, and 4 more if the message names it.
        if 60 * message.moved.len() < 56 * bodies.len() { message } else { whole() }
    }

    /// The whole request, with warm starts only if they fit its pairs.
    fn whole(&self) -> QueryContactsRequest {
        let mut message = self.request.clone();
        if message.warm_starts.len() != BASIS * (message.pairs.len() / 2) {
            message.warm_starts.clear();
        }
        message
    }

    /// Opens a stream whose first message is the whole request.
    async fn open(&self, request_id: u64) -> Result<Stream, Error> {
        let message = QueryContactsRequest { request_id, ..self.whole() };
        let (requests, waiting) = mpsc::channel(1);
        let messages = tokio_stream::once(message).chain(ReceiverStream::new(waiting));
        let mut stub = self.client.contacts();
        let answers = stub.stream_contacts(Request::new(messages)).await?.into_inner();
        Ok(Stream { requests, answers, sent: None, contract: 0 })
    }
}

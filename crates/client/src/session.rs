//! Loops over the same bodies and pairs, in which every step sends only new poses.

use hullcast_proto::{QueryContactsRequest, QueryContactsResponse};
use tokio::sync::mpsc;
use tokio_stream::{StreamExt, wrappers::ReceiverStream};
use tonic::{Request, Streaming};

use crate::client::{Deadline, by};
use crate::query::MAX_REGISTRATIONS;
use crate::{Client, Error, Hull, checked};

/// The reasons of refusals of a message that inherits, after which a new stream may accept the whole request.
const SEND_WHOLE: &[&str] = &["NOTHING_TO_INHERIT", "STATE_NOT_KEPT", "STOPPING"];
/// The number of values of a pair's basis.
const BASIS: usize = 6;

/// Steps of a simulation: the same bodies and pairs, with new poses in each step ([`Client::session`]).
///
/// The first step sends the whole request. Each later step sends only the poses, and velocities if they are new,
/// and the server starts the solver from the bases of the step before it. If the server is lost, or has dropped the state of the
/// session, the step is repeated on a new stream with the whole request. Its bases are then those of the last
/// answer if the request asks for the output BASES; otherwise the server starts without bases, which may
/// change the last digits of an answer.
///
/// A session makes one step at a time. Several sessions may share a [`Client`]. Dropping a session ends its
/// stream.
#[derive(Debug)]
pub struct Session {
    client: Client,
    request: QueryContactsRequest,
    hulls: Vec<Hull>,
    /// Whether velocities were set after the last answer.
    has_new_velocities: bool,
    /// The open stream. It is `None` during a step, and after a step that failed or was dropped.
    stream: Option<Stream>,
}

#[derive(Debug)]
struct Stream {
    requests: mpsc::Sender<QueryContactsRequest>,
    answers: Streaming<QueryContactsResponse>,
}

impl Client {
    /// Begins a session with the bodies, pairs and options of `request`; its poses are replaced by those of
    /// the first step. Nothing is sent before the first step.
    ///
    /// `hulls` are registered again if the server has lost them, for example because it was restarted with an
    /// empty store; the list may be empty. The number of pairs is bounded by the server's
    /// `max_pairs_per_request`: use several sessions for more.
    pub fn session(&self, request: QueryContactsRequest, hulls: Vec<Hull>) -> Session {
        Session { client: self.clone(), request, hulls, has_new_velocities: false, stream: None }
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
        self.has_new_velocities = true;
        Ok(())
    }

    /// Moves the bodies and answers the pairs.
    ///
    /// `positions` are the world positions of the hulls' origins, and `rotations` the quaternions x, y, z, w:
    /// one each per body. The answer has the columns of [`Client::query`]; its `request_id` is that of the
    /// session's request.
    ///
    /// # Errors
    /// [`Error::WrongLength`] if there is not one pose per body; [`Error::Refused`] if the request is malformed
    /// or over a limit; [`Error::TimedOut`] or [`Error::Lost`] if no server answers in time. The session can
    /// be used again after any error.
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
        let deadline = self.client.deadline();
        let mut answer = self.answered(deadline).await?;
        for _ in 0..MAX_REGISTRATIONS {
            let client = self.client.clone();
            if !client.restored(deadline, &self.request, &answer, &self.hulls).await? {
                break;
            }
            // The whole request is sent again, because a message that inherits would start from the bases of
            // pairs without an answer.
            self.stream = None;
            answer = self.answered(deadline).await?;
        }
        if !answer.bases.is_empty() {
            self.request.warm_starts.clone_from(&answer.bases);
        }
        Ok(answer)
    }

    /// Makes one step. If the open stream or its state is gone, the step is repeated once, at once, on a new
    /// stream. All other repetitions follow the settings of the connection.
    async fn answered(&mut self, deadline: Deadline) -> Result<QueryContactsResponse, Error> {
        let mut losses = 0;
        loop {
            let inherits = self.stream.is_some();
            let error = match by(deadline, self.attempt(deadline)).await? {
                Ok(answer) => return Ok(answer),
                Err(error) => error,
            };
            // A server that drains ends its streams between two steps, so there is no pause here.
            if inherits && (error.is_for(SEND_WHOLE) || matches!(error, Error::Lost(_))) {
                continue;
            }
            self.client.wait_to_repeat(deadline, error, &mut losses).await?;
        }
    }

    /// Sends one message and reads its answer. The stream stays only if both succeed.
    async fn attempt(&mut self, deadline: Deadline) -> Result<QueryContactsResponse, Error> {
        let request_id = Client::next_request_id();
        let mut stream = match self.stream.take() {
            Some(stream) => {
                let mut message = QueryContactsRequest {
                    request_id,
                    inherit: true,
                    positions: self.request.positions.clone(),
                    rotations: self.request.rotations.clone(),
                    time_step: self.request.time_step,
                    ..Default::default()
                };
                if self.has_new_velocities {
                    message.linear_velocities.clone_from(&self.request.linear_velocities);
                    message.angular_velocities.clone_from(&self.request.angular_velocities);
                }
                // If the stream has ended, its receiving half has the reason.
                let _ = stream.requests.send(message).await;
                stream
            }
            None => self.open(request_id).await?,
        };
        let answer = stream.answers.message().await?;
        let mut answer = answer.ok_or_else(|| Error::Lost("the server ended the session".into()))?;
        self.client.check_contract(deadline, &self.request, &answer).await?;
        let asked = std::mem::replace(&mut self.request.request_id, request_id);
        let verdict = checked::answer(&self.request, &answer);
        self.request.request_id = asked;
        verdict?;
        answer.request_id = asked;
        self.has_new_velocities = false;
        self.stream = Some(stream);
        Ok(answer)
    }

    /// Opens a stream whose first message is the whole request.
    async fn open(&self, request_id: u64) -> Result<Stream, Error> {
        let pairs = self.request.pairs.len() / 2;
        let mut message = QueryContactsRequest { request_id, ..self.request.clone() };
        if message.warm_starts.len() != BASIS * pairs {
            message.warm_starts.clear();
        }
        let (requests, waiting) = mpsc::channel(1);
        let messages = tokio_stream::once(message).chain(ReceiverStream::new(waiting));
        let mut stub = self.client.contacts();
        let answers = stub.stream_contacts(Request::new(messages)).await?.into_inner();
        Ok(Stream { requests, answers })
    }
}

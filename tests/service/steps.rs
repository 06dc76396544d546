//! Streams whose messages are the steps of a simulation: pairs that the server finds, bodies that move, come and
//! go, and matches with the answer before.

mod margins;
mod matching;
mod messages;
mod refusals;
mod simulated;
mod state;
mod world;

use hullcast::proto::{
    Output, QueryContactsRequest, QueryContactsResponse, contact_service_client::ContactServiceClient,
};
use tokio::sync::mpsc;
use tonic::{Streaming, transport::Channel};

use crate::support::{
    Refusal, TestServer, refusal,
    scenes::{ALL, append, outputs},
};

const NONE: u32 = u32::MAX;

/// A stream whose messages the test sends one by one, and the last whole answer.
struct Stepper {
    requests: mpsc::Sender<QueryContactsRequest>,
    answers: Streaming<QueryContactsResponse>,
    last: Option<QueryContactsResponse>,
}

/// The answer to a message.
#[derive(Debug)]
struct Answer {
    /// All messages, joined. If it was sent as `unchanged`, the columns of the answer before.
    whole: QueryContactsResponse,
    messages: usize,
    was_unchanged: bool,
}

impl Stepper {
    async fn open(server: &TestServer) -> Self {
        Self::with(server.contacts()).await
    }

    async fn with(mut client: ContactServiceClient<Channel>) -> Self {
        let (requests, mut received) = mpsc::channel(1);
        let stream = futures_util::stream::poll_fn(move |cx| received.poll_recv(cx));
        let answers = client.stream_contacts(stream).await.unwrap().into_inner();
        Self { requests, answers, last: None }
    }

    /// Sends a message and reads its whole answer, checking what every answer has to be.
    async fn step(&mut self, request: QueryContactsRequest) -> Result<Answer, Refusal> {
        let request_id = request.request_id;
        self.requests.send(request).await.unwrap();
        let (mut whole, mut messages) = (QueryContactsResponse::default(), 0);
        loop {
            let answer = self.answers.message().await.map_err(|status| refusal(&status))?;
            let mut part = answer.expect("an answer to each message");
            assert_eq!((part.request_id, part.contract), (request_id, 1));
            let more = part.more;
            if part.unchanged {
                assert!(messages == 0 && !more && part.outcomes.is_empty());
                let last = self.last.clone().expect("an answer before");
                let state_dropped = part.state_dropped;
                whole = QueryContactsResponse { request_id, state_dropped, ended_pairs: vec![], ..last };
                self.last = Some(whole.clone());
                return Ok(Answer { whole, messages: 1, was_unchanged: true });
            }
            if messages == 0 {
                whole.missing_hulls = std::mem::take(&mut part.missing_hulls);
                whole.invalid_bodies = std::mem::take(&mut part.invalid_bodies);
            }
            assert!(part.missing_hulls.is_empty() && part.invalid_bodies.is_empty());
            if more {
                assert!(part.ended_pairs.is_empty() && !part.state_dropped && !part.outcomes.is_empty());
            }
            whole.ended_pairs = std::mem::take(&mut part.ended_pairs);
            whole.state_dropped = part.state_dropped;
            (whole.request_id, whole.contract) = (request_id, 1);
            append(&mut whole, part);
            messages += 1;
            if !more {
                self.last = Some(whole.clone());
                return Ok(Answer { whole, messages, was_unchanged: false });
            }
        }
    }
}

/// All outputs, MATCHES included.
fn all_outputs() -> Vec<i32> {
    let mut all = outputs(&ALL);
    all.push(Output::Matches.into());
    all
}

/// The answer of `FindContacts`.
async fn found(server: &TestServer, request: &QueryContactsRequest) -> QueryContactsResponse {
    let request = QueryContactsRequest {
        find: false,
        inherit: false,
        previous_bodies: vec![],
        outputs: outputs(&ALL),
        ..request.clone()
    };
    let mut stream = server.contacts().find_contacts(request.clone()).await.unwrap().into_inner();
    let mut whole = stream.message().await.unwrap().expect("the first message always comes");
    while let Some(message) = stream.message().await.unwrap() {
        append(&mut whole, message);
    }
    whole
}

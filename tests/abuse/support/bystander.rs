//! A well-behaved client on its own address. It compares each answer bit by bit with the expected one.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use hullcast::{
    proto::{
        QueryContactsRequest, QueryContactsResponse, contact_service_client::ContactServiceClient,
        hull_service_client::HullServiceClient, register_hull_result::Result as Registered,
    },
    store::HullDefinition,
};
use tokio::task::JoinHandle;
use tonic::{Code, Request, Status, transport::Channel};
use tonic_health::pb::{
    HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient,
};

use super::{latency::Latencies, server::REGISTER_TOKEN};
use crate::scenes::{assert_same, expected, outputs, plain, register_request, round_points, scene, shapes};

/// A call that has no answer after this time counts as lost.
const LOST: Duration = Duration::from_secs(60);

/// The pause between two rounds, about one step of a simulation.
const PAUSE: Duration = Duration::from_millis(5);

/// A bystander. Clones share its connection.
#[derive(Clone)]
pub(crate) struct Bystander {
    channel: Channel,
    contacts: ContactServiceClient<Channel>,
    health: HealthClient<Channel>,
    questions: Arc<[(QueryContactsRequest, QueryContactsResponse); 2]>,
}

/// The latencies and retries of a bystander.
#[derive(Default)]
pub(crate) struct Experience {
    pub(crate) queries: Latencies,
    pub(crate) health: Latencies,
    /// The number of calls that the server refused with a request to retry later.
    pub(crate) retries: usize,
}

/// A bystander whose calls are in progress.
pub(crate) struct Working {
    done: Arc<AtomicBool>,
    answered: Arc<AtomicUsize>,
    queries: JoinHandle<(Latencies, usize)>,
    health: JoinHandle<Latencies>,
}

impl Bystander {
    /// Registers the bystander's hulls and computes the expected answers.
    pub(crate) async fn new(channel: Channel) -> Self {
        let shapes = shapes();
        let mut hulls = HullServiceClient::new(channel.clone());
        hulls.register_hulls(with_token(register_request(&shapes))).await.expect("its hulls");
        let questions = Arc::new([question(&shapes, 1), question(&shapes, 200)]);
        let contacts = ContactServiceClient::new(channel.clone());
        Self { contacts, health: HealthClient::new(channel.clone()), channel, questions }
    }

    /// Registers a hull that is not yet in the store.
    pub(crate) async fn register_a_new_hull(&self) {
        let mut hulls = HullServiceClient::new(self.channel.clone());
        let request = register_request(&[plain(round_points(30, 99))]);
        let answer = hulls.register_hulls(with_token(request)).await.expect("an answer").into_inner();
        assert!(matches!(answer.results[0].result, Some(Registered::Hull(_))), "{answer:?}");
    }

    /// Starts the queries and health checks, which continue until [`Working::stop`].
    pub(crate) fn start(&self) -> Working {
        let (done, answered) = <(Arc<AtomicBool>, Arc<AtomicUsize>)>::default();
        let queries = tokio::spawn(self.clone().ask_queries(done.clone(), answered.clone()));
        let health = tokio::spawn(self.clone().ask_health(done.clone()));
        Working { done, answered, queries, health }
    }

    async fn ask_queries(mut self, done: Arc<AtomicBool>, answered: Arc<AtomicUsize>) -> (Latencies, usize) {
        let (mut latencies, mut retries) = (Latencies::default(), 0);
        while !done.load(Ordering::SeqCst) {
            for (request, expected) in self.questions.iter() {
                let asked = Instant::now();
                let answer = loop {
                    match within(self.contacts.query_contacts(with_token(request.clone()))).await {
                        Ok(answer) => break answer.into_inner(),
                        Err(status) => tokio::time::sleep(pushback(&status)).await,
                    }
                    retries += 1;
                    assert!(asked.elapsed() < LOST, "the bystander is refused for a minute");
                };
                latencies.push(asked.elapsed());
                assert_same(&answer, expected);
                answered.fetch_add(1, Ordering::SeqCst);
            }
            tokio::time::sleep(PAUSE).await;
        }
        (latencies, retries)
    }

    async fn ask_health(mut self, done: Arc<AtomicBool>) -> Latencies {
        let mut latencies = Latencies::default();
        while !done.load(Ordering::SeqCst) {
            let asked = Instant::now();
            let request = HealthCheckRequest { service: String::new() };
            let answer = within(self.health.check(request)).await.expect("health is answered every time");
            latencies.push(asked.elapsed());
            assert_eq!(answer.into_inner().status(), ServingStatus::Serving);
            tokio::time::sleep(PAUSE).await;
        }
        latencies
    }
}

impl Working {
    /// The number of queries answered so far.
    pub(crate) fn answered(&self) -> Arc<AtomicUsize> {
        self.answered.clone()
    }

    /// Ends the work after the calls in progress, and returns the measurements.
    pub(crate) async fn stop(self) -> Experience {
        self.done.store(true, Ordering::SeqCst);
        let (queries, retries) = self.queries.await.expect("the bystander's queries");
        let health = self.health.await.expect("the bystander's health checks");
        Experience { queries, health, retries }
    }
}

fn question(shapes: &[HullDefinition], pairs: usize) -> (QueryContactsRequest, QueryContactsResponse) {
    let mut request = scene(shapes, 2 * pairs, pairs, pairs as u64);
    request.outputs = outputs(&crate::scenes::ALL);
    let answer = expected(&request, shapes);
    (request, answer)
}

/// Adds the token that permits every method. A server without tokens ignores it.
pub(crate) fn with_token<T>(message: T) -> Request<T> {
    let mut request = Request::new(message);
    let value = format!("Bearer {REGISTER_TOKEN}").parse().expect("a header");
    request.metadata_mut().insert("authorization", value);
    request
}

/// The time that the server asks the client to wait. Any other failure of the call fails the test.
fn pushback(status: &Status) -> Duration {
    assert_eq!(status.code(), Code::Unavailable, "the bystander got {status:?}");
    let pushback = status.metadata().get("grpc-retry-pushback-ms").and_then(|value| value.to_str().ok());
    let pushback = pushback.and_then(|value| value.parse().ok());
    Duration::from_millis(pushback.unwrap_or_else(|| panic!("no time to retry in {status:?}")))
}

async fn within<T>(call: impl Future<Output = T>) -> T {
    tokio::time::timeout(LOST, call).await.expect("the bystander is answered within a minute")
}

//! Sessions.

use std::sync::Arc;
use std::time::Duration;

use hullcast::{
    proto::{DeleteHullsRequest, QueryContactsRequest, QueryContactsResponse},
    service::Limits,
    store::HullDefinition,
};
use hullcast_client::{Client, Error, Session};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;

use super::{builder, hulls};
use crate::support::{
    TestServer,
    scenes::{ALL, Random, assert_same, expected, outputs, scene, shapes},
};

/// A request whose bodies move, and the answers that the contract specifies for its steps.
struct Moving {
    shapes: Vec<HullDefinition>,
    request: QueryContactsRequest,
    random: Random,
}

impl Moving {
    fn new(seed: u64) -> Self {
        let shapes = shapes();
        let request = QueryContactsRequest { outputs: outputs(&ALL), ..scene(&shapes, 15, 60, seed) };
        Self { shapes, request, random: Random::new(seed) }
    }

    /// Moves all bodies a little, makes a step, and compares its answer with that of the whole request.
    async fn step(&mut self, session: &mut Session) {
        let mut answer = self.moved_and_asked(session).await.unwrap();
        // A server without room for the session's state says so.
        answer.state_dropped = false;
        assert_same(&answer, &expected(&self.request, &self.shapes));
        self.request.warm_starts = answer.bases;
    }

    async fn moved_and_asked(&mut self, session: &mut Session) -> Result<QueryContactsResponse, Error> {
        for coordinate in &mut self.request.positions {
            *coordinate += 0.01 * self.random.signed();
        }
        session.step(self.request.positions.as_chunks().0, self.request.rotations.as_chunks().0).await
    }
}

/// Catches a step whose answer is that of other poses, or that starts without the bases of the step before.
#[tokio::test(flavor = "multi_thread")]
async fn steps_give_the_answers_of_whole_requests() {
    let server = TestServer::start().await;
    let client = builder(&server).connect().await.unwrap();
    let mut moving = Moving::new(1);
    client.register(&hulls(&moving.shapes)).await.unwrap();
    let mut session = client.session(moving.request.clone(), vec![]);
    for _ in 0..5 {
        moving.step(&mut session).await;
    }
    assert_eq!(server.metric("hullcast_requests_in_flight"), 1.0, "all steps are one call");
    let wrong = session.step(&[[0.0; 3]; 14], &[[0.0; 4]; 15]).await;
    assert_eq!(wrong, Err(Error::WrongLength { field: "positions", found: 14, expected: 15 }));
    moving.step(&mut session).await;
}

/// The server keeps no state of streams, so no message can inherit. Catches a session that fails then, even if
/// the client repeats no call, or goes on without bases.
#[tokio::test(flavor = "multi_thread")]
async fn a_step_without_kept_state_is_sent_in_full() {
    let server = TestServer::with_limits(Limits { max_stream_state_bytes: 0, ..Limits::default() }).await;
    let client = builder(&server).retries(false).connect().await.unwrap();
    let mut moving = Moving::new(2);
    client.register(&hulls(&moving.shapes)).await.unwrap();
    let mut session = client.session(moving.request.clone(), vec![]);
    for _ in 0..4 {
        moving.step(&mut session).await;
    }
}

/// A step is dropped at some point before its answer. Catches a next step that gets the answer of the dropped
/// one.
#[tokio::test(flavor = "multi_thread")]
async fn a_dropped_step_leaves_no_answer_behind() {
    let server = TestServer::start().await;
    let client = builder(&server).connect().await.unwrap();
    let mut moving = Moving::new(3);
    client.register(&hulls(&moving.shapes)).await.unwrap();
    let mut session = client.session(moving.request.clone(), vec![]);
    for micros in [0, 10, 100, 1000, 10_000] {
        moving.step(&mut session).await;
        let dropped = moving.moved_and_asked(&mut session);
        if let Ok(answer) = tokio::time::timeout(Duration::from_micros(micros), dropped).await {
            moving.request.warm_starts = answer.unwrap().bases;
        }
    }
    moving.step(&mut session).await;
}

/// A server behind a proxy that cuts its connections. Catches a session that ends with its connection, or that
/// does not register the hulls that the server has lost.
#[tokio::test(flavor = "multi_thread")]
async fn a_lost_server_is_connected_again() {
    let server = TestServer::start().await;
    let mut moving = Moving::new(4);
    let proxy = Proxy::start(&server.address).await;
    let client = Client::connect(proxy.address.as_str()).await.unwrap();
    let hulls = hulls(&moving.shapes);
    client.register(&hulls).await.unwrap();
    let mut session = client.session(moving.request.clone(), hulls);
    moving.step(&mut session).await;
    moving.step(&mut session).await;
    proxy.cut();
    moving.step(&mut session).await;
    proxy.cut();
    let ids = moving.request.hull_ids.clone();
    server.hulls().delete_hulls(DeleteHullsRequest { ids }).await.unwrap();
    moving.step(&mut session).await;
    assert_eq!(server.metric("hullcast_registered_total"), 10.0, "each of five hulls, twice");
}

/// Catches a step that is repeated on a new connection although the client repeats no call, and a session that
/// cannot be used after the loss.
#[tokio::test(flavor = "multi_thread")]
async fn a_lost_step_is_not_repeated_if_calls_are_not() {
    let server = TestServer::start().await;
    let mut moving = Moving::new(5);
    let proxy = Proxy::start(&server.address).await;
    let client = Client::builder(proxy.address.as_str()).retries(false).connect().await.unwrap();
    client.register(&hulls(&moving.shapes)).await.unwrap();
    let mut session = client.session(moving.request.clone(), vec![]);
    moving.step(&mut session).await;
    moving.step(&mut session).await;
    proxy.cut();
    let lost = moving.moved_and_asked(&mut session).await;
    assert!(matches!(lost, Err(Error::Lost(_))), "{lost:?}");
    moving.step(&mut session).await;
}

/// Passes bytes on to a server, until it is told to cut its connections.
struct Proxy {
    address: String,
    cuts: Arc<Notify>,
}

impl Proxy {
    async fn start(server: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let (cuts, server) = (Arc::new(Notify::new()), server.to_owned());
        let cut = cuts.clone();
        tokio::spawn(async move {
            while let Ok((mut near, _)) = listener.accept().await {
                let (cut, server) = (cut.clone(), server.clone());
                tokio::spawn(async move {
                    let mut far = TcpStream::connect(server).await.unwrap();
                    let cut = cut.notified();
                    tokio::select! {
                        () = cut => {}
                        _ = tokio::io::copy_bidirectional(&mut near, &mut far) => {}
                    }
                });
            }
        });
        Self { address, cuts }
    }

    /// Ends all connections.
    fn cut(&self) {
        self.cuts.notify_waiters();
    }
}

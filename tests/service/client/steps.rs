//! Sessions.

use std::sync::Arc;
use std::time::Duration;

use hullcast::{
    proto::{CONTRACT, DeleteHullsRequest, Output, QueryContactsRequest, QueryContactsResponse},
    service::Limits,
    store::HullDefinition,
};
use hullcast_client::{Client, Error, Session};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;

use super::lies::{Liar, Lie};
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

/// Catches velocities or a time step that a step does not send, that a step sends although they were replaced, or
/// that are lost with the server.
#[tokio::test(flavor = "multi_thread")]
async fn velocities_stay_until_they_are_set() {
    let server = TestServer::start().await;
    let proxy = Proxy::start(&server.address).await;
    let client = Client::connect(proxy.address.as_str()).await.unwrap();
    let mut moving = Moving::new(5);
    client.register(&hulls(&moving.shapes)).await.unwrap();
    moving.request.margin = 0.0;
    moving.request.positions.iter_mut().for_each(|x| *x *= 4.0);
    moving.request.turning_points = vec![0.3; 45];
    let mut session = client.session(moving.request.clone(), vec![]);
    let mut near = Vec::new();
    for (step, time_step) in [0.0, 0.1, 0.2, 0.0, 0.1, 0.1].into_iter().enumerate() {
        let mut vectors =
            || (0..15).map(|_| [0; 3].map(|_| 9.0 * moving.random.signed())).collect::<Vec<_>>();
        let (linear, angular) = (vectors(), vectors());
        // In the third and fifth step the velocities are those of the step before.
        match step {
            1 | 3 => session.set_velocities(&linear, &[], time_step).unwrap(),
            5 => session.set_velocities(&[], &angular, time_step).unwrap(),
            2 | 4 => {
                let linear = moving.request.linear_velocities.as_chunks().0.to_vec();
                session.set_velocities(&linear, &[], time_step).unwrap();
            }
            _ => {}
        }
        match step {
            1 | 3 => moving.request.linear_velocities = linear.into_flattened(),
            5 => {
                moving.request.linear_velocities = vec![];
                moving.request.angular_velocities = angular.into_flattened();
            }
            _ => {}
        }
        moving.request.time_step = time_step;
        if step == 4 {
            proxy.cut();
        }
        let answer = moving.moved_and_asked(&mut session).await.unwrap();
        let whole = client.query(&moving.request).await.unwrap();
        assert_same(&answer, &whole);
        near.push(answer.outcomes.iter().filter(|&&outcome| outcome == 1).count());
        moving.request.warm_starts = answer.bases;
    }
    assert!(near[0] < near[1] && near[1] < near[2] && near[3] < near[4] && near[3] < near[5], "{near:?}");
    let wrong = session.set_velocities(&[[0.0; 3]; 14], &[], 0.1);
    assert_eq!(wrong, Err(Error::WrongLength { field: "linear_velocities", found: 14, expected: 15 }));
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

/// Bodies without pairs, which a session finds in each step.
struct Finding {
    request: QueryContactsRequest,
    random: Random,
}

impl Finding {
    fn new(shapes: &[HullDefinition], seed: u64) -> Self {
        let outputs =
            outputs(&[Output::Alpha, Output::Normal, Output::Points, Output::Features, Output::Matches]);
        let request =
            QueryContactsRequest { pairs: vec![], find: true, outputs, ..scene(shapes, 30, 1, seed) };
        Self { request, random: Random::new(seed) }
    }

    /// Moves each body with a probability of one in `rarity`; none for 0.
    fn shake(&mut self, rarity: usize) {
        for body in 0..self.request.body_hulls.len() {
            if rarity > 0 && self.random.below(rarity) == 0 {
                self.request.positions[3 * body] += 0.02 * self.random.signed();
            }
        }
    }

    async fn step(&self, session: &mut Session) -> QueryContactsResponse {
        let (positions, rotations) = (&self.request.positions, &self.request.rotations);
        session.step(positions.as_chunks().0, rotations.as_chunks().0).await.unwrap()
    }

    /// Compares an answer with that of a search for the same bodies.
    async fn compare(&self, client: &Client, answer: &QueryContactsResponse) {
        let outputs = outputs(&[Output::Alpha, Output::Normal, Output::Points, Output::Features]);
        let search = QueryContactsRequest { find: false, outputs, ..self.request.clone() };
        let expected = client.find_all(&search).await.unwrap();
        assert_eq!(answer.pairs, expected.pairs);
        assert_eq!(answer.outcomes, expected.outcomes);
        assert_eq!(answer.missing_hulls, expected.missing_hulls);
        for (found, expected) in answer.alphas.iter().zip(&expected.alphas) {
            assert!((found - expected).abs() <= 1e-9 * expected, "{found}, {expected}");
        }
        assert_eq!(answer.previous_pairs.len(), answer.outcomes.len());
        assert_eq!(answer.previous_points.len(), answer.distances.len());
    }

    /// The pairs that matches say were there before, by the numbers of their bodies then, and those that ended.
    fn before(answer: &QueryContactsResponse, before: &QueryContactsResponse) -> Vec<[u32; 2]> {
        let old: &[[u32; 2]] = before.pairs.as_chunks().0;
        let stayed = answer.previous_pairs.iter().filter(|&&row| row != u32::MAX);
        let mut pairs: Vec<[u32; 2]> = stayed.map(|&row| old[row as usize]).collect();
        pairs.extend(answer.ended_pairs.as_chunks::<2>().0);
        pairs.sort_unstable();
        pairs
    }
}

/// Catches a find session that loses a pair, sends a body that did not move or the pose of another one, or
/// matches rows of another answer. Bodies move, stay, come and go, and change their order; a server is lost.
#[tokio::test(flavor = "multi_thread")]
async fn a_find_session_gives_the_answers_of_searches() {
    let server = TestServer::start().await;
    let shapes = shapes();
    let proxy = Proxy::start(&server.address).await;
    let client = Client::connect(proxy.address.as_str()).await.unwrap();
    client.register(&hulls(&shapes)).await.unwrap();
    let mut finding = Finding::new(&shapes, 5);
    let mut session = client.session(finding.request.clone(), hulls(&shapes));
    let mut last = finding.step(&mut session).await;
    assert!(session.has_restarted());
    let (mut pairs, mut stayed, mut unchanged) = (0, 0, 0);
    for step in 0..40 {
        let answer = if step % 10 == 9 {
            // The first body becomes the last one, and the second goes.
            let request = &mut finding.request;
            let previous: Vec<u32> = (2..request.body_hulls.len() as u32).chain([0]).collect();
            let of = |values: &[f64], width: usize| -> Vec<f64> {
                let chosen = previous.iter().map(|&body| width * body as usize);
                chosen.flat_map(|at| values[at..at + width].to_vec()).collect()
            };
            (request.positions, request.rotations) = (of(&request.positions, 3), of(&request.rotations, 4));
            request.body_hulls = previous.iter().map(|&body| request.body_hulls[body as usize]).collect();
            session.update(request.clone(), hulls(&shapes), &previous).await.unwrap()
        } else {
            finding.shake([1, 5, 0, 0][step % 4]);
            if step == 20 {
                proxy.cut();
            }
            finding.step(&mut session).await
        };
        finding.compare(&client, &answer).await;
        assert_eq!(session.has_restarted(), step == 20);
        if step != 20 {
            assert_eq!(Finding::before(&answer, &last), last.pairs.as_chunks::<2>().0);
        }
        pairs += answer.outcomes.len();
        stayed += answer.previous_pairs.iter().filter(|&&row| row != u32::MAX).count();
        unchanged += usize::from(answer.unchanged);
        last = answer;
    }
    assert!(pairs > 400 && stayed > 300 && unchanged > 3, "{pairs} {stayed} {unchanged}");
    let wrong = session.update(finding.request.clone(), vec![], &[0]).await;
    let expected = finding.request.body_hulls.len();
    assert_eq!(wrong, Err(Error::WrongLength { field: "previous_bodies", found: 1, expected }));
}

/// Catches a session that takes the answer of an old server, which ignores `find` and the output MATCHES, for
/// an answer without pairs or matches. The server is a new one whose answers lack the number.
#[tokio::test(flavor = "multi_thread")]
async fn an_old_server_is_refused() {
    let (liar, client) = Liar::start().await;
    let shapes = shapes();
    client.register(&hulls(&shapes)).await.unwrap();
    liar.tell(Lie::Answer(|answer| answer.contract = 0));
    let finding = Finding::new(&shapes, 6);
    let mut session = client.session(finding.request.clone(), vec![]);
    let (positions, rotations) = (&finding.request.positions, &finding.request.rotations);
    let refused = session.step(positions.as_chunks().0, rotations.as_chunks().0).await;
    assert!(matches!(refused, Err(Error::TooOld { contract: 0, needed: 1, .. })), "{refused:?}");
    let mut moving = Moving::new(6);
    let mut session = client.session(moving.request.clone(), vec![]);
    for _ in 0..3 {
        let mut answer = moving.moved_and_asked(&mut session).await.unwrap();
        assert_eq!(answer.contract, 0);
        answer.contract = CONTRACT;
        assert_same(&answer, &expected(&moving.request, &moving.shapes));
        moving.request.warm_starts = answer.bases;
    }
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

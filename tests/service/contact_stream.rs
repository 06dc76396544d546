//! Streams with `inherit`, whose messages send only poses.

use std::time::Duration;

use hullcast::{
    budget::{Caller, Part},
    compute::Job,
    proto::{
        Accuracy, DeleteHullsRequest, Output, QueryContactsRequest, QueryContactsResponse, Solver,
        contact_service_client::ContactServiceClient,
    },
    service::Limits,
    store::HullId,
};
use tokio::sync::mpsc;
use tonic::{Code, Streaming, transport::Channel};

use crate::support::{
    Refusal, Setup, TestServer, invalid, refusal, refused,
    scenes::{ALL, Random, assert_same, expected, outputs, register_request, scene, shapes, two_boxes},
};

/// A stream whose messages the test sends one by one.
pub(crate) struct Stepper {
    requests: mpsc::Sender<QueryContactsRequest>,
    answers: Streaming<QueryContactsResponse>,
}

impl Stepper {
    pub(crate) async fn open(mut client: ContactServiceClient<Channel>) -> Self {
        let (requests, mut received) = mpsc::channel(1);
        let stream = futures_util::stream::poll_fn(move |cx| received.poll_recv(cx));
        let answers = client.stream_contacts(stream).await.unwrap().into_inner();
        Self { requests, answers }
    }

    pub(crate) async fn step(
        &mut self,
        request: QueryContactsRequest,
    ) -> Result<QueryContactsResponse, Refusal> {
        self.requests.send(request).await.unwrap();
        let answer = self.answers.message().await;
        answer
            .map(|answer| answer.expect("the stream has one answer per request"))
            .map_err(|status| refusal(&status))
    }
}

/// The message for `full` when everything but the poses is inherited.
pub(crate) fn poses_alone(full: &QueryContactsRequest) -> QueryContactsRequest {
    QueryContactsRequest {
        request_id: full.request_id,
        inherit: true,
        positions: full.positions.clone(),
        rotations: full.rotations.clone(),
        ..Default::default()
    }
}

/// Moves all bodies a little.
fn moved(request: &mut QueryContactsRequest, random: &mut Random) {
    request.request_id += 1;
    for coordinate in &mut request.positions {
        *coordinate += 0.02 * random.signed();
    }
    for component in &mut request.rotations {
        *component += 1e-4 * random.signed();
    }
}

/// Every step is compared bit for bit, iterations included, with the library's answer to the
/// complete request, warm-started from the step before. Catches a column or option that is not
/// inherited, bases that are not those of the last step or of the pair, a pose that is inherited,
/// and a batch on several threads that starts from other bases.
#[tokio::test(flavor = "multi_thread")]
async fn a_step_is_the_request_in_full_from_the_bases_before() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let accuracies = [
        None,
        Some(Accuracy { solver: Solver::GjkRayCast as i32, feature_angle: Some(0.0), ..Accuracy::default() }),
        Some(Accuracy { max_points: 2, relative_tolerance: 0.01, ..Accuracy::default() }),
    ];
    let no_bases: Vec<Output> = ALL.into_iter().filter(|&output| output != Output::Bases).collect();
    let (mut steps, mut warm_calls, mut cold_calls) = (0, 0, 0);
    for (mask, accuracy, pairs) in [
        (&ALL[..], accuracies[0], 20),
        (&no_bases, accuracies[0], 300),
        (&no_bases, accuracies[1], 40),
        (&ALL, accuracies[2], 200),
    ] {
        let mut stream = Stepper::open(server.contacts()).await;
        let mut random = Random::new(5);
        let mut full = QueryContactsRequest { accuracy, ..scene(&shapes(), 30, pairs, pairs as u64) };
        full.outputs = outputs(mask);
        for step in 0..6 {
            // A body that has an invalid pose in one step must only make its pairs lose their bases.
            let kept = full.positions[7];
            if step == 2 {
                full.positions[7] = f64::NAN;
            }
            let sent = if step == 0 { full.clone() } else { poses_alone(&full) };
            let answer = stream.step(sent).await.unwrap();
            assert_same(&answer, &expected(&full, &shapes()));
            let with_bases = QueryContactsRequest { outputs: outputs(&ALL), ..full.clone() };
            let warm = expected(&with_bases, &shapes());
            let cold = expected(&QueryContactsRequest { warm_starts: vec![], ..with_bases }, &shapes());
            if step > 0 {
                warm_calls += warm.support_calls.iter().sum::<u32>();
                cold_calls += cold.support_calls.iter().sum::<u32>();
            }
            full.warm_starts = warm.bases;
            full.positions[7] = kept;
            moved(&mut full, &mut random);
            steps += 1;
        }
    }
    assert_eq!(steps, 24);
    assert!(
        10 * warm_calls < 9 * cold_calls,
        "bases save too little work: {warm_calls} of {cold_calls} calls"
    );
}

/// The server keeps the bases of a stream for the next step. Catches bases that are sent although
/// the mask does not include them.
#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_sent_for_being_kept() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let mut cases = 0;
    for mask in ALL.map(|output| vec![output]).into_iter().chain([vec![]]) {
        let full = QueryContactsRequest { outputs: outputs(&mask), ..scene(&shapes(), 20, 100, 3) };
        let mut stream = Stepper::open(server.contacts()).await;
        assert_same(&stream.step(full.clone()).await.unwrap(), &expected(&full, &shapes()));
        let again = stream.step(poses_alone(&full)).await.unwrap();
        let cold = expected(&full, &shapes());
        assert_eq!(again.outcomes, cold.outcomes);
        assert_eq!(again.bases.len(), cold.bases.len());
        cases += 1;
    }
    assert_eq!(cases, 12);
}

/// Catches a step that inherits from another message than the previous one: from the first message
/// of the stream, or from another stream.
#[tokio::test(flavor = "multi_thread")]
async fn the_message_before_is_the_one_inherited() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let mut streams = [Stepper::open(server.contacts()).await, Stepper::open(server.contacts()).await];
    for round in 0..4 {
        // The streams have equal bodies, but other pairs and options.
        for (i, stream) in streams.iter_mut().enumerate() {
            let mut full = scene(&shapes(), 20, 50 + round, (10 + i) as u64);
            full.margin = 0.01 * round as f64;
            full.outputs = outputs(&ALL);
            assert_same(&stream.step(full.clone()).await.unwrap(), &expected(&full, &shapes()));
        }
        for (i, stream) in streams.iter_mut().enumerate() {
            let mut full = scene(&shapes(), 20, 50 + round, (10 + i) as u64);
            full.margin = 0.01 * round as f64;
            full.outputs = outputs(&ALL);
            full.warm_starts = expected(&full, &shapes()).bases;
            let answer = stream.step(poses_alone(&full)).await.unwrap();
            assert_same(&answer, &expected(&full, &shapes()));
        }
    }
}

/// Catches a deleted hull that a stream still uses; the complete request would not.
#[tokio::test(flavor = "multi_thread")]
async fn a_hull_deleted_between_steps_is_unknown() {
    let server = TestServer::start().await;
    let (shapes, full) = two_boxes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let mut stream = Stepper::open(server.contacts()).await;
    assert_eq!(stream.step(full.clone()).await.unwrap().outcomes, [1]);
    server.hulls().delete_hulls(DeleteHullsRequest { ids: full.hull_ids.clone() }).await.unwrap();
    let lost = stream.step(poses_alone(&full)).await.unwrap();
    assert_eq!(
        (&lost.outcomes[..], &lost.flags[..], &lost.missing_hulls[..]),
        (&[4][..], &[16][..], &[0][..])
    );
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    assert_eq!(stream.step(poses_alone(&full)).await.unwrap().outcomes, [1]);
}

/// Messages of a stream that are there at once share the lease on their hulls. Catches a hull that the second
/// message still uses although it was deleted during the first, and hulls that stay leased while the stream
/// waits for its caller.
#[tokio::test(flavor = "multi_thread")]
async fn hulls_of_messages_that_are_there_at_once() {
    let server = TestServer::start().await;
    let (shapes, full) = two_boxes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let held = || server.metric("hullcast_held_bytes");
    let mut stream = Stepper::open(server.contacts()).await;
    assert_eq!(stream.step(full.clone()).await.unwrap().outcomes, [1]);
    assert_eq!(held(), 0.0, "free when the answer is there");
    // No pair may be computed, so the first of these messages keeps its hulls.
    let controls = server.app.engine().test_controls();
    controls.allow(0);
    for message in [poses_alone(&full), poses_alone(&full), full.clone()] {
        stream.requests.send(message).await.unwrap();
    }
    while held() == 0.0 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    let id = HullId(full.hull_ids[0][..].try_into().unwrap());
    assert!(server.app.registry().delete(id, &Job::new(Caller::alone())).await.unwrap());
    controls.open();
    let mut outcomes = Vec::new();
    for _ in 0..3 {
        outcomes.extend(stream.answers.message().await.unwrap().unwrap().outcomes);
    }
    assert_eq!(outcomes, [1, 4, 4]);
    assert_eq!(held(), 0.0);
}

/// Catches `inherit` without a previous message, fields other than poses that are silently ignored,
/// and poses whose number does not fit the inherited bodies.
#[tokio::test(flavor = "multi_thread")]
async fn a_malformed_step_names_its_field_and_ends_the_stream() {
    let server = TestServer::start().await;
    let (shapes, full) = two_boxes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();

    let unary = server.contacts().query_contacts(poses_alone(&full)).await.unwrap_err();
    assert_eq!(refusal(&unary), invalid("FIELD_NOT_ALLOWED", "inherit"));
    let mut stream = Stepper::open(server.contacts()).await;
    let first = stream.step(poses_alone(&full)).await;
    assert_eq!(first, Err(invalid("NOTHING_TO_INHERIT", "inherit")));

    type Spoil = fn(&mut QueryContactsRequest);
    let cases: [(Spoil, &str, &str); 15] = [
        (|r| r.hull_ids.push(vec![0; 32]), "FIELD_NOT_ALLOWED", "hull_ids"),
        (|r| r.body_hulls = vec![0, 0], "FIELD_NOT_ALLOWED", "body_hulls"),
        (|r| r.pairs = vec![0, 1], "FIELD_NOT_ALLOWED", "pairs"),
        (|r| r.worlds = vec![0, 0], "FIELD_NOT_ALLOWED", "worlds"),
        (|r| r.groups = vec![0, 0], "FIELD_NOT_ALLOWED", "groups"),
        (|r| r.ignored_groups = vec![0, 0], "FIELD_NOT_ALLOWED", "ignored_groups"),
        (|r| r.margin = 0.1, "FIELD_NOT_ALLOWED", "margin"),
        (|r| r.margin = f64::NAN, "FIELD_NOT_ALLOWED", "margin"),
        (|r| r.accuracy = Some(Accuracy::default()), "FIELD_NOT_ALLOWED", "accuracy"),
        (|r| r.outputs = vec![1], "FIELD_NOT_ALLOWED", "outputs"),
        (|r| r.warm_starts = vec![0; 6], "FIELD_NOT_ALLOWED", "warm_starts"),
        (|r| r.positions.push(0.0), "LENGTH_MISMATCH", "positions"),
        (|r| r.positions.clear(), "LENGTH_MISMATCH", "positions"),
        (|r| r.rotations.truncate(7), "LENGTH_MISMATCH", "rotations"),
        (|r| r.rotations.clear(), "LENGTH_MISMATCH", "rotations"),
    ];
    for (spoil, reason, field) in cases {
        let mut stream = Stepper::open(server.contacts()).await;
        stream.step(full.clone()).await.unwrap();
        let mut wrong = poses_alone(&full);
        spoil(&mut wrong);
        assert_eq!(stream.step(wrong).await, Err(invalid(reason, field)));
        assert_eq!(stream.answers.message().await.ok().flatten(), None);
    }
}

/// Catches streams that keep more state than the limit, a stream that loses its kept state by using
/// it, state that is not released, and a stream without kept state whose complete requests are
/// refused.
#[tokio::test(flavor = "multi_thread")]
async fn what_streams_keep_is_limited() {
    let (shapes, full) = two_boxes();
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let mut stream = Stepper::open(server.contacts()).await;
    stream.step(full.clone()).await.unwrap();
    // The state is an id, two bodies with their poses, a pair with its row of four points, and some offsets.
    let state = server.app.memory().used_by(Part::StreamState);
    assert!((32 + 16 + 112 + 8 + 86 + 128..500).contains(&state), "{state}");
    // One caller may have half of what all streams may keep.
    let not_kept = refused(Code::Unavailable, "STATE_NOT_KEPT", "");
    for (max_stream_state_bytes, places) in
        [(0, 0), (2 * state - 1, 0), (2 * state, 1), (4 * state - 1, 1), (4 * state, 2)]
    {
        let limits = Limits { max_stream_state_bytes, ..Limits::default() };
        let server = Setup { limits, ..Setup::default() }.start().await;
        server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
        let mut kept = Vec::new();
        for _ in 0..places {
            let mut stream = Stepper::open(server.contacts()).await;
            for _ in 0..3 {
                stream.step(full.clone()).await.unwrap();
                stream.step(poses_alone(&full)).await.unwrap();
                stream.step(poses_alone(&full)).await.unwrap();
            }
            kept.push(stream);
        }
        let mut without = Stepper::open(server.contacts()).await;
        for _ in 0..3 {
            without.step(full.clone()).await.unwrap();
        }
        assert_eq!(without.step(poses_alone(&full)).await, Err(not_kept.clone()));
        let mut places_left = 0;
        while let Some(stream) = kept.pop() {
            drop(stream);
            places_left += 1;
            // The server notices the end of a stream with a delay, so try until a place is free.
            let mut stream = Stepper::open(server.contacts()).await;
            loop {
                stream.step(full.clone()).await.unwrap();
                if stream.step(poses_alone(&full)).await.is_ok() {
                    break;
                }
                stream = Stepper::open(server.contacts()).await;
            }
        }
        assert_eq!(places_left, places);
    }
}

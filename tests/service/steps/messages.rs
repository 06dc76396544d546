//! Answers that span several messages, and answers that are not sent again.

use hullcast::{
    proto::{Output, QueryContactsRequest},
    service::Limits,
};

use super::{Stepper, all_outputs, found};
use crate::support::{
    Setup, TestServer,
    scenes::{ALL, assert_same, box_points, id, outputs, plain, register_request},
};

/// A grid of cubes, each of which touches its neighbours along every axis.
fn grid(side: u32) -> QueryContactsRequest {
    let bodies = side.pow(3);
    let position = |body: u32| [body % side, body / side % side, body / side / side].map(f64::from);
    QueryContactsRequest {
        find: true,
        hull_ids: vec![id(&cube())],
        body_hulls: vec![0; bodies as usize],
        positions: (0..bodies).flat_map(position).collect(),
        rotations: [0.0, 0.0, 0.0, 1.0].repeat(bodies as usize),
        outputs: all_outputs(),
        ..Default::default()
    }
}

fn cube() -> hullcast::store::HullDefinition {
    plain(box_points(0.5, 0.5, 0.5))
}

/// A message that inherits, in which these bodies are where they were in `request` except for a shift along x.
fn shifted(request: &QueryContactsRequest, moved: &[u32], by: f64) -> QueryContactsRequest {
    let position = |&body: &u32| {
        let [x, y, z]: [f64; 3] = request.positions[3 * body as usize..][..3].try_into().unwrap();
        [x + by, y, z]
    };
    QueryContactsRequest {
        inherit: true,
        moved: moved.to_vec(),
        positions: moved.iter().flat_map(position).collect(),
        rotations: [0.0, 0.0, 0.0, 1.0].repeat(moved.len()),
        ..Default::default()
    }
}

/// Catches rows that are lost, doubled or out of order between two messages, whether computed or used again, a list
/// that comes with the wrong message, and rows of several messages that do not match in the next step. The first
/// server's messages have at most 4,096 pairs, and the second's so few bytes that parts are cut into halves.
#[tokio::test(flavor = "multi_thread")]
async fn an_answer_spans_messages() {
    for (side, max_message_bytes) in [(12, Limits::default().max_message_bytes), (7, 256 << 10)] {
        let limits = Limits { max_message_bytes, ..Limits::default() };
        let server = Setup { limits, ..Setup::default() }.start().await;
        server.hulls().register_hulls(register_request(&[cube()])).await.unwrap();
        let mut full = grid(side);
        // An unusable body and an unknown hull are named in the first message only.
        full.hull_ids.push(vec![7; 32]);
        full.body_hulls[3] = 1;
        full.positions[3 * 5] = f64::NAN;
        let mut stream = Stepper::open(&server).await;
        let expected = found(&server, &full).await;
        let pairs = expected.outcomes.len();
        assert_eq!((&expected.missing_hulls[..], &expected.invalid_bodies[..]), (&[1][..], &[5][..]));
        let columns = |answer: &hullcast::proto::QueryContactsResponse| {
            let mut answer = answer.clone();
            (answer.previous_pairs, answer.previous_points, answer.ended_pairs) = (vec![], vec![], vec![]);
            (answer.iterations, answer.support_calls) = (vec![], vec![]);
            answer
        };
        let first = stream.step(full.clone()).await.unwrap();
        assert!(first.messages > 1 && pairs > 1000, "{} messages, {pairs} pairs", first.messages);
        assert_same(&columns(&first.whole), &columns(&expected));
        // Nothing moved: each row is its own match, which is an answer of its own.
        let again = stream.step(shifted(&full, &[], 0.0)).await.unwrap();
        assert!(again.messages > 1 && !again.was_unchanged);
        assert_same(&columns(&again.whole), &columns(&expected));
        assert_eq!(again.whole.previous_pairs, (0..pairs as u32).collect::<Vec<_>>());
        assert!(again.whole.support_calls.iter().all(|&calls| calls == 0));
        let still = stream.step(shifted(&full, &[], 0.0)).await.unwrap();
        assert!(still.was_unchanged);
        // All bodies leave: no pair is left, and all have ended.
        let all: Vec<u32> = (0..full.body_hulls.len() as u32).collect();
        let mut apart = full.clone();
        apart.positions.iter_mut().for_each(|x| *x *= 3.0);
        let message = QueryContactsRequest { moved: vec![], ..shifted(&apart, &all, 0.0) };
        let apart = stream.step(message).await.unwrap();
        assert_eq!(apart.whole.outcomes.len(), 0);
        assert_eq!(apart.whole.ended_pairs, expected.pairs);
        let message = QueryContactsRequest { moved: vec![], ..shifted(&full, &all, 0.0) };
        let back = stream.step(message).await.unwrap();
        assert_same(&columns(&back.whole), &columns(&expected));
        assert!(back.whole.ended_pairs.is_empty());
        assert!(back.whole.previous_pairs.iter().all(|&pair| pair == super::NONE));
    }
}

/// Catches an answer that is sent as unchanged although something changed, or to a client that does not know
/// steps, and one that is sent again although nothing changed. No pair may be computed for an answer that is known
/// to be the same.
#[tokio::test(flavor = "multi_thread")]
async fn an_answer_that_is_the_same_is_not_sent_again() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&[cube()])).await.unwrap();
    for find in [true, false] {
        let mut full = grid(3);
        full.outputs = outputs(&[Output::Alpha, Output::Points]);
        if !find {
            full.find = false;
            full.pairs = found(&server, &full).await.pairs;
        }
        // An old client never hears of it, although each answer is the same.
        if !find {
            let mut old = Stepper::open(&server).await;
            let poses =
                QueryContactsRequest { moved: vec![], ..shifted(&full, &(0..27).collect::<Vec<_>>(), 0.0) };
            for message in [full.clone(), full.clone(), poses.clone(), poses] {
                assert!(!old.step(message).await.unwrap().was_unchanged);
            }
        }
        let mut stream = Stepper::open(&server).await;
        assert!(!stream.step(full.clone()).await.unwrap().was_unchanged);
        let computed = server.app.engine().pairs_computed();
        for _ in 0..3 {
            assert!(stream.step(shifted(&full, &[], 0.0)).await.unwrap().was_unchanged);
            // Bodies with the bits that they had have not moved.
            assert!(stream.step(shifted(&full, &[3, 9], 0.0)).await.unwrap().was_unchanged);
        }
        assert_eq!(server.app.engine().pairs_computed(), computed);
        let all = QueryContactsRequest { moved: vec![], ..shifted(&full, &(0..27).collect::<Vec<_>>(), 0.0) };
        assert!(stream.step(all).await.unwrap().was_unchanged);
        assert!(!stream.step(shifted(&full, &[0], 1e-3)).await.unwrap().was_unchanged);
        assert!(!stream.step(shifted(&full, &[0], 0.0)).await.unwrap().was_unchanged);
        // A body that is in no pair, before and after, changes no answer.
        let apart = stream.step(shifted(&full, &[0], -7.0)).await.unwrap();
        assert!(!apart.was_unchanged);
        assert_eq!(stream.step(shifted(&full, &[0], -8.0)).await.unwrap().was_unchanged, find);
        // With the diagnostics, an answer from state differs from the one that was computed.
        let diagnosed = QueryContactsRequest { outputs: outputs(&ALL), ..full.clone() };
        stream.step(diagnosed).await.unwrap();
        let second = stream.step(shifted(&full, &[], 0.0)).await.unwrap();
        assert!(!second.was_unchanged && second.whole.iterations.iter().all(|&count| count == 0));
        assert!(stream.step(shifted(&full, &[], 0.0)).await.unwrap().was_unchanged);
    }
}

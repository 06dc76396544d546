//! The memory of a stream's state, and what happens without it.

use std::time::Duration;

use hullcast::{
    budget::Part,
    proto::{DeleteHullsRequest, Output, QueryContactsRequest},
    service::Limits,
};
use tonic::Code;

use super::{Stepper, all_outputs, found};
use crate::support::{
    Setup, TestServer, refused,
    scenes::{outputs, register_request, scene, shapes},
};

fn crowd(bodies: usize, seed: u64) -> QueryContactsRequest {
    QueryContactsRequest { find: true, outputs: all_outputs(), ..scene(&shapes(), bodies, 0, seed) }
}

fn inherited(request_id: u64) -> QueryContactsRequest {
    QueryContactsRequest { request_id, inherit: true, ..Default::default() }
}

/// Catches a stream that ends because its state was not kept, an answer that hides that, and a message that is
/// answered as if it inherited. A stream without state goes on in full messages, and keeps its state once there is
/// room.
#[tokio::test(flavor = "multi_thread")]
async fn a_stream_without_room_goes_on_in_full_messages() {
    let limits = Limits { max_stream_state_bytes: 64 << 10, ..Limits::default() };
    let server = Setup { limits, ..Setup::default() }.start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let (large, small) = (crowd(60, 1), crowd(4, 2));
    for previous in [false, true] {
        let mut stream = Stepper::open(&server).await;
        for _ in 0..3 {
            let answer = stream.step(large.clone()).await.unwrap();
            assert!(answer.whole.state_dropped && !answer.whole.outcomes.is_empty());
            assert_eq!(answer.whole.pairs, found(&server, &large).await.pairs);
            assert!(answer.whole.previous_pairs.iter().all(|&pair| pair == super::NONE));
        }
        // A smaller scene has room, and the stream has its state again.
        assert!(!stream.step(small.clone()).await.unwrap().whole.state_dropped);
        assert!(!stream.step(inherited(3)).await.unwrap().whole.state_dropped);
        assert!(stream.step(large.clone()).await.unwrap().whole.state_dropped);
        let (message, field) = match previous {
            false => (inherited(4), ""),
            true => (QueryContactsRequest { previous_bodies: (0..60).collect(), ..large.clone() }, ""),
        };
        let refusal = stream.step(message).await.unwrap_err();
        assert_eq!(refusal, refused(Code::Unavailable, "STATE_NOT_KEPT", field));
    }
}

/// Catches state that is counted wrongly, that is not given back when its stream ends, or that grows from step to
/// step.
#[tokio::test(flavor = "multi_thread")]
async fn state_is_counted_and_given_back() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let held = || server.app.memory().used_by(Part::StreamState);
    assert_eq!(held(), 0);
    let full = crowd(80, 5);
    let mut stream = Stepper::open(&server).await;
    let rows = stream.step(full.clone()).await.unwrap().whole;
    let first = held();
    // A row has at least its outcome, flags, numbers, basis, features and matches; a body its pose.
    let least = 150 * rows.outcomes.len() as u64 + 56 * 80;
    assert!((least..4 * least).contains(&first), "{first} bytes, at least {least}");
    for step in 0..20 {
        stream.step(inherited(step)).await.unwrap();
        let previous_bodies = (0..80).collect();
        stream.step(QueryContactsRequest { previous_bodies, ..full.clone() }).await.unwrap();
        assert!(held().abs_diff(first) < first / 20, "{} bytes after {first}", held());
    }
    drop(stream);
    for _ in 0..500 {
        if held() == 0 {
            return;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("{} bytes are still held", held());
}

/// Catches a broad phase whose memory is not counted, one that is kept without room, and a stream that loses the
/// rest of its state because the broad phase has no room. Steps have the same pairs with and without it.
#[tokio::test(flavor = "multi_thread")]
async fn a_broad_phase_is_kept_if_there_is_room() {
    let full = QueryContactsRequest { outputs: outputs(&[Output::Outcome]), ..crowd(80, 6) };
    let mut pairs = Vec::new();
    let (mut dropped, mut held) = (0, Vec::new());
    for limit in (1..48).map(|count| count * (8 << 10)) {
        let limits = Limits { max_stream_state_bytes: limit, ..Limits::default() };
        let server = Setup { limits, ..Setup::default() }.start().await;
        server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
        let mut stream = Stepper::open(&server).await;
        if stream.step(full.clone()).await.unwrap().whole.state_dropped {
            assert_eq!(server.app.memory().used_by(Part::StreamState), 0);
            dropped += 1;
            continue;
        }
        held.push(server.app.memory().used_by(Part::StreamState));
        let moved = QueryContactsRequest {
            moved: vec![3, 70],
            positions: [full.positions[..3].to_vec(), vec![0.1, 0.2, 0.3]].concat(),
            rotations: [0.0, 0.0, 0.0, 1.0].repeat(2),
            ..inherited(2)
        };
        pairs.push(stream.step(moved).await.unwrap().whole.pairs);
    }
    let bounds = 80 * size_of::<hullcast::contact::Bounds>() as u64;
    assert!(held.len() > 1, "{dropped} of 47 were dropped");
    let [least, most] = [held[0], held[held.len() - 1]];
    assert!(least + bounds < most, "{held:?}");
    assert!(held.iter().all(|&bytes| bytes == least || bytes == most), "{held:?}");
    let with = held.iter().filter(|&&bytes| bytes == most).count();
    assert!(dropped > 0 && with > 0 && with < held.len(), "{dropped} dropped, {held:?}");
    assert!(pairs.iter().all(|some| !some.is_empty() && *some == pairs[0]));
}

/// Catches a row that is used again although a hull is gone, and a hull that is back and does not count.
#[tokio::test(flavor = "multi_thread")]
async fn a_hull_that_goes_changes_its_bodies() {
    let server = TestServer::start().await;
    let shapes = shapes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let full = QueryContactsRequest { outputs: outputs(&[]), ..crowd(40, 9) };
    let mut stream = Stepper::open(&server).await;
    let whole = stream.step(full.clone()).await.unwrap().whole;
    assert!(stream.step(inherited(1)).await.unwrap().was_unchanged);
    server.hulls().delete_hulls(DeleteHullsRequest { ids: vec![full.hull_ids[2].clone()] }).await.unwrap();
    let without = stream.step(inherited(2)).await.unwrap();
    assert!(!without.was_unchanged);
    assert_eq!(without.whole.missing_hulls, [2]);
    assert!(without.whole.pairs.iter().all(|&body| full.body_hulls[body as usize] != 2));
    assert!(without.whole.pairs.len() < whole.pairs.len());
    assert!(stream.step(inherited(3)).await.unwrap().was_unchanged);
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let back = stream.step(inherited(4)).await.unwrap();
    assert_eq!(back.whole.pairs, whole.pairs);
    assert_eq!(back.whole.outcomes, whole.outcomes);
}

/// Catches a panic, or matches of points that were not kept, where the answer before was asked without the output
/// MATCHES and so has no ids of points, no witnesses or no points at all.
#[tokio::test(flavor = "multi_thread")]
async fn matches_may_be_asked_for_later() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let with_matches = crowd(40, 7);
    let bodies: Vec<u32> = (0..40).collect();
    for first in
        [vec![Output::Outcome], vec![Output::Alpha], vec![Output::Points], vec![Output::Features], vec![]]
    {
        let mut stream = Stepper::open(&server).await;
        let before = QueryContactsRequest { outputs: outputs(&first), ..with_matches.clone() };
        assert!(!stream.step(before).await.unwrap().whole.outcomes.is_empty());
        let after = QueryContactsRequest { previous_bodies: bodies.clone(), ..with_matches.clone() };
        let answer = stream.step(after).await.unwrap().whole;
        assert!(answer.point_counts.iter().any(|&count| count > 0));
        assert!(answer.previous_pairs.iter().zip(0..).all(|(&row, index)| row == index), "{first:?}");
        assert!(answer.previous_points.iter().all(|&point| point == super::NONE), "{first:?}");
        let answer = stream.step(inherited(3)).await.unwrap().whole;
        assert!(answer.previous_points.iter().all(|&point| point != super::NONE), "{first:?}");
    }
}

/// Catches an answer that is sent as unchanged although a hull that no body uses was deleted.
#[tokio::test(flavor = "multi_thread")]
async fn a_hull_that_goes_is_missing_even_if_no_body_uses_it() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let mut full = QueryContactsRequest { outputs: outputs(&[Output::Outcome]), ..crowd(20, 8) };
    full.body_hulls.fill(0);
    let mut stream = Stepper::open(&server).await;
    assert!(stream.step(full.clone()).await.unwrap().whole.missing_hulls.is_empty());
    let ids = vec![full.hull_ids[1].clone()];
    server.hulls().delete_hulls(DeleteHullsRequest { ids }).await.unwrap();
    assert_eq!(stream.step(inherited(2)).await.unwrap().whole.missing_hulls, [1]);
}

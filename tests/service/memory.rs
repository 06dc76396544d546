//! The memory of hulls: the cache, and the hulls that requests hold in it.

use std::sync::Arc;

use bytes::Bytes;
use hullcast::{
    budget::Part,
    proto::{Output, QueryContactsRequest},
    service::Limits,
    store::{BlobStore, HullDefinition, blobs},
};
use tonic::Code;

use crate::support::{
    Setup, TestServer, invalid, raw, refusal, refused,
    scenes::{assert_same, expected, outputs, plain, register_request, round_points, scene},
};

const HELD: &str = "hullcast_held_bytes";

/// A store with hulls of about equal size, and the bytes that all of them take in the cache.
async fn stored(count: u64) -> (Arc<dyn BlobStore>, Vec<HullDefinition>, u64) {
    let store = blobs::open("memory://").unwrap();
    let shapes: Vec<_> = (0..count).map(|seed| plain(round_points(50, seed))).collect();
    let server = with_cache(&store, 1 << 30).await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let bytes = server.app.registry().cached_bytes();
    assert_eq!(server.app.registry().cached_hulls(), shapes.len());
    (store, shapes, bytes)
}

async fn with_cache(store: &Arc<dyn BlobStore>, cache_bytes: u64) -> TestServer {
    let limits = Limits { cache_bytes, shares: false, ..Limits::default() };
    // One thread more than the chunks of the query that is held up below, so that hulls can still
    // be built.
    Setup { store: store.clone(), limits, threads: 3, ..Setup::default() }.start().await
}

/// Catches a connection that keeps a record of each of 1,000 calls that begin at the same moment, although no
/// call lasts: HTTP/2's table of streams never shrinks, and 1,000 such connections held 1.6 GiB.
#[tokio::test(flavor = "multi_thread")]
async fn calls_that_begin_together_do_not_all_have_records_at_a_time() {
    let server = TestServer::start().await;
    let connections = || server.metric(r#"hullcast_memory_bytes{part="connections"}"#);
    let mut client = raw::connect(&server.address).await;
    let first = client.send_request(raw::call("/x", &[], raw::Body::Unfinished(Bytes::new()))).await.unwrap();
    raw::status_in(first).await;
    let before = connections();
    let calls: Vec<_> = (0..1000)
        .map(|_| client.send_request(raw::call("/x", &[], raw::Body::Unfinished(Bytes::new()))))
        .collect();
    for answer in futures_util::future::join_all(calls).await {
        assert_eq!(raw::status_in(answer.unwrap()).await.code(), Code::Unimplemented);
    }
    let records = (connections() - before) / f64::from(2 << 10);
    assert!(records > 0.0 && records < 700.0, "{records} records");
}

/// One body of every shape, and some pairs.
fn of(shapes: &[HullDefinition], pairs: usize) -> QueryContactsRequest {
    let mut request = scene(shapes, shapes.len(), pairs, 1);
    request.body_hulls = (0..shapes.len() as u32).collect();
    request.outputs = outputs(&[Output::Outcome]);
    request
}

/// Catches a request that is refused although its hulls fit in the cache, a request one byte too
/// large that is answered or told to retry, and hulls that stay held after their request was
/// refused. Tested with the hulls in the cache, and with an empty cache.
#[tokio::test(flavor = "multi_thread")]
async fn a_requests_hulls_at_the_caches_bytes_and_one_past() {
    let (store, shapes, bytes) = stored(40).await;
    let request = of(&shapes, 100);
    let good = expected(&request, &shapes);
    let server = with_cache(&store, bytes).await;
    for _cold_then_warm in 0..2 {
        let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
        assert_same(&answer, &good);
        assert_eq!(server.metric(HELD), 0.0);
        assert_eq!(server.app.registry().cached_bytes(), bytes, "some hulls are not cached");
    }

    let server = with_cache(&store, bytes - 1).await;
    let too_large = invalid("HULLS_TOO_LARGE", "hull_ids");
    for _cold_then_warm in 0..2 {
        let status = server.contacts().query_contacts(request.clone()).await.unwrap_err();
        assert_eq!(refusal(&status), too_large);
        let stream = futures_util::stream::iter([request.clone()]);
        let mut answers = server.contacts().stream_contacts(stream).await.unwrap().into_inner();
        assert_eq!(refusal(&answers.message().await.unwrap_err()), too_large);
        let find = QueryContactsRequest { pairs: Vec::new(), ..request.clone() };
        let status = server.contacts().find_contacts(find).await.unwrap_err();
        assert_eq!(refusal(&status), too_large);
        server.until(HELD, 0.0).await;
        assert!(server.app.registry().cached_bytes() < bytes);
        let fewer = of(&shapes[1..], 100);
        let answer = server.contacts().query_contacts(fewer.clone()).await.unwrap().into_inner();
        assert_same(&answer, &expected(&fewer, &shapes[1..]));
    }
}

/// Hulls that other requests hold must not be evicted for a new request. That request must be told
/// to retry and hold nothing meanwhile; a request for the held hulls must be answered. Held hulls
/// must be released when their request ends or is cancelled. Catches memory that grows with the
/// number of requests in flight.
#[tokio::test(flavor = "multi_thread")]
async fn what_requests_hold_together_is_bounded() {
    let (store, shapes, bytes) = stored(40).await;
    let server = with_cache(&store, bytes * 3 / 4).await;
    let (ours, theirs) = shapes.split_at(20);
    let held = {
        let server = with_cache(&store, bytes).await;
        server.contacts().query_contacts(of(ours, 1)).await.unwrap();
        server.app.registry().cached_bytes() as f64
    };
    let slow = of(ours, 100);
    let good = expected(&slow, ours);
    let controls = server.app.engine().test_controls();
    for given_up in [false, true] {
        // No pair may be computed, so the hulls stay held.
        controls.allow(0);
        let mut contacts = server.contacts();
        let request = slow.clone();
        let call = tokio::spawn(async move { contacts.query_contacts(request).await });
        server.until(HELD, held).await;
        let shed = server.metric(r#"hullcast_sheds_total{reason="held_bytes"}"#);
        let status = server.contacts().query_contacts(of(theirs, 1)).await.unwrap_err();
        assert_eq!(refusal(&status), refused(Code::Unavailable, "TOO_BUSY", ""));
        assert!(status.metadata().contains_key("grpc-retry-pushback-ms"));
        assert_eq!(server.metric(r#"hullcast_sheds_total{reason="held_bytes"}"#), shed + 1.0);
        server.until(HELD, held).await;
        // A second request for held hulls adds nothing to the held bytes and reads nothing, and the
        // first request still holds them.
        let misses = server.metric("hullcast_cache_misses_total");
        controls.allow(1);
        server.contacts().query_contacts(of(ours, 1)).await.unwrap();
        assert_eq!(server.metric(HELD), held);
        assert_eq!(server.metric("hullcast_cache_misses_total"), misses);
        if given_up {
            call.abort();
            controls.open();
            server.until(HELD, 0.0).await;
        } else {
            controls.open();
            assert_same(&call.await.unwrap().unwrap().into_inner(), &good);
            assert_eq!(server.metric(HELD), 0.0, "hulls are held after the answer");
        }
        server.contacts().query_contacts(of(theirs, 1)).await.unwrap();
        assert!(server.app.registry().cached_bytes() <= bytes * 3 / 4);
    }
}

/// Catches memory of the budget that is not returned when a call ends: answered, refused for any
/// reason, or cancelled. A stream keeps some memory and must return it when it ends.
#[tokio::test(flavor = "multi_thread")]
async fn every_call_gives_its_memory_back() {
    let server = TestServer::start().await;
    let shapes: Vec<_> = (0..4).map(|seed| plain(round_points(50, seed))).collect();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let memory = server.app.memory();
    server.until_calls_hold_nothing().await;
    // A small request, which is decoded on the calling task, and one of 0.6 MiB, which is decoded
    // on the compute threads.
    for bodies in [100, 10_000] {
        let mut good = of(&shapes, 100);
        good.positions = vec![0.25; 3 * bodies];
        good.rotations = [0.0, 0.0, 0.0, 1.0].repeat(bodies);
        good.body_hulls = (0..bodies as u32).map(|body| body % 4).collect();
        let late_fault = QueryContactsRequest { margin: -1.0, ..good.clone() };
        let find = QueryContactsRequest { pairs: vec![], margin: 1e-3, ..of(&shapes, 0) };
        server.contacts().query_contacts(good.clone()).await.unwrap();
        server.contacts().query_contacts(late_fault).await.unwrap_err();
        let mut found = server.contacts().find_contacts(find).await.unwrap().into_inner();
        found.message().await.unwrap();
        drop(found);
        server.until_calls_hold_nothing().await;

        server.app.engine().test_controls().allow(0);
        let mut contacts = server.contacts();
        let request = good.clone();
        let call = tokio::spawn(async move { contacts.query_contacts(request).await });
        while memory.used_by(Part::Decoded) == 0 {
            tokio::time::sleep(std::time::Duration::from_millis(1)).await;
        }
        // The memory that each call takes at its start covers the first 4 KiB.
        assert!(memory.used_by(Part::Decoded) >= 60 * bodies as u64 - 4096);
        call.abort();
        server.app.engine().test_controls().open();
        server.until_calls_hold_nothing().await;

        let (requests, received) = tokio::sync::mpsc::channel(1);
        let mut received = received;
        let stream = futures_util::stream::poll_fn(move |cx| received.poll_recv(cx));
        let mut answers = server.contacts().stream_contacts(stream).await.unwrap().into_inner();
        for _ in 0..3 {
            requests.send(good.clone()).await.unwrap();
            answers.message().await.unwrap().unwrap();
        }
        // The scene: ids, presence of hulls, hulls of bodies, poses, pairs. The answer, of which the request wants
        // the outcomes only: outcomes and flags, bases.
        let kept = 4 * 32 + 4 + (4 + 56) * bodies as u64 + 8 * 100 + (2 + 24) * 100;
        while memory.used_by(Part::Decoded) > 0 {
            tokio::time::sleep(std::time::Duration::from_millis(1)).await;
        }
        assert_eq!(memory.used_by(Part::StreamState), kept, "{bodies} bodies");
        drop((requests, answers));
        server.until_calls_hold_nothing().await;
    }
}

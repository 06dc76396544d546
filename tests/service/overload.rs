//! More load than the server can compute: accepted calls must be answered, all others refused at
//! once.
//!
//! Every pair takes a known time, during which its thread sleeps. The tests compare counts, not
//! times.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use futures_util::{StreamExt, future::join_all, stream::FuturesUnordered};
use hullcast::{proto::QueryContactsRequest, service::Limits};
use tonic::{Code, Request};

use crate::support::{
    TestServer, channel, refusal, refused,
    scenes::{outputs, register_request, scene, shapes},
};

async fn server(limits: Limits, per_pair: Duration) -> TestServer {
    let server = TestServer::with_limits(limits).await;
    server.hulls().register_hulls(register_request(&shapes()[..3])).await.unwrap();
    server.app.engine().test_controls().delay(per_pair);
    server
}

fn request(pairs: usize) -> QueryContactsRequest {
    QueryContactsRequest {
        outputs: outputs(&[hullcast::proto::Output::Outcome]),
        ..scene(&shapes()[..3], 20, pairs, 1)
    }
}

/// Forty callers that retry at once ask for ten times the capacity. Catches accepted work that is
/// lost or answered twice, work that is computed and thrown away, more work accepted than allowed,
/// and a refusal that a client cannot distinguish from a fault.
#[tokio::test(flavor = "multi_thread")]
async fn what_is_accepted_is_answered_and_the_rest_is_shed() {
    const PAIRS: u32 = 100;
    const CALLERS: usize = 40;
    const ANSWERS: u64 = 400;
    let limits = Limits { max_pairs_per_request: PAIRS, max_pairs_in_flight: 4 * PAIRS, ..Limits::default() };
    let server = Arc::new(server(limits, Duration::from_micros(20)).await);
    let (answered, shed) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let done = Arc::new(AtomicBool::new(false));
    let watcher = tokio::spawn({
        let (server, done) = (server.clone(), done.clone());
        async move {
            let mut most = 0.0_f64;
            while !done.load(Ordering::SeqCst) {
                most = most.max(server.metric("hullcast_pairs_in_flight"));
                tokio::time::sleep(Duration::from_micros(200)).await;
            }
            most
        }
    });
    let callers = (0..CALLERS).map(|_| {
        let (mut contacts, answered, shed) = (server.contacts(), answered.clone(), shed.clone());
        tokio::spawn(async move {
            while answered.load(Ordering::SeqCst) < ANSWERS {
                match contacts.query_contacts(request(PAIRS as usize)).await {
                    Ok(answer) => {
                        assert_eq!(answer.into_inner().outcomes.len(), PAIRS as usize);
                        answered.fetch_add(1, Ordering::SeqCst);
                    }
                    Err(status) => {
                        assert_eq!(refusal(&status), refused(Code::Unavailable, "TOO_BUSY", ""));
                        let pushback = status.metadata().get("grpc-retry-pushback-ms").unwrap();
                        assert!(pushback.to_str().unwrap().parse::<u64>().unwrap() >= 20);
                        shed.fetch_add(1, Ordering::SeqCst);
                        tokio::time::sleep(Duration::from_millis(1)).await;
                    }
                }
            }
        })
    });
    for caller in join_all(callers).await {
        caller.unwrap();
    }
    done.store(true, Ordering::SeqCst);
    let most = watcher.await.unwrap();
    let (answered, shed) = (answered.load(Ordering::SeqCst), shed.load(Ordering::SeqCst));
    assert!(answered >= ANSWERS && shed > answered, "{answered} answered, {shed} shed");
    assert_eq!(
        server.app.engine().pairs_computed(),
        answered * u64::from(PAIRS),
        "pairs were computed for refused calls"
    );
    assert!((f64::from(PAIRS)..=f64::from(4 * PAIRS)).contains(&most), "{most} pairs in flight");
    assert_eq!(server.metric("hullcast_pairs_in_flight"), 0.0);
    assert_eq!(server.metric(r#"hullcast_sheds_total{reason="pairs_in_flight"}"#), shed as f64);
}

/// Time is measured in pairs that may be computed: each tick allows two batches while twenty are
/// offered. Catches capacity that is lost to overload: a server that computes answers nobody
/// receives, refuses calls while it is idle, or loses accepted ones.
#[tokio::test(flavor = "multi_thread")]
async fn ten_times_the_load_costs_no_capacity() {
    const PAIRS: usize = 64;
    const CAPACITY: usize = 2;
    const OFFERED: usize = 10 * CAPACITY;
    const TICKS: usize = 50;
    const ROOM: usize = 8 * CAPACITY;
    let limits = Limits {
        max_pairs_per_request: PAIRS as u32,
        max_pairs_in_flight: (ROOM * PAIRS) as u32,
        ..Limits::default()
    };
    let server = server(limits, Duration::ZERO).await;
    let controls = server.app.engine().test_controls();
    controls.allow(0);
    let mut calls = FuturesUnordered::new();
    let (mut answered, mut shed, mut most) = (0, 0, 0.0_f64);
    for tick in 1..=TICKS {
        for _ in 0..OFFERED {
            let mut contacts = server.contacts();
            calls.push(tokio::spawn(async move { contacts.query_contacts(request(PAIRS)).await }));
        }
        // Each call is either accepted or refused; then two batches may be computed.
        while shed + answered + (server.metric("hullcast_pairs_in_flight") as usize) / PAIRS < tick * OFFERED
        {
            tokio::select! {
                Some(call) = calls.next() => {
                    let status = call.unwrap().unwrap_err();
                    assert_eq!(refusal(&status), refused(Code::Unavailable, "TOO_BUSY", ""));
                    shed += 1;
                }
                () = tokio::time::sleep(Duration::from_millis(1)) => {}
            }
        }
        most = most.max(server.metric("hullcast_pairs_in_flight"));
        let before = answered;
        controls.allow(CAPACITY * PAIRS);
        while answered < before + CAPACITY && server.metric("hullcast_pairs_in_flight") > 0.0 {
            assert_eq!(calls.next().await.unwrap().unwrap().unwrap().into_inner().outcomes.len(), PAIRS);
            answered += 1;
        }
    }
    let goodput = answered as f64 / (TICKS * CAPACITY) as f64;
    assert!(goodput >= 0.9, "{goodput} of the capacity");
    assert!(shed > 8 * answered, "{shed} shed, {answered} answered");
    assert_eq!(most, (ROOM * PAIRS) as f64);
    // All accepted calls are answered, and nothing else was computed.
    controls.open();
    while let Some(call) = calls.next().await {
        call.unwrap().unwrap();
        answered += 1;
    }
    assert_eq!(answered + shed, TICKS * OFFERED);
    assert_eq!(server.app.engine().pairs_computed(), (answered * PAIRS) as u64);
}

/// A small batch that arrives last must end first. Catches a small batch that waits until large
/// ones are done.
#[tokio::test(flavor = "multi_thread")]
async fn small_batches_overtake_large_ones() {
    let server = server(Limits::default(), Duration::from_millis(1)).await;
    let mut calls = FuturesUnordered::new();
    for pairs in [70_000, 70_000, 20_000] {
        let mut contacts = server.contacts();
        calls.push(tokio::spawn(async move {
            contacts.query_contacts(request(pairs)).await.unwrap().into_inner()
        }));
    }
    server.until("hullcast_pairs_in_flight", 160_000.0).await;
    let mut contacts = server.contacts();
    calls
        .push(tokio::spawn(async move { contacts.query_contacts(request(100)).await.unwrap().into_inner() }));
    let first = calls.next().await.unwrap().unwrap();
    assert_eq!(first.outcomes.len(), 100);
    server.app.engine().test_controls().delay(Duration::ZERO);
    let mut rest: Vec<_> = calls.map(|answer| answer.unwrap().outcomes.len()).collect().await;
    rest.sort_unstable();
    assert_eq!(rest, [20_000, 70_000, 70_000]);
}

/// Catches a batch that is computed although, while it waited for its turn, its deadline passed or
/// its caller left.
#[tokio::test(flavor = "multi_thread")]
async fn who_gives_up_waiting_leaves_the_queue() {
    let server = server(Limits::default(), Duration::from_millis(1)).await;
    let mut contacts = server.contacts();
    let first = tokio::spawn(async move { contacts.query_contacts(request(70_000)).await.unwrap() });
    server.until("hullcast_pairs_in_flight", 70_000.0).await;

    let mut late = Request::new(request(30_000));
    late.set_timeout(Duration::from_millis(50));
    // A new connection. The request's header tells the server the deadline.
    let mut contacts =
        hullcast::proto::contact_service_client::ContactServiceClient::new(channel(&server.address).await);
    let status = contacts.query_contacts(late).await.unwrap_err();
    assert!(matches!(status.code(), Code::DeadlineExceeded | Code::Cancelled), "{status:?}");
    server.until("hullcast_pairs_queued", 0.0).await;

    let mut contacts = server.contacts();
    let gone = tokio::spawn(async move { contacts.query_contacts(request(30_000)).await });
    server.until("hullcast_pairs_queued", 30_000.0).await;
    gone.abort();
    server.until("hullcast_pairs_queued", 0.0).await;
    server.until("hullcast_pairs_in_flight", 70_000.0).await;

    server.app.engine().test_controls().delay(Duration::ZERO);
    assert_eq!(first.await.unwrap().into_inner().outcomes.len(), 70_000);
    assert_eq!(server.app.engine().pairs_computed(), 70_000);
}

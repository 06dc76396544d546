//! A store that hangs: an operation starts and does not return.

use std::{
    process::Command,
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use hullcast::{
    proto::{HasHullsRequest, ListHullsRequest},
    service::{Limits, Readiness, ServerOptions},
    store::HullDefinition,
};
use tonic::Code;
use tonic_health::pb::{HealthCheckRequest, health_client::HealthClient};

use crate::support::{
    Refusal, Setup, TestServer, channel,
    process::{BINARY, Process, tracer},
    refusal, refused,
    scenes::{assert_same, expected, id, plain, register_request, round_points, scene},
    store::FaultyStore,
};

const HULL_UNAVAILABLE: u8 = 32;

fn shape(seed: u64) -> HullDefinition {
    plain(round_points(20, seed))
}

fn unavailable() -> Refusal {
    refused(Code::Unavailable, "STORE_UNAVAILABLE", "")
}

/// A server with one hull in its cache, on a store that has another one. An operation may take one
/// second. The cache age is 0, so cached hulls are always stale.
async fn server(store: &Arc<FaultyStore>) -> TestServer {
    let limits = Limits { store_seconds: 1, cache_age_seconds: 0, ..Limits::default() };
    let start = || Setup { store: store.clone(), limits: limits.clone(), ..Setup::default() }.start();
    let other = start().await;
    other.hulls().register_hulls(register_request(&[shape(1), shape(2)])).await.unwrap();
    let server = start().await;
    flags(&server, &shape(1)).await;
    server
}

/// The flags of the pair of a hull with itself.
async fn flags(server: &TestServer, shape: &HullDefinition) -> u8 {
    let request = scene(std::slice::from_ref(shape), 2, 1, 1);
    server.contacts().query_contacts(request).await.unwrap().into_inner().flags[0]
}

/// Catches callers that wait for a hung store, operations that keep starting on it and pile up,
/// cached hulls that are refused, and a store that is not used again once it answers.
#[tokio::test(flavor = "multi_thread")]
async fn nothing_begins_on_a_store_that_hangs() {
    let store = FaultyStore::new();
    let server = server(&store).await;
    store.hangs.send_replace(true);
    // There are more calls than operations may run at a time, and the calls that wait for their
    // turn must be refused too.
    let waiting: Vec<_> = (0..200_u8)
        .map(|i| {
            let mut hulls = server.hulls();
            let ids = vec![vec![i; 32]];
            tokio::spawn(async move { hulls.has_hulls(HasHullsRequest { ids }).await.unwrap_err() })
        })
        .collect();
    for call in waiting {
        assert_eq!(refusal(&call.await.unwrap()), unavailable());
    }
    let begun = store.begun.load(Ordering::SeqCst);
    for round in 0..50 {
        assert_eq!(flags(&server, &shape(1)).await & HULL_UNAVAILABLE, 0, "a cached hull is answered");
        assert_eq!(flags(&server, &shape(2)).await & HULL_UNAVAILABLE, HULL_UNAVAILABLE);
        let ids = vec![id(&shape(1))];
        let present = server.hulls().has_hulls(HasHullsRequest { ids }).await.unwrap().into_inner().present;
        assert_eq!(present, [true]);
        let request = register_request(&[shape(3 + round)]);
        assert_eq!(refusal(&server.hulls().register_hulls(request).await.unwrap_err()), unavailable());
        let status = server.hulls().list_hulls(ListHullsRequest::default()).await.unwrap_err();
        assert_eq!(refusal(&status), unavailable());
    }
    assert_eq!(store.begun.load(Ordering::SeqCst), begun, "nothing began meanwhile");

    store.hangs.send_replace(false);
    while flags(&server, &shape(2)).await & HULL_UNAVAILABLE != 0 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    server.hulls().register_hulls(register_request(&[shape(3)])).await.unwrap();
    let request = scene(&[shape(1), shape(2), shape(3)], 6, 20, 1);
    let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
    assert_same(&answer, &expected(&request, &[shape(1), shape(2), shape(3)]));
}

/// Catches a hung store that is not noticed because every caller leaves before the time limit.
#[tokio::test(flavor = "multi_thread")]
async fn callers_who_leave_do_not_hide_that_the_store_hangs() {
    let store = FaultyStore::new();
    let server = server(&store).await;
    store.hangs.send_replace(true);
    let mut hulls = server.hulls();
    let call = tokio::spawn(async move {
        hulls.has_hulls(HasHullsRequest { ids: vec![vec![7; 32]] }).await.unwrap();
    });
    let begun = store.begun.load(Ordering::SeqCst);
    while store.begun.load(Ordering::SeqCst) == begun {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    call.abort();
    let begun = store.begun.load(Ordering::SeqCst);
    // Operations may start until the time limit has passed, and none after it.
    let mut refused_at_once = 0;
    while refused_at_once < 10 {
        let before = store.begun.load(Ordering::SeqCst);
        let ids = vec![vec![8; 32]];
        let mut hulls = server.hulls();
        let call = hulls.has_hulls(HasHullsRequest { ids });
        let ended = tokio::time::timeout(Duration::from_millis(100), call).await;
        let same = store.begun.load(Ordering::SeqCst) == before;
        refused_at_once += usize::from(ended.is_ok() && same);
    }
    assert!(store.begun.load(Ordering::SeqCst) - begun < 64, "more operations began than may run at a time");
}

/// Catches readiness and health that report a hung store as ready, or that wait for the store
/// themselves.
#[tokio::test(flavor = "multi_thread")]
async fn readiness_and_health_say_that_the_store_hangs() {
    let store = FaultyStore::new();
    let options = ServerOptions { probe_every: Duration::from_millis(50), ..ServerOptions::default() };
    let server = Setup { store: store.clone(), options, ..Setup::default() }.start().await;
    let mut health = HealthClient::new(channel(&server.address).await);
    let mut check = async |service: &str| {
        let request = HealthCheckRequest { service: service.into() };
        health.check(request).await.unwrap().into_inner().status
    };
    const HULLS: &str = "hullcast.v1.HullService";
    assert_eq!(check(HULLS).await, 1);
    store.hangs.send_replace(true);
    while check(HULLS).await != 2 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert_eq!(check("").await, 1, "cached hulls are served");
    while server.app.readiness() == Readiness::Ready {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let said = server.app.readiness().to_string();
    assert!(said.starts_with("degraded: the store does not answer"), "{said}");
    store.hangs.send_replace(false);
    while check(HULLS).await != 1 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

/// The real binary on a real directory whose file system calls hang, as on a network file system
/// whose server is gone. The server must degrade, answer for cached hulls, recover, and stop
/// without waiting for the file system.
#[tokio::test(flavor = "multi_thread")]
async fn a_directory_that_hangs_degrades_and_recovers() {
    let directory = tempfile::tempdir().unwrap();
    let (store, hang) = (directory.path().join("store"), directory.path().join("hang"));
    let other = Process::plain(&store);
    other.hulls().await.register_hulls(register_request(&[shape(1), shape(2)])).await.unwrap();
    let mut command = Command::new(BINARY);
    command.env("LD_PRELOAD", tracer(directory.path())).env("CALL_HANG", &hang);
    let arguments = ["--store-seconds", "1", "--probe-seconds", "0.2", "--admin-listen", "127.0.0.1:0"];
    let arguments = [&arguments[..], &["--cache-age-seconds", "0", "--grace-seconds", "0"]].concat();
    let mut server = Process::start(command, &store, &arguments);
    let flags = async |shape: &HullDefinition| {
        let request = scene(std::slice::from_ref(shape), 2, 1, 1);
        server.contacts().await.query_contacts(request).await.unwrap().into_inner().flags[0]
    };
    assert_eq!(flags(&shape(1)).await & HULL_UNAVAILABLE, 0);

    std::fs::write(&hang, "").unwrap();
    let (known, new) = (shape(1), shape(2));
    let (unread, cached) = tokio::join!(flags(&new), flags(&known));
    assert_eq!(unread & HULL_UNAVAILABLE, HULL_UNAVAILABLE);
    assert_eq!(cached & HULL_UNAVAILABLE, 0);
    server.until_ready_says("degraded").await;
    let status = server.hulls().await.register_hulls(register_request(&[shape(3)])).await.unwrap_err();
    assert_eq!(refusal(&status), unavailable());
    std::fs::remove_file(&hang).unwrap();
    server.until_ready_says("ready").await;
    assert_eq!(flags(&shape(2)).await & HULL_UNAVAILABLE, 0);

    std::fs::write(&hang, "").unwrap();
    server.until_ready_says("degraded").await;
    server.signal("-TERM");
    // The hung calls never return during the test, so a server that waited for them would never
    // end.
    assert!(server.wait().success());
}

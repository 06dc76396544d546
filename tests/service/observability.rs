//! Tests of observability: metrics, probes, logs and the dashboard.

use std::{collections::BTreeSet, sync::atomic::Ordering, time::Duration};

use hullcast::{budget::CallerKey, proto::QueryContactsRequest, service::serve_admin};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
};
use tonic_health::pb::{
    HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient,
};

use crate::support::{
    Setup, TestServer, raw, scenes,
    scenes::{register_request, two_boxes},
    store::FaultyStore,
};

/// The status code, the headers and the body of a GET.
async fn get(address: &str, path: &str) -> (u16, String, String) {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nhost: here\r\nconnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).await.unwrap();
    let (head, body) = text.split_once("\r\n\r\n").unwrap();
    (head.split(' ').nth(1).unwrap().parse().unwrap(), head.to_owned(), body.to_owned())
}

async fn admin(server: &TestServer) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    tokio::spawn(serve_admin(listener, server.app.clone()));
    address
}

/// Catches a probe that reports the wrong state to a load balancer.
#[tokio::test(flavor = "multi_thread")]
async fn probes_follow_the_servers_life() {
    let mut server = Setup { grace: Duration::from_secs(3600), ..Setup::default() }.start().await;
    let admin = admin(&server).await;
    assert_eq!(get(&admin, "/livez").await.0, 200);
    while get(&admin, "/readyz").await.0 != 200 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    assert_eq!(get(&admin, "/else").await.0, 404);
    server.begin_stop();
    while get(&admin, "/readyz").await.0 == 200 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    assert_eq!(get(&admin, "/readyz").await.2, "stopping\n");
    assert_eq!(get(&admin, "/livez").await.0, 200);
    // During the grace period every call is answered, also on new connections.
    let channel = crate::support::channel(&server.address).await;
    let mut health = HealthClient::new(channel.clone());
    let request = HealthCheckRequest::default;
    while health.check(request()).await.unwrap().into_inner().status() != ServingStatus::NotServing {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    let mut hulls = hullcast::proto::hull_service_client::HullServiceClient::new(channel);
    hulls.register_hulls(register_request(&two_boxes().0)).await.unwrap();
}

/// While the store fails, HullService must be reported as not serving, and ContactService as
/// serving. Catches a failing store that is not reported.
#[tokio::test(flavor = "multi_thread")]
async fn a_failing_store_is_degraded_and_recovers() {
    let store = FaultyStore::new();
    let mut setup = Setup { store: store.clone(), ..Setup::default() };
    setup.options.probe_every = Duration::from_millis(5);
    let server = setup.start().await;
    let admin = admin(&server).await;
    let mut health = HealthClient::new(server.channel());
    let mut status = async |service: &str| {
        let request = HealthCheckRequest { service: service.into() };
        health.check(request).await.unwrap().into_inner().status()
    };
    for (fails, said, expected) in
        [(true, "degraded: ", ServingStatus::NotServing), (false, "ready", ServingStatus::Serving)]
    {
        store.unreadable.store(fails, Ordering::SeqCst);
        loop {
            let (code, _, body) = get(&admin, "/readyz").await;
            assert_eq!(code, 200);
            if body.starts_with(said) {
                break;
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        assert_eq!(status("hullcast.v1.HullService").await, expected);
        assert_eq!(status("hullcast.v1.ContactService").await, ServingStatus::Serving);
    }
}

/// Catches a call or a pair that is not counted, or under another name, a gauge that does not
/// return to 0, and a content type that scrapers do not accept.
#[tokio::test(flavor = "multi_thread")]
async fn metrics_count_what_happened() {
    let server = TestServer::start().await;
    let admin = admin(&server).await;
    let (shapes, request) = two_boxes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
    let outcome = ["contact", "separated"][answer.outcomes[0] as usize - 1];
    let unknown = QueryContactsRequest { hull_ids: vec![vec![7; 32]], ..request.clone() };
    server.contacts().query_contacts(unknown).await.unwrap();
    let malformed = QueryContactsRequest { margin: -1.0, ..request.clone() };
    server.contacts().query_contacts(malformed.clone()).await.unwrap_err();
    let steps = futures_util::stream::iter([request, malformed]);
    let mut stream = server.contacts().stream_contacts(steps).await.unwrap().into_inner();
    while let Ok(Some(_)) = stream.message().await {}
    raw::status_of(&server.address, "/nothing.Of/TheKind", &[], raw::frame(false, &[])).await;
    server.until("hullcast_requests_in_flight", 0.0).await;

    let query = r#"method="hullcast.v1.ContactService/QueryContacts""#;
    for (name, value) in [
        (format!("hullcast_requests_total{{{query},code=\"OK\"}}"), 2.0),
        (format!("hullcast_requests_total{{{query},code=\"INVALID_ARGUMENT\"}}"), 1.0),
        (format!("hullcast_request_seconds_count{{{query}}}"), 3.0),
        (
            r#"hullcast_requests_total{method="hullcast.v1.ContactService/StreamContacts",code="INVALID_ARGUMENT"}"#
                .into(),
            1.0,
        ),
        (r#"hullcast_requests_total{method="other",code="UNIMPLEMENTED"}"#.into(), 1.0),
        (format!("hullcast_pairs_total{{outcome=\"{outcome}\"}}"), 2.0),
        (r#"hullcast_pairs_total{outcome="invalid"}"#.into(), 1.0),
        (r#"hullcast_pair_flags_total{flag="unknown_hull"}"#.into(), 1.0),
        ("hullcast_registered_total".into(), 1.0),
        ("hullcast_cache_hulls".into(), 1.0),
        ("hullcast_cache_misses_total".into(), 1.0),
        ("hullcast_cache_hits_total".into(), 2.0),
        ("hullcast_compute_seconds_count".into(), 3.0),
        ("hullcast_queue_seconds_count".into(), 3.0),
        ("hullcast_load_seconds_count".into(), 1.0),
        ("hullcast_pairs_in_flight".into(), 0.0),
        ("hullcast_request_bytes_in_flight".into(), 0.0),
        ("hullcast_ready".into(), 1.0),
    ] {
        assert_eq!(server.metric(&name), value, "{name}");
    }
    assert!(server.metric("hullcast_resident_bytes") > 1e6);
    let limits = server.app.limits();
    assert_eq!(server.metric("hullcast_memory_limit_bytes"), limits.max_memory_bytes as f64);
    assert_eq!(server.metric("hullcast_cache_limit_bytes"), limits.cache_bytes as f64);
    assert!(server.metric("hullcast_cache_bytes") > 100.0);
    assert!(server.metric("hullcast_solver_iterations_total") > 0.0);
    let (code, head, body) = get(&admin, "/metrics").await;
    assert!(
        code == 200 && head.to_lowercase().contains("content-type: application/openmetrics-text"),
        "{head}"
    );
    assert!(body.ends_with("# EOF\n"));
}

/// Catches a panel of the dashboard that stays empty because the server has no such metric, and a
/// metric that no panel shows.
#[tokio::test(flavor = "multi_thread")]
async fn the_dashboard_names_the_metrics_that_are() {
    let server = TestServer::start().await;
    let (shapes, request) = two_boxes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    server.contacts().query_contacts(request).await.unwrap();
    // The memory of a token has a sample only while a caller with this token is known.
    let _caller = server.app.callers().get(CallerKey::Token("worker".into()));
    let text = server.app.metrics_text();
    assert!(text.contains("hullcast_token_memory_bytes{token=\"worker\"} 0"), "{text}");
    let name = |text: &str| -> Option<String> {
        let end = text.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(text.len());
        text[..end].starts_with("hullcast_").then(|| text[..end].to_owned())
    };
    let samples: BTreeSet<String> = text.lines().filter_map(name).collect();
    let families: BTreeSet<String> =
        text.lines().filter_map(|line| name(line.strip_prefix("# TYPE ")?)).collect();
    let dashboard = include_str!("../../deploy/grafana.json");
    let dashboard: serde_json::Value = serde_json::from_str(dashboard).unwrap();
    let mut expressions = Vec::new();
    for panel in dashboard["panels"].as_array().unwrap() {
        for target in panel["targets"].as_array().unwrap() {
            expressions.push(target["expr"].as_str().unwrap().to_owned());
        }
    }
    let named: BTreeSet<String> = expressions
        .iter()
        .flat_map(|expression| {
            expression.match_indices("hullcast_").map(|(at, _)| name(&expression[at..]).unwrap())
        })
        .collect();
    assert!(named.len() > 20, "{named:?}");
    let absent: Vec<_> = named.difference(&samples).collect();
    assert!(absent.is_empty(), "{absent:?} in {text}");
    let unseen: Vec<_> = families
        .iter()
        .filter(|family| !named.iter().any(|name| name.starts_with(family.as_str())))
        .collect();
    assert!(unseen.is_empty(), "{unseen:?}");
}

/// Catches log lines that cannot be matched with a client's call or trace.
#[test]
fn logs_say_which_call() {
    use std::{
        io::{BufRead, BufReader, Read},
        process::{Command, Stdio},
    };
    let mut child = Command::new(env!("CARGO_BIN_EXE_hullcast"))
        .args(["serve", "--listen", "127.0.0.1:0", "--store", "memory://", "--until-stdin-closes"])
        .args(["--log", "debug", "--log-format", "json"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let address = line.strip_prefix("listening on ").unwrap().trim().to_owned();
    let trace = "4bf92f3577b34da6a3ce929d0e0e4736";
    let context = format!("00-{trace}-00f067aa0ba902b7-01");
    tokio::runtime::Runtime::new().unwrap().block_on(async {
        let path = "/hullcast.v1.ContactService/QueryContacts";
        let (_, request) = scenes::two_boxes();
        let body = raw::frame(false, &prost::Message::encode_to_vec(&request));
        for headers in [&[("x-request-id", "mine"), ("traceparent", &context)][..], &[]] {
            raw::status_of(&address, path, headers, body.clone()).await;
        }
    });
    drop(child.stdin.take());
    let mut text = String::new();
    child.stderr.take().unwrap().read_to_string(&mut text).unwrap();
    assert!(child.wait().unwrap().success());
    let said: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    for message in ["answered", "ended"] {
        let mut spans: Vec<_> =
            said.iter().filter(|l| l["fields"]["message"] == message).map(|l| &l["span"]).collect();
        // A call may end after the next one, because its caller has the answer before the call is over.
        spans.sort_by_key(|span| span["id"].is_number());
        let [mine, other] = spans[..] else { panic!("{text}") };
        assert_eq!((&mine["id"], &mine["trace"]), (&"mine".into(), &trace.into()));
        assert!(other["id"].is_number() && other["trace"].is_null(), "{text}");
        assert!(
            [mine, other].iter().all(|span| span["method"] == "hullcast.v1.ContactService/QueryContacts")
        );
    }
}

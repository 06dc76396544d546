//! Registrations, queries and searches.

use std::time::Duration;

use hullcast::{proto::QueryContactsRequest, service::Limits, store::HullDefinition};
use hullcast_client::{Error, HullId, HullPart, HullRefused, pairs};
use tonic::Code;

use super::{builder, hull, hulls, ids};
use crate::support::{
    TestServer,
    scenes::{
        ALL, assert_same, box_points, expected, id, outputs, plain, register_request, round_points, scene,
        shapes, two_boxes,
    },
};

/// Catches a hull with another id than the server's, a record of another hull, and a deletion that is not
/// told from a hull that was not there.
#[tokio::test(flavor = "multi_thread")]
async fn hulls_are_registered_described_and_deleted() {
    let limits = Limits { max_hulls_per_request: 2, ..Limits::default() };
    let server = TestServer::with_limits(limits).await;
    let client = builder(&server).connect().await.unwrap();
    assert_eq!(client.info().await.unwrap().version, env!("CARGO_PKG_VERSION"));
    let simplified = HullDefinition {
        simplification: Some(hullcast::contact::Simplification {
            max_vertices: Some(20),
            max_deviation: None,
        }),
        planarity: Some(1e-5),
        ..plain(round_points(60, 3))
    };
    let all = [shapes(), vec![simplified]].concat();
    let hulls = hulls(&all);
    let ours: Vec<HullId> = all.iter().map(|shape| HullId(id(shape).try_into().unwrap())).collect();
    let mut twice = hulls.clone();
    twice.extend(hulls.clone());
    assert_eq!(client.missing(&ids(&twice)).await.unwrap(), (0..all.len()).collect::<Vec<_>>());
    assert_eq!(client.register(&twice).await.unwrap(), [&ours[..], &ours].concat());
    assert_eq!(client.put(&hulls).await.unwrap(), ours);
    let unknown = HullId([7; 32]);
    let asked = [&ours[..], &[unknown]].concat();
    assert_eq!(client.has(&asked).await.unwrap(), [vec![true; all.len()], vec![false]].concat());
    let records = client.get(&asked, &[HullPart::Info, HullPart::Vertices, HullPart::Faces]).await.unwrap();
    assert_eq!(records.last(), Some(&None));
    let cube = records[0].as_ref().unwrap();
    assert_eq!((cube.vertices.len(), cube.face_normals.len()), (24, 18));
    assert_eq!(cube.info.as_ref().unwrap().volume, 1.0);
    let deleted = client.delete(&[&asked[..], &ours[..1]].concat()).await.unwrap();
    assert_eq!(deleted, [vec![true; all.len()], vec![false, false]].concat());
}

/// Catches a description that is larger than a message and is not sent in parts.
#[tokio::test(flavor = "multi_thread")]
async fn descriptions_over_the_message_limit_come_in_parts() {
    let limits = Limits { max_message_bytes: 16 << 10, ..Limits::default() };
    let server = TestServer::with_limits(limits).await;
    let client = builder(&server).connect().await.unwrap();
    let many: Vec<_> = (0..20).map(|seed| plain(round_points(100, seed))).collect();
    let ids = client.register(&hulls(&many)).await.unwrap();
    let records = client.get(&ids, &[HullPart::Vertices]).await.unwrap();
    for (record, shape) in records.iter().zip(&many) {
        assert_eq!(record.as_ref().unwrap().vertices, shape.points.as_flattened());
    }
    assert_eq!(records.len(), 20);
}

/// Catches a refused hull that hides the faults of others, has the wrong place, or keeps good hulls from being
/// registered.
#[tokio::test(flavor = "multi_thread")]
async fn every_refused_hull_is_named() {
    let limits = Limits { max_hulls_per_request: 2, ..Limits::default() };
    let server = TestServer::with_limits(limits).await;
    let client = builder(&server).connect().await.unwrap();
    let flat = plain(box_points(1.0, 1.0, 0.0));
    let mut broken = plain(box_points(1.0, 1.0, 1.0));
    broken.points[5][1] = f64::NAN;
    let [good, other] = [&shapes()[0], &shapes()[1]].map(hull);
    let refused = client.register(&[good.clone(), hull(&flat), other.clone(), hull(&broken)]).await;
    let Err(Error::HullsRefused(refused)) = refused else { panic!("{refused:?}") };
    let places: Vec<_> = refused
        .iter()
        .map(|HullRefused { hull, field, index, reason, .. }| {
            (*hull, field.as_str(), *index, reason.as_str())
        })
        .collect();
    assert_eq!(places, [(1, "vertices", None, "COPLANAR"), (3, "vertices", Some(5), "NOT_FINITE")]);
    assert_eq!(client.has(&ids(&[good, other])).await.unwrap(), [true, true]);
}

/// Catches an answer that depends on how the request was split: by the server's limit of pairs, or because
/// an answer was too large for a message.
#[tokio::test(flavor = "multi_thread")]
async fn split_queries_give_the_same_answer() {
    let shapes = shapes();
    let mut request = scene(&shapes, 30, 2000, 5);
    request.outputs = outputs(&ALL);
    // An unusable body, whose pairs are INVALID.
    request.rotations[4..8].fill(0.0);
    let whole = expected(&request, &shapes);
    for limits in [
        Limits::default(),
        Limits { max_pairs_per_request: 300, ..Limits::default() },
        Limits { max_message_bytes: 64 << 10, ..Limits::default() },
    ] {
        let server = TestServer::with_limits(limits).await;
        let client = builder(&server).connect().await.unwrap();
        client.register(&hulls(&shapes)).await.unwrap();
        assert_same(&client.query(&request).await.unwrap(), &whole);
        let warm = QueryContactsRequest { warm_starts: whole.bases.clone(), ..request.clone() };
        assert_same(&client.query(&warm).await.unwrap(), &expected(&warm, &shapes));
    }
    assert_eq!(pairs(&whole).count(), 2000);
}

/// Asks for each output by itself. Catches an answer that the client refuses because its table of columns does
/// not fit the output.
#[tokio::test(flavor = "multi_thread")]
async fn every_output_is_accepted() {
    let server = TestServer::start().await;
    let client = builder(&server).connect().await.unwrap();
    let shapes = shapes();
    client.register(&hulls(&shapes)).await.unwrap();
    let request = scene(&shapes, 20, 100, 6);
    let masks = ALL.iter().map(|&output| vec![output as i32]).chain([vec![], vec![900], outputs(&ALL)]);
    for outputs in masks {
        let request = QueryContactsRequest { outputs, ..request.clone() };
        assert_same(&client.query(&request).await.unwrap(), &expected(&request, &shapes));
        let search = QueryContactsRequest { pairs: vec![], ..request };
        client.find_all(&search).await.unwrap();
    }
}

/// Catches a fault of the request that loses its code, reason or place, or that is repeated.
#[tokio::test(flavor = "multi_thread")]
async fn a_refusal_names_its_place() {
    let server = TestServer::start().await;
    let client = builder(&server).connect().await.unwrap();
    let (shapes, mut request) = two_boxes();
    client.register(&hulls(&shapes)).await.unwrap();
    request.pairs = vec![0, 1, 1, 9];
    for refused in [client.query(&request).await.map(drop), client.query_once(&request).await.map(drop)] {
        let Err(Error::Refused(refusal)) = refused else { panic!("{refused:?}") };
        assert_eq!((refusal.code, refusal.reason.as_str()), (Code::InvalidArgument, "INDEX_OUT_OF_RANGE"));
        assert_eq!((refusal.field.as_deref(), refusal.index), (Some("pairs"), Some(3)));
        assert_eq!(refusal.retry_after, None);
    }
    let refused = client.find(&request).await.map(drop);
    let Err(Error::Refused(refusal)) = refused else { panic!("{refused:?}") };
    assert_eq!((refusal.reason.as_str(), refusal.field.as_deref()), ("FIELD_NOT_ALLOWED", Some("pairs")));
}

/// Catches a hull that was lost and is not registered again, and hulls that are sent although none is missing.
#[tokio::test(flavor = "multi_thread")]
async fn missing_hulls_are_registered_when_told() {
    let server = TestServer::start().await;
    let client = builder(&server).connect().await.unwrap();
    let shapes = shapes();
    let (hulls, request) = (hulls(&shapes), scene(&shapes, 20, 100, 7));
    client.put(&hulls[1..]).await.unwrap();
    let lacking = client.query(&request).await.unwrap();
    assert_eq!(lacking.missing_hulls, [0]);
    assert_same(&client.query_registering(&request, &hulls[1..]).await.unwrap(), &lacking);
    assert_same(&client.query_registering(&request, &hulls).await.unwrap(), &expected(&request, &shapes));
}

/// Catches a search that loses a message, or whose pairs differ from those of a query.
#[tokio::test(flavor = "multi_thread")]
async fn a_search_gives_what_a_query_of_its_pairs_gives() {
    let server = TestServer::start().await;
    let client = builder(&server).connect().await.unwrap();
    let shapes = shapes();
    client.register(&hulls(&shapes)).await.unwrap();
    let request = scene(&shapes, 300, 0, 8);
    let whole = client.find_all(&request).await.unwrap();
    let query = QueryContactsRequest { pairs: whole.pairs.clone(), ..request.clone() };
    let mut same = client.query(&query).await.unwrap();
    assert!(whole.outcomes.len() > 10_000, "{} pairs", whole.outcomes.len());
    same.pairs.clone_from(&whole.pairs);
    assert_same(&whole, &same);
    let mut search = client.find(&request).await.unwrap();
    let (mut messages, mut found) = (0, 0);
    while let Some(message) = search.next().await.unwrap() {
        assert_eq!(message.request_id, request.request_id);
        (messages, found) = (messages + 1, found + message.outcomes.len());
    }
    assert_eq!(found, whole.outcomes.len());
    assert!(messages > 1);
    assert_eq!(search.next().await, Ok(None), "the end stays the end");
}

/// All pairs that the server accepts are held at a gate, so it refuses another query. Catches a query that is
/// not repeated when the server is busy, one that is repeated although the caller does not want it, and one
/// that is repeated beyond its timeout.
#[tokio::test(flavor = "multi_thread")]
async fn a_busy_server_is_asked_again() {
    let limits = Limits { max_pairs_per_request: 10, max_pairs_in_flight: 10, ..Limits::default() };
    let server = TestServer::with_limits(limits).await;
    let shapes = shapes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let request = scene(&shapes, 20, 10, 9);
    server.app.engine().test_controls().allow(0);
    let mut contacts = server.contacts();
    let occupying = tokio::spawn({
        let request = request.clone();
        async move { contacts.query_contacts(request).await }
    });
    server.until("hullcast_pairs_in_flight", 10.0).await;
    let client = builder(&server).connect().await.unwrap();
    let sheds = r#"hullcast_sheds_total{reason="pairs_in_flight"}"#;
    let is_busy = |error: &Error| {
        matches!(error, Error::Refused(refusal) if refusal.reason == "TOO_BUSY")
            && error.retry_after().is_some()
    };
    let unwilling = builder(&server).retries(false).connect().await.unwrap();
    for refused in [client.query_once(&request).await, unwilling.query(&request).await] {
        assert!(refused.as_ref().is_err_and(is_busy), "{refused:?}");
    }
    assert_eq!(server.metric(sheds), 2.0);
    let short = builder(&server).timeout(Some(Duration::from_millis(200))).connect().await.unwrap();
    let refused = short.query(&request).await.unwrap_err();
    assert!(is_busy(&refused) || refused == Error::TimedOut, "{refused:?}");
    let shed = server.metric(sheds);
    let patient = tokio::spawn({
        let (client, request) = (client.clone(), request.clone());
        async move { client.query(&request).await }
    });
    while server.metric(sheds) < shed + 2.0 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    server.app.engine().test_controls().open();
    occupying.await.unwrap().unwrap();
    assert_same(&patient.await.unwrap().unwrap(), &expected(&request, &shapes));
}

/// Catches a call that waits beyond the client's timeout.
#[tokio::test(flavor = "multi_thread")]
async fn a_call_ends_at_its_timeout() {
    let server = TestServer::start().await;
    let (shapes, request) = two_boxes();
    let client = builder(&server).timeout(Some(Duration::from_millis(100))).connect().await.unwrap();
    builder(&server).connect().await.unwrap().register(&hulls(&shapes)).await.unwrap();
    server.app.engine().test_controls().allow(0);
    let late = client.query(&request).await.unwrap_err();
    let by_the_server = matches!(&late, Error::Refused(refusal) if refusal.reason == "DEADLINE_EXCEEDED");
    assert!(late == Error::TimedOut || by_the_server, "{late:?}");
    server.app.engine().test_controls().open();
}

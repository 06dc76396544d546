//! Every error with its code, its reason, its field and its index.

use std::{sync::atomic::Ordering, time::Duration};

use bytes::Bytes;
use hullcast::{
    budget::Caller,
    proto::{
        Accuracy, GetHullsRequest, HasHullsRequest, HullDefinition, ListHullsRequest, Output,
        QueryContactsRequest, RegisterHullsRequest,
    },
    service::Limits,
};
use prost::Message;
use tonic::{Code, Status};
use tonic_types::StatusExt;

use crate::support::{
    Setup, TestServer, invalid,
    raw::{frame, status_of},
    refusal, refused,
    scenes::{id, register_request, scene, shapes, two_boxes},
    store::FaultyStore,
};

const QUERY: &str = "/hullcast.v1.ContactService/QueryContacts";
const STREAM: &str = "/hullcast.v1.ContactService/StreamContacts";

/// Sends every case unary and in a stream. Catches a malformed request that is answered, and a
/// refusal that does not name the field.
#[tokio::test(flavor = "multi_thread")]
async fn malformed_queries_name_field_and_index() {
    let (shapes, good) = two_boxes();
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    server.contacts().query_contacts(good.clone()).await.unwrap();

    type Spoil = fn(&mut QueryContactsRequest);
    let with_accuracy = |spoil: fn(&mut Accuracy)| -> QueryContactsRequest {
        let mut request = good.clone();
        spoil(request.accuracy.get_or_insert_default());
        request
    };
    let plain: [(Spoil, &str, &str); 21] = [
        (|r| r.hull_ids[0].truncate(31), "MALFORMED_ID", "hull_ids[0]"),
        (|r| r.hull_ids.push(vec![]), "MALFORMED_ID", "hull_ids[1]"),
        (|r| r.hull_ids.push(vec![0; 33]), "MALFORMED_ID", "hull_ids[1]"),
        (|r| r.hull_ids.push(r.hull_ids[0].clone()), "DUPLICATE_HULL", "hull_ids[1]"),
        (|r| r.hull_ids.clear(), "INDEX_OUT_OF_RANGE", "body_hulls[0]"),
        (|r| r.body_hulls[1] = 1, "INDEX_OUT_OF_RANGE", "body_hulls[1]"),
        (|r| r.body_hulls[1] = u32::MAX, "INDEX_OUT_OF_RANGE", "body_hulls[1]"),
        (|r| r.body_hulls.push(0), "LENGTH_MISMATCH", "positions"),
        (|r| r.positions.push(0.0), "LENGTH_MISMATCH", "positions"),
        (|r| r.positions.clear(), "LENGTH_MISMATCH", "positions"),
        (|r| r.rotations.truncate(7), "LENGTH_MISMATCH", "rotations"),
        (|r| r.pairs.push(0), "LENGTH_MISMATCH", "pairs"),
        (|r| r.pairs[1] = 2, "INDEX_OUT_OF_RANGE", "pairs[1]"),
        (|r| r.warm_starts = vec![0; 5], "LENGTH_MISMATCH", "warm_starts"),
        (|r| r.warm_starts = vec![0; 12], "LENGTH_MISMATCH", "warm_starts"),
        (|r| r.margin = -1e-300, "VALUE_OUT_OF_RANGE", "margin"),
        (|r| r.margin = f64::NAN, "VALUE_OUT_OF_RANGE", "margin"),
        (|r| r.margin = f64::NEG_INFINITY, "VALUE_OUT_OF_RANGE", "margin"),
        (|r| r.worlds = vec![0, 0], "FIELD_NOT_ALLOWED", "worlds"),
        (|r| r.groups = vec![0, 0], "FIELD_NOT_ALLOWED", "groups"),
        (|r| r.ignored_groups = vec![0, 0], "FIELD_NOT_ALLOWED", "ignored_groups"),
    ];
    let mut cases: Vec<_> = plain
        .into_iter()
        .map(|(spoil, reason, field)| {
            let mut request = good.clone();
            spoil(&mut request);
            (request, invalid(reason, field))
        })
        .collect();
    let tolerance = "accuracy.relative_tolerance";
    let angle = "accuracy.feature_angle";
    type SpoilAccuracy = fn(&mut Accuracy);
    let accuracies: [(SpoilAccuracy, &str, &str); 8] = [
        (|a| a.solver = 3, "UNKNOWN_VALUE", "accuracy.solver"),
        (|a| a.solver = -1, "UNKNOWN_VALUE", "accuracy.solver"),
        (|a| a.relative_tolerance = -0.1, "VALUE_OUT_OF_RANGE", tolerance),
        (|a| a.relative_tolerance = 1.0 + f64::EPSILON, "VALUE_OUT_OF_RANGE", tolerance),
        (|a| a.relative_tolerance = f64::NAN, "VALUE_OUT_OF_RANGE", tolerance),
        (|a| a.feature_angle = Some(-1e-9), "VALUE_OUT_OF_RANGE", angle),
        (|a| a.feature_angle = Some(0.5 + f64::EPSILON), "VALUE_OUT_OF_RANGE", angle),
        (|a| a.feature_angle = Some(f64::NAN), "VALUE_OUT_OF_RANGE", angle),
    ];
    for (spoil, reason, field) in accuracies {
        cases.push((with_accuracy(spoil), invalid(reason, field)));
    }

    assert_eq!(cases.len(), 29);
    for (request, expected) in cases {
        let unary = server.contacts().query_contacts(request.clone()).await.unwrap_err();
        assert_eq!(refusal(&unary), expected);
        // The request before the error is answered; the error ends the stream.
        let requests = futures_util::stream::iter([good.clone(), request, good.clone()]);
        let mut stream = server.contacts().stream_contacts(requests).await.unwrap().into_inner();
        assert!(stream.message().await.unwrap().is_some());
        let streamed = stream.message().await.unwrap_err();
        assert_eq!(refusal(&streamed), expected);
        assert_eq!(stream.message().await.ok().flatten(), None);
    }
    // Values at the limits of the allowed ranges.
    let edges: [fn(&mut Accuracy); 4] = [
        |a| a.relative_tolerance = 1.0,
        |a| a.feature_angle = Some(0.5),
        |a| a.feature_angle = Some(0.0),
        |a| a.max_points = u32::MAX,
    ];
    for edge in edges {
        server.contacts().query_contacts(with_accuracy(edge)).await.unwrap();
    }
    let touching = QueryContactsRequest { margin: -0.0, ..good.clone() };
    server.contacts().query_contacts(touching).await.unwrap();
}

/// Catches a malformed id, path or token of the hull service that is treated as an absent hull.
#[tokio::test(flavor = "multi_thread")]
async fn malformed_hull_requests_name_field_and_index() {
    let server = TestServer::start().await;
    let mut hulls = server.hulls();
    let ids = vec![vec![0; 32], vec![0; 31]];
    let expected = invalid("MALFORMED_ID", "ids[1]");
    let get = GetHullsRequest { ids: ids.clone(), field_mask: None };
    assert_eq!(refusal(&hulls.get_hulls(get).await.unwrap_err()), expected);
    let has = HasHullsRequest { ids: ids.clone() };
    assert_eq!(refusal(&hulls.has_hulls(has).await.unwrap_err()), expected);
    let delete = hullcast::proto::DeleteHullsRequest { ids };
    assert_eq!(refusal(&hulls.delete_hulls(delete).await.unwrap_err()), expected);
    let paths = ["info", "vertices", "faces", "colour"].map(String::from).to_vec();
    let mask = Some(prost_types::FieldMask { paths });
    let get = GetHullsRequest { ids: vec![], field_mask: mask };
    let status = hulls.get_hulls(get).await.unwrap_err();
    assert_eq!(refusal(&status), invalid("UNKNOWN_PATH", "field_mask.paths[3]"));
    for token in ["x", "00", &"g".repeat(64)] {
        let list = ListHullsRequest { page_size: 1, page_token: token.into() };
        let status = hulls.list_hulls(list).await.unwrap_err();
        assert_eq!(refusal(&status), invalid("MALFORMED_PAGE_TOKEN", "page_token"));
        let shown = &token[..token.len().min(40)];
        assert!(status.message().contains(&format!("got \"{shown}\"")), "{status}");
        assert!(status.message().contains(&format!("({} byte", token.len())), "{status}");
    }
}

/// Catches an error of the transport (message too large, method unknown, compressed, not protobuf)
/// that reaches the caller with the transport's own code and without details.
#[tokio::test(flavor = "multi_thread")]
async fn the_transports_errors_have_details_too() {
    let limits = Limits { max_message_bytes: 2000, ..Limits::default() };
    let server = TestServer::with_limits(limits).await;
    let too_large = QueryContactsRequest { positions: vec![0.0; 300], ..Default::default() };
    let expected = invalid("MESSAGE_TOO_LARGE", "");
    let status = server.contacts().query_contacts(too_large.clone()).await.unwrap_err();
    assert_eq!(refusal(&status), expected);
    let stream = futures_util::stream::iter([too_large]);
    let mut stream = server.contacts().stream_contacts(stream).await.unwrap().into_inner();
    assert_eq!(refusal(&stream.message().await.unwrap_err()), expected);
    let hull = HullDefinition { vertices: vec![0.0; 300], ..Default::default() };
    let status = server.hulls().register_hulls(RegisterHullsRequest { hulls: vec![hull] }).await.unwrap_err();
    assert_eq!(refusal(&status), expected);

    let message = two_boxes().1.encode_to_vec();
    let unknown = refused(Code::Unimplemented, "UNKNOWN_METHOD", "");
    let compressed = refused(Code::Unimplemented, "COMPRESSION_UNSUPPORTED", "");
    let malformed = invalid("MALFORMED_MESSAGE", "");
    let gzip: &[(&str, &str)] = &[("grpc-encoding", "gzip")];
    let ok = frame(false, &message);
    let cases = [
        ("/hullcast.v1.ContactService/Nothing", &[][..], ok.clone(), &unknown),
        ("/nowhere.Nothing/Nothing", &[], ok.clone(), &unknown),
        (QUERY, gzip, frame(true, &message), &compressed),
        (STREAM, gzip, frame(true, &message), &compressed),
        (QUERY, &[], frame(true, &message), &malformed),
        (STREAM, &[], frame(true, &message), &malformed),
        (QUERY, &[], frame(true, &vec![7; 40_000]), &malformed),
        (QUERY, &[], frame(false, &message[1..]), &malformed),
        (QUERY, &[], Bytes::new(), &malformed),
        (QUERY, &[], ok.slice(..ok.len() - 1), &malformed),
        (STREAM, &[], frame(false, &message[1..]), &malformed),
    ];
    for (path, headers, body, expected) in cases {
        let (status, answered) = status_of(&server.address, path, headers, body).await;
        assert_eq!(&refusal(&status), expected, "{path} {headers:?} {status:?}");
        if headers == gzip {
            // The protocol requires the server to name the encodings that it accepts.
            assert!(answered.contains_key("grpc-accept-encoding"), "{answered:?}");
        }
    }
}

/// Catches a deadline that the server ignores, and one that is reported as CANCELLED. The test
/// speaks gRPC by hand, because a client enforces its own deadline before the server's answer
/// arrives.
#[tokio::test(flavor = "multi_thread")]
async fn an_expired_deadline_is_deadline_exceeded() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    // More than a millisecond of work on any machine.
    let request = scene(&shapes(), 1000, 100_000, 1);
    let body = frame(false, &request.encode_to_vec());
    let expected = refused(Code::DeadlineExceeded, "DEADLINE_EXCEEDED", "");
    for path in [QUERY, STREAM] {
        let (status, _) = status_of(&server.address, path, &[("grpc-timeout", "1m")], body.clone()).await;
        assert_eq!(refusal(&status), expected, "{path}");
    }
    // A sufficient deadline must change nothing.
    let small = frame(false, &scene(&shapes(), 2, 1, 1).encode_to_vec());
    let (status, _) = status_of(&server.address, QUERY, &[("grpc-timeout", "60S")], small).await;
    assert_eq!(status.code(), Code::Ok);
}

/// Catches a busy server that accepts more work, and a refusal without the time after which to
/// retry.
#[tokio::test(flavor = "multi_thread")]
async fn too_busy_is_unavailable_with_a_pushback() {
    // No part of the capacity is reserved for other callers.
    let limits =
        Limits { max_pairs_per_request: 100, max_pairs_in_flight: 100, shares: false, ..Limits::default() };
    let server = TestServer::with_limits(limits).await;
    let (shapes, request) = two_boxes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let outputs = hullcast::batch::Outputs::default();
    let place = server.app.engine().admit(100, outputs, &Caller::alone()).unwrap();
    let status = server.contacts().query_contacts(request.clone()).await.unwrap_err();
    assert_unavailable(&status, "TOO_BUSY");
    let stream = futures_util::stream::iter([request.clone()]);
    let mut stream = server.contacts().stream_contacts(stream).await.unwrap().into_inner();
    assert_unavailable(&stream.message().await.unwrap_err(), "TOO_BUSY");
    // A request without pairs counts as work too.
    let empty = QueryContactsRequest::default();
    assert_unavailable(&server.contacts().query_contacts(empty.clone()).await.unwrap_err(), "TOO_BUSY");
    drop(place);
    server.contacts().query_contacts(request).await.unwrap();
    server.contacts().query_contacts(empty).await.unwrap();
    // All capacity must have been returned.
    drop(server.app.engine().admit(100, outputs, &Caller::alone()).unwrap());
}

fn assert_unavailable(status: &Status, reason: &str) {
    assert_eq!(refusal(status), refused(Code::Unavailable, reason, ""));
    let retry = status.get_error_details().retry_info().expect("RetryInfo").retry_delay.unwrap();
    assert!(retry > Duration::ZERO);
    let pushback = status.metadata().get("grpc-retry-pushback-ms").expect("the trailer");
    assert_eq!(pushback.to_str().unwrap(), retry.as_millis().to_string());
}

/// Catches an answer that exceeds the message limit, in three cases: known before the computation
/// (from the size of the columns), found during it (from the points), or found only at the end.
#[tokio::test(flavor = "multi_thread")]
async fn an_answer_that_would_be_too_large_is_refused() {
    let (shapes, mut request) = two_boxes();
    request.pairs = [0, 1].repeat(400);
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let size = server.contacts().query_contacts(request.clone()).await.unwrap().get_ref().encoded_len();

    let expected = invalid("RESPONSE_TOO_LARGE", "");
    // The columns of 400 pairs without points take 400 * 62 bytes.
    for (limit, computed) in [(20_000, false), (30_000, true), (size - 1, true)] {
        let server = TestServer::with_limits(Limits { max_message_bytes: limit, ..Limits::default() }).await;
        server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
        let status = server.contacts().query_contacts(request.clone()).await.unwrap_err();
        assert_eq!(refusal(&status), expected, "{limit}");
        assert_eq!(server.app.engine().pairs_computed() > 0, computed, "{limit}");
        // A request for fewer pairs must be answered; the client halves its requests in this case.
        let mut half = request.clone();
        half.pairs.truncate(request.pairs.len() / 4);
        half.outputs = vec![Output::Outcome as i32];
        server.contacts().query_contacts(half).await.unwrap();
    }
    let server = TestServer::with_limits(Limits { max_message_bytes: size, ..Limits::default() }).await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    server.contacts().query_contacts(request).await.unwrap();
}

/// Catches an unreadable store that is reported as a missing hull: the client would register the hull again
/// instead of retrying.
#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_cannot_be_read_is_unavailable_not_unknown() {
    let store = FaultyStore::new();
    let (shapes, request) = two_boxes();
    let server = Setup { store: store.clone(), ..Setup::default() }.start().await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    store.unreadable.store(true, Ordering::SeqCst);
    // A cached hull needs no store.
    let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
    assert!(answer.missing_hulls.is_empty());

    let fresh = Setup { store: store.clone(), ..Setup::default() }.start().await;
    let answer = fresh.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
    assert_eq!((&answer.outcomes[..], &answer.flags[..]), (&[4][..], &[32][..]), "HULL_UNAVAILABLE");
    assert_eq!(answer.missing_hulls, [0]);
    let mut hulls = fresh.hulls();
    let unavailable = |status: Status| assert_unavailable(&status, "STORE_UNAVAILABLE");
    unavailable(hulls.register_hulls(register_request(&shapes)).await.unwrap_err());
    let ids = vec![id(&shapes[0])];
    unavailable(hulls.get_hulls(GetHullsRequest { ids: ids.clone(), field_mask: None }).await.unwrap_err());
    unavailable(hulls.has_hulls(HasHullsRequest { ids: ids.clone() }).await.unwrap_err());
    unavailable(hulls.list_hulls(ListHullsRequest::default()).await.unwrap_err());
    let delete = hullcast::proto::DeleteHullsRequest { ids };
    unavailable(hulls.delete_hulls(delete).await.unwrap_err());

    store.unreadable.store(false, Ordering::SeqCst);
    let answer = fresh.contacts().query_contacts(request).await.unwrap().into_inner();
    assert!(answer.missing_hulls.is_empty(), "an error is not cached");
}

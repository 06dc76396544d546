//! Answers that their callers do not read, and callers that take more than their share.

use std::time::Duration;

use hullcast::{
    budget::Part,
    proto::QueryContactsRequest,
    service::{Limits, ServerOptions},
};
use prost::Message;
use tonic::{Code, Status};

use crate::support::{
    Setup, TestServer, raw, refusal, refused,
    scenes::{ALL, outputs, register_request, two_boxes},
};

const QUERY: &str = "/hullcast.v1.ContactService/QueryContacts";
const FIND: &str = "/hullcast.v1.ContactService/FindContacts";
const INFO: &str = "/hullcast.v1.ServerService/GetServerInfo";
const CUTS: &str = r#"hullcast_cuts_total{reason="answer_not_read"}"#;
const CONNECTIONS: &str = r#"hullcast_memory_bytes{part="connections"}"#;
const ANSWERS: &str = r#"hullcast_memory_bytes{part="answers"}"#;

/// A server that gives its callers half a second to read an answer.
async fn impatient() -> TestServer {
    let options = ServerOptions { answer_time: Duration::from_millis(500), ..ServerOptions::default() };
    Setup { options, ..Setup::default() }.start().await
}

/// The answer must count in the budget while it waits, and the call must be cut off in the end.
/// Catches an answer that is held, outside the budget, for as long as its caller does not read it.
#[tokio::test(flavor = "multi_thread")]
async fn an_answer_that_is_not_read_is_cut() {
    let server = impatient().await;
    for path in [QUERY, FIND] {
        let request = match path {
            QUERY => many_contacts(&server, 4000).await,
            _ => row(&server, 4000).await,
        };
        let body = raw::Body::Whole(raw::frame(false, &request.encode_to_vec()));
        let mut client = raw::connect_from("127.0.0.1", &server.address, 20_000).await;
        let before = server.metric(CUTS);
        let unread = client.send_request(raw::call(path, &[], body)).await.unwrap();
        assert!(Status::from_header_map(unread.headers()).is_none());
        while server.metric(ANSWERS) < 200_000.0 {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        server.until(CUTS, before + 1.0).await;
        server.until(ANSWERS, 0.0).await;
        server.until("hullcast_requests_in_flight", 0.0).await;
        // The connection's other calls go on.
        let (status, _) = raw::status_on(&mut client, INFO, &[], raw::frame(false, &[])).await;
        assert_eq!(status.code(), Code::Ok);
        drop(unread);
    }
}

/// The transport takes the end of an answer that fits into one piece while the peer has read one byte of it.
/// Catches such an answer, small or large, that nothing ends, and whose memory nothing counts.
#[tokio::test(flavor = "multi_thread")]
async fn an_answer_of_one_piece_is_cut_too() {
    let server = impatient().await;
    let query = raw::frame(false, &many_contacts(&server, 100).await.encode_to_vec());
    for (cuts, (path, message)) in [(INFO, raw::frame(false, &[])), (QUERY, query)].into_iter().enumerate() {
        let before = server.metric(CONNECTIONS);
        let mut client = raw::connect_from("127.0.0.1", &server.address, 1).await;
        let idle = server.metric(CONNECTIONS);
        let unread = client.send_request(raw::call(path, &[], raw::Body::Whole(message))).await.unwrap();
        assert!(Status::from_header_map(unread.headers()).is_none());
        // The memory counts until the call is cut.
        assert!(server.metric(CONNECTIONS) >= idle + 32_768.0, "{path}");
        assert_eq!(server.metric(CUTS), cuts as f64);
        server.until(CUTS, 1.0 + cuts as f64).await;
        server.until(ANSWERS, 0.0).await;
        drop(unread);
        drop(client);
        server.until(CONNECTIONS, before).await;
    }
}

/// Catches a deadline that no longer applies after the first byte of the answer.
#[tokio::test(flavor = "multi_thread")]
async fn the_deadline_holds_while_the_answer_is_read() {
    let server = TestServer::start().await;
    let request = many_contacts(&server, 4000).await;
    let body = raw::Body::Whole(raw::frame(false, &request.encode_to_vec()));
    let mut client = raw::connect_from("127.0.0.1", &server.address, 20_000).await;
    let call = raw::call(QUERY, &[("grpc-timeout", "3S")], body);
    let _unread = client.send_request(call).await.unwrap();
    server.until(r#"hullcast_cuts_total{reason="deadline"}"#, 1.0).await;
    server.until(ANSWERS, 0.0).await;
}

/// One address takes all of its share: calls from another address must still be answered, and two
/// connections from the first address must count as one caller. Catches one caller that takes all
/// memory.
#[tokio::test(flavor = "multi_thread")]
async fn a_caller_takes_no_more_than_its_share() {
    let limits = Limits { max_memory_bytes: 1 << 30, ..Limits::default() };
    let server = TestServer::with_limits(limits).await;
    // Messages that never end: each holds the memory of its bytes that have arrived.
    let hold = |from: &'static str| {
        let address = server.address.clone();
        async move {
            let part = raw::frame(false, &vec![0; 60 << 20]).slice(..56 << 20);
            let call = raw::call(QUERY, &[], raw::Body::Unfinished(part));
            let mut client = raw::connect_from(from, &address, 1 << 20).await;
            let response = client.send_request(call).await.unwrap();
            raw::status_in(response).await
        }
    };
    let mut greedy: Vec<_> = (0..12).map(|_| tokio::spawn(hold("127.0.0.2"))).collect();
    // Some of its calls are refused: two connections from one address are one caller.
    let (status, _, rest) = futures_util::future::select_all(greedy.drain(..)).await;
    assert_eq!(refusal(&status.unwrap()), refused(Code::Unavailable, "TOO_BUSY", ""));
    assert!(server.app.memory().used_by(Part::Arriving) <= 1 << 29, "half of the budget");
    let request = many_contacts(&server, 2000).await;
    let frame = raw::frame(false, &request.encode_to_vec());
    let mut bystander = raw::connect_from("127.0.0.3", &server.address, 1 << 20).await;
    let (status, _) = raw::status_on(&mut bystander, QUERY, &[], frame).await;
    assert_eq!(status.code(), Code::Ok, "{status}");
    rest.iter().for_each(tokio::task::JoinHandle::abort);
    server.until(r#"hullcast_memory_bytes{part="arriving"}"#, 0.0).await;
}

/// Two overlapping boxes, as the same pair many times, with every output.
async fn many_contacts(server: &TestServer, pairs: usize) -> QueryContactsRequest {
    let (shapes, mut request) = two_boxes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    request.pairs = [0, 1].repeat(pairs);
    request.outputs = outputs(&ALL);
    request
}

/// A row of boxes, each of which overlaps the next one.
async fn row(server: &TestServer, bodies: usize) -> QueryContactsRequest {
    let mut request = many_contacts(server, 0).await;
    request.body_hulls = vec![0; bodies];
    request.positions = (0..bodies).flat_map(|body| [0.9 * body as f64, 0.0, 0.0]).collect();
    request.rotations = [0.0, 0.0, 0.0, 1.0].repeat(bodies);
    request
}

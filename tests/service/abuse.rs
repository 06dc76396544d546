//! Abuse by peers, on the real socket: malformed messages, held connections and floods of frames.

use std::{collections::BTreeMap, time::Duration};

use bytes::Bytes;
use futures_util::future::join_all;
use hullcast::{
    proto::{GetHullsRequest, GetServerInfoRequest},
    service::Limits,
};
use prost::Message;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};
use tonic::Code;

use crate::support::{
    Setup, TestServer, invalid, raw, refusal, refused,
    scenes::{Random, id, plain, register_request, round_points, two_boxes},
};

const INFO: &str = "/hullcast.v1.ServerService/GetServerInfo";
const QUERY: &str = "/hullcast.v1.ContactService/QueryContacts";

async fn is_answered(server: &TestServer) {
    let channel = crate::support::channel(&server.address).await;
    let mut info = hullcast::proto::server_service_client::ServerServiceClient::new(channel);
    info.get_server_info(GetServerInfoRequest {}).await.unwrap();
}

/// Sends messages with flipped, cut, repeated and inserted bytes to every method, through the whole
/// stack. Catches bytes that end the server, or that it reports as its own fault.
#[tokio::test(flavor = "multi_thread")]
async fn spoilt_messages_are_refused_or_answered() {
    const EACH: u32 = 400;
    let server = TestServer::start().await;
    let (shapes, query) = two_boxes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let seeds = [query.encode_to_vec(), register_request(&shapes).encode_to_vec(), query.hull_ids[0].clone()];
    let mut random = Random::new(1);
    let mut next = move |below: usize| random.below(below.max(1));
    let mut client = raw::connect(&server.address).await;
    let mut codes = BTreeMap::new();
    let methods = [
        "ContactService/QueryContacts",
        "ContactService/StreamContacts",
        "HullService/RegisterHulls",
        "HullService/GetHulls",
        "HullService/HasHulls",
        "HullService/ListHulls",
        "HullService/DeleteHulls",
        "ServerService/GetServerInfo",
    ];
    for method in methods {
        let path = format!("/hullcast.v1.{method}");
        for _ in 0..EACH {
            let mut message = seeds[next(seeds.len())].clone();
            for _ in 0..=next(6) {
                let at = next(message.len());
                match next(5) {
                    0 => message.truncate(at),
                    1 => message.extend_from_within(at..),
                    2 => message.insert(at, next(256) as u8),
                    _ if !message.is_empty() => message[at] ^= 1 << next(8),
                    _ => message.push(next(256) as u8),
                }
            }
            let mut frame = raw::frame(false, &message).to_vec();
            if next(10) == 0 {
                // The frame's head is damaged too: another length or another kind.
                let at = next(5);
                frame[at] ^= 1 << next(8);
            }
            let timeout = [("grpc-timeout", "5S")];
            let call = raw::status_on(&mut client, &path, &timeout, frame.clone().into());
            let answered = tokio::time::timeout(Duration::from_secs(60), call).await;
            let (status, _) = answered.unwrap_or_else(|_| panic!("{method} is silent about {frame:?}"));
            *codes.entry(format!("{:?}", status.code())).or_insert(0) += 1;
        }
    }
    assert_eq!(codes.values().sum::<u32>(), EACH * methods.len() as u32);
    assert!(codes["InvalidArgument"] > 100 && codes["Ok"] > 100, "{codes:?}");
    let known = ["InvalidArgument", "Ok", "Unimplemented", "DeadlineExceeded"];
    assert!(codes.keys().all(|code| known.contains(&code.as_str())), "{codes:?}");
    is_answered(&server).await;
}

/// Sends 16 MiB of very small elements to every method with a repeated field. Catches elements that
/// are decoded before they are counted, and a refusal that does not name the field.
#[tokio::test(flavor = "multi_thread")]
async fn messages_of_empty_elements_are_refused_by_name() {
    const ELEMENTS: usize = 8 << 20;
    let server = TestServer::start().await;
    let empty = |tag: u8| [tag << 3 | 2, 0].repeat(ELEMENTS);
    let mask = [&[0x12, 0x80, 0x80, 0x80, 0x08][..], &empty(1)].concat();
    let cases = [
        ("HullService/RegisterHulls", empty(1), invalid("TOO_MANY_HULLS", "hulls")),
        ("HullService/GetHulls", empty(1), invalid("TOO_MANY_HULLS", "ids")),
        ("HullService/GetHulls", mask, invalid("TOO_MANY_PATHS", "field_mask.paths")),
        ("HullService/HasHulls", empty(1), invalid("TOO_MANY_HULLS", "ids")),
        ("HullService/DeleteHulls", empty(1), invalid("TOO_MANY_HULLS", "ids")),
        ("ContactService/QueryContacts", empty(3), invalid("TOO_MANY_HULLS", "hull_ids")),
        ("ContactService/FindContacts", empty(3), invalid("TOO_MANY_HULLS", "hull_ids")),
        ("ContactService/StreamContacts", empty(3), invalid("TOO_MANY_HULLS", "hull_ids")),
        (
            "ContactService/QueryContacts",
            [13 << 3, 1].repeat(ELEMENTS),
            invalid("TOO_MANY_OUTPUTS", "outputs"),
        ),
    ];
    for (method, message, expected) in cases {
        let path = format!("/hullcast.v1.{method}");
        let (status, _) = raw::status_of(&server.address, &path, &[], raw::frame(false, &message)).await;
        assert_eq!(refusal(&status), expected, "{method}");
    }
    is_answered(&server).await;
}

/// A request that names one large hull thousands of times must be refused before its answer is
/// built; a few repetitions must be answered. Catches an answer that takes all memory.
#[tokio::test(flavor = "multi_thread")]
async fn a_hull_that_is_named_many_times_takes_no_memory() {
    let server = TestServer::start().await;
    let shape = plain(round_points(2000, 1));
    server.hulls().register_hulls(register_request(std::slice::from_ref(&shape))).await.unwrap();
    let mask = prost_types::FieldMask { paths: vec!["info".into(), "vertices".into(), "faces".into()] };
    let request = |times| GetHullsRequest { ids: vec![id(&shape); times], field_mask: Some(mask.clone()) };
    let status = server.hulls().get_hulls(request(4000)).await.unwrap_err();
    assert_eq!(refusal(&status), invalid("RESPONSE_TOO_LARGE", ""));
    let answer = server.hulls().get_hulls(request(50)).await.unwrap().into_inner();
    assert_eq!(answer.hulls.len(), 50);
    assert!(answer.hulls.iter().all(|hull| *hull == answer.hulls[0] && hull.vertices.len() == 6000));
    server.until_calls_hold_nothing().await;
}

/// Catches a peer that holds a connection while it sends nothing, or half of the HTTP/2 preface.
#[tokio::test(flavor = "multi_thread")]
async fn who_does_not_greet_is_cut_off() {
    let mut setup = Setup::default();
    setup.options.greeting = Duration::from_millis(50);
    let server = setup.start().await;
    for said in [&b""[..], b"P", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"] {
        let mut stream = TcpStream::connect(&server.address).await.unwrap();
        stream.write_all(said).await.unwrap();
        let mut rest = Vec::new();
        // The server ends the connection by a close or a reset.
        let _ = stream.read_to_end(&mut rest).await;
    }
    // A peer that completed the handshake may stay idle.
    let (mut client, connection) = raw::connection(&server.address).await;
    tokio::spawn(connection);
    tokio::time::sleep(Duration::from_millis(200)).await;
    let (status, _) = raw::status_on(&mut client, INFO, &[], raw::frame(false, &[])).await;
    assert_eq!(status.code(), Code::Ok);
}

/// Catches a request that never ends and is held for any deadline that its client sets.
#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_never_ends_is_cut_off() {
    let server = TestServer::with_limits(Limits { max_deadline_seconds: 1, ..Limits::default() }).await;
    for headers in [&[][..], &[("grpc-timeout", "9H")]] {
        let mut client = raw::connect(&server.address).await;
        let half = raw::Body::Unfinished(raw::frame(false, &[0; 1000]).slice(..500));
        let response = client.send_request(raw::call(QUERY, headers, half)).await.unwrap();
        let status = tonic::Status::from_header_map(response.headers()).unwrap();
        assert_eq!(refusal(&status), refused(Code::DeadlineExceeded, "DEADLINE_EXCEEDED", ""));
    }
    server.until("hullcast_request_bytes_in_flight", 0.0).await;
}

/// Up to one caller's half of the limit, half-sent requests are held; the first byte past it must be refused, and the bytes
/// must be released when the requests end. Catches half-sent requests that take unbounded memory.
#[tokio::test(flavor = "multi_thread")]
async fn bytes_of_requests_are_bounded_over_all_calls() {
    let limits =
        Limits { max_message_bytes: 100_000, max_request_bytes_in_flight: 400_000, ..Limits::default() };
    let server = TestServer::with_limits(limits).await;
    let send = |bytes: usize| {
        let address = server.address.clone();
        tokio::spawn(async move {
            let part = raw::frame(false, &vec![0; 100_000]).slice(..bytes);
            let request = raw::call(QUERY, &[], raw::Body::Unfinished(part));
            raw::connect(&address).await.send_request(request).await
        })
    };
    let held = [send(100_000), send(100_000)];
    // The memory that each call takes at its start covers the first 4 KiB.
    server.until("hullcast_request_bytes_in_flight", 2.0 * (100_000.0 - 4096.0)).await;
    let refused_call = send(6).await.unwrap().unwrap();
    let status = tonic::Status::from_header_map(refused_call.headers()).unwrap();
    assert_eq!(refusal(&status), refused(Code::Unavailable, "TOO_BUSY", ""));
    assert!(held.iter().all(|call| !call.is_finished()));
    held.into_iter().for_each(|call| call.abort());
    server.until("hullcast_request_bytes_in_flight", 0.0).await;
    is_answered(&server).await;
}

/// At the limit all connections are served, one more is closed, and the place of a closed
/// connection can be used again. Catches an unbounded number of connections.
#[tokio::test(flavor = "multi_thread")]
async fn connections_at_their_limit_and_one_past() {
    // One of the three is the test server's own connection.
    let server = TestServer::with_limits(Limits { max_connections: 3, ..Limits::default() }).await;
    let answers = async |client: &mut hyper::client::conn::http2::SendRequest<raw::Body>| {
        raw::status_on(client, INFO, &[], raw::frame(false, &[])).await.0.code()
    };
    let mut first = raw::connect(&server.address).await;
    assert_eq!(answers(&mut first).await, Code::Ok);
    let mut second = raw::connect(&server.address).await;
    assert_eq!(answers(&mut second).await, Code::Ok);
    let mut third = TcpStream::connect(&server.address).await.unwrap();
    assert_eq!(third.read(&mut [0; 100]).await.unwrap_or(0), 0);
    assert_eq!(server.metric(r#"hullcast_sheds_total{reason="connections"}"#), 1.0);
    drop(second);
    server.until("hullcast_connections", 2.0).await;
    let mut again = raw::connect(&server.address).await;
    assert_eq!(answers(&mut again).await, Code::Ok);
    assert_eq!(answers(&mut first).await, Code::Ok);
}

/// Catches calls that are reset as fast as they are made (CVE-2023-44487) and pile up.
#[tokio::test(flavor = "multi_thread")]
async fn rapid_resets_leave_nothing_behind() {
    let server = TestServer::start().await;
    let mut made = 0;
    for _ in 0..10 {
        let mut client = raw::connect(&server.address).await;
        for _ in 0..1000 {
            if client.ready().await.is_err() {
                break; // the server ended the connection
            }
            let call = client.send_request(raw::call(QUERY, &[], raw::Body::Never));
            made += 1;
            // Begins the call and cancels it at once.
            drop(tokio::time::timeout(Duration::ZERO, call).await);
        }
    }
    assert!(made >= 1000, "{made}");
    server.until("hullcast_requests_in_flight", 0.0).await;
    is_answered(&server).await;
}

/// Catches answers to pings that pile up for a peer that does not read them. The server must stop
/// reading, so that the peer can send no more.
#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_pings_is_held_back() {
    const TOO_MUCH: usize = 256 << 20;
    let server = TestServer::start().await;
    let mut stream = TcpStream::connect(&server.address).await.unwrap();
    stream.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0").await.unwrap();
    let pings = Bytes::from(b"\0\0\x08\x06\0\0\0\0\0pingpong".repeat(4096));
    let mut sent = 0;
    while let Ok(result) = tokio::time::timeout(Duration::from_secs(2), stream.write_all(&pings)).await {
        sent += pings.len();
        if result.is_err() {
            break; // the server closed the connection, which is a defence too
        }
        assert!(sent < TOO_MUCH, "the server never stops reading");
    }
    is_answered(&server).await;
}

/// Catches many silent clients that keep the server from answering others.
#[tokio::test(flavor = "multi_thread")]
async fn idle_connections_are_held() {
    const IDLE: usize = 300;
    let server = TestServer::start().await;
    let idle = join_all((0..IDLE).map(|_| raw::connect(&server.address))).await;
    server.until("hullcast_connections", IDLE as f64 + 1.0).await;
    is_answered(&server).await;
    for mut client in idle {
        let (status, _) = raw::status_on(&mut client, INFO, &[], raw::frame(false, &[])).await;
        assert_eq!(status.code(), Code::Ok);
    }
}

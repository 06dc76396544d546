//! gRPC-web and the playground's page, with the exact bytes that a browser sends.

use std::time::Duration;

use hullcast::{
    proto::{
        DeleteHullsRequest, GetHullsRequest, GetServerInfoRequest, QueryContactsRequest,
        QueryContactsResponse,
    },
    service::{Limits, Security, SecurityFiles},
};
use prost::Message;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};
use tonic::Code;

use crate::support::{
    Setup, TestServer, raw,
    scenes::{assert_same, expected, register_request, two_boxes},
};

const GRPC_WEB: &str = "application/grpc-web+proto";
const INFO: &str = "/hullcast.v1.ServerService/GetServerInfo";
const QUERY: &str = "/hullcast.v1.ContactService/QueryContacts";
const DELETE: &str = "/hullcast.v1.HullService/DeleteHulls";

fn setup() -> Setup {
    let mut setup = Setup::default();
    setup.options.playground = true;
    setup
}

/// A server without the page, which the pages of two sites may call.
fn setup_for_sites() -> Setup {
    let mut setup = Setup::default();
    setup.options.grpc_web = true;
    let origins = ["https://app.example", "http://[::1]:8000"];
    setup.options.grpc_web_origins = origins.map(|origin| origin.parse().unwrap()).to_vec();
    setup
}

/// An HTTP/1.1 response.
struct HttpResponse {
    code: u16,
    head: String,
    body: Vec<u8>,
}

/// Reads until the server closes the connection.
async fn read(stream: &mut TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    // The server ends the connection by a close or a reset.
    let _ = stream.read_to_end(&mut bytes).await;
    bytes
}

/// Sends one HTTP/1.1 request to `host` on a new connection.
async fn ask(server: &TestServer, host: &str, line: &str, headers: &str, body: &[u8]) -> HttpResponse {
    let mut stream = TcpStream::connect(&server.address).await.unwrap();
    let length = body.len();
    let head =
        format!("{line} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\ncontent-length: {length}\r\n");
    stream.write_all(format!("{head}{headers}\r\n").as_bytes()).await.unwrap();
    stream.write_all(body).await.unwrap();
    let bytes = read(&mut stream).await;
    let end = bytes.windows(4).position(|w| w == b"\r\n\r\n").expect("a head") + 4;
    let head = String::from_utf8(bytes[..end].to_vec()).unwrap().to_lowercase();
    let code = head.split(' ').nth(1).unwrap().parse().unwrap();
    let body = match head.contains("transfer-encoding: chunked") {
        true => unchunked(&bytes[end..]),
        false => bytes[end..].to_vec(),
    };
    HttpResponse { code, head, body }
}

fn unchunked(mut rest: &[u8]) -> Vec<u8> {
    let mut whole = Vec::new();
    loop {
        let line = rest.windows(2).position(|w| w == b"\r\n").expect("a chunk's length");
        let length = usize::from_str_radix(std::str::from_utf8(&rest[..line]).unwrap(), 16).unwrap();
        if length == 0 {
            return whole;
        }
        whole.extend_from_slice(&rest[line + 2..][..length]);
        rest = &rest[line + 2 + length + 2..];
    }
}

/// A unary call over gRPC-web and HTTP/1.1. Returns the message, the status and the text of the
/// trailers.
async fn call(
    server: &TestServer,
    path: &str,
    headers: &str,
    message: &impl Message,
) -> (Vec<u8>, Code, String) {
    let headers = format!("content-type: {GRPC_WEB}\r\n{headers}");
    let frame = raw::frame(false, &message.encode_to_vec());
    let said = ask(server, "127.0.0.1", &format!("POST {path}"), &headers, &frame).await;
    assert_eq!(said.code, 200, "{}", said.head);
    assert!(said.head.contains("content-type: application/grpc-web"), "{}", said.head);
    let (mut message, mut trailers, mut rest) = (vec![], said.head.clone(), &said.body[..]);
    while let [kind, a, b, c, d, after @ ..] = rest {
        let (frame, next) = after.split_at(u32::from_be_bytes([*a, *b, *c, *d]) as usize);
        match kind {
            0 => message = frame.to_vec(),
            _ => trailers = String::from_utf8(frame.to_vec()).unwrap(),
        }
        rest = next;
    }
    let status = trailers.lines().find_map(|line| line.strip_prefix("grpc-status:")).expect(&trailers);
    (message, Code::from(status.trim().parse::<i32>().unwrap()), trailers)
}

/// Catches a page with a missing file, and one that may load or run code of another origin.
#[tokio::test(flavor = "multi_thread")]
async fn the_page_is_served_with_all_its_files() {
    let server = setup().start().await;
    let page = ask(&server, "localhost:50051", "GET /", "", b"").await;
    assert_eq!(page.code, 200);
    assert!(page.head.contains("content-type: text/html"), "{}", page.head);
    assert!(
        page.head.contains("content-security-policy: default-src 'none'; script-src 'self'"),
        "{}",
        page.head
    );
    let page = String::from_utf8(page.body).unwrap();
    for (file, kind) in [("playground.js", "text/javascript"), ("playground.css", "text/css")] {
        assert!(page.contains(&format!("\"{file}\"")), "the page does not name {file}");
        let said = ask(&server, "127.0.0.1", &format!("GET /{file}"), "", b"").await;
        assert_eq!(said.code, 200);
        assert!(said.head.contains(kind) && !said.body.is_empty(), "{}", said.head);
    }
    let licences = ask(&server, "[::1]:50051", "GET /licences.txt", "", b"").await;
    assert!(String::from_utf8(licences.body).unwrap().contains("three.js authors"));
    let head = ask(&server, "localhost", "HEAD /", "", b"").await;
    assert!(head.code == 200 && head.body.is_empty());
    assert_eq!(ask(&server, "localhost", "GET /other", "", b"").await.code, 404);
}

/// Catches numbers that change on their way through gRPC-web, calls that no metric counts, and
/// plain gRPC that stops working beside it.
#[tokio::test(flavor = "multi_thread")]
async fn a_unary_call_over_grpc_web_answers_as_grpc_does() {
    let server = setup().start().await;
    let (shapes, query) = two_boxes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let (message, code, _) = call(&server, QUERY, "", &query).await;
    assert_eq!(code, Code::Ok);
    let over_web = QueryContactsResponse::decode(&message[..]).unwrap();
    assert_same(&over_web, &expected(&query, &shapes));
    let over_grpc = server.contacts().query_contacts(query.clone()).await.unwrap().into_inner();
    assert_same(&over_web, &over_grpc);
    let counted = r#"hullcast_requests_total{method="hullcast.v1.ContactService/QueryContacts",code="OK"}"#;
    server.until("hullcast_requests_in_flight", 0.0).await;
    assert_eq!(server.metric(counted), 2.0);

    // An error carries its details.
    let (_, code, trailers) =
        call(&server, QUERY, "", &QueryContactsRequest { pairs: vec![0], ..query }).await;
    assert_eq!(code, Code::InvalidArgument);
    assert!(trailers.contains("grpc-status-details-bin"), "{trailers}");
    let (_, code, _) =
        call(&server, "/hullcast.v1.ContactService/Nothing", "", &GetServerInfoRequest {}).await;
    assert_eq!(code, Code::Unimplemented);
}

/// Browsers speak HTTP/2 to a server with TLS. Catches gRPC-web that works only over HTTP/1.1.
#[tokio::test(flavor = "multi_thread")]
async fn grpc_web_works_over_http2() {
    let server = setup().start().await;
    let mut client = raw::connect(&server.address).await;
    let mut request = raw::call(INFO, &[], raw::Body::Whole(raw::frame(false, &[])));
    request.headers_mut().insert("content-type", GRPC_WEB.parse().unwrap());
    let response = client.send_request(request).await.unwrap();
    assert_eq!(response.headers()["content-type"], GRPC_WEB);
}

/// Catches a page of another site that calls the server with its visitor's rights: through a host
/// name that was made to resolve to the server, or by a POST that browsers send to any site without
/// a preflight request.
#[tokio::test(flavor = "multi_thread")]
async fn pages_of_other_sites_cannot_call() {
    let server = setup().start().await;
    let (shapes, query) = two_boxes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let delete = raw::frame(false, &DeleteHullsRequest { ids: query.hull_ids.clone() }.encode_to_vec());
    let web = format!("content-type: {GRPC_WEB}\r\n");
    for host in ["evil.example", "evil.example:50051", "localhost.evil.example", "127.0.0.1.evil.example", ""]
    {
        let said = ask(&server, host, &format!("POST {DELETE}"), &web, &delete).await;
        assert_eq!(said.code, 403, "{host}");
        assert_eq!(ask(&server, host, "GET /", "", b"").await.code, 403, "{host}");
        // A second Host header, or the whole address of the page, names another site too.
        let second = format!("host: {host}\r\n");
        assert_eq!(ask(&server, "localhost", "GET /", &second, b"").await.code, 403, "{host}");
        if !host.is_empty() {
            let line = format!("GET http://{host}/");
            assert_eq!(ask(&server, "localhost", &line, "", b"").await.code, 403, "{host}");
        }
    }
    for (kind, code) in
        [("text/plain", 415), ("application/x-www-form-urlencoded", 415), ("application/grpc", 400)]
    {
        let headers = format!("content-type: {kind}\r\n");
        let said = ask(&server, "127.0.0.1", &format!("POST {DELETE}"), &headers, &delete).await;
        assert_eq!(said.code, code, "{kind}");
    }
    // Over HTTP/2, where gRPC is served beside gRPC-web, it is refused too.
    let mut request = raw::call(DELETE, &[], raw::Body::Whole(delete));
    request.headers_mut().insert("content-type", "text/plain".parse().unwrap());
    let response = raw::connect(&server.address).await.send_request(request).await.unwrap();
    assert_eq!(response.status(), 415);
    // The server gives no permission for requests from another origin.
    let asks = "origin: http://evil.example\r\naccess-control-request-method: POST\r\n";
    let said = ask(&server, "127.0.0.1", &format!("OPTIONS {DELETE}"), asks, b"").await;
    assert!(said.code == 415 && !said.head.contains("access-control-allow"), "{}", said.head);
    let request = GetHullsRequest { ids: query.hull_ids, field_mask: None };
    let records = server.hulls().get_hulls(request).await;
    assert!(records.unwrap().into_inner().hulls.iter().all(|hull| hull.found));
}

/// Catches an origin that is allowed although it is not listed, a listed one that is not told so, and an answer
/// whose status its page may not read.
#[tokio::test(flavor = "multi_thread")]
async fn pages_of_listed_origins_can_call() {
    let server = setup_for_sites().start().await;
    let frame = raw::frame(false, &[]);
    let (preflight, post) = (format!("OPTIONS {INFO}"), format!("POST {INFO}"));
    let allowed = |said: &HttpResponse| {
        let of = |line: &str| line.strip_prefix("access-control-allow-origin: ").map(str::to_owned);
        said.head.lines().find_map(of)
    };
    for (origin, is_listed) in [
        ("https://app.example", true),
        ("http://[::1]:8000", true),
        ("http://app.example", false),
        ("https://app.example:8443", false),
        ("https://app.example.evil.example", false),
        ("null", false),
    ] {
        let expected = is_listed.then(|| origin.to_owned());
        let asks = format!(
            "origin: {origin}\r\naccess-control-request-method: POST\r\naccess-control-request-headers: \
             authorization,content-type,x-grpc-web\r\n"
        );
        let said = ask(&server, "127.0.0.1", &preflight, &asks, b"").await;
        assert_eq!((said.code, allowed(&said)), (200, expected.clone()), "{}", said.head);
        let headers = "access-control-allow-headers: authorization,content-type,x-grpc-web";
        assert!(said.head.contains(headers), "{}", said.head);
        assert!(said.head.contains("access-control-allow-methods: post"), "{}", said.head);

        let headers = format!("content-type: {GRPC_WEB}\r\norigin: {origin}\r\n");
        let said = ask(&server, "127.0.0.1", &post, &headers, &frame).await;
        assert_eq!((said.code, allowed(&said)), (200, expected), "{}", said.head);
        for status in ["grpc-status", "grpc-message", "grpc-status-details-bin"] {
            let exposed = said.head.lines().find(|line| line.starts_with("access-control-expose-headers"));
            assert!(exposed.is_some_and(|line| line.contains(status)), "{}", said.head);
        }
    }
    // A proxy in front of a listed site may pass the site's name on; other names stay refused.
    let web = format!("content-type: {GRPC_WEB}\r\n");
    for (host, code) in [("app.example", 200), ("App.Example:50051", 200), ("evil.example", 403)] {
        assert_eq!(ask(&server, host, &post, &web, &frame).await.code, code, "{host}");
    }
}

/// Catches a page that is served although only gRPC-web was asked for, and a server that speaks HTTP/1.1
/// although neither was.
#[tokio::test(flavor = "multi_thread")]
async fn grpc_web_works_without_the_page() {
    let mut setup = Setup::default();
    setup.options.grpc_web = true;
    let server = setup.start().await;
    assert_eq!(call(&server, INFO, "", &GetServerInfoRequest {}).await.1, Code::Ok);
    for file in ["/", "/playground.js"] {
        let said = ask(&server, "localhost", &format!("GET {file}"), "", b"").await;
        assert_eq!((said.code, said.head.contains("text/plain")), (404, true), "{}", said.head);
    }
    // No origin is listed, so none is told that it may call.
    let asks = "origin: http://evil.example\r\naccess-control-request-method: POST\r\n";
    let said = ask(&server, "127.0.0.1", &format!("OPTIONS {INFO}"), asks, b"").await;
    assert!(said.code == 415 && !said.head.contains("access-control-allow"), "{}", said.head);
}

/// Catches gRPC-web that bypasses the tokens. The page itself needs none.
#[tokio::test(flavor = "multi_thread")]
async fn tokens_guard_grpc_web() {
    let directory = tempfile::tempdir().unwrap();
    let files = SecurityFiles { query_tokens: directory.path().join("query"), ..SecurityFiles::default() };
    std::fs::write(&files.query_tokens, "reader").unwrap();
    let mut setup = setup();
    setup.options.security = std::sync::Arc::new(Security::open(&files).unwrap());
    let server = setup.start().await;
    assert_eq!(call(&server, INFO, "", &GetServerInfoRequest {}).await.1, Code::Unauthenticated);
    assert_eq!(
        call(&server, INFO, "authorization: Bearer reader\r\n", &GetServerInfoRequest {}).await.1,
        Code::Ok
    );
    assert_eq!(ask(&server, "localhost", "GET /", "", b"").await.code, 200);
}

/// Catches a limit of message size, or of bytes in flight, that does not hold for gRPC-web.
#[tokio::test(flavor = "multi_thread")]
async fn limits_hold_over_grpc_web() {
    let limits =
        Limits { max_message_bytes: 20_000, max_request_bytes_in_flight: 40_000, ..Limits::default() };
    let server = Setup { limits, ..setup() }.start().await;
    let of = |doubles| QueryContactsRequest { positions: vec![0.0; doubles], ..Default::default() };
    let (_, code, trailers) = call(&server, QUERY, "", &of(2600)).await;
    assert_eq!(code, Code::InvalidArgument, "{trailers}");

    let message = of(2000).encode_to_vec();
    let half = raw::frame(false, &message);
    let head = format!("POST {QUERY} HTTP/1.1\r\nhost: [::1]\r\ncontent-type: {GRPC_WEB}\r\n");
    let mut stream = TcpStream::connect(&server.address).await.unwrap();
    let head = format!("{head}content-length: {}\r\n\r\n", half.len() + 1);
    stream.write_all(head.as_bytes()).await.unwrap();
    stream.write_all(&half).await.unwrap();
    // The memory that each call takes at its start covers the first 4 KiB.
    server.until("hullcast_request_bytes_in_flight", message.len() as f64 - 4096.0).await;
    let (_, code, trailers) = call(&server, QUERY, "", &of(2000)).await;
    assert_eq!(code, Code::Unavailable, "{trailers}");
    drop(stream);
    server.until("hullcast_request_bytes_in_flight", 0.0).await;
    // The remaining connection is that of the test's own client.
    server.until("hullcast_connections", 1.0).await;
}

/// Catches HTTP/1.1 peers that can hold a connection: silent, slow, with half a head, with a body
/// that never ends, idle after an answer. Also catches HTTP/1.1 that is answered by a server
/// without a page.
#[tokio::test(flavor = "multi_thread")]
async fn http1_peers_that_dawdle_are_cut_off() {
    let mut setup = setup();
    setup.options.greeting = Duration::from_millis(50);
    setup.limits.max_deadline_seconds = 1;
    let server = setup.start().await;
    let idle = "GET /licences.txt HTTP/1.1\r\nhost: localhost\r\n\r\n";
    let endless = format!(
        "POST {QUERY} HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-type: {GRPC_WEB}\r\ncontent-length: 99\r\n\r\n"
    );
    let long = format!("GET / HTTP/1.1\r\nhost: localhost\r\nx: {}\r\n\r\n", "x".repeat(20_000));
    for (said, heard) in [
        ("", ""),
        ("P", ""),
        ("PO", ""),
        ("GET / HTTP/1.1\r\nhost: loc", ""),
        (idle, "HTTP/1.1 200"),
        (&endless, "HTTP/1.1 200"),
        (&long, "HTTP/1.1 431"),
    ] {
        let mut stream = TcpStream::connect(&server.address).await.unwrap();
        stream.write_all(said.as_bytes()).await.unwrap();
        let bytes = read(&mut stream).await;
        assert!(bytes.starts_with(heard.as_bytes()), "{said}: {}", String::from_utf8_lossy(&bytes));
        assert_eq!(bytes.is_empty(), heard.is_empty(), "{said}: {}", String::from_utf8_lossy(&bytes));
    }
    server.until("hullcast_connections", 1.0).await;

    let plain = TestServer::start().await;
    let mut stream = TcpStream::connect(&plain.address).await.unwrap();
    stream.write_all(idle.as_bytes()).await.unwrap();
    let bytes = read(&mut stream).await;
    assert!(!bytes.starts_with(b"HTTP/1.1"), "{}", String::from_utf8_lossy(&bytes));
}

/// Catches a browser's idle connection that keeps a server from stopping.
#[tokio::test(flavor = "multi_thread")]
async fn an_idle_page_does_not_keep_the_server() {
    let mut server = setup().start().await;
    let mut streams = Vec::new();
    for said in ["GET /licences.txt HTTP/1.1\r\nhost: localhost\r\n\r\n", ""] {
        let mut stream = TcpStream::connect(&server.address).await.unwrap();
        stream.write_all(said.as_bytes()).await.unwrap();
        if !said.is_empty() {
            stream.read_exact(&mut [0; 12]).await.unwrap();
        }
        streams.push(stream);
    }
    server.begin_stop();
    for stream in &mut streams {
        read(stream).await;
    }
    server.stopped().await;
}

/// Catches base64 answers, a second copy that no budget counts, whether the content type asks for them or only
/// the header `accept`.
#[tokio::test(flavor = "multi_thread")]
async fn the_text_form_of_grpc_web_is_refused() {
    let server = setup().start().await;
    let frame = raw::frame(false, &[]);
    for kind in ["application/grpc-web-text", "application/grpc-web-text+proto", "application/GRPC-web-text"]
    {
        let headers = format!("content-type: {kind}\r\n");
        let said = ask(&server, "127.0.0.1", &format!("POST {INFO}"), &headers, &frame).await;
        assert_eq!(said.code, 415, "{kind}");
    }
    let headers = format!("content-type: {GRPC_WEB}\r\naccept: application/grpc-web-text\r\n");
    let said = ask(&server, "127.0.0.1", &format!("POST {INFO}"), &headers, &frame).await;
    assert!(
        said.code == 200 && said.head.contains(&format!("content-type: {GRPC_WEB}\r\n")),
        "{}",
        said.head
    );
    assert_eq!(said.body.first(), Some(&0), "not a binary message");
}

/// Catches files that nothing counts or ends while their peer does not read them, over HTTP/2 and over
/// HTTP/1.1, and heads of pipelined answers that pile up.
#[tokio::test(flavor = "multi_thread")]
async fn files_that_are_not_read_are_counted_and_cut() {
    const CUTS: &str = r#"hullcast_cuts_total{reason="answer_not_read"}"#;
    let mut setup = setup();
    setup.options.answer_time = Duration::from_millis(500);
    let server = setup.start().await;
    let mut client = raw::connect_from("127.0.0.1", &server.address, 1000).await;
    let mut get = raw::call("/playground.js", &[], raw::Body::Whole(Vec::new().into()));
    *get.method_mut() = http::Method::GET;
    let unread = client.send_request(get).await.unwrap();
    assert_eq!(unread.status(), 200);
    assert!(server.metric(r#"hullcast_memory_bytes{part="connections"}"#) > f64::from(32 << 10));
    server.until(CUTS, 1.0).await;
    drop((unread, client));
    for (cuts, line) in [(2.0, "GET /playground.js"), (3.0, "HEAD /")] {
        let stream = TcpStream::connect(&server.address).await.unwrap();
        let asks = format!("{line} HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n").repeat(10_000);
        let (reading, mut writing) = stream.into_split();
        // The server stops reading, or closes the connection.
        let sending = tokio::spawn(async move { while writing.write_all(asks.as_bytes()).await.is_ok() {} });
        server.until(CUTS, cuts).await;
        sending.abort();
        drop(reading);
    }
    server.until("hullcast_connections", 1.0).await;
}

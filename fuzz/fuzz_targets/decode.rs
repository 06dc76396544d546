//! Any bytes sent to the real handlers are answered or refused, and a response
//! is one that its own type reads, the same bytes when asked again: no panic
//! (libFuzzer aborts on one). What is read in bulk is read as prost reads it.
#![no_main]

use std::sync::{Arc, LazyLock};

use bytes::{BufMut, Bytes, BytesMut};
use http_body_util::{BodyExt, Full};
use hullcast::proto::{QueryContactsRequest, QueryContactsResponse};
use hullcast::service::{App, Limits, handlers};
use hullcast_fuzz::seeds;
use libfuzzer_sys::fuzz_target;
use prost::Message;
use tokio::runtime::Runtime;
use tonic::{body::Body, service::Routes};
use tower::ServiceExt;

struct Server {
    runtime: Runtime,
    routes: Routes,
}

// Small limits, so that a fuzzer meets them.
static SERVER: LazyLock<Server> = LazyLock::new(|| {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let limits = Limits { max_pairs_per_request: 64, max_vertices_per_hull: 64, ..Limits::default() };
    let store = hullcast::store::blobs::open("memory://").expect("a store");
    let app = Arc::new(App::new(store, limits, 1).expect("limits that agree"));
    let routes = runtime.block_on(handlers(&app)).expect("handlers");
    // Hulls that the seeds' queries name.
    runtime.block_on(called(&routes, METHODS[2], &seeds::hulls().encode_to_vec()));
    Server { runtime, routes }
});

/// The body of the answer to a call, as it is on the wire.
async fn called(routes: &Routes, method: &str, message: &[u8]) -> Bytes {
    let request = http::Request::post(method)
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .body(Body::new(Full::new(framed(message))))
        .expect("a request");
    let response = routes.clone().oneshot(request).await.expect("handlers never fail");
    response.into_body().collect().await.expect("a body").to_bytes()
}

const METHODS: [&str; 7] = [
    "/hullcast.v1.ContactService/QueryContacts",
    "/hullcast.v1.ContactService/QueryContacts",
    "/hullcast.v1.HullService/RegisterHulls",
    "/hullcast.v1.HullService/GetHulls",
    "/hullcast.v1.HullService/ListHulls",
    "/hullcast.v1.ContactService/StreamContacts",
    "/hullcast.v1.ContactService/FindContacts",
];

/// The bytes, read in bulk and by prost, are the same message or none.
fn read_alike<M: hullcast::proto::bulk::Columnar>(bytes: &[u8]) {
    let bulk = hullcast::proto::bulk::decode::<M>(Bytes::copy_from_slice(bytes)).ok();
    let prost = M::decode(bytes).ok();
    assert_eq!(bulk.map(|m| m.encode_to_vec()), prost.map(|m| m.encode_to_vec()));
}

fn framed(message: &[u8]) -> Bytes {
    let mut frame = BytesMut::with_capacity(5 + message.len());
    frame.put_u8(0);
    frame.put_u32(message.len() as u32);
    frame.put_slice(message);
    frame.freeze()
}

fuzz_target!(|data: &[u8]| {
    let Some((&method, message)) = data.split_first() else { return };
    let method = METHODS[usize::from(method) % METHODS.len()];
    read_alike::<QueryContactsRequest>(message);
    read_alike::<QueryContactsResponse>(message);
    let server = &*SERVER;
    let body = server.runtime.block_on(called(&server.routes, method, message));
    if [METHODS[0], METHODS[5], METHODS[6]].contains(&method) {
        let again = server.runtime.block_on(called(&server.routes, method, message));
        assert_eq!(body, again, "the same request, other bytes");
    }
    if method == METHODS[0] && body.len() > 5 {
        QueryContactsResponse::decode(&body[5..]).expect("a response of its own type");
    }
});

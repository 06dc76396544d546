//! Any bytes sent to the real handlers must be answered or refused without a panic (libFuzzer
//! aborts on one). A response must decode as its own type, and a repeated request must give the
//! same bytes. Columns that are read in bulk must have the values that prost reads.
//!
//! Decoding must accept the messages that prost accepts. It may allocate at most the multiple of
//! the message that docs/operations.md states, and at most the memory that it takes from the
//! budget.
#![no_main]

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    sync::{Arc, LazyLock},
};

use bytes::{BufMut, Bytes, BytesMut};
use http_body_util::{BodyExt, Full};
use hullcast::service::wire::{CONSTANT_BYTES, HULL_BYTES, decoded_bytes};
use hullcast::service::{App, Limits, Reason, handlers};
use hullcast_contact::Stop;
use hullcast_fuzz::seeds;
use hullcast_proto::{
    DeleteHullsRequest, GetHullsRequest, HasHullsRequest, ListHullsRequest, QueryContactsRequest,
    QueryContactsResponse, RegisterHullsRequest,
};
use libfuzzer_sys::fuzz_target;
use prost::Message;
use tokio::runtime::Runtime;
use tonic::{body::Body, service::Routes};
use tower::ServiceExt;

/// An allocator that counts the bytes that each thread holds, and the most that it has held.
struct Counting;

thread_local! {
    static HELD: Cell<isize> = const { Cell::new(0) };
    static MOST: Cell<isize> = const { Cell::new(0) };
}

fn count(bytes: isize) {
    HELD.set(HELD.get() + bytes);
    MOST.set(MOST.get().max(HELD.get()));
}

// SAFETY: every request goes to the system allocator; counting allocates nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: as for this function.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-(layout.size() as isize));
        // SAFETY: as for this function.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Runs `work` and returns the most bytes that it held at one time, beyond those held before.
fn most_bytes<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = HELD.get();
    MOST.set(before);
    let result = work();
    (result, (MOST.get() - before) as usize)
}

struct Server {
    runtime: Runtime,
    routes: Routes,
    /// The first message of a stream, with which later messages may have bodies in common.
    scene: Vec<u8>,
}

const MAX_HULLS: u32 = 16;

/// Small limits, so that a fuzzer reaches them.
fn limits() -> Limits {
    Limits {
        max_pairs_per_request: 64,
        max_bodies_per_request: 64,
        max_hulls_per_request: MAX_HULLS,
        max_vertices_per_hull: 64,
        max_points_per_hull: 64,
        ..Limits::default()
    }
}

static SERVER: LazyLock<Server> = LazyLock::new(|| {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let store = hullcast::store::blobs::open("memory://").expect("a store");
    let app = Arc::new(App::new(store, limits(), 1).expect("limits that agree"));
    let routes = runtime.block_on(handlers(&app)).expect("handlers");
    // Registers the hulls that the seeds' queries name.
    runtime.block_on(called(&routes, METHODS[2], framed(&seeds::hulls().encode_to_vec())));
    Server { runtime, routes, scene: seeds::step_scene().encode_to_vec() }
});

/// The body of the response to a call with these framed messages, as on the wire.
async fn called(routes: &Routes, method: &str, messages: Bytes) -> Bytes {
    let request = http::Request::post(method)
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .body(Body::new(Full::new(messages)))
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

/// The bytes, read in bulk and by prost, must be the same message, or be refused by both.
fn read_alike<M: hullcast_proto::bulk::Columnar>(bytes: &[u8]) {
    let bulk = hullcast_proto::bulk::decode::<M>(Bytes::copy_from_slice(bytes)).ok();
    let prost = M::decode(bytes).ok();
    assert_eq!(bulk.map(|m| m.encode_to_vec()), prost.map(|m| m.encode_to_vec()));
}

/// Decodes the bytes as the handler of `method` does. Its memory must be bounded. Bytes that prost
/// refuses must be refused, and bytes that prost accepts must not be called malformed.
fn decoded_within_bounds<M: Message + Default>(method: &str, bytes: &[u8]) {
    let (decoded, most) = most_bytes(|| decoded_bytes(method, bytes, &limits(), &Stop::default()));
    let stated = 2 * bytes.len() + MAX_HULLS as usize * HULL_BYTES + CONSTANT_BYTES;
    assert!(most <= stated, "{method}: {most} bytes for {} bytes", bytes.len());
    let accepted = M::decode(bytes).is_ok();
    match decoded {
        Ok(taken) => {
            assert!(most <= taken + CONSTANT_BYTES, "{method}: {most} bytes, {taken} taken");
            assert!(accepted, "{method}: prost refuses the message");
        }
        Err(error) => assert!(!accepted || error.reason != Reason::MalformedMessage, "{method}: {error}"),
    }
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
    decoded_within_bounds::<QueryContactsRequest>("QueryContacts", message);
    decoded_within_bounds::<QueryContactsRequest>("FindContacts", message);
    decoded_within_bounds::<QueryContactsRequest>("StreamContacts", message);
    decoded_within_bounds::<RegisterHullsRequest>("RegisterHulls", message);
    decoded_within_bounds::<GetHullsRequest>("GetHulls", message);
    decoded_within_bounds::<HasHullsRequest>("HasHulls", message);
    decoded_within_bounds::<DeleteHullsRequest>("DeleteHulls", message);
    decoded_within_bounds::<ListHullsRequest>("ListHulls", message);
    let server = &*SERVER;
    let body = server.runtime.block_on(called(&server.routes, method, framed(message)));
    if [METHODS[0], METHODS[5], METHODS[6]].contains(&method) {
        let again = server.runtime.block_on(called(&server.routes, method, framed(message)));
        assert_eq!(body, again, "the same request, other bytes");
    }
    if method == METHODS[5] {
        // As a later message of a stream, twice, so that the second refers to the first.
        let stream = || [framed(&server.scene), framed(message), framed(message)].concat().into();
        let body = server.runtime.block_on(called(&server.routes, method, stream()));
        let again = server.runtime.block_on(called(&server.routes, method, stream()));
        assert_eq!(body, again, "the same stream, other bytes");
    }
    if method == METHODS[0] && body.len() > 5 {
        QueryContactsResponse::decode(&body[5..]).expect("a response of its own type");
    }
});

//! Equal request bytes give equal response bytes. This holds for any number of threads and any
//! state of the cache, however a hull reached the server, whatever was queried before, and with
//! pairs in the batch that cannot be answered.

use std::sync::Arc;

use bytes::Bytes;
use hullcast::{
    proto::{Outcome, QueryContactsRequest, QueryContactsResponse},
    service::Limits,
    store::{BlobStore, blobs},
};
use prost::Message;

use crate::support::{
    Setup, TestServer, raw,
    scenes::{ALL, append, assert_same, outputs, plain, register_request, round_points, scene, shapes},
};

const QUERY: &str = "/hullcast.v1.ContactService/QueryContacts";
const STREAM: &str = "/hullcast.v1.ContactService/StreamContacts";
const FIND: &str = "/hullcast.v1.ContactService/FindContacts";

/// A scene with bodies without a usable pose, a hull that is not registered, and warm starts of
/// which half are useless.
fn mixed() -> QueryContactsRequest {
    let mut request = scene(&shapes(), 40, 700, 3);
    request.positions[3 * 5 + 1] = f64::NAN;
    request.positions[3 * 11] = f64::INFINITY;
    request.rotations[4 * 23..4 * 24].fill(0.0);
    request.hull_ids.push(vec![0xee; 32]);
    let unknown = request.hull_ids.len() as u32 - 1;
    request.body_hulls[30..32].fill(unknown);
    request.warm_starts = (0..700).flat_map(|pair| [0, 1, 2, 3, 4, 5 + 1000 * (pair % 2)]).collect();
    request.outputs = outputs(&ALL);
    request
}

/// A request of FindContacts for the same bodies.
fn to_be_found() -> QueryContactsRequest {
    QueryContactsRequest { pairs: vec![], warm_starts: vec![], margin: 0.05, ..mixed() }
}

/// The requests as on the wire. The second message of the stream inherits from the first.
fn requests() -> Vec<(&'static str, Bytes)> {
    let frame = |request: &QueryContactsRequest| raw::frame(false, &request.encode_to_vec());
    let QueryContactsRequest { positions, rotations, .. } = mixed();
    let step = QueryContactsRequest { inherit: true, positions, rotations, ..Default::default() };
    vec![
        (QUERY, frame(&mixed())),
        (STREAM, [frame(&mixed()), frame(&step)].concat().into()),
        (FIND, frame(&to_be_found())),
    ]
}

fn first_message(frames: &[u8]) -> QueryContactsResponse {
    let length = u32::from_be_bytes(frames[1..5].try_into().unwrap()) as usize;
    QueryContactsResponse::decode(&frames[5..][..length]).unwrap()
}

async fn serving(store: &Arc<dyn BlobStore>, threads: usize, cache_bytes: u64) -> TestServer {
    let limits = Limits { cache_bytes, shares: false, ..Limits::default() };
    Setup { store: store.clone(), threads, limits, ..Setup::default() }.start().await
}

/// Catches bytes that depend on the number of compute threads, on whether a hull was built by this
/// server, read, cached or evicted, or on earlier queries.
#[tokio::test(flavor = "multi_thread")]
async fn threads_and_cache_change_no_byte() {
    let store = blobs::open("memory://").unwrap();
    let roomy = Limits::default().cache_bytes;
    let first = serving(&store, 1, roomy).await;
    first.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let mut known = Vec::new();
    for (path, request) in requests() {
        known.push(raw::answer_of(&first.address, path, request).await);
    }
    let answer = first_message(&known[0]);
    let of = |outcome: Outcome| answer.outcomes.iter().filter(|&&o| i32::from(o) == outcome as i32).count();
    assert!(of(Outcome::Invalid) > 100 && of(Outcome::Contact) > 100 && of(Outcome::Separated) > 100);
    assert_eq!((&answer.invalid_bodies[..], &answer.missing_hulls[..]), (&[5, 11, 23][..], &[5][..]));
    assert!(known[1].len() > known[0].len() + 100 && known[2].len() > 1000);

    // Other hulls, which take more memory, and a scene of them.
    let others: Vec<_> = (0..40).map(|seed| plain(round_points(40, 100 + seed))).collect();
    let own = first.app.registry().cached_bytes();
    first.hulls().register_hulls(register_request(&others)).await.unwrap();
    let tight = first.app.registry().cached_bytes() - own;
    assert!(tight > own);
    let (mut compared, mut misses) = (0, 0.0);
    for threads in [1, 2, 5] {
        // A cache with room for all hulls, and one with room for one scene's hulls at a time.
        for cache_bytes in [roomy, tight] {
            // First without any cached hull, then with cached hulls, then, if there is no room,
            // after eviction.
            let server = serving(&store, threads, cache_bytes).await;
            for between in [false, false, true, true] {
                if between {
                    let request = raw::frame(false, &scene(&others, 60, 200, 4).encode_to_vec());
                    raw::answer_of(&server.address, QUERY, request).await;
                }
                for ((path, request), known) in requests().into_iter().zip(&known) {
                    let answer = raw::answer_of(&server.address, path, request).await;
                    if answer != known {
                        // The bytes decide; the comparison of the messages shows the column that
                        // differs.
                        let [found, first] = [&answer, known].map(|frames| first_message(frames));
                        assert_same(&found, &first);
                        panic!("{path}, {threads} threads, {cache_bytes} bytes of cache");
                    }
                    compared += 1;
                }
            }
            let missed = server.metric("hullcast_cache_misses_total");
            misses += if cache_bytes == tight { missed } else { -missed };
        }
    }
    // Each of the three servers with the small cache read its hulls again.
    assert!(misses >= 15.0, "evicted hulls were not read again: {misses}");
    assert_eq!(compared, 3 * 2 * 4 * 3);
}

/// Catches a pair without an answer that shifts the other pairs' columns when a batch is split.
#[tokio::test(flavor = "multi_thread")]
async fn parts_with_unanswered_pairs_are_the_batch() {
    let server = serving(&blobs::open("memory://").unwrap(), 3, Limits::default().cache_bytes).await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let mixed = mixed();
    let whole = server.contacts().query_contacts(mixed.clone()).await.unwrap().into_inner();
    for size in [1, 33, 100, 699] {
        let mut joined = QueryContactsResponse {
            missing_hulls: whole.missing_hulls.clone(),
            invalid_bodies: whole.invalid_bodies.clone(),
            request_id: whole.request_id,
            contract: whole.contract,
            ..Default::default()
        };
        for (pairs, warm_starts) in mixed.pairs.chunks(2 * size).zip(mixed.warm_starts.chunks(6 * size)) {
            let (pairs, warm_starts) = (pairs.to_vec(), warm_starts.to_vec());
            let part = QueryContactsRequest { pairs, warm_starts, ..mixed.clone() };
            let part = server.contacts().query_contacts(part).await.unwrap().into_inner();
            assert_eq!(part.invalid_bodies, whole.invalid_bodies);
            append(&mut joined, part);
        }
        assert_same(&joined, &whole);
    }
}

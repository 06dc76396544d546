//! Every limit: a request at the limit is accepted, one past it is refused.

use hullcast::{
    proto::{
        GetHullsRequest, GetServerInfoRequest, ListHullsRequest, QueryContactsRequest,
        register_hull_result::Result as Registered,
    },
    service::Limits,
};
use prost::Message;
use tonic::Code;

use crate::support::{
    TestServer, invalid, refusal, refused,
    scenes::{plain, register_request, round_points, scene, shapes, two_boxes},
};

fn small() -> Limits {
    Limits {
        max_message_bytes: 100_000,
        max_pairs_per_request: 20,
        max_bodies_per_request: 10,
        max_hulls_per_request: 3,
        max_vertices_per_hull: 60,
        max_points_per_hull: 62,
        max_memory_bytes: 256 << 20,
        shares: true,
        max_pairs_in_flight: 1000,
        max_request_bytes_in_flight: 200_000,
        max_deadline_seconds: 77,
        max_connections: 50,
        max_stream_state_bytes: 1 << 16,
        cache_bytes: 1 << 20,
        store_bytes: 0,
        max_streams_per_connection: 7,
        max_page_size: 2,
        cache_age_seconds: 9,
        store_seconds: 7,
    }
}

/// Catches a limit that a client cannot query.
#[tokio::test(flavor = "multi_thread")]
async fn every_limit_is_published() {
    let limits = Limits { store_bytes: 5_000_000, ..small() };
    let server = TestServer::with_limits(limits.clone()).await;
    let info = server.info().get_server_info(GetServerInfoRequest {}).await.unwrap().into_inner();
    assert_eq!(info.version, env!("CARGO_PKG_VERSION"));
    assert_eq!(info.compute_threads, 2);
    assert!(["scalar", "avx2", "avx512"].contains(&&*info.instruction_set), "{info:?}");
    let published = info.limits.unwrap();
    assert_eq!(published.max_message_bytes, limits.max_message_bytes as u64);
    assert_eq!(published.max_pairs_per_request, limits.max_pairs_per_request);
    assert_eq!(published.max_bodies_per_request, limits.max_bodies_per_request);
    assert_eq!(published.max_hulls_per_request, limits.max_hulls_per_request);
    assert_eq!(published.max_vertices_per_hull, limits.max_vertices_per_hull);
    assert_eq!(published.max_points_per_hull, limits.max_points_per_hull);
    assert_eq!(published.max_memory_bytes, limits.max_memory_bytes);
    assert_eq!(published.max_pairs_in_flight, u64::from(limits.max_pairs_in_flight));
    assert_eq!(published.cache_bytes, limits.cache_bytes);
    assert_eq!(published.store_bytes, limits.store_bytes);
    assert_eq!(published.max_streams_per_connection, limits.max_streams_per_connection);
    assert_eq!(published.max_page_size, limits.max_page_size);
    assert_eq!(published.cache_age_seconds, limits.cache_age_seconds);
    assert_eq!(published.max_request_bytes_in_flight, limits.max_request_bytes_in_flight);
    assert_eq!(published.max_deadline_seconds, limits.max_deadline_seconds);
    assert_eq!(published.max_connections, limits.max_connections);
    assert_eq!(published.max_stream_state_bytes, limits.max_stream_state_bytes);
}

/// Catches limits of a query that are off by one.
#[tokio::test(flavor = "multi_thread")]
async fn queries_at_their_limits_and_one_past() {
    let server = TestServer::with_limits(small()).await;
    let shapes = &shapes()[..3];
    server.hulls().register_hulls(register_request(shapes)).await.unwrap();
    let refuse = async |request, expected| {
        let status = server.contacts().query_contacts(request).await.unwrap_err();
        assert_eq!(refusal(&status), expected);
    };
    server.contacts().query_contacts(scene(shapes, 10, 20, 1)).await.unwrap();
    refuse(scene(shapes, 10, 21, 1), invalid("TOO_MANY_PAIRS", "pairs")).await;
    refuse(scene(shapes, 11, 20, 1), invalid("TOO_MANY_BODIES", "body_hulls")).await;
    let mut four = scene(shapes, 10, 20, 1);
    four.hull_ids.push(vec![0; 32]);
    refuse(four, invalid("TOO_MANY_HULLS", "hull_ids")).await;
}

/// Catches limits of the hull service that are off by one: hulls per request, vertices and points
/// per hull.
#[tokio::test(flavor = "multi_thread")]
async fn registrations_at_their_limits_and_one_past() {
    let server = TestServer::with_limits(small()).await;
    let mut hulls = server.hulls();
    // All points on a sphere are extreme, and a point inside the sphere is not a vertex.
    let mut with_inner = round_points(60, 5);
    with_inner.push([0.0; 3]);
    let shapes = [plain(round_points(60, 4)), plain(with_inner.clone()), plain(round_points(61, 6))];
    let results = hulls.register_hulls(register_request(&shapes)).await.unwrap().into_inner().results;
    let vertices = |result: &hullcast::proto::RegisterHullResult| match &result.result {
        Some(Registered::Hull(info)) => Ok((info.vertex_count, info.registered_count)),
        Some(Registered::Error(error)) => Err((error.reason.clone(), error.field.clone())),
        None => panic!("a result has neither a hull nor an error"),
    };
    assert_eq!(vertices(&results[0]), Ok((60, 60)));
    assert_eq!(vertices(&results[1]), Ok((60, 61)));
    assert_eq!(vertices(&results[2]), Err(("TOO_MANY_VERTICES".into(), "vertices".into())));

    with_inner.push([0.0; 3]);
    let at_limit = plain(with_inner.clone());
    with_inner.push([0.0; 3]);
    let shapes_again = [at_limit, plain(with_inner), plain(round_points(60, 4))];
    let results = hulls.register_hulls(register_request(&shapes_again)).await.unwrap().into_inner().results;
    assert_eq!(vertices(&results[0]), Ok((60, 62)));
    assert_eq!(vertices(&results[1]), Err(("TOO_MANY_POINTS".into(), "vertices".into())));
    assert_eq!(vertices(&results[2]), Ok((60, 60)));
    let Some(Registered::Error(error)) = &results[1].result else { panic!("it is an error") };
    assert!(error.message.contains("got 63 points, at most 62 are allowed"), "{error:?}");

    let four = [&shapes[..], &shapes[..1]].concat();
    let status = hulls.register_hulls(register_request(&four)).await.unwrap_err();
    assert_eq!(refusal(&status), invalid("TOO_MANY_HULLS", "hulls"));
    let ids = vec![vec![0; 32]; 4];
    let request = hullcast::proto::HasHullsRequest { ids: ids[..3].to_vec() };
    hulls.has_hulls(request).await.unwrap();
    let status = hulls.has_hulls(hullcast::proto::HasHullsRequest { ids }).await.unwrap_err();
    assert_eq!(refusal(&status), invalid("TOO_MANY_HULLS", "ids"));
}

/// Lists that have a fixed limit instead of a setting. Catches one that is not limited, or is off
/// by one.
#[tokio::test(flavor = "multi_thread")]
async fn outputs_and_paths_at_their_limits_and_one_past() {
    let server = TestServer::start().await;
    let (shapes, query) = two_boxes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    for count in [256, 257] {
        let request = QueryContactsRequest { outputs: vec![1; count], ..query.clone() };
        let answered = server.contacts().query_contacts(request).await.map(|_| ());
        let mask = prost_types::FieldMask { paths: vec!["info".into(); count] };
        let request = GetHullsRequest { ids: query.hull_ids.clone(), field_mask: Some(mask) };
        let described = server.hulls().get_hulls(request).await.map(|_| ());
        let expected = |reason, field| if count > 256 { Err(invalid(reason, field)) } else { Ok(()) };
        assert_eq!(answered.map_err(|s| refusal(&s)), expected("TOO_MANY_OUTPUTS", "outputs"));
        assert_eq!(described.map_err(|s| refusal(&s)), expected("TOO_MANY_PATHS", "field_mask.paths"));
    }
}

/// Catches a message limit that is off by one. It counts the bytes of the message without its
/// frame.
#[tokio::test(flavor = "multi_thread")]
async fn a_message_at_its_limit_and_one_past() {
    let (shapes, mut request) = two_boxes();
    request.warm_starts = vec![u32::MAX; 6];
    let bytes = request.encoded_len().max(1024);
    let limits = Limits { max_message_bytes: bytes, ..small() };
    let server = TestServer::with_limits(limits).await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    // Fill the message with bodies that are in no pair, 60 bytes each.
    let mut padded = request.clone();
    while padded.encoded_len() + 60 <= bytes {
        padded.body_hulls.push(0);
        padded.positions.extend([0.0; 3]);
        padded.rotations.extend([0.0, 0.0, 0.0, 1.0]);
    }
    // Fill the rest with outputs, which may repeat and take one byte each.
    while padded.encoded_len() < bytes {
        padded.outputs.push(2);
    }
    assert_eq!(padded.encoded_len(), bytes);
    let limits = Limits { max_message_bytes: bytes, max_bodies_per_request: 100, ..small() };
    let server = TestServer::with_limits(limits).await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    server.contacts().query_contacts(padded.clone()).await.unwrap();
    padded.outputs.push(2);
    assert_eq!(padded.encoded_len(), bytes + 1);
    let status = server.contacts().query_contacts(padded).await.unwrap_err();
    assert_eq!(refusal(&status), invalid("MESSAGE_TOO_LARGE", ""));
}

/// A server with default settings must answer a request of the sizes that the contract promises.
/// Catches a default below the promise.
#[tokio::test(flavor = "multi_thread")]
async fn the_promised_sizes_are_the_defaults() {
    let (shapes, request) = two_boxes();
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let bodies = 131_072;
    let request = QueryContactsRequest {
        body_hulls: vec![0; bodies],
        positions: (0..bodies).flat_map(|i| [3.0 * i as f64, 0.0, 0.0]).collect(),
        rotations: [0.0, 0.0, 0.0, 1.0].repeat(bodies),
        pairs: (0..bodies as u32).flat_map(|i| [i, i]).collect(),
        outputs: vec![1],
        ..request
    };
    let answer = server.contacts().max_encoding_message_size(usize::MAX).query_contacts(request).await;
    assert_eq!(answer.unwrap().into_inner().outcomes.len(), 131_072);
    assert!(server.app.limits().max_vertices_per_hull >= 16_384);
    assert_eq!(server.app.limits().max_message_bytes, 64 << 20);
}

/// Catches a page that is larger than its limit, and a listing that misses or repeats hulls between
/// pages.
#[tokio::test(flavor = "multi_thread")]
async fn pages_are_at_most_their_limit_and_cover_everything_once() {
    let server = TestServer::with_limits(small()).await;
    let mut hulls = server.hulls();
    let mut expected = Vec::new();
    for seed in 0..7 {
        let shape = plain(round_points(10, seed));
        hulls.register_hulls(register_request(std::slice::from_ref(&shape))).await.unwrap();
        expected.push((crate::support::scenes::id(&shape), shape.identity_bytes().len() as u64));
    }
    expected.sort();
    for (asked, size) in [(0, 2), (1, 1), (2, 2), (3, 2), (u32::MAX, 2)] {
        let mut found = Vec::new();
        let mut page_token = String::new();
        loop {
            let request = ListHullsRequest { page_size: asked, page_token };
            let page = hulls.list_hulls(request).await.unwrap().into_inner();
            assert!(page.hulls.len() <= size, "{asked}");
            assert!(page.hulls.iter().all(|hull| hull.created_unix_ms > 0));
            found.extend(page.hulls.into_iter().map(|hull| (hull.id, hull.bytes)));
            page_token = page.next_page_token;
            if page_token.is_empty() {
                break;
            }
        }
        assert_eq!(found, expected, "{asked}");
    }
}

/// Catches a store that grows past its limit, a hull that is refused although it fits, and a limit
/// that counts a hull twice which was registered twice.
#[tokio::test(flavor = "multi_thread")]
async fn a_store_at_its_limit_and_one_byte_past() {
    let shapes = [1, 2, 3].map(|seed| plain(round_points(10, seed)));
    let each = shapes[0].identity_bytes().len() as u64;
    let full = refused(Code::ResourceExhausted, "STORE_FULL", "");
    for (store_bytes, fits) in [(2 * each, 2), (2 * each - 1, 1), (3 * each, 3)] {
        let server = TestServer::with_limits(Limits { store_bytes, ..small() }).await;
        let mut hulls = server.hulls();
        for (i, shape) in shapes.iter().enumerate() {
            let shape = std::slice::from_ref(shape);
            for _again in 0..2 {
                match hulls.register_hulls(register_request(shape)).await {
                    Ok(_) => assert!(i < fits, "{store_bytes}"),
                    Err(status) => {
                        assert_eq!(refusal(&status), full);
                        assert!(i >= fits, "{store_bytes}");
                    }
                }
            }
        }
        // Space that is freed can be used again.
        let ids = vec![crate::support::scenes::id(&shapes[0])];
        hulls.delete_hulls(hullcast::proto::DeleteHullsRequest { ids }).await.unwrap();
        hulls.register_hulls(register_request(&shapes[fits.min(2)..][..1])).await.unwrap();
    }
}

/// Catches limits that contradict each other and are accepted: the first request would hang.
#[test]
fn contradicting_limits_do_not_start() {
    type Spoil = fn(&mut Limits);
    let spoils: [Spoil; 19] = [
        |l| l.max_pairs_per_request = 0,
        |l| l.max_bodies_per_request = 0,
        |l| l.max_hulls_per_request = 0,
        |l| l.max_streams_per_connection = 0,
        |l| l.max_page_size = 0,
        |l| l.max_vertices_per_hull = 3,
        |l| l.max_message_bytes = 1023,
        |l| l.max_connections = 0,
        |l| l.cache_bytes = 0,
        |l| l.store_seconds = 0,
        |l| l.store_seconds = 3601,
        |l| l.max_deadline_seconds = 0,
        |l| l.max_request_bytes_in_flight = 2 * l.max_message_bytes as u64 - 1,
        |l| l.max_pairs_in_flight = l.max_pairs_per_request - 1,
        |l| l.max_points_per_hull = l.max_vertices_per_hull - 1,
        |l| l.max_memory_bytes = (256 << 20) - 1,
        |l| l.max_memory_bytes = l.least_memory_bytes() - 1,
        |l| l.max_memory_bytes = u64::MAX,
        |l| l.max_message_bytes = (2 << 30) + 1,
    ];
    for store_seconds in [1, 3600] {
        assert_eq!(Limits { store_seconds, ..Limits::default() }.contradiction(), None);
    }
    for spoil in spoils {
        let mut limits = Limits::default();
        assert_eq!(limits.contradiction(), None);
        spoil(&mut limits);
        let why = limits.contradiction().unwrap_or_else(|| panic!("{limits:?}"));
        let (name, rest) = why.split_once(" is ").expect(&why);
        assert!(format!("{limits:?}").contains(name) && rest.contains(", must be "), "{why}");
    }
    let exact = |message: usize| Limits {
        max_message_bytes: message,
        max_memory_bytes: Limits { max_message_bytes: message, ..Limits::default() }.least_memory_bytes(),
        max_request_bytes_in_flight: 2 * message as u64,
        ..Limits::default()
    };
    assert_eq!(exact(64 << 20).contradiction(), None);
    let why = Limits { max_memory_bytes: 512 << 20, ..Limits::default() }.contradiction().unwrap();
    assert!(
        why.starts_with("max_memory_bytes is 512 MiB, must be at least 929 MiB (twice the largest"),
        "{why}"
    );
    for other in
        ["max_message_bytes (64 MiB)", "max_points_per_hull (262144)", "max_hulls_per_request (16384)"]
    {
        assert!(why.contains(other), "{why}");
    }
    let why = Limits { max_message_bytes: 1023, ..Limits::default() }.contradiction().unwrap();
    assert_eq!(why, "max_message_bytes is 1023 bytes, must be 1 KiB to 2 GiB");
}

/// The largest definition and the largest groups of small ones, with the least budget that their limits
/// allow. Catches a registration that is TOO_BUSY for ever although nothing else runs.
#[tokio::test(flavor = "multi_thread")]
async fn the_largest_registrations_fit_into_the_least_budget() {
    let points = 150_000;
    for max_points_per_hull in [points as u32, 60] {
        let mut limits = Limits {
            max_message_bytes: 24 * points + 100,
            max_points_per_hull,
            max_vertices_per_hull: 60,
            ..Limits::default()
        };
        limits.max_memory_bytes = limits.least_memory_bytes();
        assert!(max_points_per_hull < 1000 || limits.largest_request_bytes() > 64 << 20);
        let server = TestServer::with_limits(limits.clone()).await;
        let definition = |count: usize, seed| {
            let mut points = round_points(60, seed);
            // Points inside the hull are no vertices, so that it is built fast.
            points.extend((60..count).map(|i| [1e-6 * i as f64, 0.0, 0.0]));
            plain(points)
        };
        let count = max_points_per_hull as usize;
        let shapes: Vec<_> = (0..points / count).map(|i| definition(count, i as u64 % 50)).collect();
        let request = register_request(&shapes);
        let length = request.encoded_len();
        assert!(length <= limits.max_message_bytes || max_points_per_hull == 60, "{length}");
        let mut request = request;
        while request.encoded_len() > limits.max_message_bytes {
            request.hulls.pop();
        }
        let results = server.hulls().register_hulls(request).await.unwrap().into_inner().results;
        assert!(!results.is_empty());
        assert!(results.iter().all(|result| matches!(result.result, Some(Registered::Hull(_)))));
    }
}

//! The hull service from a client's point of view: identity, one result per hull, the store and the
//! cache.

use std::{
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use hullcast::{
    contact::{ConvexHull, Simplification},
    proto::{
        DeleteHullsRequest, GetHullsRequest, GetHullsResponse, HasHullsRequest, HullError, HullInfo,
        ListHullsRequest, RegisterHullsRequest, register_hull_result::Result as Registered,
    },
    service::Limits,
    store::{HullDefinition, blobs, identity::id_of},
};
use serde_json::Value;

use crate::support::{
    Setup, TestServer, channel, refusal, refused,
    scenes::{
        ALL, assert_same, box_points, expected, id, outputs, plain, register_request, round_points, scene,
        shapes, two_boxes, wire_hull,
    },
    store::FaultyStore,
};

async fn register(server: &TestServer, request: RegisterHullsRequest) -> Vec<Result<HullInfo, HullError>> {
    let response = server.hulls().register_hulls(request).await.unwrap().into_inner();
    let result = |result: hullcast::proto::RegisterHullResult| match result.result.unwrap() {
        Registered::Hull(info) => Ok(info),
        Registered::Error(error) => Err(error),
    };
    response.results.into_iter().map(result).collect()
}

async fn get(server: &TestServer, ids: Vec<Vec<u8>>, paths: &[&str]) -> GetHullsResponse {
    let paths = paths.iter().map(|path| path.to_string()).collect();
    let request = GetHullsRequest { ids, field_mask: Some(prost_types::FieldMask { paths }) };
    server.hulls().get_hulls(request).await.unwrap().into_inner()
}

async fn has(server: &TestServer, ids: Vec<Vec<u8>>) -> Vec<bool> {
    server.hulls().has_hulls(HasHullsRequest { ids }).await.unwrap().into_inner().present
}

async fn delete(server: &TestServer, ids: Vec<Vec<u8>>) -> Vec<bool> {
    server.hulls().delete_hulls(DeleteHullsRequest { ids }).await.unwrap().into_inner().deleted
}

/// Registers the test vectors of docs/identity.md, which a client in any language can be tested
/// with. Catches an identity that differs from the documented one.
#[tokio::test(flavor = "multi_thread")]
async fn ids_are_those_of_the_document() {
    let document = include_str!("../../docs/identity.md");
    let (_, rest) = document.split_once("```json\n").expect("the vectors");
    let (json, _) = rest.split_once("```").unwrap();
    let vectors: Value = serde_json::from_str(json).unwrap();
    let vectors = vectors.as_array().unwrap();
    assert_eq!(vectors.len(), 8);
    let numbers = |value: &Value| -> Vec<f64> {
        value.as_array().map_or(vec![], |list| list.iter().map(|x| x.as_f64().unwrap()).collect())
    };
    let server = TestServer::start().await;
    for vector in vectors {
        let wire = hullcast::proto::HullDefinition {
            vertices: numbers(&vector["vertices"]),
            contraction_point: numbers(&vector["contraction_point"]),
            simplification: vector.get("max_vertices").map(|most| hullcast::proto::Simplification {
                max_vertices: most.as_u64().map(|most| most as u32),
                max_deviation: vector["max_deviation"].as_f64(),
            }),
            planarity: vector["planarity"].as_f64(),
        };
        let info = register(&server, RegisterHullsRequest { hulls: vec![wire] }).await.remove(0).unwrap();
        let id: String = info.id.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(vector["id"], id, "{}", vector["name"]);
        if let Some(bytes) = vector["bytes"].as_str() {
            let bytes: Vec<u8> = (0..bytes.len() / 2)
                .map(|i| u8::from_str_radix(&bytes[2 * i..2 * i + 2], 16).unwrap())
                .collect();
            assert_eq!(id_of(&bytes).to_string(), id, "{}", vector["name"]);
        }
    }
}

/// Catches options that are not those of the registration, an answer for the whole hull when the
/// simplified one was asked for (at once, or read back from the store), a deviation that is not
/// returned, and indices that are not those of the registered points.
#[tokio::test(flavor = "multi_thread")]
async fn simplified_hulls_are_registered_and_answered_for() {
    let store = blobs::open("memory://").unwrap();
    let server = Setup { store: store.clone(), ..Setup::default() }.start().await;
    // The second server has no cached hull.
    let reader = Setup { store, ..Setup::default() }.start().await;
    let points = round_points(200, 9);
    let wanted = |max_vertices, max_deviation| Some(Simplification { max_vertices, max_deviation });
    let cases = [wanted(Some(20), None), wanted(None, Some(0.1)), wanted(Some(100), Some(0.2)), None];
    let shapes = cases.map(|simplification| HullDefinition {
        points: points.clone(),
        simplification,
        ..HullDefinition::default()
    });
    let infos = register(&server, register_request(&shapes)).await;
    for (shape, info) in shapes.iter().zip(infos) {
        let (info, built) = (info.unwrap(), shape.build(usize::MAX).unwrap());
        assert_eq!(info.id, id(shape));
        assert_eq!((info.vertex_count, info.registered_count), (built.vertex_count() as u32, 200));
        assert_eq!(info.deviation, built.deviation());
        assert_eq!(info.deviation > 0.0, shape.simplification.is_some());
        let mut request = scene(std::slice::from_ref(shape), 12, 60, 4);
        request.outputs = outputs(&ALL);
        for server in [&server, &reader] {
            let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
            assert_same(&answer, &expected(&request, std::slice::from_ref(shape)));
        }
    }
    let refusals = [
        (wanted(Some(3), None), "SIMPLIFICATION_OUT_OF_RANGE", "simplification"),
        (wanted(None, Some(f64::NAN)), "SIMPLIFICATION_OUT_OF_RANGE", "simplification"),
        (wanted(Some(4), Some(1e-3)), "SIMPLIFICATION_NOT_POSSIBLE", "simplification"),
    ];
    for (simplification, reason, field) in refusals {
        let shape = HullDefinition { simplification, ..shapes[0].clone() };
        let error = register(&server, register_request(&[shape])).await.remove(0).unwrap_err();
        assert_eq!((&*error.reason, &*error.field), (reason, field));
    }
}

/// Catches one bad hull that makes the others fail, and an error without its own reason.
#[tokio::test(flavor = "multi_thread")]
async fn every_hull_has_a_result_of_its_own() {
    let server = TestServer::start().await;
    let good = plain(box_points(1.0, 1.0, 1.0));
    let mut nan = good.clone();
    nan.points[5][1] = f64::NAN;
    let flat = plain(vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]);
    let line = plain((0..5).map(|i| [i as f64, 0.0, 0.0]).collect());
    let three = plain(vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    let huge = plain(box_points(1e60, 1e60, 1e60));
    let outside = HullDefinition { contraction_point: Some([2.0, 0.0, 0.0]), ..good.clone() };
    let cases: [(&HullDefinition, &str, &str, Option<u32>); 6] = [
        (&nan, "NOT_FINITE", "vertices", Some(5)),
        (&flat, "COPLANAR", "vertices", None),
        (&line, "COLLINEAR", "vertices", None),
        (&three, "TOO_FEW_POINTS", "vertices", None),
        (&huge, "SIZE_OUT_OF_RANGE", "vertices", None),
        (&outside, "CONTRACTION_POINT_NOT_INSIDE", "contraction_point", None),
    ];
    let mut request = RegisterHullsRequest::default();
    for (bad, ..) in &cases {
        request.hulls.push(wire_hull(&good));
        request.hulls.push(wire_hull(bad));
    }
    let mut torn = wire_hull(&good);
    torn.vertices.pop();
    let mut two = wire_hull(&good);
    two.contraction_point = vec![0.0, 0.0];
    let planarities = [(-1e-9, "-1e-9"), (0.011, "0.011"), (f64::INFINITY, "inf"), (f64::NAN, "NaN")];
    let bent =
        planarities.map(|(planarity, _)| HullDefinition { planarity: Some(planarity), ..good.clone() });
    request.hulls.extend([torn, two]);
    request.hulls.extend(bent.iter().map(wire_hull));

    let results = register(&server, request).await;
    assert_eq!(results.len(), 18);
    for (i, (_, reason, field, index)) in cases.into_iter().enumerate() {
        assert_eq!(results[2 * i].as_ref().unwrap().id, id(&good));
        let error = results[2 * i + 1].as_ref().unwrap_err();
        assert_eq!((&error.reason[..], &error.field[..]), (reason, field), "{error:?}");
        if index.is_some() {
            assert_eq!(error.index, index, "{error:?}");
        }
        assert!(!error.message.is_empty());
    }
    for (result, (_, shown)) in results[14..].iter().zip(planarities) {
        let error = result.as_ref().unwrap_err();
        assert_eq!((&*error.reason, &*error.field), ("PLANARITY_OUT_OF_RANGE", "planarity"));
        assert!(
            error.message.contains(&format!("is {shown},")) && error.message.contains("0 to 0.01"),
            "{error:?}"
        );
    }
    for (result, field) in results[12..14].iter().zip(["vertices", "contraction_point"]) {
        let error = result.as_ref().unwrap_err();
        assert_eq!((&error.reason[..], &error.field[..]), ("MALFORMED", field));
    }
    let stored = server.hulls().list_hulls(ListHullsRequest::default()).await.unwrap().into_inner();
    assert_eq!(stored.hulls.len(), 1, "a refused hull is not stored");
}

/// A request so large that it is registered in several steps, with known, malformed and flat hulls
/// among the new ones. Catches results that are out of order, lost or of another hull.
#[tokio::test(flavor = "multi_thread")]
async fn a_large_request_is_answered_in_order() {
    let server = TestServer::start().await;
    // Many points, of which only eight are vertices.
    let shape = |i: u32| {
        let mut points = box_points(1.0 + f64::from(i), 1.0, 1.0);
        points.resize(9000, [0.0; 3]);
        plain(points)
    };
    let shapes: Vec<_> = (0..24).map(shape).collect();
    register(&server, register_request(&[shapes[3].clone(), shapes[17].clone()])).await;
    let mut request = register_request(&shapes);
    request.hulls[7].vertices.pop();
    request.hulls[20].vertices.fill(0.0);
    let results = register(&server, request).await;
    assert_eq!(results.len(), shapes.len());
    for (i, (result, shape)) in results.iter().zip(&shapes).enumerate() {
        match (i, result) {
            (7, Err(error)) => assert_eq!(error.reason, "MALFORMED"),
            (20, Err(error)) => assert_eq!(error.reason, "TOO_FEW_POINTS"),
            (_, Ok(info)) => assert_eq!(info.id, id(shape), "{i}"),
            (_, Err(error)) => panic!("{i}: {error:?}"),
        }
    }
}

/// Registers the same hull twice, twice in one request, and from many connections at once. Catches
/// registration that is not idempotent.
#[tokio::test(flavor = "multi_thread")]
async fn registering_again_changes_nothing() {
    let server = TestServer::start().await;
    let shape = plain(round_points(30, 9));
    let first = register(&server, register_request(&[shape.clone(), shape.clone()])).await;
    let mut calls = Vec::new();
    for _ in 0..8 {
        let mut hulls =
            hullcast::proto::hull_service_client::HullServiceClient::new(channel(&server.address).await);
        let request = register_request(std::slice::from_ref(&shape));
        calls.push(tokio::spawn(async move { hulls.register_hulls(request).await.unwrap().into_inner() }));
    }
    let info = first[0].as_ref().unwrap();
    assert_eq!(first[1].as_ref().unwrap(), info);
    for call in calls {
        let result = call.await.unwrap().results.remove(0).result.unwrap();
        assert_eq!(result, Registered::Hull(info.clone()));
    }
    let stored = server.hulls().list_hulls(ListHullsRequest::default()).await.unwrap().into_inner();
    assert_eq!(stored.hulls.len(), 1);
    assert_eq!(stored.next_page_token, "");
}

/// Catches a property of a hull in the wrong field, and vertices whose bits change between
/// registering and getting.
#[tokio::test(flavor = "multi_thread")]
async fn hulls_come_back_as_the_library_has_them() {
    let server = TestServer::start().await;
    // A duplicate, an interior point and a negative zero, which are registered but not kept as they
    // are.
    let mut odd = plain(box_points(0.1, 0.3, 0.7));
    odd.points.insert(2, [0.0; 3]);
    odd.points.push(odd.points[0]);
    let mut zero = plain(round_points(20, 3));
    zero.points[4] = [-0.0, 2.0, -0.0];
    // A hull merged with an unusual planarity, so that an answer for the hull without it would
    // differ.
    let merged = HullDefinition { planarity: Some(0.01), ..plain(round_points(200, 4)) };
    let shapes = [shapes(), vec![odd, zero, merged]].concat();
    let infos = register(&server, register_request(&shapes)).await;
    let ids: Vec<_> = shapes.iter().map(id).collect();
    let records = get(&server, ids.clone(), &["info", "vertices", "faces"]).await.hulls;
    assert_eq!(records.len(), shapes.len());
    for (((shape, info), record), id) in shapes.iter().zip(&infos).zip(&records).zip(&ids) {
        let hull: ConvexHull = shape.build(usize::MAX).unwrap();
        let info = info.as_ref().unwrap();
        assert!(record.found && record.id == *id && record.info.as_ref() == Some(info));
        assert_eq!(info.contraction_point, hull.contraction_point().to_array());
        assert_eq!(info.vertex_count as usize, hull.vertex_count());
        assert_eq!(info.face_count as usize, hull.face_count());
        assert_eq!(info.edge_count as usize, hull.edge_count());
        assert_eq!(info.registered_count as usize, shape.points.len());
        assert_eq!(info.volume, hull.volume());
        assert_eq!(info.center_of_mass, hull.center_of_mass().to_array());
        let inertia = hull.inertia().to_cols_array_2d();
        let [[xx, xy, xz], [_, yy, yz], [_, _, zz]] = inertia;
        assert_eq!(info.inertia, [xx, yy, zz, xy, xz, yz]);
        assert_eq!(info.inradius, hull.inradius());
        assert_eq!(info.circumradius, hull.circumradius());
        assert_eq!(info.geometric_error, hull.geometric_error());
        assert_eq!(info.planarity, shape.planarity.unwrap_or(1e-6));

        assert_eq!(record.vertex_indices, hull.registered_indices());
        let bits = |x: &f64| (x + 0.0).to_bits();
        let kept: Vec<u64> = record
            .vertex_indices
            .iter()
            .flat_map(|&i| shape.points[i as usize].iter().map(bits).collect::<Vec<_>>())
            .collect();
        assert_eq!(record.vertices.iter().map(|x| x.to_bits()).collect::<Vec<_>>(), kept);
        assert_eq!(record.face_offsets.len(), hull.face_count() + 1);
        for face in 0..hull.face_count() {
            let range = record.face_offsets[face] as usize..record.face_offsets[face + 1] as usize;
            assert_eq!(record.face_vertices[range], hull.face_outline(face).collect::<Vec<_>>());
            assert_eq!(record.face_normals[3 * face..][..3], hull.face_normal(face).to_array());
        }
    }
    // Only the parts that the mask names are sent.
    let info = &get(&server, ids[..1].to_vec(), &[]).await.hulls[0];
    assert!(info.info.is_some() && info.vertices.is_empty() && info.face_offsets.is_empty());
    let faces = &get(&server, ids[..1].to_vec(), &["faces"]).await.hulls[0];
    assert!(faces.info.is_none() && faces.vertices.is_empty() && !faces.face_offsets.is_empty());
    let vertices = &get(&server, ids[..1].to_vec(), &["vertices"]).await.hulls[0];
    assert!(vertices.info.is_none() && !vertices.vertices.is_empty() && vertices.face_offsets.is_empty());
    // A missing hull is reported as such, in its place.
    let mixed = get(&server, vec![vec![1; 32], ids[0].clone(), vec![2; 32]], &[]).await.hulls;
    assert_eq!(mixed.iter().map(|record| record.found).collect::<Vec<_>>(), [false, true, false]);
    assert!(mixed[0].info.is_none());
}

/// Catches a deleted hull that still gets answers, and one that cannot be registered again.
#[tokio::test(flavor = "multi_thread")]
async fn deleted_is_gone_until_registered_again() {
    let server = TestServer::start().await;
    let (shapes, request) = two_boxes();
    register(&server, register_request(&shapes)).await;
    let it = id(&shapes[0]);
    assert_eq!(has(&server, vec![it.clone(), vec![0; 32]]).await, [true, false]);
    assert_eq!(delete(&server, vec![it.clone(), vec![0; 32], it.clone()]).await, [true, false, false]);
    assert_eq!(has(&server, vec![it.clone()]).await, [false]);
    let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
    assert_eq!((answer.missing_hulls, answer.flags), (vec![0], vec![16]));
    register(&server, register_request(&shapes)).await;
    let answer = server.contacts().query_contacts(request).await.unwrap().into_inner();
    assert_eq!((answer.missing_hulls, answer.flags), (vec![], vec![0]));
}

/// Catches a hull that another server deleted and that this server still uses after its cache age,
/// or registers without writing it.
#[tokio::test(flavor = "multi_thread")]
async fn another_servers_deletion_is_seen_within_the_cache_age() {
    let store = blobs::open("memory://").unwrap();
    let limits = Limits { cache_age_seconds: 1, ..Limits::default() };
    let start = || Setup { store: store.clone(), limits: limits.clone(), ..Setup::default() }.start();
    let (here, there) = (start().await, start().await);
    let (shapes, request) = two_boxes();
    register(&here, register_request(&shapes)).await;
    let it = vec![id(&shapes[0])];
    assert_eq!(delete(&there, it.clone()).await, [true]);
    // The other server deleted the hull and this one registers it again. The cached copy by itself must not
    // count as stored.
    register(&here, register_request(&shapes)).await;
    assert_eq!(has(&there, it.clone()).await, [true]);
    assert_eq!(delete(&there, it.clone()).await, [true]);
    tokio::time::sleep(Duration::from_millis(1100)).await;
    let answer = here.contacts().query_contacts(request).await.unwrap().into_inner();
    assert_eq!(answer.flags, [16]);
    assert_eq!(has(&here, it).await, [false]);
}

/// Catches a corrupted blob that is served or counted as present, and one that a new registration
/// does not repair.
#[tokio::test(flavor = "multi_thread")]
async fn a_corrupted_blob_is_never_served_and_can_be_repaired() {
    let directory = tempfile::tempdir().unwrap();
    let open = || blobs::open(directory.path().to_str().unwrap()).unwrap();
    let (shapes, request) = two_boxes();
    let it = id(&shapes[0]);
    let first = Setup { store: open(), ..Setup::default() }.start().await;
    register(&first, register_request(&shapes)).await;
    let name: String = it.iter().map(|byte| format!("{byte:02x}")).collect();
    let file = directory.path().join(&name[..2]).join(&name);
    let good = std::fs::read(&file).unwrap();
    assert_eq!(good, shapes[0].identity_bytes(), "the blob is the identity bytes");

    let flipped: Vec<u8> = good.iter().enumerate().map(|(i, b)| if i == 30 { b ^ 4 } else { *b }).collect();
    // Another hull's bytes under this name, one flipped bit, a truncated blob, an empty one.
    let other = plain(round_points(10, 1)).identity_bytes();
    for bad in [&other[..], &flipped, &good[..good.len() - 8], &[]] {
        std::fs::write(&file, bad).unwrap();
        let server = Setup { store: open(), ..Setup::default() }.start().await;
        let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
        assert_eq!((&answer.outcomes[..], &answer.flags[..]), (&[4][..], &[16][..]));
        assert_eq!(has(&server, vec![it.clone()]).await, [false]);
        assert!(!get(&server, vec![it.clone()], &[]).await.hulls[0].found);
        register(&server, register_request(&shapes)).await;
        assert_eq!(std::fs::read(&file).unwrap(), good);
        let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
        assert_eq!(answer.flags, [0]);
    }
}

/// 32 calls need the same hull at once: it must be read once. Catches a read per call, a store that
/// is listed at the start, and a cache without effect.
#[tokio::test(flavor = "multi_thread")]
async fn a_hull_is_read_once_however_many_ask() {
    let store = FaultyStore::new();
    let (shapes, request) = two_boxes();
    let first = Setup { store: store.clone(), ..Setup::default() }.start().await;
    register(&first, register_request(&shapes)).await;
    assert_eq!(store.reads.load(Ordering::SeqCst), 0);

    let server = Setup { store: store.clone(), ..Setup::default() }.start().await;
    let calls: Vec<_> = (0..32)
        .map(|_| {
            let (mut contacts, request) = (server.contacts(), request.clone());
            tokio::spawn(async move { contacts.query_contacts(request).await.unwrap().into_inner() })
        })
        .collect();
    for call in calls {
        assert_eq!(call.await.unwrap().flags, [0]);
    }
    assert_eq!(store.reads.load(Ordering::SeqCst), 1);
    assert_eq!(store.listings.load(Ordering::SeqCst), 0);
}

/// Catches a cache that grows past its limit, however many hulls pass through it.
#[tokio::test(flavor = "multi_thread")]
async fn the_cache_stays_within_its_bytes() {
    let limits = Limits { cache_bytes: 200_000, ..Limits::default() };
    let server = TestServer::with_limits(limits.clone()).await;
    let shapes: Vec<_> = (0..100).map(|seed| plain(round_points(50, seed))).collect();
    let heap: usize = shapes.iter().map(|shape| shape.build(usize::MAX).unwrap().heap_bytes()).sum();
    assert!(heap as u64 > 3 * limits.cache_bytes, "all hulls fit in the cache: {heap}");
    register(&server, register_request(&shapes)).await;
    let mut most = 0;
    for seed in 0..30 {
        // One caller may use half of the cache.
        let shapes = &shapes[seed * 3..][..4];
        let request = scene(shapes, 20, 30, seed as u64);
        let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
        assert!(answer.missing_hulls.is_empty());
        most = most.max(server.app.registry().cached_bytes());
        assert!(most <= limits.cache_bytes, "{most}");
    }
    assert!(most > limits.cache_bytes / 2, "the cache is nearly empty: {most}");
}

/// Catches a full store that refuses a hull it already has, or loses one.
#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_is_store_full() {
    let store = FaultyStore::new();
    let server = Setup { store: store.clone(), ..Setup::default() }.start().await;
    let (shapes, request) = two_boxes();
    register(&server, register_request(&shapes)).await;
    store.full.store(true, Ordering::SeqCst);
    register(&server, register_request(&shapes)).await;
    let other = register_request(&[plain(round_points(10, 1))]);
    let status = server.hulls().register_hulls(other).await.unwrap_err();
    assert_eq!(refusal(&status), refused(tonic::Code::ResourceExhausted, "STORE_FULL", ""));
    assert_eq!(server.contacts().query_contacts(request).await.unwrap().into_inner().flags, [0]);
}

/// Catches a store URL that is mistaken for a directory's name, and a store that fails only when it is
/// used.
#[test]
fn stores_that_cannot_be_opened_say_why() {
    for (url, said) in [("s3://bucket", "feature \"s3\""), ("gopher://x", "unknown scheme")] {
        let error = blobs::open(url).expect_err(url).to_string();
        assert!(error.contains(said) && error.contains(url), "{error}");
    }
    let file = tempfile::NamedTempFile::new().unwrap();
    let path = file.path().to_str().unwrap();
    assert!(blobs::open(path).is_err(), "a file was opened as a directory");
    assert!(blobs::open(&format!("file://{path}")).is_err());
    let directory = tempfile::tempdir().unwrap();
    let inner = directory.path().join("made/on demand");
    let _: Arc<_> = blobs::open(&format!("file://{}", inner.display())).unwrap();
    assert!(inner.is_dir());
}

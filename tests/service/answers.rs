//! Every answer equals the library's bit for bit, for every split of the batch and any number of
//! threads, unary and streamed.

use hullcast::{
    proto::{Accuracy, Output, QueryContactsRequest, Solver},
    service::Limits,
    store::HullDefinition,
};

use crate::support::{
    Setup, TestServer,
    scenes::{
        ALL, Random, append, assert_same, expected, id, outputs, plain, register_request, round_points,
        scene, shapes, two_boxes,
    },
};

/// A server on which all shapes are registered.
async fn with_shapes(threads: usize) -> TestServer {
    let server = Setup { threads, ..Setup::default() }.start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    server
}

/// Batch sizes around every change of the way in which a batch is computed: no pair, on the calling
/// task, one chunk, several chunks, more chunks than threads.
const SIZES: [usize; 12] = [0, 1, 2, 31, 32, 33, 63, 64, 65, 128, 129, 1000];

/// Catches pairs that are lost, duplicated or reordered when a batch is split, and a workspace that
/// carries something over from one pair to the next.
#[tokio::test(flavor = "multi_thread")]
async fn every_batch_split_and_thread_count_gives_the_librarys_bits() {
    let mut outcomes = [0usize; 5];
    let mut answered = 0;
    for threads in [1, 2, 5] {
        let server = with_shapes(threads).await;
        let requests: Vec<_> = SIZES
            .iter()
            .zip(1..)
            .map(|(&pairs, seed)| QueryContactsRequest {
                outputs: outputs(&ALL),
                ..scene(&shapes(), 40, pairs, seed)
            })
            .collect();
        let mut streamed = server
            .contacts()
            .stream_contacts(futures_util::stream::iter(requests.clone()))
            .await
            .unwrap()
            .into_inner();
        for request in requests {
            let expected = expected(&request, &shapes());
            let unary = server.contacts().query_contacts(request).await.unwrap().into_inner();
            assert_same(&unary, &expected);
            assert_same(
                &streamed.message().await.unwrap().expect("the stream has one answer per request"),
                &expected,
            );
            for &outcome in &unary.outcomes {
                outcomes[outcome as usize] += 1;
            }
            answered += 1;
        }
        assert_eq!(streamed.message().await.unwrap(), None);
    }
    assert_eq!(answered, 3 * SIZES.len());
    let [none, contact, separated, _, invalid] = outcomes;
    assert!(none == 0 && invalid == 0, "{outcomes:?}");
    assert!(contact > 500 && separated > 500, "the scenes have too few pairs of one outcome: {outcomes:?}");
}

/// Catches an option that does not reach the library, and outputs that are computed or sent
/// although the request did not ask for them.
#[tokio::test(flavor = "multi_thread")]
async fn every_option_and_output_reaches_the_library() {
    let server = with_shapes(2).await;
    let mut masks: Vec<Vec<i32>> = ALL.iter().map(|&output| outputs(&[output])).collect();
    // The masks are the default, all outputs, a known value together with a value of a newer
    // contract, and only the unspecified value.
    masks.extend([vec![], outputs(&ALL), vec![Output::Alpha as i32, 1000], vec![0]]);
    let accuracies = [
        None,
        Some(Accuracy { solver: Solver::Portal as i32, relative_tolerance: 0.01, ..Accuracy::default() }),
        Some(Accuracy { solver: Solver::GjkRayCast as i32, feature_angle: Some(0.0), ..Accuracy::default() }),
        Some(Accuracy { max_points: 2, feature_angle: Some(0.5), ..Accuracy::default() }),
    ];
    let mut cases = 0;
    for (mask, seed) in masks.iter().zip(100..) {
        for accuracy in accuracies {
            for margin in [0.0, 0.2, f64::INFINITY] {
                let request = QueryContactsRequest {
                    margin,
                    accuracy,
                    outputs: mask.clone(),
                    ..scene(&shapes(), 12, 20, seed)
                };
                let expected = expected(&request, &shapes());
                let found = server.contacts().query_contacts(request).await.unwrap().into_inner();
                assert_same(&found, &expected);
                cases += 1;
            }
        }
    }
    assert_eq!(cases, 15 * 4 * 3);
}

/// Splits a scene into parts of several sizes and joins the answers; they must equal the answer to
/// the whole scene. Catches an answer that depends on the pair's position in the batch.
#[tokio::test(flavor = "multi_thread")]
async fn the_parts_of_a_batch_are_the_batch() {
    let server = with_shapes(3).await;
    let whole = scene(&shapes(), 50, 500, 7);
    let answer = server.contacts().query_contacts(whole.clone()).await.unwrap().into_inner();
    for size in [1, 7, 64, 100, 499] {
        let mut joined = hullcast::proto::QueryContactsResponse::default();
        for pairs in whole.pairs.chunks(2 * size) {
            let part = QueryContactsRequest { pairs: pairs.to_vec(), ..whole.clone() };
            let part = server.contacts().query_contacts(part).await.unwrap().into_inner();
            (joined.request_id, joined.contract) = (part.request_id, part.contract);
            append(&mut joined, part);
        }
        assert_same(&joined, &answer);
    }
}

/// Catches warm starts that are assigned to the wrong pair, and a malformed warm start that fails
/// the call or changes an answer; it must only cost a cold start.
#[tokio::test(flavor = "multi_thread")]
async fn warm_starts_are_the_librarys_and_malformed_ones_cost_nothing_else() {
    let server = with_shapes(2).await;
    let cold = QueryContactsRequest { outputs: outputs(&ALL), ..scene(&shapes(), 30, 200, 11) };
    let first = server.contacts().query_contacts(cold.clone()).await.unwrap().into_inner();
    let warm = QueryContactsRequest { warm_starts: first.bases.clone(), ..cold.clone() };
    let answer = server.contacts().query_contacts(warm.clone()).await.unwrap().into_inner();
    assert_same(&answer, &expected(&warm, &shapes()));
    assert!(first.bases.iter().any(|&vertex| vertex != u32::MAX), "no pair has a basis to start from");

    let mut random = Random::new(3);
    let useless = [5, 59, 60, 1000, u32::MAX - 1, u32::MAX];
    let warm_starts = first.bases.iter().map(|_| useless[random.below(useless.len())]).collect();
    let odd = QueryContactsRequest { warm_starts, ..cold };
    let answer = server.contacts().query_contacts(odd.clone()).await.unwrap().into_inner();
    assert_same(&answer, &expected(&odd, &shapes()));
    assert_eq!(answer.outcomes, first.outcomes);
}

/// Every unusable body or hull must be reported, its pairs answered INVALID with NaN, and all other
/// pairs answered as if it were absent. Catches an unusable body or hull that affects pairs of
/// other bodies, and one that is not reported.
#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_pair_costs_no_other() {
    let server = with_shapes(2).await;
    let good = QueryContactsRequest { outputs: outputs(&ALL), ..scene(&shapes(), 30, 300, 13) };
    let whole = server.contacts().query_contacts(good.clone()).await.unwrap().into_inner();

    // Bodies 3 to 6 are unusable, each in another way.
    let mut request = good.clone();
    request.positions[3 * 3] = f64::NAN;
    request.positions[3 * 4 + 1] = 1.1e100;
    request.rotations[4 * 5..4 * 6].fill(0.0);
    request.rotations[4 * 6..4 * 7].copy_from_slice(&[0.0, 0.0, 0.0, 4.002]);
    let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
    assert_same(&answer, &expected(&request, &shapes()));
    assert_eq!(answer.invalid_bodies, [3, 4, 5, 6]);

    // Hull 2 is not registered.
    let mut request = good.clone();
    request.hull_ids[2] = vec![0xab; 32];
    let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
    assert_eq!(answer.missing_hulls, [2]);
    let mut points = (0, 0);
    let mut kept = 0;
    for (pair, bodies) in request.pairs.chunks(2).enumerate() {
        let missing = bodies.iter().any(|&body| request.body_hulls[body as usize] == 2);
        let counts = (answer.point_counts[pair] as usize, whole.point_counts[pair] as usize);
        if missing {
            assert_eq!((answer.outcomes[pair], answer.flags[pair]), (4, 16), "INVALID, UNKNOWN_HULL");
            assert!(answer.alphas[pair].is_nan() && answer.alpha_lowers[pair].is_nan());
            assert!(answer.alpha_uppers[pair].is_nan() && answer.separations[pair].is_nan());
            assert!(answer.normals[3 * pair..][..3].iter().all(|c| c.is_nan()));
            assert_eq!(counts.0, 0);
            assert_eq!(answer.bases[6 * pair..][..6], [u32::MAX; 6]);
        } else {
            assert_eq!(answer.outcomes[pair], whole.outcomes[pair]);
            assert_eq!(answer.alphas[pair].to_bits(), whole.alphas[pair].to_bits());
            assert_eq!(counts.0, counts.1);
            assert_eq!(
                answer.witness_as[3 * points.0..][..3 * counts.0],
                whole.witness_as[3 * points.1..][..3 * counts.1]
            );
            kept += 1;
        }
        points = (points.0 + counts.0, points.1 + counts.1);
    }
    assert!((50..300).contains(&kept), "too few pairs of one kind: {kept}");
}

/// Alternates between two scenes on a server whose cache has room for only one scene's hulls.
/// Catches an answer that depends on the contents of the cache, and a hull that is dropped while a
/// batch uses it.
#[tokio::test(flavor = "multi_thread")]
async fn a_cache_too_small_for_two_scenes_changes_no_bit() {
    let others: Vec<_> = (0..40).map(|seed| plain(round_points(40, 100 + seed))).collect();
    let bytes = async |shapes: &[HullDefinition], cache_bytes| {
        let server =
            TestServer::with_limits(Limits { cache_bytes, shares: false, ..Limits::default() }).await;
        server.hulls().register_hulls(register_request(shapes)).await.unwrap();
        (server.app.registry().cached_bytes(), server)
    };
    let all = [shapes(), others.clone()].concat();
    let (room, _) = bytes(&others, 1 << 30).await;
    assert!(bytes(&shapes(), 1 << 30).await.0 < room);
    let (_, server) = bytes(&all, room).await;
    for round in 0..3 {
        for shapes in [&shapes(), &others] {
            let request = scene(shapes, 60, 200, 17 + round);
            let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
            assert_same(&answer, &expected(&request, shapes));
        }
    }
    let misses = server.metric("hullcast_cache_misses_total");
    assert!(misses > 10.0, "the scenes do not evict each other's hulls: {misses}");
}

/// Catches an id that the server computes in another way than the client, and a stream's answer
/// that does not belong to its request.
#[tokio::test(flavor = "multi_thread")]
async fn streams_answer_in_order_and_echo_the_request_id() {
    let (shapes, request) = two_boxes();
    let server = TestServer::start().await;
    let registered = server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let result = registered.into_inner().results.remove(0).result;
    let Some(hullcast::proto::register_hull_result::Result::Hull(info)) = result else {
        panic!("{result:?}")
    };
    assert_eq!(info.id, id(&shapes[0]));
    let requests: Vec<_> = (0..200)
        .map(|step| {
            let mut request = QueryContactsRequest { request_id: step, ..request.clone() };
            request.positions[5] = 0.5 + step as f64 / 100.0;
            request
        })
        .collect();
    let stream = futures_util::stream::iter(requests.clone());
    let mut answers = server.contacts().stream_contacts(stream).await.unwrap().into_inner();
    for request in requests {
        let answer = answers.message().await.unwrap().unwrap();
        assert_same(&answer, &expected(&request, &shapes));
    }
    assert_eq!(answers.message().await.unwrap(), None);
}

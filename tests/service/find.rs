//! Compares `FindContacts` with the exhaustive query of every pair that the rules allow to meet.

use std::collections::HashSet;

use hullcast::{
    budget::Caller,
    proto::{DeleteHullsRequest, Outcome, QueryContactsRequest, QueryContactsResponse},
    service::Limits,
    store::HullDefinition,
};
use prost::Message;
use tonic::Code;

use crate::support::{
    Setup, TestServer, invalid, refusal, refused,
    scenes::{
        ALL, Random, assert_same, box_points, id, outputs, plain, register_request, round_points, scene,
        shapes,
    },
    store::FaultyStore,
};

const EVERY_WORLD: u32 = u32::MAX;

/// All messages of a call.
pub(crate) async fn found(server: &TestServer, request: &QueryContactsRequest) -> Vec<QueryContactsResponse> {
    let mut stream = server.contacts().find_contacts(request.clone()).await.unwrap().into_inner();
    let mut messages = Vec::new();
    while let Some(message) = stream.message().await.unwrap() {
        messages.push(message);
    }
    assert!(!messages.is_empty(), "the first message always comes");
    messages
}

/// The messages joined into one. Only the first may name missing hulls and invalid bodies.
pub(crate) fn together(messages: &[QueryContactsResponse]) -> QueryContactsResponse {
    let mut whole = messages[0].clone();
    for message in &messages[1..] {
        assert_eq!(message.request_id, whole.request_id);
        assert!(message.missing_hulls.is_empty() && message.invalid_bodies.is_empty());
        assert!(!message.outcomes.is_empty());
        macro_rules! append {
            ($($column:ident)*) => { $(whole.$column.extend_from_slice(&message.$column);)* };
        }
        hullcast_batch::with_columns!(append);
    }
    whole
}

/// Whether the contract allows two bodies to meet, written directly from its wording.
fn may_meet(request: &QueryContactsRequest, a: usize, b: usize) -> bool {
    if let [v, w] = [a, b].map(|body| request.worlds.get(body).copied())
        && v.is_some()
    {
        match (v == Some(EVERY_WORLD), w == Some(EVERY_WORLD)) {
            (true, true) => return false,
            (false, false) if v != w => return false,
            _ => {}
        }
    }
    let [g, h] = [a, b].map(|body| request.groups.get(body).copied().unwrap_or(0));
    let ignored = request.ignored_groups.chunks(2).any(|two| two == [g, h] || two == [h, g]);
    g == 0 || h == 0 || (g != h && !ignored)
}

/// Queries every pair that may meet, and then those that are not separated: the pairs that must be
/// found. Also returns the number of pairs that may meet.
pub(crate) async fn exhaustive(
    server: &TestServer,
    request: &QueryContactsRequest,
) -> (QueryContactsResponse, usize) {
    let bodies = request.body_hulls.len();
    let pairs: Vec<u32> = (0..bodies)
        .flat_map(|a| (a + 1..bodies).map(move |b| (a, b)))
        .filter(|&(a, b)| may_meet(request, a, b))
        .flat_map(|(a, b)| [a as u32, b as u32])
        .collect();
    let plain =
        QueryContactsRequest { worlds: vec![], groups: vec![], ignored_groups: vec![], ..request.clone() };
    let mut near = Vec::new();
    for pairs in pairs.chunks(2 * 100_000) {
        let request = QueryContactsRequest { pairs: pairs.to_vec(), ..plain.clone() };
        let answer = server.contacts().query_contacts(request).await.unwrap().into_inner();
        let kept = pairs.chunks(2).zip(&answer.outcomes);
        let kept =
            kept.filter(|(_, outcome)| [Outcome::Contact as u8, Outcome::Undecided as u8].contains(outcome));
        near.extend(kept.flat_map(|(pair, _)| [pair[0], pair[1]]));
    }
    let request = QueryContactsRequest { pairs: near.clone(), ..plain };
    let mut expected = server.contacts().query_contacts(request).await.unwrap().into_inner();
    expected.pairs = near;
    (expected, pairs.len() / 2)
}

/// Bodies of `shapes[0]` at these positions, not rotated.
fn at(shapes: &[HullDefinition], positions: &[[f64; 3]]) -> QueryContactsRequest {
    QueryContactsRequest {
        hull_ids: shapes.iter().map(id).collect(),
        body_hulls: vec![0; positions.len()],
        positions: positions.as_flattened().to_vec(),
        rotations: [0.0, 0.0, 0.0, 1.0].repeat(positions.len()),
        outputs: outputs(&ALL),
        ..Default::default()
    }
}

fn grid(side: usize, step: f64, origin: [f64; 3]) -> Vec<[f64; 3]> {
    let place = |i: usize| [i % side, i / side % side, i / side / side];
    let position = |i| std::array::from_fn(|axis| origin[axis] + step * place(i)[axis] as f64);
    (0..side.pow(3)).map(position).collect()
}

/// Seeded crowds of all shapes, at three densities, with and without worlds, groups and margins.
fn crowds(shapes: &[HullDefinition]) -> Vec<QueryContactsRequest> {
    let mut scenes = Vec::new();
    for seed in 0..12 {
        let mut random = Random::new(100 + seed);
        let bodies = 150;
        let mut request = scene(shapes, bodies, 0, seed);
        let spread = [1.0, 3.0, 6.0][seed as usize % 3];
        request.positions.iter_mut().for_each(|x| *x *= spread);
        request.margin = [0.0, 0.05, 2.0, 1e-9][seed as usize % 4];
        request.outputs = outputs(&ALL);
        if seed % 2 == 1 {
            request.worlds =
                (0..bodies).map(|_| [0, 1, 2, 7, EVERY_WORLD, EVERY_WORLD - 1][random.below(6)]).collect();
        }
        if seed % 3 >= 1 {
            request.groups = (0..bodies).map(|_| random.below(9) as u32).collect();
        }
        if seed % 3 == 2 {
            request.ignored_groups = vec![1, 2, 5, 3, 5, 5, 2, 1, 8, 1000];
        }
        scenes.push(request);
    }
    scenes
}

/// Scenes in which bodies touch exactly, are exactly a margin apart, coincide, differ greatly in
/// size, or are so far from the origin that an ulp is larger than they are. With each scene the
/// number of pairs within the margin, if it is known.
fn degenerate(shapes: &[HullDefinition]) -> Vec<(QueryContactsRequest, Option<usize>)> {
    // Cubes of half extent 0.5: neighbours touch at faces, edges and corners.
    let neighbours = |side: usize| {
        let pairs = |n: usize| side.pow(3 - n as u32) * (side - 1).pow(n as u32);
        3 * pairs(1) + 3 * 2 * pairs(2) + 4 * pairs(3)
    };
    let mut scenes = vec![
        (at(shapes, &grid(5, 1.0, [0.0; 3])), Some(neighbours(5))),
        // Coordinates whose sums are exact.
        (at(shapes, &grid(5, 1.0, [2f64.powi(40), -2f64.powi(45), 2f64.powi(50)])), Some(neighbours(5))),
        (at(shapes, &[[1e-3, 2e-3, 3e-3]; 120]), Some(120 * 119 / 2)),
        (at(shapes, &[[1e100, -1e100, 1e100]; 60]), Some(60 * 59 / 2)),
        (at(shapes, &grid(4, 1e99, [0.0; 3])), Some(0)),
        (at(shapes, &[]), Some(0)),
        (at(shapes, &[[0.0; 3]]), Some(0)),
    ];
    // A gap of exactly the margin, one ulp more and one ulp less, which rounding may not
    // distinguish, and a gap that is clearly larger.
    let gap = 0.25;
    let step: f64 = 1.0 + gap;
    for (step, near) in [(step.next_down(), 144), (step, 144), (step.next_up(), 144), (step + 1e-9, 0)] {
        let request = QueryContactsRequest { margin: gap, ..at(shapes, &grid(4, step, [0.0; 3])) };
        scenes.push((request, Some(near)));
    }
    // Margins so large that every pair is within them.
    for margin in [1e101, f64::MAX] {
        let request = QueryContactsRequest { margin, ..at(shapes, &grid(3, 1e99, [0.0; 3])) };
        scenes.push((request, Some(27 * 26 / 2)));
    }
    // A margin below every normal number.
    let request = QueryContactsRequest { margin: 5e-324, ..at(shapes, &grid(3, 1.0, [0.0; 3])) };
    scenes.push((request, Some(neighbours(3))));
    // Pebbles of three shapes on a plate that is a million times as large.
    let mut random = Random::new(7);
    let mut positions = vec![[0.0; 3]];
    positions.extend((0..120).map(|_| [4e5 * random.signed(), 4e5 * random.signed(), 0.5 + random.signed()]));
    let mut request = at(shapes, &positions);
    request.body_hulls =
        (0..positions.len() as u32).map(|body| if body == 0 { 5 } else { body % 3 }).collect();
    scenes.push((request, None));
    scenes
}

/// Compares the pairs and the answers with those of the exhaustive query, bit for bit.
///
/// Catches a pair that the broad phase loses: a margin that is not fully added to the boxes, boxes
/// rounded inwards, the rounding band left out, a world or group mistaken for another, a body of
/// every world that misses one. Also catches a pair that is separated or not allowed to meet, and
/// an answer that differs from QueryContacts.
#[tokio::test(flavor = "multi_thread")]
async fn what_is_found_is_what_the_exhaustive_query_has() {
    let mut shapes = shapes();
    shapes.push(plain(box_points(5e5, 5e5, 0.5)));
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let crowds = crowds(&shapes[..5]).into_iter().map(|request| (request, None));
    let (mut asked, mut near, mut scenes, mut known) = (0, 0, 0, 0);
    for (request, count) in crowds.chain(degenerate(&shapes)) {
        let answer = together(&found(&server, &request).await);
        let (expected, pairs) = exhaustive(&server, &request).await;
        assert_eq!(answer.pairs.len(), expected.pairs.len(), "scene {scenes}");
        assert_same(&answer, &expected);
        if let Some(count) = count {
            assert_eq!(expected.outcomes.len(), count, "scene {scenes}");
            known += 1;
        }
        asked += pairs;
        near += expected.outcomes.len();
        scenes += 1;
    }
    println!("{scenes} scenes, {asked} pairs asked about one by one, {near} near each other, none missed");
    assert_eq!((scenes, known), (27, 14));
    assert!(asked > 120_000 && near > 20_000, "{near} of {asked}");
}

/// A crowd in which every pair meets, about 45,000 pairs in many messages. Catches messages that
/// lose or repeat a pair where they are cut, a body with more partners than fit in one message, and
/// candidates that are all held in memory at once.
#[tokio::test(flavor = "multi_thread")]
async fn crowded_scenes_come_in_pieces() {
    let shapes = [plain(box_points(0.5, 0.5, 0.5))];
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let mut request = at(&shapes, &[[0.25, 0.5, 0.125]; 300]);
    request.outputs = outputs(&ALL[..1]);
    let messages = found(&server, &request).await;
    assert!(messages.len() >= 10, "{}", messages.len());
    assert!(messages.iter().all(|message| message.outcomes.len() <= 4096));
    let every: Vec<u32> = (0..300).flat_map(|a| (a + 1..300).flat_map(move |b| [a, b])).collect();
    assert_eq!(together(&messages).pairs, every);

    // One ground shared by 2,000 worlds of five bodies each; two bodies of each world overlap.
    let mut positions = vec![[0.0; 3]];
    let mut worlds = vec![EVERY_WORLD];
    for world in 0..2000 {
        for body in 0..5 {
            positions.push([3.0 * f64::from(body.max(1)), 0.0, 1e-3 * f64::from(world)]);
            worlds.push(world);
        }
    }
    let mut request = at(&shapes, &positions);
    request.hull_ids.push(id(&plain(box_points(100.0, 1.0, 100.0))));
    server.hulls().register_hulls(register_request(&[plain(box_points(100.0, 1.0, 100.0))])).await.unwrap();
    request.body_hulls[0] = 1;
    request.worlds = worlds;
    request.outputs = outputs(&ALL[..1]);
    let answer = together(&found(&server, &request).await);
    let ground = answer.pairs.chunks(2).filter(|pair| pair[0] == 0).count();
    assert_eq!((ground, answer.outcomes.len() - ground), (10_000, 2000));
    let distinct: HashSet<_> = answer.pairs.chunks(2).collect();
    assert_eq!(distinct.len(), 12_000);
}

/// Catches an answer that exceeds the message limit although fewer pairs per message would not, a
/// single pair that exceeds it and is silently left out, and limits that are those of another
/// method.
#[tokio::test(flavor = "multi_thread")]
async fn limits_hold_and_large_answers_are_cut() {
    let shapes = [plain(box_points(0.5, 0.5, 0.5)), plain(round_points(12, 1))];
    let limits = Limits {
        max_message_bytes: 20_000,
        max_bodies_per_request: 100,
        max_pairs_per_request: 1000,
        max_pairs_in_flight: 1000,
        ..Limits::default()
    };
    let server = TestServer::with_limits(limits).await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let request = at(&shapes, &[[0.0; 3]; 100]);
    let messages = found(&server, &request).await;
    assert!(messages.iter().all(|message| message.encoded_len() <= 20_000));
    let whole = TestServer::start().await;
    whole.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let expected = together(&found(&whole, &request).await);
    assert_eq!(expected.outcomes.len(), 4950);
    assert_same(&together(&messages), &expected);

    let status = server.contacts().find_contacts(at(&shapes, &[[0.0; 3]; 101])).await.unwrap_err();
    assert_eq!(refusal(&status), invalid("TOO_MANY_BODIES", "body_hulls"));
    let place = server.app.engine().admit_any_size(1, &Caller::alone()).unwrap();
    let status = server.contacts().find_contacts(request.clone()).await.unwrap_err();
    assert_eq!(refusal(&status), refused(Code::Unavailable, "TOO_BUSY", ""));
    drop(place);
    // One pair of boxes fits within this limit; one pair with many points does not, which must be
    // reported.
    let limits = Limits { max_message_bytes: 1024, ..Limits::default() };
    let tiny = TestServer::with_limits(limits).await;
    tiny.hulls().register_hulls(register_request(&shapes[..1])).await.unwrap();
    let request = at(&shapes[..1], &[[0.0; 3]; 2]);
    let answer = together(&found(&tiny, &request).await);
    assert_eq!(answer.outcomes.len(), 1);
    let prism: Vec<[f64; 3]> = (0..40)
        .map(|i: u32| {
            let (sine, cosine) = (f64::from(i / 2) * 0.314).sin_cos();
            [sine, cosine, f64::from(i % 2)]
        })
        .collect();
    let prism = [plain(prism)];
    tiny.hulls().register_hulls(register_request(&prism)).await.unwrap();
    let mut stream =
        tiny.contacts().find_contacts(at(&prism, &[[0.0; 3], [0.0, 0.0, 0.9]])).await.unwrap().into_inner();
    assert_eq!(refusal(&stream.message().await.unwrap_err()), invalid("RESPONSE_TOO_LARGE", ""));
    // All capacity must have been returned.
    drop(server.app.engine().admit_any_size(1000, &Caller::alone()).unwrap());
}

/// Catches a malformed request that is answered, and a refusal that does not name the field.
#[tokio::test(flavor = "multi_thread")]
async fn malformed_requests_name_field_and_index() {
    let shapes = [plain(box_points(0.5, 0.5, 0.5))];
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let good = QueryContactsRequest {
        worlds: vec![0, 0],
        groups: vec![1, 2],
        ignored_groups: vec![1, 3],
        ..at(&shapes, &[[0.0; 3]; 2])
    };
    assert_eq!(together(&found(&server, &good).await).pairs, [0, 1]);
    type Spoil = fn(&mut QueryContactsRequest);
    let cases: [(Spoil, &str, &str); 16] = [
        (|r| r.pairs = vec![0, 1], "FIELD_NOT_ALLOWED", "pairs"),
        (|r| r.warm_starts = vec![0; 6], "FIELD_NOT_ALLOWED", "warm_starts"),
        (|r| r.inherit = true, "FIELD_NOT_ALLOWED", "inherit"),
        (|r| r.margin = f64::INFINITY, "VALUE_OUT_OF_RANGE", "margin"),
        (|r| r.margin = -1.0, "VALUE_OUT_OF_RANGE", "margin"),
        (|r| r.margin = f64::NAN, "VALUE_OUT_OF_RANGE", "margin"),
        (|r| r.worlds.push(0), "LENGTH_MISMATCH", "worlds"),
        (|r| r.worlds.truncate(1), "LENGTH_MISMATCH", "worlds"),
        (|r| r.groups.push(0), "LENGTH_MISMATCH", "groups"),
        (|r| r.groups.truncate(1), "LENGTH_MISMATCH", "groups"),
        (|r| r.ignored_groups.push(1), "LENGTH_MISMATCH", "ignored_groups"),
        (|r| r.ignored_groups[1] = 0, "VALUE_OUT_OF_RANGE", "ignored_groups[1]"),
        (|r| r.body_hulls[1] = 1, "INDEX_OUT_OF_RANGE", "body_hulls[1]"),
        (|r| r.positions.truncate(5), "LENGTH_MISMATCH", "positions"),
        (|r| r.hull_ids[0].truncate(31), "MALFORMED_ID", "hull_ids[0]"),
        (|r| r.accuracy.get_or_insert_default().solver = 9, "UNKNOWN_VALUE", "accuracy.solver"),
    ];
    for (spoil, reason, field) in cases {
        let mut request = good.clone();
        spoil(&mut request);
        let status = server.contacts().find_contacts(request).await.unwrap_err();
        assert_eq!(refusal(&status), invalid(reason, field));
    }
}

/// Bodies with an unusable pose or an unknown hull must be named and must not affect other pairs;
/// an unreadable store must fail the call. Catches bodies that are lost without a report.
#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_in_a_pair_is_named() {
    let shapes = [plain(box_points(0.5, 0.5, 0.5)), plain(round_points(12, 1))];
    let store = FaultyStore::new();
    let server = Setup { store: store.clone(), ..Setup::default() }.start().await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let mut request = at(&shapes, &[[0.0; 3]; 5]);
    request.positions[3] = f64::NAN;
    request.rotations[8..12].fill(0.0);
    request.body_hulls[3] = 1;
    server.hulls().delete_hulls(DeleteHullsRequest { ids: vec![id(&shapes[1])] }).await.unwrap();
    let answer = together(&found(&server, &request).await);
    assert_eq!((&answer.pairs[..], &answer.missing_hulls[..]), (&[0, 4][..], &[1][..]));
    assert_eq!(answer.invalid_bodies, [1, 2]);
    request.worlds = vec![0, 1, 2, 3, 4];
    let messages = found(&server, &request).await;
    assert_eq!((messages.len(), messages[0].outcomes.len()), (1, 0));
    assert_eq!((&messages[0].missing_hulls[..], &messages[0].invalid_bodies[..]), (&[1][..], &[1, 2][..]));

    store.unreadable.store(true, std::sync::atomic::Ordering::SeqCst);
    let status = server.contacts().find_contacts(request).await.unwrap_err();
    assert_eq!(refusal(&status), refused(Code::Unavailable, "STORE_UNAVAILABLE", ""));
}

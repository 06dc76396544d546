//! Margins of bodies, and motions that widen the margins of pairs.

use hullcast::{
    contact::ConvexHull,
    proto::{Outcome, QueryContactsRequest, QueryContactsResponse},
    store::HullDefinition,
};

use crate::{
    contact_stream::{Stepper, poses_alone},
    find::{exhaustive, found, together},
    support::{
        TestServer, invalid, refusal,
        scenes::{
            ALL, Random, append, assert_same, expected, outputs, register_request, scene, shapes, two_boxes,
        },
    },
};

const BODIES: usize = 40;

/// A scene whose bodies have margins and motions of every size, some of them 0.
pub fn moving_scene(shapes: &[HullDefinition], pairs: usize, seed: u64) -> QueryContactsRequest {
    let mut random = Random::new(seed);
    let mut request = QueryContactsRequest { outputs: outputs(&ALL), ..scene(shapes, BODIES, pairs, seed) };
    request.positions.iter_mut().for_each(|x| *x *= 6.0);
    let vectors = |random: &mut Random, size: f64| -> Vec<f64> {
        (0..3 * BODIES).map(|i| if i / 3 % 5 == 0 { 0.0 } else { size * random.signed() }).collect()
    };
    request.margins = (0..BODIES).map(|_| (0.4 * random.signed()).max(0.0)).collect();
    request.linear_velocities = vectors(&mut random, 3.0);
    request.angular_velocities = vectors(&mut random, 8.0);
    request.turning_points = vectors(&mut random, 0.5);
    request.time_step = 0.25;
    request
}

fn length([x, y, z]: [f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

fn row(column: &[f64], body: usize) -> [f64; 3] {
    if column.is_empty() { [0.0; 3] } else { column[3 * body..][..3].try_into().unwrap() }
}

fn difference(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

/// The margin of a pair, written directly from the contract.
fn margin_of(request: &QueryContactsRequest, hulls: &[ConvexHull], pair: [usize; 2]) -> f64 {
    let of = |body: usize| request.margins.get(body).copied().unwrap_or(0.0);
    let step = request.time_step;
    let turn = |body: usize| {
        let hull = &hulls[request.body_hulls[body] as usize];
        let centre = difference(hull.contraction_point().to_array(), row(&request.turning_points, body));
        let reach = hull.circumradius() + length(centre);
        (step * length(row(&request.angular_velocities, body))).min(2.0) * reach
    };
    let [a, b] = pair;
    let [v_a, v_b] = pair.map(|body| row(&request.linear_velocities, body));
    let motion = step * length(difference(v_b, v_a)) + turn(a) + turn(b);
    request.margin + (of(a) + of(b)) + motion
}

/// The answer of each pair with a margin of its own, computed by the library.
fn expected_pairs(request: &QueryContactsRequest, shapes: &[HullDefinition]) -> QueryContactsResponse {
    let hulls: Vec<ConvexHull> = shapes.iter().map(|shape| shape.build(usize::MAX).unwrap()).collect();
    let mut whole = expected(&QueryContactsRequest { pairs: vec![], ..request.clone() }, shapes);
    for (pair, bodies) in request.pairs.chunks(2).enumerate() {
        let alone = QueryContactsRequest {
            pairs: bodies.to_vec(),
            margin: margin_of(request, &hulls, [bodies[0] as usize, bodies[1] as usize]),
            warm_starts: request.warm_starts.chunks(6).nth(pair).unwrap_or_default().to_vec(),
            ..request.clone()
        };
        append(&mut whole, expected(&alone, shapes));
    }
    whole
}

/// Catches a term of a pair's margin that is missing, has another body's numbers, or is applied to the wrong
/// pair. The answer of each pair is that of a query of this pair alone with the margin of the contract's
/// formula. The counts show that each field decides about pairs.
#[tokio::test(flavor = "multi_thread")]
async fn each_pair_has_its_own_margin() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    type Drop = fn(&mut QueryContactsRequest);
    let drops: [Drop; 5] = [
        |r| r.margins.clear(),
        |r| r.linear_velocities.clear(),
        |r| r.angular_velocities.clear(),
        |r| r.turning_points.clear(),
        |r| r.time_step = 0.0,
    ];
    let mut decided = [0; 5];
    for seed in 0..8 {
        // More than one chunk of pairs, so that several threads answer.
        let request = moving_scene(&shapes(), 400, seed);
        let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
        assert_same(&answer, &expected_pairs(&request, &shapes()));
        for (field, drop) in drops.iter().enumerate() {
            let mut without = request.clone();
            drop(&mut without);
            let other = server.contacts().query_contacts(without.clone()).await.unwrap().into_inner();
            assert_same(&other, &expected_pairs(&without, &shapes()));
            decided[field] += other.outcomes.iter().zip(&answer.outcomes).filter(|(a, b)| a != b).count();
        }
    }
    assert!(decided.iter().all(|&count| count > 30), "{decided:?}");
}

/// Catches bounds of the broad phase that are too small for the margins of bodies or their motions: `FindContacts`
/// is compared with the query of every pair.
#[tokio::test(flavor = "multi_thread")]
async fn no_pair_is_lost_by_the_broad_phase() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let (mut pairs, mut pairs_at_rest) = (0, 0);
    for seed in 0..12 {
        let mut request = moving_scene(&shapes(), 0, 50 + seed);
        // In half of the scenes all bodies share a fast motion, which the margin of a pair does not have.
        if seed % 2 == 1 {
            request.linear_velocities.iter_mut().for_each(|v| *v += 40.0);
        }
        if seed % 3 == 1 {
            request.positions[9] = f64::NAN;
            request.angular_velocities[30] = f64::INFINITY;
        }
        let (whole, _) = exhaustive(&server, &request).await;
        let answer = together(&found(&server, &request).await);
        assert_same(&answer, &whole);
        pairs += answer.outcomes.len();
        let at_rest = QueryContactsRequest { margins: vec![], time_step: 0.0, ..request };
        pairs_at_rest += together(&found(&server, &at_rest).await).outcomes.len();
    }
    assert!(pairs > 2 * pairs_at_rest && pairs_at_rest > 50, "{pairs} pairs, {pairs_at_rest} at rest");
}

/// Catches an answer that changes because fields are there that have no effect: margins of 0, and velocities
/// without a time step or a time step without velocities.
#[tokio::test(flavor = "multi_thread")]
async fn fields_without_effect_change_no_bit() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let moving = moving_scene(&shapes(), 300, 3);
    let plain = QueryContactsRequest { outputs: moving.outputs.clone(), ..scene(&shapes(), BODIES, 300, 3) };
    let plain = QueryContactsRequest { positions: moving.positions.clone(), ..plain };
    let expected = expected(&plain, &shapes());
    let zeros = |count: usize| vec![0.0; count];
    for request in [
        plain.clone(),
        QueryContactsRequest { margins: zeros(BODIES), ..plain.clone() },
        QueryContactsRequest { margins: vec![], time_step: 0.0, ..moving.clone() },
        QueryContactsRequest { time_step: 1e100, ..plain.clone() },
        QueryContactsRequest {
            time_step: 1e100,
            turning_points: moving.turning_points.clone(),
            angular_velocities: zeros(3 * BODIES),
            ..plain.clone()
        },
    ] {
        let answer = server.contacts().query_contacts(request).await.unwrap().into_inner();
        assert_same(&answer, &expected);
    }
}

/// Catches a wrong value that is accepted, or that is refused without naming its field and index, by every
/// method, and a body with an unusable motion that affects other pairs than its own.
#[tokio::test(flavor = "multi_thread")]
async fn wrong_values_name_field_and_index() {
    let (shapes, plain) = two_boxes();
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let good = QueryContactsRequest {
        margins: vec![0.0, 1e100],
        linear_velocities: vec![1e100; 6],
        angular_velocities: vec![-1e100; 6],
        turning_points: vec![1e100; 6],
        time_step: 1e100,
        ..plain
    };
    let to_find = |request: &QueryContactsRequest| QueryContactsRequest { pairs: vec![], ..request.clone() };
    assert_eq!(together(&found(&server, &to_find(&good)).await).pairs, [0, 1]);
    type Spoil = fn(&mut QueryContactsRequest);
    let length = "LENGTH_MISMATCH";
    let range = "VALUE_OUT_OF_RANGE";
    let cases: [(Spoil, &str, &str); 17] = [
        (|r| r.margins.truncate(1), length, "margins"),
        (|r| r.margins.push(0.0), length, "margins"),
        (|r| r.margins[0] = -1e-300, range, "margins[0]"),
        (|r| r.margins[1] = f64::NAN, range, "margins[1]"),
        (|r| r.margins[1] = f64::INFINITY, range, "margins[1]"),
        (|r| r.margins[1] = 1e100_f64.next_up(), range, "margins[1]"),
        (|r| r.linear_velocities.truncate(3), length, "linear_velocities"),
        (|r| r.linear_velocities.push(0.0), length, "linear_velocities"),
        (|r| r.angular_velocities.truncate(5), length, "angular_velocities"),
        (|r| r.angular_velocities.push(0.0), length, "angular_velocities"),
        (|r| r.turning_points.truncate(2), length, "turning_points"),
        (|r| r.turning_points.push(0.0), length, "turning_points"),
        (|r| r.time_step = -1e-300, range, "time_step"),
        (|r| r.time_step = f64::NAN, range, "time_step"),
        (|r| r.time_step = f64::INFINITY, range, "time_step"),
        (|r| r.time_step = f64::NEG_INFINITY, range, "time_step"),
        (|r| r.time_step = 1e100_f64.next_up(), range, "time_step"),
    ];
    for (spoil, reason, field) in cases {
        let mut request = good.clone();
        spoil(&mut request);
        let expected = invalid(reason, field);
        let unary = server.contacts().query_contacts(request.clone()).await.unwrap_err();
        assert_eq!(refusal(&unary), expected);
        let find = server.contacts().find_contacts(to_find(&request)).await.unwrap_err();
        assert_eq!(refusal(&find), expected);
        let mut stream = Stepper::open(server.contacts()).await;
        assert_eq!(stream.step(request).await.unwrap_err(), expected);
    }

    type Column = fn(&mut QueryContactsRequest) -> &mut Vec<f64>;
    let columns: [Column; 3] =
        [|r| &mut r.linear_velocities, |r| &mut r.angular_velocities, |r| &mut r.turning_points];
    let (mut unusable, mut request) = (0, good.clone());
    // A third body, whose pair with the first is not affected.
    request.body_hulls.push(0);
    request.positions.extend([0.5, 0.5, 0.5]);
    request.rotations.extend([0.0, 0.0, 0.0, 1.0]);
    request.pairs = vec![0, 1, 0, 2, 1, 2];
    request.margins.push(0.0);
    columns.iter().for_each(|column| column(&mut request).extend([1.0; 3]));
    for column in columns {
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e100_f64.next_up(), -1.1e100] {
            // The values are checked even if nothing moves.
            for time_step in [1.0, 0.0] {
                let mut request = QueryContactsRequest { time_step, ..request.clone() };
                column(&mut request)[4] = wrong;
                let answer = server.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
                assert_eq!((&answer.invalid_bodies[..], &answer.flags[..]), (&[1][..], &[64, 0, 64][..]));
                assert_eq!(answer.outcomes, [4, Outcome::Contact as u8, 4]);
                let find = together(&found(&server, &to_find(&request)).await);
                assert_eq!((&find.invalid_bodies[..], &find.pairs[..]), (&[1][..], &[0, 2][..]));
                unusable += 1;
            }
        }
    }
    assert_eq!(unusable, 30);
}

/// A stream's messages are compared with requests in full. Catches margins that are not inherited, a time step
/// that is, velocities that are lost or mixed up with those of another message, and turning points that do not
/// stay.
#[tokio::test(flavor = "multi_thread")]
async fn messages_inherit_margins_and_velocities() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let mut full = moving_scene(&shapes(), 200, 9);
    let mut stream = Stepper::open(server.contacts()).await;
    let mut answer = stream.step(full.clone()).await.unwrap();
    assert_same(&answer, &expected_pairs(&full, &shapes()));
    let mut random = Random::new(1);
    let mut separated = Vec::new();
    for step in 0..12 {
        full.request_id += 1;
        full.warm_starts = answer.bases.clone();
        full.positions.iter_mut().for_each(|x| *x += 0.01 * random.signed());
        full.time_step = [0.0, 0.25, 0.5][step % 3];
        let mut message = QueryContactsRequest { time_step: full.time_step, ..poses_alone(&full) };
        type Column = fn(&mut QueryContactsRequest) -> &mut Vec<f64>;
        let columns: [Column; 3] =
            [|r| &mut r.linear_velocities, |r| &mut r.angular_velocities, |r| &mut r.turning_points];
        for (number, column) in columns.iter().enumerate() {
            if step >> number & 1 == 1 {
                column(&mut full).iter_mut().for_each(|v| *v *= 1.0 + 0.3 * random.signed());
                *column(&mut message) = column(&mut full).clone();
            }
        }
        answer = stream.step(message).await.unwrap();
        assert_same(&answer, &expected_pairs(&full, &shapes()));
        separated
            .push(answer.outcomes.iter().filter(|&&outcome| outcome == Outcome::Separated as u8).count());
    }
    assert!(separated[0] > separated[1] && separated[1] > separated[2], "{separated:?}");
    // The first velocities of a stream may come later than its first message.
    let plain = QueryContactsRequest {
        linear_velocities: vec![],
        angular_velocities: vec![],
        turning_points: vec![],
        warm_starts: vec![],
        ..full.clone()
    };
    let mut late = Stepper::open(server.contacts()).await;
    let answer = late.step(plain.clone()).await.unwrap();
    assert_same(&answer, &expected_pairs(&plain, &shapes()));
    let message = QueryContactsRequest {
        time_step: 0.5,
        linear_velocities: full.linear_velocities.clone(),
        ..poses_alone(&plain)
    };
    let then = QueryContactsRequest {
        time_step: 0.5,
        linear_velocities: full.linear_velocities.clone(),
        warm_starts: answer.bases,
        ..plain
    };
    assert_same(&late.step(message).await.unwrap(), &expected_pairs(&then, &shapes()));
    // Margins are options, which a message that inherits must not send.
    let message = QueryContactsRequest { margins: full.margins.clone(), ..poses_alone(&full) };
    assert_eq!(stream.step(message).await.unwrap_err(), invalid("FIELD_NOT_ALLOWED", "margins"));
    let message = QueryContactsRequest { linear_velocities: vec![0.0; 3], ..poses_alone(&full) };
    assert_eq!(late.step(message).await.unwrap_err(), invalid("LENGTH_MISMATCH", "linear_velocities"));
}

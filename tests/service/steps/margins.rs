//! Margins of bodies and motions on a stream: what is inherited, and which rows may be used again.

use hullcast::proto::{Outcome, QueryContactsRequest, QueryContactsResponse};

use super::{
    Stepper, all_outputs, found,
    simulated::{Compared, compare},
};
use crate::{
    margins::moving_scene,
    support::{
        TestServer,
        scenes::{ALL, Random, assert_same, box_points, id, outputs, plain, register_request, shapes},
    },
};

/// The ways in which a step changes the scene.
const CHANGES: [&str; 8] = [
    "nothing",
    "time",
    "all velocities",
    "some velocities",
    "turning points",
    "poses",
    "unusable",
    "margins",
];

/// A random change of a scene, and the message that inherits it.
struct Changing {
    random: Random,
    scene: QueryContactsRequest,
    unusable: Option<u32>,
}

/// Sets the entries of some bodies to random ones. A column that is empty has zeros.
fn put(random: &mut Random, column: &mut Vec<f64>, bodies: &[u32], count: usize, size: f64) {
    column.resize(3 * count, 0.0);
    for &body in bodies {
        column[3 * body as usize..][..3].iter_mut().for_each(|x| *x = size * random.signed());
    }
}

fn entries(column: &[f64], bodies: &[u32], width: usize) -> Vec<f64> {
    bodies.iter().flat_map(|&body| &column[width * body as usize..][..width]).copied().collect()
}

impl Changing {
    /// Changes the scene. The message is `None` if the change needs a whole request.
    fn change(&mut self, change: usize) -> Option<QueryContactsRequest> {
        let Self { random, scene, unusable } = self;
        let count = scene.body_hulls.len();
        let mut some: Vec<u32> = (0..3).map(|_| random.below(count) as u32).collect();
        some.sort_unstable();
        some.dedup();
        let all: Vec<u32> = (0..count as u32).collect();
        let mut message = QueryContactsRequest { inherit: true, ..Default::default() };
        let mut sends = [false; 3];
        match CHANGES[change] {
            "nothing" => some.clear(),
            "time" => {
                some.clear();
                scene.time_step = [0.0, 0.1, 0.25, 0.4][random.below(4)];
            }
            "all velocities" => {
                some.clear();
                put(random, &mut scene.linear_velocities, &all[..count / 2], count, 3.0);
                put(random, &mut scene.angular_velocities, &all[count / 3..], count, 8.0);
                message.linear_velocities.clone_from(&scene.linear_velocities);
                message.angular_velocities.clone_from(&scene.angular_velocities);
                *unusable = None;
            }
            "some velocities" => {
                put(random, &mut scene.linear_velocities, &some, count, 3.0);
                put(random, &mut scene.angular_velocities, &some, count, 8.0);
                sends = [true, true, false];
            }
            "turning points" => {
                put(random, &mut scene.turning_points, &some, count, 2.0);
                sends = [false, false, true];
            }
            "poses" => {
                for &body in &some {
                    let position = &mut scene.positions[3 * body as usize..][..3];
                    position.iter_mut().for_each(|x| *x += 0.1 * random.signed());
                }
            }
            "unusable" => {
                let body = unusable.take().unwrap_or_else(|| {
                    *unusable = Some(some[0]);
                    some[0]
                });
                some = vec![body];
                put(random, &mut scene.angular_velocities, &some, count, 8.0);
                if unusable.is_some() {
                    scene.angular_velocities[3 * body as usize + 1] = f64::NAN;
                }
                sends = [false, true, false];
            }
            _ => {
                scene.margins.resize(count, 0.0);
                some.iter().for_each(|&body| scene.margins[body as usize] = (0.4 * random.signed()).max(0.0));
                return None;
            }
        }
        message.time_step = scene.time_step;
        message.positions = entries(&scene.positions, &some, 3);
        message.rotations = entries(&scene.rotations, &some, 4);
        if sends[0] {
            message.linear_velocities = entries(&scene.linear_velocities, &some, 3);
        }
        if sends[1] {
            message.angular_velocities = entries(&scene.angular_velocities, &some, 3);
        }
        if sends[2] {
            message.turning_points = entries(&scene.turning_points, &some, 3);
        }
        message.moved = some;
        Some(message)
    }
}

/// The answer outside a stream.
async fn whole_answer(server: &TestServer, scene: &QueryContactsRequest) -> QueryContactsResponse {
    if scene.find {
        return found(server, scene).await;
    }
    let request = QueryContactsRequest { outputs: outputs(&ALL), ..scene.clone() };
    server.contacts().query_contacts(request).await.unwrap().into_inner()
}

/// Two streams get the same steps: one inherits, and the other gets the whole scene. Each answer is compared with
/// that of the scene outside a stream.
///
/// Catches a row that is used again although the margin of its pair has changed, a pair that the search leaves out
/// for the same reason, a value that another body gets, a value that is lost or kept although another one was sent,
/// and an unusable value that stays or does not. The counts show that each change decides about pairs, and that rows
/// are still used again.
#[tokio::test(flavor = "multi_thread")]
async fn margins_and_motions_are_inherited() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    let (mut decided, mut reused, mut invalid) = ([0; CHANGES.len()], [0; CHANGES.len()], 0);
    let mut compared = Compared::default();
    for seed in 0..8 {
        let find = seed % 2 == 0;
        let mut scene = moving_scene(&shapes(), if find { 0 } else { 300 }, seed);
        (scene.find, scene.outputs) = (find, all_outputs());
        if seed % 4 < 2 {
            // The first values come with a message that inherits.
            scene.linear_velocities.clear();
            scene.angular_velocities.clear();
            scene.turning_points.clear();
            scene.margins.clear();
        }
        let mut changing = Changing { random: Random::new(100 + seed), scene, unusable: None };
        let mut streams = [Stepper::open(&server).await, Stepper::open(&server).await];
        let mut before = None;
        for step in 0..160_u64 {
            let change = changing.random.below(CHANGES.len());
            let message = if step == 0 { None } else { changing.change(change) };
            let scene = &changing.scene;
            let previous_bodies =
                if step == 0 { vec![] } else { (0..scene.body_hulls.len() as u32).collect() };
            let full = QueryContactsRequest { request_id: step, previous_bodies, ..scene.clone() };
            let message = message.map(|message| QueryContactsRequest { request_id: step, ..message });
            let [inheriting, whole] = &mut streams;
            let answer = inheriting.step(message.unwrap_or_else(|| full.clone())).await.unwrap().whole;
            let other = whole.step(full).await.unwrap().whole;
            let expected = whole_answer(&server, scene).await;
            compare(&answer, &expected, &mut compared);
            compare(&other, &expected, &mut compared);
            if find {
                assert_same(&answer, &other);
            }
            let outcomes = (answer.pairs.clone(), answer.outcomes.clone());
            if step > 0 {
                decided[change] += usize::from(before.as_ref() != Some(&outcomes));
                reused[change] += answer.support_calls.iter().filter(|&&calls| calls == 0).count();
            }
            invalid += answer.invalid_bodies.len();
            before = Some(outcomes);
        }
    }
    assert_eq!(decided[0], 0, "nothing has changed");
    assert!(decided[1..].iter().all(|&count| count > 10), "{decided:?}");
    assert!(reused.iter().all(|&count| count > 100) && invalid > 100, "{reused:?}, {invalid}");
    assert!(compared.rows > 10_000 && 50 * compared.ties < compared.rows, "{compared:?}");
}

/// Two cubes that are 0.5 apart, of which the second moves towards the first, and two that touch and are at rest.
///
/// Catches a stale row, or a pair that is not found, after nothing but the time of the step or a velocity has changed,
/// and bodies at rest that are computed again because the time of the step has changed.
#[tokio::test(flavor = "multi_thread")]
async fn a_new_time_of_the_step_is_a_new_margin() {
    let cube = plain(box_points(0.5, 0.5, 0.5));
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(std::slice::from_ref(&cube))).await.unwrap();
    let contact = Outcome::Contact as u8;
    for find in [true, false] {
        let full = QueryContactsRequest {
            find,
            hull_ids: vec![id(&cube)],
            body_hulls: vec![0; 4],
            positions: vec![0.0, 0.0, 0.0, 1.5, 0.0, 0.0, 9.0, 0.0, 0.0, 10.0, 0.0, 0.0],
            rotations: [0.0, 0.0, 0.0, 1.0].repeat(4),
            pairs: if find { vec![] } else { vec![0, 1, 2, 3] },
            linear_velocities: [[0.0; 3], [-1.0, 0.0, 0.0], [0.0; 3], [0.0; 3]].concat(),
            outputs: outputs(&ALL),
            ..Default::default()
        };
        let mut stream = Stepper::open(&server).await;
        stream.step(full.clone()).await.unwrap();
        // From here on, rows are used again.
        let still = QueryContactsRequest { inherit: true, ..Default::default() };
        stream.step(still.clone()).await.unwrap();
        let faster = QueryContactsRequest {
            moved: vec![1],
            positions: full.positions[3..6].to_vec(),
            rotations: full.rotations[4..8].to_vec(),
            linear_velocities: vec![-2.0, 0.0, 0.0],
            ..still.clone()
        };
        let steps = [
            (QueryContactsRequest { time_step: 0.3, ..still.clone() }, false),
            (QueryContactsRequest { time_step: 0.6, ..still.clone() }, true),
            (QueryContactsRequest { time_step: 0.3, ..still.clone() }, false),
            (QueryContactsRequest { time_step: 0.3, ..faster }, true),
            (still, false),
        ];
        for (number, (message, is_near)) in steps.into_iter().enumerate() {
            let answer = stream.step(message).await.unwrap().whole;
            let near = answer.outcomes.iter().filter(|&&outcome| outcome == contact).count();
            assert_eq!(near, 1 + usize::from(is_near), "find {find}, step {number}");
            assert_eq!(answer.support_calls.last(), Some(&0), "find {find}, step {number}: bodies at rest");
        }
    }
}

//! Random simulations, each of whose steps is compared with `FindContacts` and with the rule of matches.

use hullcast::{
    contact::ConvexHull,
    proto::{DeleteHullsRequest, QueryContactsRequest, QueryContactsResponse},
};

use super::{
    Answer, Stepper, all_outputs, found,
    matching::{Answered, matches},
    world::{CHANGES, Change, SimulatedBody, World},
};
use crate::support::{
    TestServer,
    scenes::{assert_same, register_request, shapes},
};

/// How the rows of sessions compare with those of `FindContacts`.
#[derive(Debug, Default)]
pub(super) struct Compared {
    pub(super) rows: usize,
    /// Rows with the same bits in every column that does not depend on the start.
    pub(super) same: usize,
    /// Rows with another normal, points or features: ties.
    pub(super) ties: usize,
}

/// Compares an answer of a session with that of `FindContacts` for the same scene: the same pairs with the same
/// outcomes, and values that differ by rounding at most. Where several normals are optimal, the solvers may choose
/// different ones; such pairs are counted.
pub(super) fn compare(
    session: &QueryContactsResponse,
    find: &QueryContactsResponse,
    compared: &mut Compared,
) {
    assert_eq!(session.pairs, find.pairs);
    assert_eq!(session.outcomes, find.outcomes);
    assert_eq!(session.missing_hulls, find.missing_hulls);
    assert_eq!(session.invalid_bodies, find.invalid_bodies);
    let of = |answer: &QueryContactsResponse, row: usize| {
        let first: usize = answer.point_counts[..row].iter().map(|&count| count as usize).sum();
        first..first + answer.point_counts[row] as usize
    };
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    for row in 0..find.outcomes.len() {
        compared.rows += 1;
        let of_row = |answer: &QueryContactsResponse| {
            let points = of(answer, row);
            (
                answer.flags[row],
                bits(&answer.alphas[row..][..1]),
                bits(&answer.alpha_lowers[row..][..1]),
                bits(&answer.alpha_uppers[row..][..1]),
                bits(&answer.separations[row..][..1]),
                bits(&answer.normals[3 * row..][..3]),
                answer.feature_indices[4 * row..][..4].to_vec(),
                answer.bases[6 * row..][..6].to_vec(),
                bits(&answer.witness_as[3 * points.start..3 * points.end]),
                bits(&answer.distances[points.clone()]),
                answer.point_ids[4 * points.start..4 * points.end].to_vec(),
            )
        };
        if of_row(session) == of_row(find) {
            compared.same += 1;
            continue;
        }
        // Both brackets contain the exact alpha.
        assert!(session.alpha_lowers[row] <= find.alpha_uppers[row], "row {row}");
        assert!(find.alpha_lowers[row] <= session.alpha_uppers[row], "row {row}");
        let normal =
            |answer: &QueryContactsResponse| glam::DVec3::from_slice(&answer.normals[3 * row..][..3]);
        let same_normal = (normal(session) - normal(find)).length() < 1e-9;
        if !same_normal || session.feature_indices[4 * row..][..4] != find.feature_indices[4 * row..][..4] {
            compared.ties += 1;
            continue;
        }
        assert_eq!(of(session, row).len(), of(find, row).len(), "row {row}");
        for (one, other) in of(session, row).zip(of(find, row)) {
            assert!((session.distances[one] - find.distances[other]).abs() < 1e-9, "row {row}");
        }
    }
}

/// A session and what it was asked and answered last.
struct Session {
    stream: Stepper,
    before: Option<(Vec<SimulatedBody>, QueryContactsRequest, QueryContactsResponse)>,
}

impl Session {
    async fn open(server: &TestServer) -> Self {
        Self { stream: Stepper::open(server).await, before: None }
    }
}

/// The cases that a run of a simulation covered.
#[derive(Debug, Default)]
struct Coverage {
    changes: [usize; CHANGES.len()],
    compared: Compared,
    unchanged: usize,
    reused: usize,
    matched: usize,
    by_place: usize,
    swapped: usize,
    ended: usize,
    missing: usize,
}

/// Random simulations with bodies that move, jump, come and go, unusable poses, worlds, groups and margins that
/// change, and hulls that are deleted and registered again. Each step is sent to two sessions: one sends only the bodies that moved, the other all
/// poses or everything; both must give the same bits. Each step is compared with `FindContacts` of the scene, and
/// its matches with a matching written from the rule.
///
/// Catches a row that is used again although a body of its pair changed, a pair that is lost or stays after its
/// bodies parted, a pose that `moved` puts to another body, a number of a body that is not translated, a match of
/// another row or point, and a pair that ends without notice.
#[tokio::test(flavor = "multi_thread")]
async fn each_step_is_a_search_of_its_scene() {
    let server = TestServer::start().await;
    let shapes = shapes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let hulls: Vec<ConvexHull> = shapes.iter().map(|shape| shape.build(usize::MAX).unwrap()).collect();
    let mut coverage = Coverage::default();
    for seed in 0..12_u64 {
        let mut world =
            World::new(&shapes, 20 + 5 * seed as usize % 40, [1.2, 2.0, 4.0][seed as usize % 3], seed);
        let mut sessions = [Session::open(&server).await, Session::open(&server).await];
        let mut deleted = None;
        for step in 0..250 {
            let before_change = world.bodies.clone();
            let change = if step == 0 { Change::ComeAndGo } else { world.change() };
            coverage.changes[CHANGES.iter().position(|&other| other == change).unwrap()] += 1;
            if step % 20 == 7 {
                let ids = vec![world.request(0).hull_ids[seed as usize % shapes.len()].clone()];
                server.hulls().delete_hulls(DeleteHullsRequest { ids: ids.clone() }).await.unwrap();
                deleted = Some(ids);
            } else if step % 20 == 11 && deleted.take().is_some() {
                server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
            }
            let expected = found(&server, &world.request(step)).await;
            let same_bodies = change.may_inherit() && step > 0;
            let mut answers = Vec::new();
            for (which, session) in sessions.iter_mut().enumerate() {
                let message = match (same_bodies, which) {
                    (true, 0) => world.moved_request(step, world.moved(&before_change)),
                    (true, _) if step % 3 == 0 => {
                        let previous_bodies = (0..world.bodies.len() as u32).collect();
                        QueryContactsRequest { previous_bodies, ..world.request(step) }
                    }
                    (true, _) => world.poses_request(step),
                    (false, _) if step == 0 => world.request(step),
                    (false, _) => {
                        let previous_bodies = world.previous_bodies(&before_change);
                        QueryContactsRequest { previous_bodies, ..world.request(step) }
                    }
                };
                let answer = session.stream.step(message).await.unwrap();
                compare(&answer.whole, &expected, &mut coverage.compared);
                check_matches(session, &world, &before_change, &answer, &hulls, &mut coverage);
                session.before = Some((world.bodies.clone(), world.request(step), answer.whole.clone()));
                answers.push(answer);
            }
            let [moved, full] = &answers[..] else { panic!("two sessions") };
            assert_same(&moved.whole, &full.whole);
            coverage.unchanged += usize::from(moved.was_unchanged);
            coverage.missing += usize::from(!moved.whole.missing_hulls.is_empty());
            check_work(&world, &before_change, moved, same_bodies, &mut coverage);
        }
    }
    let Coverage { changes, compared, unchanged, reused, matched, by_place, swapped, ended, missing } =
        coverage;
    assert!(changes.iter().all(|&count| count > 300), "{changes:?}");
    assert!(compared.rows > 100_000 && 100 * compared.ties < compared.rows, "{compared:?}");
    assert!(10 * compared.same > 5 * compared.rows, "{compared:?}");
    let counts = [unchanged, reused, matched, by_place, swapped, ended, missing];
    let least = [100, 30_000, 50_000, 50, 200, 1_000, 300];
    assert!(counts.iter().zip(least).all(|(&count, least)| count >= least), "{counts:?}");
    println!("{compared:?} {counts:?}");
}

/// Compares the matches of a step with those of the rule.
fn check_matches(
    session: &Session,
    world: &World,
    bodies_before: &[SimulatedBody],
    answer: &Answer,
    hulls: &[ConvexHull],
    coverage: &mut Coverage,
) {
    let answer = &answer.whole;
    let Some((_, request, before)) = &session.before else {
        assert!(answer.previous_pairs.iter().chain(&answer.previous_points).all(|&index| index == u32::MAX));
        assert_eq!(answer.previous_pairs.len(), answer.outcomes.len());
        assert!(answer.ended_pairs.is_empty());
        return;
    };
    let now = world.request(0);
    let before = Answered { request, pairs: &before.pairs, answer: before };
    let after = Answered { request: &now, pairs: &answer.pairs, answer };
    let previous_bodies = world.previous_bodies(bodies_before);
    let expected = matches(&before, &after, &previous_bodies, hulls);
    assert_eq!(answer.previous_pairs, expected.previous_pairs);
    assert_eq!(answer.previous_points, expected.previous_points);
    assert_eq!(answer.ended_pairs, expected.ended_pairs);
    coverage.matched += answer.previous_pairs.iter().filter(|&&pair| pair != u32::MAX).count();
    coverage.ended += answer.ended_pairs.len() / 2;
    let mut point = 0;
    for (row, &old) in answer.previous_pairs.iter().enumerate() {
        let points = answer.point_counts[row] as usize;
        if old != u32::MAX {
            let [a, b] = [answer.pairs[2 * row], answer.pairs[2 * row + 1]];
            let swapped = previous_bodies[a as usize] > previous_bodies[b as usize];
            coverage.swapped += usize::from(swapped);
            let first: u32 = before.answer.point_counts[..old as usize].iter().sum();
            for at in point..point + points {
                let matched = answer.previous_points[at];
                let old = 4 * (first.wrapping_add(matched)) as usize;
                let same = matched != u32::MAX
                    && before.answer.point_ids[old..][..4] == answer.point_ids[4 * at..][..4];
                coverage.by_place += usize::from(matched != u32::MAX && !same && !swapped);
            }
        }
        point += points;
    }
}

/// Checks that no work was done for a pair of which no body moved, and that other pairs were computed.
fn check_work(
    world: &World,
    before: &[SimulatedBody],
    answer: &Answer,
    same_bodies: bool,
    coverage: &mut Coverage,
) {
    if !same_bodies || answer.was_unchanged {
        return;
    }
    let moved = world.moved(before);
    for (row, pair) in answer.whole.pairs.chunks(2).enumerate() {
        let has_moved = pair.iter().any(|body| moved.binary_search(body).is_ok());
        let calls = answer.whole.support_calls[row];
        // A hull that was registered again makes its bodies new, and the rows of pairs that were left out too.
        if !has_moved && calls == 0 {
            coverage.reused += 1;
        }
        assert!(!has_moved || calls > 0, "row {row} of {pair:?}");
    }
}

/// The same bodies with named pairs, some of them twice and in both orders, and bodies that come and go. Catches rows
/// that are matched with those of another pair of the same bodies, and a basis that is not swapped with its pair.
#[tokio::test(flavor = "multi_thread")]
async fn named_pairs_are_matched_in_order() {
    let server = TestServer::start().await;
    let shapes = shapes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let hulls: Vec<ConvexHull> = shapes.iter().map(|shape| shape.build(usize::MAX).unwrap()).collect();
    let (mut matched, mut unchanged, mut ended) = (0, 0, 0);
    for seed in 0..12 {
        let mut world = World::new(&shapes, 12, 0.9, 50 + seed);
        let mut stream = Stepper::open(&server).await;
        let mut before: Option<(QueryContactsRequest, QueryContactsResponse)> = None;
        let mut pairs: Vec<u32> = Vec::new();
        for step in 0..120 {
            let bodies_before = world.bodies.clone();
            let change = if step == 0 { Change::ComeAndGo } else { world.change() };
            let inherits = change.may_inherit() && step > 0;
            if !inherits {
                let bodies = world.bodies.len();
                pairs = (0..80).map(|_| world.random.below(bodies) as u32).collect();
            }
            let full = QueryContactsRequest {
                find: false,
                worlds: vec![],
                groups: vec![],
                ignored_groups: vec![],
                pairs: pairs.clone(),
                ..world.request(step)
            };
            let message = match inherits {
                true => world.moved_request(step, world.moved(&bodies_before)),
                false if step == 0 => full.clone(),
                false => QueryContactsRequest {
                    previous_bodies: world.previous_bodies(&bodies_before),
                    ..full.clone()
                },
            };
            let answer = stream.step(message).await.unwrap();
            unchanged += usize::from(answer.was_unchanged);
            let answer = answer.whole;
            let unary = QueryContactsRequest {
                outputs: all_outputs().into_iter().filter(|&output| output != 9).collect(),
                ..full.clone()
            };
            let cold = server.contacts().query_contacts(unary).await.unwrap().into_inner();
            assert_eq!(answer.outcomes, cold.outcomes);
            assert_eq!(answer.invalid_bodies, cold.invalid_bodies);
            for row in (0..cold.outcomes.len()).filter(|&row| cold.outcomes[row] != 4) {
                assert!(answer.alpha_lowers[row] <= cold.alpha_uppers[row], "row {row}");
                assert!(cold.alpha_lowers[row] <= answer.alpha_uppers[row], "row {row}");
            }
            if let Some((request, old)) = &before {
                let old = Answered { request, pairs: &request.pairs, answer: old };
                let new = Answered { request: &full, pairs: &pairs, answer: &answer };
                let expected = matches(&old, &new, &world.previous_bodies(&bodies_before), &hulls);
                assert_eq!(answer.previous_pairs, expected.previous_pairs, "step {step}");
                assert_eq!(answer.previous_points, expected.previous_points, "step {step}");
                assert_eq!(answer.ended_pairs, expected.ended_pairs, "step {step}");
                matched += answer.previous_pairs.iter().filter(|&&pair| pair != u32::MAX).count();
                ended += answer.ended_pairs.len() / 2;
            }
            before = Some((full, answer));
        }
    }
    assert!(matched > 5_000 && unchanged > 20 && ended > 200, "{matched} {unchanged} {ended}");
}

//! Tests of the lanes: against each other bit for bit, against the general path, and how often they give
//! up.

use std::fmt::Debug;

use super::*;
use crate::workload::{Family, Random, Regime, Workload};
use crate::{ConvexHull, Outcome, Pose, certificate, contact_manifold};
use glam::{DQuat, DVec3};

/// Hulls, and pairs of them at poses.
struct Scene {
    name: String,
    hulls: Vec<ConvexHull>,
    pairs: Vec<([usize; 2], [Pose; 2])>,
    query: Query,
    /// The largest share of lanes that may leave anything to the general path.
    most_given_up: f64,
}

impl Scene {
    fn boxes(&self) -> Vec<BoxPair<'_>> {
        let pair = |(hulls, poses): &([usize; 2], [Pose; 2])| {
            let [a, b] = [0, 1].map(|side| Body::new(&self.hulls[hulls[side]], poses[side]));
            BoxPair::new(&a, &b, &self.query, None).expect("two boxes")
        };
        self.pairs.iter().map(pair).collect()
    }
}

fn pose(position: DVec3, rotation: DQuat) -> Pose {
    Pose::new(position.to_array(), rotation.to_array()).expect("a pose")
}

fn cuboid(half: DVec3, centre: DVec3) -> ConvexHull {
    let sign = |corner: usize, axis: usize| if corner >> axis & 1 == 0 { -1.0 } else { 1.0 };
    let corner = |i: usize| (centre + half * DVec3::new(sign(i, 0), sign(i, 1), sign(i, 2))).to_array();
    ConvexHull::new(&[0, 1, 2, 3, 4, 5, 6, 7].map(corner)).expect("a box")
}

/// The generated pairs of a regime.
fn generated(regime: Regime, pairs: usize, seed: u64) -> Scene {
    let workload = Workload::generate(Family::Box, regime, pairs, seed).expect("a workload");
    let of = |pair: &crate::workload::GeneratedPair| {
        let pose = |side: usize| Pose::new(pair.positions[side], pair.rotations[side]).expect("a pose");
        (pair.hulls, [pose(0), pose(1)])
    };
    Scene {
        name: regime.name().to_owned(),
        hulls: workload.hulls.iter().map(|points| ConvexHull::new(points).expect("a hull")).collect(),
        pairs: workload.pairs.iter().map(of).collect(),
        query: Query { margin: 0.01, ..Query::default() },
        most_given_up: 0.05,
    }
}

/// Pairs at the limits: thin and long boxes, sizes from 1e-50 to 1e50, boxes of very different sizes, places
/// far from the origin, centres that coincide or nearly do, aligned boxes, touching faces, and rotations
/// around the feature angle.
fn extreme(kind: usize, pairs: usize, seed: u64) -> Scene {
    let mut random = Random::new(seed);
    let size = match kind {
        1 => 3e-50,
        2 => 1e49,
        _ => 1.0,
    };
    let mut hulls = Vec::new();
    for _ in 0..24 {
        let mut half = DVec3::from_array([(); 3].map(|()| random.within(0.3, 1.0)));
        if kind == 0 {
            half *= DVec3::from_array([(); 3].map(|()| 10_f64.powf(random.within(-6.0, 0.0))));
        }
        if kind == 3 {
            half *= 10_f64.powf(random.within(-8.0, 8.0));
        }
        hulls.push(cuboid(half * size, DVec3::ZERO));
    }
    let mut scene = Scene {
        name: format!("extreme {kind}"),
        hulls,
        pairs: Vec::new(),
        query: Query { margin: 0.01 * size, ..Query::default() },
        most_given_up: 0.5,
    };
    for _ in 0..pairs {
        let which = [random.below(scene.hulls.len()), random.below(scene.hulls.len())];
        let [a, b] = which.map(|i| &scene.hulls[i]);
        let [half_a, half_b] = [a, b].map(|hull| hull.box_shape().expect("a box").half * hull.scale());
        let rotation_a = random.rotation();
        let tiny = [0.0, 1e-15, 1e-13, 1e-11, 1e-9, 1e-6, 0.0099999, 0.01, 0.0100001, 0.02];
        let tilt = |random: &mut Random| {
            let axis = [DVec3::X, DVec3::Y, DVec3::Z, random.direction()][random.below(4)];
            DQuat::from_axis_angle(axis, tiny[random.below(tiny.len())])
        };
        let rotation_b = match kind {
            5..=7 => rotation_a * tilt(&mut random) * tilt(&mut random),
            _ => random.rotation(),
        };
        let axis = random.below(3);
        let touching = (half_a + half_b)[axis];
        let aside = DVec3::from_array([(); 3].map(|()| random.within(-0.5, 0.5))) * (half_a + half_b);
        let offset = match kind {
            // Coinciding centres, or nearly.
            4 => aside * [0.0, 1e-300, 1e-18, 1e-16, 1e-15, 1e-12, 1e-6][random.below(7)],
            // Touching faces, to a few roundoffs.
            5 => {
                let mut along = aside;
                along[axis] = touching * (1.0 + [0.0, 1e-16, -1e-15, 1e-14, -1e-3][random.below(5)]);
                rotation_a * along
            }
            // Aligned boxes exactly on each other: all corners on lines.
            6 => {
                let mut along = DVec3::ZERO;
                along[axis] = touching * [1.0, 0.99, 0.5][random.below(3)];
                rotation_a * along
            }
            _ => random.direction() * (half_a.length() + half_b.length()) * random.within(0.2, 1.1),
        };
        let far = if kind == 8 { 10_f64.powf(random.within(0.0, 15.0)) } else { 0.0 };
        let position = random.direction() * far;
        scene.pairs.push((which, [pose(position, rotation_a), pose(position + offset, rotation_b)]));
    }
    scene
}

fn scenes(pairs: usize) -> Vec<Scene> {
    let mut scenes: Vec<Scene> = Regime::ALL.map(|regime| generated(regime, pairs, 3)).into();
    scenes.extend((0..9).map(|kind| extreme(kind, pairs, 11)));
    scenes
}

/// Every bit of an answer.
fn bits(manifold: &Manifold) -> impl PartialEq + Debug + use<> {
    let Manifold { alpha, alpha_lower, alpha_upper, normal, separation, kept_area, .. } = *manifold;
    let numbers = [alpha, alpha_lower, alpha_upper, normal.x, normal.y, normal.z, separation, kept_area];
    let points: Vec<_> = manifold
        .points
        .iter()
        .map(|p| ([p.witness_a.x, p.witness_a.y, p.witness_a.z, p.distance].map(f64::to_bits), p.id))
        .collect();
    let Manifold { outcome, flags, features, basis, iterations, support_calls, .. } = *manifold;
    (numbers.map(f64::to_bits), points, outcome, flags, features, basis, [iterations, support_calls])
}

/// Catches an instruction set whose operations differ from the definition, a lane that reads another one,
/// an answer that depends on the place in its group or on how a batch is split, and padding that is read.
#[test]
fn every_instruction_set_gives_the_same_bits() {
    let (mut one, mut many) = (Workspace::default(), Workspace::default());
    let mut compared = 0;
    let sets: Vec<_> = InstructionSet::available().collect();
    println!("{sets:?}");
    for scene in scenes(3_000) {
        let boxes = scene.boxes();
        let expected: Vec<_> = boxes
            .iter()
            .map(|pair| {
                let [a, b] = &pair.bodies;
                bits(contact_manifold(a, b, &scene.query, None, &mut one))
            })
            .collect();
        for &set in &sets {
            // Groups that begin elsewhere, and a last group of every length.
            for first in [0, 3, 7] {
                let answers = box_manifolds_with(set, &boxes[first..], &scene.query, &mut many);
                assert_eq!(answers.len(), boxes.len() - first);
                for (i, (answer, expected)) in answers.iter().zip(&expected[first..]).enumerate() {
                    assert_eq!(&bits(answer), expected, "{}, {set:?}, pair {}", scene.name, first + i);
                    compared += 1;
                }
            }
        }
    }
    assert!(compared >= 12 * 2_900 * 3 * sets.len());
}

/// Catches a lane that takes the margin of another lane, or that of the call, and a part for the general path
/// that does.
#[test]
fn every_lane_has_the_margin_of_its_pair() {
    let (mut one, mut many) = (Workspace::default(), Workspace::default());
    let mut outcomes = [0; 2];
    for scene in scenes(2_000) {
        let query = |i: usize| {
            let size = scene.query.margin * 100.0;
            Query { margin: [0.0, 1e-3 * size, 0.3 * size, 1e9 * size, f64::INFINITY][i % 5], ..scene.query }
        };
        let same_margin = scene.boxes();
        let boxes: Vec<_> = same_margin
            .iter()
            .enumerate()
            .map(|(i, pair)| {
                let [a, b] = &pair.bodies;
                BoxPair::new(a, b, &query(i), None).expect("two boxes")
            })
            .collect();
        for set in InstructionSet::available() {
            let answers = box_manifolds_with(set, &boxes, &scene.query, &mut many);
            for (i, (answer, pair)) in answers.iter().zip(&boxes).enumerate() {
                let [a, b] = &pair.bodies;
                let alone = contact_manifold(a, b, &query(i), None, &mut one);
                assert_eq!(bits(answer), bits(alone), "{}, {set:?}, pair {i}", scene.name);
                if let Err(violation) = certificate::check(a, b, &query(i), answer) {
                    panic!("{}, pair {i}: {violation} {answer:?}", scene.name);
                }
                outcomes[usize::from(answer.outcome == Outcome::Separated)] += 1;
            }
        }
    }
    assert!(outcomes.iter().all(|&count| count > 2_000), "{outcomes:?}");
}

/// The answer of the path for all hulls.
fn general<'w>(pair: &BoxPair<'_>, query: &Query, workspace: &'w mut Workspace) -> &'w Manifold {
    let [a, b] = &pair.bodies;
    let Workspace { turned, steps, .. } = workspace;
    steps.answer(&mut Pair::new(a, b), query, None, turned);
    &workspace.steps.manifold
}

/// Counts of a comparison.
#[derive(Debug, Default)]
struct Counts {
    pairs: usize,
    contacts: usize,
    same_features: usize,
    same_points: usize,
    points: usize,
}

/// Compares a lane's answer with that of the path for all hulls.
fn compare(name: &str, pair: &BoxPair<'_>, lane: &Manifold, whole: &Manifold, counts: &mut Counts) {
    let [a, b] = &pair.bodies;
    counts.pairs += 1;
    if lane.outcome != whole.outcome {
        // Within the rounding band around the margin either answer is right.
        let [lower, upper] = [lane, whole].map(|m| m.alpha_upper.min(1e300));
        assert!(
            lane.outcome == Outcome::Contact || whole.outcome == Outcome::Contact,
            "{name}: {lower} {upper}"
        );
        return;
    }
    if lane.outcome != Outcome::Contact {
        return;
    }
    counts.contacts += 1;
    if lane.flags.coincident || whole.flags.gap_open {
        return;
    }
    // Both brackets hold the exact growth scale.
    assert!(
        lane.alpha_lower <= whole.alpha_upper && whole.alpha_lower <= lane.alpha_upper,
        "{name}: {lane:?} {whole:?}"
    );
    let size = a.hull.circumradius() + b.hull.circumradius();
    let far = a.pose.translation.length() + b.pose.translation.length();
    let near = 1e-9 * size + 1e-14 * far;
    if lane.features != whole.features || lane.normal.distance(whole.normal) > 1e-9 {
        return;
    }
    counts.same_features += 1;
    counts.points += lane.points.len();
    let same = lane.points.len() == whole.points.len()
        && lane.points.iter().zip(&whole.points).all(|(p, q)| {
            p.id == q.id
                && p.witness_a.distance(q.witness_a) <= near
                && (p.distance - q.distance).abs() <= near
        });
    counts.same_points += usize::from(same);
}

/// Every answer must pass the certificate, agree with the path for all hulls where nothing is ambiguous, and
/// rarely leave anything to it. Catches a wrong bracket, feature, corner, name or order of points, and a
/// lane that gives up although nothing is uncertain.
#[test]
fn lanes_agree_with_the_general_path() {
    let (mut lanes, mut other) = (Workspace::default(), Workspace::default());
    let mut compared = 0;
    for scene in scenes(25_000) {
        let boxes = scene.boxes();
        let answers = box_manifolds(&boxes, &scene.query, &mut lanes).to_vec();
        let gave_up = std::mem::take(&mut lanes.lanes.gave_up);
        let mut counts = Counts::default();
        let mut violations = 0;
        for (i, (pair, lane)) in boxes.iter().zip(&answers).enumerate() {
            let name = format!("{}, pair {i}", scene.name);
            let [a, b] = &pair.bodies;
            if let Err(violation) = certificate::check(a, b, &scene.query, lane) {
                if violations < 5 {
                    println!("{name}: {violation} {lane:?}");
                }
                violations += 1;
            }
            compare(&name, pair, lane, general(pair, &scene.query, &mut other), &mut counts);
        }
        compared += counts.pairs;
        println!("{}: gave up whole, part {gave_up:?}; {counts:?}; {violations} violations", scene.name);
        assert_eq!(violations, 0, "{}", scene.name);
        let share = (gave_up[0] + gave_up[1]) as f64 / boxes.len() as f64;
        assert!(share <= scene.most_given_up, "{}: {gave_up:?}", scene.name);
        if scene.most_given_up < 0.1 {
            assert!(
                counts.same_features as f64 >= 0.998 * counts.contacts as f64,
                "{}: {counts:?}",
                scene.name
            );
            assert!(
                counts.same_points as f64 >= 0.9999 * counts.same_features as f64,
                "{}: {counts:?}",
                scene.name
            );
        }
    }
    assert_eq!(compared, 12 * 25_000);
}

/// Catches values that depend on the other outputs.
#[test]
fn partial_answers_have_the_same_numbers() {
    let mut workspace = Workspace::default();
    for scene in scenes(500) {
        let boxes = scene.boxes();
        let mut ask =
            |wanted| box_manifolds(&boxes, &Query { wanted, ..scene.query }, &mut workspace).to_vec();
        let (points, growth, outcome) = (ask(Wanted::Points), ask(Wanted::Growth), ask(Wanted::Outcome));
        for ((points, growth), outcome) in points.iter().zip(&growth).zip(&outcome) {
            let of =
                |m: &Manifold| (m.alpha_lower.to_bits(), m.alpha_upper.to_bits(), m.normal, m.separation);
            assert!(growth.outcome != points.outcome || of(points) == of(growth), "{points:?} {growth:?}");
            assert_eq!(outcome.outcome, growth.outcome);
            assert!(growth.points.is_empty() && growth.features.is_none());
        }
    }
}

//! Alpha, normal, features and patch belong to the pair: they do not depend on which hull is A, on
//! where the world's origin is, or on the order of the vertices. This holds away from ties and
//! thresholds, so pairs whose answer jumps under a small motion are skipped.

use std::cell::Cell;

use glam::{DQuat, DVec3};
use hullcast_contact::{Feature, Manifold, Workspace};
use proptest::prelude::*;
use proptest::test_runner::TestCaseError;

use crate::case::{Case, Shape, turn};
use crate::metamorphic::{at, check, holds, outer, point, product, rotation, scene, solve};
use crate::polygon::{self, Point};
use crate::scene::Random;

/// An answer, expressed in the frame of the original scene.
struct AnswerInFrame {
    normal: DVec3,
    /// The corners of the touching feature of each hull, by the bits of their coordinates.
    touched: [Vec<[u64; 3]>; 2],
    /// The patch, projected along the first answer's normal.
    patch: Vec<Point>,
    /// The least and the greatest distance of the contact points, and the separation.
    distances: [f64; 3],
    estimated: bool,
}

/// Expresses an answer in the frame of the original scene. `back` maps world points of the changed
/// scene to the original one, `turned_back` maps directions. `swapped` says that A and B were
/// exchanged: the features are exchanged back and the normal is reversed.
fn seen(
    case: &Case,
    m: &Manifold,
    swapped: bool,
    back: impl Fn(DVec3) -> DVec3,
    turned_back: DQuat,
    along: DVec3,
) -> AnswerInFrame {
    let (e1, e2) = along.any_orthonormal_pair();
    let features = m.features.expect("features");
    let corners = |side: usize| {
        let shape = &case.shapes[side];
        let vertices = match features[side] {
            Feature::Vertex(v) => vec![v],
            Feature::Edge(ends) => ends.to_vec(),
            Feature::Face(face) => shape.hull.face_outline(face as usize).collect(),
        };
        let coordinates = |&v: &u32| shape.points[v as usize].map(|x| (x + 0.0).to_bits());
        let mut corners: Vec<_> = vertices.iter().map(coordinates).collect();
        corners.sort_unstable();
        corners
    };
    let order = if swapped { [1, 0] } else { [0, 1] };
    let flat = |p: &hullcast_contact::ContactPoint| {
        let p = back(p.witness_a);
        [e1.dot(p), e2.dot(p)]
    };
    let distances = || m.points.iter().map(|p| p.distance);
    AnswerInFrame {
        normal: turned_back * if swapped { -m.normal } else { m.normal },
        touched: order.map(corners),
        patch: polygon::convex_hull(&m.points.iter().map(flat).collect::<Vec<_>>()),
        distances: [
            distances().fold(f64::INFINITY, f64::min),
            distances().fold(f64::NEG_INFINITY, f64::max),
            m.separation,
        ],
        estimated: m.flags.estimated,
    }
}

impl AnswerInFrame {
    fn of(case: &Case, m: &Manifold, along: DVec3) -> Self {
        seen(case, m, false, |p| p, DQuat::IDENTITY, along)
    }

    /// Describes the difference between two answers if lengths differ by more than `allowed` times
    /// `size`, or the features differ.
    fn difference(&self, other: &Self, size: f64, allowed: f64) -> Option<String> {
        let turn = (self.normal - other.normal).length();
        let apart = polygon::hausdorff(&self.patch, &other.patch) / size;
        let heights = self.distances.iter().zip(&other.distances).map(|(a, b)| (a - b).abs() / size);
        let heights = heights.fold(0.0, f64::max);
        let same = self.touched == other.touched && self.estimated == other.estimated;
        let near = turn <= allowed && apart <= allowed && heights <= allowed;
        (!(same && near)).then(|| {
            format!("features same: {same}, normal {turn:e}, patch {apart:e}, distances {heights:e}")
        })
    }
}

/// Copies of the case with B moved by 1e-7 of the hulls' size along each axis, and tilted by 1e-7
/// rad about each axis.
fn little_moves(case: &Case) -> Vec<Case> {
    const LITTLE: f64 = 1e-7;
    let size = outer(case);
    let mut moves = Vec::new();
    for k in 0..3 {
        for sign in [1.0, -1.0] {
            let mut axis = [0.0; 3];
            axis[k] = 1.0;
            let d = case.positions[1];
            moves.push(at(case, std::array::from_fn(|i| d[i] + sign * LITTLE * size * axis[i])));
            let mut tilted = case.clone();
            tilted.rotations[1] = product(turn(axis, sign * LITTLE), case.rotations[1]);
            moves.push(tilted);
        }
    }
    moves
}

/// Each scene is solved again with A and B exchanged, after a rigid motion of the world, and with
/// its vertices in another order. Normal, features, patch and distances, mapped back to the
/// original frame, must agree to 1e-9 of the hulls' size. Catches a frame that is mixed up, and an
/// index that decides where the geometry should. The counts show that vertices, edges and faces
/// were all compared.
#[test]
fn the_whole_answer_is_the_pairs_own() {
    let (compared, features, skipped) = (Cell::new(0), Cell::new([0; 3]), Cell::new(0));
    holds(1500, (scene(), rotation(), point(), any::<u64>()), |(case, q, t, seed)| {
        let m = solve(&case);
        let (size, along) = (outer(&case), m.normal);
        let first = AnswerInFrame::of(&case, &m, along);
        let still =
            |other: &Case| first.difference(&AnswerInFrame::of(other, &solve(other), along), size, 1e-5);
        if little_moves(&case).iter().any(|other| still(other).is_some()) {
            skipped.set(skipped.get() + 1);
            return Ok(());
        }
        compared.set(compared.get() + 1);
        let mut kinds = features.get();
        for feature in m.features.expect("features") {
            kinds[match feature {
                Feature::Vertex(_) => 0,
                Feature::Edge(_) => 1,
                Feature::Face(_) => 2,
            }] += 1;
        }
        features.set(kinds);
        let same = |what: &str, other: AnswerInFrame| -> Result<(), TestCaseError> {
            let difference = first.difference(&other, size, 1e-9);
            check(difference.is_none(), || format!("{what}: {difference:?}"))
        };

        let [a, b] = case.shapes.clone();
        let swapped = Case {
            shapes: [b.clone(), a.clone()],
            rotations: [case.rotations[1], case.rotations[0]],
            ..at(&case, case.positions[1].map(|x| -x))
        };
        let d = DVec3::from_array(case.positions[1]);
        same("swapped", seen(&swapped, &solve(&swapped), true, |p| p + d, DQuat::IDENTITY, along))?;

        let [x, y, z, w] = q;
        let (turn, by) = (DQuat::from_xyzw(x, y, z, w).normalize(), DVec3::from_array(t));
        let moved = Case {
            positions: case.positions.map(|p| (turn * DVec3::from_array(p) + by).to_array()),
            rotations: case.rotations.map(|r| product(q, r)),
            ..case.clone()
        };
        let back = turn.inverse();
        same("moved", seen(&moved, &solve(&moved), false, |p| back * (p - by), back, along))?;

        let random = &mut Random::new(seed);
        let shuffled = [a, b].map(|shape| {
            let mut points = shape.points.clone();
            (1..points.len()).rev().for_each(|i| points.swap(i, random.below(i + 1)));
            Shape::centred(points)
        });
        let reordered = Case { shapes: shuffled, ..case.clone() };
        let m = reordered.solve(&reordered.query(f64::INFINITY), &mut Workspace::default());
        same("reordered", AnswerInFrame::of(&reordered, &m, along))
    });
    let (compared, kinds) = (compared.get(), features.get());
    println!("{compared} compared, {} skipped, {kinds:?} vertices, edges, faces", skipped.get());
    assert!(compared > 400 && kinds.iter().all(|&count| count > 40), "{compared} {kinds:?}");
}

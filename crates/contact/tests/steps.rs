//! The cost of pairs: the steps that a workspace counts, and the estimate of them.

use hullcast_contact::{
    Accuracy, Body, ConvexHull, Outcome, Pose, Query, Solver, Wanted, Workspace, contact_manifold,
    estimated_steps,
};

/// A prism of elliptic base, turned about its axis by `turn` radians.
fn prism(sides: usize, size: f64, turn: f64) -> ConvexHull {
    let corner = |i: usize, z: f64| {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / sides as f64 + turn).sin_cos();
        [size * cos, 0.8 * size * sin, z]
    };
    let points: Vec<_> = (0..sides).flat_map(|i| [corner(i, -0.2), corner(i, 0.2)]).collect();
    ConvexHull::new(&points).unwrap()
}

/// How the second prism is placed on the first: its size, its turn in sides, its shift in the
/// plane, its tilt in radians.
struct Placement {
    name: &'static str,
    size: f64,
    turn: f64,
    moved: [f64; 2],
    tilt: f64,
}

const PLACEMENTS: [Placement; 10] = [
    Placement { name: "aligned", size: 1.0, turn: 0.0, moved: [0.0, 0.0], tilt: 0.0 },
    Placement { name: "turned by half a side", size: 1.0, turn: 0.5, moved: [0.0, 0.0], tilt: 0.0 },
    Placement { name: "moved", size: 1.0, turn: 0.1, moved: [0.7, 0.3], tilt: 0.0 },
    Placement { name: "nearly parallel", size: 1.0, turn: 1e-9, moved: [1e-9, 0.0], tilt: 0.0 },
    Placement { name: "inside", size: 0.5, turn: 0.3, moved: [0.1, 0.2], tilt: 0.0 },
    Placement { name: "around", size: 3.0, turn: 0.3, moved: [0.1, 0.2], tilt: 0.0 },
    Placement { name: "touching", size: 1.0, turn: 0.0, moved: [2.0, 0.0], tilt: 0.0 },
    Placement { name: "touching a corner", size: 1.0, turn: 0.5, moved: [2.0, 0.0], tilt: 0.0 },
    Placement { name: "apart", size: 1.0, turn: 0.2, moved: [1.5, 2.0], tilt: 0.0 },
    Placement { name: "tilted", size: 1.0, turn: 0.3, moved: [0.3, 0.0], tilt: 0.003 },
];

impl Placement {
    /// The steps, iterations and points of the pair.
    fn steps(&self, sides: usize, max_points: u32, workspace: &mut Workspace) -> (u64, u32, usize) {
        let turn = self.turn * std::f64::consts::TAU / sides as f64;
        let (a, b) = (prism(sides, 1.0, 0.0), prism(sides, self.size, turn));
        let (sin, cos) = (0.5 * self.tilt).sin_cos();
        let origin = Pose::new([0.0; 3], [0.0, 0.0, 0.0, 1.0]).unwrap();
        let pose = Pose::new([self.moved[0], self.moved[1], 0.39], [sin, 0.0, 0.0, cos]).unwrap();
        let (a, b) = (Body::new(&a, origin), Body::new(&b, pose));
        let accuracy = Accuracy { max_points, ..Accuracy::default() };
        let query = Query { margin: f64::INFINITY, accuracy, ..Query::default() };
        let answer = contact_manifold(&a, &b, &query, None, workspace);
        let (iterations, points) = (answer.iterations, answer.points.len());
        (workspace.take_steps(), iterations, points)
    }
}

/// Prisms of 64 to 8,192 sides in ten placements. Doubling the sides must not take more than 2.3
/// times the steps, and several doublings not more than that per doubling. Catches work that visits
/// every side for every side.
///
/// The steps are compared with the most steps of any smaller polygon, and with at least 10,000:
/// below that, it matters more than the number of sides whether a support call can use the map of
/// directions. If a solver takes more iterations for a rounder polygon, the limit grows in
/// proportion.
#[test]
fn twice_the_sides_take_about_twice_the_steps() {
    let mut workspace = Workspace::default();
    let mut longest = 0;
    for placement in PLACEMENTS {
        for max_points in [0, 20] {
            let mut most: Vec<(u64, u32)> = Vec::new();
            for doublings in 0..8 {
                let sides = 64 << doublings;
                let (steps, iterations, points) = placement.steps(sides, max_points, &mut workspace);
                println!("{}, {sides} sides: {steps} steps, {points} points", placement.name);
                for (&(before, fewer), smaller) in most.iter().rev().zip(1..) {
                    let more = f64::from(iterations.max(fewer)) / f64::from(fewer);
                    let limit = before as f64 * 2.3_f64.powi(smaller) * more;
                    assert!(steps as f64 <= limit, "{}: {steps} above {limit}", placement.name);
                }
                let (before, fewer) = most.last().copied().unwrap_or((10_000, iterations));
                most.push(if steps > before { (steps, iterations) } else { (before, fewer) });
                longest = longest.max(points);
                assert!(max_points == 0 || points <= 20);
            }
        }
    }
    // In the longest patch most sides of both polygons cross.
    assert!(longest > 12_000, "{longest}");
}

/// Prisms of 4 to 2,000 sides in contact, with both solvers. Every count must be below 20 times the
/// estimate, and in two thirds of the pairs above a twentieth of it. Catches steps that are lost,
/// or that are carried over to the next pair, and an estimate far from the true cost.
#[test]
fn estimates_are_near_what_pairs_take() {
    let mut workspace = Workspace::default();
    assert_eq!(workspace.take_steps(), 0);
    let (mut pairs, mut far_off) = (0, 0);
    for sides in [4, 8, 32, 100, 1000] {
        for other in [4, 16, 64, 2000] {
            let (a, b) = (prism(sides, 1.0, 0.0), prism(other, 0.7, 0.1));
            let estimate = estimated_steps(&a, &b);
            assert_eq!(estimate, estimated_steps(&b, &a));
            for solver in Solver::ALL {
                for wanted in [Wanted::Outcome, Wanted::Growth, Wanted::Points] {
                    let accuracy = Accuracy { solver, ..Accuracy::default() };
                    let query = Query { wanted, accuracy, ..Query::default() };
                    let at = |z| Pose::new([0.1, 0.2, z], [0.0, 0.1, 0.0, 0.995]).unwrap();
                    let bodies = [Body::new(&a, at(0.0)), Body::new(&b, at(0.3))];
                    let answer = contact_manifold(&bodies[0], &bodies[1], &query, None, &mut workspace);
                    assert_eq!(answer.outcome, Outcome::Contact);
                    let steps = workspace.take_steps();
                    assert_eq!(workspace.take_steps(), 0);
                    assert!(steps > 200 && steps < 20 * estimate, "{sides} {other}: {steps}, {estimate}");
                    far_off += usize::from(steps < estimate / 20);
                    pairs += 1;
                }
            }
        }
    }
    assert!(pairs == 120 && far_off < pairs / 3, "{far_off} of {pairs}");
}

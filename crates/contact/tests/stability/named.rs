//! Inputs that broke a real library, named by the library's issue, each with the bug it would catch
//! here. Every answer of both solvers is compared with the exact one.

use std::rc::Rc;

use hullcast_contact::{Feature, Flags, Manifold, Outcome, Solver, Workspace};

use crate::case::{Case, Shape, cuboid, turn};
use crate::judge::{SolverScore, judge};
use crate::scene::{Random, box_points, prism_points, scaled};

pub(crate) const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

/// Compares both solvers' answers for a case with the exact one, and returns their answers at an
/// infinite margin.
pub(crate) fn judged(case: &Case) -> [Manifold; 2] {
    let mut cells = [SolverScore::default(), SolverScore::default()];
    judge(case, &mut cells, &mut Workspace::default());
    for (cell, solver) in cells.iter().zip(Solver::ALL) {
        assert!(cell.failed.is_empty(), "{solver:?}: {:#?}\n{case:?}", cell.failed);
        assert_eq!(cell.undecided, 0, "{solver:?} undecided\n{case:?}");
    }
    answers(case, f64::INFINITY)
}

pub(crate) fn answers(case: &Case, margin: f64) -> [Manifold; 2] {
    Solver::ALL.map(|solver| {
        let mut query = case.query(margin);
        query.accuracy.solver = solver;
        case.solve(&query, &mut Workspace::default())
    })
}

pub(crate) fn level(shapes: [Rc<Shape>; 2], d: [f64; 3]) -> Case {
    Case::new(shapes, d, [LEVEL; 2])
}

/// A triangle of a ground mesh: a prism of the given thickness.
fn triangle(size: f64, thickness: f64) -> Rc<Shape> {
    let corners = [[-size, -size], [size, -size], [0.0, size]];
    Shape::new([0.0, -thickness].into_iter().flat_map(|z| corners.map(|[x, y]| [x, y, z])).collect())
}

/// parry#166. A cube of half extent 0.5 on a plate of half extent 2e4, at random places, turned
/// about the vertical or at random, and within 0.1 of touching. A solver that stops by an absolute
/// tolerance, or by a merely local one, loses its way on such a plate and returns a wrong depth in
/// every scene.
#[test]
fn cube_on_a_large_plate() {
    let random = &mut Random::new(166);
    for (half, thickness, scale) in [(2e4, 0.5, 1.0), (2e4, 0.5, 1e-6), (2e4, 1e-3, 1.0)] {
        let plate =
            Shape::new(box_points([half, half, thickness]).iter().map(|&p| scaled(p, scale)).collect());
        let cube = cuboid([0.5 * scale; 3]);
        for _ in 0..100 {
            let d = [random.range(-0.9, 0.9) * half, random.range(-0.9, 0.9) * half, 0.0];
            let depth = thickness + 0.5 + random.range(-0.1, 0.1);
            let d = scaled([d[0], d[1], depth], scale);
            let spun = turn([0.0, 0.0, 1.0], random.range(0.0, 6.0));
            for rotation in [spun, random.rotation()] {
                let [portal, gjk] = judged(&Case::new([plate.clone(), cube.clone()], d, [LEVEL, rotation]));
                assert!(!portal.flags.gap_open && !gjk.flags.gap_open);
            }
        }
    }
}

/// parry#166 again. Two cubes on one axis: the ray meets the middle of a face, and every simplex
/// that GJK makes there is degenerate. The normal is exactly z and the patch has four points.
#[test]
fn coaxial_cubes() {
    let random = &mut Random::new(167);
    for _ in 0..200 {
        let [a, b] = [random.range(0.1, 2.0), random.range(0.1, 2.0)];
        let d = [0.0, 0.0, (a + b) * random.range(0.5, 1.5)];
        let [portal, _] = judged(&level([cuboid([a; 3]), cuboid([b; 3])], d));
        assert_eq!(portal.normal.to_array(), [0.0, 0.0, 1.0]);
        assert_eq!(portal.points.len(), 4);
    }
}

/// parry#315. Unit cubes that exactly touch, along each axis. The depth is 0, so a direction taken
/// from the two closest points is 0/0 and gives a wrong normal.
#[test]
fn cubes_that_exactly_touch() {
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let mut d = [0.0; 3];
            d[axis] = side;
            for m in judged(&level([cuboid([0.5; 3]), cuboid([0.5; 3])], d)) {
                assert_eq!(m.normal.to_array(), d);
                assert_eq!((m.alpha, m.points.len()), (1.0, 4));
            }
            assert!(
                answers(&level([cuboid([0.5; 3]), cuboid([0.5; 3])], d), 0.0)
                    .iter()
                    .all(|m| m.outcome == Outcome::Contact)
            );
        }
    }
}

/// parry#49. Points on a sphere of radius 1e-23. An absolute epsilon takes them all for one point,
/// and the library panicked.
#[test]
fn vertices_near_1e_23() {
    let random = &mut Random::new(49);
    for _ in 0..50 {
        let points = (0..12).map(|_| scaled(random.direction(), 1e-23)).collect();
        let shape = Shape::new(points);
        judged(&Case::aimed(random, [shape.clone(), shape], 0.9));
    }
}

/// JoltPhysics#671. A prism hovers one millimetre above a box. A normal that follows the sign of
/// the penetration is flipped here.
#[test]
fn hull_a_millimetre_above_a_box() {
    let hull = Shape::new(prism_points(9, 0.3, 0.1));
    for m in judged(&level([cuboid([5.0, 5.0, 1.0]), hull], [0.7, -0.4, 1.101])) {
        assert!(m.normal.z > 0.999 && (m.separation - 1e-3).abs() < 1e-12, "{m:?}");
    }
}

/// JoltPhysics#2065. A beam 84 m long lies on its edge, 5 cm deep in a box. A tolerance in
/// proportion to the size of the hull hides that depth.
#[test]
fn long_edge_five_centimetres_deep() {
    let beam = cuboid([42.0, 0.5, 0.5]);
    let edge = turn([1.0, 0.0, 0.0], std::f64::consts::FRAC_PI_4);
    let height = 1.0 + 0.5f64.sqrt() - 0.05;
    for m in judged(&Case::new([cuboid([60.0, 4.0, 1.0]), beam], [3.0, 0.2, height], [LEVEL, edge])) {
        assert!((m.separation + 0.05).abs() < 1e-12);
        assert!(m.points.len() == 2, "{m:?}");
    }
}

/// JoltPhysics#2103. Shapes at distance 0, which were reported as 7 m deep: a polytope that is flat
/// to rounding is expanded to the wrong side.
#[test]
fn just_touching_is_not_deep() {
    let random = &mut Random::new(2103);
    for _ in 0..200 {
        let shapes = [cuboid([7.0, 3.0, 0.5]), Shape::new(prism_points(8, 1.0, 4.0))];
        let case = Case::aimed(random, shapes, 1.5).at_distance(0.0);
        for m in judged(&case) {
            assert!(m.separation.abs() < 1e-12, "{m:?}");
        }
    }
}

/// bullet3#1703. A box 1 cm deep in a slab of 128 x 1 x 128. A collision margin that shrinks the
/// thin side lets the box sink.
#[test]
fn box_on_a_slab() {
    for m in judged(&level([cuboid([64.0, 0.5, 64.0]), cuboid([0.5; 3])], [20.0, 0.99, -31.0])) {
        assert!((m.separation + 0.01).abs() < 1e-14 && m.points.len() == 4);
    }
}

/// bullet3#2579. Boxes of 5 mm, which fall below absolute thresholds.
#[test]
fn boxes_of_five_millimetres() {
    let random = &mut Random::new(2579);
    for _ in 0..100 {
        judged(&Case::aimed(random, [cuboid([2.5e-3; 3]), cuboid([2.5e-3; 3])], 0.99));
    }
}

/// bullet3#2157, newton#3773. A cylinder of 1 cm lies 0.1 mm deep in a triangle of 320 m. The rounding of
/// the triangle's far corners exceeds the depth, and 58 m was reported.
#[test]
fn small_hulls_on_a_huge_triangle() {
    let cylinder = Shape::new(prism_points(16, 0.01, 0.01));
    for thickness in [1.0, 1e-2, 1e-4] {
        for (x, y) in [(0.0, 0.0), (100.0, -120.0), (-150.0, -157.0)] {
            for m in judged(&level([triangle(160.0, thickness), cylinder.clone()], [x, y, 0.0099])) {
                assert!((m.separation + 1e-4).abs() < 1e-10, "{} {m:?}", m.separation);
            }
        }
    }
}

/// fcl#395. A plate 1 cm thick and a cube, at any attitude, so that the cube also enters from the
/// plate's rim.
#[test]
fn plate_of_one_centimetre() {
    let random = &mut Random::new(395);
    for _ in 0..200 {
        let shapes = [cuboid([1.0, 1.0, 0.005]), cuboid([0.1; 3])];
        let alpha = random.range(0.3, 1.2);
        judged(&Case::aimed(random, shapes, alpha));
    }
}

/// fcl#493. Boxes with a gap, or an overlap, between 1e-15 and 1e-6 of their size. A gap was
/// counted as touching, and an overlap as a gap.
#[test]
fn boxes_an_epsilon_apart() {
    let boxes = || [cuboid([0.5; 3]), cuboid([0.5; 3])];
    for gap in [1e-15, 1e-13, 1e-9, 1e-6] {
        judged(&level(boxes(), [1.0 + gap, 0.3, 0.2]));
        judged(&level(boxes(), [1.0 - gap, 0.3, 0.2]));
    }
    // Outside the rounding band the outcome must be the exact one.
    for (gap, outcome) in [(1e-13, Outcome::Separated), (-1e-13, Outcome::Contact)] {
        assert!(answers(&level(boxes(), [1.0 + gap, 0.3, 0.2]), 0.0).iter().all(|m| m.outcome == outcome));
    }
}

/// fcl#545. A small cube on the diagonal of a large one, at alpha 0.99. The ray meets a corner of the
/// difference; if the tie is resolved to a direction that is not a face normal, the depth comes out
/// sqrt(3) times too large.
#[test]
fn small_cube_on_the_diagonal() {
    for small in [0.1, 1e-3] {
        let reach = 1.0 + small;
        for m in judged(&level([cuboid([1.0; 3]), cuboid([small; 3])], [0.99 * reach; 3])) {
            assert!((m.alpha - 0.99).abs() < 1e-14);
            assert!((m.separation + 0.01 * reach).abs() < 1e-14, "{m:?}");
        }
    }
}

/// libccd#25. Cubes on the z axis: a triangle of zero area gave NaN. libccd#49. At depth 0 the
/// depth was divided by itself. Alpha is z over twice the half extent.
#[test]
fn cubes_on_one_axis_are_numbers() {
    for (half, z) in [(0.5, 1.9), (1.0, 1.9), (0.95, 1.9), (0.5, 1.0)] {
        for m in judged(&level([cuboid([half; 3]), cuboid([half; 3])], [0.0, 0.0, z])) {
            assert!((m.alpha - z / (2.0 * half)).abs() < 1e-14 && m.normal.z == 1.0);
        }
    }
}

/// coal#636. A solver with a limit of 1 to 20 iterations. It returned NaN for contacts because its
/// status was ignored; here every number must be finite and the open bracket flagged.
#[test]
fn early_stops_say_so() {
    let random = &mut Random::new(636);
    let mut open = 0;
    for limit in (1..=20).cycle().take(400) {
        let shapes = [Shape::new(prism_points(12, 1.0, 0.3)), Shape::new(prism_points(9, 0.4, 0.8))];
        let case = Case { max_iterations: limit, ..Case::aimed(random, shapes, 0.9) };
        for m in judged(&case) {
            open += usize::from(m.flags.gap_open);
            assert!(m.iterations <= limit, "{} of {limit}", m.iterations);
            let numbers = [m.alpha, m.separation, m.points[0].distance, m.points[0].witness_a.length()];
            assert!(numbers.iter().all(|x| x.is_finite()), "{m:?}");
        }
    }
    assert!(open > 100, "{open} stopped early");
}

/// mujoco#3383. Thin hulls at gaps from 1e-11 to 0.1, which were reported as touching.
#[test]
fn separated_hulls_do_not_touch() {
    let random = &mut Random::new(3383);
    for _ in 0..200 {
        let shapes = [Shape::new(prism_points(6, 0.5, 0.02)), cuboid([0.3, 0.02, 0.3])];
        let gap = 10f64.powf(random.range(-11.0, -1.0));
        let case = Case::aimed(random, shapes, 1.5).at_distance(gap);
        judged(&case);
        assert!(answers(&case, 0.0).iter().all(|m| m.outcome == Outcome::Separated), "{gap:e} {case:?}");
    }
}

/// mujoco#3476. Boxes that are flush in a face, an edge or a corner. A corner of a clipped face was
/// lifted along the wrong plane and gave a phantom contact 71 mm deep. Every distance must be 0.
#[test]
fn flush_boxes_have_no_phantom_contacts() {
    let [a, b] = [cuboid([0.5, 0.4, 0.1]), cuboid([0.5, 0.4, 0.1])];
    for d in [[0.0, 0.0, 0.2], [1.0, 0.0, 0.0], [0.5, 0.4, 0.2], [1.0, 0.8, 0.0], [1.0, 0.8, 0.2]] {
        for m in judged(&level([a.clone(), b.clone()], d)) {
            assert!(m.points.iter().all(|p| p.distance.abs() < 1e-15), "{m:?}");
        }
    }
}

/// mujoco#2471. A cube tilted by up to 1e-4 on a box, with a margin: corners of the patch were
/// lost. All four must be there.
#[test]
fn slight_tilt_keeps_the_patch() {
    for tilt in [1e-9, 1e-6, 1e-4] {
        let rotation = turn([0.6, 0.8, 0.0], tilt);
        let case = Case::new([cuboid([1.0, 1.0, 0.1]), cuboid([0.2; 3])], [0.3, 0.1, 0.3], [LEVEL, rotation]);
        judged(&case);
        for m in answers(&case, 0.01) {
            assert_eq!((m.outcome, m.points.len()), (Outcome::Contact, 4), "{m:?}");
        }
    }
}

/// bepuphysics2#417. Identical extruded polygons that overlap gave a depth of NaN, or two points
/// where at least four are due.
#[test]
fn identical_extruded_polygons() {
    for sides in 3..12 {
        let shape = Shape::centred(prism_points(sides, 1.0, 0.5));
        for d in [[0.0, 0.0, 0.9], [0.0, 0.0, 0.5], [0.0; 3], [0.3, 0.0, 0.9]] {
            for m in judged(&level([shape.clone(), shape.clone()], d)) {
                let least = if d == [0.0; 3] { 1 } else { 3 };
                assert!(m.points.len() >= least.min(sides), "{sides} {d:?} {m:?}");
                assert!(m.alpha.is_finite() && m.normal.is_finite());
            }
        }
    }
}

/// bepuphysics2#67. Nearly coplanar faces flicker from step to step. Here a tilt of up to 2e-8 rad,
/// far below the feature angle, must keep the features and the ids of the points.
#[test]
fn near_coplanar_faces_do_not_flicker() {
    // A roof of two faces that differ by about 2e-8 rad, which merge into one face.
    let mut points = box_points([1.0, 0.8, 0.3]);
    points.extend([[0.0, 0.8, 0.3 + 1e-8], [0.0, -0.8, 0.3 + 1e-8]]);
    let roof = Shape::new(points);
    let resting = |tilt: f64| {
        let rotation = turn([0.0, 1.0, 0.0], tilt);
        judged(&Case::new([roof.clone(), cuboid([0.3, 0.2, 0.2])], [0.0, 0.0, 0.499], [LEVEL, rotation]))
    };
    let still = resting(0.0);
    assert!(matches!(still[0].features, Some([Feature::Face(_), Feature::Face(_)])));
    for step in 1..20 {
        let tilt = 1e-9 * f64::from(step) * if step % 2 == 0 { 1.0 } else { -1.0 };
        for (m, first) in resting(tilt).iter().zip(&still) {
            assert_eq!(m.features, first.features);
            assert!(m.points.iter().map(|p| p.id).eq(first.points.iter().map(|p| p.id)));
        }
    }
}

/// reactphysics3d#92. Coplanar triangles that are not merged lose points of the patch. A box face
/// with 30 x 30 additional points must be one face.
#[test]
fn coplanar_triangles_are_one_face() {
    let mut points = box_points([1.0, 1.0, 0.2]);
    points.extend((0..900).map(|i| [-1.0 + f64::from(i % 30) / 15.0, -1.0 + f64::from(i / 30) / 15.0, 0.2]));
    let ground = Shape::new(points);
    assert_eq!(ground.hull.face_count(), 6);
    for m in judged(&level([ground, cuboid([0.31, 0.27, 0.1])], [0.04, 0.03, 0.299])) {
        assert_eq!(m.points.len(), 4);
    }
}

/// Genesis#3127. The whole scene is turned about the vertical in steps of 1/32 of a turn. The
/// answer must not change, although ties between support points are resolved differently.
#[test]
fn turning_the_scene_changes_nothing() {
    let shapes = [cuboid([1.0, 1.0, 0.1]), cuboid([0.3, 0.3, 0.3])];
    let still = judged(&level(shapes.clone(), [0.2, 0.1, 0.399]));
    for step in 1..32 {
        let angle = std::f64::consts::TAU * f64::from(step) / 32.0;
        let (sin, cos) = angle.sin_cos();
        let d = [0.2 * cos - 0.1 * sin, 0.2 * sin + 0.1 * cos, 0.399];
        let rotation = turn([0.0, 0.0, 1.0], angle);
        for (m, first) in judged(&Case::new(shapes.clone(), d, [rotation; 2])).iter().zip(&still) {
            assert!((m.alpha - first.alpha).abs() < 1e-14 && (m.separation - first.separation).abs() < 1e-14);
            assert_eq!(m.points.len(), first.points.len());
        }
    }
}

/// Thin plates that are nearly in one plane. A solver can stall there, with steps at rounding
/// level; one took 300 iterations, which a higher limit would have hidden.
#[test]
fn stacked_plates_do_not_stall() {
    let shapes = [cuboid([1.0, 0.7, 1e-6]), cuboid([0.6, 0.9, 1e-6])];
    let d = [-0.0649442904150084, -0.016471141617431306, 2.02e-6];
    for axis in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.8, 0.0], [0.8, -0.6, 0.0]] {
        for m in judged(&Case::new(shapes.clone(), d, [LEVEL, turn(axis, 1e-4)])) {
            assert!(m.iterations < 40 && m.flags == Flags::default(), "{m:?}");
        }
    }
}

/// Boxes with integer sizes, and prisms on prisms, where the ray meets edges and corners of the
/// difference. A pivot without an exact rule for ties finds no exit, or cycles.
#[test]
fn pivot_ties_end() {
    for (a, b, d) in [
        ([2.0, 3.0, 3.0], [4.0, 4.0, 1.0], [4.0, -4.0, 2.0]),
        ([1.0, 3.0, 2.0], [1.0, 3.0, 4.0], [0.0, -4.0, 4.0]),
    ] {
        for m in judged(&level([cuboid(a), cuboid(b)], d)) {
            assert!(m.iterations < 40 && m.flags == Flags::default(), "{m:?}");
        }
    }
    for sides in 3..16 {
        let prism = Shape::centred(prism_points(sides, 1.0, 0.5));
        for m in judged(&level([prism.clone(), prism], [0.0, 0.0, 0.5])) {
            assert!(m.iterations < 40 && m.alpha == 0.5, "{m:?}");
        }
    }
}

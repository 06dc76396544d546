//! Failures of this library that the matrix or fuzzing found, each with its cause. Every answer of
//! both solvers is compared with the exact one.

use hullcast_contact::{Basis, Feature, Outcome, Workspace, certificate, contact_manifold};

use crate::case::{Case, Shape, any_shape, cuboid, turn};
use crate::named::{LEVEL, answers, judged, level};
use crate::scene::{Random, box_points, prism_points, scaled};

/// Found by the matrix. Hulls at about 1e-11 to 1e-7 of their size apart, around the margin. A
/// closest point in plain doubles is mostly rounding there: GJK got stuck, and one pair in five was
/// UNDECIDED.
#[test]
fn hulls_a_billionth_apart_are_decided() {
    let random = &mut Random::new(1);
    for _ in 0..200 {
        let shapes = [cuboid([1.0, 0.7, 0.4]), Shape::new(prism_points(7, 0.6, 0.5))];
        let margin = 10f64.powf(random.range(-11.0, -7.0));
        let share = [0.5, 0.999, 1.001, 2.0][random.below(4)];
        judged(&Case::aimed(random, shapes, 1.5).at_distance(margin * share).with_margins([margin]));
    }
}

/// Found by the matrix. The basis of a solver that is stopped early is off the support plane. A
/// face of the far side was then taken as touching, its projection overlapped the other hull, and
/// separated hulls were reported as CONTACT.
#[test]
fn early_stops_do_not_invent_contacts() {
    let a = Shape::new(vec![
        [0.1875, -0.296875, 0.9375],
        [0.890625, -0.09375, -0.4375],
        [0.671875, 0.34375, 0.65625],
        [-0.796875, 0.515625, 0.296875],
    ]);
    let b = Shape::new(vec![
        [-0.046875, 0.953125, 0.328125],
        [0.375, 0.46875, 0.796875],
        [-0.765625, -0.640625, -0.15625],
        [-0.296875, -0.46875, -0.828125],
    ]);
    let rotations = [
        [-0.0827216576609364, -0.5293645832590999, 0.32859040844171405, 0.7777908515949862],
        [-0.4063704887291144, 0.006293026149322877, -0.2447522644546267, 0.8802952645313259],
    ];
    let case = Case::new([a, b], [0.8393576959297059, 1.1659839253516702, 0.8617446829190631], rotations);
    judged(&Case { max_iterations: 3, ..case.clone() });
    assert!(answers(&case, 0.0).iter().all(|m| m.outcome == Outcome::Separated));
}

/// As above, but with a loose tolerance: the basis may be off the support plane by as much as the
/// tolerance allows.
#[test]
fn loose_answers_hold_what_they_say() {
    let random = &mut Random::new(2);
    for tolerance in [1.0, 0.3, 0.1, 1e-3] {
        for _ in 0..300 {
            let shapes = [any_shape(random), any_shape(random)];
            let alpha = random.range(0.8, 1.3);
            judged(&Case { relative_tolerance: tolerance, ..Case::aimed(random, shapes, alpha) });
        }
    }
}

/// Found by the matrix. A box whose top face carries points that are coplanar only to rounding. A
/// triangle of such points is thin, and its plane so inaccurate that alpha missed its budget by a
/// third.
#[test]
fn nearly_coplanar_points_keep_the_budget() {
    let random = &mut Random::new(3);
    for _ in 0..500 {
        let mut points = box_points([1.0, 0.8, 0.3]);
        for i in 0..25 {
            let [x, y] = [-0.9 + 0.45 * f64::from(i % 5), -0.7 + 0.35 * f64::from(i / 5)];
            points.push([x, y, 0.3 + 1e-15 * random.range(-1.0, 1.0)]);
        }
        let spin = turn([0.0, 0.0, 1.0], random.range(0.0, 6.0));
        let d = [random.range(-0.3, 0.3), random.range(-0.3, 0.3), 0.5];
        judged(&Case::new([Shape::new(points), cuboid([0.4, 0.3, 0.2])], d, [LEVEL, spin]));
    }
}

/// Found by fuzzing. A hull from 1e-9 down to 1e-39 of the other's size. If a hull is smaller than
/// the rounding of its own position, its projected corners coincide and its sides have no
/// direction. Clipping by such sides kept the whole of the large face, so witnesses were outside
/// the small hull by the size of the large one.
#[test]
fn a_hull_smaller_than_rounding_keeps_its_witnesses() {
    let random = &mut Random::new(20);
    let mut faces = 0;
    for power in (9..40).step_by(3) {
        let size = 10f64.powi(-power);
        for round in 0..40 {
            let points = match round % 3 {
                0 => box_points([0.5, 0.3, 0.4]),
                1 => prism_points(5, 0.6, 0.3),
                _ => vec![[0.7, 0.4, 0.2], [-0.5, -0.4, -0.6], [-0.5, -0.4, 0.2], [0.3, 0.4, 0.2]],
            };
            let small = Shape::new(points.iter().map(|&p| scaled(p, size)).collect());
            let height = 0.5 + size * random.range(-0.2, 0.5);
            let at = [random.range(-0.9, 0.9), random.range(-0.6, 0.6), height];
            let rotations = [LEVEL, if round % 2 == 0 { LEVEL } else { random.rotation() }];
            let large = cuboid([1.0, 0.7, 0.5]);
            let case = if round % 4 < 2 {
                Case::new([large, small], at, rotations)
            } else {
                Case::new([small, large], at.map(|x| -x), [rotations[1], rotations[0]])
            };
            for m in judged(&case) {
                faces += usize::from(matches!(m.features, Some([Feature::Face(_), Feature::Face(_)])));
            }
        }
    }
    assert!(faces > 200, "{faces} faces on faces");
}

/// Found by fuzzing. A wedge of half width 1e-1 to 1e-8 points at the corner of a cube. The region
/// within the merge distance of both sides of a sharp corner extends far beyond the corner, the
/// farther the sharper it is. A face with such a corner was taken to touch a feature that only
/// comes near its tip.
#[test]
fn nothing_touches_beyond_a_sharp_corner() {
    let (mut estimated, mut touching) = (0, 0);
    for power in 1..=8 {
        let half = 10f64.powi(-power);
        let tip = [[0.0, 0.0], [1.0, half], [1.0, -half]];
        let wedge = Shape::new([0.0, 0.2].iter().flat_map(|&z| tip.map(|[x, y]| [x, y, z])).collect());
        // The cube is turned so that one of its corners points at the tip.
        let rotation = turn([0.0, 0.0, 1.0], std::f64::consts::FRAC_PI_4);
        let reach = 1e-15 / half;
        for gap in [-0.1, -3.0 * reach, 0.0, 3.0 * reach, 8.0 * reach, 1e-5] {
            for (height, order) in [(0.3, [0, 1]), (0.30001, [0, 1]), (0.3, [1, 0]), (0.30001, [1, 0])] {
                let cube = cuboid([0.1; 3]);
                let centre = [-gap - 0.1 * 2f64.sqrt(), 0.0, height];
                let (shapes, at) = ([cube, wedge.clone()], [centre, [0.0; 3]]);
                let mut case = Case::new(order.map(|i| shapes[i].clone()), [0.0; 3], [LEVEL; 2]);
                case.positions = order.map(|i| at[i]);
                case.rotations = order.map(|i| [rotation, LEVEL][i]);
                for m in judged(&case) {
                    estimated += usize::from(m.flags.estimated);
                    touching += usize::from(!m.flags.estimated);
                }
            }
        }
    }
    assert!(estimated > 100 && touching > 100, "{estimated} estimated, {touching} touching");
}

/// Found by fuzzing. Needles of length 1e6 to 3e9. The closest point of a thin triangle was
/// computed as the foot on its plane, whose normal is a small difference of large products. It may
/// lie far from the triangle, so hulls beyond the margin were reported as CONTACT.
#[test]
fn long_needles_are_as_far_as_they_are() {
    let random = &mut Random::new(91);
    for _ in 0..600 {
        let length = 10f64.powf(random.range(6.0, 9.5));
        let axis = [[1.0; 3], [1.0, 1e-3, 0.0], random.direction()][random.below(3)];
        let mut points: Vec<[f64; 3]> =
            (0..5).map(|_| scaled(random.direction(), random.range(1.0, 4.0))).collect();
        points.push(scaled(axis, length));
        let needle = Shape::new(points);
        let shapes = [any_shape(random), needle];
        let distance = random.range(0.3, 1.5);
        let alpha = random.range(1.1, 2.0);
        let case = Case::aimed(random, shapes, alpha).at_distance(distance);
        judged(&case.with_margins([0.5, 0.9, 0.99, 1.01, 1.1, 2.0].map(|share| share * distance)));
    }
}

/// Found by fuzzing. A side of the clipping face does not cut if it is within the merge distance of
/// the crossing of its neighbours' lines. Those lines were then taken to cross in another corner,
/// and that corner's height was used for the contact point.
#[test]
fn sides_around_an_uncut_one_meet_between_them() {
    let a = vec![
        [0.5, 0.0, 0.03125],
        [3.3125, 3.3125, 3.3125],
        [-0.203125, -13.0, 3.3125],
        [3.3125, 2.5625, 2.5625],
        [1.34375, 2.5625, 2.5625],
        [2.5625, 2.5625, 2.5625],
        [2.5625, 2.53125, 3.3125],
        [-0.40625, -0.40625, -0.40625000000000194],
        [0.5, 0.0, 3.3125],
        [-0.21875, -0.40625, -0.21875],
        [-0.21875, -0.21875, -0.21875],
    ];
    let b = vec![
        [2.78125, 2.78125, 0.0],
        [0.3125, 2.78125, 1.5],
        [-0.40625, 3.312500000000047, 3.3125],
        [3.3125, -0.40625, -0.40625],
        [-0.40625000000000194, 0.3125, 0.0],
        [3.3125, 0.0, 1.34375],
        [0.59375, 48.0, -0.21875],
        [3.3125, 0.0, -0.40625],
        [1.09375, -0.40625, 3.3125],
        [2.187500000000031, 240518168576.0, 240518168576.0],
        [-3.156249999999955, -3.15625, 0.84375],
        [-3.125, 51.31250000000005, 1.75],
        [3.3125, 0.0625, 0.0],
    ];
    let case = level([Shape::new(a), Shape::new(b)], [0.0; 3]);
    let case = Case { relative_tolerance: 1e-9, max_iterations: 5, ..case };
    let mut query = case.query(1e-9);
    query.accuracy.feature_angle = 0.5;
    let [a, b] = case.bodies();
    let m = case.solve(&query, &mut Workspace::default());
    assert!(m.points.len() > 2 && !m.flags.estimated, "{m:?}");
    certificate::check(&a, &b, &query, &m).unwrap_or_else(|violation| panic!("{violation}\n{m:?}"));
}

/// Found by fuzzing. Hulls whose points have doubles 3e-17 to 1e-7 away. Corners of a face that are
/// some roundings apart can appear in either order when seen from the side. The side between them
/// then pointed in an arbitrary direction, and clipping by it cut off most of a patch or left
/// witnesses outside, in ordinary scenes.
#[test]
fn corners_that_nearly_coincide_cut_nothing_off() {
    let random = &mut Random::new(77);
    let mut patches = 0;
    for _ in 0..4000 {
        let doubled = |random: &mut Random| {
            let half = [0; 3].map(|_| random.range(0.3, 1.0));
            let count = 5 + random.below(8);
            let mut points = crate::scene::cloud(random, count, half);
            for i in 0..points.len() {
                let by = scaled(random.direction(), 10f64.powf(random.range(-16.5, -7.0)));
                points.push(std::array::from_fn(|k| points[i][k] + by[k]));
            }
            Shape::new(points)
        };
        let shapes = [doubled(random), doubled(random)];
        let tilt = turn([1.0, 0.0, 0.0], random.range(-0.4, 0.4));
        let spin = turn([0.0, 0.0, 1.0], random.range(0.0, 6.3));
        let d = [random.range(-0.4, 0.4), random.range(-0.4, 0.4), random.range(0.3, 0.9)];
        let case = Case::new(shapes, d, [spin, tilt]);
        for feature_angle in [0.01, 0.5] {
            let mut query = case.query(f64::INFINITY);
            query.accuracy.feature_angle = feature_angle;
            let m = case.certified(&query);
            patches += usize::from(m.points.len() > 2);
        }
        judged(&case);
    }
    assert!(patches > 2000, "{patches}");
}

/// Found by fuzzing. Beside a needle, a triangle and one of its sides are equally far to a double's
/// rounding. The side won that tie, so the corner opposite to it was dropped and then found again,
/// and pairs were UNDECIDED although no limit was set.
#[test]
fn needles_beside_hulls_are_decided() {
    let random = &mut Random::new(92);
    let mut decided = [0; 2];
    for round in 0..400 {
        let base = [[2.78125, 0.0, 0.0], [3.3125, -0.4062499999999993, 2.78125], [2.78125, 2.78125, 2.78125]];
        let length = if round == 0 { 7247757312.0 } else { 10f64.powf(random.range(8.0, 10.0)) };
        let needle = Shape::new([&base[..], &[[0.3125, 0.3125, length]]].concat());
        let small = match round {
            0 => vec![
                [-0.40625, 1.3125, 3.3125],
                [1.5, 1.6875, 1.687500000000009],
                [0.0, 0.0, -1.6249999999999867],
                [-2.875, -1.15625, 0.0],
            ],
            _ => (0..4).map(|_| [0; 3].map(|_| random.range(-3.0, 3.0))).collect(),
        };
        let case = level([needle, Shape::new(small)], [0.0; 3]);
        let case = Case { relative_tolerance: [1.0, 0.0, 1e-3][round % 3], ..case };
        judged(&case.clone().with_margins([1.0, 0.1, 0.01]));
        // A warm start that is not a triangle leaves inner points in the simplex.
        let [a, b] = case.bodies();
        for vertex in 0..4 {
            let warm = Basis { a: [vertex; 3], b: [vertex; 3] };
            for margin in [1.0, 0.1, 0.01] {
                let workspace = &mut Workspace::default();
                let answer = contact_manifold(&a, &b, &case.query(margin), Some(&warm), workspace);
                assert_ne!(answer.outcome, Outcome::Undecided, "{answer:?}\n{case:?}");
                decided[usize::from(answer.outcome == Outcome::Contact)] += 1;
            }
        }
    }
    assert!(decided.iter().all(|&count| count > 100), "{decided:?}");
}

/// Found by fuzzing; the fault was in the certificate, not in the answer. For a hull of size 1e20
/// with a thin basis, only one of the weights is not noise. The certificate tried only pairs and
/// triples of weights and found no valid bound.
#[test]
fn the_certificate_tries_every_weight_alone() {
    let a = vec![
        [2.90625, 1.09375, 0.3125],
        [0.0, 0.0, 3.3125],
        [0.53125, 0.53125, 0.53125],
        [1.1875, 0.53125, 0.53125],
        [3.8125, 3.3125, 0.0],
    ];
    let b = vec![
        [3.8125, -0.28125, 3.3125],
        [0.0, 1.8125, 2.1875],
        [2405181685760.0, 3.8125, -0.40625],
        [0.90625, 0.3125, 2405181685760.0],
        [0.53125, 0.53125, 0.53125],
        [-0.40625, 3.3125, 0.0],
        [2.1875, 2405181685760.0, 2.4441935897665156e20],
        [0.3125, 2405181685760.0, 37580963840.0],
        [-3.81640625, 1.27734375, 6313601925114.617],
        [3.3125, 3.3125, -0.40625],
    ];
    let turned = [0.5773306324272376, 0.5773306324272376, 0.5773306324272376, 0.008247580463246251];
    let mut case = Case::new([Shape::new(a), Shape::new(b)], [0.0; 3], [turned, [0.5; 4]]);
    case.positions = [[-1.5625, -3.90625, -3.156250000000031], [-0.40625, 3.3125, 3.3125]];
    case.relative_tolerance = 1e-9;
    judged(&Case { max_iterations: 5, ..case.clone() });
    judged(&case);
}

//! Contact manifolds: closed forms, the table of feature pairs, and seeded sweeps whose answers are
//! checked by the certificate.

mod scene;

use hullcast_contact::{
    Accuracy, Body, ConvexHull, Element, Feature, Manifold, Outcome, Query, Solver, Wanted, Workspace,
    certificate, contact_manifold,
};
use scene::*;

fn everything(solver: Solver) -> Query {
    Query {
        margin: f64::INFINITY,
        accuracy: Accuracy { solver, ..Default::default() },
        wanted: Wanted::Points,
    }
}

fn solve(a: &Body<'_>, b: &Body<'_>, query: &Query) -> Manifold {
    let manifold = contact_manifold(a, b, query, None, &mut Workspace::default()).clone();
    if let Err(violation) = certificate::check(a, b, query, &manifold) {
        panic!("{violation}\n{query:?}\n{manifold:#?}\n{a:?}\n{b:?}");
    }
    manifold
}

/// A box of half height 0.25 stacked on one of half height 0.5, centres 0.7 apart. Closed form:
/// alpha is 0.7 / 0.75, the separation is -0.05, and the patch is the overlap of two squares.
/// Catches a wrong sign of the normal or a distance, and a lost corner.
#[test]
fn stacked_boxes_touch_on_the_overlap_of_their_faces() {
    let (a, b) = (box_hull([1.0, 1.0, 0.5]), box_hull([0.5, 0.5, 0.25]));
    for solver in Solver::ALL {
        let m = solve(&at(&a, [0.0; 3], IDENTITY), &at(&b, [0.75, 0.0, 0.7], IDENTITY), &everything(solver));
        assert_eq!(m.outcome, Outcome::Contact);
        assert!((m.alpha - 0.7 / 0.75).abs() < 1e-15, "{solver:?} {}", m.alpha);
        assert!((m.normal.z - 1.0).abs() < 1e-15);
        assert!((m.separation + 0.05).abs() < 1e-15);
        let mut corners: Vec<_> =
            m.points.iter().map(|p| (p.witness_a * 1e6).to_array().map(|x| x.round() as i64)).collect();
        corners.sort_unstable();
        let z = 500_000;
        assert_eq!(
            corners,
            [
                [250_000, -500_000, z],
                [250_000, 500_000, z],
                [1_000_000, -500_000, z],
                [1_000_000, 500_000, z]
            ]
        );
        assert!(m.points.iter().all(|p| (p.distance + 0.05).abs() < 1e-15));
        assert!(matches!(m.features, Some([Feature::Face(_), Feature::Face(_)])));
    }
}

/// A cube of half extent 0.5 stands on its corner, 0.01 deep in a box. Its height over the corner
/// is sqrt(0.75), so the contact is one point below its centre, made by B's vertex inside A's face.
/// Catches a face chosen for the wrong hull, and a point named by the wrong features.
#[test]
fn a_corner_on_a_face_is_one_point() {
    let (ground, cube) = (box_hull([2.0, 2.0, 0.5]), box_hull([0.5, 0.5, 0.5]));
    let half = (0.5 * (1.0 / 3f64.sqrt()).acos()).sin_cos();
    // Rotates (1, 1, 1) / sqrt(3) to z, about the axis (1, -1, 0) / sqrt(2).
    let axis = 0.5f64.sqrt();
    let rotation = [axis * half.0, -axis * half.0, 0.0, half.1];
    let height = 0.5 + 0.75f64.sqrt() - 0.01;
    for solver in Solver::ALL {
        let m = solve(
            &at(&ground, [0.0; 3], IDENTITY),
            &at(&cube, [0.1, 0.2, height], rotation),
            &everything(solver),
        );
        assert_eq!(m.points.len(), 1, "{solver:?} {m:?}");
        assert!((m.separation + 0.01).abs() < 1e-14, "{}", m.separation);
        assert!(matches!(m.features, Some([Feature::Face(_), Feature::Vertex(_)])));
        assert!(matches!(m.points[0].id, [Element::Inside, Element::Vertex(_)]));
        assert!((m.points[0].witness_a.truncate() - glam::DVec2::new(0.1, 0.2)).length() < 1e-14);
    }
}

/// Two roofs with crossed ridges, 0.05 apart and 0.05 deep. They touch in one point made by two
/// edges, whose distance is the gap. Catches an arc test of the wrong orientation.
#[test]
fn crossed_edges_are_one_point() {
    let roof = |up: f64, along_x: bool| {
        let ridge = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]];
        let base = [[1.0, 0.5, -1.0], [1.0, -0.5, -1.0], [-1.0, 0.5, -1.0], [-1.0, -0.5, -1.0]];
        let turn = |[x, y, z]: [f64; 3]| if along_x { [x, y, up * z] } else { [-y, x, up * z] };
        hull(&ridge.into_iter().chain(base).map(turn).collect::<Vec<_>>())
    };
    let (a, b) = (roof(1.0, true), roof(-1.0, false));
    for solver in Solver::ALL {
        for gap in [-0.05, 0.05] {
            let m =
                solve(&at(&a, [0.0; 3], IDENTITY), &at(&b, [0.01, 0.02, gap], IDENTITY), &everything(solver));
            assert_eq!(m.points.len(), 1);
            assert!(matches!(m.points[0].id, [Element::Edge(_), Element::Edge(_)]), "{m:?}");
            assert!((m.points[0].distance - gap).abs() < 1e-14);
        }
    }
}

/// The feature pairs that generic poses produce: 0 is a vertex, 1 an edge, 2 a face. Vertex on
/// vertex and vertex on edge occur only in a tie.
const GENERIC: [(usize, usize); 6] = [(0, 2), (2, 0), (1, 1), (1, 2), (2, 1), (2, 2)];

struct Coverage {
    pairs: usize,
    kinds: [[usize; 3]; 3],
    estimated: usize,
    contacts: usize,
    separated: usize,
}

fn kind(f: &Feature) -> usize {
    match f {
        Feature::Vertex(_) => 0,
        Feature::Edge(_) => 1,
        Feature::Face(_) => 2,
    }
}

fn shapes(random: &mut Random) -> Vec<ConvexHull> {
    let half = |random: &mut Random| [random.range(0.3, 1.0), random.range(0.3, 1.0), random.range(0.3, 1.0)];
    let mut shapes = Vec::new();
    for _ in 0..4 {
        shapes.push(box_hull(half(random)));
        for count in [4, 6, 16, 64, 256] {
            let h = half(random);
            if let Ok(shape) = ConvexHull::new(&cloud(random, count, h)) {
                shapes.push(shape);
            }
        }
        shapes.push(hull(&prism_points(
            3 + random.below(20),
            random.range(0.3, 1.0),
            random.range(0.2, 1.0),
        )));
        shapes.push(box_hull([random.range(0.3, 1.0), random.range(0.3, 1.0), 1e-3]));
        shapes.push(box_hull([random.range(0.3, 1.0), 1e-4, 1e-4]));
    }
    shapes
}

/// Random shapes at every depth, with both solvers, with and without a warm start. The certificate
/// checks each answer; the solvers' brackets must overlap and their outcomes must be equal. Catches
/// a solver that stops early, a bound of the wrong sign, and a warm start that changes the answer.
#[test]
fn every_answer_carries_its_certificate() {
    let random = &mut Random::new(7);
    let shapes = shapes(random);
    let mut covered = Coverage { pairs: 0, kinds: [[0; 3]; 3], estimated: 0, contacts: 0, separated: 0 };
    let mut workspace = Workspace::default();
    for _ in 0..20_000 {
        let (a, b) = (&shapes[random.below(shapes.len())], &shapes[random.below(shapes.len())]);
        let (direction, reach) = (random.direction(), a.circumradius() + b.circumradius());
        let origin = scaled(random.direction(), 3.0);
        let body_a = at(a, origin, random.rotation());
        let turned = random.rotation();
        let along = |by: f64| at(b, std::array::from_fn(|i| origin[i] + by * direction[i]), turned);
        // Solves the pair once to learn its alpha, then moves B along the direction to the wanted
        // growth scale.
        let alpha = solve(&body_a, &along(reach), &everything(Solver::Portal)).alpha;
        let wanted = match random.below(6) {
            0 => random.range(0.05, 0.9),
            1 => random.range(0.9, 1.0),
            2 => 1.0 + random.range(-1e-12, 1e-12),
            3 => random.range(1.0, 1.1),
            4 => random.range(1.1, 3.0),
            _ => random.range(0.99, 1.01),
        };
        let body_b = along(reach * wanted / alpha);
        let margin = [0.0, 0.01, 0.1, f64::INFINITY][random.below(4)];
        let answers =
            Solver::ALL.map(|solver| solve(&body_a, &body_b, &Query { margin, ..everything(solver) }));
        let [portal, gjk] = &answers;
        assert_eq!(portal.outcome, gjk.outcome, "{portal:?} {gjk:?}");
        assert!(portal.alpha_lower <= gjk.alpha_upper && gjk.alpha_lower <= portal.alpha_upper);
        for m in &answers {
            assert!(!m.flags.gap_open && m.outcome != Outcome::Undecided, "{m:?} {a:?} {b:?}");
        }
        covered.pairs += 1;
        if portal.outcome == Outcome::Separated {
            covered.separated += 1;
            continue;
        }
        covered.contacts += 1;
        covered.estimated += usize::from(portal.flags.estimated);
        if let Some([fa, fb]) = &portal.features {
            covered.kinds[kind(fa)][kind(fb)] += 1;
        }
        // With an infinite margin no distance has to be decided, so only the growth step's
        // iterations count.
        let query = everything(Solver::Portal);
        let warm = contact_manifold(&body_a, &body_b, &query, portal.basis.as_ref(), &mut workspace);
        certificate::check(&body_a, &body_b, &query, warm).expect("a warm answer");
        assert!(warm.iterations <= 2, "{} steps from the optimal basis", warm.iterations);
    }
    assert_eq!(covered.pairs, 20_000);
    assert!(
        covered.contacts > 8000 && covered.separated > 2000,
        "{} {}",
        covered.contacts,
        covered.separated
    );
    assert!(covered.estimated > 100, "{}", covered.estimated);
    assert!(GENERIC.iter().all(|&(i, j)| covered.kinds[i][j] > 10), "{:?}", covered.kinds);
}

/// A plate of half thickness 0.1 in contact with itself. The centres coincide and give no
/// direction, so alpha is 0 and the manifold is that of an offset along the thinnest direction:
/// separation -0.2, four points. Catches a division 0/0.
#[test]
fn coincident_centres_are_flagged_and_still_answered() {
    let plate = box_hull([0.1, 1.0, 1.0]);
    for solver in Solver::ALL {
        for (position, rotation) in [([0.0; 3], IDENTITY), ([1.0, 2.0, 3.0], [0.5, 0.5, 0.5, 0.5])] {
            let body = at(&plate, position, rotation);
            let m = solve(&body, &body, &everything(solver));
            assert!(m.flags.coincident && m.outcome == Outcome::Contact);
            assert_eq!((m.alpha, m.alpha_lower), (0.0, 0.0));
            assert!((m.separation + 0.2).abs() < 1e-15, "{m:?}");
            assert_eq!(m.points.len(), 4);
            assert!(m.basis.is_some());
        }
    }
}

/// A 17-gon tilted on a 24-gon, whose patch is reduced to 1, 2, 3, 4 and 8 points. The reduced
/// patch must keep the deepest point and most of the area, and report the kept fraction. Catches a
/// reduction that keeps neighbouring points, or that does not set its flag.
#[test]
fn reduction_keeps_the_deepest_and_the_largest() {
    let (a, b) = (hull(&prism_points(24, 1.0, 0.5)), hull(&prism_points(17, 0.9, 0.5)));
    let tilt = 2e-3;
    let rotation = [f64::sin(tilt / 2.0), 0.0, 0.0, f64::cos(tilt / 2.0)];
    let (body_a, body_b) = (at(&a, [0.0; 3], IDENTITY), at(&b, [0.05, 0.02, 0.99], rotation));
    let whole = solve(&body_a, &body_b, &everything(Solver::Portal));
    assert!(whole.points.len() > 12 && !whole.flags.reduced && whole.kept_area == 1.0);
    let deepest = |m: &Manifold| m.points.iter().map(|p| p.distance).fold(f64::INFINITY, f64::min);
    let area = |m: &Manifold| {
        let first = m.points[0].witness_a;
        let fan = m.points.windows(2).map(|w| (w[0].witness_a - first).cross(w[1].witness_a - first));
        0.5 * fan.sum::<glam::DVec3>().length()
    };
    for (max, share) in [(1, 0.0), (2, 0.0), (3, 0.3), (4, 0.6), (8, 0.85)] {
        let accuracy = Accuracy { max_points: max, ..Default::default() };
        let m = solve(&body_a, &body_b, &Query { accuracy, ..everything(Solver::Portal) });
        assert_eq!(m.points.len(), max as usize);
        assert!(m.flags.reduced);
        assert_eq!(deepest(&m), deepest(&whole));
        assert!(m.points.iter().all(|p| whole.points.contains(p)));
        assert!((m.kept_area - area(&m) / area(&whole)).abs() < 1e-5, "{max}: {}", m.kept_area);
        assert!(area(&m) >= share * area(&whole), "{max}: {} of {}", area(&m), area(&whole));
    }
}

/// Random pairs, asked for each kind of result and with limits of 1 to 10 iterations. The requested
/// results must not change the values, and the bracket of a limited solver must still contain the
/// answer. Catches an early exit that decides wrongly.
#[test]
fn stopping_early_is_still_right() {
    let random = &mut Random::new(99);
    let shapes = shapes(random);
    let (mut decided_early, mut open) = (0, 0);
    for _ in 0..5000 {
        let (a, b) = (&shapes[random.below(shapes.len())], &shapes[random.below(shapes.len())]);
        let reach = a.circumradius() + b.circumradius();
        let position = scaled(random.direction(), reach * random.range(0.05, 1.2));
        let (body_a, body_b) = (at(a, [0.0; 3], random.rotation()), at(b, position, random.rotation()));
        for solver in Solver::ALL {
            let query = Query { margin: 0.02, ..everything(solver) };
            let whole = solve(&body_a, &body_b, &query);
            let growth = solve(&body_a, &body_b, &Query { wanted: Wanted::Growth, ..query });
            assert_eq!(
                (growth.alpha, growth.normal, growth.outcome),
                (whole.alpha, whole.normal, whole.outcome)
            );
            let outcome = solve(&body_a, &body_b, &Query { wanted: Wanted::Outcome, ..query });
            assert_eq!(outcome.outcome, whole.outcome);
            decided_early += usize::from(outcome.iterations < whole.iterations);
            let exact = solve(&body_a, &body_b, &everything(solver));
            for max_iterations in [1, 2, 3, 5, 10] {
                let accuracy = Accuracy { solver, max_iterations, ..Default::default() };
                let m = solve(&body_a, &body_b, &Query { accuracy, ..everything(solver) });
                assert!(
                    m.alpha_lower <= exact.alpha_upper && exact.alpha_lower <= m.alpha_upper,
                    "{m:?} {exact:?}"
                );
                assert!(!m.points.is_empty());
                open += usize::from(m.flags.gap_open);
            }
        }
    }
    assert!(decided_early > 1000 && open > 5000, "{decided_early} {open}");
}

/// Hulls with more than 512 vertices, for which the support mapping builds a map of directions:
/// generic ones, and ones with plateaus, where many vertices are equally far (a fine prism's rims,
/// a lattice's facets). Catches a bound built on a support point that is not the farthest.
#[test]
fn large_hulls_keep_their_certificates() {
    let random = &mut Random::new(5);
    let lattice: Vec<[f64; 3]> = (0..40_000)
        .map(|_| {
            let d = random.direction();
            d.map(|x| (x * 64.0).round())
        })
        .collect();
    let large = [
        hull(&cloud(random, 1500, [1.0, 0.8, 0.6])),
        hull(&cloud(random, 3000, [1.0, 0.5, 1e-3])),
        hull(&prism_points(600, 1.0, 0.3)),
        hull(&lattice),
        box_hull([0.7, 0.5, 0.3]),
    ];
    assert!(large[..4].iter().all(|h| h.vertex_count() > 512), "a hull too small for a map");
    let mut answered = 0;
    for _ in 0..600 {
        let (a, b) = (&large[random.below(5)], &large[random.below(5)]);
        let reach = a.circumradius() + b.circumradius();
        let position = scaled(random.direction(), reach * random.range(0.1, 1.1));
        let (body_a, body_b) = (at(a, [0.0; 3], random.rotation()), at(b, position, random.rotation()));
        let [portal, gjk] = Solver::ALL.map(|solver| solve(&body_a, &body_b, &everything(solver)));
        assert!(!portal.flags.gap_open && !gjk.flags.gap_open);
        assert!(portal.alpha_lower <= gjk.alpha_upper && gjk.alpha_lower <= portal.alpha_upper);
        for margin in [0.0, 0.1] {
            let [p, g] =
                Solver::ALL.map(|solver| solve(&body_a, &body_b, &Query { margin, ..everything(solver) }));
            assert_eq!(p.outcome, g.outcome);
            answered += 1;
        }
    }
    assert_eq!(answered, 1200);
}

/// Two boxes in random axes and orders of corners. The closed form over the separating axes must
/// name the facet, so that the portal needs one iteration and rarely more. Catches a wrong sign or
/// axis in the closed form, which the portal would correct silently.
#[test]
fn the_closed_form_of_boxes_names_the_facet() {
    let random = &mut Random::new(3);
    let (mut steps, mut worst) = (0, 0);
    for _ in 0..3000 {
        let boxes: [ConvexHull; 2] = std::array::from_fn(|_| {
            // Each box has axes of its own and its corners in any order.
            let half = std::array::from_fn(|_| random.range(0.2, 1.0));
            let turn = glam::DQuat::from_array(random.rotation());
            let mut corners =
                box_points(half).iter().map(|&c| (turn * glam::DVec3::from(c)).into()).collect::<Vec<_>>();
            corners.rotate_left(random.below(8));
            hull(&corners)
        });
        let position = scaled(random.direction(), random.range(0.1, 3.0));
        let (a, b) = (at(&boxes[0], [0.0; 3], random.rotation()), at(&boxes[1], position, random.rotation()));
        let m = solve(&a, &b, &everything(Solver::Portal));
        steps += m.iterations;
        worst = worst.max(m.iterations);
    }
    assert!(steps <= 3030 && worst <= 5, "{steps} steps for 3000 pairs, {worst} at most");
}

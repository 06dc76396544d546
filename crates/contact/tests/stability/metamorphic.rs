//! Properties that need no known answer, tested on generated scenes that aim at degeneracy: their
//! coordinates and quaternions lie on a small grid, or off it by a few ulps.

use std::rc::Rc;

use hullcast_contact::{ConvexHull, Feature, Manifold, Workspace};
use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestRng, TestRunner};

use crate::case::{Case, Shape, norm, rotate};
use crate::judge::{SolverScore, U, judge};
use crate::oracle::Exact;
use crate::polygon;

/// Runs the test on the same cases every time. On failure the panic shows the smallest failing
/// scene.
pub(crate) fn holds<S: Strategy>(
    cases: u32,
    strategy: S,
    test: impl Fn(S::Value) -> Result<(), TestCaseError>,
) {
    let config =
        Config { cases, failure_persistence: None, max_global_rejects: 100_000, ..Config::default() };
    let rng = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    if let Err(error) = TestRunner::new_with_rng(config, rng).run(&strategy, test) {
        panic!("{error}");
    }
}

/// `x` moved by some ulps.
fn nudged(x: f64, ulps: i64) -> f64 {
    if x == 0.0 {
        ulps as f64 * f64::EPSILON * 0.25
    } else {
        f64::from_bits((x.to_bits() as i64 + ulps) as u64)
    }
}

/// A coordinate on the grid; one in ten may be off it by up to 3 ulps.
fn coordinate() -> impl Strategy<Value = f64> {
    let grid = prop::sample::select(vec![-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0]);
    (grid, prop_oneof![9 => Just(0i64), 1 => -3i64..=3]).prop_map(|(x, ulps)| nudged(x, ulps))
}

pub(crate) fn point() -> impl Strategy<Value = [f64; 3]> {
    [coordinate(), coordinate(), coordinate()]
}

/// Boxes, and hulls of grid points, which are often coplanar, collinear or equal to within some
/// ulps. The origin is inside and is the contraction point.
fn shape() -> impl Strategy<Value = Rc<Shape>> {
    let half = prop::sample::select(vec![0.25, 0.5, 1.0, 2.0, 3.0, 1e-3]);
    let cuboid = [half.clone(), half.clone(), half].prop_map(crate::scene::box_points);
    let cloud = prop::collection::vec(point(), 5..14);
    let about_origin = |points: Vec<[f64; 3]>| {
        let options =
            hullcast_contact::HullOptions { contraction_point: Some([0.0; 3]), ..Default::default() };
        let hull = ConvexHull::with_options(&points, &options).ok()?;
        (hull.inradius() > 1e-4).then(|| Rc::new(Shape { points, hull }))
    };
    prop_oneof![cuboid, cloud].prop_filter_map("no hull about the origin", about_origin)
}

/// Rotations: some that map the grid's cube to itself, some near those, and some at random.
pub(crate) fn rotation() -> impl Strategy<Value = [f64; 4]> {
    let s = 0.5f64.sqrt();
    let turns = vec![
        [0.0, 0.0, 0.0, 1.0],
        [1.0, 0.0, 0.0, 0.0],
        [0.5, 0.5, 0.5, 0.5],
        [s, 0.0, 0.0, s],
        [0.0, s, s, 0.0],
    ];
    let near = (prop::sample::select(turns.clone()), [-3i64..=3, -3i64..=3, -3i64..=3, -3i64..=3])
        .prop_map(|(q, ulps)| std::array::from_fn(|k| nudged(q[k], ulps[k])));
    let any = [-1.0..1.0, -1.0..1.0, -1.0..1.0, 0.1..1.0f64].prop_map(|q| {
        let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        q.map(|x| x / length)
    });
    let exact = prop::sample::select(turns[..3].to_vec());
    prop_oneof![3 => exact, 2 => near, 1 => any]
}

pub(crate) fn scene() -> impl Strategy<Value = Case> {
    // Offsets along axes and diagonals meet edges and corners of the difference.
    let aligned = prop::sample::select(vec![-1.0, 0.0, 1.0]);
    let aligned = [aligned.clone(), aligned.clone(), aligned];
    let offset = (prop_oneof![point(), aligned], prop::sample::select(vec![0.25, 1.0, 2.0, 4.0]))
        .prop_map(|(d, by)| d.map(|x| x * by))
        .prop_filter("coincident", |d| norm(*d) > 1e-9);
    ([shape(), shape()], offset, [rotation(), rotation()]).prop_map(|(shapes, d, q)| Case::new(shapes, d, q))
}

pub(crate) fn solve(case: &Case) -> Manifold {
    case.solve(&case.query(f64::INFINITY), &mut Workspace::default())
}

fn inner(case: &Case) -> f64 {
    case.shapes.iter().map(|s| s.hull.inradius()).sum()
}

pub(crate) fn outer(case: &Case) -> f64 {
    case.shapes.iter().map(|s| s.hull.circumradius()).sum()
}

/// The error budget of alpha. The contraction points are the origins, so `M` is `|d|`.
fn budget(case: &Case, alpha: f64) -> f64 {
    let noise = 16.0 * U * norm(case.positions[1]) / inner(case);
    alpha * 16.0 * U * outer(case) / inner(case) + noise
}

pub(crate) fn check(holds: bool, message: impl FnOnce() -> String) -> Result<(), TestCaseError> {
    if holds { Ok(()) } else { Err(TestCaseError::fail(message())) }
}

fn same(a: f64, b: f64, budget: f64) -> Result<(), TestCaseError> {
    check((a - b).abs() <= budget, || format!("{a:e} and {b:e} differ by more than {budget:e}"))
}

pub(crate) fn at(case: &Case, d: [f64; 3]) -> Case {
    Case { positions: [[0.0; 3], d], ..case.clone() }
}

/// 3000 scenes near degeneracy, each compared with the exact answer. No answer may be flagged.
/// Catches a degenerate case that a solver does not handle; the count of ties shows that there were
/// such cases.
#[test]
fn degenerate_scenes_are_exact() {
    let ties = std::cell::Cell::new(0);
    holds(3000, scene(), |case| {
        let mut cells = [SolverScore::default(), SolverScore::default()];
        judge(&case, &mut cells, &mut Workspace::default());
        ties.set(ties.get() + cells[0].counts.ties);
        let failed: Vec<_> = cells.iter().flat_map(|c| &c.failed).collect();
        let flagged = cells.iter().map(|c| c.gap_open + c.undecided).sum::<usize>();
        check(failed.is_empty() && flagged == 0, || format!("{failed:#?}, {flagged} flagged"))
    });
    assert!(ties.get() > 40, "{} ties", ties.get());
}

/// Scaling the centre offset scales alpha: `alpha(k d) = k alpha(d)`. Catches a threshold that is
/// not relative.
#[test]
fn alpha_is_homogeneous() {
    holds(400, (scene(), 1e-3..1e3f64), |(case, k)| {
        let far = at(&case, case.positions[1].map(|x| k * x));
        let (near, far_alpha) = (solve(&case).alpha, solve(&far).alpha);
        same(far_alpha, k * near, k * budget(&case, near) + budget(&far, far_alpha))
    });
}

/// Alpha is convex in the offset, `alpha(d1 + d2) <= alpha(d1) + alpha(d2)`, and Lipschitz,
/// `|alpha(d1) - alpha(d2)| <= |d1 - d2| / r`. Catches a local optimum.
#[test]
fn alpha_is_convex_and_continuous() {
    holds(400, (scene(), point()), |(case, d2)| {
        prop_assume!(norm(d2) > 1e-9);
        let d1 = case.positions[1];
        let (other, sum) = (at(&case, d2), at(&case, std::array::from_fn(|k| d1[k] + d2[k])));
        prop_assume!(norm(sum.positions[1]) > 1e-9);
        let [a, b, both] = [&case, &other, &sum].map(|c| (solve(c).alpha, c)).map(|(x, c)| (x, budget(c, x)));
        let rounding = a.1 + b.1 + both.1;
        check(both.0 <= a.0 + b.0 + rounding, || format!("not convex: {a:?} {b:?} {both:?}"))?;
        let reach = norm(std::array::from_fn(|k| d1[k] - d2[k])) / inner(&case);
        check((a.0 - b.0).abs() <= reach * (1.0 + 8.0 * U) + rounding, || {
            format!("jumps: {a:?} {b:?} {reach}")
        })
    });
}

/// Alpha does not change if A and B are exchanged, if the world is moved rigidly, or if the
/// vertices are reordered. Catches a frame that is mixed up, and an index that decides where the
/// geometry should.
#[test]
fn alpha_is_the_pairs_own() {
    holds(400, (scene(), rotation(), point(), any::<u64>()), |(case, q, t, seed)| {
        let alpha = solve(&case).alpha;
        let [a, b] = case.shapes.clone();
        let swapped = Case {
            shapes: [b.clone(), a.clone()],
            rotations: [case.rotations[1], case.rotations[0]],
            ..at(&case, case.positions[1].map(|x| -x))
        };
        same(solve(&swapped).alpha, alpha, 2.0 * budget(&case, alpha))?;

        // The motion rounds d and the rotations by some ulps; in alpha these are multiplied by R/r.
        let moved = Case {
            positions: case.positions.map(|p| {
                let p = rotate(q, p);
                std::array::from_fn(|k| p[k] + t[k])
            }),
            rotations: case.rotations.map(|r| product(q, r)),
            ..case.clone()
        };
        let lost = 4.0 * U * (norm(case.positions[1]) + 2.0 * norm(t)) / inner(&case);
        same(solve(&moved).alpha, alpha, 3.0 * budget(&case, alpha) + lost)?;

        let shuffled = |shape: &Shape| {
            let mut points = shape.points.clone();
            let mut random = crate::scene::Random::new(seed);
            (1..points.len()).rev().for_each(|i| points.swap(i, random.below(i + 1)));
            Shape::centred(points)
        };
        let reordered = Case { shapes: [shuffled(&a), shuffled(&b)], ..case.clone() };
        same(solve(&reordered).alpha, alpha, 2.0 * budget(&case, alpha))
    });
}

pub(crate) fn product([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

/// A hull with one more point has no larger alpha. A hull without one of its points, but with the
/// same contraction point, has no smaller alpha; the increase is at most `alpha` times the
/// deviation over `r'`, the inradius of the reduced pair. Catches a support search that misses
/// vertices.
#[test]
fn larger_hulls_meet_sooner() {
    let dropped = std::cell::Cell::new(0);
    holds(400, (scene(), point(), any::<prop::sample::Index>()), |(case, extra, index)| {
        let alpha = solve(&case).alpha;
        let with = |points| Case { shapes: [Shape::centred(points), case.shapes[1].clone()], ..case.clone() };
        let mut points = case.shapes[0].points.clone();
        points.push(extra.map(|x| 1.5 * x));
        let larger = solve(&with(points.clone())).alpha;
        check(larger <= alpha + 2.0 * budget(&case, alpha), || format!("{larger:e} above {alpha:e}"))?;

        points.pop();
        let gone = points.swap_remove(index.index(points.len()));
        let options =
            hullcast_contact::HullOptions { contraction_point: Some([0.0; 3]), ..Default::default() };
        let Ok(hull) = ConvexHull::with_options(&points, &options) else { return Ok(()) };
        prop_assume!(hull.inradius() > 1e-4);
        dropped.set(dropped.get() + 1);
        // The distance to the nearest remaining vertex is at least the deviation.
        let distance = |p: &[f64; 3]| norm(std::array::from_fn(|k| p[k] - gone[k]));
        let deviation = points.iter().map(distance).fold(f64::INFINITY, f64::min);
        let simplified = with(points);
        let found = solve(&simplified).alpha;
        let rounding = budget(&case, alpha) + budget(&simplified, found);
        let most = alpha * (1.0 + deviation / inner(&simplified));
        check(alpha <= found + rounding && found <= most + rounding, || {
            format!("{found:e} in {alpha:e} to {most:e}")
        })
    });
    assert!(dropped.get() > 100);
}

/// Relation (1) of Silcowitz et al. (SCA 2010) with its constants. Overlapping:
/// `r (1 - alpha) <= d_MTD <= d_GD <= R (1 - alpha)` and `d_GD <= (R/r) d_MTD`; separated:
/// `r (alpha - 1) <= s(n) <= distance <= R (alpha - 1)`. The minimum translation `d_MTD` comes from
/// a search of all facet normals of the difference, the distance from exact arithmetic. Catches a
/// separation that belongs to another direction than the optimal one.
#[test]
fn growth_distance_bounds_the_least_translation() {
    let counts = std::cell::Cell::new([0; 2]);
    holds(300, scene(), |case| {
        let m = solve(&case);
        let exact = case.exact();
        let (inner, outer) = (inner(&case), outer(&case));
        let slack = 1e-12 * (outer + norm(case.positions[1]));
        let in_order = |bounds: &[f64]| {
            check(bounds.windows(2).all(|w| w[0] <= w[1] + slack), || format!("{bounds:?} of {m:?}"))
        };
        let mut met = counts.get();
        met[usize::from(m.alpha > 1.0)] += 1;
        counts.set(met);
        if m.alpha > 1.0 {
            let distance = exact.distance_squared(exact.support(&exact.d)).value();
            return in_order(&[inner * (m.alpha - 1.0), m.separation, distance, outer * (m.alpha - 1.0)]);
        }
        let least = least_translation(&case, &exact);
        in_order(&[inner * (1.0 - m.alpha), least, -m.separation, outer * (1.0 - m.alpha)])?;
        in_order(&[-m.separation, outer / inner * least])
    });
    let [deep, apart] = counts.get();
    assert!(deep > 50 && apart > 50, "{deep} {apart}");
}

/// The minimum translation distance: the least overlap along any facet normal of the Minkowski
/// difference.
fn least_translation(case: &Case, exact: &Exact) -> f64 {
    let sides = [0, 1].map(|side| {
        let (hull, q) = (&case.shapes[side].hull, case.rotations[side]);
        let normals: Vec<_> = hull.faces().iter().map(|face| rotate(q, face.normal.to_array())).collect();
        let edge = |[i, j]: [u32; 2]| {
            rotate(q, (hull.vertices()[j as usize] - hull.vertices()[i as usize]).to_array())
        };
        let edges: Vec<_> = hull.edge_vertices().iter().map(|&e| edge(e)).collect();
        (normals, edges)
    });
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let [(normals_a, edges_a), (normals_b, edges_b)] = &sides;
    let crossed =
        edges_a.iter().flat_map(|&e| edges_b.iter().map(move |&f| (cross(e, f), norm(e) * norm(f))));
    let crossed = crossed.filter(|(n, scale)| norm(*n) > 1e-9 * scale).map(|(n, _)| n);
    let all = normals_a.iter().chain(normals_b).copied().chain(crossed);
    let depth = |n: [f64; 3]| {
        let unit = n.map(|x| x / norm(n));
        -exact.separation(unit).max(exact.separation(unit.map(|x| -x)))
    };
    all.map(depth).fold(f64::INFINITY, f64::min)
}

/// B is moved by a small vector. While the same faces touch along the same normal, the patch's area
/// changes by at most the length of its outline times that vector's length, and its depth by at
/// most twice that length. Catches a corner that comes and goes.
#[test]
fn patches_are_continuous() {
    let compared = std::cell::Cell::new(0);
    holds(1500, (scene(), [-1.0..1.0, -1.0..1.0, -1.0..1.0f64], 3i32..12), |(case, way, power)| {
        let by = 10f64.powi(-power);
        let d = case.positions[1];
        let moved = at(&case, std::array::from_fn(|k| d[k] + by * way[k]));
        let (before, after) = (solve(&case), solve(&moved));
        let faces = matches!(before.features, Some([Feature::Face(_), Feature::Face(_)]));
        let still = before.features == after.features && (before.normal - after.normal).length() <= 64.0 * U;
        if !faces || !still || before.flags.estimated || after.flags.estimated {
            return Ok(());
        }
        compared.set(compared.get() + 1);
        let (e1, e2) = before.normal.any_orthonormal_pair();
        let area = |m: &Manifold| {
            let at = |p: &hullcast_contact::ContactPoint| [e1.dot(p.witness_a), e2.dot(p.witness_a)];
            polygon::area(&polygon::convex_hull(&m.points.iter().map(at).collect::<Vec<_>>()))
        };
        let lowest = |m: &Manifold| m.points.iter().map(|p| p.distance).fold(f64::INFINITY, f64::min);
        let length = norm(way) * by;
        let rounding = 1e-12 * outer(&case) * outer(&case);
        let (was, is) = (area(&before), area(&after));
        same(was, is, 8.0 * outer(&case) * length + rounding)?;
        same(lowest(&before), lowest(&after), 2.0 * length + rounding)
    });
    assert!(compared.get() > 100, "{} patches", compared.get());
}

//! Tests of simplified hulls: the vertices left out are never farther away than the deviation.

use glam::DVec3;
use hullcast_contact::{
    Body, HullError, HullErrorKind, HullOptions, Pose, Query, Simplification, Workspace, contact_manifold,
    hull::{ConvexHull, triangulate},
};

use crate::clouds::{Points, Random, clouds, cube, prism, random_cloud, sphere};

fn simplified(points: &[[f64; 3]], wanted: Simplification) -> Result<ConvexHull, HullError> {
    ConvexHull::with_options(points, &HullOptions { simplification: Some(wanted), ..HullOptions::default() })
}

fn vertices(most: u32) -> Simplification {
    Simplification { max_vertices: Some(most), max_deviation: None }
}

fn within(deviation: f64) -> Simplification {
    Simplification { max_vertices: None, max_deviation: Some(deviation) }
}

/// The hulls of the example scenes: the links of robots, and a pile.
pub(crate) fn real() -> Vec<Points> {
    let mut hulls = Vec::new();
    for scene in ["panda", "anymal_c", "pile"] {
        let path = format!("{}/../../examples/scenes/{scene}.json", env!("CARGO_MANIFEST_DIR"));
        let scene: serde_json::Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        for hull in scene["hulls"].as_array().unwrap() {
            hulls.push(serde_json::from_value(hull["vertices"].clone()).unwrap());
        }
    }
    hulls
}

fn at(points: &[[f64; 3]], index: u32) -> DVec3 {
    DVec3::from_array(points[index as usize])
}

/// The point of a triangle that is nearest to the origin: the foot on its plane if that is inside,
/// otherwise the nearest point of its sides.
fn nearest_of_triangle([a, b, c]: [DVec3; 3]) -> DVec3 {
    let n = (b - a).cross(c - a);
    let foot = n * (n.dot(a) / n.length_squared());
    let inside = [(a, b), (b, c), (c, a)].iter().all(|&(u, v)| n.dot((u - foot).cross(v - foot)) >= 0.0);
    let on_side = |u: DVec3, v: DVec3| {
        let t = (-u.dot(v - u) / (v - u).length_squared()).clamp(0.0, 1.0);
        u + (v - u) * if t.is_nan() { 0.0 } else { t }
    };
    let mut candidates = vec![on_side(a, b), on_side(b, c), on_side(c, a)];
    if inside && foot.is_finite() {
        candidates.push(foot);
    }
    candidates.into_iter().min_by(|p, q| p.length_squared().total_cmp(&q.length_squared())).unwrap()
}

/// A lower and an upper bound of the distance between the inner hull and the farthest vertex that
/// was left out. The upper bound is the distance to the triangles of the inner hull; a direction
/// proves the lower bound. No step of the simplification is used.
fn true_deviation(points: &[[f64; 3]], whole: &ConvexHull, inner: &ConvexHull) -> (f64, f64) {
    let kept = inner.registered_indices();
    let corners: Points = kept.iter().map(|&i| points[i as usize]).collect();
    let triangles = triangulate(&corners).unwrap().triangles;
    let (mut lower, mut upper) = (0.0_f64, 0.0_f64);
    for &v in whole.registered_indices().iter().filter(|v| !kept.contains(v)) {
        let from = |i: u32| at(&corners, i) - at(points, v);
        let feet = triangles.iter().map(|t| nearest_of_triangle(t.map(from)));
        let foot = feet.min_by(|p, q| p.length_squared().total_cmp(&q.length_squared())).unwrap();
        upper = upper.max(foot.length());
        let direction = foot.normalize_or_zero();
        let reach = (0..corners.len() as u32).map(|i| direction.dot(from(i))).fold(f64::INFINITY, f64::min);
        lower = lower.max(reach);
    }
    (lower, upper)
}

/// Simplifies more than a thousand hulls, of robots and at random, in four ways each. Catches a
/// deviation below the true distance (because of a distance to the wrong hull, one that was not
/// computed again, or rounding), a deviation far above it, a vertex that is not of the hull, moved or
/// numbered wrongly, a different contraction point, and limits that are exceeded.
#[test]
fn deviations_hold_on_a_thousand_hulls() {
    let real = real();
    assert!(real.len() >= 60);
    let random = (0..800).map(random_cloud);
    let all = real.into_iter().chain(clouds().into_iter().map(|cloud| cloud.points)).chain(random);
    let (mut hulls, mut simplified_hulls, mut left_out, mut refused, mut tight) = (0, 0, 0, 0, 0);
    for points in all {
        let Ok(whole) = ConvexHull::new(&points) else { continue };
        if whole.vertex_count() > 600 {
            continue;
        }
        hulls += 1;
        let size = whole.circumradius();
        let half = (whole.vertex_count() as u32 / 2).max(4);
        let both = Simplification { max_vertices: Some(half), max_deviation: Some(0.3 * size) };
        for wanted in [vertices(half), vertices(12), within(0.02 * size), both] {
            let inner = match simplified(&points, wanted) {
                Ok(inner) => inner,
                Err(error) => {
                    // With few vertices the centre may be outside, or the deviation too large. A
                    // limit on the deviation only can always be met.
                    assert!(wanted.max_vertices.is_some(), "{error}");
                    refused += 1;
                    continue;
                }
            };
            let kept = inner.registered_indices();
            assert!(kept.iter().all(|i| whole.registered_indices().binary_search(i).is_ok()));
            assert!(wanted.max_vertices.is_none_or(|most| kept.len() <= most as usize));
            assert!(wanted.max_deviation.is_none_or(|most| inner.deviation() <= most));
            assert_eq!(inner.contraction_point(), whole.contraction_point());
            assert_eq!(inner.registered_count(), points.len());
            assert!(inner.geometric_error() >= inner.deviation());
            if kept.len() == whole.vertex_count() {
                assert_eq!(inner.deviation(), 0.0);
                continue;
            }
            let (lower, upper) = true_deviation(&points, &whole, &inner);
            let deviation = inner.deviation();
            assert!(lower <= deviation, "{lower:e} above {deviation:e}");
            // If triangles are slivers, the search may end before it reaches the nearest point.
            assert!(deviation <= upper + 1e-6 * size, "{deviation:e} far above {upper:e}");
            tight += usize::from(deviation - lower <= 1e-12 * size);
            simplified_hulls += 1;
            left_out += whole.vertex_count() - kept.len();
        }
    }
    println!(
        "{hulls} hulls, {simplified_hulls} simplified, {left_out} vertices left out, {refused} refused; \
         no deviation below the distance, {tight} tight"
    );
    assert!(hulls >= 1000 && simplified_hulls >= 2000 && left_out >= 50_000);
    assert!(refused < simplified_hulls / 4 && tight > simplified_hulls * 9 / 10);
}

/// Catches a change of alpha that the deviations do not account for. The simplified hulls are inside
/// the whole ones and have the same contraction points, so alpha never falls, and it rises by no
/// more than the deviations allow: `alpha' <= alpha (1 + eps / r')` (docs/hulls.md).
#[test]
fn alpha_rises_by_no_more_than_the_deviations_allow() {
    let mut random = Random::new(17);
    let real = real();
    let query = Query { margin: f64::INFINITY, ..Query::default() };
    let (mut pairs, mut changed) = (0, 0);
    while pairs < 1500 {
        let shapes = [0, 1].map(|_| match random.below(2) {
            0 => real[random.below(real.len())].clone(),
            _ => sphere(10 + random.below(200), &mut random),
        });
        let whole = shapes.each_ref().map(|points| ConvexHull::new(points).unwrap());
        let part = 0.11 + 0.1 * random.signed();
        let inner = [0, 1].map(|i| simplified(&shapes[i], within(part * whole[i].inradius())).unwrap());
        let size = whole[0].circumradius() + whole[1].circumradius();
        let position = [0; 3].map(|_| 0.7 * size * random.signed());
        let mut rotation = [0; 4].map(|_| random.signed());
        let norm = rotation.iter().map(|c| c * c).sum::<f64>().sqrt();
        rotation.iter_mut().for_each(|c| *c /= norm);
        let Ok(pose) = Pose::new(position, rotation) else { continue };
        let origin = Pose::new([0.0; 3], [0.0, 0.0, 0.0, 1.0]).unwrap();
        let bracket = |hulls: &[ConvexHull; 2]| {
            let bodies = (Body::new(&hulls[0], origin), Body::new(&hulls[1], pose));
            let mut workspace = Workspace::default();
            let manifold = contact_manifold(&bodies.0, &bodies.1, &query, None, &mut workspace);
            (manifold.alpha_lower, manifold.alpha_upper)
        };
        let ((lower, upper), (lower_inner, upper_inner)) = (bracket(&whole), bracket(&inner));
        let allowed =
            (inner[0].deviation() + inner[1].deviation()) / (inner[0].inradius() + inner[1].inradius());
        assert!(upper_inner >= lower, "alpha fell from {lower} to {upper_inner}");
        assert!(lower_inner <= upper * (1.0 + allowed), "{lower_inner} above {upper} by more than {allowed}");
        changed += usize::from(lower_inner > upper);
        pairs += 1;
    }
    println!("{pairs} pairs, alpha of {changed} proven to have risen, none by more than its bound");
    assert!(changed > 500, "{changed}");
}

/// Catches a hull that is refused for its number of vertices although few would be kept, and a
/// simplified hull that exceeds the limit. The hull has 300 vertices; the limits are below, at and
/// above the number that is kept.
#[test]
fn the_vertex_limit_is_for_the_simplified_hull() {
    let points = sphere(300, &mut Random::new(11));
    let limited = |max_vertices, wanted| {
        let options = HullOptions { max_vertices, simplification: Some(wanted), ..HullOptions::default() };
        ConvexHull::with_options(&points, &options).map_err(|error| error.kind)
    };
    let too_many = HullErrorKind::TooManyVertices;
    assert_eq!(limited(50, vertices(50)).unwrap().vertex_count(), 50);
    assert_eq!(limited(50, vertices(50)), simplified(&points, vertices(50)).map_err(|error| error.kind));
    assert_eq!(limited(49, vertices(50)).unwrap_err(), too_many);
    assert_eq!(limited(299, vertices(400)).unwrap_err(), too_many);
    assert_eq!(limited(300, vertices(400)).unwrap().vertex_count(), 300);
    let kept = limited(300, within(0.05)).unwrap().vertex_count();
    assert!((20..290).contains(&kept), "{kept}");
    assert_eq!(limited(kept, within(0.05)).unwrap().vertex_count(), kept);
    assert_eq!(limited(kept - 1, within(0.05)).unwrap_err(), too_many);
    assert_eq!(limited(299, within(0.0)).unwrap_err(), too_many);
    let both = Simplification { max_vertices: Some(40), max_deviation: Some(0.5) };
    assert!(limited(40, both).unwrap().deviation() <= 0.5);
}

/// Catches options that are accepted although no hull satisfies them, refusals of the wrong kind, and
/// limits that change a hull although they do not apply.
#[test]
fn what_cannot_be_is_refused() {
    let kind = |result: Result<ConvexHull, HullError>| result.unwrap_err().kind;
    for wanted in [vertices(3), vertices(0), within(-1e-300), within(f64::NAN)] {
        assert_eq!(kind(simplified(&cube(), wanted)), HullErrorKind::SimplificationOutOfRange);
    }
    let both = Simplification { max_vertices: Some(7), max_deviation: Some(0.01) };
    assert_eq!(kind(simplified(&cube(), both)), HullErrorKind::SimplificationNotPossible);
    // The contraction point is in a corner that is cut off.
    let options = HullOptions {
        contraction_point: Some([0.98, 0.98, -0.98]),
        simplification: Some(vertices(4)),
        ..HullOptions::default()
    };
    let mut skew = cube();
    skew[0] = [-9.0, -9.0, -9.0];
    let refused = ConvexHull::with_options(&skew, &options);
    assert!(refused.is_err(), "{:?}", refused.map(|hull| hull.registered_indices().to_vec()));
    assert_eq!(kind(simplified(&cube()[..3], vertices(4))), HullErrorKind::TooFewPoints);
    // The centre of mass of a cube is on the surface of the hull of four of its corners. The error must name
    // the option at fault, because the caller gave no contraction point.
    let detail = simplified(&cube(), vertices(4)).unwrap_err().detail;
    assert!(detail.starts_with("with 4 vertices, as max_vertices asks, ("), "{detail}");
    assert!(detail.ends_with(": allow more vertices"), "{detail}");
    // The vertices that satisfy the deviation would leave the plate flat, so more are taken.
    let plate = prism(32, 1e-3);
    let flat = simplified(&plate, within(0.05)).unwrap();
    assert!(flat.vertex_count() < 64 && flat.deviation() <= 0.05 && flat.inradius() > 0.0);
    // No limit applies, so the hull is left as it is.
    for wanted in [vertices(8), vertices(u32::MAX), within(0.0), Simplification::default()] {
        let hull = simplified(&cube(), wanted).unwrap();
        assert_eq!((hull.vertex_count(), hull.deviation()), (8, 0.0));
    }
    assert_eq!(simplified(&cube(), within(f64::INFINITY)).unwrap().registered_count(), 8);
}

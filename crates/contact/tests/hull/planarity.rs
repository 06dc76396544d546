//! Hulls whose faces are merged with a given planarity.

use glam::{DQuat, DVec3};
use hullcast_contact::{
    Body, Feature, HullErrorKind, HullOptions, Pose, Query, Workspace, certificate, contact_manifold,
    hull::{ConvexHull, triangulate},
};

use crate::check::{CheckCounts, check};
use crate::clouds::{Points, Random, clouds, cube, globe, prism, random_cloud, rotated, scaled, sphere};
use crate::simplify::real;

/// The planarities of the sweeps, from 0 to the largest allowed.
const PLANARITIES: [f64; 5] = [0.0, 1e-9, 1e-4, 1e-3, 0.01];

fn with(points: &[[f64; 3]], planarity: f64) -> ConvexHull {
    let options = HullOptions { planarity: Some(planarity), ..HullOptions::default() };
    ConvexHull::with_options(points, &options).unwrap()
}

/// Every definition holds at every planarity: for the clouds of the other tests, random clouds, the
/// links of robots, and spheres of ten thousand vertices. Catches a face whose vertices are farther
/// from its plane than allowed, an outline that is not convex or leaves out vertices of its face, and
/// a hull whose vertices or sizes depend on the planarity.
#[test]
fn every_planarity_gives_a_hull() {
    let mut random = Random::new(30);
    let mut all: Vec<(String, Points)> =
        clouds().into_iter().map(|cloud| (cloud.name, cloud.points)).collect();
    all.extend((0..150).map(|seed| (format!("random {seed}"), random_cloud(seed))));
    all.extend(real().into_iter().map(|points| ("real".into(), points)));
    let mut counts = PLANARITIES.map(|_| CheckCounts::default());
    for (name, points) in all {
        let Ok(plain) = ConvexHull::new(&points) else { continue };
        for (planarity, counts) in PLANARITIES.iter().zip(&mut counts) {
            println!("{name} {planarity:e}");
            let hull = with(&points, *planarity);
            check(&points, &hull, counts);
            assert_eq!(hull.planarity(), *planarity);
            assert_eq!((hull.vertices(), hull.scale()), (plain.vertices(), plain.scale()));
            assert_eq!((hull.inradius(), hull.circumradius()), (plain.inradius(), plain.circumradius()));
            assert_eq!((hull.volume(), hull.inertia()), (plain.volume(), plain.inertia()));
        }
    }
    for points in [sphere(10_000, &mut random), globe(70, 140)] {
        check(&points, &with(&points, PLANARITIES[4]), &mut counts[4]);
    }
    println!("{counts:#?}");
    assert!(counts.iter().all(|counts| counts.hulls > 380));
    assert!(counts.windows(2).all(|two| two[0].merged_faces <= two[1].merged_faces));
    assert!(counts[4].merged_faces > 20_000 && counts[4].inexact_faces > 2_000);
}

/// Catches a planarity outside 0 to 0.01 that is accepted, or that is refused without naming the
/// value and the range, and a planarity at a limit of the range that is refused.
#[test]
fn a_planarity_out_of_range_is_named() {
    let points = cube();
    for wrong in [-1e-300, 0.010_000_000_000_000_002, 1.5, 1e300, f64::INFINITY, f64::NEG_INFINITY, f64::NAN]
    {
        let options = HullOptions { planarity: Some(wrong), ..HullOptions::default() };
        let error = ConvexHull::with_options(&points, &options).unwrap_err();
        assert_eq!(error.kind, HullErrorKind::PlanarityOutOfRange);
        assert_eq!((error.kind.field(), error.index), ("planarity", None));
        assert!(
            error.detail.contains(&format!("{wrong:?}"))
                && error.detail.len() < 100
                && error.detail.contains("0 to 0.01")
        );
    }
    for allowed in [0.0, -0.0, f64::MIN_POSITIVE, 0.01] {
        assert_eq!(with(&points, allowed).face_count(), 6, "{allowed:e}");
    }
}

/// Boxes, prisms, barrels and frusta that are turned and rounded to five decimals, as in mesh files;
/// spheres; and the links of robots.
fn shapes(random: &mut Random) -> Vec<Points> {
    let barrel = || [prism(24, 0.5), scaled(&prism(24, 0.2), [1.2, 1.2, 1.0])].concat();
    let frustum: Points = prism(12, 0.4)
        .into_iter()
        .map(|[x, y, z]| if z > 0.0 { [0.6 * x, 0.6 * y, z] } else { [x, y, z] })
        .collect();
    let written = |points: Points, random: &mut Random| -> Points {
        rotated(&points, random).into_iter().map(|p| p.map(|x| (x * 1e5).round() / 1e5)).collect()
    };
    let mut shapes = Vec::new();
    for points in [cube(), scaled(&cube(), [0.7, 0.4, 0.1]), prism(6, 0.5), prism(64, 0.5), barrel(), frustum]
    {
        shapes.push(written(points, random));
    }
    shapes.extend([sphere(60, random), sphere(1000, random)]);
    shapes.extend(real().into_iter().filter(|points| points.len() > 20).take(16));
    shapes
}

fn quaternion(random: &mut Random) -> [f64; 4] {
    let [x, y, z, w]: [f64; 4] = std::array::from_fn(|_| random.signed());
    let length = (x * x + y * y + z * z + w * w).sqrt();
    [x, y, z, w].map(|q| q / length)
}

/// How far a point is above the planes of a hull's triangles, before faces are merged. `own` is in
/// the hull frame and the caller's units.
fn above_triangles(points: &[[f64; 3]], triangles: &[[u32; 3]], own: DVec3) -> f64 {
    let above = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| DVec3::from_array(points[v as usize]));
        (b - a).cross(c - a).normalize_or_zero().dot(own - a)
    };
    triangles.iter().map(above).fold(f64::NEG_INFINITY, f64::max)
}

/// Pairs at random poses, most of them in contact. Catches an alpha that depends on the planarity, an
/// answer that violates its certificate, and a witness that is farther off its hull than the
/// planarity of its face.
#[test]
fn alpha_is_the_same_and_witnesses_are_off_by_the_planarity_alone() {
    let mut random = Random::new(31);
    let shapes = shapes(&mut random);
    let surfaces: Vec<_> = shapes.iter().map(|points| triangulate(points).unwrap().triangles).collect();
    let hulls: Vec<Vec<ConvexHull>> =
        shapes.iter().map(|points| PLANARITIES.map(|planarity| with(points, planarity)).into()).collect();
    let mut workspace = Workspace::default();
    let (mut contacts, mut off, mut other_bits) = (0, 0, 0);
    for _ in 0..1500 {
        let chosen = [(); 2].map(|()| random.below(shapes.len()));
        let sizes = chosen.map(|i| hulls[i][0].circumradius());
        let apart = 0.6 * (sizes[0] + sizes[1]);
        let position: [f64; 3] = std::array::from_fn(|_| apart * random.signed());
        let places = [[0.0; 3], position].map(|at| (at, quaternion(&mut random)));
        let poses = places.map(|(at, turn)| Pose::new(at, turn).unwrap());
        let mut first = None;
        for (planarity, &share) in PLANARITIES.iter().enumerate() {
            let [a, b] = [0, 1].map(|side| Body::new(&hulls[chosen[side]][planarity], poses[side]));
            let query = Query { margin: 0.05 * apart, ..Query::default() };
            let answer = contact_manifold(&a, &b, &query, None, &mut workspace);
            certificate::check(&a, &b, &query, answer)
                .unwrap_or_else(|violation| panic!("{share:e}: {violation}"));
            let (outcome, lower, upper) =
                *first.get_or_insert((answer.outcome, answer.alpha_lower, answer.alpha_upper));
            assert_eq!(answer.outcome, outcome, "{share:e}");
            assert!(answer.alpha_lower <= upper && lower <= answer.alpha_upper, "{share:e}: another alpha");
            other_bits += usize::from((answer.alpha_lower, answer.alpha_upper) != (lower, upper));
            contacts += usize::from(!answer.points.is_empty());
            let Some(features) = answer.features.filter(|_| !answer.flags.estimated) else { continue };
            for point in &answer.points {
                let witnesses = [point.witness_a, point.witness_a + point.distance * answer.normal];
                for (side, body) in [a, b].iter().enumerate() {
                    let i = chosen[side];
                    let (at, turn) = places[side];
                    let turn = DQuat::from_array(turn).normalize();
                    let own = turn.conjugate() * (witnesses[side] - DVec3::from_array(at));
                    let above = above_triangles(&shapes[i], &surfaces[i], own);
                    let planarity = match features[side] {
                        Feature::Face(f) => body.hull.faces()[f as usize].planarity * body.hull.scale(),
                        _ => 0.0,
                    };
                    // The witness is lifted along the contact normal, which is within the feature
                    // angle of the face normal. The factor 1.01 covers that angle.
                    let allowed = 1.01 * planarity + 1e-13 * apart;
                    assert!(above <= allowed, "{share:e}: a witness is {above:e} off, {allowed:e} allowed");
                    off += usize::from(above > 1e-9 * apart);
                }
            }
        }
    }
    println!("{contacts} contacts, {off} witnesses off their hull, {other_bits} other bits of alpha");
    assert!(contacts > 3000 && off > 100, "{contacts} {off}");
}

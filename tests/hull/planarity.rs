//! Hulls whose faces are merged to a planarity that was asked for.

use hullcast::contact::{HullErrorKind, HullOptions, hull::ConvexHull};

use crate::check::{Met, check};
use crate::clouds::{Random, clouds, globe, random_cloud, sphere};
use crate::simplify::real;

/// Those that the sweeps take, from none to the largest.
const PLANARITIES: [f64; 5] = [0.0, 1e-9, 1e-4, 1e-3, 0.01];

fn with(points: &[[f64; 3]], planarity: f64) -> ConvexHull {
    let options = HullOptions { planarity: Some(planarity), ..HullOptions::default() };
    ConvexHull::with_options(points, &options).unwrap()
}

/// Every definition holds at every planarity: on the clouds of the other tests, on spheres of
/// ten thousand vertices, at random, and on the links of robots. Catches a face whose vertices
/// are farther from its plane than was asked for, an outline that is not convex or leaves out
/// vertices of its face, and a hull whose vertices or sizes depend on the planarity.
#[test]
fn every_planarity_gives_a_hull() {
    let mut random = Random::new(30);
    let mut all: Vec<(String, Vec<[f64; 3]>)> =
        clouds().into_iter().map(|cloud| (cloud.name, cloud.points)).collect();
    all.extend((0..150).map(|seed| (format!("random {seed}"), random_cloud(seed))));
    all.extend(real().into_iter().map(|points| ("real".into(), points)));
    let mut met = PLANARITIES.map(|_| Met::default());
    for (name, points) in all {
        let Ok(plain) = ConvexHull::new(&points) else { continue };
        for (planarity, met) in PLANARITIES.iter().zip(&mut met) {
            println!("{name} {planarity:e}");
            let hull = with(&points, *planarity);
            check(&points, &hull, met);
            assert_eq!(hull.planarity(), *planarity);
            assert_eq!((hull.vertices(), hull.scale()), (plain.vertices(), plain.scale()));
            assert_eq!((hull.inradius(), hull.circumradius()), (plain.inradius(), plain.circumradius()));
            assert_eq!((hull.volume(), hull.inertia()), (plain.volume(), plain.inertia()));
        }
    }
    for points in [sphere(10_000, &mut random), globe(70, 140)] {
        check(&points, &with(&points, PLANARITIES[4]), &mut met[4]);
    }
    println!("{met:#?}");
    assert!(met.iter().all(|met| met.hulls > 380));
    assert!(met.windows(2).all(|two| two[0].merged_faces <= two[1].merged_faces));
    assert!(met[4].merged_faces > 20_000 && met[4].inexact_faces > 2_000);
}

/// Catches a planarity that is not a share from 0 to 0.01 and is taken, or refused without its
/// value and the range, and limits that are refused.
#[test]
fn a_planarity_out_of_range_is_named() {
    let points = crate::clouds::cube();
    for wrong in [-1e-300, 0.010_000_000_000_000_002, 1.0, f64::INFINITY, f64::NEG_INFINITY, f64::NAN] {
        let options = HullOptions { planarity: Some(wrong), ..HullOptions::default() };
        let error = ConvexHull::with_options(&points, &options).unwrap_err();
        assert_eq!(error.kind, HullErrorKind::PlanarityOutOfRange);
        assert_eq!((error.kind.field(), error.index), ("planarity", None));
        assert!(error.detail.contains(&format!("{wrong}")) && error.detail.contains("0 to 0.01"));
    }
    for allowed in [0.0, -0.0, f64::MIN_POSITIVE, 0.01] {
        assert_eq!(with(&points, allowed).face_count(), 6, "{allowed:e}");
    }
}

//! Builds the hulls of many clouds and checks them against the definitions only.

mod check;
mod clouds;
mod faces;
mod planarity;
mod recorded;
mod simplify;
mod sizes;
mod stopping;

use std::collections::BTreeSet;

use check::{CheckCounts, check};
use clouds::{Points, Random, clouds, cube, moved, random_cloud, scaled, sphere};
use glam::DVec3;
use hullcast_contact::hull::{ConvexHull, HullError, HullErrorKind, HullOptions};

fn hull(points: &[[f64; 3]]) -> ConvexHull {
    ConvexHull::new(points).unwrap()
}

fn at(points: &[[f64; 3]], contraction_point: [f64; 3]) -> Result<ConvexHull, HullError> {
    let options = HullOptions { contraction_point: Some(contraction_point), ..HullOptions::default() };
    ConvexHull::with_options(points, &options)
}

/// Every definition holds for the hull of every cloud. Catches a fault in any step of the build: a
/// lost vertex, a hole, a wrong neighbour, a face that is off its plane.
#[test]
fn every_cloud_gives_a_hull() {
    let mut counts = CheckCounts::default();
    for cloud in clouds() {
        println!("{}", cloud.name);
        let hull = ConvexHull::new(&cloud.points).unwrap();
        check(&cloud.points, &hull, &mut counts);
    }
    println!("{counts:?}");
    assert!(counts.hulls >= 170 && counts.triangles > 10_000);
    assert!(counts.coplanar_sides > 1_000, "few exactly coplanar triangles");
    assert!(counts.dropped_points > 5_000, "few interior points");
    assert!(counts.merged_faces > 4_000 && counts.inexact_faces > 300, "few merged faces");
    assert!(counts.vertices_without_edges > 300, "few vertices inside merged faces");
}

/// Every definition holds for the hulls of random shapes, and a shape without a hull is refused with
/// a reason other than an internal error.
#[test]
fn random_clouds_give_hulls_or_reasons() {
    let (mut counts, mut refused) = (CheckCounts::default(), 0);
    for seed in 0..300 {
        let points = random_cloud(seed);
        match ConvexHull::new(&points) {
            Ok(hull) => check(&points, &hull, &mut counts),
            Err(error) => {
                assert!(!error.detail.contains("internal"), "{seed}: {error}");
                refused += 1;
            }
        }
    }
    println!("{counts:?}, {refused} refused");
    assert!(counts.hulls > 280 && refused > 0 && counts.ordered_edges > 15_000);
    assert!(counts.coplanar_sides > 2_500 && counts.inexact_faces > 300);
}

/// Every definition holds at the size of the largest meshes. A quadratic step would take hours here.
#[test]
fn ten_thousand_points_give_a_hull() {
    let mut random = Random::new(3);
    for points in [sphere(10_000, &mut random), clouds::globe(50, 200), clouds::ball(10_000, &mut random)] {
        check(&points, &hull(&points), &mut CheckCounts::default());
    }
}

/// The counts, sizes and numbering of a cube's hull are those computed by hand. Catches a wrong
/// orientation, scale or merge.
#[test]
fn a_cube_is_known_by_hand() {
    let hull = hull(&cube());
    assert_eq!((hull.vertex_count(), hull.face_count(), hull.edge_count()), (8, 6, 12));
    assert_eq!((hull.volume(), hull.scale()), (8.0, 2.0));
    assert!((1.0 - 2e-15..1.0).contains(&hull.inradius()));
    assert!((3_f64.sqrt()..3_f64.sqrt() + 3e-15).contains(&hull.circumradius()));
    assert!(hull.geometric_error() < 4e-15);
    for face in 0..6 {
        assert_eq!((hull.outline(face).len(), hull.face_neighbours(face).len()), (4, 4));
        assert_eq!(hull.faces()[face].area, 1.0);
        let normal = hull.face_normal(face);
        let corners: Vec<_> = hull.outline(face).iter().map(|&v| hull.vertices()[v as usize]).collect();
        assert!(corners.iter().all(|c| c.dot(normal) == 0.5));
        assert!((corners[1] - corners[0]).cross(corners[2] - corners[1]).dot(normal) > 0.0);
        assert!(hull.face_outline(face).eq(hull.outline(face).iter().copied()));
    }
    for (ends, faces) in hull.edge_vertices().iter().zip(hull.edge_faces()) {
        let left = hull.outline(faces[0] as usize);
        let place = left.iter().position(|v| *v == ends[0]).unwrap();
        assert_eq!(left[(place + 1) % 4], ends[1]);
    }
}

/// The order in which the points are given changes their numbers and nothing else.
#[test]
fn order_changes_numbers_alone() {
    let mut random = Random::new(7);
    for cloud in clouds() {
        let mut order: Vec<usize> = (0..cloud.points.len()).collect();
        random.shuffle(&mut order);
        let shuffled: Points = order.iter().map(|&i| cloud.points[i]).collect();
        let (one, other) = (hull(&cloud.points), hull(&shuffled));
        let bits = |hull: &ConvexHull, points: &[[f64; 3]]| -> BTreeSet<[u64; 3]> {
            hull.registered_indices().iter().map(|&i| points[i as usize].map(f64::to_bits)).collect()
        };
        assert_eq!(bits(&one, &cloud.points), bits(&other, &shuffled), "{}", cloud.name);
        assert_eq!((one.volume(), one.inertia()), (other.volume(), other.inertia()));
        assert_eq!(one.contraction_point(), other.contraction_point());
        assert_eq!(one.unit_inradius(), other.unit_inradius());
        assert_eq!(one.faces(), other.faces(), "{}", cloud.name);
    }
}

/// The first of several equal points is the vertex, -0.0 equals 0.0, and points inside the hull,
/// inside a face or on an edge are not vertices.
#[test]
fn duplicates_and_points_between_are_dropped() {
    let mut points = vec![[0.0; 3], [0.5, 0.5, 1.0], [1.0, 0.0, 0.0]];
    points.extend(cube());
    points.extend(cube());
    points.extend([[-1.0, -1.0, -0.0], [1.0, 1.0, 1.0]]);
    let cube_hull = hull(&points);
    assert_eq!(cube_hull.registered_indices(), [3, 4, 5, 6, 7, 8, 9, 10]);
    assert_eq!(cube_hull.registered_count(), points.len());
    let signed = [[-0.0, 0.0, -0.0], [1.0, -0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -0.0, 1.0], [0.0, 0.0, 0.0]];
    assert_eq!(hull(&signed).registered_indices(), [0, 1, 2, 3]);
}

/// The mass properties of boxes and of a tetrahedron are those of the closed forms. Catches a wrong
/// axis, sign or unit in the integrals.
#[test]
fn masses_are_known_by_hand() {
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-13 * b.abs();
    for (size, offset) in [(1.0, [0.0; 3]), (1.0, [7.0, -5.0, 3.0]), (1e-40, [0.0; 3]), (1e49, [0.0; 3])] {
        let half = [1.0, 0.5, 0.25].map(|h| h * size);
        let solid = hull(&moved(&scaled(&cube(), half), offset));
        assert!(near(solid.volume(), 8.0 * half[0] * half[1] * half[2]));
        assert!((solid.center_of_mass() - DVec3::from_array(offset)).length() <= 1e-15 * (size + 9.0));
        let square = half.map(|h| h * h);
        for axis in 0..3 {
            let expected = solid.volume() / 3.0 * (square[(axis + 1) % 3] + square[(axis + 2) % 3]);
            assert!(near(solid.inertia().col(axis)[axis], expected));
            assert!(solid.inertia().col(axis)[(axis + 1) % 3].abs() < 1e-13 * expected);
        }
    }
    let corner = hull(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    assert!(near(corner.volume(), 1.0 / 6.0));
    assert!((corner.center_of_mass() - DVec3::splat(0.25)).length() < 1e-15);
    // For the tetrahedron in the corner at the origin, the integrals of x^2 and x y about the origin
    // are 1/60 and 1/120.
    assert!(near(corner.inertia().x_axis.x, 2.0 * (1.0 / 60.0 - 1.0 / 96.0)));
    assert!(near(corner.inertia().x_axis.y, -(1.0 / 120.0 - 1.0 / 96.0)));
}

/// Any point inside can be the contraction point, down to 3e-11 from the surface of this cube. A
/// point that is nearer, on the surface or outside is refused.
#[test]
fn contraction_points_are_strictly_inside() {
    for depth in [0.5, 1e-3, 1e-6, 1e-9, 3e-11] {
        let z = 1.0 - depth;
        let near = at(&cube(), [0.25, -0.5, z]).unwrap();
        assert_eq!(near.contraction_point(), DVec3::new(0.25, -0.5, z));
        // Vertices in hull units are rounded, and the inradius has to allow for that.
        let lost = (1.0 - z) - near.inradius();
        assert!((0.0..8e-16).contains(&lost), "{depth:e}: {lost:e}");
        assert_eq!(near.face_count(), 6);
        check(&cube(), &near, &mut CheckCounts::default());
    }
    let bad = [
        [0.0, 0.0, 1.0],
        [0.0, 0.0, 1.0 - 1e-11],
        [1.0, 1.0, 1.0],
        [1.0, 1.0, 0.0],
        [0.0, 0.0, 1.0 + f64::EPSILON],
        [-3.0, 0.0, 0.0],
        [1e300, 0.0, 0.0],
        [f64::NAN, 0.0, 0.0],
        [0.0, f64::NEG_INFINITY, 0.0],
    ];
    for point in bad {
        let error = at(&cube(), point).unwrap_err();
        assert_eq!(error.kind, HullErrorKind::ContractionPointNotInside, "{point:?}");
        assert_eq!((error.kind.field(), error.index), ("contraction_point", None));
        let first = format!("({}, ", plain(point[0]));
        assert!(error.detail.starts_with(&first), "{error}");
    }
    assert!(at(&cube(), [2.0; 3]).unwrap_err().detail.starts_with("(2, 2, 2) is not"));
    assert!(at(&cube(), [-0.5, 1.5e-9, 4e40]).unwrap_err().detail.starts_with("(-0.5, 1.5e-9, 4e40)"));
}

/// A number as messages show it.
fn plain(value: f64) -> String {
    let text = format!("{value:?}");
    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
}

/// Each kind of refusal is returned for its clouds, and names the value at fault.
#[test]
fn bad_clouds_are_named() {
    let error = |points: &[[f64; 3]]| ConvexHull::new(points).unwrap_err();
    let is = |points: &[[f64; 3]], kind, named: &str| {
        let error = error(points);
        assert_eq!((error.kind, error.kind.field()), (kind, "vertices"));
        assert!(error.to_string().contains(kind.reason()) && error.detail.contains(named), "{error}");
        error.index
    };
    use HullErrorKind::{Collinear, Coplanar, NotFinite, NotRepresentable, SizeOutOfRange, TooFewPoints};
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut points = cube();
        points[5][1] = value;
        assert_eq!(is(&points, NotFinite, &format!("point 5: y is {value}")), Some(5));
    }
    assert_eq!(is(&[], TooFewPoints, "0 distinct"), None);
    is(&[[1.0; 3]; 9], TooFewPoints, "1 distinct points of 9");
    is(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.0; 3]], TooFewPoints, "3 distinct");
    let line = |f: fn(f64) -> [f64; 3]| (0..20).map(|i| f(f64::from(i))).collect::<Points>();
    is(&line(|t| [t, 2.0 * t, -t]), Collinear, "20 distinct");
    is(&line(|t| [t, t * t, 1.0 - t]), Coplanar, "20 distinct");
    is(&line(|t| [0.1, t.sin(), t.cos()]), Coplanar, "one plane");
    is(&scaled(&cube(), [0.49e-50; 3]), SizeOutOfRange, "9.8e-51");
    is(&scaled(&cube(), [0.51e50; 3]), SizeOutOfRange, "1.02e50");
    is(&scaled(&cube(), [1e308; 3]), SizeOutOfRange, "inf");
    let no_double_between: Points =
        cube().iter().map(|p| [p[0], p[1], 1.0 + f64::EPSILON * p[2].max(0.0)]).collect();
    is(&no_double_between, NotRepresentable, "too thin");
    // Points that are one rounding off a plane span a solid, but doubles cannot represent a
    // contraction point inside it.
    is(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.3, 0.3, 1e-300]], NotRepresentable, "too thin");
    let smallest = hull(&scaled(&cube(), [0.5e-50; 3]));
    let largest = hull(&scaled(&cube(), [0.5e50; 3]));
    assert!(smallest.volume() > 0.9e-150 && largest.volume() < 1.1e150);
}

/// The limit counts extreme vertices, not points.
#[test]
fn the_vertex_limit_counts_extreme_vertices() {
    let mut points = sphere(100, &mut Random::new(8));
    points.extend(scaled(&sphere(500, &mut Random::new(9)), [0.5; 3]));
    let limited = |max_vertices| {
        ConvexHull::with_options(&points, &HullOptions { max_vertices, ..HullOptions::default() })
    };
    assert_eq!(limited(100).unwrap().vertex_count(), 100);
    let error = limited(99).unwrap_err();
    assert_eq!(error.kind, HullErrorKind::TooManyVertices);
    assert!(error.detail.contains("100 extreme vertices") && error.detail.contains("99"), "{error}");
}

/// The bytes that a cache counts are the bytes that a hull holds. The lists of a clone have no spare
/// capacity, so a hull with the same number of bytes has none either. Catches a list that is not
/// counted, and one that grows faster than the hull: both leave the bounds.
#[test]
fn heap_bytes_follow_the_counts() {
    for (points, vertices, faces, edges) in [(64, 64, 124, 186), (256, 256, 508, 762)] {
        let hull = hull(&sphere(points, &mut Random::new(10)));
        let (v, f, e) = (hull.vertex_count(), hull.face_count(), hull.edge_count());
        assert_eq!((v, f, e), (vertices, faces, edges));
        assert_eq!(hull.heap_bytes(), hull.clone().heap_bytes());
        // The least is the vertices, planes and edges. The most adds all adjacency lists and the
        // data that speed up queries.
        let (least, most) = (v * 24 + f * 32 + e * 16, v * 128 + f * 96 + e * 64);
        assert!((least..=most).contains(&hull.heap_bytes()), "{} of {v} vertices", hull.heap_bytes());
    }
}

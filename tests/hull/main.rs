//! Hulls of many clouds, checked against the definitions alone.

mod check;
mod clouds;
mod simplify;

use std::collections::BTreeSet;

use check::{Met, check};
use clouds::{
    Points, Random, box_grid, clouds, cube, moved, noisy, prism, random_cloud, rotated, scaled, sphere,
};
use glam::DVec3;
use hullcast::contact::hull::{ConvexHull, HullError, HullErrorKind, HullOptions};

fn hull(points: &[[f64; 3]]) -> ConvexHull {
    ConvexHull::new(points).unwrap()
}

fn at(points: &[[f64; 3]], contraction_point: [f64; 3]) -> Result<ConvexHull, HullError> {
    let options = HullOptions { contraction_point: Some(contraction_point), ..HullOptions::default() };
    ConvexHull::with_options(points, &options)
}

/// Every definition holds for every cloud's hull. A fault of any step shows
/// here: a lost vertex, a hole, a wrong neighbour, a face off its plane.
#[test]
fn every_cloud_gives_a_hull() {
    let mut met = Met::default();
    for cloud in clouds() {
        println!("{}", cloud.name);
        let hull = ConvexHull::new(&cloud.points).unwrap();
        check(&cloud.points, &hull, &mut met);
    }
    println!("{met:?}");
    assert!(met.hulls >= 170 && met.triangles > 10_000);
    assert!(met.coplanar_sides > 1_000, "few exactly coplanar triangles");
    assert!(met.dropped_points > 5_000, "few interior points");
    assert!(met.merged_faces > 4_000 && met.inexact_faces > 300, "few merged faces");
    assert!(met.vertices_without_edges > 300, "few vertices inside merged faces");
}

/// The same for shapes nobody thought of; those that are no hull say why.
#[test]
fn random_clouds_give_hulls_or_reasons() {
    let (mut met, mut refused) = (Met::default(), 0);
    for seed in 0..300 {
        let points = random_cloud(seed);
        match ConvexHull::new(&points) {
            Ok(hull) => check(&points, &hull, &mut met),
            Err(error) => {
                assert!(!error.detail.contains("internal"), "{seed}: {error}");
                refused += 1;
            }
        }
    }
    println!("{met:?}, {refused} refused");
    assert!(met.hulls > 280 && refused > 0 && met.ordered_edges > 15_000);
    assert!(met.coplanar_sides > 2_500 && met.inexact_faces > 300);
}

/// At the size of the largest meshes: quadratic steps would show as hours.
#[test]
fn ten_thousand_points_give_a_hull() {
    let mut random = Random::new(3);
    for points in [sphere(10_000, &mut random), clouds::globe(50, 200), clouds::ball(10_000, &mut random)] {
        check(&points, &hull(&points), &mut Met::default());
    }
}

/// The unit cube's counts, sizes and numbering by hand: a wrong orientation,
/// scale or merge shows here first.
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

/// Exact merging alone leaves hundreds of facets on turned shapes.
#[test]
fn turned_boxes_and_prisms_keep_their_faces() {
    let mut random = Random::new(4);
    let grid = box_grid(30);
    assert_eq!(hull(&grid).vertex_count(), 8, "a point inside a face or an edge was kept");
    assert_eq!(hull(&prism(1000, 0.5)).face_count(), 1002);
    for _ in 0..3 {
        let box_hull = hull(&rotated(&grid, &mut random));
        assert_eq!((box_hull.face_count(), box_hull.edge_count()), (6, 12));
        assert!((0..6).all(|face| box_hull.outline(face).len() == 4));
        let prism_hull = hull(&rotated(&prism(1000, 0.5), &mut random));
        assert_eq!((prism_hull.face_count(), prism_hull.edge_count()), (1002, 3000));
        assert!(prism_hull.geometric_error() < 1e-14, "a fitted plane is tilted");
    }
}

/// Opposite faces, rims and neighbours of thin shapes stay apart: a tolerance
/// of the circumradius alone would make one face of a plate's two sides.
#[test]
fn thin_shapes_keep_their_faces() {
    let mut random = Random::new(5);
    for thin in [1.0, 1e-3, 1e-6, 1e-8] {
        for by in [[1.0, 0.7, thin], [1.0, thin, 0.6 * thin]] {
            let points = scaled(&prism(7, 1.0), by);
            assert_eq!(hull(&points).face_count(), 9, "{by:?}");
            assert_eq!(hull(&rotated(&points, &mut random)).face_count(), 9, "{by:?} turned");
        }
    }
}

/// Noise below the tolerance leaves a box's six faces; every point stays a
/// vertex that supports.
#[test]
fn noise_on_faces_merges() {
    let mut random = Random::new(6);
    let mut vertices = 0;
    for amount in [1e-15, 1e-12, 1e-9, 1e-7] {
        let points = noisy(&rotated(&box_grid(8), &mut random), amount, &mut random);
        let hull = hull(&points);
        assert_eq!(hull.face_count(), 6, "{amount:e}");
        assert!(hull.geometric_error() < 4.0 * amount + 1e-14);
        vertices += hull.vertex_count();
    }
    assert!(vertices > 200, "{vertices}");
}

/// A hull is its shape: scaling by a power of two changes no bit in hull units.
#[test]
fn scaling_by_a_power_of_two_changes_no_bit() {
    for cloud in clouds() {
        let hull = hull(&cloud.points);
        let size = cloud.points.iter().flatten().fold(0.0_f64, |m, c| m.max(c.abs()));
        for k in [-60, -1, 1, 60] {
            let power = 2_f64.powi(k);
            // Within the range of sizes, and where no coordinate is rounded.
            let exact = cloud.points.iter().flatten().all(|c| c * power / power == *c);
            if !(1e-49..1e49).contains(&(size * power)) || !exact {
                continue;
            }
            let other = ConvexHull::new(&scaled(&cloud.points, [power; 3])).unwrap();
            assert_eq!(other.scale(), hull.scale() * power, "{}", cloud.name);
            assert_eq!(other.volume(), hull.volume() * power * power * power);
            let inertia = hull.inertia() * power * power * power * power * power;
            assert_eq!(other.inertia(), inertia, "{}", cloud.name);
            assert_eq!(other.contraction_point(), hull.contraction_point() * power);
            assert_eq!(in_hull_units(&other), in_hull_units(&hull), "{}", cloud.name);
        }
    }
}

/// Found by fuzzing: the inradius of a needle with subnormal sides at its tip was rounded down
/// by more than that of the same needle where they are normal.
#[test]
fn subnormal_sides_are_as_exact_as_others() {
    let (tiny, mut built) = (4.4e-323, 0);
    let mut random = Random::new(14);
    for round in 0..40 {
        let length = if round == 0 { 16472519.66517901 } else { 10_f64.powf(3.0 + 4.0 * random.signed()) };
        let mut points =
            vec![[tiny, tiny, length], [-tiny, tiny, length], [-tiny, -tiny, length], [tiny, -tiny, length]];
        let radius = length * 1e-9;
        points.extend(prism(6, 0.0).iter().take(6).map(|p| [p[0] * radius, p[1] * radius, -length]));
        let units =
            |points: &Points| ConvexHull::new(points).map(|hull| in_hull_units(&hull)).map_err(|e| e.kind);
        let needle = units(&points);
        built += usize::from(needle.is_ok());
        for k in [40, 82] {
            assert_eq!(units(&scaled(&points, [2_f64.powi(k); 3])), needle, "{length:e}");
        }
    }
    assert!(built >= 10, "{built}");
}

/// All that queries read.
fn in_hull_units(hull: &ConvexHull) -> impl PartialEq + std::fmt::Debug + use<> {
    let faces = 0..hull.face_count();
    (
        hull.vertices().to_vec(),
        (hull.unit_inradius(), hull.unit_circumradius()),
        hull.faces().to_vec(),
        faces.map(|f| (hull.outline(f).to_vec(), hull.face_neighbours(f).to_vec())).collect::<Vec<_>>(),
        (hull.edge_vertices().to_vec(), hull.edge_faces().to_vec()),
    )
}

/// The order in which points come changes their numbers and nothing else.
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

/// Of duplicates the first is the vertex, -0.0 is 0.0, and points of the inside,
/// of a face's inside and of an edge are none.
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

/// A facet that bends by one subnormal step: in floating point the middle point
/// counts as in the plane and an extreme vertex would be lost.
#[test]
fn subnormal_coordinates_are_exact() {
    let step = f64::from_bits(1);
    let mut points: Points = cube().into_iter().map(|[x, y, z]| [x, y, z + 1.0]).collect();
    points.push([0.25, 0.25, -step]);
    assert_eq!(hull(&points).vertex_count(), 9);
    points[8][2] = 0.0;
    assert_eq!(hull(&points).vertex_count(), 8);
    points[8][2] = step;
    assert_eq!(hull(&points).vertex_count(), 8);
    // One corner lower: three of the four others still span the middle.
    points[0][2] = -step;
    points[8] = [0.5, 0.5, 0.0];
    assert_eq!(hull(&points).vertex_count(), 8);
    points[8] = [0.5, 0.5, -step];
    assert_eq!(hull(&points).vertex_count(), 9);
}

/// Closed forms. A wrong axis, sign or unit in the integrals shows here.
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
    // Integrals of x^2 and x y of the corner are 1/60 and 1/120 at the origin.
    assert!(near(corner.inertia().x_axis.x, 2.0 * (1.0 / 60.0 - 1.0 / 96.0)));
    assert!(near(corner.inertia().x_axis.y, -(1.0 / 120.0 - 1.0 / 96.0)));
}

/// Any point inside is a contraction point, however near the surface; one on it
/// or outside is refused.
#[test]
fn contraction_points_are_strictly_inside() {
    for depth in [0.5, 1e-3, 1e-6, 1e-9, 3e-11] {
        let z = 1.0 - depth;
        let near = at(&cube(), [0.25, -0.5, z]).unwrap();
        assert_eq!(near.contraction_point(), DVec3::new(0.25, -0.5, z));
        // Vertices about the point are rounded, which the inradius has to allow for.
        let lost = (1.0 - z) - near.inradius();
        assert!((0.0..8e-16).contains(&lost), "{depth:e}: {lost:e}");
        assert_eq!(near.face_count(), 6);
        check(&cube(), &near, &mut Met::default());
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
        assert!(error.detail.contains(&format!("{:e}", point[0])), "{error}");
    }
}

/// Each reason, and that it names what is at fault.
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
    // One rounding off a line or a plane is a hull; whether it has an inside
    // that doubles can name is another matter.
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

/// What a cache counts is what is held. A clone's lists have no room to spare:
/// a hull with the same bytes has none either. A list that is not counted, or one
/// that grows faster than the hull, is outside the bounds.
#[test]
fn heap_bytes_follow_the_counts() {
    for (points, vertices, faces, edges) in [(64, 64, 124, 186), (256, 256, 508, 762)] {
        let hull = hull(&sphere(points, &mut Random::new(10)));
        let (v, f, e) = (hull.vertex_count(), hull.face_count(), hull.edge_count());
        assert_eq!((v, f, e), (vertices, faces, edges));
        assert_eq!(hull.heap_bytes(), hull.clone().heap_bytes());
        // Vertices, planes and edges alone; with all adjacency and what speeds a query up.
        let (least, most) = (v * 24 + f * 32 + e * 16, v * 128 + f * 96 + e * 64);
        assert!((least..=most).contains(&hull.heap_bytes()), "{} of {v} vertices", hull.heap_bytes());
    }
}

/// Found by fuzzing: of needles of an aspect from 1e12 on the vertices about the
/// contraction point are rounded by as much as keeps faces apart. Outlines turned
/// round about their exact normals (areas were negative), corners and edges did not
/// make a polyhedron (Euler's formula), and witnesses were outside. They are refused,
/// by the aspect alone; all others hold every definition.
#[test]
fn needles_are_hulls_or_too_thin() {
    let mut random = Random::new(13);
    let (mut met, mut refused) = (Met::default(), 0);
    for round in 0..3000 {
        let length = 10_f64.powf(9.0 + 3.5 * random.signed());
        let grid = |random: &mut Random| [(); 3].map(|()| (random.signed() * 104.0).round() / 32.0);
        let mut points: Points = (0..4 + random.below(9)).map(|_| grid(&mut random)).collect();
        // Some in a plane or on a line with others, to rounding.
        for _ in 0..random.below(3) {
            let [p, q, r] = [(); 3].map(|()| points[random.below(points.len())]);
            points.push(std::array::from_fn(|k| p[k] + (q[k] - r[k])));
            points.push(std::array::from_fn(|k| p[k] + 0.3 * (q[k] - p[k])));
        }
        let tip = grid(&mut random);
        points.push(tip.map(|c| c * length));
        if round % 3 == 0 {
            points.push(std::array::from_fn(|k| tip[k] * length + points[0][k]));
        }
        match ConvexHull::new(&points) {
            Ok(hull) => {
                assert!(hull.inradius() > 7e-12 * hull.circumradius());
                check(&points, &hull, &mut met);
            }
            Err(error) => {
                assert!(error.detail.contains("too thin"), "{error}: {points:?}");
                refused += 1;
            }
        }
    }
    assert!(met.hulls > 1500 && refused > 300, "{} hulls, {refused} refused", met.hulls);
}

/// Found by fuzzing, and none of the hull's: an edge as short as a third face, merged to
/// the tolerance, is off its plane runs the other way in its neighbour's outline.
#[test]
fn edges_within_a_merged_face_may_fold() {
    let [x, y] = [6.802236877180397e19, 5.7069614478038925e19];
    let points = [
        [3.6875, 3.09375, y],
        [5.573204538870989e16, 3.09375, 0.0],
        [0.0, 0.0, 0.78125],
        [126701535232.0, 0.0, 0.0],
        [3.09375, 3.09375, 0.0],
        [0.0, 3.09375, 3.09375],
        [3.6875, x, 6.642809450371482e16],
        [x, y, 0.0],
        [x, 3.6875, 1.7005592192950993e19],
        [3.09375, 0.0, 3.09375],
        [x, x, 114.0],
    ];
    check(&points, &hull(&points), &mut Met::default());
}

/// Found by fuzzing, and none of the hull's: where corners all but coincide, two faces may
/// meet along an edge and along it again, a fold thinner than the merge tolerance, of which
/// one side runs against the outlines.
#[test]
fn edges_beside_corners_that_nearly_coincide_may_fold_back() {
    let [x, y] = [6.802236877180397e19, 5.7069614478038925e19];
    let points = [
        [3.6875, 3.09375, y],
        [5.573204538870989e16, 3.09375, 0.0],
        [3.09375, 1.125, 3.34375],
        [0.0, 0.0, y],
        [99.0, 3.09375, 3.09375],
        [3.6875, x, 6.642809450371482e16],
        [x, 99.0, 0.0],
        [3.09375, 3.09375, 0.0],
        [3.09375, 3.09375, 0.375],
        [3.09375, 0.0, 3.09375],
        [0.0, 0.0, 3.09375],
        [3.09375, 0.0, 3.6875],
        [3.6875, 0.0, 3321888768.0],
        [y, 1.7005592192950993e19, 0.0],
    ];
    check(&points, &hull(&points), &mut Met::default());
}

/// Found by fuzzing: vertices that differ, but not once they are about the
/// contraction point, made a face of no area, whose outline bounded nothing.
#[test]
fn vertices_that_coincide_about_the_contraction_point_make_no_face() {
    let mut random = Random::new(12);
    let mut coinciding = 0;
    for size in [1e-10, 1e-15, 1e-18, 1e-40] {
        for _ in 0..40 {
            let mut points = vec![[1.0, 0.1, 0.0], [1.0, -1.0, 0.2], [0.5, 0.7, 1.0]];
            points.extend(scaled(&sphere(6, &mut random), [size; 3]));
            let hull = hull(&points);
            check(&points, &hull, &mut Met::default());
            assert!(hull.faces().iter().all(|face| face.area > 0.1 * size * size), "{size:e}");
            let places: BTreeSet<_> =
                hull.vertices().iter().map(|v| v.to_array().map(f64::to_bits)).collect();
            coinciding += usize::from(places.len() < hull.vertex_count());
        }
    }
    assert!(coinciding >= 80, "{coinciding}");
}

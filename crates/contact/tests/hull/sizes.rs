//! Hulls of any size and shape: scaling by powers of two, subnormal coordinates and needles.

use hullcast_contact::hull::ConvexHull;

use crate::check::{CheckCounts, check};
use crate::clouds::{Points, Random, clouds, cube, prism, scaled};
use crate::hull;

/// Scaling by a power of two changes no bit of the geometry in hull units.
#[test]
fn scaling_by_a_power_of_two_changes_no_bit() {
    for cloud in clouds() {
        let hull = hull(&cloud.points);
        let size = cloud.points.iter().flatten().fold(0.0_f64, |m, c| m.max(c.abs()));
        for k in [-60, -1, 1, 60] {
            let power = 2_f64.powi(k);
            // Skip sizes out of range and coordinates that scaling would round.
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

/// Found by fuzzing: the inradius of a needle with subnormal sides at its tip was rounded down by
/// more than that of the same needle at a scale at which the sides are normal.
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

/// All geometry that queries read.
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

/// Catches an extreme vertex that is lost because a facet bends by only one subnormal step. In
/// floating-point arithmetic the point in the middle would count as in the plane.
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
    // One corner is lower. Point 8 is in the triangle of the other three, so it is not extreme.
    points[0][2] = -step;
    points[8] = [0.5, 0.5, 0.0];
    assert_eq!(hull(&points).vertex_count(), 8);
    points[8] = [0.5, 0.5, -step];
    assert_eq!(hull(&points).vertex_count(), 9);
}

/// Found by fuzzing: for needles of an aspect of 1e12 and more, the vertices in hull units are
/// rounded by as much as the tolerance that keeps faces apart. Outlines ran the wrong way about their
/// exact normals (areas were negative), corners and edges did not make a polyhedron (Euler's
/// formula), and witnesses were outside. Such needles are now refused because of their aspect, and
/// all others must satisfy every definition.
#[test]
fn needles_are_hulls_or_too_thin() {
    let mut random = Random::new(13);
    let (mut counts, mut refused) = (CheckCounts::default(), 0);
    for round in 0..3000 {
        let length = 10_f64.powf(9.0 + 3.5 * random.signed());
        let grid = |random: &mut Random| [(); 3].map(|()| (random.signed() * 104.0).round() / 32.0);
        let mut points: Points = (0..4 + random.below(9)).map(|_| grid(&mut random)).collect();
        // Some points are in a plane or on a line with others, up to rounding.
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
                check(&points, &hull, &mut counts);
            }
            Err(error) => {
                assert!(error.detail.contains("too thin"), "{error}: {points:?}");
                refused += 1;
            }
        }
    }
    assert!(counts.hulls > 1500 && refused > 300, "{} hulls, {refused} refused", counts.hulls);
}

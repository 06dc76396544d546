//! What fuzzing several places of each pair of hulls found, each with its cause.

use hullcast::contact::{Element, Manifold};

use crate::case::{Case, Shape, cuboid, turn};
use crate::named::{LEVEL, judged};
use crate::scene::{Random, box_points, scaled};

/// A needle of 2e9 and a sliver of its roundings' size at its tip: the simplex with the
/// newest vertex of the difference was as near as without it to a rounding, so that vertex
/// was dropped and found again until the steps were used up, and the pair UNDECIDED. (Of a
/// needle-like triangle the closest point was also found from the far end, 10 digits lost.)
#[test]
fn slivers_at_the_tip_of_a_needle_are_decided() {
    let mut needle: Vec<[f64; 3]> = vec![
        [-106238710.76734579, 510114444.3579956, 774657266.1705873],
        [-106238710.91610357, 510114444.38784754, 774657266.1305287],
        [-106238711.00902641, 510114444.48722994, 774657266.0523413],
        [-106238711.01062077, 510114444.6181818, 774657265.9658905],
        [-106238710.9202778, 510114444.7306843, 774657265.9041971],
        [-106238710.77250528, 510114444.78176516, 774657265.8908261],
        [-106238710.62374747, 510114444.7519132, 774657265.9308847],
        [-106238710.53082469, 510114444.6525308, 774657266.0090721],
        [-106238710.52923027, 510114444.5215789, 774657266.095523],
        [-106238710.6195733, 510114444.40907645, 774657266.1572164],
    ];
    needle.push([106238710.76992553, -510114444.56988037, -774657266.0307068]);
    let sliver = vec![
        [0.0, 4.641588833612782e-7, 6.057638293142939e-8],
        [-2.6101572156825333e-9, -4.641588833612782e-7, -1.2115276586285877e-7],
        [0.0, -4.641588833612782e-7, -6.057638293142939e-8],
        [0.0, -2.320794416806391e-7, 0.0],
        [2.6101572156825333e-9, 4.641588833612782e-7, 0.0],
        [2.6101572156825333e-9, -2.320794416806391e-7, 6.057638293142939e-8],
        [-1.3050786078412667e-9, -4.641588833612782e-7, 0.0],
        [1.3050786078412667e-9, -4.641588833612782e-7, 1.2115276586285877e-7],
        [2.6101572156825333e-9, 2.320794416806391e-7, -6.057638293142939e-8],
        [1.3050786078412667e-9, 4.641588833612782e-7, 0.0],
        [0.0, 4.641588833612782e-7, 0.0],
        [-1.3050786078412667e-9, 4.641588833612782e-7, -6.057638293142939e-8],
    ];
    let inside = [1.297144999282961e-9, 3.7950984688201775e-7, 7.36490977889719e-9];
    let shapes = [Shape::new(needle), Shape::about(sliver, Some(inside))];
    let mut case = Case::new(
        shapes,
        [-106238710.77250606, 510114444.781766, 774657265.8908252],
        [LEVEL, [0.0191391687259545, -0.32864674296779794, -0.4759126208229137, 0.8155563670885069]],
    );
    case.relative_tolerance = 1.0;
    judged(&case);
}

/// Sides of an outline that go on along one line, to the merge distance, cut as one: what
/// was cut far beyond the first one's end was lifted to the height of that end, so that
/// witnesses on hulls thinner than 1e-12 were outside by as much as a face is tilted.
#[test]
fn crossings_are_lifted_along_the_side_that_they_are_beside() {
    let random = &mut Random(11);
    let (mut crossings, mut touching) = (0, 0);
    for round in 0..3000 {
        // A needle, its sides bent by less than the merge distance of it and a larger box.
        let size = 10f64.powf(random.range(-4.0, -1.0));
        let width = 10f64.powf(random.range(-10.0, -8.0));
        let mut points = vec![[-1.0, 0.0, 0.0], [1.0, width, 0.0], [1.0, -width, 0.0], [1.0, 0.0, width]];
        for _ in 0..random.below(9) {
            let ([x, y, z], share) = (points[1 + random.below(3)], random.range(0.1, 0.9));
            let out = share + 10f64.powf(random.range(-15.0, -11.0)) / width;
            points.push([(x + 1.0) * share - 1.0, y * out, z * out]);
        }
        let points = points.iter().map(|&p| scaled(p, size)).collect();
        let (shapes, order) = ([cuboid([0.8, 0.6, 0.2]), Shape::new(points)], [[0, 1], [1, 0]][round % 2]);
        let (spin, tilt) = (random.range(0.0, 6.3), random.range(-0.4, 0.4));
        let rotation = crate::metamorphic::product(turn([0.0, 0.0, 1.0], spin), turn([0.0, 1.0, 0.0], tilt));
        let at = [0.8 + size * random.range(-0.5, 0.5), random.range(-0.5, 0.5), 0.2 - 0.1 * size];
        let (positions, rotations) = ([[0.0; 3], at], [LEVEL, rotation]);
        let mut case = Case::new(order.map(|i| shapes[i].clone()), [0.0; 3], order.map(|i| rotations[i]));
        case.positions = order.map(|i| positions[i]);
        for feature_angle in [0.01, 0.5] {
            let mut query = case.query(f64::INFINITY);
            query.accuracy.feature_angle = feature_angle;
            let m = case.certified(&query);
            touching += usize::from(!m.flags.estimated);
            crossings += m.points.iter().filter(|p| is_crossing(p.id)).count();
        }
    }
    assert!(touching > 600 && crossings > 400, "{touching} touching, {crossings} crossings");
}

/// Whether two edges make a point.
fn is_crossing(id: [Element; 2]) -> bool {
    id.iter().all(|e| matches!(e, Element::Edge(_)))
}

/// Whether alpha is below the normal doubles, and not 0 for centres that coincide.
fn is_subnormal(m: &Manifold) -> bool {
    !m.flags.coincident && m.alpha.is_subnormal()
}

/// None of the answer's: centres so near that alpha is below the normal doubles, a multiple
/// of 2^-1074, as are the ends of its bracket; what the certificate allowed underflowed to 0.
#[test]
fn alphas_below_the_normal_doubles_hold_their_certificate() {
    let random = &mut Random(12);
    let mut subnormal = 0;
    for _ in 0..400 {
        let shapes = [0; 2].map(|_| Shape::centred(box_points([0; 3].map(|_| random.range(0.2, 1.0)))));
        let d = random.direction().map(|x| x * 10f64.powf(random.range(-323.0, -307.0)));
        let case = Case::new(shapes, d, [random.rotation(), random.rotation()]);
        let answers = case.certified_by_each(&case.query(f64::INFINITY));
        subnormal += answers.iter().filter(|m| is_subnormal(m)).count();
    }
    assert!(subnormal > 300, "{subnormal}");
}

/// Found by the matrix: a corner within the merge distance of the other feature touches it,
/// but the lines of its sides leave that feature farther out, and what clipping left there was
/// cut off: ESTIMATED where the features met.
#[test]
fn sharp_corners_that_nearly_touch_are_no_estimate() {
    let rotations = [
        [0.5830568089354147, 0.7725214534593713, -0.23601900229948608, 0.08689299196498486],
        [-0.2571161694078712, 0.7722333137332357, -0.017761606210850624, 0.5807163764992508],
    ];
    let shapes = [
        cuboid([0.9866653267547436, 0.3128986704880256, 0.7466787133231939]),
        cuboid([0.42804489062759, 0.818651503756993, 0.6245443554274834]),
    ];
    let d = [-1.127161555820639, 1.4147214450740229, 0.8540473453848052];
    let near = Case::new(shapes.clone(), d, rotations);
    judged(&near);
    // And around it, to some times the merge distance.
    let random = &mut Random(13);
    for _ in 0..500 {
        let by = scaled(random.direction(), 10f64.powf(random.range(-15.5, -13.0)));
        judged(&Case::new(shapes.clone(), std::array::from_fn(|k| d[k] + by[k]), rotations));
    }
}

/// Where edges that are nearly parallel cross near an end, the crossing was as far off along
/// them as rounding is over their sine: witnesses beyond the ends, by 1e-6 of the hulls.
#[test]
fn edges_nearly_parallel_cross_within_both() {
    let random = &mut Random(14);
    let roof = Shape::centred(vec![[-1.0, 0.0, 0.5], [1.0, 0.0, 0.5], [0.0, -1.0, -0.5], [0.0, 1.0, -0.5]]);
    let (mut corners, mut crossings) = (0, 0);
    for round in 0..4000 {
        // B upside down on A's edge, spun by a little, so that the edges meet in an end of one
        // of them, but for some ulps.
        let spin = 10f64.powf(random.range(-12.0, -1.0));
        let upside_down = crate::metamorphic::product(
            turn([0.0, 0.0, 1.0], spin),
            turn([1.0, 0.0, 0.0], std::f64::consts::PI),
        );
        let slide = random.range(-1.9, 1.9);
        let end = [-1.0, 1.0][random.below(2)];
        let across = if round % 2 == 0 { end * spin.sin() } else { (slide - end) * spin.tan() };
        let off = 10f64.powf(random.range(-18.0, -11.0)) * [-1.0, 1.0][random.below(2)];
        let d = [slide, across + off, 1.0 + 10f64.powf(random.range(-18.0, -15.0))];
        let shapes = [roof.clone(), roof.clone()];
        let case = Case::new(shapes, d, [LEVEL, upside_down]);
        for m in case.certified_by_each(&case.query(f64::INFINITY)) {
            let [point] = m.points[..] else { continue };
            if is_crossing(point.id) { crossings += 1 } else { corners += 1 }
        }
    }
    assert!(corners > 1000 && crossings > 500, "{corners} corners, {crossings} crossings");
}

/// None of the answer's: a contraction point below the normal doubles, which the certificate
/// turned with the bits that it has there.
#[test]
fn contraction_points_below_the_normal_doubles_hold_their_certificate() {
    let random = &mut Random(15);
    let mut subnormal = 0;
    for _ in 0..400 {
        let centre = random.direction().map(|x| x * 10f64.powf(random.range(-321.0, -307.0)));
        // The smaller the hulls, the more of alpha a bit of the centre is.
        let half = [0; 3].map(|_| 10f64.powf(random.range(-4.0, 0.0)));
        let shapes = [Shape::about(box_points(half), Some(centre)), Shape::centred(box_points(half))];
        let case = Case::new(shapes, [0.0; 3], [random.rotation(), random.rotation()]);
        for max_iterations in [2, 1000] {
            let mut query = case.query(f64::INFINITY);
            query.accuracy.max_iterations = max_iterations;
            subnormal += case.certified_by_each(&query).iter().filter(|m| is_subnormal(m)).count();
        }
    }
    assert!(subnormal > 500, "{subnormal}");
}

//! Contact patches as convex polygons in space.

use glam::DVec3;

/// Area of a polygon whose corners are in order about `normal`.
pub(super) fn area(polygon: &[DVec3], normal: DVec3) -> f64 {
    let [first, rest @ ..] = polygon else { return 0.0 };
    rest.windows(2).map(|two| 0.5 * normal.dot((two[0] - first).cross(two[1] - first))).sum::<f64>().abs()
}

/// The corners of the convex hull of points in any order, seen along `normal`, in order about it. Uses
/// Andrew's monotone chain, because the answers of other libraries may be neither convex nor in order. This is
/// not the chain of `hullcast-contact`: that one is private, and its answers are among those compared here.
pub(super) fn convex(points: &[DVec3], normal: DVec3) -> Vec<DVec3> {
    let (u, v) = normal.any_orthonormal_pair();
    let mut order: Vec<DVec3> = points.to_vec();
    order.sort_unstable_by(|p, q| (u.dot(*p)).total_cmp(&u.dot(*q)).then(v.dot(*p).total_cmp(&v.dot(*q))));
    order.dedup();
    if order.len() < 3 {
        return order;
    }
    let turns_left = |p: DVec3, q: DVec3, x: DVec3| normal.dot((q - p).cross(x - q)) > 0.0;
    let half = |points: &mut dyn Iterator<Item = DVec3>| {
        let mut chain: Vec<DVec3> = Vec::new();
        for point in points {
            while let [.., p, q] = chain[..] {
                if turns_left(p, q, point) {
                    break;
                }
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut corners = half(&mut order.iter().copied());
    corners.extend(half(&mut order.iter().rev().copied()));
    corners
}

/// The Hausdorff distance of two convex polygons. It is attained at a corner, since the distance to a
/// convex set is a convex function. Infinite if exactly one of them is empty.
pub(super) fn hausdorff(p: &[DVec3], q: &[DVec3]) -> f64 {
    if p.is_empty() && q.is_empty() {
        return 0.0;
    }
    let farthest = |from: &[DVec3], to: &[DVec3]| from.iter().map(|&x| distance(x, to)).fold(0.0, f64::max);
    farthest(p, q).max(farthest(q, p))
}

/// Distance of a point from a convex polygon, a segment or a point.
fn distance(x: DVec3, polygon: &[DVec3]) -> f64 {
    match *polygon {
        [] => f64::INFINITY,
        [p] => x.distance(p),
        [p, q] => x.distance(on_segment(x, p, q)),
        [first, ref rest @ ..] => {
            let fan = rest.windows(2).map(|two| x.distance(on_triangle(x, [first, two[0], two[1]])));
            fan.fold(f64::INFINITY, f64::min)
        }
    }
}

fn on_segment(x: DVec3, p: DVec3, q: DVec3) -> DVec3 {
    let along = q - p;
    let t = (x - p).dot(along) / along.length_squared();
    if t.is_nan() { p } else { p + along * t.clamp(0.0, 1.0) }
}

fn on_triangle(x: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let n = (b - a).cross(c - a);
    let foot = x - n * ((x - a).dot(n) / n.length_squared());
    let inside = [(a, b), (b, c), (c, a)].iter().all(|&(u, v)| n.dot((u - foot).cross(v - foot)) >= 0.0);
    if inside && foot.is_finite() {
        return foot;
    }
    let sides = [on_segment(x, a, b), on_segment(x, b, c), on_segment(x, c, a)];
    sides.into_iter().min_by(|p, q| x.distance(*p).total_cmp(&x.distance(*q))).unwrap_or(a)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The corners of a square in any order, with points inside and on its sides, must give the square.
    /// Catches corners that are lost or out of order, and points that are not corners.
    #[test]
    fn corners_are_put_in_order() {
        let corners = [(-1.0, -1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0)];
        let inside = [(0.0, 0.5), (1.0, 0.0), (0.25, 0.0), (1.0, 1.0)];
        for normal in [DVec3::Z, DVec3::NEG_Z] {
            let points: Vec<DVec3> =
                corners.iter().chain(&inside).map(|&(x, y)| DVec3::new(x, y, 0.0)).collect();
            let square = convex(&points, normal);
            assert_eq!((square.len(), area(&square, normal)), (4, 4.0));
            assert_eq!(convex(&points[..2], normal).len(), 2);
            assert_eq!(convex(&[points[0]; 3], normal), [points[0]]);
        }
    }

    /// Catches a distance that is one-sided, or measured to the corners only or to the plane, and an area
    /// with a wrong sign or without a corner.
    #[test]
    fn squares_are_known_by_hand() {
        let square = |x: f64, half: f64| {
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(u, v)| DVec3::new(x + half * u, half * v, 0.0))
        };
        let [one, small, moved] = [square(0.0, 1.0), square(0.0, 0.5), square(3.0, 1.0)];
        assert_eq!(area(&one, DVec3::Z), 4.0);
        assert_eq!(area(&one, DVec3::NEG_Z), 4.0);
        assert_eq!(area(&one[..2], DVec3::Z), 0.0);
        assert_eq!(hausdorff(&one, &one), 0.0);
        let corner = 0.5_f64.hypot(0.5);
        assert!((hausdorff(&one, &small) - corner).abs() < 1e-15);
        assert!((hausdorff(&small, &one) - corner).abs() < 1e-15);
        assert!((hausdorff(&one, &moved) - 3.0).abs() < 1e-15);
        assert!(
            (hausdorff(&one, &[DVec3::new(0.25, 0.0, 2.0)]) - 1.25_f64.hypot(1.0).hypot(2.0)).abs() < 1e-15
        );
        assert_eq!(hausdorff(&one, &[]), f64::INFINITY);
        assert_eq!(hausdorff(&[], &[]), 0.0);
    }
}

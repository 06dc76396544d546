//! Convex polygons in the plane, given by their corners. The code is slow and plain, and shares
//! nothing with the clipping that it checks.

pub(crate) type Point = [f64; 2];

fn minus(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// The convex hull, anticlockwise (Andrew's monotone chain).
pub(crate) fn convex_hull(points: &[Point]) -> Vec<Point> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    sorted.dedup();
    if sorted.len() < 3 {
        return sorted;
    }
    let chain = |points: &mut dyn Iterator<Item = &Point>| {
        let mut chain: Vec<Point> = Vec::new();
        for &point in points {
            while let [.., a, b] = chain[..]
                && cross(minus(b, a), minus(point, a)) <= 0.0
            {
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut hull = chain(&mut sorted.iter());
    hull.extend(chain(&mut sorted.iter().rev()));
    hull
}

fn sides(polygon: &[Point]) -> impl Iterator<Item = [Point; 2]> + '_ {
    (0..polygon.len()).map(|i| [polygon[i], polygon[(i + 1) % polygon.len()]])
}

/// The point where two segments cross, if they cross in one point.
fn crossing([a, b]: [Point; 2], [c, d]: [Point; 2]) -> Option<Point> {
    let (ab, cd, ac) = (minus(b, a), minus(d, c), minus(c, a));
    let area = cross(ab, cd);
    let (s, t) = (cross(ac, cd) / area, cross(ac, ab) / area);
    ((0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t)).then(|| [a[0] + s * ab[0], a[1] + s * ab[1]])
}

/// The intersection of two anticlockwise polygons, segments or points. Its corners are the corners
/// of one that are at most `slack` outside the other, and the crossings of sides. Empty if they do
/// not meet.
pub(crate) fn intersection(p: &[Point], q: &[Point], slack: f64) -> Vec<Point> {
    let mut corners: Vec<Point> = Vec::new();
    corners.extend(p.iter().filter(|&&v| distance(q, v) <= slack));
    corners.extend(q.iter().filter(|&&v| distance(p, v) <= slack));
    for side in sides(p) {
        corners.extend(sides(q).filter_map(|other| crossing(side, other)));
    }
    convex_hull(&corners)
}

/// The distance of `point` from a convex polygon, segment or point; 0 inside.
fn distance(polygon: &[Point], point: Point) -> f64 {
    let inside = |[a, b]: [Point; 2]| cross(minus(b, a), minus(point, a)) >= 0.0;
    if polygon.len() > 2 && sides(polygon).all(inside) {
        return 0.0;
    }
    let to_side = |[a, b]: [Point; 2]| {
        let (side, from) = (minus(b, a), minus(point, a));
        let length = dot(side, side);
        let t = if length > 0.0 { (dot(from, side) / length).clamp(0.0, 1.0) } else { 0.0 };
        let gap = [from[0] - t * side[0], from[1] - t * side[1]];
        dot(gap, gap).sqrt()
    };
    sides(polygon).map(to_side).fold(f64::INFINITY, f64::min)
}

/// The least distance between two convex polygons, segments or points; 0 if they meet.
pub(crate) fn gap(p: &[Point], q: &[Point]) -> f64 {
    if !intersection(p, q, 0.0).is_empty() {
        return 0.0;
    }
    let one_way =
        |from: &[Point], to: &[Point]| from.iter().map(|&v| distance(to, v)).fold(f64::INFINITY, f64::min);
    one_way(p, q).min(one_way(q, p))
}

/// The Hausdorff distance of two convex polygons, which is attained at a corner. Infinite if one is
/// empty.
pub(crate) fn hausdorff(p: &[Point], q: &[Point]) -> f64 {
    let one_way = |from: &[Point], to: &[Point]| from.iter().map(|&v| distance(to, v)).fold(0.0, f64::max);
    if p.is_empty() || q.is_empty() { f64::INFINITY } else { one_way(p, q).max(one_way(q, p)) }
}

/// The area of an anticlockwise polygon.
pub(crate) fn area(polygon: &[Point]) -> f64 {
    let origin = polygon.first().copied().unwrap_or_default();
    sides(polygon).map(|[a, b]| cross(minus(a, origin), minus(b, origin)) / 2.0).sum()
}

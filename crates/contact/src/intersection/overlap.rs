//! The vertices of the intersection of two projected features: each one once, in order, with its id.
//!
//! ```text
//! two small polygons in general position:   walk around both                      (polygons)
//! otherwise, B or A is a polygon:           clip the other feature by it          (clip)
//! otherwise:                                the crossing of two edges, or corners on the other
//! then merge vertices within eps of each other, and drop those on the line of their neighbours
//! ```

use glam::DVec2;

use super::PlanePoint;
use super::clip::{Clip, Made, Vertex};
use super::outline::{Outline, height_on};
use super::polygons::Polygons;
use crate::manifold::Element;

/// Appends the vertices of the intersection, anticlockwise, and returns the index of the one with the
/// lowest id. Appends nothing if the projections miss each other by more than `eps`.
///
/// The caller has set the sides of B. If B is not a polygon, or both are large, it has set A's too.
pub(super) fn find(
    a: &Outline,
    b: &Outline,
    eps: f64,
    polygons: &mut Polygons,
    clip: &mut Clip,
    points: &mut Vec<PlanePoint>,
) -> usize {
    if !polygons.find(a, b, eps, points) {
        clipped(a, b, eps, clip, points);
    }
    if !settled(points, eps) {
        merge(points, eps);
        straighten(points, eps);
    }
    lowest(points)
}

/// Appends the vertices of any two features. Vertices closer than `eps` are not merged yet.
fn clipped(a: &Outline, b: &Outline, eps: f64, clip: &mut Clip, points: &mut Vec<PlanePoint>) {
    if b.corners.len() > 2 {
        clip.clip(a, b, eps);
        points.extend(clip.kept.iter().map(|v| {
            let [(own, height_a), (other, height_b)] = lifted(v, a, b);
            PlanePoint { at: v.at, height_a, height_b, id: [own, other] }
        }));
    } else if a.corners.len() > 2 {
        clip.clip(b, a, eps);
        points.extend(clip.kept.iter().map(|v| {
            let [(own, height_b), (other, height_a)] = lifted(v, b, a);
            PlanePoint { at: v.at, height_a, height_b, id: [coinciding(a, v.at, eps).unwrap_or(other), own] }
        }));
    } else {
        thin(a, b, eps, points);
    }
}

/// The index of the lowest id. Computed without branches, because they would be unpredictable.
fn lowest(points: &[PlanePoint]) -> usize {
    let (mut first, mut least) = (0, [u128::MAX; 2]);
    for (i, point) in points.iter().enumerate() {
        let key = point.id.map(Element::key);
        let lower = (key[0] < least[0]) | ((key[0] == least[0]) & (key[1] < least[1]));
        first = if lower { i } else { first };
        least = [0, 1].map(|k| if lower { key[k] } else { least[k] });
    }
    first
}

/// For the subject and for the window, the part that makes a vertex and the height of the vertex on it.
fn lifted(v: &Vertex, subject: &Outline, window: &Outline) -> [(Element, f64); 2] {
    let corner = |outline: &Outline, i: u32| {
        let corner = &outline.corners[i as usize];
        (Element::Vertex(corner.vertex), corner.height)
    };
    let side = |outline: &Outline, i: u32| {
        (outline.side_name(i as usize), height_on(outline.side(i as usize), v.at))
    };
    match v.made {
        Made::Own(i) => [corner(subject, i), (Element::Inside, window.height(v.at))],
        Made::Window { corner: j, near } => {
            let (name, height) = corner(window, j);
            let height = if near { window.height(v.at) } else { height };
            [(Element::Inside, subject.height(v.at)), (name, height)]
        }
        Made::Crossing(i, j) => [side(subject, i), side(window, window.side_beside(j, v.at))],
        // Clipping replaces all of these.
        Made::Meeting([_, j]) => [(Element::Inside, subject.height(v.at)), side(window, j)],
    }
}

/// Whether the outline needs no cleaning: no vertex is within `eps` of the next one, or of the line
/// between its neighbours.
fn settled(points: &[PlanePoint], eps: f64) -> bool {
    let (&[.., last], &[first, ..]) = (points, points) else { return true };
    let mut before = last.at;
    let mut at = first.at;
    let mut whole = points.len() > 2;
    for i in 0..points.len() {
        let after = points.get(i + 1).map_or(first.at, |p| p.at);
        whole &= at.distance_squared(after) > eps * eps && aside(before, at, after, eps);
        (before, at) = (at, after);
    }
    whole
}

/// The corner of A at a vertex of B's clipped outline, if there is one.
fn coinciding(a: &Outline, at: DVec2, eps: f64) -> Option<Element> {
    let corner = a.corners.iter().find(|c| c.at.distance_squared(at) <= eps * eps);
    corner.map(|c| Element::Vertex(c.vertex))
}

/// Intersects edges and vertices. Two edges that cross clear of their ends give the crossing. Otherwise
/// the points are the corners within `eps` of the other feature: rounding decides where nearly parallel
/// edges cross near an end, but it does not move that end.
fn thin(a: &Outline, b: &Outline, eps: f64, points: &mut Vec<PlanePoint>) {
    if let Some(point) = crossing(a, b, eps) {
        return points.push(point);
    }
    for c in a.corners.iter().filter(|c| touches(b, c.at, eps)) {
        let id = [Element::Vertex(c.vertex), Element::Inside];
        points.push(PlanePoint { at: c.at, height_a: c.height, height_b: b.height(c.at), id });
    }
    for c in b.corners.iter().filter(|c| touches(a, c.at, eps)) {
        let id = [Element::Inside, Element::Vertex(c.vertex)];
        points.push(PlanePoint { at: c.at, height_a: a.height(c.at), height_b: c.height, id });
    }
}

/// The crossing of two edges, if every end is farther than `eps` from the other edge's line.
fn crossing(a: &Outline, b: &Outline, eps: f64) -> Option<PlanePoint> {
    let (&[side_a], &[side_b]) = (a.sides.as_slice(), b.sides.as_slice()) else { return None };
    let [p, q] = a.side(0);
    let [a0, a1] = [p, q].map(|c| side_b.distance(c.at));
    let [b0, b1] = b.side(0).map(|c| side_a.distance(c.at));
    let crosses = (a0 > 0.0) != (a1 > 0.0) && (b0 > 0.0) != (b1 > 0.0);
    if !crosses || [a0, a1, b0, b1].iter().any(|distance| distance.abs() <= eps) {
        return None;
    }
    let at = p.at + (a0 / (a0 - a1)) * (q.at - p.at);
    let (height_a, height_b) = (height_on([p, q], at), height_on(b.side(0), at));
    let id = [a.side_name(0), b.side_name(0)];
    Some(PlanePoint { at, height_a, height_b, id })
}

/// Whether a point is within `eps` of a vertex or an edge.
fn touches(feature: &Outline, at: DVec2, eps: f64) -> bool {
    match feature.corners.as_slice() {
        [p, q] => {
            let (whole, part) = (q.at - p.at, at - p.at);
            let share = (part.dot(whole) / whole.length_squared()).clamp(0.0, 1.0);
            let nearest = if share.is_nan() { p.at } else { p.at + share * whole };
            at.distance(nearest) <= eps
        }
        corners => corners.iter().any(|c| c.at.distance(at) <= eps),
    }
}

/// The order in which merged points are kept: a corner of A first, then a corner of B, then a crossing.
fn rank(p: &PlanePoint) -> (u8, [Element; 2]) {
    let kind = match p.id {
        [Element::Vertex(_), _] => 0,
        [_, Element::Vertex(_)] => 1,
        _ => 2,
    };
    (kind, p.id)
}

/// Merges neighbours closer than `eps`, keeping the one of the lowest rank. One pass merges along the
/// outline. The last point and the first are merged after that, since each may replace the other
/// several times.
fn merge(points: &mut Vec<PlanePoint>, eps: f64) {
    let Some(&first) = points.first() else { return };
    let are_one = |p: &PlanePoint, q: &PlanePoint| !(p.at.distance_squared(q.at) > eps * eps);
    let (mut kept, mut current) = (0, first);
    for i in 1..points.len() {
        let next = points[i];
        if !are_one(&current, &next) {
            points[kept] = current;
            kept += 1;
            current = next;
        } else if rank(&next) < rank(&current) {
            current = next;
        }
    }
    points[kept] = current;
    points.truncate(kept + 1);
    let mut start = 0;
    while points.len() - start > 1 && are_one(&current, &points[start]) {
        if rank(&points[start]) < rank(&current) {
            points.pop();
            break;
        }
        start += 1;
    }
    points.drain(..start);
}

/// Drops vertices closer than `eps` to the line between their neighbours. If the whole outline is one
/// line, keeps its two ends.
fn straighten(points: &mut Vec<PlanePoint>, eps: f64) {
    if points.len() < 3 {
        return;
    }
    // If all vertices are within eps of one line, their area is at most 4 eps times their reach.
    let first = points[0].at;
    let (mut doubled_area, mut reach_squared) = (0.0, 0.0_f64);
    for pair in points.windows(2) {
        let (p, q) = (pair[0].at - first, pair[1].at - first);
        doubled_area += p.perp_dot(q);
        reach_squared = reach_squared.max(q.length_squared());
    }
    if doubled_area * doubled_area <= 64.0 * eps * eps * reach_squared {
        flatten(points, eps);
    }
    drop_straight(points, eps);
}

/// Drops vertices closer than `eps` to the line between their neighbours, one after another, but keeps
/// the last two.
fn drop_straight(points: &mut Vec<PlanePoint>, eps: f64) {
    // The vertices kept so far are at `..kept`, and those still to be examined begin at `i`.
    let (mut kept, count) = (0, points.len());
    for i in 0..count {
        let previous = points[if kept == 0 { count - 1 } else { kept - 1 }].at;
        let next = points[if i + 1 < count { i + 1 } else { 0 }].at;
        let are_two = kept + (count - i) <= 2;
        if are_two || aside(previous, points[i].at, next, eps) {
            points[kept] = points[i];
            kept += 1;
        }
    }
    points.truncate(kept);
}

/// If the whole outline is one line, keeps its two ends.
#[cold]
fn flatten(points: &mut Vec<PlanePoint>, eps: f64) {
    let farthest = |from: DVec2| {
        let distance = |i: &usize| points[*i].at.distance_squared(from);
        (0..points.len()).max_by(|i, j| distance(i).total_cmp(&distance(j)).then(j.cmp(i))).unwrap_or(0)
    };
    let first = farthest(points[0].at);
    let (p, q) = (points[first], points[farthest(points[first].at)]);
    if points.iter().all(|v| !aside(p.at, v.at, q.at, eps)) {
        points.clear();
        points.extend([p, q]);
    }
}

/// Whether `q` is farther than `eps` from the line through `p` and `r`.
fn aside(p: DVec2, q: DVec2, r: DVec2, eps: f64) -> bool {
    let area = (q - p).perp_dot(r - p);
    area * area > eps * eps * (r - p).length_squared()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::intersection::outline::{Corner, random_polygon as polygon};
    use crate::workload::Random;

    /// The walk and clipping must give the same polygon. Catches a sign lost, a corner of B left out or
    /// walked past, and a crossing on the wrong side.
    #[test]
    fn polygons_share_what_clipping_leaves() {
        let (eps, mut random) = (1e-12, Random::new(5));
        let (mut polygons, mut clip) = (Polygons::default(), Clip::default());
        let (mut kinds, mut large) = ([0; 4], 0);
        for _ in 0..40_000 {
            let [of_a, of_b] = [(); 2].map(|()| 3 + random.below(7));
            let (a, b) = (polygon(&mut random, of_a, 0), polygon(&mut random, of_b, 100));
            let (mut walked, mut cut) = (vec![], vec![]);
            if !polygons.find(&a, &b, eps, &mut walked) {
                assert!(walked.is_empty());
                large += usize::from(of_a > 8 || of_b > 8);
                continue;
            }
            assert!(of_a <= 8 && of_b <= 8);
            clipped(&a, &b, eps, &mut clip, &mut cut);
            assert_eq!(walked.len(), cut.len());
            let crossings = walked.iter().filter(|p| p.id.iter().all(|e| matches!(e, Element::Edge(_))));
            let kind = match (walked.is_empty(), crossings.count()) {
                (true, _) => 0,
                (_, 0) => 1,
                (_, 2) => 2,
                _ => 3,
            };
            kinds[kind] += 1;
            if walked.is_empty() {
                continue;
            }
            let (first, same) = (lowest(&walked), lowest(&cut));
            walked.rotate_left(first);
            cut.rotate_left(same);
            for (p, q) in walked.iter().zip(&cut) {
                assert_eq!(p.id, q.id);
                // Rounding decides where nearly parallel sides cross.
                let heights = (p.height_a - q.height_a).abs() + (p.height_b - q.height_b).abs();
                assert!(p.at.distance(q.at) < 1e-9 && heights < 1e-9, "{p:?} {q:?}");
            }
        }
        assert!(kinds.iter().all(|&count| count > 1000) && large > 5000, "{kinds:?} {large}");
    }

    /// One pass must keep the same points as removing one point at a time. Catches a merge or a
    /// straightening that keeps others, above all at the seam between the last point and the first.
    #[test]
    fn one_pass_keeps_what_removing_one_at_a_time_keeps() {
        fn merge_slowly(points: &mut Vec<PlanePoint>, eps: f64) {
            let mut i = 0;
            while points.len() > 1 && i < points.len() {
                let next = if i + 1 == points.len() { 0 } else { i + 1 };
                if points[i].at.distance_squared(points[next].at) > eps * eps {
                    i += 1;
                } else if rank(&points[next]) < rank(&points[i]) {
                    points.remove(i);
                } else {
                    points.remove(next);
                    i -= usize::from(next < i);
                }
            }
        }
        fn drop_slowly(points: &mut Vec<PlanePoint>, eps: f64) {
            let mut i = 0;
            while points.len() > 2 && i < points.len() {
                let previous = points[if i == 0 { points.len() - 1 } else { i - 1 }].at;
                let next = points[if i + 1 == points.len() { 0 } else { i + 1 }].at;
                if aside(previous, points[i].at, next, eps) {
                    i += 1;
                } else {
                    points.remove(i);
                }
            }
        }
        let mut random = Random::new(22);
        let (mut merged, mut straightened) = (0, 0);
        for _ in 0..20_000 {
            let mut points: Vec<PlanePoint> = (0..=random.below(12))
                .map(|_| PlanePoint {
                    at: DVec2::new(random.below(4) as f64, random.below(4) as f64),
                    height_a: 0.0,
                    height_b: 0.0,
                    id: [
                        [Element::Inside, Element::Vertex(random.below(9) as u32)][random.below(2)],
                        [Element::Inside, Element::Vertex(random.below(9) as u32)][random.below(2)],
                    ],
                })
                .collect();
            let mut expected = points.clone();
            merge_slowly(&mut expected, 1.1);
            merged += usize::from(expected.len() < points.len());
            merge(&mut points, 1.1);
            let ids =
                |points: &[PlanePoint]| points.iter().map(|p| (p.at.to_array(), p.id)).collect::<Vec<_>>();
            assert_eq!(ids(&points), ids(&expected));
            expected.clone_from(&points);
            drop_slowly(&mut expected, 0.3);
            straightened += usize::from(expected.len() < points.len());
            drop_straight(&mut points, 0.3);
            assert_eq!(ids(&points), ids(&expected));
        }
        assert!(merged > 5000 && straightened > 1000, "{merged} {straightened}");
    }

    /// Rounding decides where nearly parallel sides cross. If the crossing were lifted at one place on A
    /// and at another on B, a witness would be off its side by as much as the side is steep there.
    #[test]
    fn a_crossing_is_lifted_where_it_is() {
        let mut random = Random::new(6);
        let mut polygons = Polygons::default();
        let mut crossings = 0;
        for round in 0..4000 {
            let a = polygon(&mut random, 5, 0);
            let turn = DVec2::from_angle(10_f64.powi(-3 - round % 8));
            let about = a.corners[0].at.lerp(a.corners[1].at, random.unit());
            let mut b = Outline::default();
            let turned = |c: &Corner| Corner {
                at: about + turn.rotate(c.at - about),
                vertex: c.vertex + 100,
                height: 100.0 * random.unit(),
            };
            b.corners.extend(a.corners.iter().map(turned));
            b.set_sides();
            let mut points = vec![];
            polygons.find(&a, &b, 1e-13, &mut points);
            for p in &points {
                let [Element::Edge(_), Element::Edge(_)] = p.id else { continue };
                crossings += 1;
                for (outline, name, height) in [(&a, p.id[0], p.height_a), (&b, p.id[1], p.height_b)] {
                    let side = (0..5).find(|&i| outline.side_name(i) == name).expect("a side");
                    let ends = outline.side(side);
                    assert!((height - height_on(ends, p.at)).abs() < 1e-12, "{height} {ends:?} {p:?}");
                }
            }
        }
        assert!(crossings > 5000, "{crossings}");
    }

    /// If a corner lies on a side, or within the merge distance of one, `clip` decides which vertex stands
    /// for the crossing. Catches a walk that does not leave such polygons to it.
    #[test]
    fn a_corner_on_a_line_is_not_walked_past() {
        let mut random = Random::new(9);
        let mut polygons = Polygons::default();
        for round in 0..2000 {
            let (mut a, b) = (polygon(&mut random, 4, 0), polygon(&mut random, 5, 100));
            let [from, to] = b.side(round % 5).map(|c| c.at);
            let share = random.within(-1.0, 2.0);
            let aside = b.sides[round % 5].inward * random.within(-0.9e-6, 0.9e-6);
            let moved = from + share * (to - from) + aside - a.corners[round % 4].at;
            a.corners.iter_mut().for_each(|c| c.at += moved);
            a.set_sides();
            assert!(!polygons.find(&a, &b, 1e-6, &mut vec![]));
        }
    }
}

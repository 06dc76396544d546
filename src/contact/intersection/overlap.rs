//! Where two projected features overlap: the vertices of the intersection, each
//! once, in order, by name.

use glam::DVec2;

use super::PlanePoint;
use super::clip::{Clip, Made, Vertex};
use super::outline::{Outline, height_on};
use crate::contact::manifold::Element;

/// Appends the vertices of the intersection, anticlockwise, and returns which has
/// the lowest id; none where the projections miss each other by more than `eps`.
/// What others are measured against has its sides: B's polygon, else A's, else both.
pub(super) fn find(
    a: &Outline,
    b: &Outline,
    eps: f64,
    clip: &mut Clip,
    points: &mut Vec<PlanePoint>,
) -> usize {
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
    if !settled(points, eps) {
        merge(points, eps);
        straighten(points, eps);
    }
    lowest(points)
}

/// Where the lowest id is. Without branches: where is anyone's guess.
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

/// What of the subject and of the window makes a vertex, and how high it is on
/// each.
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
    }
}

/// Whether no vertex is within `eps` of the next or of the line between its
/// neighbours: an outline as it should be.
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

/// A's corner at a vertex of B's clipped outline.
fn coinciding(a: &Outline, at: DVec2, eps: f64) -> Option<Element> {
    let corner = a.corners.iter().find(|c| c.at.distance_squared(at) <= eps * eps);
    corner.map(|c| Element::Vertex(c.vertex))
}

/// Edges and vertices: of two edges that cross clear of their ends the crossing, else the
/// corners within `eps` of the other feature. Where nearly parallel edges cross near an end
/// is rounding's to say; that end is not.
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

/// Where two edges cross, if every end is farther than `eps` from the other's line.
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

/// A's corner names a point, else B's, else the crossing.
fn rank(p: &PlanePoint) -> (u8, [Element; 2]) {
    let kind = match p.id {
        [Element::Vertex(_), _] => 0,
        [_, Element::Vertex(_)] => 1,
        _ => 2,
    };
    (kind, p.id)
}

/// Of neighbours closer than `eps` keeps the one of the lowest rank.
fn merge(points: &mut Vec<PlanePoint>, eps: f64) {
    let mut i = 0;
    while points.len() > 1 && i < points.len() {
        let next = if i + 1 == points.len() { 0 } else { i + 1 };
        if points[i].at.distance_squared(points[next].at) > eps * eps {
            i += 1;
        } else if rank(&points[next]) < rank(&points[i]) {
            points.remove(i);
        } else {
            points.remove(next);
            // A removed first vertex moves all others down.
            i -= usize::from(next < i);
        }
    }
}

/// Drops vertices closer than `eps` to the line between their neighbours; of an
/// outline that is all one line keeps the two ends.
fn straighten(points: &mut Vec<PlanePoint>, eps: f64) {
    if points.len() < 3 {
        return;
    }
    // On a line all vertices span 4 eps times their reach at most.
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

/// Keeps the two ends of an outline that is all one line.
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

//! Where two projected features overlap: the vertices of the intersection, each
//! once, in order, by name.

use glam::DVec2;

use super::PlanePoint;
use super::clip::{Clip, Vertex};
use super::outline::{Outline, Part};

/// Buffers.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    clip: Clip,
    named: Vec<Named>,
}

/// A vertex of the intersection, by what of A and of B makes it.
#[derive(Clone, Copy, Debug)]
struct Named {
    at: DVec2,
    a: Part,
    b: Part,
}

impl Named {
    /// A's corner names a point, else B's, else the crossing.
    fn rank(&self) -> (u8, Part, Part) {
        let kind = match (self.a, self.b) {
            (Part::Corner(_), _) => 0,
            (_, Part::Corner(_)) => 1,
            _ => 2,
        };
        (kind, self.a, self.b)
    }
}

/// Appends the vertices of the intersection, anticlockwise from the first that
/// is a corner of A's or else on A's first side; none where the
/// projections miss each other by more than `eps`.
pub(super) fn find(
    a: &mut Outline,
    b: &mut Outline,
    eps: f64,
    scratch: &mut Scratch,
    points: &mut Vec<PlanePoint>,
) {
    let Scratch { clip, named } = scratch;
    named.clear();
    if b.corners.len() > 2 {
        b.set_sides();
        clip.clip(a, b, eps);
        named.extend(clip.kept.iter().map(|v| Named { at: v.at, a: v.own, b: v.other }));
    } else if a.corners.len() > 2 {
        a.set_sides();
        clip.clip(b, a, eps);
        named.extend(clip.kept.iter().map(|v| Named { at: v.at, a: coinciding(a, v, eps), b: v.own }));
    } else {
        a.set_sides();
        b.set_sides();
        thin(a, b, eps, named);
    }
    merge(named, eps);
    straighten(named, eps);
    if let Some(first) = (0..named.len()).min_by_key(|&i| (named[i].a, named[i].b)) {
        named.rotate_left(first);
    }
    points.extend(named.iter().map(|v| lift(a, b, v)));
}

/// A's part at a vertex of B's clipped outline: A's corner where one is there.
fn coinciding(a: &Outline, v: &Vertex, eps: f64) -> Part {
    let corner = a.corners.iter().position(|c| c.at.distance_squared(v.at) <= eps * eps);
    corner.map_or(v.other, |i| Part::Corner(i as u16))
}

/// Edges and vertices: corners within `eps` of the other feature; of two edges
/// that are not aligned the crossing.
fn thin(a: &Outline, b: &Outline, eps: f64, named: &mut Vec<Named>) {
    let crossing = crossing(a, b);
    if let Some((named_crossing, clear)) = &crossing
        && *clear > eps
    {
        return named.push(*named_crossing);
    }
    for (c, i) in a.corners.iter().zip(0..) {
        if touches(b, c.at, eps) {
            named.push(Named { at: c.at, a: Part::Corner(i), b: Part::Inside });
        }
    }
    for (c, j) in b.corners.iter().zip(0..) {
        if touches(a, c.at, eps) {
            named.push(Named { at: c.at, a: Part::Inside, b: Part::Corner(j) });
        }
    }
    if let (Some((named_crossing, _)), true) = (crossing, named.len() < 2) {
        named.clear();
        named.push(named_crossing);
    }
}

/// Where two edges cross, and how far the nearest end is from the other's line.
fn crossing(a: &Outline, b: &Outline) -> Option<(Named, f64)> {
    let (&[p, q], &[side_a], &[side_b]) = (a.corners.as_slice(), a.sides.as_slice(), b.sides.as_slice())
    else {
        return None;
    };
    let [a0, a1] = [p, q].map(|c| side_b.distance(c.at));
    let [b0, b1] = [0, 1].map(|j| side_a.distance(b.corners[j].at));
    let clear = a0.abs().min(a1.abs()).min(b0.abs()).min(b1.abs());
    let at = p.at + (a0 / (a0 - a1)) * (q.at - p.at);
    ((a0 > 0.0) != (a1 > 0.0) && (b0 > 0.0) != (b1 > 0.0))
        .then_some((Named { at, a: Part::Side(0), b: Part::Side(0) }, clear))
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

/// Of neighbours closer than `eps` keeps the one of the lowest rank.
fn merge(vertices: &mut Vec<Named>, eps: f64) {
    let mut i = 0;
    while vertices.len() > 1 && i < vertices.len() {
        let next = if i + 1 == vertices.len() { 0 } else { i + 1 };
        let (p, q) = (vertices[i], vertices[next]);
        if p.at.distance_squared(q.at) > eps * eps {
            i += 1;
        } else if q.rank() < p.rank() {
            vertices.remove(i);
        } else {
            vertices.remove(next);
            // A removed first vertex moves all others down.
            i -= usize::from(next < i);
        }
    }
}

/// Drops vertices closer than `eps` to the line between their neighbours; of an
/// outline that is all one line keeps the two ends.
fn straighten(vertices: &mut Vec<Named>, eps: f64) {
    if vertices.len() < 3 {
        return;
    }
    // On a line all vertices span 4 eps times their reach at most.
    let first = vertices[0].at;
    let (mut doubled_area, mut reach_squared) = (0.0, 0.0_f64);
    for pair in vertices.windows(2) {
        let (p, q) = (pair[0].at - first, pair[1].at - first);
        doubled_area += p.perp_dot(q);
        reach_squared = reach_squared.max(q.length_squared());
    }
    if doubled_area * doubled_area <= 64.0 * eps * eps * reach_squared {
        flatten(vertices, eps);
    }
    let mut i = 0;
    while vertices.len() > 2 && i < vertices.len() {
        let previous = vertices[if i == 0 { vertices.len() - 1 } else { i - 1 }].at;
        let next = vertices[if i + 1 == vertices.len() { 0 } else { i + 1 }].at;
        if aside(previous, vertices[i].at, next, eps) {
            i += 1;
        } else {
            vertices.remove(i);
        }
    }
}

/// Keeps the two ends of an outline that is all one line.
#[cold]
fn flatten(vertices: &mut Vec<Named>, eps: f64) {
    let farthest = |from: DVec2| {
        let distance = |i: &usize| vertices[*i].at.distance_squared(from);
        (0..vertices.len()).max_by(|i, j| distance(i).total_cmp(&distance(j)).then(j.cmp(i))).unwrap_or(0)
    };
    let first = farthest(vertices[0].at);
    let (p, q) = (vertices[first], vertices[farthest(vertices[first].at)]);
    if vertices.iter().all(|v| !aside(p.at, v.at, q.at, eps)) {
        vertices.clear();
        vertices.extend([p, q]);
    }
}

/// Whether `q` is farther than `eps` from the line through `p` and `r`.
fn aside(p: DVec2, q: DVec2, r: DVec2, eps: f64) -> bool {
    let area = (q - p).perp_dot(r - p);
    area * area > eps * eps * (r - p).length_squared()
}

/// The witnesses' heights over a vertex: along the hulls' own corners and sides
/// where these make it, else over the face.
fn lift(a: &Outline, b: &Outline, vertex: &Named) -> PlanePoint {
    PlanePoint {
        at: vertex.at,
        height_a: a.height(vertex.a, vertex.at),
        height_b: b.height(vertex.b, vertex.at),
        id: [a.named(vertex.a), b.named(vertex.b)],
    }
}

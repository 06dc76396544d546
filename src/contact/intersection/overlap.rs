//! Where two projected features overlap.
//!
//! The vertices of the intersection of two convex polygons are the corners of
//! each inside the other and the crossings of their sides. Two tables of signed
//! distances, corners of one against sides of the other, decide all three; a
//! crossing too near a corner to be told from it is that corner, found by the
//! inclusive inside test, so that no rounding loses a vertex.

use glam::DVec2;

use super::PlanePoint;
use super::outline::{Corner, Outline};
use crate::contact::manifold::Element;

/// Buffers.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Corner `i` of A against side `j` of B at `i * sides + j`, positive inside.
    a_in_b: Vec<f64>,
    b_in_a: Vec<f64>,
    chain: Vec<PlanePoint>,
}

/// Appends the vertices of the intersection, anticlockwise; none where the
/// projections miss each other by more than `eps`.
pub(super) fn find(a: &Outline, b: &Outline, eps: f64, scratch: &mut Scratch, points: &mut Vec<PlanePoint>) {
    if a.corners.len() == 2 && b.corners.len() == 2 {
        edge_on_edge(a, b, eps, points);
    } else {
        distances(a, b, &mut scratch.a_in_b);
        distances(b, a, &mut scratch.b_in_a);
        corners_inside(a, b, &scratch.a_in_b, eps, points, |c, height| PlanePoint {
            at: c.at,
            height_a: c.height,
            height_b: height,
            id: [Element::Vertex(c.vertex), Element::Inside],
        });
        corners_inside(b, a, &scratch.b_in_a, eps, points, |c, height| PlanePoint {
            at: c.at,
            height_a: height,
            height_b: c.height,
            id: [Element::Inside, Element::Vertex(c.vertex)],
        });
        crossings(a, b, scratch, points);
    }
    merge(points, eps);
    convex_order(points, eps, &mut scratch.chain);
}

/// Signed distances of the corners of `of` from the side lines of `to`.
fn distances(of: &Outline, to: &Outline, table: &mut Vec<f64>) {
    table.clear();
    for c in &of.corners {
        for j in 0..to.sides() {
            let [p, q] = to.side(j).map(|c| c.at);
            table.push((q - p).perp_dot(c.at - p) / (q - p).length());
        }
    }
}

/// Appends the corners of `of` that are inside `to`, with `to`'s height there.
fn corners_inside(
    of: &Outline,
    to: &Outline,
    table: &[f64],
    eps: f64,
    points: &mut Vec<PlanePoint>,
    point: impl Fn(&Corner, f64) -> PlanePoint,
) {
    let sides = to.sides();
    for (i, c) in of.corners.iter().enumerate() {
        let row = &table[i * sides..(i + 1) * sides];
        let inside = match to.corners.as_slice() {
            [only] => only.at.distance(c.at) <= eps,
            [p, q] => on_segment(c.at, p.at, q.at, row[0], eps),
            // A side of no length (NaN) bounds nothing.
            _ => !row.iter().any(|&d| d < -eps),
        };
        if inside {
            points.push(point(c, to.height(c.at)));
        }
    }
}

fn on_segment(at: DVec2, p: DVec2, q: DVec2, from_line: f64, eps: f64) -> bool {
    let length = p.distance(q);
    if !(length > eps) {
        return at.distance(p) <= eps || at.distance(q) <= eps;
    }
    let along = (at - p).dot(q - p) / length;
    from_line.abs() <= eps && along >= -eps && along <= length + eps
}

/// Appends the proper crossings of sides.
fn crossings(a: &Outline, b: &Outline, scratch: &Scratch, points: &mut Vec<PlanePoint>) {
    let (sides_a, sides_b) = (a.sides(), b.sides());
    for i in 0..sides_a {
        let next_i = (i + 1) % a.corners.len();
        for j in 0..sides_b {
            let (a0, a1) = (scratch.a_in_b[i * sides_b + j], scratch.a_in_b[next_i * sides_b + j]);
            if (a0 > 0.0) == (a1 > 0.0) {
                continue;
            }
            let next_j = (j + 1) % b.corners.len();
            let (b0, b1) = (scratch.b_in_a[j * sides_a + i], scratch.b_in_a[next_j * sides_a + i]);
            if (b0 > 0.0) != (b1 > 0.0) {
                points.push(crossing(a, i, a0 / (a0 - a1), b, j, b0 / (b0 - b1)));
            }
        }
    }
}

fn crossing(a: &Outline, i: usize, share_a: f64, b: &Outline, j: usize, share_b: f64) -> PlanePoint {
    let ([a0, a1], [b0, b1]) = (a.side(i), b.side(j));
    let mix = |p: f64, q: f64, share: f64| p + share * (q - p);
    PlanePoint {
        at: a0.at + share_a * (a1.at - a0.at),
        height_a: mix(a0.height, a1.height, share_a),
        height_b: mix(b0.height, b1.height, share_b),
        id: [a.side_id(i), b.side_id(j)],
    }
}

/// Two edges: the ends of their overlap where both lie on the other's line, else
/// the crossing.
fn edge_on_edge(a: &Outline, b: &Outline, eps: f64, points: &mut Vec<PlanePoint>) {
    let mut table = [[0.0; 2]; 2];
    let ends = [(a, b), (b, a)];
    let on_line = |of: &Outline, to: &Outline| {
        let [p, q] = to.side(0).map(|c| c.at);
        let length = (q - p).length();
        of.side(0).map(|c| if length > 0.0 { (q - p).perp_dot(c.at - p) / length } else { 0.0 })
    };
    for (row, (of, to)) in table.iter_mut().zip(ends) {
        *row = on_line(of, to);
    }
    let [[a0, a1], [b0, b1]] = table;
    for (side, (of, to)) in ends.into_iter().enumerate() {
        for (c, &from_line) in of.corners.iter().zip(&table[side]) {
            if on_segment(c.at, to.corners[0].at, to.corners[1].at, from_line, eps) {
                let other = to.height(c.at);
                let (height_a, height_b) = if side == 0 { (c.height, other) } else { (other, c.height) };
                let named = Element::Vertex(c.vertex);
                let id = if side == 0 { [named, Element::Inside] } else { [Element::Inside, named] };
                points.push(PlanePoint { at: c.at, height_a, height_b, id });
            }
        }
    }
    let proper = (a0 > 0.0) != (a1 > 0.0) && (b0 > 0.0) != (b1 > 0.0);
    if proper && points.len() < 2 {
        points.clear();
        points.push(crossing(a, 0, a0 / (a0 - a1), b, 0, b0 / (b0 - b1)));
    }
}

/// Of points closer than `eps` keeps A's corner, else B's, else the crossing
/// with the lowest id.
fn merge(points: &mut Vec<PlanePoint>, eps: f64) {
    let rank = |p: &PlanePoint| match p.id {
        [Element::Vertex(_), _] => 0,
        [_, Element::Vertex(_)] => 1,
        _ => 2,
    };
    points.sort_unstable_by(|p, q| {
        p.at.x.total_cmp(&q.at.x).then(p.at.y.total_cmp(&q.at.y)).then(p.id.cmp(&q.id))
    });
    let mut i = 0;
    while i < points.len() {
        let p = points[i];
        let near = (i + 1..points.len())
            .take_while(|&j| points[j].at.x - p.at.x <= eps)
            .find(|&j| points[j].at.distance(p.at) <= eps);
        match near {
            Some(j) if (rank(&points[j]), points[j].id) < (rank(&p), p.id) => {
                points.remove(i);
            }
            Some(j) => {
                points.remove(j);
            }
            None => i += 1,
        }
    }
}

/// Orders points, sorted by `x`, as the convex polygon they are (Andrew's
/// monotone chain), without those closer than `eps` to the line between their
/// neighbours.
fn convex_order(points: &mut Vec<PlanePoint>, eps: f64, chain: &mut Vec<PlanePoint>) {
    if points.len() < 3 {
        return;
    }
    chain.clear();
    for pass in 0..2 {
        let start = chain.len();
        for i in 0..points.len() {
            let p = if pass == 0 { points[i] } else { points[points.len() - 1 - i] };
            while chain.len() >= start + 2
                && !turns_left(&chain[chain.len() - 2], &chain[chain.len() - 1], &p, eps)
            {
                chain.pop();
            }
            chain.push(p);
        }
        // The last point starts the other pass, or closes the polygon.
        chain.pop();
    }
    std::mem::swap(points, chain);
}

/// Whether `q` lies right of the line from `p` to `r` by more than `eps`.
fn turns_left(p: &PlanePoint, q: &PlanePoint, r: &PlanePoint, eps: f64) -> bool {
    (q.at - p.at).perp_dot(r.at - p.at) > eps * (r.at - p.at).length()
}

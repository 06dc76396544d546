//! Where two projected features overlap.
//!
//! The vertices of the intersection of two convex polygons are the corners of
//! each inside the other and the crossings of their sides. Two tables of signed
//! distances, corners of one from sides of the other, decide all three; a
//! crossing too near a corner to be told from it is that corner, found by the
//! inclusive inside test, so that no rounding loses a vertex.

use glam::DVec2;

use super::PlanePoint;
use super::outline::{Outline, Part};

/// Buffers.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Corner `i` of A from side `j` of B at `i * sides + j`, positive inside.
    a_from_b: Vec<f64>,
    b_from_a: Vec<f64>,
    vertices: Vec<Vertex>,
    chain: Vec<Vertex>,
}

/// A vertex of the intersection, by what makes it.
#[derive(Clone, Copy, Debug)]
struct Vertex {
    at: DVec2,
    a: Part,
    b: Part,
}

impl Vertex {
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

/// Appends the vertices of the intersection, anticlockwise; none where the
/// projections miss each other by more than `eps`.
pub(super) fn find(a: &Outline, b: &Outline, eps: f64, scratch: &mut Scratch, points: &mut Vec<PlanePoint>) {
    let Scratch { a_from_b, b_from_a, vertices, chain } = scratch;
    distances(a, b, a_from_b);
    distances(b, a, b_from_a);
    vertices.clear();
    corners_inside(a, b, a_from_b, eps, |i, at| {
        vertices.push(Vertex { at, a: Part::Corner(i), b: Part::Inside })
    });
    corners_inside(b, a, b_from_a, eps, |j, at| {
        vertices.push(Vertex { at, a: Part::Inside, b: Part::Corner(j) })
    });
    let aligned = a.corners.len() == 2 && b.corners.len() == 2 && vertices.len() >= 2;
    if !aligned {
        each_crossing(a, b, a_from_b, b_from_a, |i, j, at| {
            vertices.push(Vertex { at, a: Part::Side(i), b: Part::Side(j) });
        });
    }
    merge(vertices, eps);
    convex_order(vertices, eps, chain);
    points.extend(vertices.iter().map(|v| lift(a, b, v)));
}

/// Signed distances of the corners of `of` from the side lines of `to`.
fn distances(of: &Outline, to: &Outline, table: &mut Vec<f64>) {
    table.clear();
    for c in &of.corners {
        table.extend(to.sides.iter().map(|side| side.distance(c.at)));
    }
}

/// The corners of `of` that are inside `to`.
fn corners_inside(of: &Outline, to: &Outline, table: &[f64], eps: f64, mut visit: impl FnMut(u16, DVec2)) {
    let sides = to.sides.len();
    for (i, c) in of.corners.iter().enumerate() {
        let row = &table[i * sides..(i + 1) * sides];
        let inside = match to.corners.as_slice() {
            [only] => only.at.distance(c.at) <= eps,
            [p, q] => on_segment(c.at, p.at, q.at, row[0], eps),
            // A side of no length (NaN) bounds nothing: it is never the smaller.
            _ => row.iter().fold(f64::INFINITY, |least, &d| if d < least { d } else { least }) >= -eps,
        };
        if inside {
            visit(i as u16, c.at);
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

/// The proper crossings of sides.
fn each_crossing(
    a: &Outline,
    b: &Outline,
    a_from_b: &[f64],
    b_from_a: &[f64],
    mut visit: impl FnMut(u16, u16, DVec2),
) {
    let (sides_a, sides_b) = (a.sides.len(), b.sides.len());
    for i in 0..sides_a {
        let next_i = a.next(i);
        let (row, next_row) = (&a_from_b[i * sides_b..], &a_from_b[next_i * sides_b..]);
        for j in 0..sides_b {
            let (a0, a1) = (row[j], next_row[j]);
            let (b0, b1) = (b_from_a[j * sides_a + i], b_from_a[b.next(j) * sides_a + i]);
            // One branch, since each half of it is anyone's guess.
            if ((a0 > 0.0) != (a1 > 0.0)) & ((b0 > 0.0) != (b1 > 0.0)) {
                let [p, q] = [a.corners[i].at, a.corners[next_i].at];
                visit(i as u16, j as u16, p + (a0 / (a0 - a1)) * (q - p));
            }
        }
    }
}

/// Of vertices closer than `eps` keeps the one of the lowest rank. Leaves them
/// sorted by place.
fn merge(vertices: &mut Vec<Vertex>, eps: f64) {
    vertices.sort_unstable_by(|p, q| {
        p.at.x.total_cmp(&q.at.x).then(p.at.y.total_cmp(&q.at.y)).then_with(|| p.rank().cmp(&q.rank()))
    });
    let mut i = 0;
    while i < vertices.len() {
        let p = vertices[i];
        let near = (i + 1..vertices.len())
            .take_while(|&j| vertices[j].at.x - p.at.x <= eps)
            .find(|&j| vertices[j].at.distance_squared(p.at) <= eps * eps);
        match near {
            Some(j) if vertices[j].rank() < p.rank() => drop(vertices.remove(i)),
            Some(j) => drop(vertices.remove(j)),
            None => i += 1,
        }
    }
}

/// Orders vertices, sorted by place, as the convex polygon they are (Andrew's
/// monotone chain), without those closer than `eps` to the line between their
/// neighbours.
fn convex_order(vertices: &mut Vec<Vertex>, eps: f64, chain: &mut Vec<Vertex>) {
    if vertices.len() < 3 {
        return;
    }
    chain.clear();
    let mut walk = |points: &mut dyn Iterator<Item = &Vertex>| {
        let start = chain.len();
        for p in points {
            while chain.len() >= start + 2
                && !turns_left(chain[chain.len() - 2].at, chain[chain.len() - 1].at, p.at, eps)
            {
                chain.pop();
            }
            chain.push(*p);
        }
        // The last point starts the other half.
        chain.pop();
    };
    walk(&mut vertices.iter());
    walk(&mut vertices.iter().rev());
    std::mem::swap(vertices, chain);
}

/// Whether `q` lies right of the line from `p` to `r` by more than `eps`.
fn turns_left(p: DVec2, q: DVec2, r: DVec2, eps: f64) -> bool {
    let area = (q - p).perp_dot(r - p);
    area > 0.0 && area * area > eps * eps * (r - p).length_squared()
}

/// The witnesses' heights over a vertex: along the hulls' own corners and sides
/// where these make it, else over the face.
fn lift(a: &Outline, b: &Outline, vertex: &Vertex) -> PlanePoint {
    PlanePoint {
        at: vertex.at,
        height_a: a.height(vertex.a, vertex.at),
        height_b: b.height(vertex.b, vertex.at),
        id: [a.named(vertex.a), b.named(vertex.b)],
    }
}

//! The estimated point where two projected features miss each other.

use glam::DVec2;

use super::PlanePoint;
use super::outline::Outline;
use crate::contact::manifold::Element;

/// A pair of nearest points: on A, on B, what they lie on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Near {
    a: DVec2,
    b: DVec2,
    height_a: f64,
    height_b: f64,
    id: [Element; 2],
}

/// The point midway between the closest points of both projections (the middle
/// of the closest set where it is not unique), each lifted to its own feature, and
/// how far apart the projections are.
pub(super) fn estimate(a: &Outline, b: &Outline, eps: f64, nearest: &mut Vec<Near>) -> (PlanePoint, f64) {
    nearest.clear();
    let mut least = f64::INFINITY;
    each_pair(a, b, |near| {
        let distance = near.a.distance(near.b);
        if distance < least - eps {
            nearest.clear();
        }
        if distance <= least + eps {
            nearest.push(near);
        }
        least = least.min(distance);
    });
    nearest.retain(|near| near.a.distance(near.b) <= least + eps);
    // Of several equally near pairs the two ends of the closest set.
    let across = nearest.first().map_or(DVec2::X, |near| (near.b - near.a).perp());
    let key = |near: &&Near| across.dot(near.a + near.b);
    let first = nearest.iter().min_by(|p, q| key(p).total_cmp(&key(q)));
    let last = nearest.iter().max_by(|p, q| key(p).total_cmp(&key(q)));
    let point = match (first, last) {
        (Some(p), Some(q)) => PlanePoint {
            at: 0.25 * (p.a + p.b + q.a + q.b),
            height_a: 0.5 * (p.height_a + q.height_a),
            height_b: 0.5 * (p.height_b + q.height_b),
            id: p.id.min(q.id),
        },
        _ => PlanePoint {
            at: 0.5 * (a.corners[0].at + b.corners[0].at),
            height_a: a.corners[0].height,
            height_b: b.corners[0].height,
            id: [Element::Vertex(a.corners[0].vertex), Element::Vertex(b.corners[0].vertex)],
        },
    };
    (point, least)
}

/// Each corner of one with its nearest point of each side (or of the corner) of
/// the other.
fn each_pair(a: &Outline, b: &Outline, mut visit: impl FnMut(Near)) {
    for c in &a.corners {
        each_nearest(b, c.at, |at, height, id| {
            let id = [Element::Vertex(c.vertex), id];
            visit(Near { a: c.at, b: at, height_a: c.height, height_b: height, id });
        });
    }
    for c in &b.corners {
        each_nearest(a, c.at, |at, height, id| {
            let id = [id, Element::Vertex(c.vertex)];
            visit(Near { a: at, b: c.at, height_a: height, height_b: c.height, id });
        });
    }
}

fn each_nearest(outline: &Outline, from: DVec2, mut visit: impl FnMut(DVec2, f64, Element)) {
    if let [only] = outline.corners.as_slice() {
        visit(only.at, only.height, Element::Vertex(only.vertex));
    }
    for i in 0..outline.side_count() {
        let [p, q] = outline.side(i);
        let whole = q.at - p.at;
        let share = ((from - p.at).dot(whole) / whole.length_squared()).clamp(0.0, 1.0);
        if !(share > 0.0) {
            visit(p.at, p.height, Element::Vertex(p.vertex));
        } else if share < 1.0 {
            visit(p.at + share * whole, p.height + share * (q.height - p.height), outline.side_name(i));
        } else {
            visit(q.at, q.height, Element::Vertex(q.vertex));
        }
    }
}

//! How far a point is from the hull of a set of points at most, as GJK finds it
//! (E. G. Gilbert, D. W. Johnson and S. S. Keerthi, *A fast procedure for computing the distance
//! between complex objects in three-dimensional space*, 1988, section 4, doi:10.1109/56.2083).
//!
//! The search keeps the point of the hull that is nearest so far, and at most four points of
//! the set whose hull holds it. It asks the set for the point farthest along the way to the
//! target, adds it to the four, and looks for the nearest point again. Every nearest point is a
//! point of the hull, so the distance to it is an upper bound, even if rounding ends the search
//! early. It takes some ten steps; each asks the set once.

use glam::DVec3;

use super::points::{Added, PointTree};
use crate::contact::stop::{Meter, Stopped};
use crate::contact::tolerance::{DISTANCE_ITERATIONS, NOISE, U};

/// Steps of finding the nearest point of a simplex.
const SIMPLEX: u64 = 250;

/// An upper bound of the distance of `target` from the hull of the points in the tree, hull
/// units.
pub(super) fn distance(target: DVec3, points: &PointTree, meter: &Meter<'_>) -> Result<f64, Stopped> {
    let mut simplex = Corners::default().with(points.first());
    let mut known = None;
    let mut shortest = f64::INFINITY;
    for _ in 0..DISTANCE_ITERATIONS {
        meter.spend(SIMPLEX)?;
        let (nearest, kept) = nearest(target, &simplex, known);
        let away = target - nearest;
        // Less would be rounding: the bound is what was reached.
        if !(away.length() < shortest * (1.0 - NOISE * U)) {
            break;
        }
        shortest = away.length();
        let next = points.farthest_along(away, kept.points(), meter)?;
        if away.dot(next.point) <= away.dot(nearest) || kept.has(next) {
            break;
        }
        // Of three points that were four the nearest point may be another.
        known = (!kept.surround).then_some(nearest);
        simplex = kept.with(next);
    }
    // Points are within 1 of the centre, weights sum to 1 within rounding.
    Ok(shortest + NOISE * U)
}

/// At most four points.
#[derive(Clone, Copy, Default)]
struct Corners {
    points: [Added; 4],
    len: usize,
    /// They are three of four that surround the target.
    surround: bool,
}

impl Corners {
    fn points(&self) -> &[Added] {
        &self.points[..self.len]
    }

    fn has(&self, p: Added) -> bool {
        self.points().iter().any(|corner| corner.point == p.point)
    }

    /// With another, of at most three.
    fn with(mut self, p: Added) -> Self {
        self.points[self.len] = p;
        self.len += 1;
        self.surround = false;
        self
    }
}

/// The point of the hull of some points that is nearest to `target`, and those whose hull it
/// is in. `known` is the nearest point of all but the last of the points, of whose hull each
/// holds a part: then only the faces with the last are looked at.
fn nearest(target: DVec3, simplex: &Corners, known: Option<DVec3>) -> (DVec3, Corners) {
    let all = 1_u32 << simplex.len;
    let (first, mut nearest, mut holder) = match known {
        Some(known) => (all / 2, known, all / 2 - 1),
        None => (1, simplex.points[0].point, 1),
    };
    let mut shortest = nearest.distance_squared(target);
    // The faces of every dimension.
    for face in first..all {
        let (mut corners, mut len) = ([DVec3::ZERO; 4], 0);
        for (i, corner) in simplex.points().iter().enumerate() {
            if face >> i & 1 == 1 {
                corners[len] = corner.point;
                len += 1;
            }
        }
        if let Some(foot) = foot(target, &corners[..len])
            && foot.distance_squared(target) < shortest
        {
            (nearest, shortest, holder) = (foot, foot.distance_squared(target), face);
        }
    }
    let mut kept = Corners::default();
    for (i, &corner) in simplex.points().iter().enumerate() {
        if holder >> i & 1 == 1 && kept.len < 3 {
            kept = kept.with(corner);
        }
    }
    // Four points that surround the target leave no room for a fifth, and need none.
    kept.surround = holder == 0b1111;
    (nearest, kept)
}

/// The foot of the perpendicular from `target`, where it is inside; of four points `target`
/// itself, where they surround it. Whatever rounding does to the weights, they are not
/// negative and sum to 1: the foot is a point of the hull.
fn foot(target: DVec3, corners: &[DVec3]) -> Option<DVec3> {
    let weights = match *corners {
        [_] => [1.0, 0.0, 0.0, 0.0],
        [a, b] => {
            let ab = b - a;
            let t = (target - a).dot(ab) / ab.length_squared();
            [1.0 - t, t, 0.0, 0.0]
        }
        [a, b, c] => {
            let n = (b - a).cross(c - a);
            let (at, bt, ct) = (a - target, b - target, c - target);
            let parts = [n.dot(bt.cross(ct)), n.dot(ct.cross(at)), n.dot(at.cross(bt))];
            // Outside, even if the division underflows: most triangles end here.
            if parts.iter().any(|&part| part < -f64::MIN_POSITIVE) {
                return None;
            }
            let [u, v, w] = parts.map(|part| part / n.length_squared());
            [u, v, w, 0.0]
        }
        [a, b, c, d] => {
            let volume = |p: DVec3, q: DVec3, r: DVec3, s: DVec3| (q - p).cross(r - p).dot(s - p);
            let whole = volume(a, b, c, d);
            let parts = [
                volume(target, b, c, d),
                volume(a, target, c, d),
                volume(a, b, target, d),
                volume(a, b, c, target),
            ];
            parts.map(|part| part / whole)
        }
        _ => return None,
    };
    let sum: f64 = weights.iter().sum();
    let inside = weights.iter().all(|&w| w >= 0.0) && sum > 0.0 && sum.is_finite();
    inside.then(|| corners.iter().zip(&weights).map(|(&p, &w)| p * (w / sum)).sum())
}

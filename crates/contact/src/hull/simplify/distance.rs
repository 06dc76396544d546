//! An upper bound of the distance between a point (the *target*) and the hull of a set of points,
//! by GJK (E. G. Gilbert, D. W. Johnson and S. S. Keerthi, *A fast procedure for computing the
//! distance between complex objects in three-dimensional space*, 1988, section 4,
//! doi:10.1109/56.2083).
//!
//! ```text
//! simplex = [any point of the set]
//! repeat:
//!     nearest = the point of the hull of `simplex` that is nearest to the target
//!     reduce `simplex` to the corners whose hull contains `nearest`
//!     next = the point of the set that is farthest along target - nearest
//!     stop if `next` is no farther along than `nearest`; otherwise add it to `simplex`
//! ```
//!
//! The simplex has at most four points. Every `nearest` is a point of the hull of the set, so the
//! distance to it is an upper bound, even if rounding ends the search early. A search takes about
//! ten rounds, and each round asks the set one question.

use glam::DVec3;

use super::points::{Added, Guess, PointTree};
use crate::stop::{Meter, Stopped};
use crate::tolerance::{DISTANCE_ITERATIONS, NOISE, U};

/// Steps to find the nearest point of a simplex.
const SIMPLEX: u64 = 250;

/// The answers that a search got in its first rounds, one per round. The next search for the same
/// target asks similar questions and starts from these answers.
pub(super) type Trace = [Guess; 12];

/// An upper bound of the distance of `target` from the hull of the points in the tree; hull units.
pub(super) fn distance(
    target: DVec3,
    points: &PointTree,
    trace: &mut Trace,
    meter: &Meter<'_>,
) -> Result<f64, Stopped> {
    let mut steps = 0;
    let mut simplex = Corners::default().with(points.first());
    let mut known = None;
    let mut shortest = f64::INFINITY;
    for _ in 0..DISTANCE_ITERATIONS {
        meter.spend(SIMPLEX)?;
        let (nearest, kept) = nearest(target, &simplex, known);
        let away = target - nearest;
        // A smaller improvement is rounding. The shortest distance so far is the bound.
        if !(away.length() < shortest * (1.0 - NOISE * U)) {
            break;
        }
        shortest = away.length();
        let next = points.farthest_along(away, kept.points(), &mut trace[steps], meter)?;
        steps = (steps + 1).min(trace.len() - 1);
        if away.dot(next.point) <= away.dot(nearest) || kept.has(next) {
            break;
        }
        // If the simplex was reduced from four points that surround the target to three, the
        // nearest point of the three is not known.
        known = (!kept.surround).then_some(nearest);
        simplex = kept.with(next);
    }
    // The points are within 1 of the contraction point and the weights sum to 1 up to rounding,
    // which this allowance covers.
    Ok(shortest + NOISE * U)
}

/// A simplex: at most four points of the set.
#[derive(Clone, Copy, Default)]
struct Corners {
    points: [Added; 4],
    len: usize,
    /// Whether these are three of four points that surround the target.
    surround: bool,
}

impl Corners {
    fn points(&self) -> &[Added] {
        &self.points[..self.len]
    }

    fn has(&self, p: Added) -> bool {
        self.points().iter().any(|corner| corner.point == p.point)
    }

    /// Adds a point to at most three others.
    fn with(mut self, p: Added) -> Self {
        self.points[self.len] = p;
        self.len += 1;
        self.surround = false;
        self
    }
}

/// The point of the hull of the simplex that is nearest to `target`, and the corners whose hull
/// contains it.
///
/// `known`, if present, is the nearest point of the hull of all corners but the last, and is not in
/// the hull of fewer of them. Then only the faces with the last corner are examined.
fn nearest(target: DVec3, simplex: &Corners, known: Option<DVec3>) -> (DVec3, Corners) {
    let all = 1_u32 << simplex.len;
    let (first, mut nearest, mut holder) = match known {
        Some(known) => (all / 2, known, all / 2 - 1),
        None => (1, simplex.points[0].point, 1),
    };
    let mut shortest = nearest.distance_squared(target);
    // The faces of every dimension: bit `i` of `face` says whether corner `i` belongs to it.
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
    // If four points surround the target, the distance is 0. Three of them are kept, since the
    // simplex has no place for a fifth point.
    kept.surround = holder == 0b1111;
    (nearest, kept)
}

/// The foot of the perpendicular from `target` to the span of the corners, or `None` if the foot is
/// outside their hull. For four corners that surround `target`, the foot is `target` itself.
///
/// The foot is computed as a mixture of the corners with weights that are not negative and sum to
/// 1. So it is a point of the hull, however the weights are rounded.
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
            // Certainly outside, even if the division below would underflow. Most triangles end
            // here.
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

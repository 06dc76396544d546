//! Decides whether the distance between two hulls exceeds the margin, with the GJK algorithm
//! (E. G. Gilbert, D. W. Johnson and S. S. Keerthi, *A fast procedure for computing the distance
//! between complex objects in three-dimensional space*, 1988, section 4, doi:10.1109/56.2083).
//!
//! Growth distance leaves this open for some pairs. Its normal is not the direction of the shortest
//! distance, so a flat hull can be near along the normal and still be far away.
//!
//! The distance between the hulls is the distance of the centre offset `d` from `K`. GJK keeps a
//! simplex of at most four vertices of `K` and moves it towards `d`:
//!
//! ```text
//! loop:
//!     v = from the point of the simplex closest to d, to d
//!     |v| is within the margin: Within
//!     w = vertex of K farthest along v
//!     the plane through w across v separates d from K by more than the margin: Beyond
//!     w is no progress: repeat in wide arithmetic; there, decide by the bracket of the distance
//!     add w to the simplex
//! ```
//!
//! `|v|` is an upper bound of the distance, and the plane through `w` gives a lower one. Each round
//! costs one support call of each hull. The number of rounds is limited, and a query that reaches
//! the limit is answered Unknown instead of with a guess.

use glam::DVec3;

use super::growth::{Cost, separates};
use super::pair::{Pair, Support};
use super::simplex::Simplex;
use super::tolerance::{DISTANCE_ITERATIONS, STALL};

/// How the distance compares with the margin.
pub(crate) enum Decision {
    /// Within the margin, or so near to it that rounding leaves the answer open.
    Within,
    /// Beyond the margin: a direction that certifies it, with its support point.
    Beyond(DVec3, Support),
    /// The iteration limit was reached, or the search stalled, before the distance was known.
    Unknown,
}

/// Decides whether the pair is within `margin` (pair units). The search starts from the vertices of
/// `seeds`.
pub(crate) fn decide(pair: &Pair<'_>, seeds: &[Support], margin: f64, cost: &mut Cost) -> Decision {
    let band = pair.rounding_band();
    let mut simplex = Simplex::from_points(seeds);
    let (mut shortest, mut farthest, mut stalled) = (f64::INFINITY, f64::NEG_INFINITY, 0);
    // Between hulls that nearly touch, the computed direction is mostly rounding. So is the test
    // whether four points surround d, and the distance of a thin triangle. From the first such
    // case on, the simplex is reduced in wide arithmetic.
    let mut wide = false;
    for _ in 0..DISTANCE_ITERATIONS {
        // From the nearest known point of K to d, which is a direction from A to B.
        let away = if wide { -simplex.wide_closest_to(pair.d) } else { -simplex.closest_to(pair.d) };
        let distance = away.length();
        let within = distance <= margin + band;
        if !wide && (simplex.is_full() || (within && simplex.is_thin())) {
            (wide, shortest, stalled) = (true, f64::INFINITY, 0);
            continue;
        }
        if within {
            return Decision::Within;
        }
        let w = pair.support(away);
        cost.iterations += 1;
        cost.support_calls += 2;
        if separates(pair, away, &w, margin) {
            return Decision::Beyond(away, w);
        }
        let lower = (away.dot(pair.d) - away.dot(w.point)) / distance;
        stalled = if distance < shortest || lower > farthest { 0 } else { stalled + 1 };
        (shortest, farthest) = (shortest.min(distance), farthest.max(lower));
        let stuck = simplex.contains(&w) || stalled >= STALL;
        if stuck && wide {
            // The simplex is optimal to rounding, and the bracket lies on neither side of the band.
            return if shortest - farthest <= band { Decision::Within } else { Decision::Unknown };
        }
        if stuck {
            // The rounded distance of a thin triangle may be far too short. No distance measured in
            // wide arithmetic would be less, so forget it.
            (wide, shortest, stalled) = (true, f64::INFINITY, 0);
        } else {
            simplex.push(w);
        }
    }
    Decision::Unknown
}

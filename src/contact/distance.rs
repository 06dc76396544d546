//! Whether the distance between two hulls exceeds the margin (GJK), for the
//! pairs that growth distance leaves open: its normal is not the direction of
//! the shortest distance, and a flat hull can be far away along the one and
//! near along the other.

use glam::DVec3;

use super::growth::{Cost, separates};
use super::pair::{Pair, Support};
use super::simplex::Simplex;
use super::tolerance::{DISTANCE_ITERATIONS, STALL};

/// What the distance says of the margin.
pub(crate) enum Decision {
    /// Within the margin, or so near to it that rounding cannot tell.
    Within,
    /// Beyond: a direction that certifies it, with its support point.
    Beyond(DVec3, Support),
    /// An iteration limit came first.
    Unknown,
}

/// Decides, starting from the vertices of `seeds`.
pub(crate) fn decide(pair: &Pair<'_>, seeds: &[Support], margin: f64, cost: &mut Cost) -> Decision {
    let band = pair.rounding_band();
    let mut simplex = Simplex::from_points(seeds);
    let (mut shortest, mut farthest, mut stalled) = (f64::INFINITY, f64::NEG_INFINITY, 0);
    // Between hulls that nearly touch the direction is mostly rounding, and so
    // is whether four points surround d, or how near a thin triangle is: wide
    // arithmetic from there on.
    let mut wide = false;
    for _ in 0..DISTANCE_ITERATIONS {
        // From the nearest known point of K to d, that is from A to B.
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
            // Optimal to rounding, and neither side of the band certain.
            return if shortest - farthest <= band { Decision::Within } else { Decision::Unknown };
        }
        if stuck {
            // Of a thin triangle the rounded distance may be far too short: what is
            // measured widely would never be less.
            (wide, shortest, stalled) = (true, f64::INFINITY, 0);
        } else {
            simplex.push(w);
        }
    }
    Decision::Unknown
}

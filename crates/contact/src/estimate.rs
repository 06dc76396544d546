//! The estimated cost of a pair in elementary steps ([`Stop`](super::Stop)), before the pair is computed.
//!
//! The estimate depends on the vertices and faces of the hulls, and is meant for a typical pair.

use super::ConvexHull;
use super::cost::{ITERATION, LOOK, MAPPED_CALL, PAIR, POINT, SIDE, scan_steps};

/// The number of iterations for a typical pair.
const ITERATIONS: u64 = 8;

/// The number of steps that a contact manifold of these two hulls typically takes. The service uses
/// it to size work units, and to charge a caller before the true number of steps is known.
///
/// ```
/// use hullcast_contact::{ConvexHull, estimated_steps};
///
/// let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
/// let small = ConvexHull::new(&corners)?;
/// assert!((100..10_000).contains(&estimated_steps(&small, &small)));
/// # Ok::<(), hullcast_contact::HullError>(())
/// ```
pub fn estimated_steps(a: &ConvexHull, b: &ConvexHull) -> u64 {
    let call = |hull: &ConvexHull| {
        if hull.support_map.is_some() { MAPPED_CALL } else { scan_steps(hull.vertex_count()) }
    };
    let sides = a.largest_face() as u64 + b.largest_face() as u64;
    PAIR + ITERATIONS * (ITERATION + call(a) + call(b)) + (SIDE + 2 * LOOK + POINT) * sides
}

//! What a pair costs, in elementary steps ([`Stop`](super::Stop)): estimated before it is
//! computed, and counted while it is.
//!
//! The estimate goes by the hulls' vertices and faces; it is what a typical pair takes. The
//! count goes by what was done: each support call counts the vertices that it looked at, and
//! each polygon its sides. It is kept in coarse places, so that counting takes no time that
//! can be measured.

use std::cell::Cell;

use super::ConvexHull;

/// Steps of a pair beside its support calls and polygons: its frame and its answer.
pub(crate) const PAIR: u64 = 200;
/// Steps of one iteration of a solver beside its support calls.
pub(crate) const ITERATION: u64 = 40;
/// Steps for each side of a projected feature.
pub(crate) const SIDE: u64 = 20;
/// Steps of measuring one vertex of a large polygon from a line, or one pair of a corner and a
/// side.
pub(crate) const LOOK: u64 = 5;
/// Steps of lifting, merging and writing one contact point.
pub(crate) const POINT: u64 = 30;
/// Iterations of a typical pair.
const ITERATIONS: u64 = 8;
/// Vertices that the support mapping looks at in one step.
const VERTICES_A_STEP: usize = 2;
/// Steps of a support call by the map of directions.
pub(crate) const MAPPED_CALL: u64 = 40;

/// Counts the steps of one pair.
#[derive(Debug, Default)]
pub(crate) struct Count(Cell<u64>);

impl Count {
    #[inline]
    pub(crate) fn add(&self, steps: u64) {
        self.0.set(self.0.get() + steps);
    }

    pub(crate) fn steps(&self) -> u64 {
        self.0.get()
    }
}

/// Steps of a support call that looks at all of so many vertices.
#[inline]
pub(crate) fn scan_steps(vertices: usize) -> u64 {
    4 + (vertices / VERTICES_A_STEP) as u64
}

/// The steps that a contact manifold of these hulls typically takes: for the sizes of work
/// units, and for the share of a caller before the true steps are known.
///
/// ```
/// use hullcast::contact::{ConvexHull, estimated_steps};
///
/// let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
/// let small = ConvexHull::new(&corners)?;
/// assert!((100..10_000).contains(&estimated_steps(&small, &small)));
/// # Ok::<(), hullcast::contact::HullError>(())
/// ```
pub fn estimated_steps(a: &ConvexHull, b: &ConvexHull) -> u64 {
    let call = |hull: &ConvexHull| {
        if hull.support_map.is_some() { MAPPED_CALL } else { scan_steps(hull.vertex_count()) }
    };
    let sides = a.largest_face() as u64 + b.largest_face() as u64;
    PAIR + ITERATIONS * (ITERATION + call(a) + call(b)) + (SIDE + 2 * LOOK + POINT) * sides
}

//! The cost of a pair in elementary steps ([`Stop`](super::Stop)), counted while the pair is computed.
//!
//! The count depends on the work that is done: each support call counts the vertices that it
//! evaluated, and each polygon counts its sides. Only a few coarse places count, so that counting
//! takes no measurable time.

use std::cell::Cell;

/// Steps per pair besides its support calls and polygons: setting up the frame and writing the
/// answer.
pub(crate) const PAIR: u64 = 200;
/// Steps per pair of boxes that is computed in lanes.
pub(crate) const LANE: u64 = 100;
/// Steps per iteration of a solver, besides its support calls.
pub(crate) const ITERATION: u64 = 40;
/// Steps per side of a projected feature.
pub(crate) const SIDE: u64 = 20;
/// Steps to measure the distance of one vertex of a large polygon from a line, or to compare one
/// corner with one side.
pub(crate) const LOOK: u64 = 5;
/// Steps to lift, merge and write one contact point.
pub(crate) const POINT: u64 = 30;
/// The number of vertices that the support mapping evaluates in one step.
const VERTICES_A_STEP: usize = 2;
/// Steps of a support call that uses the map of directions.
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

/// Steps of a support call that evaluates all vertices of a hull.
#[inline]
pub(crate) fn scan_steps(vertices: usize) -> u64 {
    4 + (vertices / VERTICES_A_STEP) as u64
}

//! Hulls being built on the compute threads.

use std::sync::Arc;

use super::HullDefinition;
use crate::{
    budget::Permit,
    compute::Parts,
    contact::{ConvexHull, HullError, Stop, Stopped},
};

/// Bytes that building takes at most for each point of a definition, the definition, its blob
/// and the hull among them. Measured: `building_takes_no_more_than_is_counted`.
const BYTES_PER_POINT: usize = 1 << 10;

/// Bytes that building takes for any definition.
const BYTES_PER_HULL: usize = 8 << 10;

/// Steps of building for each point of a definition.
const STEPS_PER_POINT: u64 = 3_000;

/// Steps of simplifying for each pair of points of a definition.
const SIMPLIFYING_STEPS: u64 = 500;

/// The most bytes that building a hull takes.
pub(super) fn building_bytes(definition: &HullDefinition) -> usize {
    BYTES_PER_HULL + BYTES_PER_POINT * definition.points.len()
}

/// Hulls to be built, each a part.
pub(super) struct Building {
    pub(super) definitions: Vec<HullDefinition>,
    pub(super) max_vertices: usize,
    pub(super) stop: Arc<Stop>,
    /// Given back with the definitions.
    pub(super) _memory: Permit,
}

impl Parts for Building {
    type Part = Result<ConvexHull, HullError>;
    type Whole = Vec<Self::Part>;

    fn count(&self) -> usize {
        self.definitions.len()
    }

    fn steps(&self, index: usize) -> u64 {
        let definition = &self.definitions[index];
        let points = definition.points.len() as u64;
        let simplifying = match definition.simplification {
            Some(_) => points.saturating_mul(points).saturating_mul(SIMPLIFYING_STEPS),
            None => 0,
        };
        simplifying.saturating_add(STEPS_PER_POINT * points)
    }

    fn part(&self, index: usize) -> Result<Self::Part, Stopped> {
        self.stop.spend(self.steps(index))?;
        Ok(self.definitions[index].build(self.max_vertices))
    }

    fn whole(&self, parts: Vec<Self::Part>) -> Result<Self::Whole, Stopped> {
        Ok(parts)
    }
}

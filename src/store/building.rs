//! Hulls being built on the compute threads.

use std::sync::{Arc, Mutex};

use super::HullDefinition;
use crate::{
    budget::Permit,
    compute::Parts,
    contact::{BuildError, ConvexHull, HullError, Stop, Stopped},
    lock::locked,
};

/// The most bytes that building takes per point of a definition, including the definition, its blob
/// and the hull. Measured by the test `building_takes_no_more_than_is_counted`.
const BYTES_PER_POINT: usize = 1280;

/// The bytes that building takes for any definition.
const BYTES_PER_HULL: usize = 2 << 10;

/// The steps of building, per point of a definition.
const STEPS_PER_POINT: u64 = 3_000;

/// The steps of simplifying, per pair of points of a definition.
const SIMPLIFYING_STEPS: u64 = 500;

/// The most bytes that building a hull of `points` points takes.
pub(crate) fn building_bytes(points: usize) -> usize {
    BYTES_PER_HULL + BYTES_PER_POINT * points
}

/// Hulls to be built; each is one part.
pub(super) struct BuildWork {
    pub(super) definitions: Vec<HullDefinition>,
    pub(super) max_vertices: usize,
    pub(super) stop: Arc<Stop>,
    /// Released before the caller receives the hulls, or when the work is dropped.
    pub(super) memory: Mutex<Option<Permit>>,
}

impl Parts for BuildWork {
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
        match self.definitions[index].build_stoppable(self.max_vertices, &self.stop) {
            Ok(hull) => Ok(Ok(hull)),
            Err(BuildError::Hull(error)) => Ok(Err(error)),
            Err(BuildError::Stopped) => Err(Stopped),
        }
    }

    fn whole(&self, parts: Vec<Self::Part>) -> Result<Self::Whole, Stopped> {
        drop(locked(&self.memory).take());
        Ok(parts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::Simplification;

    /// Points spread over a sphere, all of them extreme.
    fn sphere(count: usize) -> Vec<[f64; 3]> {
        let point = |i: usize| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
            let (sine, cosine) = (2.399_963_229_728_653 * i as f64).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            [radius * cosine, radius * sine, z]
        };
        (0..count).map(point).collect()
    }

    /// Catches hulls whose building takes more memory than is charged for it. The memory is the
    /// peak of building, and the definition twice: as points and as stored bytes.
    #[test]
    fn building_takes_no_more_than_is_counted() {
        // The corners of a prism with many sides.
        let prism = |count: usize| -> Vec<[f64; 3]> {
            (0..count)
                .map(|i| {
                    let angle = std::f64::consts::TAU * (i / 2) as f64 / (count / 2) as f64;
                    [angle.cos(), angle.sin(), (i % 2) as f64]
                })
                .collect()
        };
        let wanted = Simplification { max_vertices: Some(64), max_deviation: None };
        for (name, points, simplification) in [
            ("4 points", sphere(4), None),
            ("sphere of 100", sphere(100), None),
            ("sphere of 4000", sphere(4000), None),
            ("prism of 4000", prism(4000), None),
            ("sphere of 300, simplified", sphere(300), Some(wanted)),
        ] {
            let definition = HullDefinition { points, simplification, ..HullDefinition::default() };
            let made = allocation_counter::measure(|| {
                definition.build(usize::MAX).unwrap();
            });
            let stored = 2 * size_of_val(&definition.points[..]);
            let (peak, counted) = (made.bytes_max as usize + stored, building_bytes(definition.points.len()));
            assert!(peak <= counted, "{name}: {peak} of {counted}");
        }
    }
}

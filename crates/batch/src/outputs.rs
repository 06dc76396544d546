//! The parts of an answer that are computed and sent.

use hullcast_contact::Wanted;

/// A set of outputs. Outcomes and flags are always computed and sent; other outputs only if
/// requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outputs {
    /// The growth scale and its bracket.
    pub alpha: bool,
    /// The normal and the separation.
    pub normal: bool,
    /// Witnesses on A and distances.
    pub points: bool,
    /// Witnesses on B.
    pub witness_b: bool,
    /// The kinds and indices of the features, and the ids of the points.
    pub features: bool,
    /// The bases, from which the next query can start.
    pub bases: bool,
    /// Iterations, support calls, and the area kept by reduction.
    pub diagnostics: bool,
}

impl Outputs {
    /// Only outcomes and flags.
    pub const OUTCOME: Self = Self {
        alpha: false,
        normal: false,
        points: false,
        witness_b: false,
        features: false,
        bases: false,
        diagnostics: false,
    };

    /// Whether the answer has a column of points, and therefore point counts.
    pub fn any_points(self) -> bool {
        self.points || self.witness_b || self.features
    }

    /// The kind of result that the computation has to produce.
    pub fn wanted(self) -> Wanted {
        if self.any_points() {
            Wanted::Points
        } else if self.alpha || self.normal || self.bases {
            Wanted::Growth
        } else {
            Wanted::Outcome
        }
    }

    /// Bytes on the wire per pair, without its points.
    pub fn pair_bytes(self) -> usize {
        2 + 24 * usize::from(self.alpha)
            + 32 * usize::from(self.normal)
            + 4 * usize::from(self.any_points())
            + 18 * usize::from(self.features)
            + 24 * usize::from(self.bases)
            + 16 * usize::from(self.diagnostics)
    }

    /// Bytes on the wire per point.
    pub fn point_bytes(self) -> usize {
        32 * usize::from(self.points) + 24 * usize::from(self.witness_b) + 16 * usize::from(self.features)
    }
}

impl Default for Outputs {
    /// The outputs of a request that names none: growth scale, normal and points.
    fn default() -> Self {
        Self { alpha: true, normal: true, points: true, ..Self::OUTCOME }
    }
}

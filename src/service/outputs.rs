//! What of an answer is computed and sent.

use crate::contact::Wanted;

/// A set of outputs. Outcomes and flags always are; what is not asked for is
/// neither computed nor sent.
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
    /// Kinds and indices of the features, and the points' ids.
    pub features: bool,
    /// Bases, to start the next query from.
    pub bases: bool,
    /// Iterations, support calls and what reduction kept.
    pub diagnostics: bool,
}

impl Outputs {
    /// Outcomes and flags alone.
    pub const OUTCOME: Self = Self {
        alpha: false,
        normal: false,
        points: false,
        witness_b: false,
        features: false,
        bases: false,
        diagnostics: false,
    };

    /// Whether points are counted, for any column of theirs.
    pub fn any_points(self) -> bool {
        self.points || self.witness_b || self.features
    }

    /// How far the computation has to go.
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
    /// Growth scale, normal and points.
    fn default() -> Self {
        Self { alpha: true, normal: true, points: true, ..Self::OUTCOME }
    }
}

//! Why a cloud of points is not a hull.

use std::fmt;

use crate::contact::stop::Stopped;

/// Why a cloud of points is not a hull.
#[derive(Clone, Debug, PartialEq)]
pub struct HullError {
    /// The reason.
    pub kind: HullErrorKind,
    /// The point at fault, where one point is.
    pub index: Option<usize>,
    /// The value at fault, for people.
    pub detail: String,
}

/// The reasons.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HullErrorKind {
    /// Fewer than 4 distinct points.
    TooFewPoints,
    /// All points on one line.
    Collinear,
    /// All points in one plane.
    Coplanar,
    /// A coordinate is NaN or infinite.
    NotFinite,
    /// The largest extent is outside [1e-50, 1e50].
    SizeOutOfRange,
    /// The contraction point is on the surface, outside, or nearer to it than rounding.
    ContractionPointNotInside,
    /// More extreme vertices than the limit.
    TooManyVertices,
    /// The inradius is below 2^-37 of the circumradius: too thin for doubles.
    NotRepresentable,
    /// Simplification to fewer than 4 vertices, or by a deviation that is negative or NaN.
    SimplificationOutOfRange,
    /// No hull of so few vertices was found within the deviation.
    SimplificationNotPossible,
    /// The planarity is not a number from 0 to 0.01.
    PlanarityOutOfRange,
}

impl HullErrorKind {
    /// Stable, upper case: the reason on the wire.
    pub fn reason(self) -> &'static str {
        match self {
            Self::TooFewPoints => "TOO_FEW_POINTS",
            Self::Collinear => "COLLINEAR",
            Self::Coplanar => "COPLANAR",
            Self::NotFinite => "NOT_FINITE",
            Self::SizeOutOfRange => "SIZE_OUT_OF_RANGE",
            Self::ContractionPointNotInside => "CONTRACTION_POINT_NOT_INSIDE",
            Self::TooManyVertices => "TOO_MANY_VERTICES",
            Self::NotRepresentable => "NOT_REPRESENTABLE",
            Self::SimplificationOutOfRange => "SIMPLIFICATION_OUT_OF_RANGE",
            Self::SimplificationNotPossible => "SIMPLIFICATION_NOT_POSSIBLE",
            Self::PlanarityOutOfRange => "PLANARITY_OUT_OF_RANGE",
        }
    }

    /// The field at fault, as the wire names it.
    pub fn field(self) -> &'static str {
        match self {
            Self::ContractionPointNotInside => "contraction_point",
            Self::SimplificationOutOfRange | Self::SimplificationNotPossible => "simplification",
            Self::PlanarityOutOfRange => "planarity",
            _ => "vertices",
        }
    }
}

impl fmt::Display for HullError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.kind.reason(), self.detail)
    }
}

impl std::error::Error for HullError {}

/// Why a hull that may be stopped was not built.
#[derive(Clone, Debug, PartialEq)]
pub enum BuildError {
    /// The points make no hull.
    Hull(HullError),
    /// The caller's [`Stop`](crate::contact::Stop) ended the build.
    Stopped,
}

impl From<HullError> for BuildError {
    fn from(error: HullError) -> Self {
        Self::Hull(error)
    }
}

impl From<Stopped> for BuildError {
    fn from(_: Stopped) -> Self {
        Self::Stopped
    }
}

impl fmt::Display for BuildError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hull(error) => error.fmt(f),
            Self::Stopped => Stopped.fmt(f),
        }
    }
}

impl std::error::Error for BuildError {}

//! Errors of building a hull.

use std::fmt;

use crate::stop::Stopped;

/// The reason why no hull can be built from a cloud of points.
#[derive(Clone, Debug, PartialEq)]
pub struct HullError {
    /// The kind of error.
    pub kind: HullErrorKind,
    /// The index of the point at fault, if one point is at fault.
    pub index: Option<usize>,
    /// A description for people, with the value at fault. It starts with "internal:" if the
    /// error is a bug of the build.
    pub detail: String,
}

/// The kinds of [`HullError`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HullErrorKind {
    /// Fewer than 4 distinct points.
    TooFewPoints,
    /// All points are on one line.
    Collinear,
    /// All points are in one plane.
    Coplanar,
    /// A coordinate is NaN or infinite.
    NotFinite,
    /// The largest extent is outside [1e-50, 1e50].
    SizeOutOfRange,
    /// The contraction point is outside the hull, on its surface, or inside by no more than
    /// rounding: the inradius about it is at most 2^-37 of the circumradius.
    ContractionPointNotInside,
    /// The hull has more extreme vertices than the limit.
    TooManyVertices,
    /// The hull is too thin for double precision: its inradius is at most 2^-37 of its
    /// circumradius, or a face is thinner than the rounding of its vertices.
    NotRepresentable,
    /// The simplification asks for fewer than 4 vertices, or for a deviation that is negative or
    /// NaN.
    SimplificationOutOfRange,
    /// No hull with at most `max_vertices` vertices was found within `max_deviation`.
    SimplificationNotPossible,
    /// The planarity is not a number from 0 to 0.01.
    PlanarityOutOfRange,
}

impl HullErrorKind {
    /// Every kind.
    pub const ALL: &[Self] = &[
        Self::TooFewPoints,
        Self::Collinear,
        Self::Coplanar,
        Self::NotFinite,
        Self::SizeOutOfRange,
        Self::ContractionPointNotInside,
        Self::TooManyVertices,
        Self::NotRepresentable,
        Self::SimplificationOutOfRange,
        Self::SimplificationNotPossible,
        Self::PlanarityOutOfRange,
    ];

    /// The stable, upper-case name of this kind, as the service sends it.
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

    /// The field at fault, by its name in the service's messages.
    pub fn field(self) -> &'static str {
        match self {
            Self::ContractionPointNotInside => "contraction_point",
            Self::SimplificationOutOfRange | Self::SimplificationNotPossible => "simplification",
            Self::PlanarityOutOfRange => "planarity",
            _ => "vertices",
        }
    }
}

/// A number as messages show it: 2 for 2.0, and with an exponent if it is very small or large.
pub(super) fn plain(value: f64) -> String {
    let text = format!("{value:?}");
    text.strip_suffix(".0").map(str::to_owned).unwrap_or(text)
}

impl fmt::Display for HullError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.kind.reason(), self.detail)
    }
}

impl std::error::Error for HullError {}

/// The reason why a build that can be stopped gave no hull.
#[derive(Clone, Debug, PartialEq)]
pub enum BuildError {
    /// No hull can be built from the points.
    Hull(HullError),
    /// The caller's [`Stop`](crate::Stop) ended the build.
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

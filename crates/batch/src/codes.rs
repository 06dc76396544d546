//! The numbers by which the columns of an answer say what they mean.
//!
//! They are part of the contract of the service too, and a test of the service compares them with its
//! enums.

/// The outcome of a pair.
pub mod outcome {
    /// The hulls are within the margin of each other, or so near to it that rounding leaves it open.
    pub const CONTACT: u8 = 1;
    /// The hulls are certified to be farther apart than the margin.
    pub const SEPARATED: u8 = 2;
    /// A search ended before the outcome was known.
    pub const UNDECIDED: u8 = 3;
    /// The pair was not computed, because one of its hulls or poses is missing.
    pub const INVALID: u8 = 4;
}

/// The bits of a pair's flags.
pub mod flag {
    /// The projected features do not meet: the one contact point is an estimate.
    pub const ESTIMATED: u8 = 1;
    /// The centres coincide to rounding: alpha is 0 and the normal is arbitrary.
    pub const COINCIDENT: u8 = 2;
    /// The bracket of alpha is wider than the query asked for.
    pub const GAP_OPEN: u8 = 4;
    /// Points were dropped to keep at most `max_points`.
    pub const REDUCED: u8 = 8;
    /// A hull of the pair is not registered.
    pub const UNKNOWN_HULL: u8 = 16;
    /// A hull of the pair could not be read.
    pub const HULL_UNAVAILABLE: u8 = 32;
    /// A body of the pair has no usable pose.
    pub const INVALID_BODY: u8 = 64;
    /// The gradient is not unique. Only set if a derivative was asked for.
    pub const KINK: u8 = 128;
}

/// The kind of a touching feature.
pub mod feature {
    /// There is no feature.
    pub const NONE: u8 = 0;
    /// A vertex.
    pub const VERTEX: u8 = 1;
    /// An edge.
    pub const EDGE: u8 = 2;
    /// A face.
    pub const FACE: u8 = 3;
}

/// The index of a basis, feature or id that does not exist.
pub const NO_INDEX: u32 = u32::MAX;

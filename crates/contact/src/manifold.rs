//! The answer for a pair: values, bounds and status.

use glam::DVec3;

/// How the distance between the hulls compares with the margin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Outcome {
    /// Within the margin, or so near to it that rounding leaves it open.
    Contact,
    /// Certified farther apart than the margin.
    Separated,
    /// A search reached its iteration limit, or stopped making progress (a stall) while its bracket was
    /// still open, before the outcome was known.
    #[default]
    Undecided,
}

/// Qualifications of an answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags {
    /// The projected features do not meet: the one contact point is an estimate.
    pub estimated: bool,
    /// The centres coincide to rounding: alpha is 0 and the normal is arbitrary.
    pub coincident: bool,
    /// The bracket of alpha is wider than the query asked for.
    pub gap_open: bool,
    /// Points were dropped to keep at most `max_points`.
    pub reduced: bool,
}

/// The optimal triple of vertex pairs of step 1. Pair `i` is `(a[i], b[i])`, in indices of the
/// vertices as registered. It is the best warm start for the same two hulls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Basis {
    /// Vertices of A.
    pub a: [u32; 3],
    /// Vertices of B.
    pub b: [u32; 3],
}

/// The feature of a hull that touches, with indices of the vertices as registered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feature {
    /// A vertex.
    Vertex(u32),
    /// An edge, lower vertex first.
    Edge([u32; 2]),
    /// A face, by its index in the hull.
    Face(u32),
}

/// The part of a hull that made a contact point, with indices of the vertices as registered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Element {
    /// A vertex.
    Vertex(u32),
    /// An edge, or a side of a face's outline, lower vertex first.
    Edge([u32; 2]),
    /// The inside of the face. Also used if this hull adds nothing, because only the other hull's vertex
    /// determines the point.
    Inside,
}

impl Element {
    /// A number whose order is the order of the elements.
    pub(crate) fn key(self) -> u128 {
        let [kind, first, second] = match self {
            Self::Vertex(v) => [0, v, 0],
            Self::Edge([v, w]) => [1, v, w],
            Self::Inside => [2, 0, 0],
        }
        .map(u128::from);
        kind << 64 | first << 32 | second
    }
}

/// One contact point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactPoint {
    /// Point on A's feature, world frame.
    pub witness_a: DVec3,
    /// Signed distance along the normal. The witness on B is `witness_a + distance * normal`.
    pub distance: f64,
    /// The parts of A and of B that made the point. The id stays the same as long as the same parts
    /// make the point.
    pub id: [Element; 2],
}

/// The answer for a pair.
#[derive(Clone, Debug, PartialEq)]
pub struct Manifold {
    /// Within the margin, beyond it, or undecided.
    pub outcome: Outcome,
    /// Qualifications of the numbers below.
    pub flags: Flags,
    /// Growth scale. For a separated pair it is a certified lower bound.
    pub alpha: f64,
    /// Certified lower bound of alpha.
    pub alpha_lower: f64,
    /// Certified upper bound of alpha; infinite for a separated pair.
    pub alpha_upper: f64,
    /// Contact normal: unit, world frame, from A to B. For a separated pair it is a separating direction.
    pub normal: DVec3,
    /// Signed separation along the normal, negative if overlapping. For a separated pair it is a
    /// certified lower bound of the distance.
    pub separation: f64,
    /// Touching features of A and B, if points were asked for.
    pub features: Option<[Feature; 2]>,
    /// Contact points in order, anticlockwise about the normal.
    pub points: Vec<ContactPoint>,
    /// Fraction of the patch's area that the remaining points span. It is below 1 only if `max_points`
    /// dropped points of a patch that has an area.
    pub kept_area: f64,
    /// Best warm start, or `None` for a separated pair.
    pub basis: Option<Basis>,
    /// Solver iterations.
    pub iterations: u32,
    /// Support mapping calls, counted for each hull.
    pub support_calls: u32,
}

impl Default for Manifold {
    fn default() -> Self {
        Self {
            outcome: Outcome::default(),
            flags: Flags::default(),
            alpha: 0.0,
            alpha_lower: 0.0,
            alpha_upper: 0.0,
            normal: DVec3::ZERO,
            separation: 0.0,
            features: None,
            points: Vec::new(),
            kept_area: 1.0,
            basis: None,
            iterations: 0,
            support_calls: 0,
        }
    }
}

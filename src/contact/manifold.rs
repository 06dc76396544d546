//! What is answered of a pair: value, bound and status.

use glam::DVec3;

/// What is known of the distance between the hulls and the margin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Outcome {
    /// Within the margin, to rounding.
    Contact,
    /// Certified farther apart than the margin.
    Separated,
    /// An iteration limit was met before the outcome was known.
    #[default]
    Undecided,
}

/// What an answer has to be read with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags {
    /// The projected features miss each other: one estimated point.
    pub estimated: bool,
    /// The centres coincide to rounding: alpha is 0, the normal arbitrary.
    pub coincident: bool,
    /// The bracket of alpha is wider than asked.
    pub gap_open: bool,
    /// `max_points` dropped points.
    pub reduced: bool,
}

/// The optimal triple of vertex pairs of step 1: `(a[i], b[i])`, each an index
/// of its hull's vertices as registered. The best warm start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Basis {
    /// Vertices of A.
    pub a: [u32; 3],
    /// Vertices of B.
    pub b: [u32; 3],
}

/// What of a hull touches, with indices of its vertices as registered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feature {
    /// A vertex.
    Vertex(u32),
    /// An edge, lower vertex first.
    Edge([u32; 2]),
    /// A face: its index in the hull.
    Face(u32),
}

/// What of a hull made a contact point, with indices of its vertices as registered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Element {
    /// A vertex.
    Vertex(u32),
    /// An edge or a side of a face's outline, lower vertex first.
    Edge([u32; 2]),
    /// The inside of the face (or nothing of its own: the other hull made the point).
    Inside,
}

impl Element {
    /// In the same order as the elements.
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
    /// World point on A's feature.
    pub witness_a: DVec3,
    /// Signed, along the normal; the witness on B is `witness_a + distance * normal`.
    pub distance: f64,
    /// What of A and of B made it: the same while the same features do.
    pub id: [Element; 2],
}

/// The answer for a pair.
#[derive(Clone, Debug, PartialEq)]
pub struct Manifold {
    /// Within the margin or beyond.
    pub outcome: Outcome,
    /// What the numbers have to be read with.
    pub flags: Flags,
    /// Growth scale; for a separated pair a certified lower bound of it.
    pub alpha: f64,
    /// Certified lower end of the bracket of alpha.
    pub alpha_lower: f64,
    /// Certified upper end; infinity for a separated pair.
    pub alpha_upper: f64,
    /// Unit, world frame, from A to B; for a separated pair the separating direction.
    pub normal: DVec3,
    /// Signed separation along the normal; for a separated pair a certified
    /// lower bound of the distance.
    pub separation: f64,
    /// Features of A and B, when points were asked for.
    pub features: Option<[Feature; 2]>,
    /// Contact points, anticlockwise about the normal.
    pub points: Vec<ContactPoint>,
    /// Share of the patch's area that the points still span: 1 unless `max_points` dropped
    /// some, and where the patch has no area.
    pub kept_area: f64,
    /// Best warm start; none for a separated pair.
    pub basis: Option<Basis>,
    /// Solver iterations.
    pub iterations: u32,
    /// Support mapping calls, each hull counted.
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

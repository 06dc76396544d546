//! A query about a pair: the margin, the accuracy, and how far to compute.

/// The solver of the growth scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Solver {
    /// Portal refinement, which starts inside the Minkowski difference.
    #[default]
    Portal,
    /// The paper's ray cast, based on GJK.
    GjkRayCast,
}

impl Solver {
    /// All solvers, in the order of the enum.
    pub const ALL: [Self; 2] = [Self::Portal, Self::GjkRayCast];

    /// The solver's name in the contract of the service and in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Portal => "PORTAL",
            Self::GjkRayCast => "GJK_RAY_CAST",
        }
    }
}

/// How far the computation goes. Each level includes the one before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Wanted {
    /// Only the outcome: the computation stops as soon as the outcome is decided.
    Outcome,
    /// Growth scale, bracket, normal and separation: step 1.
    Growth,
    /// Features and contact points: all three steps.
    #[default]
    Points,
}

/// Settings that trade accuracy for speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// The solver of the growth scale.
    pub solver: Solver,
    /// Width of the bracket, relative to alpha, at which the solver may stop: 0 to 1. With 0 it stops
    /// at rounding level.
    pub relative_tolerance: f64,
    /// Radians, 0 to 0.5. Faces and edges within this angle of the normal count as touched.
    pub feature_angle: f64,
    /// Largest number of contact points per pair; 0 keeps all.
    pub max_points: u32,
    /// Largest number of solver iterations per pair, at least 1.
    pub max_iterations: u32,
}

/// Settings chosen from the measurements of `make tradeoff` (docs/tradeoff.md).
impl Accuracy {
    /// Solves to rounding level and keeps the whole patch. No coarser tolerance measured faster.
    /// Measured: brackets at most 1.4e-13 of alpha wide.
    pub const EXACT: Self = Self {
        solver: Solver::Portal,
        relative_tolerance: 0.0,
        feature_angle: 0.01,
        max_points: 0,
        max_iterations: 1000,
    };

    /// [`Accuracy::EXACT`] with at most four points per pair, so that there are fewer points to send
    /// and to solve for. Measured: 2 to 7 % more time; in 19 of 20 pairs the patch is off by at most
    /// 6 % of the hulls' size.
    pub const FOUR_POINTS: Self = Self { max_points: 4, ..Self::EXACT };
}

impl Default for Accuracy {
    /// [`Accuracy::EXACT`].
    fn default() -> Self {
        Self::EXACT
    }
}

/// A query about a pair.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Query {
    /// Contact points are computed for hulls within this distance of each other, caller's units. At
    /// least 0; infinity includes every pair.
    pub margin: f64,
    /// Settings that trade accuracy for speed.
    pub accuracy: Accuracy,
    /// How far the computation goes.
    pub wanted: Wanted,
}

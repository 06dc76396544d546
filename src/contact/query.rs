//! What is asked of a pair.

/// Which solver finds the growth scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Solver {
    /// Portal refinement from inside.
    #[default]
    Portal,
    /// The paper's GJK-based ray cast.
    GjkRayCast,
}

/// How far the computation goes; each includes the one before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Wanted {
    /// The outcome alone: stops as soon as it is decided.
    Outcome,
    /// Growth scale, bracket, normal and separation: step 1.
    Growth,
    /// Features and contact points: all three steps.
    #[default]
    Points,
}

/// Speed against accuracy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// Which solver finds the growth scale.
    pub solver: Solver,
    /// Width of the bracket over alpha that is good enough, 0 to 1; 0: to rounding.
    pub relative_tolerance: f64,
    /// Radians, 0 to 0.5: faces and edges within it of the normal count as touched.
    pub feature_angle: f64,
    /// Points a pair; 0: all.
    pub max_points: u32,
    /// Solver iterations a pair, at least 1.
    pub max_iterations: u32,
}

/// Chosen from what `hullcast tradeoff` measured (docs/tradeoff.md).
impl Accuracy {
    /// To rounding, the whole patch. No coarser tolerance was measured to be faster. Measured:
    /// brackets at most 1.4e-13 of alpha wide.
    pub const EXACT: Self = Self {
        solver: Solver::Portal,
        relative_tolerance: 0.0,
        feature_angle: 0.01,
        max_points: 0,
        max_iterations: 1000,
    };

    /// The same, at most four points a pair: fewer to send and to solve for. Measured: 2 to 7 %
    /// more time; in 19 of 20 pairs the patch is at most 6 % of the hulls' size off.
    pub const FOUR_POINTS: Self = Self { max_points: 4, ..Self::EXACT };
}

impl Default for Accuracy {
    /// [`Accuracy::EXACT`].
    fn default() -> Self {
        Self::EXACT
    }
}

/// What is asked of a pair.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Query {
    /// Contact points are wanted where the hulls are within it: at least 0, infinity for every pair.
    pub margin: f64,
    /// Speed against accuracy.
    pub accuracy: Accuracy,
    /// How far the computation goes.
    pub wanted: Wanted,
}

//! Options that `query` and `load` have in common.

use clap::{Args, ValueEnum};

use hullcast::proto;

/// Speed against accuracy.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct AccuracyArgs {
    /// Which solver finds the growth scale.
    #[arg(long, value_enum, default_value_t)]
    solver: SolverArg,
    /// Width of the bracket over alpha that is good enough, 0 to 1; 0: to rounding.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    relative_tolerance: f64,
    /// Faces and edges within it of the normal count as touched, 0 to 0.5 [default: 0.01].
    #[arg(long, value_name = "RADIANS")]
    feature_angle: Option<f64>,
    /// Contact points a pair at most; 0: all.
    #[arg(long, value_name = "COUNT", default_value_t = 0)]
    max_points: u32,
}

#[derive(ValueEnum, Clone, Copy, Debug, Default)]
enum SolverArg {
    /// Portal refinement from inside.
    #[default]
    Portal,
    /// The paper's GJK-based ray cast.
    GjkRayCast,
}

/// A column group of the answer.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OutputArg {
    /// Outcomes and flags alone.
    Outcome,
    /// The growth scale and its bracket.
    Alpha,
    /// The normal and the separation.
    Normal,
    /// Witnesses on A and distances.
    Points,
    /// Witnesses on B.
    WitnessB,
    /// Kinds and indices of the features, and the points' ids.
    Features,
    /// Bases, to start the next query from.
    Bases,
    /// Iterations and support calls.
    Diagnostics,
}

/// The parts of a query that are the same for every pair.
#[derive(Clone, Debug)]
pub(crate) struct Asked {
    /// Contact points are computed for hulls within this distance.
    pub(crate) margin: f64,
    /// Settings that trade accuracy for speed.
    pub(crate) accuracy: proto::Accuracy,
    /// Numbers of the outputs to compute and send.
    pub(crate) outputs: Vec<i32>,
}

impl AccuracyArgs {
    /// The query with a margin and outputs. The server or the library refuses values out of range.
    pub(crate) fn asked(&self, margin: f64, outputs: &[OutputArg]) -> Asked {
        let solver = match self.solver {
            SolverArg::Portal => proto::Solver::Portal,
            SolverArg::GjkRayCast => proto::Solver::GjkRayCast,
        };
        let accuracy = proto::Accuracy {
            solver: solver.into(),
            relative_tolerance: self.relative_tolerance,
            feature_angle: self.feature_angle,
            max_points: self.max_points,
        };
        Asked { margin, accuracy, outputs: outputs.iter().map(|o| o.wire().into()).collect() }
    }
}

impl OutputArg {
    fn wire(self) -> proto::Output {
        match self {
            Self::Outcome => proto::Output::Outcome,
            Self::Alpha => proto::Output::Alpha,
            Self::Normal => proto::Output::Normal,
            Self::Points => proto::Output::Points,
            Self::WitnessB => proto::Output::WitnessB,
            Self::Features => proto::Output::Features,
            Self::Bases => proto::Output::Bases,
            Self::Diagnostics => proto::Output::Diagnostics,
        }
    }
}

//! The options that `query` and `load` have in common.

use clap::{Args, ValueEnum};

use super::values::{count, number};
use hullcast::proto;

/// Speed against accuracy.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Speed against accuracy")]
pub(crate) struct AccuracyArgs {
    /// The solver that finds the growth scale.
    #[arg(long, value_enum, ignore_case = true, default_value_t)]
    solver: SolverArg,
    /// Stop the solver at this width of the bracket, relative to alpha, 0 to 1. 0 means as narrow
    /// as rounding allows.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_negative_numbers = true,
          value_parser = number(0.0, 1.0))]
    relative_tolerance: f64,
    /// Faces and edges count as touched within this angle of the normal, 0 to 0.5 [default: 0.01].
    #[arg(long, value_name = "RADIANS", allow_negative_numbers = true, value_parser = number(0.0, 0.5))]
    feature_angle: Option<f64>,
    /// Most contact points per pair. 0 means all.
    #[arg(long, value_name = "COUNT", default_value_t = 0, allow_negative_numbers = true,
          value_parser = count(0, u32::MAX))]
    max_points: u32,
}

#[derive(ValueEnum, Clone, Copy, Debug, Default)]
enum SolverArg {
    /// Portal refinement from inside.
    #[default]
    Portal,
    /// The paper's GJK-based ray cast.
    #[value(alias = "gjk_ray_cast")]
    GjkRayCast,
}

/// A column group of the answer, such as `witness-b`. The spelling of Python and the protocol,
/// `WITNESS_B`, is accepted too.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OutputArg {
    /// Only outcomes and flags.
    Outcome,
    /// The growth scale and its bracket.
    Alpha,
    /// The normal and the separation.
    Normal,
    /// Witnesses on A and distances.
    Points,
    /// Witnesses on B.
    #[value(alias = "witness_b")]
    WitnessB,
    /// Kinds and indices of the features, and the points' ids.
    Features,
    /// Bases, from which the next query can start.
    Bases,
    /// Iterations, support calls, and the fraction of the patch's area that is left if points are
    /// dropped.
    Diagnostics,
    /// The gradient of the growth scale.
    #[value(alias = "alpha_gradient")]
    AlphaGradient,
    /// The gradient of the separation.
    #[value(alias = "separation_gradient")]
    SeparationGradient,
    /// The Jacobian of the normal.
    #[value(alias = "normal_jacobian")]
    NormalJacobian,
}

/// The parts of a query that are the same for every pair.
#[derive(Clone, Debug)]
pub(crate) struct QueryOptions {
    /// Contact points are computed for hulls within this distance.
    pub(crate) margin: f64,
    /// Settings that trade accuracy for speed.
    pub(crate) accuracy: proto::Accuracy,
    /// Numbers of the outputs to compute and send.
    pub(crate) outputs: Vec<i32>,
}

impl AccuracyArgs {
    /// The query with a margin and outputs. The server or the library refuses values out of range.
    pub(crate) fn query_options(&self, margin: f64, outputs: &[OutputArg]) -> QueryOptions {
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
        QueryOptions { margin, accuracy, outputs: outputs.iter().map(|o| o.wire().into()).collect() }
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
            Self::AlphaGradient => proto::Output::AlphaGradient,
            Self::SeparationGradient => proto::Output::SeparationGradient,
            Self::NormalJacobian => proto::Output::NormalJacobian,
        }
    }
}

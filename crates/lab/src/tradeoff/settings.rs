//! The grid of settings: the levels of every knob, and all their combinations.

use std::fmt;

use hullcast_contact::{Accuracy, Simplification, Solver};

/// A setting: one value of each knob.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Setting {
    pub(super) solver: Solver,
    pub(super) relative_tolerance: f64,
    pub(super) max_iterations: u32,
    /// Whether a pair starts from the answer before a small motion.
    pub(super) warm: bool,
    /// Deviation allowed to simplified hulls, as a fraction of the circumradius; 0 means not
    /// simplified.
    pub(super) simplification: f64,
    pub(super) feature_angle: f64,
    pub(super) max_points: u32,
    pub(super) centre: Centre,
}

/// The contraction point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Centre {
    /// The centre of mass.
    Mass,
    /// The centre of the largest ball inside.
    Ball,
    /// The centre of mass, moved by half the inradius.
    Offset,
}

const TOLERANCES: [f64; 4] = [0.0, 1e-6, 1e-3, 1e-1];
const ITERATIONS: [u32; 3] = [1000, 16, 4];
const WARM: [bool; 2] = [false, true];
pub(super) const SIMPLIFICATIONS: [f64; 3] = [0.0, 0.01, 0.05];
const FEATURE_ANGLES: [f64; 3] = [0.01, 0.0, 0.1];
const MAX_POINTS: [u32; 3] = [0, 4, 1];
pub(super) const CENTRES: [Centre; 3] = [Centre::Mass, Centre::Ball, Centre::Offset];

/// The names of the knobs in the table's columns.
pub(super) const KNOBS: [&str; 8] = [
    "solver",
    "relative_tolerance",
    "max_iterations",
    "start",
    "simplification",
    "feature_angle",
    "max_points",
    "contraction_point",
];

impl Setting {
    /// The setting of a request that gives no accuracy: the first level of each knob.
    pub(super) const DEFAULT: Self = Self {
        solver: Solver::ALL[0],
        relative_tolerance: TOLERANCES[0],
        max_iterations: ITERATIONS[0],
        warm: WARM[0],
        simplification: SIMPLIFICATIONS[0],
        feature_angle: FEATURE_ANGLES[0],
        max_points: MAX_POINTS[0],
        centre: CENTRES[0],
    };

    /// Every combination. The inner loops do not change the hulls.
    pub(super) fn grid() -> Vec<Self> {
        let mut grid = Vec::new();
        for centre in CENTRES {
            for simplification in SIMPLIFICATIONS {
                for solver in Solver::ALL {
                    for relative_tolerance in TOLERANCES {
                        for max_iterations in ITERATIONS {
                            for warm in WARM {
                                for feature_angle in FEATURE_ANGLES {
                                    grid.extend(MAX_POINTS.map(|max_points| Self {
                                        solver,
                                        relative_tolerance,
                                        max_iterations,
                                        warm,
                                        simplification,
                                        feature_angle,
                                        max_points,
                                        centre,
                                    }));
                                }
                            }
                        }
                    }
                }
            }
        }
        grid
    }

    /// The accuracy that the library is called with.
    pub(super) fn accuracy(&self) -> Accuracy {
        Accuracy {
            solver: self.solver,
            relative_tolerance: self.relative_tolerance,
            feature_angle: self.feature_angle,
            max_points: self.max_points,
            max_iterations: self.max_iterations,
        }
    }

    /// The simplification of the hulls. `size` is the circumradius.
    pub(super) fn simplified(&self, size: f64) -> Option<Simplification> {
        (self.simplification > 0.0)
            .then_some(Simplification { max_vertices: None, max_deviation: Some(self.simplification * size) })
    }

    /// The value of each knob, in the order of [`KNOBS`].
    pub(super) fn values(&self) -> [String; KNOBS.len()] {
        let start = if self.warm { "warm" } else { "cold" };
        let centre = match self.centre {
            Centre::Mass => "mass",
            Centre::Ball => "ball",
            Centre::Offset => "offset",
        };
        [
            match self.solver {
                Solver::Portal => "portal".into(),
                Solver::GjkRayCast => "gjk_ray_cast".into(),
            },
            self.relative_tolerance.to_string(),
            self.max_iterations.to_string(),
            start.into(),
            self.simplification.to_string(),
            self.feature_angle.to_string(),
            self.max_points.to_string(),
            centre.into(),
        ]
    }

    /// The indices of the knobs that are not at their default.
    pub(super) fn changed(&self) -> Vec<usize> {
        let (own, default) = (self.values(), Self::DEFAULT.values());
        (0..KNOBS.len()).filter(|&knob| own[knob] != default[knob]).collect()
    }
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let values = self.values();
        let changed: Vec<String> =
            self.changed().into_iter().map(|knob| format!("{} {}", KNOBS[knob], values[knob])).collect();
        if changed.is_empty() { f.write_str("the default") } else { f.write_str(&changed.join(", ")) }
    }
}

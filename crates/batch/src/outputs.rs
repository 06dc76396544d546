//! The parts of an answer that are computed and sent.

use hullcast_contact::Wanted;

/// Declares every output in one place: its field, its variant, its number and its name.
macro_rules! outputs {
    ($($(#[doc = $doc:literal])* $field:ident, $output:ident = $number:literal, $name:literal;)*) => {
        /// A part of an answer that a query may ask for. The numbers are those of the service's contract.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Output {
            $($(#[doc = $doc])* $output = $number,)*
        }

        impl Output {
            /// All outputs, in the order of their numbers.
            pub const ALL: &'static [Self] = &[$(Self::$output),*];

            /// The output's name in the contract.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$output => $name,)*
                }
            }
        }

        /// A set of outputs. Outcomes and flags are always computed and sent; other outputs only if
        /// requested.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct Outputs {
            $($(#[doc = $doc])* pub $field: bool,)*
        }

        impl Outputs {
            /// Only outcomes and flags.
            pub const OUTCOME: Self = Self { $($field: false,)* };

            /// Whether the set has this output.
            #[inline]
            pub const fn has(self, output: Output) -> bool {
                match output {
                    $(Output::$output => self.$field,)*
                }
            }

            /// Adds an output to the set.
            pub fn add(&mut self, output: Output) {
                match output {
                    $(Output::$output => self.$field = true,)*
                }
            }
        }
    };
}

outputs! {
    /// The growth scale and its bracket.
    alpha, Alpha = 2, "ALPHA";
    /// The normal and the separation.
    normal, Normal = 3, "NORMAL";
    /// Witnesses on A and distances.
    points, Points = 4, "POINTS";
    /// Witnesses on B.
    witness_b, WitnessB = 5, "WITNESS_B";
    /// The kinds and indices of the features, and the ids of the points.
    features, Features = 6, "FEATURES";
    /// The bases, from which the next query can start.
    bases, Bases = 7, "BASES";
    /// Iterations, support calls, and the area kept by reduction.
    diagnostics, Diagnostics = 8, "DIAGNOSTICS";
    /// The rows and points of the answer before that are the same pairs and points. Only streams have such an
    /// answer.
    matches, Matches = 9, "MATCHES";
    /// The gradient of the growth scale.
    alpha_gradient, AlphaGradient = 10, "ALPHA_GRADIENT";
    /// The gradient of the separation.
    separation_gradient, SeparationGradient = 11, "SEPARATION_GRADIENT";
    /// The Jacobian of the normal.
    normal_jacobian, NormalJacobian = 12, "NORMAL_JACOBIAN";
}

impl Output {
    /// The output with this number, or `None` if this version has none.
    pub fn from_number(number: i32) -> Option<Self> {
        Self::ALL.iter().copied().find(|&output| i32::from(output as u8) == number)
    }
}

impl Outputs {
    /// The set of these outputs, besides outcomes and flags.
    pub fn of(outputs: impl IntoIterator<Item = Output>) -> Self {
        let mut set = Self::OUTCOME;
        outputs.into_iter().for_each(|output| set.add(output));
        set
    }

    /// Whether the answer has a column of points, and therefore point counts.
    pub fn any_points(self) -> bool {
        self.points || self.witness_b || self.features || self.matches
    }

    /// Whether the answer has derivatives.
    pub fn any_derivatives(self) -> bool {
        self.alpha_gradient || self.separation_gradient || self.normal_jacobian
    }

    /// The kind of result that the computation has to produce.
    pub fn wanted(self) -> Wanted {
        if self.any_points() {
            Wanted::Points
        } else if self.alpha || self.normal || self.bases || self.any_derivatives() {
            Wanted::Growth
        } else {
            Wanted::Outcome
        }
    }
}

impl Default for Outputs {
    /// The outputs of a query that names none: growth scale, normal and points.
    fn default() -> Self {
        Self { alpha: true, normal: true, points: true, ..Self::OUTCOME }
    }
}

//! The table of columns, and the columns of an answer.
//!
//! An answer is a set of columns: one array per quantity. A column has a fixed number of values per pair, or
//! per contact point; the points are stored pair after pair. The table in this file names every
//! column once, with its type, its width, the outputs that bring it, and how its values come from a manifold.
//! Everything that treats all columns alike is made from the table: the columns themselves, their sizes, the
//! response of the service, and the files and texts of the command line.

use std::ops::Range;

use hullcast_contact::{ContactPoint, Derivatives, Manifold, Stop, Stopped};

use crate::{
    codes::{NO_INDEX, feature, flag, outcome},
    outputs::{Output, Outputs},
};
use declare::BYTES_BETWEEN_LOOKS;
use manifold::{basis, bit, feature_indices, features, flag_bits, outcome_code, point_id, rows, witness_b};

mod column;
#[macro_use]
mod declare;
mod manifold;

pub use column::{Column, Per, Values};
pub use manifold::InvalidPair;

// The table. Each row of a pair or point has: the column's name, its type and width, the key of its value in
// JSON, whether the `first` version of the contract has it, the outputs that bring it, and its value. A pair
// that could not be computed has the value `invalid` in every place.
columns! {
    ($)
    found {
        /// The bodies of each pair, the lower index first; only if the pairs were searched for.
        pairs: [u32; 2], "pair";
    }
    always {
        /// The outcomes; [`outcome`] has their codes.
        outcomes: [u8; 1], "outcome";
        /// The flags; [`flag`] has their bits.
        flags: [u8; 1], "flags";
    }
    pair {
        /// The growth scale. For a separated pair it is a certified lower bound.
        alphas: [f64; 1], "alpha", first, of [Alpha] = |m| [m.alpha], invalid: f64::NAN;
        /// The lower end of the certified bracket of alpha.
        alpha_lowers: [f64; 1], "alpha_bracket", first, of [Alpha] = |m| [m.alpha_lower], invalid: f64::NAN;
        /// The upper end of the certified bracket of alpha; infinite for a separated pair.
        alpha_uppers: [f64; 1], "alpha_bracket", first, of [Alpha] = |m| [m.alpha_upper], invalid: f64::NAN;
        /// The signed separation along the normal. For a separated pair it is a certified lower bound of
        /// the distance.
        separations: [f64; 1], "separation", first, of [Normal] = |m| [m.separation], invalid: f64::NAN;
        /// The unit normal in the world frame, from A to B.
        normals: [f64; 3], "normal", first, of [Normal] = |m| m.normal.to_array(), invalid: f64::NAN;
        /// The number of contact points.
        point_counts: [u32; 1], "points", first, of [Points WitnessB Features Matches] = |m| [m.points.len() as u32],
            invalid: 0;
        /// The kinds of the touching features of A and of B; [`feature`] has their codes.
        feature_kinds: [u8; 2], "feature_kinds", first, of [Features] = |m| features(m).map(|(kind, _)| kind),
            invalid: feature::NONE;
        /// The indices of the touching features: two for A and two for B. A vertex or a face has one index
        /// and [`NO_INDEX`], an edge its two vertices.
        feature_indices: [u32; 4], "feature_indices", first, of [Features] = |m| feature_indices(m),
            invalid: NO_INDEX;
        /// The optimal triple of vertex pairs, from which the next query can start: three vertices of A and
        /// three of B. [`NO_INDEX`] if there is none.
        bases: [u32; 6], "basis", first, of [Bases] = |m| basis(m), invalid: NO_INDEX;
        /// The number of iterations of the solver.
        iterations: [u32; 1], "iterations", first, of [Diagnostics] = |m| [m.iterations], invalid: 0;
        /// The number of calls of the support mapping, of both hulls together.
        support_calls: [u32; 1], "support_calls", first, of [Diagnostics] = |m| [m.support_calls], invalid: 0;
        /// The fraction of the patch's area that the points still span.
        kept_areas: [f64; 1], "kept_area", later, of [Diagnostics] = |m| [m.kept_area], invalid: f64::NAN;
        /// The row of the same pair in the answer before, or [`NO_INDEX`]. A batch does not know the answer
        /// before; [`matches`](crate::matches) fills the column in.
        previous_pairs: [u32; 1], "previous_pair", later, of [Matches] = |_m| [NO_INDEX], invalid: NO_INDEX;
    }
    derivative {
        /// The gradient of the growth scale: by a translation of B relative to A, by a rotation of A, and by a
        /// rotation of B, each along the world's axes. NaN for a pair without a basis, as for the others below.
        alpha_gradients: [f64; 9], "alpha_gradient", of [AlphaGradient] = |d| d.alpha;
        /// The gradient of the separation, in the same order.
        separation_gradients: [f64; 9], "separation_gradient", of [SeparationGradient] = |d| d.separation;
        /// The Jacobian of the normal: for each of its coordinates a row, in the same order.
        normal_jacobians: [f64; 27], "normal_jacobian", of [NormalJacobian] = |d| rows(&d.normal);
        /// A bound of the derivatives' rounding error, relative to their sizes ([`Derivatives::error`]).
        gradient_errors: [f64; 1], "gradient_error", of [AlphaGradient SeparationGradient NormalJacobian] =
            |d| [d.error];
    }
    point {
        /// The witness on A, in the world frame.
        witness_as: [f64; 3], "witness_a", first, of [Points] = |_, point| point.witness_a.to_array();
        /// The signed distance along the normal, negative if the hulls overlap there.
        distances: [f64; 1], "distance", first, of [Points] = |_, point| [point.distance];
        /// The witness on B, in the world frame.
        witness_bs: [f64; 3], "witness_b", first, of [WitnessB] = |manifold, point| witness_b(manifold, point);
        /// The parts of A and of B that make the point, two numbers each: an edge's vertices, a vertex twice,
        /// or [`NO_INDEX`] twice for the inside of a face.
        point_ids: [u32; 4], "id", first, of [Features] = |_, point| point_id(point);
        /// The index of the same point in the row of the answer before, or [`NO_INDEX`]; filled in like
        /// `previous_pairs`.
        previous_points: [u32; 1], "previous_point", later, of [Matches] = |_, _point| [NO_INDEX];
    }
}

impl Columns {
    /// The number of pairs.
    pub fn len(&self) -> usize {
        self.outcomes.len()
    }

    /// Whether there are no pairs.
    pub fn is_empty(&self) -> bool {
        self.outcomes.is_empty()
    }

    /// Bytes on the wire, without the tags and lengths of the columns.
    pub fn wire_bytes(&self, outputs: Outputs) -> usize {
        self.len() * outputs.pair_bytes() + self.points * outputs.point_bytes()
    }

    /// The solver's iterations over all pairs, including those that are not sent.
    pub fn solver_iterations(&self) -> u64 {
        self.solver_iterations
    }

    /// The number of pairs with each outcome: CONTACT, SEPARATED, UNDECIDED, INVALID.
    pub fn outcome_counts(&self) -> [usize; 4] {
        let mut counts = [0; 4];
        for &outcome in &self.outcomes {
            counts[outcome as usize - 1] += 1;
        }
        counts
    }

    /// Adds the bodies of the next pair, if the query did not name them.
    pub fn push_pair(&mut self, bodies: [u32; 2]) {
        self.pairs.extend_from_slice(&bodies);
    }

    /// The number of points of all pairs, sent or not.
    pub fn point_count(&self) -> usize {
        self.points
    }
}

#[cfg(test)]
mod tests {
    use hullcast_contact::Element;

    use super::*;

    /// Catches a column whose values do not have the width of the table, a size that leaves a column out, and
    /// a column that is filled although no output brings it. The values are those of a pair with one point
    /// and of a pair that could not be computed, for every set of outputs.
    #[test]
    fn the_columns_are_those_of_the_table() {
        let point = ContactPoint {
            witness_a: glam::DVec3::ONE,
            distance: 0.5,
            id: [Element::Vertex(1), Element::Inside],
        };
        let manifold = Manifold { points: vec![point], ..Manifold::default() };
        for set in 0..1_usize << Output::ALL.len() {
            let chosen = Output::ALL.iter().enumerate().filter(|(bit, _)| set >> bit & 1 == 1);
            let outputs = Outputs::of(chosen.map(|(_, &output)| output));
            let mut columns = Columns::default();
            columns.push(&manifold, outputs);
            columns.push_derivatives(None, outputs);
            columns.push_invalid(InvalidPair::default(), outputs);
            let mut bytes = 0;
            for (column, values) in columns.values() {
                let rows = match column.per {
                    Per::FoundPair => 0,
                    Per::Pair => 2,
                    Per::Point => 1,
                };
                let rows = if column.is_sent(outputs) { rows } else { 0 };
                assert_eq!(values.len(), rows * column.width, "{} {outputs:?}", column.name);
                bytes += match values {
                    Values::U8(values) => size_of_val(values),
                    Values::U32(values) => size_of_val(values),
                    Values::F64(values) => size_of_val(values),
                };
            }
            assert_eq!((columns.wire_bytes(outputs), columns.filled_bytes()), (bytes, bytes), "{outputs:?}");
            columns.clear();
            assert_eq!((columns.filled_bytes(), columns.len()), (0, 0));
        }
        assert_eq!(COLUMNS.len(), 25);
        let all = Outputs::of(Output::ALL.iter().copied());
        assert_eq!(all.pair_bytes(), 2 + 24 + 32 + 4 + 18 + 24 + 16 + 4 + 46 * 8);
    }
}

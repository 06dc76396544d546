//! The table of columns, and the columns of an answer.
//!
//! An answer is a set of columns: one array per quantity. A column has a fixed number of values per pair, or
//! per contact point; the points are stored pair after pair. The table at the end of this file names every
//! column once, with its type, its width, the outputs that bring it, and how its values come from a manifold.
//! Everything that treats all columns alike is made from the table: the columns themselves, their sizes, the
//! response of the service, and the files and texts of the command line.

use std::ops::Range;

use hullcast_contact::{ContactPoint, Element, Feature, Manifold, Outcome, Stop, Stopped};

use crate::{
    codes::{NO_INDEX, feature, flag, outcome},
    outputs::{Output, Outputs},
    scene::Missing,
};

/// Bytes that are copied between two checks of the stop flag: about half a millisecond.
const BYTES_BETWEEN_LOOKS: usize = 2 << 20;

/// The row of a column in the table.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// The column's name in the contract and in files.
    pub name: &'static str,
    /// The name of the value of one pair or point, in the JSON of the command line. Columns of one key are
    /// joined to one list.
    pub key: &'static str,
    /// Whether the values belong to pairs or to points.
    pub per: Per,
    /// The number of values per pair or point.
    pub width: usize,
    /// The outputs that bring the column; each of them suffices. Empty if the column does not depend on the
    /// outputs.
    pub outputs: &'static [Output],
    /// Whether a server of the first version of the contract does not send the column.
    pub is_later: bool,
}

/// The owner of a column's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Per {
    /// Each pair of an answer to a search for pairs.
    FoundPair,
    /// Each pair.
    Pair,
    /// Each contact point.
    Point,
}

/// The values of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Values<'a> {
    /// Codes and flags.
    U8(&'a [u8]),
    /// Counts and indices.
    U32(&'a [u32]),
    /// Lengths and ratios.
    F64(&'a [f64]),
}

impl Column {
    /// Whether the column is sent if these outputs are asked for.
    pub fn is_sent(&self, outputs: Outputs) -> bool {
        let any = self.outputs.iter().any(|&output| outputs.has(output));
        self.per != Per::FoundPair && (self.outputs.is_empty() || any)
    }
}

impl Values<'_> {
    /// The values of one pair or point of a column with `width` values each, or `None` if the column has no
    /// such pair or point.
    pub fn row(&self, index: usize, width: usize) -> Option<Self> {
        let row = index * width..(index + 1) * width;
        Some(match self {
            Self::U8(values) => Self::U8(values.get(row)?),
            Self::U32(values) => Self::U32(values.get(row)?),
            Self::F64(values) => Self::F64(values.get(row)?),
        })
    }

    /// The number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::U32(values) => values.len(),
            Self::F64(values) => values.len(),
        }
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether both have the same bits. NaN is the same as itself, and 0.0 is not -0.0.
    pub fn is_same(&self, other: Self) -> bool {
        match (*self, other) {
            (Self::U8(one), Self::U8(other)) => one == other,
            (Self::U32(one), Self::U32(other)) => one == other,
            (Self::F64(one), Self::F64(other)) => {
                one.len() == other.len() && one.iter().zip(other).all(|(a, b)| a.to_bits() == b.to_bits())
            }
            _ => false,
        }
    }
}

impl<'a> From<&'a [u8]> for Values<'a> {
    fn from(values: &'a [u8]) -> Self {
        Self::U8(values)
    }
}

impl<'a> From<&'a [u32]> for Values<'a> {
    fn from(values: &'a [u32]) -> Self {
        Self::U32(values)
    }
}

impl<'a> From<&'a [f64]> for Values<'a> {
    fn from(values: &'a [f64]) -> Self {
        Self::F64(values)
    }
}

/// The reason why a pair is not answered. It affects only pairs of the body or hull at fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InvalidPair {
    unknown_hull: bool,
    hull_unavailable: bool,
    invalid_body: bool,
}

impl InvalidPair {
    /// Records that the pose of a body is not usable.
    pub fn body(&mut self) {
        self.invalid_body = true;
    }

    /// Records that the hull of a body is missing.
    pub fn hull(&mut self, missing: Missing) {
        match missing {
            Missing::Unknown => self.unknown_hull = true,
            Missing::Unavailable => self.hull_unavailable = true,
        }
    }

    fn flags(self) -> u8 {
        bit(self.unknown_hull, flag::UNKNOWN_HULL)
            | bit(self.hull_unavailable, flag::HULL_UNAVAILABLE)
            | bit(self.invalid_body, flag::INVALID_BODY)
    }
}

fn bit(set: bool, flag: u8) -> u8 {
    if set { flag } else { 0 }
}

fn outcome_code(outcome: Outcome) -> u8 {
    match outcome {
        Outcome::Contact => outcome::CONTACT,
        Outcome::Separated => outcome::SEPARATED,
        Outcome::Undecided => outcome::UNDECIDED,
    }
}

fn flag_bits(manifold: &Manifold) -> u8 {
    let flags = &manifold.flags;
    bit(flags.estimated, flag::ESTIMATED)
        | bit(flags.coincident, flag::COINCIDENT)
        | bit(flags.gap_open, flag::GAP_OPEN)
        | bit(flags.reduced, flag::REDUCED)
}

fn witness_b(manifold: &Manifold, point: &ContactPoint) -> [f64; 3] {
    (point.witness_a + point.distance * manifold.normal).to_array()
}

fn point_id(point: &ContactPoint) -> [u32; 4] {
    let [[a0, a1], [b0, b1]] = point.id.map(|element| match element {
        Element::Vertex(vertex) => [vertex, vertex],
        Element::Edge(ends) => ends,
        Element::Inside => [NO_INDEX, NO_INDEX],
    });
    [a0, a1, b0, b1]
}

/// The features of A and of B, each as its kind and its indices.
fn features(manifold: &Manifold) -> [(u8, [u32; 2]); 2] {
    let features = manifold.features.map(|features| features.map(Some)).unwrap_or_default();
    features.map(|touched| match touched {
        None => (feature::NONE, [NO_INDEX, NO_INDEX]),
        Some(Feature::Vertex(vertex)) => (feature::VERTEX, [vertex, NO_INDEX]),
        Some(Feature::Edge(ends)) => (feature::EDGE, ends),
        Some(Feature::Face(face)) => (feature::FACE, [face, NO_INDEX]),
    })
}

fn feature_indices(manifold: &Manifold) -> [u32; 4] {
    let [(_, [a0, a1]), (_, [b0, b1])] = features(manifold);
    [a0, a1, b0, b1]
}

fn basis(manifold: &Manifold) -> [u32; 6] {
    let basis = manifold.basis.map(|basis| (basis.a, basis.b));
    basis.map_or([NO_INDEX; 6], |([a0, a1, a2], [b0, b1, b2])| [a0, a1, a2, b0, b1, b2])
}

/// Declares all columns in one place, with everything that treats them alike. `$d` is a dollar sign, for the
/// macro that this macro declares.
macro_rules! columns {
    (
        ($d:tt)
        found { $(#[doc = $found_doc:literal])* $found:ident: [$found_element:ty; $found_width:literal], $found_key:literal; }
        always { $($(#[doc = $always_doc:literal])* $always:ident: [u8; 1], $always_key:literal;)* }
        pair { $(
            $(#[doc = $pair_doc:literal])*
            $pair:ident: [$pair_element:ty; $pair_width:literal], $pair_key:literal, $pair_age:ident,
            of [$($pair_output:ident)*] = |$manifold:ident| $pair_value:expr, invalid: $invalid:expr;
        )* }
        point { $(
            $(#[doc = $point_doc:literal])*
            $point:ident: [$point_element:ty; $point_width:literal], $point_key:literal, $point_age:ident,
            of [$($point_output:ident)*] = |$of_manifold:pat_param, $of_point:ident| $point_value:expr;
        )* }
    ) => {
        /// The columns of consecutive pairs. A column that was not asked for stays empty.
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct Columns {
            $(#[doc = $found_doc])* pub $found: Vec<$found_element>,
            $($(#[doc = $always_doc])* pub $always: Vec<u8>,)*
            $($(#[doc = $pair_doc])* pub $pair: Vec<$pair_element>,)*
            $($(#[doc = $point_doc])* pub $point: Vec<$point_element>,)*
            points: usize,
            solver_iterations: u64,
        }

        /// The table of all columns.
        pub const COLUMNS: &[Column] = &[
            Column {
                name: stringify!($found), key: $found_key, per: Per::FoundPair, width: $found_width,
                outputs: &[], is_later: false,
            },
            $(Column {
                name: stringify!($always), key: $always_key, per: Per::Pair, width: 1,
                outputs: &[], is_later: false,
            },)*
            $(Column {
                name: stringify!($pair), key: $pair_key, per: Per::Pair, width: $pair_width,
                outputs: &[$(Output::$pair_output),*], is_later: is_later!($pair_age),
            },)*
            $(Column {
                name: stringify!($point), key: $point_key, per: Per::Point, width: $point_width,
                outputs: &[$(Output::$point_output),*], is_later: is_later!($point_age),
            },)*
        ];

        /// Calls a macro with the names of all columns, in the order of [`COLUMNS`].
        #[doc(hidden)]
        #[macro_export]
        macro_rules! with_columns {
            ($d callback:ident) => { $d callback! { $found $($always)* $($pair)* $($point)* } };
        }

        impl Outputs {
            /// Bytes on the wire per pair, without its points.
            pub fn pair_bytes(self) -> usize {
                let always = [$(stringify!($always)),*].len();
                always $(+ if false $(|| self.has(Output::$pair_output))* {
                    size_of::<[$pair_element; $pair_width]>()
                } else {
                    0
                })*
            }

            /// Bytes on the wire per point.
            pub fn point_bytes(self) -> usize {
                0 $(+ if false $(|| self.has(Output::$point_output))* {
                    size_of::<[$point_element; $point_width]>()
                } else {
                    0
                })*
            }
        }

        impl Columns {
            /// Bytes copied per elementary step.
            pub const BYTES_PER_STEP: usize = 4;

            /// The values of each column of the table.
            pub fn values(&self) -> impl Iterator<Item = (&'static Column, Values<'_>)> {
                let values = [
                    Values::from(&self.$found[..]),
                    $(Values::from(&self.$always[..]),)*
                    $(Values::from(&self.$pair[..]),)*
                    $(Values::from(&self.$point[..]),)*
                ];
                COLUMNS.iter().zip(values)
            }

            /// Adds a pair's answer.
            pub fn push(&mut self, manifold: &Manifold, outputs: Outputs) {
                self.solver_iterations += u64::from(manifold.iterations);
                self.outcomes.push(outcome_code(manifold.outcome));
                self.flags.push(flag_bits(manifold));
                $(if false $(|| outputs.has(Output::$pair_output))* {
                    let value = |$manifold: &Manifold| -> [$pair_element; $pair_width] { $pair_value };
                    self.$pair.extend_from_slice(&value(manifold));
                })*
                if outputs.any_points() {
                    self.push_points(manifold, outputs);
                }
            }

            fn push_points(&mut self, manifold: &Manifold, outputs: Outputs) {
                self.points += manifold.points.len();
                $(if false $(|| outputs.has(Output::$point_output))* {
                    let value = |$of_manifold: &Manifold, $of_point: &ContactPoint|
                        -> [$point_element; $point_width] { $point_value };
                    for point in &manifold.points {
                        self.$point.extend_from_slice(&value(manifold, point));
                    }
                })*
            }

            /// Adds a pair without an answer; its numbers are NaN.
            pub fn push_invalid(&mut self, invalid: InvalidPair, outputs: Outputs) {
                self.outcomes.push(outcome::INVALID);
                self.flags.push(invalid.flags());
                $(if false $(|| outputs.has(Output::$pair_output))* {
                    self.$pair.extend_from_slice(&[$invalid; $pair_width]);
                })*
            }

            /// Adds rows of an earlier answer, whose points are `points` of its points. Columns that the earlier
            /// answer does not have stay empty.
            pub(crate) fn push_rows(&mut self, from: &Self, rows: Range<usize>, points: Range<usize>) {
                $(self.$always.extend_from_slice(&from.$always[rows.clone()]);)*
                $(if !from.$pair.is_empty() {
                    let values = rows.start * $pair_width..rows.end * $pair_width;
                    self.$pair.extend_from_slice(&from.$pair[values]);
                })*
                self.points += points.len();
                $(if !from.$point.is_empty() {
                    let values = points.start * $point_width..points.end * $point_width;
                    self.$point.extend_from_slice(&from.$point[values]);
                })*
            }

            /// Appends the next pairs of the same answer.
            pub fn append(&mut self, mut next: Self) {
                if self.is_empty() {
                    *self = next;
                    return;
                }
                self.points += next.points;
                self.solver_iterations += next.solver_iterations;
                self.$found.append(&mut next.$found);
                $(self.$always.append(&mut next.$always);)*
                $(self.$pair.append(&mut next.$pair);)*
                $(self.$point.append(&mut next.$point);)*
            }

            /// Takes the columns that are not sent out, so that the columns of `outputs` remain.
            #[must_use]
            pub fn take_unsent(&mut self, outputs: Outputs) -> Self {
                let mut unsent = Self { points: self.points, ..Self::default() };
                $(if !(false $(|| outputs.has(Output::$pair_output))*) {
                    unsent.$pair = std::mem::take(&mut self.$pair);
                })*
                $(if !(false $(|| outputs.has(Output::$point_output))*) {
                    unsent.$point = std::mem::take(&mut self.$point);
                })*
                unsent
            }

            /// Puts columns that were sent back to those that [`Self::take_unsent`] took out.
            pub fn unite(&mut self, sent: Self) {
                self.$found = sent.$found;
                $(self.$always = sent.$always;)*
                $(if !sent.$pair.is_empty() {
                    self.$pair = sent.$pair;
                })*
                $(if !sent.$point.is_empty() {
                    self.$point = sent.$point;
                })*
            }

            /// Whether all values that are sent are the same, bit by bit.
            pub fn is_same(&self, other: &Self, outputs: Outputs) -> bool {
                let both = self.values().zip(other.values());
                let mut sent = both.filter(|((column, _), _)| {
                    column.per == Per::FoundPair || column.is_sent(outputs)
                });
                sent.all(|((_, one), (_, other))| one.is_same(other))
            }

            /// Joins the parts in order, with one allocation per column.
            ///
            /// # Errors
            /// The work was stopped.
            pub fn concatenated(parts: &[Self], stop: &Stop) -> Result<Self, Stopped> {
                let mut copied = 0;
                let points = parts.iter().map(|part| part.points).sum();
                let solver_iterations = parts.iter().map(|part| part.solver_iterations).sum();
                let mut whole = Self { points, solver_iterations, ..Self::default() };
                join!(whole, parts, copied, stop, [$found $($always)* $($pair)* $($point)*]);
                stop.spend((copied / Self::BYTES_PER_STEP) as u64)?;
                Ok(whole)
            }

            /// The bytes of all elements.
            pub fn filled_bytes(&self) -> usize {
                size_of_val(&self.$found[..])
                    $(+ size_of_val(&self.$always[..]))*
                    $(+ size_of_val(&self.$pair[..]))*
                    $(+ size_of_val(&self.$point[..]))*
            }

            /// Removes all pairs; the allocated memory stays.
            pub fn clear(&mut self) {
                self.$found.clear();
                $(self.$always.clear();)*
                $(self.$pair.clear();)*
                $(self.$point.clear();)*
                self.points = 0;
                self.solver_iterations = 0;
            }

            /// The bytes of allocated memory.
            pub fn heap_bytes(&self) -> usize {
                self.$found.capacity() * size_of::<$found_element>()
                    $(+ self.$always.capacity())*
                    $(+ self.$pair.capacity() * size_of::<$pair_element>())*
                    $(+ self.$point.capacity() * size_of::<$point_element>())*
            }
        }
    };
}

/// Joins the columns of the parts in order.
macro_rules! join {
    ($whole:ident, $parts:ident, $copied:ident, $stop:ident, [$($column:ident)*]) => {
        $($whole.$column.reserve_exact($parts.iter().map(|part| part.$column.len()).sum());
        for part in $parts {
            $whole.$column.extend_from_slice(&part.$column);
            $copied += size_of_val(&part.$column[..]);
            if $copied > BYTES_BETWEEN_LOOKS {
                $stop.spend((std::mem::take(&mut $copied) / Self::BYTES_PER_STEP) as u64)?;
            }
        })*
    };
}

/// Whether a column came after the first version of the contract.
macro_rules! is_later {
    (first) => {
        false
    };
    (later) => {
        true
    };
}

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
        assert_eq!(COLUMNS.len(), 21);
        assert_eq!(Outputs::of(Output::ALL.iter().copied()).pair_bytes(), 2 + 24 + 32 + 4 + 18 + 24 + 16 + 4);
    }
}

//! The macro that declares all columns. It is used once, for the table.

/// Bytes that are copied between two checks of the stop flag: about half a millisecond.
pub(super) const BYTES_BETWEEN_LOOKS: usize = 2 << 20;

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
        derivative { $(
            $(#[doc = $derivative_doc:literal])*
            $derivative:ident: [f64; $derivative_width:literal], $derivative_key:literal,
            of [$($derivative_output:ident)*] = |$derivatives:ident| $derivative_value:expr;
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
            $($(#[doc = $derivative_doc])* pub $derivative: Vec<f64>,)*
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
                name: stringify!($derivative), key: $derivative_key, per: Per::Pair, width: $derivative_width,
                outputs: &[$(Output::$derivative_output),*], is_later: true,
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
            ($d callback:ident) => { $d callback! { $found $($always)* $($pair)* $($derivative)* $($point)* } };
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
                $(+ if false $(|| self.has(Output::$derivative_output))* {
                    size_of::<[f64; $derivative_width]>()
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
                    $(Values::from(&self.$derivative[..]),)*
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

            /// Adds the derivatives of the pair that was added last; NaN if it has none.
            pub fn push_derivatives(&mut self, found: Option<&Derivatives>, outputs: Outputs) {
                if let Some(flags) = self.flags.last_mut() {
                    *flags |= bit(found.is_some_and(|found| found.kink), flag::KINK);
                }
                $(if false $(|| outputs.has(Output::$derivative_output))* {
                    let value = |$derivatives: &Derivatives| -> [f64; $derivative_width] { $derivative_value };
                    let none = [f64::NAN; $derivative_width];
                    self.$derivative.extend_from_slice(&found.map_or(none, value));
                })*
            }

            /// Adds a pair without an answer; its numbers are NaN.
            pub fn push_invalid(&mut self, invalid: InvalidPair, outputs: Outputs) {
                self.outcomes.push(outcome::INVALID);
                self.flags.push(invalid.flags());
                $(if false $(|| outputs.has(Output::$pair_output))* {
                    self.$pair.extend_from_slice(&[$invalid; $pair_width]);
                })*
                self.push_derivatives(None, outputs);
            }

            /// Adds rows of an earlier answer, whose points are `points` of its points. Columns that the earlier
            /// answer does not have stay empty.
            pub(crate) fn push_rows(&mut self, from: &Self, rows: Range<usize>, points: Range<usize>) {
                $(self.$always.extend_from_slice(&from.$always[rows.clone()]);)*
                $(if !from.$pair.is_empty() {
                    let values = rows.start * $pair_width..rows.end * $pair_width;
                    self.$pair.extend_from_slice(&from.$pair[values]);
                })*
                $(if !from.$derivative.is_empty() {
                    let values = rows.start * $derivative_width..rows.end * $derivative_width;
                    self.$derivative.extend_from_slice(&from.$derivative[values]);
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
                $(self.$derivative.append(&mut next.$derivative);)*
                $(self.$point.append(&mut next.$point);)*
            }

            /// Takes the columns that are not sent out, so that the columns of `outputs` remain.
            #[must_use]
            pub fn take_unsent(&mut self, outputs: Outputs) -> Self {
                let mut unsent = Self { points: self.points, ..Self::default() };
                $(if !(false $(|| outputs.has(Output::$pair_output))*) {
                    unsent.$pair = std::mem::take(&mut self.$pair);
                })*
                $(if !(false $(|| outputs.has(Output::$derivative_output))*) {
                    unsent.$derivative = std::mem::take(&mut self.$derivative);
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
                $(if !sent.$derivative.is_empty() {
                    self.$derivative = sent.$derivative;
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
                join!(whole, parts, copied, stop, [$found $($always)* $($pair)* $($derivative)* $($point)*]);
                stop.spend((copied / Self::BYTES_PER_STEP) as u64)?;
                Ok(whole)
            }

            /// The bytes of all elements.
            pub fn filled_bytes(&self) -> usize {
                size_of_val(&self.$found[..])
                    $(+ size_of_val(&self.$always[..]))*
                    $(+ size_of_val(&self.$pair[..]))*
                    $(+ size_of_val(&self.$derivative[..]))*
                    $(+ size_of_val(&self.$point[..]))*
            }

            /// Removes all pairs; the allocated memory stays.
            pub fn clear(&mut self) {
                self.$found.clear();
                $(self.$always.clear();)*
                $(self.$pair.clear();)*
                $(self.$derivative.clear();)*
                $(self.$point.clear();)*
                self.points = 0;
                self.solver_iterations = 0;
            }

            /// The bytes of allocated memory.
            pub fn heap_bytes(&self) -> usize {
                self.$found.capacity() * size_of::<$found_element>()
                    $(+ self.$always.capacity())*
                    $(+ self.$pair.capacity() * size_of::<$pair_element>())*
                    $(+ self.$derivative.capacity() * size_of::<f64>())*
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

//! The row of a column in the table, and a column's values.

use crate::outputs::{Output, Outputs};

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

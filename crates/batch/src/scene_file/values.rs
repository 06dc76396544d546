//! The values of scene files. Their errors say what a user may write, where serde would name a type of Rust. A
//! row that is too long is refused by its length, where serde's JSON would report a fault of the syntax.

use std::{fmt, marker::PhantomData};

use serde::{
    Deserialize, Deserializer,
    de::{Error, IgnoredAny, SeqAccess, Unexpected, Visitor},
};

/// An index of a hull or a body.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct JsonIndex(pub(super) u32);

/// A number.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct JsonNumber(pub(super) f64);

/// A list of `N` values.
#[derive(Clone, Copy, Debug)]
pub(super) struct JsonRow<T, const N: usize>(pub(super) [T; N]);

impl<const N: usize> JsonRow<JsonNumber, N> {
    /// The numbers.
    pub(super) fn numbers(self) -> [f64; N] {
        self.0.map(|JsonNumber(number)| number)
    }
}

/// A value that rows have.
pub(super) trait RowEntry: Copy + Default {
    /// Several of these values, in the words of an error.
    const PLURAL: &str;
}

impl RowEntry for JsonIndex {
    const PLURAL: &str = "indices";
}

impl RowEntry for JsonNumber {
    const PLURAL: &str = "numbers";
}

/// A list of points or quaternions.
pub(super) fn rows<'de, D: Deserializer<'de>, const N: usize>(source: D) -> Result<Vec<[f64; N]>, D::Error> {
    let rows = Vec::<JsonRow<JsonNumber, N>>::deserialize(source)?;
    Ok(rows.into_iter().map(JsonRow::numbers).collect())
}

/// A point, or `null`.
pub(super) fn point<'de, D: Deserializer<'de>>(source: D) -> Result<Option<[f64; 3]>, D::Error> {
    Ok(Option::<JsonRow<JsonNumber, 3>>::deserialize(source)?.map(JsonRow::numbers))
}

/// A number, or `null`.
pub(super) fn optional<'de, D: Deserializer<'de>>(source: D) -> Result<Option<f64>, D::Error> {
    Ok(Option::deserialize(source)?.map(|JsonNumber(number)| number))
}

impl<'de> Deserialize<'de> for JsonIndex {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        source.deserialize_u32(IndexVisitor)
    }
}

struct IndexVisitor;

impl Visitor<'_> for IndexVisitor {
    type Value = JsonIndex;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an index, a whole number from 0")
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<JsonIndex, E> {
        let index = value.try_into().map(JsonIndex);
        index.map_err(|_| E::invalid_value(Unexpected::Unsigned(value), &self))
    }
}

impl<'de> Deserialize<'de> for JsonNumber {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        source.deserialize_f64(NumberVisitor)
    }
}

struct NumberVisitor;

impl Visitor<'_> for NumberVisitor {
    type Value = JsonNumber;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<JsonNumber, E> {
        Ok(JsonNumber(value))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<JsonNumber, E> {
        Ok(JsonNumber(value as f64))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<JsonNumber, E> {
        Ok(JsonNumber(value as f64))
    }
}

impl<'de, T: RowEntry + Deserialize<'de>, const N: usize> Deserialize<'de> for JsonRow<T, N> {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        source.deserialize_seq(RowVisitor(PhantomData))
    }
}

struct RowVisitor<T, const N: usize>(PhantomData<T>);

impl<'de, T: RowEntry + Deserialize<'de>, const N: usize> Visitor<'de> for RowVisitor<T, N> {
    type Value = JsonRow<T, N>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{N} {}", T::PLURAL)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<JsonRow<T, N>, A::Error> {
        let mut row = [T::default(); N];
        for (length, entry) in row.iter_mut().enumerate() {
            *entry = list.next_element()?.ok_or_else(|| A::Error::invalid_length(length, &self))?;
        }
        let mut length = N;
        while list.next_element::<IgnoredAny>()?.is_some() {
            length += 1;
        }
        if length > N {
            return Err(A::Error::invalid_length(length, &self));
        }
        Ok(JsonRow(row))
    }
}

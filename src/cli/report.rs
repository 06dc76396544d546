//! An answer, and its form as JSON. `table` and `arrays` have the other forms.

use std::io::{self, Write};
use std::ops::Range;

use serde::ser::{Serialize, SerializeMap, SerializeSeq, Serializer};

use super::scene::{Frame, SceneFile};
use hullcast::batch::columns::{Column, Per, Values};
use hullcast::proto::{self, Flag, Outcome};
use hullcast::service::wire::response_columns;

/// A frame of a scene and its answer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AnsweredFrame<'a> {
    /// The scene of the query.
    pub(crate) scene: &'a SceneFile,
    /// The configuration of the query.
    pub(crate) frame: &'a Frame,
    /// The answer. Columns that were not requested are empty.
    pub(crate) columns: &'a proto::QueryContactsResponse,
}

/// Row `i` of a column with `N` entries per row; `None` if the column was not requested.
pub(super) fn row<T: Copy, const N: usize>(column: &[T], i: usize) -> Option<[T; N]> {
    column.as_chunks::<N>().0.get(i).copied()
}

impl AnsweredFrame<'_> {
    /// Writes every pair as JSON, one per line. Infinities and NaN are written as null.
    ///
    /// # Errors
    /// The output cannot be written.
    pub(crate) fn write_json(&self, out: &mut impl Write) -> io::Result<()> {
        write!(out, "{{\"scene\":{},\"frame\":{}", json(&self.scene.name)?, json(&self.frame.name)?)?;
        write!(out, ",\"invalid_bodies\":{}", json(&self.columns.invalid_bodies)?)?;
        write!(out, ",\"pairs\":[")?;
        // Columns of one key are joined to one list.
        let columns: Vec<_> = response_columns(self.columns).collect();
        let of = |per| {
            columns.chunk_by(|(one, _), (other, _)| one.key == other.key).filter(move |joined| {
                joined.iter().all(|(column, values)| column.per == per && !values.is_empty())
            })
        };
        let (of_pair, of_point): (Vec<_>, Vec<_>) = (of(Per::Pair).collect(), of(Per::Point).collect());
        let mut first_point = 0;
        for i in 0..self.columns.outcomes.len() {
            let points = first_point..first_point + self.point_count(i);
            first_point = points.end;
            let pair = PairJson { answered: self, i, points, of_pair: &of_pair, of_point: &of_point };
            write!(out, "{}\n{}", if i == 0 { "" } else { "," }, json(&pair)?)?;
        }
        writeln!(out, "\n]}}")
    }

    pub(super) fn bodies(&self, i: usize) -> [u32; 2] {
        [self.scene.pairs[2 * i], self.scene.pairs[2 * i + 1]]
    }

    pub(super) fn point_count(&self, i: usize) -> usize {
        self.columns.point_counts.get(i).map_or(0, |&n| n as usize)
    }
}

/// The columns that make one value in the JSON.
type Joined<'a> = &'a [(&'static Column, Values<'a>)];

/// A pair in the JSON. Columns that were not requested are left out.
struct PairJson<'a> {
    answered: &'a AnsweredFrame<'a>,
    i: usize,
    points: Range<usize>,
    of_pair: &'a [Joined<'a>],
    of_point: &'a [Joined<'a>],
}

impl Serialize for PairJson<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { answered, i, of_pair, .. } = *self;
        let pair = answered.bodies(i);
        let names = pair.map(|body| answered.scene.body_names[body as usize].as_str());
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("pair", &pair)?;
        if names.iter().any(|name| !name.is_empty()) {
            map.serialize_entry("names", &names)?;
        }
        for joined in of_pair {
            let key = joined[0].0.key;
            match key {
                "outcome" => map.serialize_entry(key, outcome_name(answered.columns.outcomes[i]))?,
                "flags" => map.serialize_entry(key, &flag_names(answered.columns.flags[i]))?,
                // The points themselves stand in the place of their number.
                "points" => map.serialize_entry(key, &PointsJson(self))?,
                _ => map.serialize_entry(key, &ValueJson(joined, i))?,
            }
        }
        map.end()
    }
}

/// The points of a pair.
struct PointsJson<'a>(&'a PairJson<'a>);

impl Serialize for PointsJson<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let PairJson { points, of_point, .. } = self.0;
        serializer.collect_seq(points.clone().map(|i| PointJson { of_point, i }))
    }
}

/// A point.
struct PointJson<'a> {
    of_point: &'a [Joined<'a>],
    i: usize,
}

impl Serialize for PointJson<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer
            .collect_map(self.of_point.iter().map(|joined| (joined[0].0.key, ValueJson(joined, self.i))))
    }
}

/// The value of a pair or a point in joined columns: a number, or a list of numbers.
struct ValueJson<'a>(Joined<'a>, usize);

impl Serialize for ValueJson<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self(joined, i) = *self;
        let rows = joined.iter().filter_map(|(column, values)| values.row(i, column.width));
        if let [(Column { width: 1, .. }, _)] = joined {
            return match rows.flat_map(numbers).next() {
                Some(number) => number.serialize(serializer),
                None => serializer.serialize_none(),
            };
        }
        let mut list = serializer.serialize_seq(None)?;
        for number in rows.flat_map(numbers) {
            list.serialize_element(&number)?;
        }
        list.end()
    }
}

/// A number of a column.
#[derive(serde::Serialize)]
#[serde(untagged)]
enum ColumnNumber {
    Integer(u32),
    Float(f64),
}

fn numbers(values: Values<'_>) -> Vec<ColumnNumber> {
    match values {
        Values::U8(values) => values.iter().map(|&value| ColumnNumber::Integer(value.into())).collect(),
        Values::U32(values) => values.iter().map(|&value| ColumnNumber::Integer(value)).collect(),
        Values::F64(values) => values.iter().map(|&value| ColumnNumber::Float(value)).collect(),
    }
}

fn json<T: Serialize + ?Sized>(value: &T) -> io::Result<String> {
    Ok(serde_json::to_string(value)?)
}

/// The outcome's name in the contract; `UNKNOWN` for an outcome of a newer server.
pub(super) fn outcome_name(outcome: u8) -> &'static str {
    let known = Outcome::try_from(i32::from(outcome)).ok().filter(|known| *known != Outcome::Unspecified);
    known.and_then(|known| known.as_str_name().strip_prefix("OUTCOME_")).unwrap_or("UNKNOWN")
}

/// The names, in the contract, of the flags that are set. Flags of a newer server are left out.
pub(super) fn flag_names(flags: u8) -> Vec<&'static str> {
    let set = (0..u8::BITS).map(|bit| i32::from(flags) & 1 << bit).filter(|&flag| flag != 0);
    set.filter_map(|flag| Flag::try_from(flag).ok()?.as_str_name().strip_prefix("FLAG_")).collect()
}

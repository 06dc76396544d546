//! An answer, and its form as JSON. `table` and `arrays` have the other forms.

use std::io::{self, Write};

use serde::Serialize;

use super::scene::{Frame, SceneFile};
use hullcast::proto::{self, Flag, Outcome};

/// A frame of a scene and its answer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Answered<'a> {
    /// The scene of the query.
    pub(crate) scene: &'a SceneFile,
    /// The configuration of the query.
    pub(crate) frame: &'a Frame,
    /// The answer. Columns that were not requested are empty.
    pub(crate) columns: &'a proto::QueryContactsResponse,
}

/// A pair in the JSON. Fields that were not requested are left out.
#[derive(Serialize)]
struct PairJson<'a> {
    pair: [u32; 2],
    #[serde(skip_serializing_if = "no_names")]
    names: [&'a str; 2],
    outcome: &'static str,
    flags: Vec<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    alpha: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    alpha_bracket: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    separation: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    normal: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    points: Option<Vec<PointJson>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    feature_kinds: Option<[u8; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    feature_indices: Option<[u32; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    basis: Option<[u32; 6]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    iterations: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    support_calls: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    kept_area: Option<f64>,
}

#[derive(Serialize)]
struct PointJson {
    #[serde(skip_serializing_if = "Option::is_none")]
    witness_a: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    distance: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    witness_b: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    id: Option<[u32; 4]>,
}

fn no_names(names: &[&str; 2]) -> bool {
    names.iter().all(|name| name.is_empty())
}

/// Row `i` of a column with `N` entries per row; `None` if the column was not requested.
pub(super) fn row<T: Copy, const N: usize>(column: &[T], i: usize) -> Option<[T; N]> {
    column.as_chunks::<N>().0.get(i).copied()
}

impl Answered<'_> {
    /// Writes every pair as JSON, one per line. Infinities and NaN are written as null.
    ///
    /// # Errors
    /// The output cannot be written.
    pub(crate) fn write_json(&self, out: &mut impl Write) -> io::Result<()> {
        write!(out, "{{\"scene\":{},\"frame\":{}", json(&self.scene.name)?, json(&self.frame.name)?)?;
        write!(out, ",\"invalid_bodies\":{}", json(&self.columns.invalid_bodies)?)?;
        write!(out, ",\"pairs\":[")?;
        let mut first_point = 0;
        for i in 0..self.columns.outcomes.len() {
            let pair = self.pair(i, first_point);
            first_point += self.point_count(i);
            write!(out, "{}\n{}", if i == 0 { "" } else { "," }, json(&pair)?)?;
        }
        writeln!(out, "\n]}}")
    }

    fn pair(&self, i: usize, first_point: usize) -> PairJson<'_> {
        let c = self.columns;
        let pair = self.bodies(i);
        let counted = c.point_counts.get(i).map(|_| first_point..first_point + self.point_count(i));
        PairJson {
            pair,
            names: pair.map(|body| self.scene.body_names[body as usize].as_str()),
            outcome: outcome_name(c.outcomes[i]),
            flags: flag_names(c.flags[i]),
            alpha: c.alphas.get(i).copied(),
            alpha_bracket: c.alpha_lowers.get(i).zip(c.alpha_uppers.get(i)).map(|(&l, &u)| [l, u]),
            separation: c.separations.get(i).copied(),
            normal: row(&c.normals, i),
            points: counted.map(|points| points.map(|k| self.point(k)).collect()),
            feature_kinds: row(&c.feature_kinds, i),
            feature_indices: row(&c.feature_indices, i),
            basis: row(&c.bases, i),
            iterations: c.iterations.get(i).copied(),
            support_calls: c.support_calls.get(i).copied(),
            kept_area: c.kept_areas.get(i).copied(),
        }
    }

    fn point(&self, k: usize) -> PointJson {
        let c = self.columns;
        PointJson {
            witness_a: row(&c.witness_as, k),
            distance: c.distances.get(k).copied(),
            witness_b: row(&c.witness_bs, k),
            id: row(&c.point_ids, k),
        }
    }

    pub(super) fn bodies(&self, i: usize) -> [u32; 2] {
        [self.scene.pairs[2 * i], self.scene.pairs[2 * i + 1]]
    }

    pub(super) fn point_count(&self, i: usize) -> usize {
        self.columns.point_counts.get(i).map_or(0, |&n| n as usize)
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

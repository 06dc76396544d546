//! Writes an answer as a table, as JSON or as numpy arrays.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use serde::Serialize;

use super::npz::Npz;
use super::scene::{Frame, Scene};
use hullcast::proto::{self, Flag, Outcome};

/// A frame of a scene and its answer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Answered<'a> {
    /// The scene of the query.
    pub(crate) scene: &'a Scene,
    /// The configuration of the query.
    pub(crate) frame: &'a Frame,
    /// The answer. Columns that were not asked for are empty.
    pub(crate) columns: &'a proto::QueryContactsResponse,
}

/// A pair in the JSON. Fields that were not asked for are left out.
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

/// Row `i` of a column with `N` entries per row; none if the column was not asked for.
fn row<T: Copy, const N: usize>(column: &[T], i: usize) -> Option<[T; N]> {
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

    fn bodies(&self, i: usize) -> [u32; 2] {
        [self.scene.pairs[2 * i], self.scene.pairs[2 * i + 1]]
    }

    fn point_count(&self, i: usize) -> usize {
        self.columns.point_counts.get(i).map_or(0, |&n| n as usize)
    }

    /// Writes one line per pair (separated pairs only if `all`), then the sums.
    ///
    /// # Errors
    /// The output cannot be written.
    pub(crate) fn write_table(&self, out: &mut impl Write, all: bool) -> io::Result<()> {
        let c = self.columns;
        let names: Vec<String> = (0..c.outcomes.len()).map(|i| self.label(i)).collect();
        let width = names.iter().map(String::len).max().unwrap_or(0).max(4);
        writeln!(
            out,
            "{:<width$}  {:<9}  {:>20}  {:>9}  {:>13}  {:^29}  points  deepest",
            "pair", "outcome", "alpha", "bracket", "separation", "normal"
        )?;
        let mut first = 0;
        for (i, name) in names.iter().enumerate() {
            let points = first..first + self.point_count(i);
            first = points.end;
            if all || c.outcomes[i] != Outcome::Separated as u8 {
                write!(out, "{name:<width$}  {:<9}  ", outcome_name(c.outcomes[i]))?;
                self.write_numbers(out, i, points)?;
            }
        }
        self.write_sums(out)
    }

    /// The pair's body indices with their names.
    fn label(&self, i: usize) -> String {
        let name = |body: u32| match self.scene.body_names[body as usize].as_str() {
            "" => format!("{body}"),
            name => format!("{body} {name}"),
        };
        let [a, b] = self.bodies(i);
        format!("{} - {}", name(a), name(b))
    }

    fn write_numbers(
        &self,
        out: &mut impl Write,
        i: usize,
        points: std::ops::Range<usize>,
    ) -> io::Result<()> {
        let c = self.columns;
        let number = |x: Option<f64>| x.map_or_else(|| "-".into(), |x| format!("{x:.6e}"));
        let alpha = c.alphas.get(i).map_or_else(|| "-".into(), |a| format!("{a:.16}"));
        let bracket = c.alpha_uppers.get(i).zip(c.alpha_lowers.get(i)).map(|(u, l)| u - l);
        let bracket = bracket.map_or_else(|| "-".into(), |w| format!("{w:.2e}"));
        let normal = row::<_, 3>(&c.normals, i)
            .map_or_else(|| "-".into(), |[x, y, z]| format!("{x:9.6} {y:9.6} {z:9.6}"));
        let deepest = c.distances.get(points.clone()).and_then(|d| d.iter().copied().reduce(f64::min));
        write!(
            out,
            "{alpha:>20}  {bracket:>9}  {:>13}  {normal:^29}  {:>6}  {}",
            number(c.separations.get(i).copied()),
            points.len(),
            number(deepest)
        )?;
        for flag in flag_names(c.flags[i]) {
            write!(out, "  {flag}")?;
        }
        writeln!(out)
    }

    fn write_sums(&self, out: &mut impl Write) -> io::Result<()> {
        let c = self.columns;
        let count = |outcome: Outcome| c.outcomes.iter().filter(|&&o| o == outcome as u8).count();
        let points: u64 = c.point_counts.iter().map(|&n| u64::from(n)).sum();
        let frame = if self.frame.name.is_empty() { String::new() } else { format!(", {}", self.frame.name) };
        write!(
            out,
            "{}{frame}: {} pairs: {} contact, {} separated",
            self.scene.name,
            c.outcomes.len(),
            count(Outcome::Contact),
            count(Outcome::Separated)
        )?;
        for (outcome, name) in [(Outcome::Undecided, "undecided"), (Outcome::Invalid, "invalid")] {
            if count(outcome) > 0 {
                write!(out, ", {} {name}", count(outcome))?;
            }
        }
        writeln!(out, "; {points} points")
    }

    /// Writes `pairs` and the columns under their names in the wire format. Columns with several numbers
    /// per row become two-dimensional arrays.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(crate) fn write_npz(&self, path: &Path) -> io::Result<()> {
        let c = self.columns;
        let mut file = Npz::new(io::BufWriter::new(File::create(path)?));
        file.array("pairs", &self.scene.pairs, 2)?;
        file.array("outcomes", &c.outcomes, 1)?;
        file.array("flags", &c.flags, 1)?;
        let floats: [(&str, &[f64], usize); 8] = [
            ("alphas", &c.alphas, 1),
            ("alpha_lowers", &c.alpha_lowers, 1),
            ("alpha_uppers", &c.alpha_uppers, 1),
            ("separations", &c.separations, 1),
            ("normals", &c.normals, 3),
            ("witness_as", &c.witness_as, 3),
            ("distances", &c.distances, 1),
            ("witness_bs", &c.witness_bs, 3),
        ];
        for (name, column, width) in floats {
            file.array(name, column, width)?;
        }
        file.array("feature_kinds", &c.feature_kinds, 2)?;
        let integers: [(&str, &[u32], usize); 8] = [
            ("point_counts", &c.point_counts, 1),
            ("feature_indices", &c.feature_indices, 4),
            ("point_ids", &c.point_ids, 4),
            ("bases", &c.bases, 6),
            ("iterations", &c.iterations, 1),
            ("support_calls", &c.support_calls, 1),
            ("missing_hulls", &c.missing_hulls, 1),
            ("invalid_bodies", &c.invalid_bodies, 1),
        ];
        for (name, column, width) in integers {
            file.array(name, column, width)?;
        }
        file.finish()?;
        Ok(())
    }
}

fn json<T: Serialize + ?Sized>(value: &T) -> io::Result<String> {
    Ok(serde_json::to_string(value)?)
}

/// The outcome's name in the contract; `UNKNOWN` for an outcome of a newer server.
fn outcome_name(outcome: u8) -> &'static str {
    let known = Outcome::try_from(i32::from(outcome)).ok().filter(|known| *known != Outcome::Unspecified);
    known.and_then(|known| known.as_str_name().strip_prefix("OUTCOME_")).unwrap_or("UNKNOWN")
}

/// The names, in the contract, of the flags that are set. Flags of a newer server are left out.
fn flag_names(flags: u8) -> Vec<&'static str> {
    let set = (0..u8::BITS).map(|bit| i32::from(flags) & 1 << bit).filter(|&flag| flag != 0);
    set.filter_map(|flag| Flag::try_from(flag).ok()?.as_str_name().strip_prefix("FLAG_")).collect()
}

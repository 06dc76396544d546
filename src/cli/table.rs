//! An answer as a table for people, with few digits, and `-` for numbers that were not
//! requested.

use std::io::{self, Write};
use std::ops::Range;

use super::report::{AnsweredFrame, flag_names, outcome_name, row};
use super::values::counted;
use hullcast::proto::Outcome;

/// Shown in place of a number that was not requested or does not exist.
const NONE: &str = "-";

impl AnsweredFrame<'_> {
    /// Writes one line per pair (separated pairs only if `all` is set), then the sums.
    ///
    /// # Errors
    /// The output cannot be written.
    pub(crate) fn write_table(&self, out: &mut impl Write, all: bool) -> io::Result<()> {
        let outcomes = &self.columns.outcomes;
        let mut lines = Vec::new();
        let mut first = 0;
        for (i, &outcome) in outcomes.iter().enumerate() {
            let points = first..first + self.point_count(i);
            first = points.end;
            if all || outcome != Outcome::Separated as u8 {
                lines.push(self.line(i, points));
            }
        }
        if !lines.is_empty() {
            write_aligned(out, &lines)?;
        }
        self.write_sums(out, lines.len())
    }

    /// The cells of a pair.
    fn line(&self, i: usize, points: Range<usize>) -> [String; 8] {
        let c = self.columns;
        let cell = |x: Option<f64>| x.map_or_else(|| NONE.into(), few_digits);
        let bracket = c.alpha_uppers.get(i).zip(c.alpha_lowers.get(i)).map(|(u, l)| u - l);
        let normal = row::<_, 3>(&c.normals, i)
            .map_or_else(|| NONE.into(), |normal| normal.map(|x| format!("{:>7}", places(x, 4))).join(" "));
        let count = c.point_counts.get(i).map_or_else(|| NONE.into(), u32::to_string);
        let deepest = c.distances.get(points).and_then(|d| d.iter().copied().reduce(f64::min));
        [
            self.label(i),
            // The flags come with the outcome that they explain.
            [&[outcome_name(c.outcomes[i])], flag_names(c.flags[i]).as_slice()].concat().join(" "),
            c.alphas.get(i).map_or_else(|| NONE.into(), |&alpha| growth(alpha)),
            bracket.map_or_else(|| NONE.into(), |width| format!("{width:.0e}")),
            cell(c.separations.get(i).copied()),
            normal,
            count,
            cell(deepest),
        ]
    }

    /// The body indices with their names.
    fn label(&self, i: usize) -> String {
        let name = |body: u32| match self.scene.body_names[body as usize].as_str() {
            "" => format!("{body}"),
            name => format!("{body} {name}"),
        };
        let [a, b] = self.bodies(i);
        format!("{} - {}", name(a), name(b))
    }

    fn write_sums(&self, out: &mut impl Write, lines: usize) -> io::Result<()> {
        let c = self.columns;
        let count = |outcome: Outcome| c.outcomes.iter().filter(|&&o| o == outcome as u8).count();
        let frame = if self.frame.name.is_empty() { String::new() } else { format!(", {}", self.frame.name) };
        write!(
            out,
            "{}{frame}: {}, {} in contact, {} separated",
            self.scene.name,
            counted(c.outcomes.len(), "pair"),
            count(Outcome::Contact),
            count(Outcome::Separated)
        )?;
        for (outcome, name) in [(Outcome::Undecided, "undecided"), (Outcome::Invalid, "invalid")] {
            if count(outcome) > 0 {
                write!(out, ", {} {name}", count(outcome))?;
            }
        }
        if !c.point_counts.is_empty() {
            let points: u64 = c.point_counts.iter().map(|&n| u64::from(n)).sum();
            write!(out, "; {}", counted(points, "contact point"))?;
        }
        let left_out = c.outcomes.len() - lines;
        if left_out > 0 {
            write!(out, " (--all lists the separated pairs too)")?;
        }
        writeln!(out)
    }
}

/// Writes the lines below their headings. Names begin at the left, numbers end at the right.
fn write_aligned(out: &mut impl Write, lines: &[[String; 8]]) -> io::Result<()> {
    let head = ["pair", "outcome", "alpha", "bracket", "separation", "normal", "points", "deepest"];
    let width = |column: usize| {
        let cells = lines.iter().map(|line| line[column].chars().count());
        cells.max().unwrap_or(0).max(head[column].len())
    };
    let widths: [usize; 8] = std::array::from_fn(width);
    let mut write_line = |cells: [&str; 8]| {
        let mut text = String::new();
        for (column, (cell, width)) in cells.into_iter().zip(widths).enumerate() {
            text += &match column {
                0 | 1 => format!("{cell:<width$}  "),
                _ => format!("{cell:>width$}  "),
            };
        }
        writeln!(out, "{}", text.trim_end())
    };
    write_line(head)?;
    lines.iter().try_for_each(|line| write_line(line.each_ref().map(String::as_str)))
}

/// A growth scale, with enough digits to show its difference from 1.
fn growth(alpha: f64) -> String {
    if alpha.abs() < 1e4 { places(alpha, 6) } else { few_digits(alpha) }
}

/// The number with this many decimal places, and never a negative zero.
fn places(x: f64, count: usize) -> String {
    let text = format!("{x:.count$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|digit| digit == b'0' || digit == b'.') => rest.to_owned(),
        _ => text,
    }
}

/// Four significant digits, with an exponent only where there would be many zeros.
fn few_digits(x: f64) -> String {
    const DIGITS: i32 = 4;
    if x == 0.0 || !x.is_finite() {
        // Not `-0`.
        return (x + 0.0).to_string();
    }
    let scientific = format!("{x:.3e}");
    // The exponent is that of the rounded number, so that 9.9999e-5 is written as 0.0001.
    let exponent = scientific.split('e').nth(1).and_then(|text| text.parse().ok());
    match exponent {
        Some(exponent @ -4..DIGITS) => places(x, (DIGITS - 1 - exponent) as usize),
        _ => scientific,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches numbers with sixteen digits, negative zeros, and exponents for lengths of
    /// ordinary size.
    #[test]
    fn numbers_are_short() {
        for (x, text) in [
            (0.0, "0"),
            (-0.0, "0"),
            (1.0, "1.000"),
            (-0.000_132_492_8, "-0.0001325"),
            (0.000_099_9, "9.990e-5"),
            (0.000_099_999_99, "0.0001000"),
            (9999.99, "1.000e4"),
            (12.345_678, "12.35"),
            (1234.5678, "1235"),
            (123_456.7, "1.235e5"),
            (f64::INFINITY, "inf"),
            (f64::NAN, "NaN"),
        ] {
            assert_eq!(few_digits(x), text);
        }
        assert_eq!((places(-1e-9, 4), places(-0.5, 4)), ("0.0000".into(), "-0.5000".into()));
        assert_eq!((growth(0.998_377_024_757_573_3), growth(1e9)), ("0.998377".into(), "1.000e9".into()));
    }
}

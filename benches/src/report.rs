//! Formats results as text and writes them into docs/performance.md, between the marks of a section.

use std::fmt::Write as _;
use std::{fs, io, process::Command};

use crate::rounds::Timing;

/// A table with one row per cell and one column per contender, each entry `time (ratio)`.
pub struct Table {
    text: String,
    csv: String,
}

impl Table {
    /// An empty table. `label` is the heading of the column of row names.
    pub fn new(label: &str, contenders: &[&str]) -> Self {
        let mut text = format!("| {label} |");
        for name in contenders {
            let _ = write!(text, " {name} |");
        }
        let _ = write!(text, "\n|---|{}", "---|".repeat(contenders.len()));
        Self {
            text,
            csv: format!("\"{label}\",contender,nanoseconds,times_faster,quartile_low,quartile_high\n"),
        }
    }

    /// Adds a row. The first timing is the reference, which is shown without a ratio.
    pub fn row(&mut self, label: &str, timings: &[Timing]) {
        let _ = write!(self.text, "\n| {label} |");
        for (index, timing) in timings.iter().enumerate() {
            let _ = match index {
                0 => write!(self.text, " {} |", short(timing.nanoseconds)),
                _ => write!(self.text, " {} ({:.2}x) |", short(timing.nanoseconds), timing.ratio),
            };
            let [low, high] = timing.quartiles;
            let Timing { name, nanoseconds, ratio, .. } = timing;
            let _ =
                writeln!(self.csv, "\"{label}\",\"{name}\",{nanoseconds:.1},{ratio:.3},{low:.3},{high:.3}");
        }
    }

    /// The table as Markdown.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// All figures as comma-separated values, for other programs.
    pub fn csv(&self) -> &str {
        &self.csv
    }
}

fn short(nanoseconds: f64) -> String {
    if nanoseconds < 1e4 { format!("{nanoseconds:.0} ns") } else { format!("{:.1} us", nanoseconds / 1e3) }
}

/// The machine, its load, the date and the commit, as every page of measurements states them.
///
/// # Errors
/// The script cannot be run.
pub fn provenance() -> io::Result<String> {
    let output = Command::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../scripts/provenance")).output()?;
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_string())
}

/// The directory of the results.
pub const DOCS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs");

/// Puts `text` between `<!-- section -->` and `<!-- /section -->` of performance.md.
///
/// # Errors
/// The file cannot be read or written, or it lacks these marks.
pub fn replace_section(section: &str, text: &str) -> io::Result<()> {
    let path = format!("{DOCS}/performance.md");
    let (open, close) = (format!("<!-- {section} -->"), format!("<!-- /{section} -->"));
    let old = fs::read_to_string(&path)?;
    let parts = old.split_once(&open).and_then(|(head, rest)| Some((head, rest.split_once(&close)?.1)));
    let (head, tail) = parts.ok_or_else(|| io::Error::other(format!("no {open} in {path}")))?;
    fs::write(path, format!("{head}{open}\n{text}\n{close}{tail}"))
}

//! Results as text, and into docs/performance.md between the marks of their section.

use std::fmt::Write as _;
use std::{fs, io, process::Command};

use crate::rounds::Timing;

/// A table: rows of cells, one contender a column, `time (ratio)`.
pub struct Table {
    text: String,
    csv: String,
}

impl Table {
    /// `label` names the rows.
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

    /// One row; the first timing is the reference, shown without a ratio.
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

    /// Markdown.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Every figure, for other programs.
    pub fn csv(&self) -> &str {
        &self.csv
    }
}

fn short(nanoseconds: f64) -> String {
    if nanoseconds < 1e4 { format!("{nanoseconds:.0} ns") } else { format!("{:.1} us", nanoseconds / 1e3) }
}

/// Machine and how busy it was, date and commit: as every page of measurements has it.
///
/// # Errors
/// Where the script cannot be run.
pub fn provenance() -> io::Result<String> {
    let output = Command::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../scripts/provenance")).output()?;
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_string())
}

/// Where the results go.
pub const DOCS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs");

/// Puts `text` between `<!-- section -->` and `<!-- /section -->` of performance.md.
///
/// # Errors
/// Where the file cannot be read or written or has no such marks.
pub fn replace_section(section: &str, text: &str) -> io::Result<()> {
    let path = format!("{DOCS}/performance.md");
    let (open, close) = (format!("<!-- {section} -->"), format!("<!-- /{section} -->"));
    let old = fs::read_to_string(&path)?;
    let parts = old.split_once(&open).and_then(|(head, rest)| Some((head, rest.split_once(&close)?.1)));
    let (head, tail) = parts.ok_or_else(|| io::Error::other(format!("no {open} in {path}")))?;
    fs::write(path, format!("{head}{open}\n{text}\n{close}{tail}"))
}

//! The tables of the page, and the rows from which its picture is drawn.

use std::fmt::Write;

use super::measure::{Cell, PLANARITIES};
use super::shapes::{ROUNDINGS, Rounding};

/// One row per cell.
pub(super) fn csv(cells: &[Cell]) -> String {
    let mut text =
        String::from("group,rounding,planarity,cases,whole,mean area,least area,alpha,error,edges lost\n");
    for cell in cells {
        let Cell { group, planarity, cases, alpha, error, least_area, .. } = cell;
        let _ = writeln!(
            text,
            "{group},{},{planarity:e},{cases},{:.5},{:.5},{least_area:.5},{alpha:.1e},{error:.2e},{:.5}",
            cell.rounding.name(),
            cell.mean(cell.whole as f64),
            cell.mean(cell.area),
            lost(cell),
        );
    }
    text
}

/// The share of edges sharper than the feature angle that the hull has lost.
fn lost(cell: &Cell) -> f64 {
    1.0 - cell.edges as f64 / cell.all_edges as f64
}

fn names(cells: &[Cell]) -> Vec<&str> {
    let mut names: Vec<_> = cells.iter().map(|cell| cell.group.as_str()).collect();
    names.dedup();
    names
}

fn header(text: &mut String, title: &str) {
    let columns = PLANARITIES.map(|planarity| format!(" {planarity:.0e} |")).concat();
    let rule = "--:|".repeat(PLANARITIES.len());
    let _ = writeln!(text, "{title}, by the planarity:\n\n| shapes |{columns}\n|---|{rule}");
}

/// A Markdown table: one line per group and rounding, and one column per planarity.
fn table(
    text: &mut String,
    cells: &[Cell],
    title: &str,
    roundings: &[Rounding],
    value: impl Fn(&Cell) -> String,
) {
    header(text, title);
    for name in names(cells) {
        for &rounding in roundings {
            let of = |cell: &&Cell| cell.group == name && cell.rounding == rounding;
            let values: String = cells.iter().filter(of).map(|cell| format!(" {} |", value(cell))).collect();
            let _ = writeln!(text, "| {name}, {} |{values}", rounding.name());
        }
    }
    text.push('\n');
}

/// All tables.
pub(super) fn tables(cells: &[Cell], orientations: usize) -> String {
    let counted = hullcast_batch::counted(orientations, "orientation");
    let mut text = format!("Each shape stands on its largest face, in {counted}.\n\n");
    let rounded = &ROUNDINGS[1..];
    let percent = |share: f64| format!("{:.1}", 100.0 * share);
    table(
        &mut text,
        cells,
        "Whole patches (area within 1 % of the unrounded shape's), %",
        &ROUNDINGS,
        |cell| percent(cell.mean(cell.whole as f64)),
    );
    table(
        &mut text,
        cells,
        "Mean area of the patch, divided by that of the unrounded shape",
        rounded,
        |cell| format!("{:.3}", cell.mean(cell.area)),
    );
    let plain = &ROUNDINGS[..1];
    table(&mut text, cells, "Edges sharper than 0.01 rad that are lost by false merges, %", plain, |cell| {
        percent(lost(cell))
    });
    table(&mut text, cells, "Largest error of a face, divided by the circumradius", plain, |cell| {
        format!("{:.1e}", cell.error)
    });
    let two = &[Rounding::None, Rounding::Decimals(6)];
    let first = |cell: &Cell| {
        let same = |other: &&Cell| other.group == cell.group && other.rounding == cell.rounding;
        cells.iter().find(same).cloned().unwrap_or_else(|| cell.clone())
    };
    table(&mut text, cells, "Time to build a hull, divided by that at 1e-6", two, |cell| {
        format!("{:.2}", cell.building / first(cell).building)
    });
    table(&mut text, cells, "Time of a pair, divided by that at 1e-6", two, |cell| {
        format!("{:.2}", cell.answering / first(cell).answering)
    });
    let alpha = cells.iter().map(|cell| cell.alpha).fold(0.0, f64::max);
    let _ = writeln!(text, "Largest relative difference of alpha between planarities: {alpha:.1e}.");
    text
}

//! The tables of the page, and the rows from which its picture is drawn.

use std::fmt::Write;

use super::measure::{PLANARITIES, PlanarityFigures};
use super::shapes::{ROUNDINGS, Rounding};

/// One row per group, rounding and planarity.
pub(super) fn csv(rows: &[PlanarityFigures]) -> String {
    let mut text =
        String::from("group,rounding,planarity,cases,whole,mean area,least area,alpha,error,edges lost\n");
    for figures in rows {
        let PlanarityFigures { group, planarity, cases, alpha, error, least_area, .. } = figures;
        let _ = writeln!(
            text,
            "{group},{},{planarity:e},{cases},{:.5},{:.5},{least_area:.5},{alpha:.1e},{error:.2e},{:.5}",
            figures.rounding.name(),
            figures.mean(figures.whole as f64),
            figures.mean(figures.area),
            lost(figures),
        );
    }
    text
}

/// The share of edges sharper than the feature angle that the hull has lost.
fn lost(figures: &PlanarityFigures) -> f64 {
    1.0 - figures.edges as f64 / figures.all_edges as f64
}

fn names(rows: &[PlanarityFigures]) -> Vec<&str> {
    let mut names: Vec<_> = rows.iter().map(|figures| figures.group.as_str()).collect();
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
    rows: &[PlanarityFigures],
    title: &str,
    roundings: &[Rounding],
    value: impl Fn(&PlanarityFigures) -> String,
) {
    header(text, title);
    for name in names(rows) {
        for &rounding in roundings {
            let of = |figures: &&PlanarityFigures| figures.group == name && figures.rounding == rounding;
            let values: String =
                rows.iter().filter(of).map(|figures| format!(" {} |", value(figures))).collect();
            let _ = writeln!(text, "| {name}, {} |{values}", rounding.name());
        }
    }
    text.push('\n');
}

/// All tables.
pub(super) fn tables(rows: &[PlanarityFigures], orientations: usize) -> String {
    let counted = hullcast_batch::counted(orientations, "orientation");
    let mut text = format!("Each shape stands on its largest face, in {counted}.\n\n");
    let rounded = &ROUNDINGS[1..];
    let percent = |share: f64| format!("{:.1}", 100.0 * share);
    table(
        &mut text,
        rows,
        "Whole patches (area within 1 % of the unrounded shape's), %",
        &ROUNDINGS,
        |figures| percent(figures.mean(figures.whole as f64)),
    );
    table(
        &mut text,
        rows,
        "Mean area of the patch, divided by that of the unrounded shape",
        rounded,
        |figures| format!("{:.3}", figures.mean(figures.area)),
    );
    let plain = &ROUNDINGS[..1];
    table(
        &mut text,
        rows,
        "Edges sharper than 0.01 rad that are lost by false merges, %",
        plain,
        |figures| percent(lost(figures)),
    );
    table(&mut text, rows, "Largest error of a face, divided by the circumradius", plain, |figures| {
        format!("{:.1e}", figures.error)
    });
    let two = &[Rounding::None, Rounding::Decimals(6)];
    let first = |figures: &PlanarityFigures| {
        let same =
            |other: &&PlanarityFigures| other.group == figures.group && other.rounding == figures.rounding;
        rows.iter().find(same).cloned().unwrap_or_else(|| figures.clone())
    };
    table(&mut text, rows, "Time to build a hull, divided by that at 1e-6", two, |figures| {
        format!("{:.2}", figures.building / first(figures).building)
    });
    table(&mut text, rows, "Time of a pair, divided by that at 1e-6", two, |figures| {
        format!("{:.2}", figures.answering / first(figures).answering)
    });
    let alpha = rows.iter().map(|figures| figures.alpha).fold(0.0, f64::max);
    let _ = writeln!(text, "Largest relative difference of alpha between planarities: {alpha:.1e}.");
    text
}

//! The results of a run, level by level: a table, a CSV file and a picture.

use std::fmt::Write;

use super::levels::Level;

/// The results of one level.
#[derive(Clone, Debug)]
pub(crate) struct LevelResult {
    pub(crate) level: Level,
    /// Batches sent per second.
    pub(crate) offered: f64,
    /// Batches answered per second.
    pub(crate) answered: f64,
    pub(crate) pairs: f64,
    /// Milliseconds from the time when a batch was due to its answer: p50, p90, p95, p99, and the
    /// percentile that the user asked for.
    pub(crate) latency: [f64; 5],
    pub(crate) shed: u64,
    pub(crate) errors: u64,
}

const HEAD: &str = "offered batches/s,answered batches/s,pairs/s,p50 ms,p90 ms,p95 ms,p99 ms,shed,errors";

/// The rows as comma-separated values.
pub(crate) fn csv(rows: &[LevelResult]) -> String {
    let kind = rows.first().map_or("level", |row| row.level.kind());
    let mut text = format!("{kind},{HEAD}\n");
    for row in rows {
        let [p50, p90, p95, p99, _] = row.latency;
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{},{:.3},{:.3},{:.1},{p50:.4},{p90:.4},{p95:.4},{p99:.4},{},{}",
            row.level.value(),
            row.offered,
            row.answered,
            row.pairs,
            row.shed,
            row.errors
        );
    }
    text
}

/// The rows as a table for display.
pub(crate) fn table(rows: &[LevelResult]) -> String {
    let csv = csv(rows);
    let cells: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    let width = |column: usize| cells.iter().map(|row| row[column].len()).max().unwrap_or(0);
    let mut text = String::new();
    for row in &cells {
        for (column, cell) in row.iter().enumerate() {
            let _ = write!(text, "{cell:>width$}  ", width = width(column));
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    text
}

const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 420.0;
const BORDER: f64 = 60.0;
/// Shorter latencies are drawn as this one, because a logarithmic axis needs a lower end.
const LEAST_MS: f64 = 1e-4;
const CURVES: [(&str, &str); 3] = [("p50", "#3b7dd8"), ("p95", "#d8893b"), ("p99", "#c23b3b")];

/// Draws latency against offered load, with a linear axis of load from 0 and a logarithmic axis of
/// latency.
pub(super) fn svg(title: &str, rows: &[LevelResult]) -> String {
    let scale = Scale::of(rows);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" \
         font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n\
         <text x=\"{BORDER}\" y=\"24\" font-size=\"14\">{}</text>\n",
        title.replace('&', "&amp;").replace('<', "&lt;")
    );
    scale.draw(&mut svg);
    let mut ordered: Vec<&LevelResult> = rows.iter().collect();
    ordered.sort_by(|a, b| a.offered.total_cmp(&b.offered));
    for (curve, (name, colour)) in CURVES.into_iter().enumerate() {
        let point =
            |row: &&LevelResult| format!("{:.1},{:.1}", scale.x(row.offered), scale.y(drawn(row)[curve]));
        let points: Vec<String> = ordered.iter().map(point).collect();
        let _ = writeln!(
            svg,
            "<polyline fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\" points=\"{}\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" fill=\"{colour}\">{name}</text>",
            points.join(" "),
            WIDTH - BORDER + 8.0,
            BORDER + 16.0 * curve as f64
        );
    }
    svg.push_str("</svg>\n");
    svg
}

/// The latencies of the row that have curves.
fn drawn(row: &LevelResult) -> [f64; CURVES.len()] {
    [row.latency[0], row.latency[2], row.latency[3]]
}

/// Maps loads and latencies to places in the picture.
struct Scale {
    most_load: f64,
    /// The lowest and the highest decade of milliseconds.
    decades: [f64; 2],
}

impl Scale {
    fn of(rows: &[LevelResult]) -> Self {
        let latencies = || rows.iter().flat_map(drawn);
        let low = latencies().fold(f64::INFINITY, f64::min).max(LEAST_MS).log10().floor();
        let high = latencies().fold(1e-3, f64::max).log10().ceil().max(low + 1.0);
        let most_load = rows.iter().map(|row| row.offered).fold(1e-9, f64::max);
        Self { most_load, decades: [low, high] }
    }

    fn x(&self, load: f64) -> f64 {
        BORDER + load / self.most_load * (WIDTH - 2.0 * BORDER)
    }

    fn y(&self, ms: f64) -> f64 {
        let [low, high] = self.decades;
        HEIGHT - BORDER - (ms.max(LEAST_MS).log10() - low) / (high - low) * (HEIGHT - 2.0 * BORDER)
    }

    /// Draws the lines and labels of both axes.
    fn draw(&self, svg: &mut String) {
        let [low, high] = self.decades.map(|decade| decade as i32);
        for decade in low..=high {
            let ms = 10_f64.powi(decade);
            let at = self.y(ms);
            let _ = writeln!(
                svg,
                "<path d=\"M{BORDER} {at:.1}H{:.1}\" stroke=\"#ddd\"/><text x=\"{:.1}\" y=\"{:.1}\" \
                 text-anchor=\"end\">{ms}</text>",
                WIDTH - BORDER,
                BORDER - 6.0,
                at + 4.0
            );
        }
        for part in 0..=5 {
            let load = self.most_load * f64::from(part) / 5.0;
            let _ = writeln!(
                svg,
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{load:.0}</text>",
                self.x(load),
                HEIGHT - BORDER + 18.0
            );
        }
        let _ = writeln!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">offered batches/s</text>\
             <text x=\"14\" y=\"{:.1}\">ms</text>",
            WIDTH / 2.0,
            HEIGHT - 16.0,
            BORDER - 12.0
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a column under another one's heading, and a picture that does not contain the worst level.
    #[test]
    fn rows_are_written_under_their_heads() {
        let row = |rate: f64, ms: f64| LevelResult {
            level: Level::Rate(rate),
            offered: rate,
            answered: rate - 1.0,
            pairs: 64.0 * rate,
            latency: [ms, 2.0 * ms, 3.0 * ms, 4.0 * ms, 4.0 * ms],
            shed: 5,
            errors: 6,
        };
        let rows = [row(10.0, 0.25), row(20.0, 100.0)];
        let text = csv(&rows);
        let [head, first, _] = text.lines().collect::<Vec<_>>()[..] else { panic!("{text}") };
        let cell = |name: &str| {
            let column = head.split(',').position(|head| head == name).unwrap();
            first.split(',').nth(column).unwrap().parse::<f64>().unwrap()
        };
        let heads = ["request rate", "answered batches/s", "pairs/s", "p50 ms", "p99 ms", "shed", "errors"];
        assert_eq!(heads.map(cell), [10.0, 9.0, 640.0, 0.25, 1.0, 5.0, 6.0]);
        let picture = svg("a < b", &rows);
        assert!(picture.contains("a &lt; b") && picture.matches("<polyline").count() == 3);
        let numbers = picture.split("points=\"").skip(1).flat_map(|part| {
            let points = part.split('"').next().unwrap();
            points.split([' ', ',']).map(|n| n.parse::<f64>().unwrap()).collect::<Vec<_>>()
        });
        assert!(numbers.clone().count() == 12 && numbers.into_iter().all(|n| (0.0..=WIDTH).contains(&n)));
        assert_eq!(table(&rows).lines().count(), 3);
    }
}

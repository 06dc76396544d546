//! Writes the matrix as a table, a page and a picture.

use std::fmt::Write as _;

use hullcast_contact::Solver;

use crate::judge::{MEASURES, SolverScore};
use crate::matrix::Score;

/// The counts of a cell, with their names.
fn counts(cell: &SolverScore) -> [(&'static str, usize); 6] {
    [
        ("cases", cell.cases),
        ("failures", cell.failures),
        ("GAP_OPEN", cell.gap_open),
        ("COINCIDENT", cell.coincident),
        ("UNDECIDED", cell.undecided),
        ("ESTIMATED", cell.estimated),
    ]
}

fn cells(scores: &[Score]) -> impl Iterator<Item = (&Score, &'static str, &SolverScore)> {
    scores.iter().flat_map(|score| {
        Solver::ALL
            .map(Solver::name)
            .into_iter()
            .zip(&score.cells)
            .map(move |(solver, cell)| (score, solver, cell))
    })
}

/// Every failure, with its row and solver.
pub(crate) fn failures(scores: &[Score]) -> Vec<String> {
    let of = |(score, solver, cell): (&Score, &str, &SolverScore)| -> Vec<String> {
        cell.failed.iter().map(|f| format!("{}, {}, {solver}: {f}", score.axis, score.value)).collect()
    };
    cells(scores).flat_map(of).collect()
}

/// The fraction of a cell's cases with a flag that excuses an error; ESTIMATED is left out.
fn flagged(cell: &SolverScore) -> String {
    let flagged = cell.gap_open + cell.coincident + cell.undecided;
    if flagged == 0 { "·".into() } else { format!("{:.1} %", 100.0 * flagged as f64 / cell.cases as f64) }
}

/// The Markdown table with one line per row and solver.
pub(crate) fn table(scores: &[Score]) -> String {
    let names = counts(&scores[0].cells[0]).map(|(name, _)| name);
    let [names, measures] = [names.join(" | "), MEASURES.join(" | ")];
    let mut text = format!("| axis | value | solver | {names} | flagged | {measures} |\n");
    let _ = writeln!(
        text,
        "|---|---|---|{}",
        "--:|".repeat(counts(&scores[0].cells[0]).len() + 1 + MEASURES.len())
    );
    for (score, solver, cell) in cells(scores) {
        let counts = counts(cell).map(|(_, n)| if n == 0 { "·".into() } else { n.to_string() });
        let worst = cell.worst.map(|w| if w == 0.0 { "·".into() } else { format!("{w:.1e}") });
        let _ = writeln!(
            text,
            "| {} | {} | {solver} | {} | {} | {} |",
            score.axis,
            score.value,
            counts.join(" | "),
            flagged(cell),
            worst.join(" | ")
        );
    }
    text
}

/// The Markdown table with one line per solver, over all rows.
pub(crate) fn summary(scores: &[Score]) -> String {
    let mut text = format!("| solver | cells | cases | failures | {} |\n", MEASURES.join(" | "));
    let _ = writeln!(text, "|---|--:|--:|--:|{}", "--:|".repeat(MEASURES.len()));
    for (i, solver) in Solver::ALL.map(Solver::name).iter().enumerate() {
        let all = || scores.iter().map(|s| &s.cells[i]);
        let (cases, failures): (usize, usize) =
            all().fold((0, 0), |(cases, failures), c| (cases + c.cases, failures + c.failures));
        let worst = |m: usize| all().map(|c| c.worst[m]).fold(0.0, f64::max);
        let worst: Vec<String> = (0..MEASURES.len()).map(|m| format!("{:.2}", worst(m))).collect();
        let _ =
            writeln!(text, "| {solver} | {} | {cases} | {failures} | {} |", scores.len(), worst.join(" | "));
    }
    text
}

/// The number of features that were compared with the definition, and of answers that had to be
/// ESTIMATED.
pub(crate) fn features(scores: &[Score]) -> ([usize; 3], usize) {
    let met = || scores.iter().flat_map(|s| &s.cells).map(|cell| cell.counts);
    let touched = met().fold([0; 3], |sum, met| std::array::from_fn(|i| sum[i] + met.touched[i]));
    (touched, met().map(|met| met.due).sum())
}

const PAGE: &str = "\
# Numerical stability

`make stability` compares answers at numerical extremes with exact ones and writes this page. Each row of the
table below is one value of an axis, such as a scale or an aspect ratio. A row has many seeded pairs, and each pair
is answered by both solvers.

The exact answers are those for the given floats, in integers of any length. A quaternion is a rational
rotation, so every vertex of the Minkowski difference is an integer vector in one common unit. The growth scale
comes from an exact simplex method, `s(n)` of the returned normal from every vertex, and the distance from an exact
GJK. `u` is 2^-53, `R` and `r` are the sums of the circumradii and inradii about the contraction points, `M` is the
sum of the lengths that enter the centre offset `d`, and `L` is the distance from the world's origin. A measure is
the worst error as a fraction of its budget:

| measure | error | budget |
|---|---|---|
| alpha | difference from the exact growth scale | `alpha tol + 16 u alpha R/r + 16 u M/r` |
| bracket | its width. An exact alpha outside the bracket is a failure | `upper (tol + 64 u R/r) + 32 u M/r` |
| normal | the exact growth scale minus the lower bound that the normal proves | that of alpha |
| separation | difference from `s(n)` | `64 u (R + d) + 16 u M` |
| outcome | distance beyond the margin of a CONTACT. A SEPARATED pair within the margin is a failure | the rounding band, which is that of separation |
| witness | distance outside its hull, unless ESTIMATED | faces' planarity, `64 u (R + M)`, `4 u L` |
| distance | of a point, below `s(n)` | that of separation, and twice the planarity |

- **Outcomes** are asked for cold, warm and from arbitrary vertices, with points, without them and as the only
  output, at the margins of the row, at 0 and within 1e-12 of the pair's own distance.
- **Features** are compared with the definition by a search of all faces, edges and vertices, at feature angles of 0,
  0.01, 0.1 and 0.5, and ESTIMATED with the projected features. The certificate checks every answer too.
- **Flags** excuse only the error that they name: GAP_OPEN the width, COINCIDENT alpha and normal. Only rows about
  GAP_OPEN or COINCIDENT may be flagged in more than one case of a hundred, and their cases must be flagged where
  the flag is due. The column *flagged* leaves out ESTIMATED.
- **A failure** is any error over its budget without a flag. The rows of powers of two also compare the bits of alpha,
  bracket, normal and basis.
";

/// The page of the matrix: the measures, the totals, the picture and the rows.
pub(crate) fn page(scores: &[Score], provenance: &str) -> String {
    let picture = "![Worst error of each row as a fraction of its budget](stability.svg)";
    let ([vertices, edges, faces], due) = features(scores);
    format!(
        "{PAGE}\n{provenance}\n\n{}\nFeatures compared with the definition: {vertices} vertices, {edges} edges, \
         {faces} faces; {due} answers had to be ESTIMATED.\n\n{picture}\n\n## Rows\n\n{}",
        summary(scores),
        table(scores)
    )
}

/// Pixels: the width and height of a cell, the width of the labels, the height of the head.
const CELL: [usize; 2] = [34, 13];
const LABELS: usize = 250;
const HEAD: usize = 100;

/// An SVG heat map with one line per row of the matrix and one column per measure and solver. The
/// colour shows the worst error as a fraction of its budget.
pub(crate) fn heat_map(scores: &[Score]) -> String {
    let width = LABELS + (2 * MEASURES.len() + 1) * CELL[0] + 20;
    let height = HEAD + scores.len() * CELL[1] + 50;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         font-family=\"sans-serif\" font-size=\"10\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    for (i, solver) in Solver::ALL.map(Solver::name).iter().enumerate() {
        let left = |m: usize| LABELS + (i * (MEASURES.len() + 1) + m) * CELL[0];
        let _ = writeln!(svg, "<text x=\"{}\" y=\"14\" font-weight=\"bold\">{solver}</text>", left(0));
        for (m, name) in MEASURES.iter().enumerate() {
            let x = left(m) + CELL[0] / 2;
            let _ =
                writeln!(svg, "<text transform=\"translate({x},{}) rotate(-60)\">{name}</text>", HEAD - 6);
            for (row, score) in scores.iter().enumerate() {
                let (cell, y) = (&score.cells[i], HEAD + row * CELL[1]);
                let _ = writeln!(
                    svg,
                    "<rect x=\"{}\" y=\"{y}\" width=\"{}\" height=\"{}\" fill=\"{}\"/>",
                    left(m),
                    CELL[0] - 1,
                    CELL[1] - 1,
                    colour(cell.worst[m]),
                );
            }
        }
    }
    let mut before = "";
    for (row, score) in scores.iter().enumerate() {
        let y = HEAD + row * CELL[1] + 10;
        if score.axis != before {
            let _ = writeln!(svg, "<text x=\"6\" y=\"{y}\" font-weight=\"bold\">{}</text>", score.axis);
            let line = y - 10;
            let _ = writeln!(svg, "<path d=\"M6 {line}H{width}\" stroke=\"#999\" stroke-width=\"0.5\"/>");
        }
        before = score.axis;
        let _ =
            writeln!(svg, "<text x=\"{}\" y=\"{y}\" text-anchor=\"end\">{}</text>", LABELS - 8, score.value);
    }
    legend(&mut svg, height - 36);
    svg + "</svg>\n"
}

fn legend(svg: &mut String, y: usize) {
    let steps = [
        ("0", 0.0),
        ("≤ 1e-3", 1e-4),
        ("1e-2", 5e-3),
        ("0.1", 0.05),
        ("0.5", 0.3),
        ("1", 0.9),
        ("over budget", 2.0),
    ];
    let _ = writeln!(svg, "<text x=\"6\" y=\"{}\">worst error, share of its budget:</text>", y + 10);
    for (i, (name, share)) in steps.iter().enumerate() {
        let x = 190 + 78 * i;
        let fill = colour(*share);
        let _ = writeln!(
            svg,
            "<rect x=\"{x}\" y=\"{y}\" width=\"14\" height=\"13\" fill=\"{fill}\" stroke=\"#bbb\"/>"
        );
        let _ = writeln!(svg, "<text x=\"{}\" y=\"{}\">{name}</text>", x + 18, y + 10);
    }
}

/// White to dark blue on a logarithmic scale; red beyond the budget.
fn colour(share: f64) -> &'static str {
    match share {
        0.0 => "#f7f7f7",
        s if s <= 1e-3 => "#e3eef9",
        s if s <= 1e-2 => "#c2daef",
        s if s <= 0.1 => "#8cbfdd",
        s if s <= 0.5 => "#4a90c4",
        s if s <= 1.0 => "#1d5c9c",
        _ => "#d7301f",
    }
}

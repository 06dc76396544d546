//! Numerical stability at the extremes. A matrix has one row per value of an axis, and every row is
//! run with both solvers. Further tests hold inputs that broke real libraries, failures found by
//! fuzzing, and properties that need no known answer. Every answer is compared with the exact one.
//!
//! `make stability` runs the whole matrix and writes `docs/stability.md`; `make stability-long`
//! runs the long sweeps.

mod case;
mod derivatives;
mod determinism;
mod exact;
mod frames;
mod fuzzed;
mod gauss;
mod judge;
mod long;
mod matrix;
mod metamorphic;
mod named;
mod oracle;
#[allow(dead_code)]
#[path = "../workload/polygon.rs"]
mod polygon;
mod refused;
mod regressions;
mod report;
#[path = "../scene/mod.rs"]
mod scene;
mod starts;

use matrix::{Score, of_every_row, run};

/// Cases per row: `FEW` in `cargo test`, `MANY` in `make stability`.
const FEW: usize = 60;
const MANY: usize = 2000;

fn scores(cases: usize) -> Vec<Score> {
    of_every_row(|row| run(row, cases))
}

/// Runs 60 cases of every row of the matrix. Catches an answer that is wrong without a flag, and a
/// flag that is raised without need. The counts of features show that the comparison of features
/// was not vacuous.
#[test]
fn the_matrix_is_met() {
    let scores = scores(FEW);
    let failures = report::failures(&scores);
    assert!(failures.is_empty(), "{failures:#?}");
    assert!(scores.len() > 120);
    let (touched, due) = report::features(&scores);
    assert!(touched.iter().all(|&count| count > 10_000) && due > 10_000, "{touched:?} {due}");
}

/// Runs the whole matrix. If the environment variable STABILITY names a directory, writes the page
/// and the picture there.
#[test]
#[ignore = "make stability"]
fn the_whole_matrix_is_met() {
    let scores = scores(MANY);
    let (summary, table) = (report::summary(&scores), report::table(&scores));
    println!("{table}\n{summary}");
    if let Some(directory) = std::env::var_os("STABILITY").map(std::path::PathBuf::from) {
        let write =
            |name: &str, text: &str| std::fs::write(directory.join(name), text).expect("a file to write");
        let provenance = std::env::var("PROVENANCE").unwrap_or_default();
        write("stability.md", &report::page(&scores, &provenance));
        write("stability.svg", &report::heat_map(&scores));
    }
    let failures = report::failures(&scores);
    assert!(failures.is_empty(), "{failures:#?}");
}

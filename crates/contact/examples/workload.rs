//! Checks every pair of a workload file (docs/workload.md) against its exact answer, with both solvers; run by `make
//! workload WORKLOAD=path`.
//!
//! Prints counts and the worst fraction of each error budget. Fails if any pair exceeds a budget.

#[path = "../tests/workload/check.rs"]
mod check;
#[path = "../tests/workload/double_double.rs"]
mod double_double;
#[path = "../tests/workload/format.rs"]
mod format;
#[path = "../tests/workload/polygon.rs"]
mod polygon;
#[path = "../tests/workload/truth.rs"]
mod truth;

use std::process::ExitCode;

use hullcast_contact::Solver;

/// The number of violations that are printed for each family, regime and solver.
const SHOWN: usize = 5;

fn main() -> ExitCode {
    let Some(path) = std::env::args_os().nth(1) else {
        eprintln!("usage: workload FILE");
        return ExitCode::from(2);
    };
    let families = match std::fs::read(&path).and_then(|bytes| format::parse(&bytes)) {
        Ok(families) => families,
        Err(error) => {
            eprintln!("{}: {error}", path.display());
            return ExitCode::from(2);
        }
    };
    let mut rows = Vec::new();
    for solver in Solver::ALL {
        for family in &families {
            rows.push((family.name, solver, check::check_family(family, solver)));
        }
    }
    println!("{}", check::table(&rows));
    let mut violations = 0;
    for (family, solver, scores) in &rows {
        for (regime, score) in format::REGIMES.iter().zip(scores) {
            violations += score.violations.len();
            for violation in score.violations.iter().take(SHOWN) {
                println!("{family} {regime} {solver:?}: {violation}");
            }
        }
    }
    println!("{violations} violations");
    ExitCode::from(u8::from(violations > 0))
}

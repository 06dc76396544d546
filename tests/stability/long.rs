//! Seeded sweeps: `make stability-long`. A million cases by the certificate, a
//! hundred thousand by the exact answers with each solver; THOUSANDS for fewer.

use hullcast::contact::{Accuracy, Outcome, Workspace, certificate, contact_manifold};

use crate::case::Case;
use crate::judge::SOLVERS;
use crate::matrix::{Row, of_every_row, rows, run};
use crate::report;

/// Cases in thousands by the certificate; a tenth of it by the exact answers.
fn thousands() -> usize {
    std::env::var("THOUSANDS").ok().and_then(|n| n.parse().ok()).unwrap_or(1000)
}

/// Cases of a row, so that all rows, large hulls thinned out, have `wanted` at least.
fn of_each(rows: &[Row], wanted: usize) -> usize {
    let all = |each: usize| rows.iter().map(|row| row.thinned_out(each)).sum::<usize>();
    (wanted.div_ceil(rows.len())..).find(|&each| all(each) >= wanted).unwrap_or(wanted)
}

/// Each row's cases go on where `make stability` ends.
#[test]
#[ignore = "make stability-long"]
fn many_cases_by_the_exact_answers() {
    let rows = rows();
    let wanted = 100 * thousands();
    let each = of_each(&rows, wanted);
    let scores = of_every_row(|row| run(row.reseeded(1), each));
    println!("{}", report::summary(&scores));
    let cases = scores.iter().map(|score| score.cells[0].cases).sum::<usize>();
    assert!(cases >= wanted, "{cases} of {wanted}");
    let failures = report::failures(&scores);
    assert!(failures.is_empty(), "{failures:#?}");
}

/// Answers GAP_OPEN or UNDECIDED.
#[derive(Clone, Copy, Default)]
struct Open {
    /// Of cases that limit the solver's iterations.
    limited: usize,
    /// Of others.
    others: usize,
}

/// What a seed's case found: UNDECIDED, GAP_OPEN and all else by the certificate.
fn violation(case: &Case, workspace: &mut Workspace, open: &mut Open) -> Option<String> {
    let limited = case.max_iterations < Accuracy::default().max_iterations;
    let count = if limited { &mut open.limited } else { &mut open.others };
    let [a, b] = case.bodies();
    for solver in SOLVERS {
        for margin in [f64::INFINITY, 0.0].into_iter().chain(case.margins.iter().copied()) {
            let mut query = case.query(margin);
            query.accuracy.solver = solver;
            let answer = contact_manifold(&a, &b, &query, None, workspace);
            *count += usize::from(answer.flags.gap_open || answer.outcome == Outcome::Undecided);
            if let Err(violation) = certificate::check(&a, &b, &query, answer) {
                return Some(format!("{solver:?}, margin {margin:e}: {violation}\n{case:?}"));
            }
        }
    }
    None
}

#[test]
#[ignore = "make stability-long"]
fn a_million_cases_by_the_certificate() {
    let wanted = 1000 * thousands();
    let each = of_each(&rows(), wanted);
    let counts = of_every_row(|mut row| {
        let random = &mut row.random(2);
        // Making large hulls' cases costs more than answering them: they are thinned out.
        let (mut workspace, mut open, cases) = (Workspace::default(), Open::default(), row.thinned_out(each));
        for _ in 0..cases {
            let case = row.case(random);
            if let Some(violation) = violation(&case, &mut workspace, &mut open) {
                panic!("{}, {}: {violation}", row.axis, row.value);
            }
        }
        (cases, open)
    });
    let cases: usize = counts.iter().map(|(cases, _)| cases).sum();
    let open = |of: fn(&Open) -> usize| counts.iter().map(|(_, open)| of(open)).sum::<usize>();
    let (limited, others) = (open(|open| open.limited), open(|open| open.others));
    println!(
        "{cases} cases by the certificate; GAP_OPEN or UNDECIDED: {limited} answers with limited \
         iterations, {others} others"
    );
    assert!(limited > 0, "no limit was reached");
    assert_eq!(others, 0, "left open without a limit");
    assert!(cases >= wanted, "{cases} of {wanted}");
}

//! Long seeded sweeps, run by `make stability-long`. A million cases are checked by the
//! certificate, and a hundred thousand by the exact answers of both solvers. The environment
//! variable THOUSANDS sets another size.

use hullcast_contact::{Accuracy, Outcome, Solver, Workspace, certificate, contact_manifold};

use crate::case::Case;
use crate::matrix::{Row, of_every_row, rows, run};
use crate::report;

/// The number of thousands of cases for the certificate; a tenth as many are compared exactly.
fn thousands() -> usize {
    std::env::var("THOUSANDS").ok().and_then(|n| n.parse().ok()).unwrap_or(1000)
}

/// The number of cases per row with which all rows together have at least `wanted` cases, although
/// rows with large hulls run fewer.
fn of_each(rows: &[Row], wanted: usize) -> usize {
    let all = |each: usize| rows.iter().map(|row| row.thinned_out(each)).sum::<usize>();
    (wanted.div_ceil(rows.len())..).find(|&each| all(each) >= wanted).unwrap_or(wanted)
}

/// Compares a hundred thousand cases with the exact answers. They are drawn from other random
/// streams than those of `make stability`.
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

/// Counts of answers that were GAP_OPEN or UNDECIDED.
#[derive(Clone, Copy, Default)]
struct OpenAnswers {
    /// Answers of cases that limit the solver's iterations.
    limited: usize,
    /// Answers of all other cases.
    others: usize,
}

/// The first violation of the certificate in a case, if there is one. Counts open answers in
/// `open`.
fn violation(case: &Case, workspace: &mut Workspace, open: &mut OpenAnswers) -> Option<String> {
    let limited = case.max_iterations < Accuracy::default().max_iterations;
    let count = if limited { &mut open.limited } else { &mut open.others };
    let [a, b] = case.bodies();
    for solver in Solver::ALL {
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

/// Checks the answers of a million cases by their certificates, with both solvers and at all
/// margins. Catches a wrong answer that is too rare for the smaller sweeps, and an answer left open
/// although there was no limit of iterations.
#[test]
#[ignore = "make stability-long"]
fn a_million_cases_by_the_certificate() {
    let wanted = 1000 * thousands();
    let each = of_each(&rows(), wanted);
    let counts = of_every_row(|mut row| {
        let random = &mut row.random(2);
        // Making a case with large hulls costs more than solving it, so their rows run fewer cases.
        let (mut workspace, mut open, cases) =
            (Workspace::default(), OpenAnswers::default(), row.thinned_out(each));
        for _ in 0..cases {
            let case = row.case(random);
            if let Some(violation) = violation(&case, &mut workspace, &mut open) {
                panic!("{}, {}: {violation}", row.axis, row.value);
            }
        }
        (cases, open)
    });
    let cases: usize = counts.iter().map(|(cases, _)| cases).sum();
    let open = |of: fn(&OpenAnswers) -> usize| counts.iter().map(|(_, open)| of(open)).sum::<usize>();
    let (limited, others) = (open(|open| open.limited), open(|open| open.others));
    println!(
        "{cases} cases by the certificate; GAP_OPEN or UNDECIDED: {limited} answers with limited \
         iterations, {others} others"
    );
    assert!(limited > 0, "no limit was reached");
    assert_eq!(others, 0, "left open without a limit");
    assert!(cases >= wanted, "{cases} of {wanted}");
}

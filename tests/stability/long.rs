//! Seeded sweeps: `make stability-long`. A million cases by the certificate, a
//! hundred thousand by the exact answers with each solver; THOUSANDS for fewer.

use hullcast::contact::{Flags, Outcome, Workspace, certificate, contact_manifold};

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

/// What a seed's case found: UNDECIDED, GAP_OPEN and all else by the certificate.
fn violation(case: &Case, workspace: &mut Workspace, flagged: &mut usize) -> Option<String> {
    let [a, b] = case.bodies();
    for solver in SOLVERS {
        for margin in [f64::INFINITY, 0.0].into_iter().chain(case.margins.iter().copied()) {
            let mut query = case.query(margin);
            query.accuracy.solver = solver;
            let answer = contact_manifold(&a, &b, &query, None, workspace);
            let open = Flags { gap_open: true, estimated: answer.flags.estimated, ..Flags::default() };
            *flagged += usize::from(answer.flags == open || answer.outcome == Outcome::Undecided);
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
        let (mut workspace, mut flagged, cases) = (Workspace::default(), 0, row.thinned_out(each));
        for _ in 0..cases {
            let case = row.case(random);
            if let Some(violation) = violation(&case, &mut workspace, &mut flagged) {
                panic!("{}, {}: {violation}", row.axis, row.value);
            }
        }
        (cases, flagged)
    });
    let cases: usize = counts.iter().map(|(cases, _)| cases).sum();
    let flagged: usize = counts.iter().map(|(_, flagged)| flagged).sum();
    println!("{cases} cases by the certificate, {flagged} answers GAP_OPEN or UNDECIDED");
    assert!(cases >= wanted, "{cases} of {wanted}");
}

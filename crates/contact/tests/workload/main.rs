//! 240 pairs with exact answers, 20 of each family and regime, checked with both solvers.
//! `make workload` does the same for a file of any length.
//!
//! The test catches a solver that stops early or at the wrong facet, a false or loose bracket, a
//! normal that is not optimal, points off their hulls, a patch with a corner too many or too few,
//! an overlap without points, a flag raised without need, and a wrong outcome.

mod check;
mod double_double;
mod format;
mod polygon;
mod truth;

use hullcast_contact::Solver;

/// Every answer must be within the budgets of [`check`]. The counts at the end show that the test
/// is not vacuous: every cell has its pairs, and the resting faces do meet.
#[test]
fn every_answer_is_within_its_budget() {
    let bytes = include_bytes!("../../../../tests/golden/workload.bin");
    let families = format::parse(bytes).expect("the committed file is whole");
    let mut rows = Vec::new();
    for solver in Solver::ALL {
        for family in &families {
            rows.push((family.name, solver, check::check_family(family, solver)));
        }
    }
    println!("{}", check::table(&rows));
    let cells = || rows.iter().flat_map(|(_, _, cells)| cells);
    let violations: Vec<&String> = cells().flat_map(|cell| &cell.violations).collect();
    assert!(violations.is_empty(), "{violations:#?}");
    assert!(cells().all(|cell| cell.pairs == 20));
    assert_eq!(cells().map(|cell| cell.overlapping).sum::<usize>(), 2 * OVERLAPPING);
    assert_eq!(cells().map(|cell| cell.patches).sum::<usize>(), 2 * PATCHES);
}

/// The number of pairs in the file that overlap.
const OVERLAPPING: usize = 150;
/// The number of those whose faces meet; they include all 80 resting pairs.
const PATCHES: usize = 82;

/// The file's normals must prove the file's growth scales. Catches a reference that reads poses,
/// planes or frames in another way than the file means them.
#[test]
fn the_reference_agrees_with_the_file() {
    let families = format::parse(include_bytes!("../../../../tests/golden/workload.bin"))
        .expect("the committed file is whole");
    for family in &families {
        for pair in family.regimes.iter().flatten() {
            let truth = truth::Truth::new(&family.hulls, pair);
            let unit = f64::EPSILON * truth.outer / truth.inner;
            assert!(truth.optimality_gap(pair.normal).abs() <= 4.0 * unit * truth.alpha);
        }
    }
}

/// A square of half side 1 and the same square turned by 45 degrees meet in a regular octagon of
/// area 8 (sqrt(2) - 1); separate squares have no intersection. Catches a wrong reference, which
/// would accept wrong patches.
#[test]
fn the_reference_intersection_is_right() {
    let square = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let turned = [[0.0, -2f64.sqrt()], [2f64.sqrt(), 0.0], [0.0, 2f64.sqrt()], [-2f64.sqrt(), 0.0]];
    let octagon = polygon::intersection(&square, &turned, 0.0);
    assert_eq!(octagon.len(), 8);
    assert!((polygon::area(&octagon) - 8.0 * (2f64.sqrt() - 1.0)).abs() < 1e-14);
    assert!((polygon::hausdorff(&octagon, &square) - (2f64.sqrt() - 1.0)).abs() < 1e-14);
    let apart = square.map(|[x, y]| [x + 3.0, y]);
    assert!(polygon::intersection(&square, &apart, 0.0).is_empty());
    assert_eq!(polygon::hausdorff(&square, &[]), f64::INFINITY);
}

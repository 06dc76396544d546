//! Any pair with any options is answered as its certificate says, by both
//! solvers, cold and warm, no two answers contradict each other, and none is left
//! open without a limit.
#![no_main]

use hullcast::contact::{
    Basis, Body, Manifold, Outcome, Query, Solver, Wanted, Workspace, certificate, contact_manifold,
};
use hullcast_fuzz::{Scene, UNLIMITED};
use libfuzzer_sys::fuzz_target;
use std::sync::atomic::{AtomicU64, Ordering};

/// Unit roundoff.
const U: f64 = f64::EPSILON / 2.0;

/// Pairs answered: what is no hull is no case. `scripts/fuzz` reads how many.
static CASES: AtomicU64 = AtomicU64::new(0);
const REPORTED: u64 = 10_000;

fuzz_target!(|scene: Scene| {
    let (Ok(a), Ok(b)) = (scene.hull(0), scene.hull(1)) else { return };
    let (Ok(pose_a), Ok(pose_b)) = (scene.pose(0), scene.pose(1)) else { return };
    let (a, b) = (Body::new(&a, pose_a), Body::new(&b, pose_b));
    let cases = CASES.fetch_add(1, Ordering::Relaxed) + 1;
    if cases % REPORTED == 0 {
        eprintln!("cases: {cases}");
    }
    let workspace = &mut Workspace::default();
    let mut first: Option<Manifold> = None;
    for solver in [Solver::Portal, Solver::GjkRayCast] {
        let mut query = scene.query;
        query.accuracy.solver = solver;
        let [odd_a, odd_b] = [0, 3].map(|i| std::array::from_fn(|k| scene.odd_warm_start[i + k]));
        let mut warm: Option<Basis> = None;
        for _ in 0..2 {
            let answer = contact_manifold(&a, &b, &query, warm.as_ref(), workspace);
            if query.accuracy.max_iterations == UNLIMITED {
                let open = answer.outcome == Outcome::Undecided
                    || (answer.flags.gap_open && query.wanted != Wanted::Outcome);
                assert!(!open, "{solver:?}: left open\n{answer:?}");
            }
            // An outcome alone promises no numbers.
            if query.wanted != Wanted::Outcome
                && let Err(violation) = certificate::check(&a, &b, &query, answer)
            {
                panic!("{solver:?}: {violation}\n{answer:?}");
            }
            warm = answer.basis.or(Some(Basis { a: odd_a, b: odd_b }));
            let first = first.get_or_insert_with(|| answer.clone());
            agree(&scene, [&a, &b], &query, first, answer);
        }
    }
});

/// Brackets that have no growth scale in common, and outcomes that no rounding
/// excuses, cannot both be right.
fn agree(scene: &Scene, [a, b]: [&Body<'_>; 2], query: &Query, one: &Manifold, other: &Manifold) {
    let bracket = |m: &Manifold| (m.alpha_lower, m.alpha_upper);
    let ((low, high), (lower, upper)) = (bracket(one), bracket(other));
    assert!(low <= upper && lower <= high, "brackets apart: {one:?} {other:?}");
    let outer = a.hull.circumradius() + b.hull.circumradius();
    let t: f64 = (0..3).map(|k| (scene.positions[1][k] - scene.positions[0][k]).abs()).sum();
    let m = t + a.hull.contraction_point().length() + b.hull.contraction_point().length();
    let band = U * (64.0 * (outer + m) + 16.0 * m);
    let contact = |m: &Manifold| m.outcome == Outcome::Contact;
    let apart = |m: &Manifold| m.outcome == Outcome::Separated && m.separation > query.margin + 2.0 * band;
    assert!(!(contact(one) && apart(other) || apart(one) && contact(other)), "{one:?} {other:?}");
}

//! Every pair, with any options, must get an answer that its certificate accepts, from both
//! solvers, with and without a warm start, and with A and B exchanged. No two answers may
//! contradict each other, none may be left open without a limit of iterations, and scaling by a
//! power of two may change no bit.
#![no_main]

use hullcast_contact::{
    Basis, Body, Manifold, Outcome, Query, Solver, Wanted, Workspace, certificate, contact_manifold,
};
use hullcast_fuzz::{PairScene, Question, UNLIMITED};
use libfuzzer_sys::fuzz_target;
use std::sync::atomic::{AtomicU64, Ordering};

/// Unit roundoff.
const U: f64 = f64::EPSILON / 2.0;

/// A fraction of the larger hull's circumradius. If a hull is smaller than this, its sides are known,
/// in units of both hulls, only to some thousandths, and the bracket may stay open.
const MINUTE: f64 = 1e-11;

/// Questions answered so far; `scripts/fuzz` reads the count from the output.
static CASES: AtomicU64 = AtomicU64::new(0);
const REPORTED: u64 = 10_000;

fuzz_target!(|scene: PairScene| {
    let workspace = &mut Workspace::default();
    let twin = scene.scale.and_then(|by| scene.scaled(by));
    for (i, question) in scene.questions.iter().enumerate() {
        let answers = answered(scene.hulls(), question, workspace);
        if let Some(twin) = &twin {
            let other = answered(twin.hulls(), &twin.questions[i], workspace);
            assert!(answers.iter().zip(&other).all(|(m, n)| bits(m) == bits(n)), "{answers:?} {other:?}");
        }
        let cases = CASES.fetch_add(1, Ordering::Relaxed) + 1;
        if cases.is_multiple_of(REPORTED) {
            eprintln!("cases: {cases}");
        }
    }
});

/// The parts of an answer that have no unit of length.
fn bits(m: &Manifold) -> (Outcome, [u64; 6], Option<Basis>, usize) {
    let numbers = [m.alpha, m.alpha_lower, m.alpha_upper, m.normal.x, m.normal.y, m.normal.z];
    (m.outcome, numbers.map(f64::to_bits), m.basis, m.points.len())
}

/// The answers of both solvers to a question, each checked.
fn answered(
    hulls: [&hullcast_contact::ConvexHull; 2],
    question: &Question,
    workspace: &mut Workspace,
) -> Vec<Manifold> {
    let [a, b] = question.poses.bodies(hulls);
    let mut answers: Vec<Manifold> = Vec::new();
    for solver in Solver::ALL {
        let mut query = question.query;
        query.accuracy.solver = solver;
        let [odd_a, odd_b] = [0, 3].map(|i| std::array::from_fn(|k| question.odd_warm_start[i + k]));
        let mut warm: Option<Basis> = None;
        for _ in 0..2 {
            let answer = contact_manifold(&a, &b, &query, warm.as_ref(), workspace);
            hold(&a, &b, &query, answer);
            warm = answer.basis.or(Some(Basis { a: odd_a, b: odd_b }));
            answers.push(answer.clone());
        }
        let answer = contact_manifold(&b, &a, &query, None, workspace);
        hold(&b, &a, &query, answer);
        answers.push(answer.clone());
    }
    let apart = Apart::new(question, &a, &b);
    answers.iter().for_each(|answer| apart.agree(&answers[0], answer));
    answers
}

fn hold(a: &Body<'_>, b: &Body<'_>, query: &Query, answer: &Manifold) {
    if query.accuracy.max_iterations == UNLIMITED {
        let [one, other] = [a, b].map(|body| body.hull.circumradius());
        let minute = one.min(other) < MINUTE * one.max(other);
        let open = answer.outcome == Outcome::Undecided
            || (answer.flags.gap_open && query.wanted != Wanted::Outcome && !minute);
        assert!(!open, "left open\n{query:?} {answer:?}");
    }
    // If a query asks only for the outcome, the numbers need not be right.
    if query.wanted != Wanted::Outcome
        && let Err(violation) = certificate::check(a, b, query, answer)
    {
        panic!("{violation}\n{query:?} {answer:?}");
    }
}

/// The separation above which no rounding excuses a CONTACT.
struct Apart(f64);

impl Apart {
    fn new(question: &Question, a: &Body<'_>, b: &Body<'_>) -> Self {
        let outer = a.hull.circumradius() + b.hull.circumradius();
        let [from, to] = question.poses.positions;
        let t: f64 = (0..3).map(|k| (to[k] - from[k]).abs()).sum();
        let m = t + a.hull.contraction_point().length() + b.hull.contraction_point().length();
        Self(question.query.margin + 2.0 * U * (64.0 * (outer + m) + 16.0 * m))
    }

    /// Two brackets without a common growth scale cannot both be right, and neither can two
    /// different outcomes that no rounding excuses.
    fn agree(&self, one: &Manifold, other: &Manifold) {
        let bracket = |m: &Manifold| (m.alpha_lower, m.alpha_upper);
        let ((low, high), (lower, upper)) = (bracket(one), bracket(other));
        assert!(low <= upper && lower <= high, "brackets apart: {one:?} {other:?}");
        let contact = |m: &Manifold| m.outcome == Outcome::Contact;
        let apart = |m: &Manifold| m.outcome == Outcome::Separated && m.separation > self.0;
        assert!(!(contact(one) && apart(other) || apart(one) && contact(other)), "{one:?} {other:?}");
    }
}

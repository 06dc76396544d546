//! Compares every answer with the truth of its pair, and keeps score.

use std::fmt::Write as _;

use hullcast_contact::{
    Accuracy, Body, ConvexHull, Feature, Flags, HullOptions, Manifold, Outcome, Pose, Query, Solver,
    Workspace, certificate, contact_manifold,
};

use super::double_double::wide;
use super::format::{Family, Pair, REGIMES, SEPARATED};
use super::polygon::{self, Point};
use super::truth::{Truth, norm};

/// Unit roundoff of a double.
const U: f64 = f64::EPSILON / 2.0;

/// The measured errors of an answer, each as a fraction of its budget.
#[derive(Clone, Copy)]
enum Measure {
    /// `|alpha - exact|` over `16 u alpha R/r + 16 u M/r`.
    Alpha,
    /// `upper - lower` over `64 u upper R/r + 32 u M/r`.
    Bracket,
    /// The exact alpha minus the lower bound that the normal proves, over
    /// `64 u alpha R/r + 16 u M/r`.
    Normal,
    /// `|separation - s(n)|` over `64 u (R + |d|) + 16 u M`.
    Separation,
    /// The distance of a witness from its hull's surface, over `1e-9 R`.
    Surface,
    /// How much a point's distance is below `s(n)`, over the separation's budget.
    Distance,
    /// The Hausdorff distance between the patch of two faces and the exact one, over `1e-9 R`.
    Patch,
}

const MEASURES: [&str; 7] = ["alpha", "bracket", "normal", "separation", "surface", "distance", "patch"];

/// The score of one family in one regime with one solver.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct FamilyScore {
    pub(crate) pairs: usize,
    pub(crate) overlapping: usize,
    pub(crate) points: usize,
    pub(crate) estimated: usize,
    /// Pairs with two faces that meet.
    pub(crate) patches: usize,
    /// The worst fraction of each budget.
    worst: [f64; MEASURES.len()],
    pub(crate) violations: Vec<String>,
}

impl FamilyScore {
    /// Records an error as a fraction of its budget. A fraction above 1, or NaN, is a violation.
    fn measure(&mut self, measure: Measure, value: f64, budget: f64) {
        let share = value / budget;
        let worst = &mut self.worst[measure as usize];
        *worst = if share.is_nan() { f64::INFINITY } else { worst.max(share) };
        self.demand(share <= 1.0, || format!("{} is {share:.3} of its budget", MEASURES[measure as usize]));
    }

    fn demand(&mut self, holds: bool, message: impl FnOnce() -> String) {
        if !holds {
            self.violations.push(format!("pair {}: {}", self.pairs, message()));
        }
    }
}

/// Checks every pair of a family; returns one score per regime.
pub(crate) fn check_family(family: &Family, solver: Solver) -> Vec<FamilyScore> {
    let options = HullOptions { contraction_point: Some([0.0; 3]), ..HullOptions::default() };
    let hulls: Vec<ConvexHull> = family
        .hulls
        .iter()
        .map(|hull| {
            ConvexHull::with_options(&hull.vertices, &options).expect("the workload's hulls are good")
        })
        .collect();
    let mut workspace = Workspace::default();
    let regime = |(regime, pairs): (usize, &Vec<Pair>)| {
        let mut score = FamilyScore::default();
        for pair in pairs {
            let bodies = [0, 1].map(|side| {
                let pose = pair.poses[side];
                let pose = Pose::new(pose.position, pose.rotation).expect("the workload's poses are good");
                Body::new(&hulls[pair.hulls[side]], pose)
            });
            let truth = Truth::new(&family.hulls, pair);
            check_pair(&truth, &bodies, solver, regime, &mut workspace, &mut score);
            score.pairs += 1;
        }
        score
    };
    family.regimes.iter().enumerate().map(regime).collect()
}

fn check_pair(
    truth: &Truth,
    [a, b]: &[Body; 2],
    solver: Solver,
    regime: usize,
    workspace: &mut Workspace,
    score: &mut FamilyScore,
) {
    let accuracy = Accuracy { solver, ..Accuracy::default() };
    // With an infinite margin every pair has numbers and points.
    let everywhere = Query { margin: f64::INFINITY, accuracy, ..Query::default() };
    let answer = contact_manifold(a, b, &everywhere, None, workspace);
    check_certificate(a, b, &everywhere, answer, score);
    score.demand(answer.outcome == Outcome::Contact, || format!("{:?} at any margin", answer.outcome));
    check_numbers(truth, answer, score);
    check_points(truth, answer, score);
    check_estimated(truth, answer, [a.hull, b.hull], score);
    check_patch(truth, answer, score);

    let touching = Query { margin: 0.0, ..everywhere };
    let answer = contact_manifold(a, b, &touching, None, workspace);
    check_certificate(a, b, &touching, answer, score);
    check_outcome(truth, answer, regime, score);
}

/// The library's own certificate must accept the answer.
fn check_certificate(a: &Body, b: &Body, query: &Query, answer: &Manifold, score: &mut FamilyScore) {
    let result = certificate::check(a, b, query, answer);
    score.demand(result.is_ok(), || format!("certificate: {result:?}"));
}

fn check_numbers(truth: &Truth, answer: &Manifold, score: &mut FamilyScore) {
    let condition = truth.outer / truth.inner;
    // The contraction points are the hulls' origins. Among the lengths that enter the offset, `M`,
    // only the distance of the origins remains.
    let noise = 16.0 * U * truth.distance;
    let exact = truth.alpha;
    let n = answer.normal.to_array();

    let error = (answer.alpha - exact).abs();
    score.measure(Measure::Alpha, error, 16.0 * U * exact * condition + noise / truth.inner);
    score.demand(answer.alpha_lower <= exact && exact <= answer.alpha_upper, || {
        format!("exact {exact:e} outside [{:e}, {:e}]", answer.alpha_lower, answer.alpha_upper)
    });
    let width = answer.alpha_upper - answer.alpha_lower;
    let allowed = 64.0 * U * answer.alpha_upper * condition + 2.0 * noise / truth.inner;
    score.measure(Measure::Bracket, width, allowed);

    score.demand((norm(n) - 1.0).abs() <= 8.0 * U, || format!("normal of length {:e}", norm(n)));
    let gap = truth.optimality_gap(n);
    score.measure(Measure::Normal, gap, 64.0 * U * exact * condition + noise / truth.inner);
    let error = (answer.separation - truth.separation(n)).abs();
    score.measure(Measure::Separation, error, separation_budget(truth));

    let others = Flags { estimated: false, ..answer.flags };
    score.demand(others == Flags::default(), || format!("{others:?}"));
}

fn separation_budget(truth: &Truth) -> f64 {
    64.0 * U * (truth.outer + truth.distance) + 16.0 * U * truth.distance
}

fn check_points(truth: &Truth, answer: &Manifold, score: &mut FamilyScore) {
    score.demand(!answer.points.is_empty(), || "no points".into());
    score.points += answer.points.len();
    score.estimated += usize::from(answer.flags.estimated);
    score.demand(!answer.flags.estimated || answer.points.len() == 1, || "several estimated points".into());
    let lowest = truth.separation(answer.normal.to_array());
    for point in &answer.points {
        score.measure(Measure::Distance, lowest - point.distance, separation_budget(truth));
        if !answer.flags.estimated {
            let witness_b = point.witness_a + point.distance * answer.normal;
            let tolerance = 1e-9 * truth.outer;
            score.measure(Measure::Surface, truth.off_surface(0, point.witness_a.to_array()), tolerance);
            score.measure(Measure::Surface, truth.off_surface(1, witness_b.to_array()), tolerance);
        }
    }
}

/// ESTIMATED must be set exactly if the features, projected along the normal, do not meet.
fn check_estimated(truth: &Truth, answer: &Manifold, hulls: [&ConvexHull; 2], score: &mut FamilyScore) {
    let Some(features) = answer.features else {
        return score.demand(false, || "no features".into());
    };
    let n = answer.normal.to_array();
    let [a, b] = [0, 1].map(|side| {
        let vertices = match features[side] {
            Feature::Vertex(v) => vec![v],
            Feature::Edge(edge) => edge.to_vec(),
            Feature::Face(face) => hulls[side].face_outline(face as usize).collect(),
        };
        truth.outline(side, &vertices, n)
    });
    let gap = polygon::gap(&a, &b);
    let merge = 64.0 * U * (truth.outer + truth.distance);
    // A factor of two allows for this check's own rounding to double.
    let due = if answer.flags.estimated { gap > merge / 2.0 } else { gap <= merge * 2.0 };
    score.demand(due, || format!("estimated: {}, features {gap:e} apart", answer.flags.estimated));
}

fn check_patch(truth: &Truth, answer: &Manifold, score: &mut FamilyScore) {
    let Some(exact) = truth.patch() else { return };
    score.patches += 1;
    score.demand(!answer.flags.estimated, || "estimated although the faces meet".into());
    let project = truth.projection(truth.normal);
    let corners: Vec<Point> =
        answer.points.iter().map(|point| project(wide(point.witness_a.to_array()))).collect();
    let error = polygon::hausdorff(&polygon::convex_hull(&corners), &exact);
    score.measure(Measure::Patch, error, 1e-9 * truth.outer);
}

/// At margin 0 the outcome must agree with the exact alpha.
fn check_outcome(truth: &Truth, answer: &Manifold, regime: usize, score: &mut FamilyScore) {
    if truth.alpha < 1.0 {
        score.overlapping += 1;
        score.demand(answer.outcome == Outcome::Contact, || {
            format!("{:?} at alpha {}", answer.outcome, truth.alpha)
        });
        score.demand(!answer.points.is_empty(), || "overlapping and no points".into());
    } else if truth.alpha > 1.0 {
        score.demand(answer.outcome == Outcome::Separated, || {
            format!("{:?} at alpha {}", answer.outcome, truth.alpha)
        });
        check_rejection(truth, answer, score);
    }
    score.demand(regime != SEPARATED || truth.alpha > 1.0, || "an overlap among the separated".into());
}

/// The numbers of a separated pair are lower bounds, and nothing else is sent.
fn check_rejection(truth: &Truth, answer: &Manifold, score: &mut FamilyScore) {
    let holds = answer.alpha <= truth.alpha && answer.alpha_upper == f64::INFINITY;
    score.demand(holds, || format!("alpha {} is no lower bound", answer.alpha));
    let proven = truth.separation(answer.normal.to_array());
    let holds = answer.separation > 0.0 && answer.separation - proven <= separation_budget(truth);
    score.demand(holds, || format!("separation {} where {proven} is proven", answer.separation));
    let bare = answer.points.is_empty() && answer.basis.is_none() && answer.features.is_none();
    score.demand(bare && answer.flags == Flags::default(), || "more than a rejection".into());
}

/// A table with one line per regime: counts, and the worst fraction of each budget.
pub(crate) fn table(rows: &[(&str, Solver, Vec<FamilyScore>)]) -> String {
    let mut text = format!("{:<8} {:<10} {:<9} ", "family", "solver", "regime");
    let counts = ["pairs", "overlap", "points", "estim.", "patches", "wrong"];
    for column in counts.iter().chain(&MEASURES) {
        let _ = write!(text, "{column:>10} ");
    }
    for (family, solver, cells) in rows {
        for (regime, score) in REGIMES.iter().zip(cells) {
            let solver = format!("{solver:?}");
            let _ = write!(text, "\n{family:<8} {solver:<10} {regime:<9} ");
            let wrong = score.violations.len();
            for count in [score.pairs, score.overlapping, score.points, score.estimated, score.patches, wrong]
            {
                let _ = write!(text, "{count:>10} ");
            }
            for share in score.worst {
                let _ = write!(text, "{share:>10.2e} ");
            }
        }
    }
    text
}

//! Compares the answers for a case with the exact ones, and keeps the score of a cell: counts,
//! flags, and the worst error as a fraction of its budget.

use hullcast_contact::{
    Basis, Body, Feature, Manifold, Outcome, Query, Solver, Wanted, Workspace, certificate, contact_manifold,
};

use super::case::{Case, norm, rotate};
use super::exact::zero;
use super::gauss::{FeatureQuestion, objection};
use super::oracle::{Corner, Exact, Growth};
use super::polygon;

/// Unit roundoff.
pub(crate) const U: f64 = f64::EPSILON / 2.0;

/// The measured errors, each as a fraction of its budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Measure {
    /// `|alpha - exact|` over `alpha tol + 16 u alpha R/r + 16 u M/r`.
    Alpha,
    /// How far the exact alpha is outside the bracket (any amount is a failure); otherwise the
    /// bracket's width over `upper (tol + 64 u R/r) + 32 u M/r`.
    Bracket,
    /// The exact alpha minus the lower bound that the normal proves, over alpha's budget.
    Normal,
    /// `|separation - s(n)|` over `64 u (R + |d|) + 16 u M`.
    Separation,
    /// The distance beyond the margin of a CONTACT pair, over the rounding band. A SEPARATED pair
    /// within the margin is a failure.
    Outcome,
    /// How far witnesses are outside their hulls, over the faces' planarity plus the merge
    /// distance.
    Witness,
    /// How much a point's distance is below `s(n)`.
    Distance,
}

pub(crate) const MEASURES: [&str; 7] =
    ["alpha", "bracket", "normal", "separation", "outcome", "witness", "distance"];

/// The score of one row of the matrix with one solver.
#[derive(Clone, Debug, Default)]
pub(crate) struct SolverScore {
    pub(crate) cases: usize,
    pub(crate) failures: usize,
    pub(crate) failed: Vec<String>,
    pub(crate) worst: [f64; MEASURES.len()],
    /// The number of cases with an answer that carries this flag.
    pub(crate) gap_open: usize,
    pub(crate) coincident: usize,
    pub(crate) undecided: usize,
    pub(crate) estimated: usize,
    pub(crate) counts: CaseCounts,
}

/// The kinds of cases, counted from the exact answers. They show that a cell contains the cases
/// that its row names.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct CaseCounts {
    pub(crate) overlapping: usize,
    pub(crate) apart: usize,
    /// The ray meets an edge or a corner of the Minkowski difference.
    pub(crate) ties: usize,
    pub(crate) edge_edge: usize,
    pub(crate) faces: usize,
    /// Contacts with four or more points.
    pub(crate) patches: usize,
    pub(crate) contact: usize,
    pub(crate) separated: usize,
    /// Growth distance would report CONTACT, but the hulls are farther apart than the margin.
    pub(crate) ghosts: usize,
    /// Answers flagged GAP_OPEN, and answers flagged COINCIDENT.
    pub(crate) open: usize,
    pub(crate) coincident: usize,
    pub(crate) pivots: usize,
    /// Touching vertices, edges and faces, at any feature angle, each checked against the
    /// definition by brute force; and the number of answers that had to be ESTIMATED.
    pub(crate) touched: [usize; 3],
    pub(crate) due: usize,
}

impl SolverScore {
    pub(crate) fn measure(&mut self, measure: Measure, value: f64, budget: f64) {
        let share = if value <= 0.0 { 0.0 } else { value / budget };
        let worst = &mut self.worst[measure as usize];
        *worst = if share.is_nan() { f64::INFINITY } else { worst.max(share) };
        let name = MEASURES[measure as usize];
        self.demand(share <= 1.0, || format!("{name} {value:e} is {share:.3e} of its budget"));
    }

    pub(crate) fn demand(&mut self, holds: bool, message: impl FnOnce() -> String) {
        if !holds {
            self.failures += 1;
            if self.failed.len() < 5 {
                let case = self.cases;
                self.failed.push(format!("case {case}: {}", message()));
            }
        }
    }
}

/// The quantities in the budgets, in the caller's units.
struct Sizes {
    inner: f64,
    outer: f64,
    /// `M`, `|d|` and `L`.
    m: f64,
    d: f64,
    world: f64,
    planarity: f64,
}

impl Sizes {
    fn new(case: &Case, [a, b]: &[Body<'_>; 2]) -> Self {
        let [ta, tb] = case.positions;
        let t: [f64; 3] = std::array::from_fn(|k| tb[k] - ta[k]);
        let centre = |body: &Body<'_>| body.hull.contraction_point().to_array();
        let turned = [(a, 0), (b, 1)].map(|(body, side)| rotate(case.rotations[side], centre(body)));
        Self {
            inner: a.hull.inradius() + b.hull.inradius(),
            outer: a.hull.circumradius() + b.hull.circumradius(),
            m: norm(t) + norm(centre(a)) + norm(centre(b)),
            d: norm(std::array::from_fn(|k| t[k] + (turned[1][k] - turned[0][k]))),
            world: norm(ta) + norm(tb),
            planarity: a.hull.geometric_error() + b.hull.geometric_error(),
        }
    }

    fn alpha(&self, alpha: f64, tolerance: f64) -> f64 {
        alpha * (tolerance + 16.0 * U * self.outer / self.inner) + 16.0 * U * self.m / self.inner
    }

    /// The rounding band of a separation.
    fn band(&self) -> f64 {
        64.0 * U * (self.outer + self.d) + 16.0 * U * self.m
    }

    fn merge(&self) -> f64 {
        64.0 * U * (self.outer + self.m)
    }
}

/// Judges one case with both solvers.
pub(crate) fn judge(case: &Case, scores: &mut [SolverScore; 2], workspace: &mut Workspace) {
    let bodies = case.bodies();
    let sizes = Sizes::new(case, &bodies);
    let exact = case.exact();
    let mut known: Option<Growth> = None;
    for (solver, score) in Solver::ALL.into_iter().zip(scores) {
        let mut query = case.query(f64::INFINITY);
        query.accuracy.solver = solver;
        let [a, b] = &bodies;
        let answer = contact_manifold(a, b, &query, None, workspace).clone();
        let corners = |basis: hullcast_contact::Basis| -> [Corner; 3] {
            std::array::from_fn(|i| [basis.a[i] as usize, basis.b[i] as usize])
        };
        let growth = known.get_or_insert_with(|| exact.growth(answer.basis.map(corners)));
        let judging = Judging { case, bodies: &bodies, sizes: &sizes, exact: &exact, growth };
        score.counts.pivots += growth.pivots;
        judging.numbers(&query, &answer, score);
        judging.features(&query, &answer, score);
        judging.feature_angles(&query, score, workspace);
        judging.points(&answer, score);
        judging.certificate(&query, &answer, score);
        judging.twin(&query, &answer, score);
        judging.outcomes(&query, &answer, score, workspace);
        judging.count(&answer, score);
        score.cases += 1;
    }
}

struct Judging<'a> {
    case: &'a Case,
    bodies: &'a [Body<'a>; 2],
    sizes: &'a Sizes,
    exact: &'a Exact,
    growth: &'a Growth,
}

impl Judging<'_> {
    fn numbers(&self, query: &Query, answer: &Manifold, score: &mut SolverScore) {
        let (sizes, growth) = (self.sizes, self.growth);
        let tolerance = query.accuracy.relative_tolerance;
        let alpha = growth.value();
        let n = answer.normal.to_array();
        score.demand(answer.outcome == Outcome::Contact, || format!("{:?} at any margin", answer.outcome));
        score.demand((norm(n) - 1.0).abs() <= 8.0 * U, || format!("a normal of length {:e}", norm(n)));
        let (low, high) = (growth.error_of(answer.alpha_lower), growth.error_of(answer.alpha_upper));
        score.demand(low <= 0.0 && high >= 0.0, || {
            format!("exact alpha is {low:e} below, {high:e} above the bracket's ends: {answer:?}")
        });
        score.measure(
            Measure::Separation,
            (answer.separation - self.exact.separation(n)).abs(),
            sizes.band(),
        );
        if answer.flags.coincident {
            let noise = 16.0 * U * sizes.m;
            return score
                .demand(answer.alpha == 0.0 && sizes.d <= noise, || format!("coincident at {:e}", sizes.d));
        }
        if answer.flags.gap_open {
            let inside = answer.alpha_lower <= answer.alpha && answer.alpha <= answer.alpha_upper;
            return score.demand(inside, || format!("alpha outside its bracket: {answer:?}"));
        }
        score.measure(Measure::Alpha, growth.error_of(answer.alpha).abs(), sizes.alpha(alpha, tolerance));
        let allowed = answer.alpha_upper * (tolerance + 64.0 * U * sizes.outer / sizes.inner)
            + 32.0 * U * sizes.m / sizes.inner;
        score.measure(Measure::Bracket, answer.alpha_upper - answer.alpha_lower, allowed);
        let short = self.exact.optimality_gap(n, growth);
        score.measure(Measure::Normal, short, sizes.alpha(alpha, tolerance));
    }

    fn points(&self, answer: &Manifold, score: &mut SolverScore) {
        let sizes = self.sizes;
        let (n, world) = (answer.normal, 4.0 * U * sizes.world);
        let least = self.case.least_points;
        score.demand(answer.points.len() >= least, || format!("{} points of {least}", answer.points.len()));
        let lowest = self.exact.separation(n.to_array());
        for p in &answer.points {
            let slack = sizes.band() + 2.0 * sizes.planarity + world;
            score.measure(Measure::Distance, lowest - p.distance, slack);
            if answer.flags.estimated {
                continue;
            }
            for (side, at) in [p.witness_a, p.witness_a + p.distance * n].into_iter().enumerate() {
                let out = self.outside(side, at.to_array());
                score.measure(Measure::Witness, out, sizes.planarity + sizes.merge() + world);
            }
        }
    }

    /// Checks the features of the same pair with the pure Gauss map (feature angle 0) and with wide
    /// feature angles.
    fn feature_angles(&self, query: &Query, score: &mut SolverScore, workspace: &mut Workspace) {
        let [a, b] = self.bodies;
        for feature_angle in [0.0, 0.1, 0.5] {
            let mut query = *query;
            query.accuracy.feature_angle = feature_angle;
            self.features(&query, contact_manifold(a, b, &query, None, workspace), score);
        }
    }

    /// Checks the features against the definition by brute force, and the flag ESTIMATED against
    /// the projected features.
    fn features(&self, query: &Query, answer: &Manifold, score: &mut SolverScore) {
        let Some(features) = answer.features else {
            return score.demand(false, || "no features".into());
        };
        for side in 0..2 {
            let hull = self.bodies[side].hull;
            let [x, y, z, w] = self.case.rotations[side];
            let n = rotate([-x, -y, -z, w], answer.normal.to_array());
            let n = glam::DVec3::from_array(n) * [1.0, -1.0][side];
            let question = FeatureQuestion {
                hull,
                n,
                depth: 64.0 * U * self.sizes.outer / hull.scale(),
                feature_angle: query.accuracy.feature_angle,
                basis: answer.basis.map_or(vec![], |b| [b.a, b.b][side].to_vec()),
            };
            let objection = objection(&question, features[side]);
            let angle = query.accuracy.feature_angle;
            score.demand(objection.is_none(), || {
                format!("{:?} of {side} at angle {angle}: {objection:?}", features[side])
            });
            match features[side] {
                Feature::Face(_) => score.counts.touched[2] += 1,
                Feature::Edge(_) => score.counts.touched[1] += 1,
                Feature::Vertex(_) => score.counts.touched[0] += 1,
            }
        }
        self.estimated(answer, score);
    }

    /// How far a world point is outside a hull.
    fn outside(&self, side: usize, at: [f64; 3]) -> f64 {
        let hull = self.bodies[side].hull;
        let [x, y, z, w] = self.case.rotations[side];
        let from: [f64; 3] = std::array::from_fn(|k| at[k] - self.case.positions[side][k]);
        let own = glam::DVec3::from_array(rotate([-x, -y, -z, w], from)) - hull.contraction_point();
        let planes = hull.faces().iter().map(|face| (face.normal, face.offset));
        planes.map(|(m, o)| m.dot(own) - o * hull.scale()).fold(f64::NEG_INFINITY, f64::max)
    }

    /// ESTIMATED must be set exactly if the features, projected along the normal, do not meet.
    fn estimated(&self, answer: &Manifold, score: &mut SolverScore) {
        let Some(features) = answer.features else {
            return score.demand(false, || "no features".into());
        };
        let n = answer.normal;
        let (e1, e2) = n.any_orthonormal_pair();
        let d = self.offset();
        let outline = |side: usize| {
            let hull = self.bodies[side].hull;
            let vertices = match features[side] {
                Feature::Vertex(v) => vec![v],
                Feature::Edge(edge) => edge.to_vec(),
                Feature::Face(face) => hull.face_outline(face as usize).collect(),
            };
            let shift = if side == 0 { glam::DVec3::ZERO } else { d };
            let corner = |&v: &u32| {
                let from = glam::DVec3::from_array(self.case.shapes[side].points[v as usize])
                    - hull.contraction_point();
                let p = glam::DVec3::from_array(rotate(self.case.rotations[side], from.to_array())) + shift;
                [e1.dot(p), e2.dot(p)]
            };
            polygon::convex_hull(&vertices.iter().map(corner).collect::<Vec<_>>())
        };
        let gap = polygon::gap(&outline(0), &outline(1));
        // A factor of two allows for this check's own rounding.
        let merge = self.sizes.merge();
        let due = if answer.flags.estimated { gap > merge / 2.0 } else { gap <= merge * 2.0 };
        score.counts.due += usize::from(answer.flags.estimated);
        score.demand(due, || format!("estimated: {}, features {gap:e} apart", answer.flags.estimated));
    }

    /// The offset from A's contraction point to B's.
    fn offset(&self) -> glam::DVec3 {
        let centre = |side: usize| self.bodies[side].hull.contraction_point().to_array();
        let turned =
            [0, 1].map(|side| glam::DVec3::from_array(rotate(self.case.rotations[side], centre(side))));
        let [ta, tb] = self.case.positions.map(glam::DVec3::from_array);
        (tb - ta) + (turned[1] - turned[0])
    }

    fn certificate(&self, query: &Query, answer: &Manifold, score: &mut SolverScore) {
        let [a, b] = self.bodies;
        let result = certificate::check(a, b, query, answer);
        score.demand(result.is_ok(), || format!("certificate: {result:?}"));
    }

    /// The twin, the same scene at another power of two, must have an answer with the same bits.
    fn twin(&self, query: &Query, answer: &Manifold, score: &mut SolverScore) {
        let Some(twin) = &self.case.twin else { return };
        let other = twin.solve(query, &mut Workspace::default());
        let bits = |m: &Manifold| {
            [m.alpha, m.alpha_lower, m.alpha_upper, m.normal.x, m.normal.y, m.normal.z].map(f64::to_bits)
        };
        score.demand(bits(answer) == bits(&other) && answer.basis == other.basis, || {
            format!("other bits at another scale: {answer:?} {other:?}")
        });
    }

    /// CONTACT and SEPARATED must agree with the exact distance: without a warm start, with the
    /// answer's own basis and with an arbitrary one, and for every kind of result asked for.
    fn outcomes(
        &self,
        query: &Query,
        numbers: &Manifold,
        score: &mut SolverScore,
        workspace: &mut Workspace,
    ) {
        let [a, b] = self.bodies;
        let overlapping = self.growth.num <= self.growth.den;
        let distance = (!overlapping).then(|| self.exact.distance_squared(self.exact.support(&self.exact.d)));
        // Margins around the pair's own distance.
        let apart = distance.as_ref().map(|d| [1.0 - 1e-3, 1.0 - 1e-12, 1.0 + 1e-9].map(|by| by * d.value()));
        let own = apart.into_iter().flatten();
        // An arbitrary triple of vertices, different in each case.
        let [odd_a, odd_b] = [0, 1].map(|side| {
            let count = self.case.shapes[side].points.len();
            [1, 2 + score.cases, 3 + 5 * score.cases].map(|i| (i % count) as u32)
        });
        let odd = Basis { a: odd_a, b: odd_b };
        for margin in self.case.margins.iter().copied().chain([0.0]).chain(own) {
            let beyond = distance.as_ref().map_or(-margin, |d| d.beyond(margin));
            let ghost = numbers.separation <= margin && beyond > self.sizes.band();
            score.counts.ghosts += usize::from(ghost);
            let warm = numbers.basis.as_ref();
            for (wanted, warm) in [
                (Wanted::Points, None),
                (Wanted::Points, warm),
                (Wanted::Points, Some(&odd)),
                (Wanted::Outcome, None),
                (Wanted::Growth, warm),
            ] {
                let query = Query { margin, wanted, ..*query };
                let answer = contact_manifold(a, b, &query, warm, workspace);
                match answer.outcome {
                    // The band is widened by a sixteenth, because the separation that is compared
                    // with it is rounded too.
                    Outcome::Contact => {
                        score.measure(Measure::Outcome, beyond, self.sizes.band() * (1.0 + 0.0625));
                    }
                    Outcome::Separated => {
                        score.demand(beyond > 0.0, || format!("separated, {beyond:e} beyond {margin:e}"));
                        self.bounds(
                            answer,
                            distance.as_ref().map_or(0.0, |d| d.beyond(answer.separation.max(0.0))),
                            score,
                        );
                    }
                    Outcome::Undecided => score.undecided += 1,
                }
                match answer.outcome {
                    Outcome::Contact => score.counts.contact += 1,
                    _ => score.counts.separated += 1,
                }
                let result = certificate::check(a, b, &query, answer);
                score.demand(result.is_ok(), || format!("certificate at margin {margin:e}: {result:?}"));
            }
        }
    }

    /// The numbers of a separated pair are lower bounds: of alpha and of the distance.
    fn bounds(&self, answer: &Manifold, beyond: f64, score: &mut SolverScore) {
        let holds = self.growth.error_of(answer.alpha_lower) <= 0.0 && beyond >= 0.0;
        score.demand(holds, || format!("no lower bounds, distance {beyond:e} beyond: {answer:?}"));
    }

    fn count(&self, answer: &Manifold, score: &mut SolverScore) {
        let flags = answer.flags;
        score.gap_open += usize::from(flags.gap_open);
        score.coincident += usize::from(flags.coincident);
        score.estimated += usize::from(flags.estimated);
        let counts = &mut score.counts;
        counts.open += usize::from(flags.gap_open);
        counts.coincident += usize::from(flags.coincident);
        let overlapping = self.growth.num <= self.growth.den;
        counts.overlapping += usize::from(overlapping);
        counts.apart += usize::from(!overlapping);
        counts.ties += usize::from(self.growth.is_tied());
        counts.patches += usize::from(answer.points.len() >= 4);
        match answer.features {
            Some([Feature::Edge(_), Feature::Edge(_)]) => counts.edge_edge += 1,
            Some([Feature::Face(_), Feature::Face(_)]) => counts.faces += 1,
            _ => {}
        }
    }
}

impl Growth {
    /// Whether the ray meets an edge or a corner of `K` exactly.
    fn is_tied(&self) -> bool {
        self.weights.iter().any(zero)
    }
}

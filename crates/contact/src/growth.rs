//! Step 1: growth scale and contact normal, with a certified bracket.
//!
//! The growth scale `alpha` is the smallest scale at which both hulls, grown about their contraction
//! points, touch (C. J. Ong and E. G. Gilbert, *Growth distances: new measures for object separation
//! and penetration*, IEEE Transactions on Robotics and Automation 12(6), 1996). Silcowitz, Niebe and
//! Erleben (SCA 2010, section 3) find it by a ray cast. Let `d` be the offset between the contraction
//! points, and `K` the Minkowski difference of the hulls, each about its own contraction point. `K`
//! contains the origin, and the ray along `d` leaves `K` at `d / alpha`:
//!
//! ```text
//!          ______
//!         /      \  n
//!        /        \/          alpha = |d| / |x|, where the ray along d leaves K at x
//!       |      _.-'x---> d    n = outward normal of K's facet at x
//!       |  o-'     |
//!        \        /           alpha < 1: the hulls overlap; alpha > 1: they are apart
//!         \__ K _/
//! ```
//!
//! Two proofs need no trust in a solver, so any solver can return a bracket of alpha. Here `h_K(n)` is
//! the support value of `K`, the largest `n.u` over its points `u`:
//!
//! - Every direction `n` proves the lower bound `alpha >= n.d / h_K(n)`, because all of `K` lies on one
//!   side of its support plane ([`lower_bound`]).
//! - Every triple of points of `K` whose cone holds `d` proves an upper bound: if `d` is the sum of
//!   `l_i u_i` with `l_i >= 0`, then `alpha <= l_0 + l_1 + l_2` ([`upper_bound`]).
//!
//! Solvers: [`portal`] refines a triangle around the ray from inside `K` and is the default. It takes
//! about two thirds of the time of the other one, and its last triple warm-starts the next query.
//! [`gjk_ray_cast`] is the paper's. For two boxes, [`boxes`] computes where the portal should start.

pub(crate) mod boxes;
pub(crate) mod gjk_ray_cast;
pub(crate) mod portal;
pub(crate) mod triple;

use boxes::Boxes;
use glam::DVec3;

use super::pair::{Pair, Support, shift};
use super::support::Columns;
use super::tolerance::{COARSE, COINCIDENT, NOISE, U};
use super::{Accuracy, Basis, ConvexHull, Solver};

/// The result of step 1.
pub(crate) enum Growth {
    /// Growth scale and normal with their bracket.
    Solved(Solution),
    /// A direction along which the hulls are farther apart than the margin.
    Separated(Separation),
}

/// Growth scale and normal. The scale and both ends of its bracket are for `d`, not for the ray.
pub(crate) struct Solution {
    pub(crate) alpha: f64,
    pub(crate) lower: f64,
    pub(crate) upper: f64,
    /// Contact normal: unit, A's frame, from A to B.
    pub(crate) normal: DVec3,
    /// The vertex of `K` farthest along the normal.
    pub(crate) support: Support,
    /// Points of `K` whose cone holds `d`. They are the basis unless one of them is an inner point.
    pub(crate) triple: [Support; 3],
    pub(crate) gap_open: bool,
    /// Wide arithmetic could improve the normal or the weights.
    pub(crate) coarse: bool,
    pub(crate) coincident: bool,
    pub(crate) cost: Cost,
}

/// A direction that certifies separation beyond the margin.
pub(crate) struct Separation {
    /// The direction: A's frame, any length but 0.
    pub(crate) direction: DVec3,
    /// The vertex of `K` farthest along it.
    pub(crate) support: Support,
    pub(crate) cost: Cost,
}

/// The work done, for diagnostics.
#[derive(Clone, Copy, Default)]
pub(crate) struct Cost {
    pub(crate) iterations: u32,
    pub(crate) support_calls: u32,
}

/// The goal of a solver, and its limits.
pub(crate) struct Goal {
    /// Width of the bracket at which the solver may stop, relative to alpha.
    pub(crate) relative_tolerance: f64,
    pub(crate) max_iterations: u32,
    /// If a pair is farther apart than this (pair units), the answer is only that. Infinity excludes no
    /// pair.
    pub(crate) margin: f64,
    /// Whether only the outcome matters, so that the solver may stop once the hulls certainly overlap.
    pub(crate) outcome_only: bool,
}

impl Goal {
    pub(crate) fn new(accuracy: &Accuracy, margin: f64, outcome_only: bool) -> Self {
        Self {
            relative_tolerance: accuracy.relative_tolerance,
            max_iterations: accuracy.max_iterations,
            margin,
            outcome_only,
        }
    }
}

/// Finds the growth scale and normal of a pair. `warm` is the basis of an earlier answer.
pub(crate) fn growth<'a>(
    pair: &mut Pair<'a>,
    solver: Solver,
    warm: Option<&Basis>,
    goal: &Goal,
    turned: &'a mut Columns,
) -> Growth {
    let boxes = if solver == Solver::Portal { Boxes::of(pair) } else { None };
    if goal.margin < f64::INFINITY
        && let Some(direction) = boxes.as_ref().and_then(|boxes| boxes.seem_apart(pair, goal.margin))
    {
        let support = pair.support(direction);
        if separates(pair, direction, &support, goal.margin) {
            let cost = Cost { iterations: 1, support_calls: 2 };
            return Growth::Separated(Separation { direction, support, cost });
        }
    }
    pair.turn(turned);
    let warm = warm.and_then(|basis| triple_of(pair, basis));
    if pair.ray.length() <= COINCIDENT * U * pair.ray_m {
        return Growth::Solved(coincident(pair, goal));
    }
    let start = match solver {
        Solver::Portal => warm.or_else(|| boxes.map(|boxes| boxes.seeds(pair))),
        Solver::GjkRayCast => warm,
    };
    let seeds = start.as_ref().map_or(&[][..], |triple| triple);
    match solver {
        Solver::Portal => portal::solve(pair, seeds, goal, Cost::default()),
        Solver::GjkRayCast => gjk_ray_cast::solve(pair, seeds, goal),
    }
}

/// The vertices of `K` that a basis names. None if one of its indices is not a vertex.
pub(crate) fn triple_of(pair: &Pair<'_>, basis: &Basis) -> Option<[Support; 3]> {
    let mut triple = [Support::default(); 3];
    for (u, (&a, &b)) in triple.iter_mut().zip(basis.a.iter().zip(&basis.b)) {
        *u = pair.support_of(pair.a.vertex_of_registered(a)?, pair.b.vertex_of_registered(b)?);
    }
    Some(triple)
}

/// The solution for coincident centres. Alpha is 0, and every normal is optimal. Returns the normal
/// that a small offset along the thinnest direction of either hull would have.
fn coincident(pair: &mut Pair<'_>, goal: &Goal) -> Solution {
    let (ray, noise) = (pair.ray, pair.ray_m);
    (pair.ray, pair.ray_m) = (thinnest_direction(pair), 0.0);
    let never_beyond = Goal { margin: f64::INFINITY, outcome_only: false, ..*goal };
    let solved = portal::solve(pair, &[], &never_beyond, Cost::default());
    (pair.ray, pair.ray_m) = (ray, noise);
    let upper = (NOISE * U * pair.m / pair.inradius).next_up();
    match solved {
        Growth::Solved(solution) => {
            Solution { alpha: 0.0, lower: 0.0, upper, gap_open: false, coincident: true, ..solution }
        }
        // This cannot happen, because no distance exceeds an infinite margin.
        Growth::Separated(Separation { direction, support, cost }) => Solution {
            alpha: 0.0,
            lower: 0.0,
            upper,
            normal: direction.normalize(),
            support,
            triple: [support; 3],
            gap_open: true,
            coarse: true,
            coincident: true,
            cost,
        },
    }
}

fn thinnest_direction(pair: &Pair<'_>) -> DVec3 {
    let thinnest = |hull: &ConvexHull| {
        let offsets = hull.faces().iter().map(|face| face.offset).enumerate();
        offsets.fold((0, f64::INFINITY), |best, (i, o)| if o < best.1 { (i, o) } else { best })
    };
    let (face_a, offset_a) = thinnest(pair.a);
    let (face_b, offset_b) = thinnest(pair.b);
    if offset_a * pair.scale_a <= offset_b * pair.scale_b {
        pair.a.faces()[face_a].normal
    } else {
        -(pair.rotation * pair.b.faces()[face_b].normal)
    }
}

/// Certified lower bound of the growth scale of the ray, rounded down. Any direction `n` with its
/// support point gives one.
pub(crate) fn lower_bound(pair: &Pair<'_>, n: DVec3, support: &Support) -> f64 {
    let length = n.length();
    let reach = n.dot(pair.ray) - NOISE * U * pair.ray_m * length;
    let width = n.dot(support.point) + NOISE * U * pair.circumradius * length;
    if reach > 0.0 && width > 0.0 { (reach / width).next_down() } else { 0.0 }
}

/// Certified upper bound of the growth scale of the ray, rounded up. It holds for any weights: `K`
/// contains a ball of radius `r`, so the part of the ray that the weighted triple leaves out adds at
/// most its length divided by `r`.
pub(crate) fn upper_bound(pair: &Pair<'_>, triple: &[Support; 3], weights: [f64; 3]) -> f64 {
    let [l0, l1, l2] = weights.map(|l| l.max(0.0));
    let made = triple[0].point * l0 + triple[1].point * l1 + triple[2].point * l2;
    let sum = l0 + l1 + l2;
    let missing = (pair.ray - made).length() + NOISE * U * (pair.ray_m + pair.circumradius * sum);
    let upper = (sum + missing / pair.inradius).next_up();
    if upper.is_nan() { f64::INFINITY } else { upper }
}

/// The solution that a direction with its support point and a triple prove.
pub(crate) fn conclude(
    pair: &Pair<'_>,
    n: DVec3,
    support: Support,
    triple: [Support; 3],
    goal: &Goal,
    cost: Cost,
) -> Solution {
    let lower = lower_bound(pair, n, &support);
    let ratio = n.dot(pair.ray) / n.dot(support.point);
    let by_weights = |weights| Bracket::new(pair, goal, lower, ratio, upper_bound(pair, &triple, weights));
    // Cramer's rule is the cheapest way to the weights. The others are worth their cost only if its
    // bracket is too wide and the query needs a narrower one.
    let mut bracket = by_weights(triple::weights(pair.ray, &triple));
    if (bracket.open | bracket.coarse) && !decides(pair, bracket.upper, goal) {
        bracket = narrowed(pair, &triple, bracket, by_weights);
    }
    let Bracket { alpha, upper, open, coarse } = bracket;
    let k = pair.alpha_exponent;
    Solution {
        alpha: shift(alpha, k),
        lower: outward(lower, k, f64::next_down).max(0.0),
        upper: outward(upper, k, f64::next_up),
        normal: n.normalize(),
        support,
        triple,
        gap_open: open,
        coarse,
        coincident: false,
        cost,
    }
}

/// A bracket of the growth scale of the ray.
struct Bracket {
    alpha: f64,
    upper: f64,
    /// Wider than the query asked for.
    open: bool,
    /// So wide that other weights may narrow it.
    coarse: bool,
}

impl Bracket {
    /// The bracket with these ends. `ratio` is the growth scale in plain arithmetic.
    #[inline]
    fn new(pair: &Pair<'_>, goal: &Goal, lower: f64, ratio: f64, upper: f64) -> Self {
        let alpha = ratio.clamp(lower, upper.max(lower));
        // The width of the bracket without its allowance for noise.
        let share = U * (pair.ray_m + pair.circumradius * upper) / pair.inradius;
        let own_width = upper - NOISE * share - alpha;
        Self {
            alpha,
            upper,
            open: !(upper - lower <= pair.closed_width(upper, goal.relative_tolerance)),
            coarse: own_width > goal.relative_tolerance * upper + COARSE * share,
        }
    }
}

/// The narrowest bracket of the one by Cramer's rule, the one by areas, and, if both are open, the one by wide
/// arithmetic.
#[cold]
fn narrowed(
    pair: &Pair<'_>,
    triple: &[Support; 3],
    mut bracket: Bracket,
    by_weights: impl Fn([f64; 3]) -> Bracket,
) -> Bracket {
    for weights in [triple::weights_by_areas, triple::wide_weights] {
        let other = by_weights(weights(pair.ray, triple));
        bracket = if other.upper < bracket.upper { other } else { bracket };
        if !bracket.open {
            break;
        }
    }
    bracket
}

/// Whether the query is for the outcome only, and this upper bound of the growth scale of the ray
/// already decides it.
fn decides(pair: &Pair<'_>, upper: f64, goal: &Goal) -> bool {
    goal.outcome_only && (goal.margin == f64::INFINITY || shift(upper, pair.alpha_exponent) <= 1.0)
}

/// `bound * 2^k`, rounded outward if the result is subnormal.
fn outward(bound: f64, k: i32, round: fn(f64) -> f64) -> f64 {
    let shifted = shift(bound, k);
    if shifted.abs() < f64::MIN_POSITIVE { round(shifted) } else { shifted }
}

/// Whether `n` (any length) certifies that the hulls are farther apart than the margin.
pub(crate) fn separates(pair: &Pair<'_>, n: DVec3, support: &Support, margin: f64) -> bool {
    let gap = n.dot(pair.d) - n.dot(support.point);
    gap > 0.0 && gap > (margin + pair.rounding_band()) * n.length()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::workload::{Family, Regime, Workload};
    use crate::{Body, Pose};

    /// For a facet that is small beside `K`, Cramer's rule leaves a bracket that is too wide, and the pair
    /// then takes a second step in wide arithmetic. Catches a wrong formula of the areas, and a
    /// conclusion that does not use them: both cost steps and change no bracket's truth.
    #[test]
    fn weights_by_areas_close_every_bracket() {
        let (mut solved, mut wide_by_cramer) = (0, 0);
        for (family, regime) in Family::ALL.into_iter().flat_map(|f| Regime::ALL.map(|r| (f, r))) {
            let workload = Workload::generate(family, regime, 250, 3).expect("a workload");
            let hulls: Vec<ConvexHull> =
                workload.hulls.iter().map(|points| ConvexHull::new(points).expect("a hull")).collect();
            for posed in &workload.pairs {
                let [a, b] = [0, 1].map(|i| {
                    let pose = Pose::new(posed.positions[i], posed.rotations[i]).expect("a pose");
                    Body::new(&hulls[posed.hulls[i]], pose)
                });
                let goal = Goal::new(&Accuracy::EXACT, f64::INFINITY, false);
                let (mut pair, mut turned) = (Pair::new(&a, &b), Columns::default());
                let Growth::Solved(solution) = growth(&mut pair, Solver::Portal, None, &goal, &mut turned)
                else {
                    unreachable!("no distance exceeds an infinite margin");
                };
                assert!(!solution.gap_open && !solution.coarse, "{family:?} {regime:?}");
                let n = solution.normal;
                let lower = lower_bound(&pair, n, &solution.support);
                let ratio = n.dot(pair.ray) / n.dot(solution.support.point);
                let [by_cramer, by_areas] = [triple::weights, triple::weights_by_areas].map(|weights| {
                    let upper = upper_bound(&pair, &solution.triple, weights(pair.ray, &solution.triple));
                    Bracket::new(&pair, &goal, lower, ratio, upper)
                });
                assert!(!by_areas.open && !by_areas.coarse, "{family:?} {regime:?}");
                wide_by_cramer += usize::from(by_cramer.open || by_cramer.coarse);
                solved += 1;
            }
        }
        assert!(solved == 3000 && wide_by_cramer >= 50, "{wide_by_cramer} of {solved}");
    }
}

//! Portal refinement from inside (after Snethen, *XenoCollide*, 2008): the
//! primal simplex method on `min sum l_i : sum l_i c_i = d, l >= 0` over the
//! vertices `c_i` of `K`.
//!
//! The origin lies inside `K`, so a small triangle of inner points around the
//! ray is a feasible start; the support point beyond the triangle's plane
//! replaces one corner, until there is none beyond. Finite, since the signs
//! that choose the corner are exact (`triple`), with a bracket at every step.

use std::ops::ControlFlow::{self, Break, Continue};

use glam::DVec3;

use super::triple::{Normal, Triple};
use super::{Cost, Goal, Growth, Separation, conclude, separates};
use crate::contact::pair::{Pair, Support};
use crate::contact::tolerance::{FIRST_STEPS, GAIN, STALL, U};

/// Growth scale and normal. `seeds` are vertices of `K` worth trying first: a
/// basis of an earlier answer, a simplex of another solver.
pub(crate) fn solve(pair: &Pair<'_>, seeds: &[Support], goal: &Goal, mut cost: Cost) -> Growth {
    if seeds.is_empty() {
        return refine(pair, inner_triangle(pair), false, goal, cost);
    }
    let start = match *seeds {
        [s0, s1, s2] => match look(pair, [s0, s1, s2], goal, &mut cost) {
            Break(growth) => return growth,
            Continue(start) => start,
        },
        _ => None,
    };
    let Start { portal, wide } = start.unwrap_or_else(|| Start::plain(inside(pair, seeds)));
    match refine(pair, portal, wide, goal, cost) {
        // Seeds that mislead cost a cold start.
        Growth::Solved(misled) if misled.gap_open && misled.cost.iterations < goal.max_iterations => {
            refine(pair, inner_triangle(pair), false, goal, misled.cost)
        }
        solved => solved,
    }
}

/// A portal to go on from.
struct Start {
    portal: Triple,
    /// It is known to be the last, and plain arithmetic does not show it.
    wide: bool,
}

impl Start {
    fn plain(portal: Triple) -> Self {
        Self { portal, wide: false }
    }
}

/// Whether three seeds are the basis: their bracket shows it by itself. Only to go on from them
/// their cone has to hold the ray.
fn look(
    pair: &Pair<'_>,
    seeds: [Support; 3],
    goal: &Goal,
    cost: &mut Cost,
) -> ControlFlow<Growth, Option<Start>> {
    let around = || Triple::around(pair, seeds).map(Start::plain);
    // Of the last step nothing would be left to go on with.
    let last = cost.iterations + 1 >= goal.max_iterations;
    let Some((portal, normal)) = Triple::along(pair, seeds).filter(|_| !last) else {
        return Continue(around());
    };
    let n = normal.n;
    let w = pair.support(n);
    cost.iterations += 1;
    cost.support_calls += 2;
    if goal.margin < f64::INFINITY && separates(pair, n, &w, goal.margin) {
        return Break(Growth::Separated(Separation { direction: n, support: w, cost: *cost }));
    }
    let refined = refined(pair, &portal, normal, &w, 0.0);
    if refined {
        // A wide bracket would close about a cone beside the ray too.
        let closest = Goal { relative_tolerance: 0.0, ..*goal };
        let solution = conclude(pair, n, w, portal.supports(), &closest, *cost);
        if !solution.gap_open && !solution.coarse {
            return Break(Growth::Solved(solution));
        }
    }
    Continue(around().map(|mut start| {
        start.wide = refined;
        if !refined {
            start.portal.pivot(pair, w);
        }
        start
    }))
}

/// Pivots until no vertex of `K` lies beyond the portal.
fn refine(pair: &Pair<'_>, mut portal: Triple, mut wide: bool, goal: &Goal, mut cost: Cost) -> Growth {
    let mut best = Best::default();
    let mut stalled = 0;
    let uncompared = FIRST_STEPS.min(goal.max_iterations / 2);
    loop {
        let normal = if wide { portal.wide_normal() } else { portal.normal() };
        let n = normal.n;
        cost.iterations += 1;
        let w = pair.support(n);
        cost.support_calls += 2;
        if goal.margin < f64::INFINITY && separates(pair, n, &w, goal.margin) {
            return Growth::Separated(Separation { direction: n, support: w, cost });
        }
        if may_decide(pair, &portal, n, goal) {
            let solution = conclude(pair, n, w, portal.supports(), goal, cost);
            if solution.upper <= 1.0 || goal.margin == f64::INFINITY {
                return Growth::Solved(solution);
            }
        }
        let improves = cost.iterations <= uncompared || best.improve(pair.ray, n, w);
        stalled = if improves { 0 } else { stalled + 1 };
        let out_of_steps = cost.iterations >= goal.max_iterations || stalled >= STALL;
        let refined = refined(pair, &portal, normal, &w, goal.relative_tolerance);
        if refined || out_of_steps {
            // The portal's own plane holds the basis: an earlier one, as good to
            // rounding, may be another facet's.
            let mut solution = conclude(pair, n, w, portal.supports(), goal, cost);
            if solution.gap_open && best.ratio > 0.0 {
                solution = conclude(pair, best.direction, best.support, portal.supports(), goal, cost);
            }
            let sharp = !solution.gap_open && !solution.coarse;
            if sharp || wide || out_of_steps || !refined {
                return Growth::Solved(solution);
            }
            wide = true;
            continue;
        }
        portal.pivot(pair, w);
    }
}

/// The direction with the largest lower bound so far.
#[derive(Default)]
struct Best {
    ratio: f64,
    direction: DVec3,
    support: Support,
}

impl Best {
    fn improve(&mut self, ray: DVec3, n: DVec3, w: Support) -> bool {
        let ratio = n.dot(ray) / n.dot(w.point);
        let better = ratio > self.ratio && ratio.is_finite();
        if better {
            *self = Self { ratio, direction: n, support: w };
        }
        better
    }
}

/// Whether `w` is not beyond the triangle's plane by more than was asked for,
/// or than the rounding of the plane and of two support values leaves open.
#[inline]
fn refined(pair: &Pair<'_>, portal: &Triple, plane: Normal, w: &Support, relative_tolerance: f64) -> bool {
    let gain = plane.n.dot(w.point - portal.get(0).point);
    let rounding = GAIN * U * pair.circumradius;
    !(gain > 0.0 && gain * gain > rounding * rounding * plane.error_squared)
        || gain <= relative_tolerance * plane.n.dot(w.point)
        || (0..3).any(|i| portal.get(i).same(w))
}

/// Whether an outcome alone is asked for and the bracket may decide it: the centre offset is
/// on the portal's inner side, or every distance is within the margin.
#[inline]
fn may_decide(pair: &Pair<'_>, portal: &Triple, n: DVec3, goal: &Goal) -> bool {
    goal.outcome_only && (goal.margin == f64::INFINITY || n.dot(pair.d) <= n.dot(portal.get(0).point))
}

/// Inner points around the ray, replaced by the seeds beyond their plane.
fn inside(pair: &Pair<'_>, seeds: &[Support]) -> Triple {
    let mut portal = inner_triangle(pair);
    for seed in seeds {
        if !refined(pair, &portal, portal.normal(), seed, 0.0) {
            portal.pivot(pair, *seed);
        }
    }
    portal
}

/// A triangle around and across the ray, so that the first support point is the
/// one along the ray, with its corners a little inside the inner ball: of the
/// openings tried (0.02 to 0.99 along the ray) this took the fewest steps.
fn inner_triangle(pair: &Pair<'_>) -> Triple {
    let along = pair.ray.normalize();
    let (e1, e2) = along.any_orthonormal_pair();
    let (radius, half) = (0.99 * pair.inradius, 0.5 * 3f64.sqrt());
    let around = [e1, -0.5 * e1 + half * e2, -0.5 * e1 - half * e2];
    Triple::new(around.map(|across| Support::inner((0.8 * along + 0.6 * across) * radius)))
}

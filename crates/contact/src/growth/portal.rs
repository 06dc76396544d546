//! Portal refinement: finds the facet of `K` through which the ray leaves, starting inside `K`.
//!
//! After G. Snethen, *XenoCollide: Complex Collision Made Simple* (Game Programming Gems 7, 2008). A
//! *portal* is a triangle of three points of `K` that the ray crosses. The origin lies inside `K`, so
//! a small triangle of inner points around the ray is a portal to start from. Each step moves the
//! portal outward:
//!
//! ```text
//!              w                 portal = triangle around the ray
//!           .     .              loop:
//!      u0 +----|----+ u1             n = outward normal of the portal
//!          \   |   /                 w = vertex of K farthest along n
//!           \  |ray                  w is not beyond the portal: done
//!            \ | /                   replace one corner by w: the one without which
//!             \|/                        the ray still crosses the portal
//!              o  origin
//! ```
//!
//! This is the primal simplex method for the linear programme `min sum l_i` subject to
//! `sum l_i c_i = d` and `l >= 0`, over the vertices `c_i` of `K`. The portal's corners are the basis,
//! its normal is the dual solution, the support mapping finds the entering column, and
//! [`Triple::pivot`] finds the leaving one.
//!
//! Every step proves a bracket of alpha: the normal gives a lower bound and the corners an upper one.
//! The method is finite, because the signs that choose the corner are exact and ties are broken by a
//! symbolic shift of the ray (see [`triple`](super::triple)). A step costs one support call of each
//! hull and constant work. A good start (a basis of an earlier answer, or the seeds of two boxes)
//! usually needs one step.
//!
//! Departures from XenoCollide: the search stops by the certified bracket and not by a tolerance on a
//! length. If double precision leaves the bracket open, the last portal is measured again in wide
//! arithmetic.

use std::ops::ControlFlow::{self, Break, Continue};

use glam::DVec3;

use super::triple::{Normal, Triple};
use super::{Cost, Goal, Growth, Separation, conclude, separates};
use crate::pair::{Pair, Support};
use crate::tolerance::{FIRST_STEPS, GAIN, STALL, U};

/// Finds the growth scale and normal. `seeds` are vertices of `K` that are worth trying first: the
/// basis of an earlier answer, or the simplex of another solver.
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
        // The seeds were misleading: start again without them.
        Growth::Solved(misled) if misled.gap_open && misled.cost.iterations < goal.max_iterations => {
            refine(pair, inner_triangle(pair), false, goal, misled.cost)
        }
        solved => solved,
    }
}

/// A portal to start the refinement from.
struct Start {
    portal: Triple,
    /// Whether to continue in wide arithmetic: no vertex of `K` lies beyond the portal, but double
    /// precision does not prove its bracket.
    wide: bool,
}

impl Start {
    fn plain(portal: Triple) -> Self {
        Self { portal, wide: false }
    }
}

/// Tries three seeds as the basis, without checking that their cone holds the ray: if it is the
/// basis, its bracket proves that. If it is not, the cone must hold the ray for the search to go on
/// from it. Returns the answer, or the portal to go on from (none if the cone misses the ray).
fn look(
    pair: &Pair<'_>,
    seeds: [Support; 3],
    goal: &Goal,
    cost: &mut Cost,
) -> ControlFlow<Growth, Option<Start>> {
    let around = || Triple::around(pair, seeds).map(Start::plain);
    // On the last allowed iteration there is no iteration left to continue from here.
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
        // At the requested tolerance the bracket could close although the cone misses the ray. So this
        // asks for the narrowest bracket.
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

/// Pivots until no vertex of `K` lies beyond the portal. If `wide` is set, the normals are computed
/// in wide arithmetic from the start.
fn refine(pair: &Pair<'_>, mut portal: Triple, mut wide: bool, goal: &Goal, mut cost: Cost) -> Growth {
    let mut best = BestDirection::default();
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
            // Use the direction of the portal itself: it belongs to the basis. An earlier direction may
            // be as good to rounding, but it may belong to another facet.
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

/// The direction with the largest lower bound so far, and its support point.
#[derive(Default)]
struct BestDirection {
    ratio: f64,
    direction: DVec3,
    support: Support,
}

impl BestDirection {
    fn improve(&mut self, ray: DVec3, n: DVec3, w: Support) -> bool {
        let ratio = n.dot(ray) / n.dot(w.point);
        let better = ratio > self.ratio && ratio.is_finite();
        if better {
            *self = Self { ratio, direction: n, support: w };
        }
        better
    }
}

/// Whether the portal is final: `w` is not beyond its plane by more than the tolerance allows, or by
/// more than the rounding of the plane and of two support values.
#[inline]
fn refined(pair: &Pair<'_>, portal: &Triple, plane: Normal, w: &Support, relative_tolerance: f64) -> bool {
    let gain = plane.n.dot(w.point - portal.get(0).point);
    let rounding = GAIN * U * pair.circumradius;
    !(gain > 0.0 && gain * gain > rounding * rounding * plane.error_squared)
        || gain <= relative_tolerance * plane.n.dot(w.point)
        || (0..3).any(|i| portal.get(i).same(w))
}

/// Whether the query is for the outcome only and the bracket may decide it: the centre offset is on
/// the inner side of the portal, or the margin is infinite.
#[inline]
fn may_decide(pair: &Pair<'_>, portal: &Triple, n: DVec3, goal: &Goal) -> bool {
    goal.outcome_only && (goal.margin == f64::INFINITY || n.dot(pair.d) <= n.dot(portal.get(0).point))
}

/// A portal of inner points around the ray, into which the seeds beyond its plane are pivoted.
fn inside(pair: &Pair<'_>, seeds: &[Support]) -> Triple {
    let mut portal = inner_triangle(pair);
    for seed in seeds {
        if !refined(pair, &portal, portal.normal(), seed, 0.0) {
            portal.pivot(pair, *seed);
        }
    }
    portal
}

/// A triangle across and around the ray, with its corners a little inside the inner ball. It is
/// perpendicular to the ray, so the first support point is the one along the ray. This opening took the
/// fewest steps of those tried (0.02 to 0.99 along the ray).
fn inner_triangle(pair: &Pair<'_>) -> Triple {
    let along = pair.ray.normalize();
    let (e1, e2) = along.any_orthonormal_pair();
    let (radius, half) = (0.99 * pair.inradius, 0.5 * 3f64.sqrt());
    let around = [e1, -0.5 * e1 + half * e2, -0.5 * e1 - half * e2];
    Triple::new(around.map(|across| Support::inner((0.8 * along + 0.6 * across) * radius)))
}

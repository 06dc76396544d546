//! The paper's solver: a ray cast by GJK, from outside `K`.
//!
//! Silcowitz, Niebe and Erleben (SCA 2010, section 3) use the method of G. van den Bergen, *Ray casting
//! against general convex objects with application to continuous collision detection* (2004). A point
//! `x` starts outside `K` and moves along the ray towards the origin. It never passes a plane that
//! GJK shows to separate it from `K`, so it can only stop on the surface:
//!
//! ```text
//! x = at infinity on the ray along d; direction = d; simplex = no points
//! loop:
//!     w = vertex of K farthest along direction
//!     the plane through w across direction cuts the ray before x: move x to that plane
//!     add w to the simplex
//!     v = from the simplex point closest to x, to x
//!     |v| is small, or there is no progress: portal refinement finishes from the simplex
//!     direction = v
//! ```
//!
//! A step costs one support call of each hull and the reduction of a simplex of at most four points.
//!
//! Departure from the paper, which stops at a tolerance on `|v|` and takes the normal from `v`. Near
//! the surface `v` is mostly rounding, so the simplex goes to [`portal`](super::portal). The portal
//! finds the facet and closes the bracket, usually in one step, and the answer stops by its bracket.

use glam::DVec3;

use super::{Cost, Goal, Growth, Separation, portal, separates};
use crate::pair::{Pair, Support};
use crate::simplex::Simplex;
use crate::tolerance::{RAY_CAST_NEAR, STALL};

/// Finds the growth scale and normal. `seeds` are vertices of `K` of an earlier answer.
pub(crate) fn solve(pair: &Pair<'_>, seeds: &[Support], goal: &Goal) -> Growth {
    // The portal computes the bracket, so one iteration of the limit is left for it.
    if goal.max_iterations <= 1 {
        return portal::solve(pair, seeds, goal, Cost::default());
    }
    let along = pair.ray.normalize();
    let near = (RAY_CAST_NEAR * pair.circumradius).max(0.5 * goal.relative_tolerance * pair.inradius);
    let mut simplex = Simplex::from_points(seeds);
    let mut cost = Cost::default();
    let mut position = f64::INFINITY;
    let mut direction = along;
    let mut shortest = f64::INFINITY;
    let mut stalled = 0;
    loop {
        let w = pair.support(direction);
        cost.iterations += 1;
        cost.support_calls += 2;
        if goal.margin < f64::INFINITY && separates(pair, direction, &w, goal.margin) {
            return Growth::Separated(Separation { direction, support: w, cost });
        }
        let advanced = advance(&mut position, along, direction, &w);
        let known = simplex.contains(&w);
        if !known {
            simplex.push(w);
        }
        let away = -simplex.closest_to(along * position);
        let distance = away.length();
        stalled = if advanced || distance < shortest { 0 } else { stalled + 1 };
        shortest = if advanced { distance } else { shortest.min(distance) };
        let stuck = (known && !advanced) || stalled >= STALL || simplex.is_full();
        if !(distance > near) || stuck || cost.iterations + 1 >= goal.max_iterations {
            return portal::solve(pair, simplex.points(), goal, cost);
        }
        direction = away;
    }
}

/// Moves the point to the plane through `w` across `direction` if that plane cuts the ray nearer to
/// the origin. Returns whether the point moved.
fn advance(position: &mut f64, along: DVec3, direction: DVec3, w: &Support) -> bool {
    let plane = direction.dot(w.point) / direction.dot(along);
    let beyond = direction.dot(along) > 0.0 && plane < *position;
    if beyond {
        *position = plane;
    }
    beyond
}

//! The paper's solver (Silcowitz et al. 2010, section 3; van den Bergen, *Ray
//! casting against general convex objects*, 2004): a point outside `K` moves
//! along the ray towards the origin, never past a plane that GJK shows to
//! separate it from `K`.
//!
//! Where the point is so near to `K` that the direction to it is mostly
//! rounding, the simplex goes to the pivot of [`portal`](super::portal), which
//! finds the face and closes the bracket, usually in one step. The paper stops
//! by a tolerance on the distance instead; this stops by the bracket.

use glam::DVec3;

use super::{Cost, Goal, Growth, Separation, portal, separates};
use crate::contact::pair::{Pair, Support};
use crate::contact::simplex::Simplex;
use crate::contact::tolerance::{RAY_CAST_NEAR, STALL};

/// Growth scale and normal. `seeds` are vertices of `K` of an earlier answer.
pub(crate) fn solve(pair: &Pair<'_>, seeds: &[Support], goal: &Goal) -> Growth {
    // The bracket is the pivot's: of the limit one step is left for it.
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

/// Moves the point to the plane through `w` across `direction`, if it lies
/// beyond; whether it did.
fn advance(position: &mut f64, along: DVec3, direction: DVec3, w: &Support) -> bool {
    let plane = direction.dot(w.point) / direction.dot(along);
    let beyond = direction.dot(along) > 0.0 && plane < *position;
    if beyond {
        *position = plane;
    }
    beyond
}

//! The motion of a body during a step, and by how much it can bring two hulls together.
//!
//! The turning point of a body moves at a constant velocity `v`, and the body turns about that point at a
//! constant rate `w`. During a step `h`, no point of the hull then moves farther from the line of the turning
//! point than `min(h |w|, 2) rho`, where `rho` is the largest distance of a point of the hull from the turning
//! point: a turn by the angle `theta` moves a point at the distance `rho` by `2 sin(min(theta, pi) / 2) rho` at
//! most, and `2 sin(theta / 2) <= min(theta, 2)`. The distance between two hulls therefore shrinks by at most
//!
//! ```text
//! h |v_B - v_A| + min(h |w_A|, 2) rho_A + min(h |w_B|, 2) rho_B
//! ```
//!
//! A query whose margin is wider by that much (a *speculative* margin) misses no pair that touches within the
//! step. The bound has no direction: it counts bodies that fly apart too.

use glam::DVec3;

use super::{ConvexHull, body::MAX_POSITION, tolerance::MOTION_ABOVE};

/// The squared length below which squares of coordinates may underflow.
const SMALL_SQUARE: f64 = 1e-250;
/// A power of two that brings the coordinates of a shorter vector to where their squares do not underflow.
const MAGNIFIED: f64 = f64::from_bits((1023 + 600) << 52);

/// The motion of a body: its velocity, its rate of turn, and the point about which it turns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// The velocity of the turning point; world axes, length per time.
    linear: DVec3,
    /// The rate of turn; world axes, radians per time.
    angular: DVec3,
    /// The turning point; hull frame, caller's units.
    turning_point: DVec3,
}

impl Motion {
    /// A motion, or `None` if a number is not finite or its magnitude is above 1e100.
    ///
    /// `linear` is the velocity of the turning point and `angular` the rate of turn about it, in radians per
    /// unit of time, both along the world's axes. `turning_point` is in the hull's frame and the caller's units.
    #[inline]
    pub fn new(linear: [f64; 3], angular: [f64; 3], turning_point: [f64; 3]) -> Option<Self> {
        let usable = [linear, angular, turning_point].iter().flatten().all(|x| x.abs() <= MAX_POSITION);
        let [linear, angular, turning_point] = [linear, angular, turning_point].map(DVec3::from_array);
        usable.then_some(Self { linear, angular, turning_point })
    }

    /// At most how far the turning moves a point of the hull during a step.
    fn turned_by(&self, hull: &ConvexHull, step: f64) -> f64 {
        let turn = (step * length(self.angular)).min(2.0);
        turn * (hull.circumradius() + length(hull.contraction_point() - self.turning_point))
    }

    /// The largest distance by which a point of the hull moves during a step, rounded up.
    pub fn reach(&self, hull: &ConvexHull, step: f64) -> f64 {
        (step * length(self.linear) + self.turned_by(hull, step)) * MOTION_ABOVE
    }
}

/// The largest distance by which two hulls in motion approach each other during a step, rounded up. It is 0 if
/// the step is 0.
pub fn approach(a: (&ConvexHull, &Motion), b: (&ConvexHull, &Motion), step: f64) -> f64 {
    let [(hull_a, motion_a), (hull_b, motion_b)] = [a, b];
    let shift = step * length(motion_b.linear - motion_a.linear);
    (shift + motion_a.turned_by(hull_a, step) + motion_b.turned_by(hull_b, step)) * MOTION_ABOVE
}

/// The length of a vector, accurate to some roundoffs even if the squares of its coordinates underflow.
fn length(v: DVec3) -> f64 {
    let square = v.dot(v);
    if square < SMALL_SQUARE { (v * MAGNIFIED).length() / MAGNIFIED } else { square.sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube() -> ConvexHull {
        let corners: Vec<[f64; 3]> =
            (0..8).map(|i| [0, 1, 2].map(|axis| f64::from(i >> axis & 1) * 2.0 - 1.0)).collect();
        ConvexHull::new(&corners).unwrap()
    }

    /// Catches a term that is left out or counted twice, a rate of turn beyond the diameter, and a turning
    /// point that is taken in the wrong direction. The values follow from the formula by hand.
    #[test]
    fn the_bound_is_the_sum_of_its_terms() {
        let hull = cube();
        let radius = 3f64.sqrt();
        let motion = |v, w, x| Motion::new(v, w, x).unwrap();
        let still = Motion::default();
        for (a, b, step, expected) in [
            (still, still, 1.0, 0.0),
            (motion([3.0, 0.0, 4.0], [0.0; 3], [9.0; 3]), still, 0.5, 2.5),
            (
                motion([3.0, 0.0, 4.0], [0.0; 3], [0.0; 3]),
                motion([3.0, 0.0, 4.0], [0.0; 3], [0.0; 3]),
                9.0,
                0.0,
            ),
            (still, motion([0.0; 3], [0.0, 0.5, 0.0], [0.0; 3]), 0.5, 0.25 * radius),
            (motion([0.0; 3], [0.0, 0.5, 0.0], [3.0, 0.0, 4.0]), still, 0.5, 0.25 * (radius + 5.0)),
            (motion([0.0; 3], [0.0, 50.0, 0.0], [3.0, 0.0, 4.0]), still, 0.5, 2.0 * (radius + 5.0)),
            (
                motion([1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0; 3]),
                motion([-1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0; 3]),
                0.5,
                1.0 + 1.5 * radius,
            ),
        ] {
            let bound = approach((&hull, &a), (&hull, &b), step);
            assert!((expected..=expected * (1.0 + 1e-14)).contains(&bound), "{a:?} {b:?}: {bound}");
            assert_eq!(approach((&hull, &a), (&hull, &b), 0.0), 0.0);
            let reaches = a.reach(&hull, step) + b.reach(&hull, step);
            assert!(reaches * (1.0 + 1e-15) >= bound, "{a:?} {b:?}: {reaches}");
        }
    }

    /// Catches a speed that is lost because its square underflows or overflows, and a number that is accepted
    /// although no arithmetic follows it.
    #[test]
    fn speeds_of_every_size_count() {
        let hull = cube();
        let step_of = |speed: f64| {
            let motion = Motion::new([0.0, speed, 0.0], [0.0; 3], [0.0; 3]).unwrap();
            approach((&hull, &motion), (&hull, &Motion::default()), 2.0) / speed
        };
        for speed in [1e-300, 1e-170, 1e-120, 1.0, 1e100] {
            assert!((2.0..2.0 + 1e-14).contains(&step_of(speed)), "{speed}: {}", step_of(speed));
        }
        for wrong in [f64::NAN, f64::INFINITY, -f64::INFINITY, 1.0001e100] {
            for place in 0..3 {
                let mut numbers = [[0.0; 3]; 3];
                numbers[place][place] = wrong;
                let [linear, angular, turning_point] = numbers;
                assert_eq!(Motion::new(linear, angular, turning_point), None, "{wrong} at {place}");
            }
        }
    }
}

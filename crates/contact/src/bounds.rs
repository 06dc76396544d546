//! Bounding boxes of bodies for the broad phase. They are rounded outward, so that the broad phase
//! never loses a pair within the margin.

use glam::DVec3;

use super::{Body, tolerance::REACH, tolerance::U};

/// A box along the world's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lowest coordinates.
    pub low: DVec3,
    /// Highest coordinates.
    pub high: DVec3,
}

impl Bounds {
    /// Whether the two boxes have a point in common, touching surfaces included.
    #[inline]
    pub fn meets(&self, other: &Self) -> bool {
        self.low.cmple(other.high).all() && other.low.cmple(self.high).all()
    }
}

impl Body<'_> {
    /// A box in the world (caller's units) that contains every point within `margin / 2` of the hull.
    /// The box is rounded outward and includes half of the rounding band around the margin. Hence two
    /// bodies whose boxes do not meet are SEPARATED for [`contact_manifold`](super::contact_manifold)
    /// at that margin.
    pub fn bounds(&self, margin: f64) -> Bounds {
        let (hull, pose) = (self.hull, &self.pose);
        let centre = hull.contraction_point();
        let reach = 0.5 * margin;
        let slack = reach + REACH * U * (hull.circumradius() + centre.length() + margin);
        let bound = |axis: usize, sign: f64| {
            // The world axis in the hull's own frame.
            let n = pose.rotation.row(axis) * sign;
            let farthest = n.dot(hull.vertices()[hull.support(n) as usize]) * hull.scale();
            let offset = n.dot(centre) + farthest + slack;
            (pose.translation[axis] + sign * offset.next_up(), sign)
        };
        let outward = |(x, sign): (f64, f64)| if sign > 0.0 { x.next_up() } else { x.next_down() };
        let corner = |sign: f64| DVec3::from_array([0, 1, 2].map(|axis| outward(bound(axis, sign))));
        Bounds { low: corner(-1.0), high: corner(1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ConvexHull, Pose};

    /// The bounds of a box that is rotated by a right angle are known exactly. Catches bounds with
    /// exchanged axes, a contraction point that is forgotten or has the wrong sign, a margin that is
    /// lost, and inward rounding.
    #[test]
    fn a_turned_boxs_bounds_are_its_own() {
        let corners: Vec<[f64; 3]> = (0..8)
            .map(|i| [f64::from(i & 1), f64::from(i >> 1 & 1) * 2.0, f64::from(i >> 2 & 1) * 3.0])
            .collect();
        let hull = ConvexHull::new(&corners).unwrap();
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // A right angle about z takes x to y, and y to -x.
        for (rotation, low, high) in [
            ([0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 2.0, 3.0]),
            ([0.0, 0.0, half, half], [-2.0, 0.0, 0.0], [0.0, 1.0, 3.0]),
            ([half, 0.0, 0.0, half], [0.0, -3.0, 0.0], [1.0, 0.0, 2.0]),
        ] {
            for position in [[0.0; 3], [10.0, -20.0, 30.0], [1e15, -1e17, 1e100]] {
                for margin in [0.0, 0.5] {
                    let body = Body::new(&hull, Pose::new(position, rotation).unwrap());
                    let bounds = body.bounds(margin);
                    let at = DVec3::from_array(position);
                    let [low, high] = [DVec3::from_array(low), DVec3::from_array(high)];
                    let [low, high] = [at + (low - 0.5 * margin), at + (high + 0.5 * margin)];
                    assert!(bounds.low.cmplt(low).all() && bounds.high.cmpgt(high).all(), "{bounds:?}");
                    let near = (at.abs() * 2.0 * f64::EPSILON).max(DVec3::splat(1e-12));
                    assert!((low - bounds.low).cmple(near).all(), "{bounds:?}");
                    assert!((bounds.high - high).cmple(near).all(), "{bounds:?}");
                }
            }
        }
    }
}

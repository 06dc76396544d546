//! Three points of `K` whose cone holds the ray, and the choice of the one that a new point replaces.
//!
//! Seen with the ray pointing at the viewer, the points `u0, u1, u2` run anticlockwise around it. The
//! direction opposite to a new point `w` lies between two neighbours `u_i` and `u_i+1`. These two stay,
//! and `w` replaces the third: the cone of `w`, `u_i` and `u_i+1` holds the ray exactly if `u_i` is
//! anticlockwise of `w` and `u_i+1` is clockwise of it.
//!
//! ```text
//!        u1                  The opposite of w lies between u1 and u2:
//!          \                 they stay, and w replaces u0.
//!    -w .   \
//!         ` .o---- u0        Signs of det(ray, w, u): u0 +, u1 +, u2 -.
//!           / ` .
//!          /      ` w
//!        u2
//! ```
//!
//! The signs are exact. If the ray meets an edge or a corner of the cone exactly, the ray counts as
//! shifted by `(e, e^2, e^3)` along A's axes, for an infinitely small `e`. Therefore every step is a
//! step of the simplex method on one fixed, non-degenerate problem, and cannot cycle (A. Charnes,
//! *Optimality and Degeneracy in Linear Programming*, 1952, doi:10.2307/1907845).

use glam::DVec3;

use crate::exact::{orient2d, orient3d, triangle_normal, triple_product};
use crate::pair::{Pair, Support};
use crate::tolerance::{THIN, TRIPLE_PRODUCT, U};

/// A number with the sign of `det(ray, w, u)`: positive if `u` lies anticlockwise of `w` about the
/// ray. It is 0 only if `w` and `u` are parallel.
#[inline]
fn turn(pair: &Pair<'_>, ray_cross_w: DVec3, w: DVec3, u: DVec3) -> f64 {
    let value = ray_cross_w.dot(u);
    if value.abs() > pair.sure_turn { value } else { exact_turn(pair.ray, w, u) }
}

#[cold]
fn exact_turn(ray: DVec3, w: DVec3, u: DVec3) -> f64 {
    let det = orient3d(ray, w, u, DVec3::ZERO);
    if det != 0.0 {
        return det;
    }
    // The coefficients of e, e^2 and e^3 in the determinant of the shifted ray.
    let minor = |a: usize, b: usize| orient2d([w[a], w[b]], [u[a], u[b]], [0.0; 2]);
    [minor(1, 2), minor(2, 0), minor(0, 1)].into_iter().find(|&m| m != 0.0).unwrap_or(0.0)
}

/// A number with the sign of `det(u0, u1, u2)`.
fn volume(pair: &Pair<'_>, [u0, u1, u2]: [DVec3; 3]) -> f64 {
    let value = u0.cross(u1).dot(u2);
    let sure = TRIPLE_PRODUCT * U * pair.circumradius * pair.circumradius * pair.circumradius;
    if value.abs() > sure { value } else { orient3d(u0, u1, u2, DVec3::ZERO) }
}

/// Three points of `K` whose cone holds the ray.
///
/// The points stay where they are stored, and a pivot only permutes their places. A point is thus
/// written long before it is read again, so that no read waits for a write.
pub(crate) struct Triple {
    places: [Support; 4],
    /// The places of the three, anticlockwise about the ray: corner `i` is in byte `i`.
    at: u32,
    /// The place that is not in use, for the next point.
    free: u32,
}

impl Triple {
    pub(crate) fn new([u0, u1, u2]: [Support; 3]) -> Self {
        Self { places: [u0, u1, u2, Support::default()], at: 0x02_01_00, free: 3 }
    }

    /// The three points, anticlockwise about the ray. None if their cone does not hold the ray.
    pub(crate) fn around(pair: &Pair<'_>, [u0, u1, u2]: [Support; 3]) -> Option<Self> {
        let [p0, p1, p2] = [u0.point, u1.point, u2.point];
        let turns = [(p0, p1), (p1, p2), (p2, p0)].map(|(u, v)| turn(pair, pair.ray.cross(u), u, v));
        let all = |sign: f64| turns.iter().fold(true, |all, &t| all & (sign * t > 0.0));
        if !(all(1.0) | all(-1.0)) {
            return None;
        }
        let last = [u2, u1];
        let flip = usize::from(turns[0] < 0.0);
        let along = [u0, last[1 - flip], last[flip]];
        // With a negative volume the line of the ray meets their triangle behind the origin.
        (volume(pair, along.map(|u| u.point)) > 0.0).then(|| Self::new(along))
    }

    /// The three points in the order whose normal points along the ray, and that normal. None if their
    /// triangle is thin.
    #[inline]
    pub(crate) fn along(pair: &Pair<'_>, [u0, u1, u2]: [Support; 3]) -> Option<(Self, Normal)> {
        let normal = Normal::plain([u0, u1, u2].map(|u| u.point))?;
        Some(if normal.n.dot(pair.ray) < 0.0 {
            (Self::new([u0, u2, u1]), Normal { n: -normal.n, ..normal })
        } else {
            (Self::new([u0, u1, u2]), normal)
        })
    }

    /// Corner `i` of the three.
    #[inline]
    pub(crate) fn get(&self, i: usize) -> &Support {
        &self.places[(self.at >> (8 * i) & 3) as usize]
    }

    /// The three corners.
    #[inline]
    pub(crate) fn supports(&self) -> [Support; 3] {
        [*self.get(0), *self.get(1), *self.get(2)]
    }

    /// Replaces by `w`, a point beyond the triangle's plane, the one corner without which the cone still
    /// holds the ray.
    #[inline]
    pub(crate) fn pivot(&mut self, pair: &Pair<'_>, w: Support) {
        self.places[(self.free & 3) as usize] = w;
        let across = pair.ray.cross(w.point);
        let [t0, t1, t2] = [0, 1, 2].map(|i| turn(pair, across, w.point, self.get(i).point));
        // Find the corner that goes. If one is parallel to w (its sign is 0), it goes. Otherwise the
        // neighbours `u_i`, `u_i+1` with signs + and - stay, in their order, and the third goes:
        // 1 if u2 and u0 stay, 2 if u0 and u1 stay, 0 otherwise. The branch would be unpredictable, so
        // the choice is computed.
        let goes = if t0 == 0.0 || t1 == 0.0 || t2 == 0.0 {
            [t0, t1, t2].iter().position(|&t| t == 0.0).unwrap_or(0) as u32
        } else {
            u32::from((t2 > 0.0) & (t0 < 0.0)) + 2 * u32::from((t0 > 0.0) & (t1 < 0.0))
        };
        // Rotate the places until the corner that goes is in byte 0. The product writes the three
        // bytes twice in a row, b0 b1 b2 b0 b1 b2, and the shift by whole bytes then leaves three
        // consecutive ones: the one that goes, and the two that stay in anticlockwise order.
        let in_turn = ((u64::from(self.at) * 0x1_00_00_01) >> (8 * goes)) as u32;
        self.at = in_turn & 0xff_ff_00 | self.free;
        self.free = in_turn & 0xff;
    }

    /// The outward normal of the triangle. Thin triangles take wide arithmetic.
    #[inline]
    pub(crate) fn normal(&self) -> Normal {
        if let Some(normal) = Normal::plain([0, 1, 2].map(|i| self.get(i).point)) {
            normal
        } else {
            // The normal is rebuilt from its coordinates. Otherwise the compiler passes the plain
            // one through memory too.
            let Normal { n, error_squared } = self.wide_normal();
            Normal { n: DVec3::new(n.x, n.y, n.z), error_squared }
        }
    }

    /// The outward normal in wide arithmetic: unit, and correct for every triangle.
    #[cold]
    pub(crate) fn wide_normal(&self) -> Normal {
        let n = triangle_normal(self.get(0).point, self.get(1).point, self.get(2).point).unit;
        Normal { n, error_squared: 1.0 }
    }
}

/// Outward normal of a triangle, and its error.
#[derive(Clone, Copy)]
pub(crate) struct Normal {
    pub(crate) n: DVec3,
    /// The square of a length whose roundoff is the error of the normal.
    pub(crate) error_squared: f64,
}

impl Normal {
    /// The normal in double precision. None if the triangle is thin.
    #[inline]
    fn plain([u0, u1, u2]: [DVec3; 3]) -> Option<Self> {
        let (e1, e2) = (u1 - u0, u2 - u0);
        let n = e1.cross(e2);
        let (length_squared, sides_squared) = (n.length_squared(), e1.length_squared() * e2.length_squared());
        // `(length + sides)^2` is at most this, which takes no square root.
        ((length_squared > 0.0) & (THIN * length_squared >= sides_squared))
            .then_some(Self { n, error_squared: 2.0 * (length_squared + sides_squared) })
    }
}

/// Weights `l` with `sum of l_i u_i = ray`, by Cramer's rule. They are not finite if the triple and
/// the origin lie in one plane.
pub(crate) fn weights(ray: DVec3, triple: &[Support; 3]) -> [f64; 3] {
    let [u0, u1, u2] = triple.map(|u| u.point);
    let (c0, c1, c2) = (u1.cross(u2), u2.cross(u0), u0.cross(u1));
    let volume = u0.dot(c0);
    [c0, c1, c2].map(|c| ray.dot(c) / volume)
}

/// [`weights`] by areas, for a triangle that is small or thin. The ray meets the plane of the triple at a
/// point `x`. The weights are the areas of the triangles of `x` and two corners, as shares of the whole
/// triangle, times the growth scale of the plane. The sides of a small triangle are differences with
/// hardly any rounding, whereas Cramer's rule multiplies whole points, whose products nearly cancel.
pub(crate) fn weights_by_areas(ray: DVec3, triple: &[Support; 3]) -> [f64; 3] {
    let [u0, u1, u2] = triple.map(|u| u.point);
    let (e1, e2) = (u1 - u0, u2 - u0);
    let n = e1.cross(e2);
    let (p, q) = (e2.cross(n), n.cross(e1));
    let (all, reach, height) = (e1.dot(p), n.dot(ray), n.dot(u0));
    // From u0 to x, times the reach.
    let w = ray * height - u0 * reach;
    let unit = 1.0 / (height * all);
    let [l1, l2] = [w.dot(p) * unit, w.dot(q) * unit];
    [reach / height - l1 - l2, l1, l2]
}

/// [`weights`] in wide arithmetic, for a triple that is nearly flat.
#[cold]
pub(crate) fn wide_weights(ray: DVec3, triple: &[Support; 3]) -> [f64; 3] {
    let [u0, u1, u2] = triple.map(|u| u.point);
    let volume = triple_product(u0, u1, u2);
    [(ray, u1, u2), (u0, ray, u2), (u0, u1, ray)].map(|(a, b, c)| triple_product(a, b, c) / volume)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// If only the exact branch reversed a sign, only ties would show it.
    #[test]
    fn plain_and_exact_turns_agree() {
        let (ray, w, u) = (DVec3::new(0.1, -0.2, 1.0), DVec3::new(0.7, 0.1, 0.3), DVec3::new(-0.2, 0.9, 0.4));
        for (w, u) in [(w, u), (u, w)] {
            let plain = ray.cross(w).dot(u);
            assert!(plain.abs() > 0.1);
            assert_eq!(exact_turn(ray, w, u).signum(), plain.signum());
        }
    }

    /// For a ray along an edge of the cone the shifted ray decides, in the same way for every triangle,
    /// and only parallel points tie.
    #[test]
    fn ties_are_broken_by_the_shifted_ray() {
        let (ray, w) = (DVec3::X, DVec3::new(2.0, 0.0, 0.0));
        let u = DVec3::new(1.0, 1.0, 0.0);
        // det(ray + (e, e^2, e^3), w, u) = 2 e^3.
        assert!(exact_turn(ray, w, u) > 0.0 && exact_turn(ray, u, w) < 0.0);
        assert_eq!(exact_turn(ray, w, ray), 0.0);
    }
}

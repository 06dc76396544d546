//! Three points of `K` whose cone holds the ray: where the ray leaves their
//! triangle, which of them a fourth point replaces.
//!
//! The signs that decide this are exact, and where the ray meets an edge or a
//! corner of the cone exactly, the ray is read as shifted by `(e, e^2, e^3)`
//! for an infinitely small `e` along the axes of A. So every step is a step of
//! the simplex method on one fixed, non-degenerate problem: it cannot cycle.

use glam::DVec3;

use crate::contact::exact::{orient2d, orient3d, triangle_normal, triple_product};
use crate::contact::pair::{Pair, Support};
use crate::contact::tolerance::{THIN, TRIPLE_PRODUCT, U};

/// Sign of `det(ray, w, u)`: whether `u` lies anticlockwise of `w` about the
/// ray. 0 only where `w` and `u` are parallel.
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
    // The determinant's coefficients of e, e^2 and e^3.
    let minor = |a: usize, b: usize| orient2d([w[a], w[b]], [u[a], u[b]], [0.0; 2]);
    [minor(1, 2), minor(2, 0), minor(0, 1)].into_iter().find(|&m| m != 0.0).unwrap_or(0.0)
}

/// Sign of `det(u0, u1, u2)`.
fn volume(pair: &Pair<'_>, [u0, u1, u2]: [DVec3; 3]) -> f64 {
    let value = u0.cross(u1).dot(u2);
    let sure = TRIPLE_PRODUCT * U * pair.circumradius * pair.circumradius * pair.circumradius;
    if value.abs() > sure { value } else { orient3d(u0, u1, u2, DVec3::ZERO) }
}

/// Three points of `K` whose cone holds the ray. They stay where they are, and
/// names of their places change: a point is long in memory when it is read again.
pub(crate) struct Triple {
    places: [Support; 4],
    /// Places of the three, anticlockwise about the ray, a byte each.
    at: u32,
    /// The place for the next.
    free: u32,
}

impl Triple {
    pub(crate) fn new([u0, u1, u2]: [Support; 3]) -> Self {
        Self { places: [u0, u1, u2, Support::default()], at: 0x02_01_00, free: 3 }
    }

    /// The three points anticlockwise about the ray, if their cone holds it.
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
        // Else the line of the ray meets their triangle behind the origin.
        (volume(pair, along.map(|u| u.point)) > 0.0).then(|| Self::new(along))
    }

    /// The three points in the order whose normal is along the ray, and that normal; none
    /// where their triangle is thin.
    #[inline]
    pub(crate) fn along(pair: &Pair<'_>, [u0, u1, u2]: [Support; 3]) -> Option<(Self, Normal)> {
        let normal = Normal::plain([u0, u1, u2].map(|u| u.point))?;
        Some(if normal.n.dot(pair.ray) < 0.0 {
            (Self::new([u0, u2, u1]), Normal { n: -normal.n, ..normal })
        } else {
            (Self::new([u0, u1, u2]), normal)
        })
    }

    /// One of the three.
    #[inline]
    pub(crate) fn get(&self, i: usize) -> &Support {
        &self.places[(self.at >> (8 * i) & 3) as usize]
    }

    /// The three.
    #[inline]
    pub(crate) fn supports(&self) -> [Support; 3] {
        [*self.get(0), *self.get(1), *self.get(2)]
    }

    /// Puts `w`, beyond the triangle's plane, in the place of the one point
    /// without which the cone still holds the ray.
    #[inline]
    pub(crate) fn pivot(&mut self, pair: &Pair<'_>, w: Support) {
        self.places[(self.free & 3) as usize] = w;
        let across = pair.ray.cross(w.point);
        let [t0, t1, t2] = [0, 1, 2].map(|i| turn(pair, across, w.point, self.get(i).point));
        // The two with opposite signs stay, in their order; a parallel one (0) goes.
        // Which is anyone's guess: chosen without branches.
        let goes = if t0 == 0.0 || t1 == 0.0 || t2 == 0.0 {
            [t0, t1, t2].iter().position(|&t| t == 0.0).unwrap_or(0) as u32
        } else {
            u32::from((t2 > 0.0) & (t0 < 0.0)) + 2 * u32::from((t0 > 0.0) & (t1 < 0.0))
        };
        // Three bytes twice: from any of them on come the three in turn.
        let in_turn = ((u64::from(self.at) * 0x1_00_00_01) >> (8 * goes)) as u32;
        self.at = in_turn & 0xff_ff_00 | self.free;
        self.free = in_turn & 0xff;
    }

    /// Its outward normal, in wide arithmetic where the triangle is thin.
    #[inline]
    pub(crate) fn normal(&self) -> Normal {
        if let Some(normal) = Normal::plain([0, 1, 2].map(|i| self.get(i).point)) {
            normal
        } else {
            // Taken apart: else the plain one would go through memory too.
            let Normal { n, error_squared } = self.wide_normal();
            Normal { n: DVec3::new(n.x, n.y, n.z), error_squared }
        }
    }

    /// The same, unit, whatever the triangle.
    #[cold]
    pub(crate) fn wide_normal(&self) -> Normal {
        let n = triangle_normal(self.get(0).point, self.get(1).point, self.get(2).point).unit;
        Normal { n, error_squared: 1.0 }
    }
}

/// Outward normal of a triangle, and how wrong it may be.
#[derive(Clone, Copy)]
pub(crate) struct Normal {
    pub(crate) n: DVec3,
    /// Roundoffs of a length whose square this is are its error.
    pub(crate) error_squared: f64,
}

impl Normal {
    /// Of a triangle that is not thin.
    #[inline]
    fn plain([u0, u1, u2]: [DVec3; 3]) -> Option<Self> {
        let (e1, e2) = (u1 - u0, u2 - u0);
        let n = e1.cross(e2);
        let (length_squared, sides_squared) = (n.length_squared(), e1.length_squared() * e2.length_squared());
        // (length + sides)^2 at most.
        ((length_squared > 0.0) & (THIN * length_squared >= sides_squared))
            .then_some(Self { n, error_squared: 2.0 * (length_squared + sides_squared) })
    }
}

/// Weights `l` with `sum of l_i u_i = ray` (Cramer's rule); not finite where the
/// triple is flat as seen from the origin.
pub(crate) fn weights(ray: DVec3, triple: &[Support; 3]) -> [f64; 3] {
    let [u0, u1, u2] = triple.map(|u| u.point);
    let (c0, c1, c2) = (u1.cross(u2), u2.cross(u0), u0.cross(u1));
    let volume = u0.dot(c0);
    [c0, c1, c2].map(|c| ray.dot(c) / volume)
}

/// The same in wide arithmetic, for a triple that is nearly flat.
#[cold]
pub(crate) fn wide_weights(ray: DVec3, triple: &[Support; 3]) -> [f64; 3] {
    let [u0, u1, u2] = triple.map(|u| u.point);
    let volume = triple_product(u0, u1, u2);
    [(ray, u1, u2), (u0, ray, u2), (u0, u1, ray)].map(|(a, b, c)| triple_product(a, b, c) / volume)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sign turned round in the exact branch alone would only show at ties.
    #[test]
    fn plain_and_exact_turns_agree() {
        let (ray, w, u) = (DVec3::new(0.1, -0.2, 1.0), DVec3::new(0.7, 0.1, 0.3), DVec3::new(-0.2, 0.9, 0.4));
        for (w, u) in [(w, u), (u, w)] {
            let plain = ray.cross(w).dot(u);
            assert!(plain.abs() > 0.1);
            assert_eq!(exact_turn(ray, w, u).signum(), plain.signum());
        }
    }

    /// A ray along an edge of the cone: the shifted ray decides, the same way
    /// for every triangle, and only parallel points tie.
    #[test]
    fn ties_are_broken_by_the_shifted_ray() {
        let (ray, w) = (DVec3::X, DVec3::new(2.0, 0.0, 0.0));
        let u = DVec3::new(1.0, 1.0, 0.0);
        // det(ray + (e, e^2, e^3), w, u) = 2 e^3.
        assert!(exact_turn(ray, w, u) > 0.0 && exact_turn(ray, u, w) < 0.0);
        assert_eq!(exact_turn(ray, w, ray), 0.0);
    }
}

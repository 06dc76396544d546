//! Orientation tests and triangle normals that are correct for every finite input.
//!
//! An orientation test returns the sign of a determinant: on which side of a plane (or of a line) a
//! point lies. The cheapest of three levels of arithmetic that is certain decides it:
//!
//! ```text
//! rounded     the determinant in doubles, if it exceeds its error bound    about 10 steps
//! expansions  exact sums of doubles, extended until the sign is certain    about 300 steps
//! integers    of any length, for coordinates whose products may underflow  about 10,000 steps
//! ```
//!
//! The first two levels are the adaptive predicates of the crate `robust` (J. R. Shewchuk,
//! *Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates*, 1997,
//! section 4, doi:10.1007/PL00009321). They are exact only while no product underflows or
//! overflows. So points with a coordinate outside 2^-280 to 2^280 (and not 0) take integers.
//!
//! Normals work in the same way. The cross product of two sides is computed in double-double
//! numbers, which suffices unless the triangle is a sliver. The normal of a sliver is computed in
//! integers. A cross product in plain doubles would be mostly rounding for thin triangles.

use glam::DVec3;
use robust::{Coord, Coord3D};

use super::stop::Meter;
use super::tolerance::{DEPTH, DOUBLE_DOUBLE_PRODUCT, SLIVER_SINE, SURELY_ROUNDED};

mod double_double;
mod wide;

pub(crate) use double_double::{Dd, Dd3, dd_cross, dd_dot, exact_difference, triple_product};

/// The biased exponent of 2^-280, the smallest nonzero coordinate for which `robust` is exact. The
/// last bit of such a coordinate is at least 2^-332, so the last bit of a product of three is at
/// least 2^-996, which is still a normal number.
const SAFE_LOW: u64 = 1023 - 280;
/// The biased exponent of 2^280. Coordinates below it cannot overflow in `robust`, with room to
/// spare.
const SAFE_HIGH: u64 = 1023 + 280;

/// Steps of an orientation test that the rounded value decides, as measured.
const ROUNDED_STEPS: u64 = 10;
/// Steps of an orientation test for points that are nearly in one plane, as measured.
const NEAR_PLANE_STEPS: u64 = 300;
/// Steps of an orientation test, or of a normal, in integers of any length, as measured.
pub(crate) const WIDE_STEPS: u64 = 10_000;

/// 2 to the power of `exponent`. The exponent is clamped to the range of normal numbers.
pub(crate) const fn power_of_two(exponent: i32) -> f64 {
    let clamped = if exponent < -1022 {
        -1022
    } else if exponent > 1023 {
        1023
    } else {
        exponent
    };
    f64::from_bits(((clamped + 1023) as u64) << 52)
}

/// The exponent `e` with `2^(e - 1) <= |x| < 2^e` if `x` is normal; -1022 if `x` is smaller.
pub(crate) fn exponent_above(x: f64) -> i32 {
    ((x.to_bits() >> 52) & 0x7ff) as i32 - 1022
}

/// The normal and the area of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TriangleNormal {
    /// The unit normal, accurate to 4 roundoffs however thin the triangle is. It points to the side
    /// from which the corners run anticlockwise. Zero if the corners are exactly collinear.
    pub(crate) unit: DVec3,
    /// Twice the area, in the units of the corners squared; 0 if that underflows.
    pub(crate) double_area: f64,
}

/// Twice the vector area of a triangle, that is, the cross product of two sides. Its value is
/// `mantissa * 2^exponents[0] * 2^exponents[1]`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct VectorArea {
    mantissa: Dd3,
    exponents: [i32; 2],
}

impl VectorArea {
    /// The doubled vector area of the triangle `a`, `b`, `c`, with an error of about 2^-102 of the
    /// product of two sides.
    pub(crate) fn new(a: DVec3, b: DVec3, c: DVec3) -> Self {
        // Each side is scaled to a length near 1, so that tiny triangles cannot underflow.
        let (ab, ab_exponent) = normalised(exact_difference(b, a));
        let (ac, ac_exponent) = normalised(exact_difference(c, a));
        Self { mantissa: dd_cross(ab, ac), exponents: [ab_exponent, ac_exponent] }
    }

    /// The approximate number of steps that the unit normal takes besides those of the area.
    pub(crate) fn normal_steps(&self) -> u64 {
        if self.is_sliver() { WIDE_STEPS } else { 0 }
    }

    /// Whether the triangle is a sliver, whose area is too inaccurate in double-double numbers.
    fn is_sliver(&self) -> bool {
        DVec3::from_array(self.mantissa.map(Dd::value)).abs().max_element() < SLIVER_SINE
    }

    /// The doubled vector area if the unit of length is 2^`unit`.
    pub(crate) fn value(&self, unit: i32) -> Dd3 {
        let [ab, ac] = self.exponents.map(|exponent| power_of_two(exponent - unit));
        self.mantissa.map(|x| x.scaled(ab).scaled(ac))
    }
}

/// The normal and the area of the triangle `a`, `b`, `c`.
pub(crate) fn triangle_normal(a: DVec3, b: DVec3, c: DVec3) -> TriangleNormal {
    normal_of(&VectorArea::new(a, b, c), a, b, c)
}

/// The normal and the area of the triangle `a`, `b`, `c`, given its doubled vector area. The normal
/// of a sliver is as accurate as that of any other triangle.
pub(crate) fn normal_of(area: &VectorArea, a: DVec3, b: DVec3, c: DVec3) -> TriangleNormal {
    let rounded = DVec3::from_array(area.mantissa.map(Dd::value));
    if rounded.abs().max_element() >= SLIVER_SINE {
        let length = rounded.length();
        let [ab, ac] = area.exponents.map(power_of_two);
        return TriangleNormal { unit: rounded / length, double_area: length * ab * ac };
    }
    let (mantissa, exponent) = wide::cross(a, b, c);
    let length = mantissa.length();
    if length == 0.0 {
        return TriangleNormal { unit: DVec3::ZERO, double_area: 0.0 };
    }
    let half = exponent / 2;
    let double_area = length * power_of_two(half) * power_of_two(exponent - half);
    TriangleNormal { unit: mantissa / length, double_area }
}

/// A lower bound of how far `p` is below the plane of the triangle `a`, `b`, `c`. `None` for
/// slivers.
pub(crate) fn depth_below(a: DVec3, b: DVec3, c: DVec3, p: DVec3) -> Option<f64> {
    // For a subnormal side, `normalised` clamps the exponent, so the side stays too small. A second
    // application brings it to the size of the other sides.
    let side = |to| normalised(normalised(exact_difference(to, a)).0).0;
    let cross = dd_cross(side(b), side(c));
    let length = DVec3::new(cross[0].value(), cross[1].value(), cross[2].value()).length();
    if length < SLIVER_SINE {
        return None;
    }
    let (pa, pa_exponent) = normalised(exact_difference(a, p));
    // Subtract the error of the products and of the roundings.
    let depth = (dd_dot(cross, pa).value() - DOUBLE_DOUBLE_PRODUCT) / length;
    Some((depth - DEPTH * depth.abs()) * power_of_two(pa_exponent))
}

/// Scales `v` by a power of two so that its largest component is in [0.5, 1). Returns the scaled
/// vector and the exponent of the factor that undoes the scaling.
fn normalised(v: Dd3) -> (Dd3, i32) {
    let exponent = exponent_above(v[0].hi.abs().max(v[1].hi.abs()).max(v[2].hi.abs()));
    let power = power_of_two(-exponent);
    (v.map(|x| x.scaled(power)), exponent)
}

/// Does the same as [`orient3d`], and counts the steps. A value larger than `sure` was certainly decided in
/// rounded arithmetic; see [`sure_orient3d`].
#[inline]
pub(crate) fn counted_orient3d(points: [DVec3; 4], sure: f64, meter: &Meter<'_>) -> f64 {
    let [a, b, c, d] = points;
    if !are_safe(&points) {
        meter.count(WIDE_STEPS);
        return wide::orient3d(a, b, c, d);
    }
    let value = adaptive_orient3d(a, b, c, d);
    meter.count(if value.abs() > sure { ROUNDED_STEPS } else { NEAR_PLANE_STEPS });
    value
}

/// For points that are at most `extent` apart: the size above which the value of [`orient3d`] was
/// certainly decided in rounded arithmetic.
pub(crate) fn sure_orient3d(extent: f64) -> f64 {
    SURELY_ROUNDED * extent * extent * extent
}

/// Whether `robust` is exact for these points. Checks all coordinates before it branches: one branch
/// instead of twelve.
#[inline]
fn are_safe(points: &[DVec3; 4]) -> bool {
    points.iter().fold(true, |safe, p| safe & is_safe(p.x) & is_safe(p.y) & is_safe(p.z))
}

/// Tells on which side of the plane through `a`, `b`, `c` the point `d` lies. Only the sign is exact: it is
/// negative on the side from which `a`, `b`, `c` run anticlockwise, and zero in the plane.
pub(crate) fn orient3d(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    if are_safe(&[a, b, c, d]) { adaptive_orient3d(a, b, c, d) } else { wide::orient3d(a, b, c, d) }
}

#[inline]
fn adaptive_orient3d(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    let coord = |p: DVec3| Coord3D { x: p.x, y: p.y, z: p.z };
    robust::orient3d(coord(a), coord(b), coord(c), coord(d))
}

/// The orientation of `a`, `b`, `c`. Only the sign is exact: it is positive if they turn anticlockwise, and
/// zero if they are on one line.
pub(crate) fn orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    if [a, b, c].iter().fold(true, |safe, p| safe & is_safe(p[0]) & is_safe(p[1])) {
        let coord = |p: [f64; 2]| Coord { x: p[0], y: p[1] };
        robust::orient2d(coord(a), coord(b), coord(c))
    } else {
        wide::orient2d(a, b, c)
    }
}

/// The approximate number of steps that [`orient2d`] took for these points to find `value`.
#[inline]
pub(crate) fn orient2d_steps(points: [[f64; 2]; 3], value: f64) -> u64 {
    if !points.iter().flatten().all(|&x| is_safe(x)) {
        return WIDE_STEPS / 4;
    }
    let [a, b, c] = points;
    let size = |p: [f64; 2]| (p[0] - c[0]).abs() + (p[1] - c[1]).abs();
    if value.abs() > SURELY_ROUNDED * size(a) * size(b) { ROUNDED_STEPS } else { NEAR_PLANE_STEPS / 4 }
}

/// Whether three points lie on one line, decided exactly.
pub(crate) fn collinear(a: DVec3, b: DVec3, c: DVec3) -> bool {
    let turn = |f: fn(DVec3) -> [f64; 2]| orient2d(f(a), f(b), f(c)) == 0.0;
    turn(|p| [p.x, p.y]) && turn(|p| [p.y, p.z]) && turn(|p| [p.z, p.x])
}

/// Whether `x` is 0 or in the range in which `robust` is exact.
fn is_safe(x: f64) -> bool {
    let exponent = x.to_bits() >> 52 & 0x7ff;
    (x == 0.0) | (exponent.wrapping_sub(SAFE_LOW) < SAFE_HIGH - SAFE_LOW)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::tolerance::U;
    use crate::workload::Random;

    /// Random numbers in [-1, 1).
    pub(super) fn stream(seed: u64) -> impl FnMut() -> f64 {
        let mut random = Random::new(seed);
        move || random.within(-1.0, 1.0)
    }

    fn vector(next: &mut impl FnMut() -> f64) -> DVec3 {
        DVec3::new(next(), next(), next())
    }

    /// Catches a fault in the expansions or in the integers, and a sign that means different sides
    /// in the two: both must give the same sign for points near a plane.
    #[test]
    fn wide_and_adaptive_signs_agree() {
        let mut next = stream(7);
        let mut signs = [0; 3];
        for i in 0..20_000 {
            let [a, b, c] = [(); 3].map(|()| vector(&mut next));
            // `d` is in the plane up to rounding or, with coordinates on a coarse grid, exactly.
            let grid = |p: DVec3| (p * 8.0).round();
            let (a, b, c) = if i % 2 == 0 { (a, b, c) } else { (grid(a), grid(b), grid(c)) };
            let d = a + (b - a) * 0.5 + (c - a) * if i % 3 == 0 { 2.0 } else { 0.25 };
            let sign = orient3d(a, b, c, d);
            assert_eq!(wide::orient3d(a, b, c, d), if sign == 0.0 { 0.0 } else { sign.signum() });
            signs[if sign == 0.0 { 0 } else { 1 + usize::from(sign > 0.0) }] += 1;
            let flat = |p: DVec3| [p.x, p.y];
            let turn = orient2d(flat(a), flat(b), flat(c));
            let sign = if turn == 0.0 { 0.0 } else { turn.signum() };
            assert_eq!(wide::orient2d(flat(a), flat(b), flat(c)), sign);
        }
        assert!(signs.iter().all(|&n| n > 1_500), "{signs:?}");
    }

    /// Catches a point that counts as in the plane because products underflow: the point is one
    /// subnormal step off the plane.
    #[test]
    fn one_subnormal_step_is_seen() {
        let step = f64::from_bits(1);
        let [a, b, c] = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let at = |z: f64| DVec3::new(0.25, 0.25, z);
        assert!(orient3d(a, b, c, at(-step)) > 0.0);
        assert!(orient3d(a, b, c, at(step)) < 0.0);
        assert_eq!(orient3d(a, b, c, at(0.0)), 0.0);
        assert!(orient2d([0.0, 0.0], [1.0, 0.0], [1.0, step]) > 0.0);
        assert!(!collinear(a, b, DVec3::new(2.0, 0.0, step)) && collinear(a, b, DVec3::X * 2.0));
        assert!(orient3d(a * 1e300, b * 1e300, c * 1e300, DVec3::Z) < 0.0);
    }

    /// Catches a normal of a sliver that differs from the normal of a fat triangle in the same plane.
    /// The relative error of a cross product in double precision grows with the inverse of the
    /// thinness.
    #[test]
    fn slivers_have_normals() {
        let mut next = stream(11);
        let mut thin = 0;
        for i in 0..4_200 {
            // u and v are small integers, so the sliver is exactly in their plane.
            let [u, v] = [(); 2].map(|()| (vector(&mut next) * 1024.0).round());
            let expected = u.cross(v);
            if expected == DVec3::ZERO {
                continue;
            }
            let (far, step) = (u * power_of_two(i % 14), v * power_of_two(-(i / 14 % 30)));
            let apex = far + step;
            let normal = triangle_normal(DVec3::ZERO, far, apex);
            // The plane is the same only if adding the step was exact.
            if apex - far == step {
                thin += usize::from(step.length() < SLIVER_SINE * far.length());
                assert!((normal.unit - expected.normalize()).length() < 8.0 * U, "{i}");
                let area = expected.length() * power_of_two(i % 14 - i / 14 % 30);
                assert!((normal.double_area / area - 1.0).abs() < 8.0 * U);
            }
        }
        assert!(thin > 40, "{thin}");
        // A height of 2^-1070, which double-double numbers cannot resolve.
        let apex = DVec3::new(0.5, power_of_two(-1022) / power_of_two(48), 0.0);
        let normal = triangle_normal(DVec3::ZERO, DVec3::X, apex);
        assert_eq!((normal.unit, normal.double_area), (DVec3::Z, apex.y));
        assert_eq!(triangle_normal(DVec3::ZERO, DVec3::X, DVec3::X * 3.0).unit, DVec3::ZERO);
    }

    /// Catches a depth above the truth, and one far below it. Either would spoil every inradius.
    #[test]
    fn depths_are_bounds_and_tight() {
        let mut next = stream(5);
        for _ in 0..1_000 {
            let [a, b, c, p] = [(); 4].map(|()| vector(&mut next));
            let (a, b, c) = if orient3d(a, b, c, p) > 0.0 { (a, b, c) } else { (a, c, b) };
            let depth = depth_below(a, b, c, p).unwrap();
            let normal = triangle_normal(a, b, c).unit;
            assert!((normal.dot(a - p) - depth).abs() < 32.0 * U);
        }
        let [a, b, c] = [DVec3::Z, DVec3::new(1.0, 0.0, 1.0), DVec3::new(0.0, 1.0, 1.0)];
        let depth = depth_below(a, b, c, DVec3::ZERO).unwrap();
        assert!(depth < 1.0 && depth > 1.0 - 16.0 * U);
        assert!(depth_below(a, b, c, DVec3::Z * (1.0 - 1e-15)).unwrap() > 0.99e-15);
        assert_eq!(depth_below(a, b, b, DVec3::ZERO), None);
    }
}

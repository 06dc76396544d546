//! Arithmetic beyond double precision: double-double numbers, and orientation
//! tests and triangle normals that are right for every finite input.
//!
//! The orientation tests are those of the crate `robust` (J. R. Shewchuk,
//! *Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric
//! Predicates*, 1997). These are exact only while no product underflows, so
//! coordinates outside [`SAFE_LOW`, `SAFE_HIGH`] take integers of any length.

use glam::DVec3;
use robust::{Coord, Coord3D};

mod wide;

/// Smallest nonzero coordinate for which `robust` is exact: its last bit is
/// 2^-332, that of a product of three 2^-996, still a normal number's.
const SAFE_LOW: f64 = power_of_two(-280);
/// Largest coordinate for which `robust` cannot overflow, with room to spare.
const SAFE_HIGH: f64 = power_of_two(280);
/// Unit roundoff of double precision.
pub(crate) const ROUNDOFF: f64 = power_of_two(-53);
/// Sine of the angle of two sides from which on a double-double cross product
/// is good to 2^-58 relative (its error is below 2^-98).
const SLIVER_SINE: f64 = power_of_two(-40);

/// 2^`exponent`, for exponents of normal numbers; others are clamped to them.
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

/// The `e` with `2^(e - 1) <= |x| < 2^e` for normal `x`; -1022 for smaller ones.
pub(crate) fn exponent_above(x: f64) -> i32 {
    ((x.to_bits() >> 52) & 0x7ff) as i32 - 1022
}

/// The unevaluated sum `hi + lo`, with `lo` at most half an ulp of `hi`.
///
/// Operations are good to a few 2^-106 relative to the operands' magnitude
/// (M. Joldes, J.-M. Muller and V. Popescu, *Tight and Rigorous Error Bounds
/// for Basic Building Blocks of Double-Word Arithmetic*, 2017). No fused
/// multiply-add, so that every machine gives the same bits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Dd {
    pub(crate) hi: f64,
    pub(crate) lo: f64,
}

/// `a + b` exactly, for any order of magnitudes (Knuth).
pub(crate) fn two_sum(a: f64, b: f64) -> Dd {
    let hi = a + b;
    let b_part = hi - a;
    Dd { hi, lo: (a - (hi - b_part)) + (b - b_part) }
}

/// `a - b` exactly.
pub(crate) fn two_diff(a: f64, b: f64) -> Dd {
    two_sum(a, -b)
}

/// `a + b` exactly where `|a| >= |b|` or `a` is 0 (Dekker).
fn quick_two_sum(a: f64, b: f64) -> Dd {
    let hi = a + b;
    Dd { hi, lo: b - (hi - a) }
}

/// Halves of at most 26 bits each, with sum `a` (Veltkamp). Needs `|a| < 2^996`.
fn split(a: f64) -> (f64, f64) {
    let scaled = a * 134_217_729.0; // 2^27 + 1
    let high = scaled - (scaled - a);
    (high, a - high)
}

/// `a * b` exactly where nothing underflows (Dekker).
pub(crate) fn two_prod(a: f64, b: f64) -> Dd {
    let hi = a * b;
    let (ah, al) = split(a);
    let (bh, bl) = split(b);
    Dd { hi, lo: ((ah * bh - hi) + ah * bl + al * bh) + al * bl }
}

impl Dd {
    /// The nearest double.
    pub(crate) fn value(self) -> f64 {
        self.hi + self.lo
    }

    /// Scaled by a power of two.
    fn scaled(self, power: f64) -> Self {
        Self { hi: self.hi * power, lo: self.lo * power }
    }
}

impl From<f64> for Dd {
    fn from(hi: f64) -> Self {
        Self { hi, lo: 0.0 }
    }
}

impl std::ops::Add for Dd {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let high = two_sum(self.hi, other.hi);
        let low = two_sum(self.lo, other.lo);
        let sum = quick_two_sum(high.hi, high.lo + low.hi);
        quick_two_sum(sum.hi, low.lo + sum.lo)
    }
}

impl std::ops::Neg for Dd {
    type Output = Self;
    fn neg(self) -> Self {
        Self { hi: -self.hi, lo: -self.lo }
    }
}

impl std::ops::Sub for Dd {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl std::ops::Mul for Dd {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let product = two_prod(self.hi, other.hi);
        quick_two_sum(product.hi, product.lo + (self.hi * other.lo + self.lo * other.hi))
    }
}

/// A vector of double-doubles.
pub(crate) type Dd3 = [Dd; 3];

/// `a - b` exactly.
pub(crate) fn exact_difference(a: DVec3, b: DVec3) -> Dd3 {
    [two_diff(a.x, b.x), two_diff(a.y, b.y), two_diff(a.z, b.z)]
}

/// Cross product, to about 2^-102 of the product of the lengths.
pub(crate) fn dd_cross(a: Dd3, b: Dd3) -> Dd3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Dot product, to about 2^-102 of the product of the lengths.
pub(crate) fn dd_dot(a: Dd3, b: Dd3) -> Dd {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Which way a triangle faces and how large it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TriangleNormal {
    /// Unit, to 4 roundoffs however thin the triangle; the side from which the
    /// corners run anticlockwise. Zero for corners that are exactly collinear.
    pub(crate) unit: DVec3,
    /// Twice the area, units of the corners squared; 0 where that underflows.
    pub(crate) double_area: f64,
}

/// Normal and size of the triangle `a`, `b`, `c`. Slivers, whose cross product
/// is noise in double precision, are as good as any other.
pub(crate) fn triangle_normal(a: DVec3, b: DVec3, c: DVec3) -> TriangleNormal {
    // Sides are brought near 1 each, so that tiny triangles cannot underflow.
    let (ab, ab_exponent) = normalised(exact_difference(b, a));
    let (ac, ac_exponent) = normalised(exact_difference(c, a));
    let cross = dd_cross(ab, ac);
    let rounded = DVec3::new(cross[0].value(), cross[1].value(), cross[2].value());
    if rounded.abs().max_element() >= SLIVER_SINE {
        let length = rounded.length();
        let double_area = length * power_of_two(ab_exponent) * power_of_two(ac_exponent);
        return TriangleNormal { unit: rounded / length, double_area };
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

/// Scaled by a power of two to a largest component in [0.5, 1), and its exponent.
fn normalised(v: Dd3) -> (Dd3, i32) {
    let exponent = exponent_above(v[0].hi.abs().max(v[1].hi.abs()).max(v[2].hi.abs()));
    let power = power_of_two(-exponent);
    (v.map(|x| x.scaled(power)), exponent)
}

/// Where `d` lies of the plane through `a`, `b`, `c`: only the sign is exact.
/// Negative on the side from which `a`, `b`, `c` run anticlockwise, zero on it.
pub(crate) fn orient3d(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    if [a, b, c, d].iter().all(|p| p.to_array().iter().all(is_safe)) {
        let coord = |p: DVec3| Coord3D { x: p.x, y: p.y, z: p.z };
        robust::orient3d(coord(a), coord(b), coord(c), coord(d))
    } else {
        wide::orient3d(a, b, c, d)
    }
}

/// Which way `a`, `b`, `c` turn: only the sign is exact. Positive anticlockwise.
pub(crate) fn orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    if [a, b, c].iter().all(|p| p.iter().all(is_safe)) {
        let coord = |p: [f64; 2]| Coord { x: p[0], y: p[1] };
        robust::orient2d(coord(a), coord(b), coord(c))
    } else {
        wide::orient2d(a, b, c)
    }
}

/// Whether three points lie on one line, exactly.
pub(crate) fn collinear(a: DVec3, b: DVec3, c: DVec3) -> bool {
    let turn = |f: fn(DVec3) -> [f64; 2]| orient2d(f(a), f(b), f(c)) == 0.0;
    turn(|p| [p.x, p.y]) && turn(|p| [p.y, p.z]) && turn(|p| [p.z, p.x])
}

fn is_safe(x: &f64) -> bool {
    *x == 0.0 || (SAFE_LOW..=SAFE_HIGH).contains(&x.abs())
}

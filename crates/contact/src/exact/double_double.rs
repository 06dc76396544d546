//! Double-double numbers: about 106 bits of precision from two doubles.
//!
//! A double-double is the exact sum of a double and its rounding error. The building blocks are
//! *error-free transformations*, which return the rounded result of an operation together with its
//! exact rounding error:
//!
//! ```text
//! two_sum        hi + lo = a + b         6 operations
//! quick_two_sum  hi + lo = a + b         3 operations, for |a| >= |b|
//! split          high + low = a          26 bits each
//! two_prod       hi + lo = a * b         17 operations, from split halves
//! ```
//!
//! They are from T. J. Dekker, *A floating-point technique for extending the available precision*,
//! 1971, doi:10.1007/BF01397083 (`split` is by Veltkamp), and `two_sum` from D. E. Knuth, *The Art
//! of Computer Programming*, volume 2, section 4.2.2.
//!
//! This is our own code, because the geometry needs few operations, on vectors, and their proven bounds depend
//! on exactly these steps.

use glam::DVec3;

/// The unevaluated sum `hi + lo`, where `lo` is at most half an ulp of `hi`.
///
/// The error of an operation is a few 2^-106 of the magnitude of its operands (M. Joldes, J.-M.
/// Muller and V. Popescu, *Tight and Rigorous Error Bounds for Basic Building Blocks of Double-Word
/// Arithmetic*, 2017, doi:10.1145/3121432; addition is their SloppyDWPlusDW, so it is not relative
/// to a result that cancels). No operation uses fused multiply-add, so that every machine gives the
/// same bits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Dd {
    pub(crate) hi: f64,
    pub(crate) lo: f64,
}

/// `a + b` exactly, whichever is larger (Knuth).
fn two_sum(a: f64, b: f64) -> Dd {
    let hi = a + b;
    let b_part = hi - a;
    Dd { hi, lo: (a - (hi - b_part)) + (b - b_part) }
}

/// `a - b` exactly.
fn two_diff(a: f64, b: f64) -> Dd {
    two_sum(a, -b)
}

/// `a + b` exactly if `|a| >= |b|` or `a` is 0 (Dekker).
fn quick_two_sum(a: f64, b: f64) -> Dd {
    let hi = a + b;
    Dd { hi, lo: b - (hi - a) }
}

/// Two halves of at most 26 bits each, whose sum is `a` (Veltkamp). Needs `|a| < 2^996`.
fn split(a: f64) -> (f64, f64) {
    let scaled = a * 134_217_729.0; // 2^27 + 1
    let high = scaled - (scaled - a);
    (high, a - high)
}

/// `a * b` exactly if nothing underflows (Dekker).
fn two_prod(a: f64, b: f64) -> Dd {
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

    /// The number times `power`, which must be a power of two.
    pub(super) fn scaled(self, power: f64) -> Self {
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
        quick_two_sum(high.hi, high.lo + (self.lo + other.lo))
    }
}

impl std::ops::Add<f64> for Dd {
    type Output = Self;
    fn add(self, other: f64) -> Self {
        let high = two_sum(self.hi, other);
        quick_two_sum(high.hi, high.lo + self.lo)
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

impl std::ops::Div for Dd {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let high = self.hi / other.hi;
        let rest = self - other * Self::from(high);
        quick_two_sum(high, rest.hi / other.hi)
    }
}

/// A vector of double-doubles.
pub(crate) type Dd3 = [Dd; 3];

/// `a - b` exactly.
pub(crate) fn exact_difference(a: DVec3, b: DVec3) -> Dd3 {
    [two_diff(a.x, b.x), two_diff(a.y, b.y), two_diff(a.z, b.z)]
}

/// The cross product, with an error of about 2^-102 of the product of the lengths.
pub(crate) fn dd_cross(a: Dd3, b: Dd3) -> Dd3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The dot product, with an error of about 2^-102 of the product of the lengths.
pub(crate) fn dd_dot(a: Dd3, b: Dd3) -> Dd {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a . (b x c)`, with an error of about 2^-102 of the product of the lengths, then rounded to a
/// double.
pub(crate) fn triple_product(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let wide = |v: DVec3| v.to_array().map(Dd::from);
    dd_dot(wide(a), dd_cross(wide(b), wide(c))).value()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exact::{power_of_two, tests::stream, wide};

    /// Catches a sum or a product that loses a bit: the exact value minus both parts must be 0.
    #[test]
    fn sums_and_products_are_exact() {
        let mut next = stream(3);
        for i in 0..1_000 {
            let (a, b) = (next() * power_of_two(i % 60), next());
            let (sum, product) = (two_sum(a, b), two_prod(a, b));
            assert_eq!((sum.hi, product.hi), (a + b, a * b));
            assert_eq!(wide::sign_of_sum(&[(a, 1.0), (b, 1.0), (sum.hi, -1.0), (sum.lo, -1.0)]), 0.0);
            assert_eq!(wide::sign_of_sum(&[(a, b), (product.hi, -1.0), (product.lo, -1.0)]), 0.0);
        }
    }
}

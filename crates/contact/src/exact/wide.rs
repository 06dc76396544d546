//! Integers of any length, for the few inputs for which expansions of doubles are not exact.
//!
//! Every double is an integer times a power of two. With the smallest power among all coordinates as
//! the unit, the coordinates are integers, and so are determinants and cross products. Schoolbook
//! arithmetic on digits in base 2^32 computes them exactly. The code aims to be plain, not fast.
//! It is our own code, so that the geometry depends on no crate for numbers that almost no input needs.

use std::cmp::Ordering;

use glam::DVec3;

/// A signed integer. The digits of its magnitude are in base 2^32, the lowest first, without leading
/// zeros.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Wide {
    negative: bool,
    digits: Vec<u32>,
}

impl Wide {
    /// `x / 2^unit`, which must be an integer: `unit` must be at most [`last_bit`] of `x`.
    fn from_double(x: f64, unit: i32) -> Self {
        let (mantissa, exponent) = decompose(x);
        if mantissa == 0 {
            return Self::default();
        }
        let shift = (exponent - unit) as u32;
        let mut digits = vec![0; (shift / 32) as usize];
        let mut rest = u128::from(mantissa) << (shift % 32);
        while rest != 0 {
            digits.push(rest as u32);
            rest >>= 32;
        }
        Self { negative: x < 0.0, digits }
    }

    fn plus(&self, other: &Self) -> Self {
        if self.negative == other.negative {
            return Self { negative: self.negative, digits: added(&self.digits, &other.digits) };
        }
        match compared(&self.digits, &other.digits) {
            Ordering::Equal => Self::default(),
            Ordering::Greater => {
                Self { negative: self.negative, digits: subtracted(&self.digits, &other.digits) }
            }
            Ordering::Less => {
                Self { negative: other.negative, digits: subtracted(&other.digits, &self.digits) }
            }
        }
    }

    fn minus(&self, other: &Self) -> Self {
        let negated = Self { negative: !other.negative && !other.digits.is_empty(), ..other.clone() };
        self.plus(&negated)
    }

    fn times(&self, other: &Self) -> Self {
        let mut digits = vec![0_u32; self.digits.len() + other.digits.len()];
        for (i, &a) in self.digits.iter().enumerate() {
            let mut carry = 0_u64;
            for (j, &b) in other.digits.iter().enumerate() {
                let sum = u64::from(a) * u64::from(b) + u64::from(digits[i + j]) + carry;
                digits[i + j] = sum as u32;
                carry = sum >> 32;
            }
            digits[i + other.digits.len()] = carry as u32;
        }
        trim(&mut digits);
        Self { negative: !digits.is_empty() && self.negative != other.negative, digits }
    }

    fn sign(&self) -> f64 {
        match (self.digits.is_empty(), self.negative) {
            (true, _) => 0.0,
            (false, true) => -1.0,
            (false, false) => 1.0,
        }
    }

    /// The number of bits of the magnitude.
    fn bits(&self) -> i32 {
        self.digits.last().map_or(0, |top| self.digits.len() as i32 * 32 - top.leading_zeros() as i32)
    }

    /// `self / 2^exponent` in double precision. `exponent` must be at least [`Wide::bits`].
    fn to_double(&self, exponent: i32) -> f64 {
        // The three highest digits hold at least 65 bits, more than the precision of a double.
        let lowest = self.digits.len().saturating_sub(3);
        let top = self.digits[lowest..].iter().rev().fold(0_u128, |sum, &d| sum << 32 | u128::from(d));
        let power = lowest as i32 * 32 - exponent;
        let half = power / 2;
        let size = top as f64 * super::power_of_two(half) * super::power_of_two(power - half);
        if self.negative { -size } else { size }
    }
}

/// `(m, e)` with `|x| = m 2^e`, where `m` is odd or 0.
fn decompose(x: f64) -> (u64, i32) {
    let bits = x.to_bits();
    let biased = ((bits >> 52) & 0x7ff) as i32;
    let fraction = bits & ((1 << 52) - 1);
    let (mantissa, exponent) =
        if biased == 0 { (fraction, -1074) } else { (fraction | 1 << 52, biased - 1075) };
    let zeros = if mantissa == 0 { 0 } else { mantissa.trailing_zeros() };
    (mantissa >> zeros, exponent + zeros as i32)
}

/// The largest `unit` for which every one of `values` is a multiple of 2^`unit`.
fn last_bit(values: impl Iterator<Item = f64>) -> i32 {
    let bit = |x| {
        let (mantissa, exponent) = decompose(x);
        (mantissa != 0).then_some(exponent)
    };
    values.filter_map(bit).min().unwrap_or(0)
}

fn trim(digits: &mut Vec<u32>) {
    while digits.last() == Some(&0) {
        digits.pop();
    }
}

fn compared(a: &[u32], b: &[u32]) -> Ordering {
    a.len().cmp(&b.len()).then_with(|| a.iter().rev().cmp(b.iter().rev()))
}

fn added(a: &[u32], b: &[u32]) -> Vec<u32> {
    let digit = |s: &[u32], i: usize| u64::from(s.get(i).copied().unwrap_or(0));
    let mut carry = 0;
    let mut sum: Vec<u32> = (0..=a.len().max(b.len()))
        .map(|i| {
            let total = digit(a, i) + digit(b, i) + carry;
            carry = total >> 32;
            total as u32
        })
        .collect();
    trim(&mut sum);
    sum
}

/// `a - b` for `a >= b`.
fn subtracted(a: &[u32], b: &[u32]) -> Vec<u32> {
    let mut borrow = 0;
    let mut difference: Vec<u32> = (0..a.len())
        .map(|i| {
            let rest = i64::from(a[i]) - i64::from(b.get(i).copied().unwrap_or(0)) - borrow;
            borrow = i64::from(rest < 0);
            rest as u32
        })
        .collect();
    trim(&mut difference);
    difference
}

/// `points - origin` as integers of one unit, and the exponent of that unit.
fn differences<const N: usize, const D: usize>(
    points: [[f64; D]; N],
    origin: [f64; D],
) -> ([[Wide; D]; N], i32) {
    let unit = last_bit(points.iter().flatten().chain(&origin).copied());
    let offset = origin.map(|x| Wide::from_double(x, unit));
    let difference = |p: [f64; D]| std::array::from_fn(|i| Wide::from_double(p[i], unit).minus(&offset[i]));
    (points.map(difference), unit)
}

fn cross_product(a: &[Wide; 3], b: &[Wide; 3]) -> [Wide; 3] {
    let component = |i: usize, j: usize| a[i].times(&b[j]).minus(&a[j].times(&b[i]));
    [component(1, 2), component(2, 0), component(0, 1)]
}

/// See [`super::orient3d`].
pub(super) fn orient3d(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    let ([a, b, c], _) = differences([a, b, c].map(|p| p.to_array()), d.to_array());
    let normal = cross_product(&b, &c);
    let volume = a[0].times(&normal[0]).plus(&a[1].times(&normal[1])).plus(&a[2].times(&normal[2]));
    volume.sign()
}

/// See [`super::orient2d`].
pub(super) fn orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    let ([a, b], _) = differences([a, b], c);
    a[0].times(&b[1]).minus(&a[1].times(&b[0])).sign()
}

/// `(m, e)` with `(b - a) x (c - a) = m 2^e`. Each component of `m` is rounded, and the largest is
/// in [0.5, 1]. `m` is zero if the cross product is exactly zero.
pub(super) fn cross(a: DVec3, b: DVec3, c: DVec3) -> (DVec3, i32) {
    let ([b, c], unit) = differences([b, c].map(|p| p.to_array()), a.to_array());
    let product = cross_product(&b, &c);
    let bits = product.iter().map(Wide::bits).max().unwrap_or(0);
    let [x, y, z] = product.map(|component| component.to_double(bits));
    (DVec3::new(x, y, z), bits + 2 * unit)
}

/// The sign of the sum of the products, decided exactly.
#[cfg(test)]
pub(super) fn sign_of_sum(products: &[(f64, f64)]) -> f64 {
    let [left, right] = [0, 1].map(|i| last_bit(products.iter().map(|p| if i == 0 { p.0 } else { p.1 })));
    let product = |&(a, b)| Wide::from_double(a, left).times(&Wide::from_double(b, right));
    products.iter().map(product).fold(Wide::default(), |sum, p| sum.plus(&p)).sign()
}

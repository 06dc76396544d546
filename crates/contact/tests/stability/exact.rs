//! Integers of any length for the exact answers. Every float is an integer times a power of two, so
//! products and sums of floats lose nothing.

use num_bigint::{BigInt, Sign};

pub(crate) type V = [BigInt; 3];

/// `x` as an odd integer times `2^exponent`, or `None` if `x` is 0.
pub(crate) fn parts(x: f64) -> Option<(BigInt, i32)> {
    assert!(x.is_finite(), "{x} is no number");
    if x == 0.0 {
        return None;
    }
    let bits = x.abs().to_bits();
    let (fraction, biased) = (bits & ((1 << 52) - 1), (bits >> 52) as i32);
    let (mantissa, exponent) =
        if biased == 0 { (fraction, -1074) } else { (fraction | 1 << 52, biased - 1075) };
    let zeros = mantissa.trailing_zeros();
    let odd = BigInt::from(mantissa >> zeros);
    Some((if x < 0.0 { -odd } else { odd }, exponent + zeros as i32))
}

/// The largest exponent such that all values are integer multiples of its power of two; 0 if all
/// values are 0.
pub(crate) fn common_exponent(values: impl IntoIterator<Item = f64>) -> i32 {
    values.into_iter().filter_map(parts).map(|(_, e)| e).min().unwrap_or(0)
}

/// `x / 2^exponent`; `x` must be a multiple of `2^exponent`.
pub(crate) fn integer(x: f64, exponent: i32) -> BigInt {
    let shifted = |(m, e): (BigInt, i32)| m << usize::try_from(e - exponent).expect("a common exponent");
    parts(x).map_or(BigInt::ZERO, shifted)
}

pub(crate) fn vector(v: [f64; 3], exponent: i32) -> V {
    v.map(|x| integer(x, exponent))
}

pub(crate) fn dot(a: &V, b: &V) -> BigInt {
    &a[0] * &b[0] + &a[1] * &b[1] + &a[2] * &b[2]
}

pub(crate) fn cross(a: &V, b: &V) -> V {
    let minor = |i: usize, j: usize| &a[i] * &b[j] - &a[j] * &b[i];
    [minor(1, 2), minor(2, 0), minor(0, 1)]
}

pub(crate) fn minus(a: &V, b: &V) -> V {
    [&a[0] - &b[0], &a[1] - &b[1], &a[2] - &b[2]]
}

pub(crate) fn plus(a: &V, b: &V) -> V {
    [&a[0] + &b[0], &a[1] + &b[1], &a[2] + &b[2]]
}

pub(crate) fn times(a: &V, by: &BigInt) -> V {
    [&a[0] * by, &a[1] * by, &a[2] * by]
}

pub(crate) fn negative(x: &BigInt) -> bool {
    x.sign() == Sign::Minus
}

pub(crate) fn positive(x: &BigInt) -> bool {
    x.sign() == Sign::Plus
}

pub(crate) fn zero(x: &BigInt) -> bool {
    x.sign() == Sign::NoSign
}

/// `x` as a float below 2^64 and the exponent of a power of two, rounded to about half an ulp.
pub(crate) fn approximate(x: &BigInt) -> (f64, i64) {
    let bits = x.bits() as i64;
    let drop = (bits - 64).max(0);
    let top = (x.magnitude() >> drop as usize).iter_u64_digits().next().unwrap_or(0) as f64;
    (if negative(x) { -top } else { top }, drop)
}

/// `num / den * 2^exponent`, rounded to about one ulp.
pub(crate) fn quotient(num: &BigInt, den: &BigInt, exponent: i64) -> f64 {
    let ((n, ne), (d, de)) = (approximate(num), approximate(den));
    scale(n / d, ne - de + exponent)
}

/// `x * 2^exponent` without overflow in between.
pub(crate) fn scale(mut x: f64, exponent: i64) -> f64 {
    let mut left = exponent.clamp(-10_000, 10_000) as i32;
    while left != 0 {
        let step = left.clamp(-1000, 1000);
        x *= 2f64.powi(step);
        left -= step;
    }
    x
}

/// All vectors divided by one power of two, so that every coordinate is at most 1 in size.
pub(crate) fn unit_floats(vectors: &[V]) -> Vec<[f64; 3]> {
    let bits = vectors.iter().flatten().map(|x| x.bits()).max().unwrap_or(0) as i64;
    let float = |x: &BigInt| {
        let (top, exponent) = approximate(x);
        scale(top, exponent - bits)
    };
    vectors.iter().map(|v| [float(&v[0]), float(&v[1]), float(&v[2])]).collect()
}

//! Unevaluated sums of two doubles, with about 106 significant bits, so that the check's own
//! rounding is far below every budget that it checks. After Dekker, *A floating-point technique for
//! extending the available precision* (1971).

use std::ops::{Add, Div, Mul, Neg, Sub};

/// `high + low`, with `low` at most half an ulp of `high`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Dd {
    pub(crate) high: f64,
    low: f64,
}

fn two_sum(a: f64, b: f64) -> Dd {
    let high = a + b;
    let b_part = high - a;
    Dd { high, low: (a - (high - b_part)) + (b - b_part) }
}

/// Exact if `|a| >= |b|`.
fn quick_two_sum(a: f64, b: f64) -> Dd {
    let high = a + b;
    Dd { high, low: b - (high - a) }
}

impl From<f64> for Dd {
    fn from(value: f64) -> Self {
        Self { high: value, low: 0.0 }
    }
}

impl From<Dd> for f64 {
    fn from(value: Dd) -> Self {
        value.high + value.low
    }
}

impl Add for Dd {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let (s, t) = (two_sum(self.high, other.high), two_sum(self.low, other.low));
        let s = quick_two_sum(s.high, s.low + t.high);
        quick_two_sum(s.high, s.low + t.low)
    }
}

impl Neg for Dd {
    type Output = Self;
    fn neg(self) -> Self {
        Self { high: -self.high, low: -self.low }
    }
}

impl Sub for Dd {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Dd {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let high = self.high * other.high;
        let low = self.high.mul_add(other.high, -high) + (self.high * other.low + self.low * other.high);
        quick_two_sum(high, low)
    }
}

impl Div for Dd {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let first = self.high / other.high;
        let rest = self - other * first.into();
        let second = rest.high / other.high;
        let third = (rest - other * second.into()).high / other.high;
        quick_two_sum(first, second) + third.into()
    }
}

/// A vector of double-doubles.
pub(crate) type Dd3 = [Dd; 3];

pub(crate) fn wide(v: [f64; 3]) -> Dd3 {
    v.map(Dd::from)
}

pub(crate) fn narrow(v: Dd3) -> [f64; 3] {
    v.map(f64::from)
}

pub(crate) fn dot(a: Dd3, b: Dd3) -> Dd {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn minus(a: Dd3, b: Dd3) -> Dd3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(crate) fn plus(a: Dd3, b: Dd3) -> Dd3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// The rows of the rotation `I + (2 / |q|^2) (...)` of a quaternion `x, y, z, w` of any norm.
pub(crate) fn rotation(q: [f64; 4]) -> [Dd3; 3] {
    let [x, y, z, w] = q.map(Dd::from);
    let one = Dd::from(1.0);
    let s = Dd::from(2.0) / (x * x + y * y + z * z + w * w);
    [
        [one - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), one - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), one - s * (x * x + y * y)],
    ]
}

pub(crate) fn rotate(rows: &[Dd3; 3], v: [f64; 3]) -> Dd3 {
    rows.map(|row| dot(row, wide(v)))
}

//! Lanes: one number of each of several pairs, with one type for each instruction set.
//!
//! [`Lanes`] is implemented by `f64`, which is the definition, and in `x86` by vectors of 2, 4 and 8
//! doubles. That file is the only one of this module with `unsafe`. Every operation is one that IEEE 754 defines, or
//! moves bits, so every instruction set gives the same bits in every lane: there is no fused
//! multiply-add and no approximate reciprocal. [`Lanes::max`] and [`Lanes::min`] return their second
//! argument if the two are equal or unordered, as the instructions do.
//!
//! # How an instruction set is chosen
//!
//! [`InstructionSet`] looks at the CPU, and calls the entry function of the instruction set. Only the
//! entry functions have `#[target_feature]`. Everything below them is generic and `#[inline(always)]`,
//! so it becomes part of the entry function and is compiled for that function's instructions. A helper without
//! `#[inline(always)]`, or a closure or `array::map` around an operation, is compiled for the plain
//! instruction set instead: each operation in it then becomes a call, which is right but takes three
//! to five times as long. The benchmark `make bench` shows such a loss.

#[cfg(target_arch = "x86_64")]
mod x86;

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

/// Lanes of the widest type, and the pairs of a group.
pub(crate) const WIDTH: usize = 8;

/// One number of each pair of a group.
pub(crate) type Row = [f64; WIDTH];

/// A yes or no in each lane.
pub(super) trait Mask:
    Copy + BitAnd<Output = Self> + BitOr<Output = Self> + Not<Output = Self>
{
    /// Bit `k` is set if lane `k` is.
    fn bits(self) -> u32;

    /// Whether any lane is set.
    #[inline(always)]
    fn any(self) -> bool {
        self.bits() != 0
    }
}

/// One double in each lane. The operators work in each lane by itself.
pub(super) trait Lanes:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// The number of lanes; it divides [`WIDTH`].
    const COUNT: usize;
    /// The result of a comparison.
    type Mask: Mask;

    /// The same number in every lane.
    fn splat(x: f64) -> Self;
    /// Lane `k` of result `i` is number `i` of row `at + k`: the rows become lanes.
    fn transposed(rows: &[&Row; WIDTH], at: usize) -> [Self; WIDTH];
    /// Writes the lanes to `row`, from place `at` on.
    fn store(self, row: &mut Row, at: usize);
    /// The square root, correctly rounded.
    fn sqrt(self) -> Self;
    /// The magnitude.
    fn abs(self) -> Self;
    /// `self` if it is larger, otherwise `other`.
    fn max(self, other: Self) -> Self;
    /// `self` if it is smaller, otherwise `other`.
    fn min(self, other: Self) -> Self;
    /// Whether `self > other`; false for NaN.
    fn gt(self, other: Self) -> Self::Mask;
    /// Whether `self >= other`; false for NaN.
    fn ge(self, other: Self) -> Self::Mask;
    /// `yes` where the mask is set, otherwise `no`.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// The magnitude of `self` with the sign of `sign`.
    fn copysign(self, sign: Self) -> Self;
    /// The next larger double of a positive, finite one.
    fn next_up(self) -> Self;
    /// The next smaller double of a positive, finite one.
    fn next_down(self) -> Self;
}

impl Mask for bool {
    #[inline(always)]
    fn bits(self) -> u32 {
        u32::from(self)
    }
}

/// One lane: the definition, and the form for single pairs.
impl Lanes for f64 {
    const COUNT: usize = 1;
    type Mask = bool;

    #[inline(always)]
    fn splat(x: f64) -> Self {
        x
    }

    #[inline(always)]
    fn transposed(rows: &[&Row; WIDTH], at: usize) -> [Self; WIDTH] {
        *rows[at]
    }

    #[inline(always)]
    fn store(self, row: &mut Row, at: usize) {
        row[at] = self;
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }

    #[inline(always)]
    fn abs(self) -> Self {
        self.abs()
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }

    #[inline(always)]
    fn gt(self, other: Self) -> bool {
        self > other
    }

    #[inline(always)]
    fn ge(self, other: Self) -> bool {
        self >= other
    }

    #[inline(always)]
    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }

    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        self.copysign(sign)
    }

    #[inline(always)]
    fn next_up(self) -> Self {
        f64::from_bits(self.to_bits().wrapping_add(1))
    }

    #[inline(always)]
    fn next_down(self) -> Self {
        f64::from_bits(self.to_bits().wrapping_sub(1))
    }
}

/// A computation that is written for any lanes.
pub(super) trait Kernel {
    /// Computes. Implementations are `#[inline(always)]`.
    fn run<L: Lanes>(self);
}

/// An instruction set that this machine has, for [`box_manifolds_with`](crate::box_manifolds_with).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InstructionSet(Kind);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Scalar,
    #[cfg(target_arch = "x86_64")]
    Vectors(x86::Vectors),
}

impl InstructionSet {
    /// One lane, on every machine.
    pub(super) const SCALAR: Self = Self(Kind::Scalar);

    /// All instruction sets of this machine, from the narrowest to the widest.
    pub fn available() -> impl DoubleEndedIterator<Item = Self> {
        #[cfg(target_arch = "x86_64")]
        let vectors = x86::Vectors::available().map(|vectors| Self(Kind::Vectors(vectors)));
        #[cfg(not(target_arch = "x86_64"))]
        let vectors = std::iter::empty();
        std::iter::once(Self::SCALAR).chain(vectors)
    }

    /// The widest instruction set of this machine.
    pub fn widest() -> Self {
        Self::available().next_back().unwrap_or(Self::SCALAR)
    }

    /// The name of the instruction set, and its number of lanes.
    pub const fn name(self) -> &'static str {
        match self.0 {
            Kind::Scalar => "one lane",
            #[cfg(target_arch = "x86_64")]
            Kind::Vectors(vectors) => vectors.name(),
        }
    }

    /// Computes with the lanes of this instruction set.
    #[inline]
    pub(super) fn run<K: Kernel>(self, kernel: K) {
        match self.0 {
            Kind::Scalar => kernel.run::<f64>(),
            #[cfg(target_arch = "x86_64")]
            Kind::Vectors(vectors) => vectors.run(kernel),
        }
    }
}

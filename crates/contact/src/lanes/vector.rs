//! Vectors and matrices of lanes. The sums are formed in the order in which they are written.

use std::ops::{Add, Mul, Neg, Sub};

use super::simd::{Lanes, Row};

/// A vector in each lane.
#[derive(Clone, Copy)]
pub(super) struct Vector<L> {
    pub(super) x: L,
    pub(super) y: L,
    pub(super) z: L,
}

impl<L: Lanes> Vector<L> {
    #[inline(always)]
    pub(super) fn new(x: L, y: L, z: L) -> Self {
        Self { x, y, z }
    }

    #[inline(always)]
    pub(super) fn splat(x: L) -> Self {
        Self { x, y: x, z: x }
    }

    #[inline(always)]
    pub(super) fn dot(self, other: Self) -> L {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    #[inline(always)]
    pub(super) fn cross(self, other: Self) -> Self {
        Self {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    #[inline(always)]
    pub(super) fn scale(self, factor: L) -> Self {
        Self { x: self.x * factor, y: self.y * factor, z: self.z * factor }
    }

    /// The product of each coordinate with that of the other vector.
    #[inline(always)]
    pub(super) fn times(self, other: Self) -> Self {
        Self { x: self.x * other.x, y: self.y * other.y, z: self.z * other.z }
    }

    #[inline(always)]
    pub(super) fn abs(self) -> Self {
        Self { x: self.x.abs(), y: self.y.abs(), z: self.z.abs() }
    }

    #[inline(always)]
    pub(super) fn length(self) -> L {
        self.dot(self).sqrt()
    }

    #[inline(always)]
    pub(super) fn max_element(self) -> L {
        self.x.max(self.y).max(self.z)
    }

    #[inline(always)]
    pub(super) fn min_element(self) -> L {
        self.x.min(self.y).min(self.z)
    }

    /// The smaller of each two coordinates.
    #[inline(always)]
    pub(super) fn min(self, other: Self) -> Self {
        Self { x: self.x.min(other.x), y: self.y.min(other.y), z: self.z.min(other.z) }
    }

    /// The magnitudes of this vector's coordinates with the signs of the other's.
    #[inline(always)]
    pub(super) fn copysign(self, sign: Self) -> Self {
        Self { x: self.x.copysign(sign.x), y: self.y.copysign(sign.y), z: self.z.copysign(sign.z) }
    }

    /// `1 / x` of each coordinate, by one division.
    #[inline(always)]
    pub(super) fn inverses(self) -> Self {
        let yz = self.y * self.z;
        let inverse = L::splat(1.0) / (yz * self.x);
        Self { x: yz * inverse, y: self.z * self.x * inverse, z: self.x * self.y * inverse }
    }

    #[inline(always)]
    pub(super) fn store(self, rows: &mut [Row; 3], at: usize) {
        self.x.store(&mut rows[0], at);
        self.y.store(&mut rows[1], at);
        self.z.store(&mut rows[2], at);
    }

    #[inline(always)]
    pub(super) fn select(mask: L::Mask, yes: Self, no: Self) -> Self {
        Self {
            x: L::select(mask, yes.x, no.x),
            y: L::select(mask, yes.y, no.y),
            z: L::select(mask, yes.z, no.z),
        }
    }
}

impl<L: Lanes> Add for Vector<L> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }
}

impl<L: Lanes> Sub for Vector<L> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }
}

impl<L: Lanes> Neg for Vector<L> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self { x: -self.x, y: -self.y, z: -self.z }
    }
}

/// A matrix in each lane, by its columns.
#[derive(Clone, Copy)]
pub(super) struct Matrix<L> {
    pub(super) x: Vector<L>,
    pub(super) y: Vector<L>,
    pub(super) z: Vector<L>,
}

impl<L: Lanes> Matrix<L> {
    #[inline(always)]
    pub(super) fn abs(self) -> Self {
        Self { x: self.x.abs(), y: self.y.abs(), z: self.z.abs() }
    }

    /// The product of the transposed matrix and a vector.
    #[inline(always)]
    pub(super) fn transposed_times(self, v: Vector<L>) -> Vector<L> {
        Vector { x: self.x.dot(v), y: self.y.dot(v), z: self.z.dot(v) }
    }

    /// The product of the transposed matrix and another matrix.
    #[inline(always)]
    pub(super) fn transposed_times_matrix(self, other: Self) -> Self {
        Self {
            x: self.transposed_times(other.x),
            y: self.transposed_times(other.y),
            z: self.transposed_times(other.z),
        }
    }
}

impl<L: Lanes> Mul<Vector<L>> for Matrix<L> {
    type Output = Vector<L>;

    #[inline(always)]
    fn mul(self, v: Vector<L>) -> Vector<L> {
        self.x.scale(v.x) + self.y.scale(v.y) + self.z.scale(v.z)
    }
}

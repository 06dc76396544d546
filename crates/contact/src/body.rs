//! A hull at a pose.

use glam::{DMat3, DVec3};

use super::ConvexHull;

/// Positions with a coordinate beyond this magnitude (caller's units) are refused.
pub(super) const MAX_POSITION: f64 = 1e100;
/// The least norm of a quaternion that is accepted and normalised.
pub(super) const MIN_NORM: f64 = 0.25;
/// The largest norm of a quaternion that is accepted and normalised. Rounding and drift stay far
/// inside this range, so a norm outside it is more likely to be an error of the caller.
pub(super) const MAX_NORM: f64 = 4.0;

/// The reason why a pose is not usable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InvalidPose {
    /// A coordinate is not finite, or its magnitude is above 1e100.
    Position,
    /// A component is not finite, or the norm is not in 0.25 to 4.
    Rotation,
}

impl std::fmt::Display for InvalidPose {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Position => "a position's coordinate is not finite, or its magnitude is above 1e100",
            Self::Rotation => "a quaternion's component is not finite, or its norm is not in 0.25 to 4",
        })
    }
}

impl std::error::Error for InvalidPose {}

/// A pose: maps a hull's own frame to the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// World position of the hull frame's origin.
    pub(super) translation: DVec3,
    /// Rotation, orthonormal to rounding.
    pub(super) rotation: DMat3,
}

impl Pose {
    /// A pose from a position (caller's units) and a quaternion `x, y, z, w`. The quaternion's norm must
    /// be in 0.25 to 4; the quaternion is normalised.
    ///
    /// # Errors
    /// [`InvalidPose`] says whether the position or the rotation is not usable.
    #[inline]
    pub fn new(position: [f64; 3], rotation: [f64; 4]) -> Result<Self, InvalidPose> {
        let norm_squared = Self::check(position, rotation)?;
        let [x, y, z, w] = rotation;
        // The matrix is I + (2 / |q|^2) (...), which is rational in the quaternion, so that exact
        // arithmetic can follow it without a square root.
        let s = 2.0 / norm_squared;
        let (xs, ys, zs) = (x * s, y * s, z * s);
        let rotation = DMat3::from_cols(
            DVec3::new(1.0 - (y * ys + z * zs), x * ys + w * zs, x * zs - w * ys),
            DVec3::new(x * ys - w * zs, 1.0 - (x * xs + z * zs), y * zs + w * xs),
            DVec3::new(x * zs + w * ys, y * zs - w * xs, 1.0 - (x * xs + y * ys)),
        );
        Ok(Self { translation: DVec3::from_array(position), rotation })
    }

    /// A point of the world (caller's units) in the hull's own frame.
    pub fn local(&self, point: DVec3) -> DVec3 {
        self.rotation.transpose() * (point - self.translation)
    }

    /// Makes the checks of [`Pose::new`] and returns the quaternion's squared norm.
    ///
    /// # Errors
    /// The errors of [`Pose::new`].
    #[inline]
    pub fn check(position: [f64; 3], [x, y, z, w]: [f64; 4]) -> Result<f64, InvalidPose> {
        if !position.iter().all(|c| c.abs() <= MAX_POSITION) {
            return Err(InvalidPose::Position);
        }
        let norm_squared = x * x + y * y + z * z + w * w;
        if !(MIN_NORM * MIN_NORM..=MAX_NORM * MAX_NORM).contains(&norm_squared) {
            return Err(InvalidPose::Rotation);
        }
        Ok(norm_squared)
    }
}

/// A hull at a pose.
#[derive(Clone, Copy, Debug)]
pub struct Body<'a> {
    /// The shape.
    pub hull: &'a ConvexHull,
    /// Its position and rotation in the world.
    pub pose: Pose,
}

impl<'a> Body<'a> {
    /// `hull` at `pose`.
    #[inline]
    pub fn new(hull: &'a ConvexHull, pose: Pose) -> Self {
        Self { hull, pose }
    }
}

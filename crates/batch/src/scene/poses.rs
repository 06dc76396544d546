//! The poses and motions of the bodies of a scene.

use hullcast_contact::{Pose, Stopped, stop::Meter};

use super::{SceneError, pose_lengths};
use crate::motion::{MOTION_STEPS, Motions, has_bits_of};

/// Elementary steps of checking a pose.
const POSE_STEPS: u64 = 10;

/// Poses and motions as they arrived. A body's pose is converted when one of its pairs is computed. So compute
/// threads do this work, and until then a pose takes 56 bytes instead of 104.
#[derive(Clone, Debug, Default)]
pub struct Poses {
    positions: Vec<f64>,
    rotations: Vec<f64>,
    motions: Motions,
}

impl Poses {
    /// The poses of `bodies` bodies at rest, and the indices of the bodies without a usable pose, in ascending
    /// order. Such a body makes only its own pairs INVALID.
    ///
    /// # Errors
    /// A column has another number of entries than the bodies need, or the check was stopped.
    pub fn new(
        bodies: usize,
        positions: Vec<f64>,
        rotations: Vec<f64>,
        meter: &Meter<'_>,
    ) -> Result<(Self, Vec<u32>), SceneError> {
        Self::moving(bodies, positions, rotations, Motions::default(), meter)
    }

    /// The poses of `bodies` bodies with these motions, and the indices of the bodies of which the pose or the
    /// motion is not usable, in ascending order.
    ///
    /// # Errors
    /// A column has another number of entries than the bodies need, or the check was stopped.
    pub fn moving(
        bodies: usize,
        positions: Vec<f64>,
        rotations: Vec<f64>,
        motions: Motions,
        meter: &Meter<'_>,
    ) -> Result<(Self, Vec<u32>), SceneError> {
        pose_lengths(bodies, &positions, &rotations)?;
        let poses = Self { positions, rotations, motions };
        let unusable = poses.unusable(meter)?;
        Ok((poses, unusable))
    }

    /// The indices of the bodies of which the pose or the motion is not usable, in ascending order.
    ///
    /// # Errors
    /// The check was stopped.
    pub fn unusable(&self, meter: &Meter<'_>) -> Result<Vec<u32>, Stopped> {
        let at_rest = self.motions.is_absent();
        let steps = if at_rest { POSE_STEPS } else { POSE_STEPS + MOTION_STEPS };
        let (positions, rotations) = (self.positions.as_chunks::<3>().0, self.rotations.as_chunks::<4>().0);
        let bodies = positions.iter().zip(rotations).enumerate();
        let unusable = |(body, (position, rotation)): (usize, (&[f64; 3], &[f64; 4]))| {
            Pose::check(*position, *rotation).is_err() || (!at_rest && self.motions.get(body).is_none())
        };
        // The unusable bodies are counted first, so that the list is allocated once.
        let mut count = 0;
        for body in bodies.clone() {
            meter.spend(steps)?;
            count += usize::from(unusable(body));
        }
        let mut invalid = Vec::with_capacity(count);
        if count > 0 {
            for body in bodies {
                meter.spend(steps)?;
                if unusable(body) {
                    invalid.push(body.0 as u32);
                }
            }
        }
        Ok(invalid)
    }

    /// The same poses with these motions, which are those of as many bodies.
    #[must_use]
    pub fn with_motions(self, motions: Motions) -> Self {
        Self { motions, ..self }
    }

    /// The motions of the bodies.
    pub fn motions(&self) -> &Motions {
        &self.motions
    }

    /// The number of poses.
    pub fn count(&self) -> usize {
        self.positions.len() / 3
    }

    /// The bytes of the poses and motions.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.positions[..]) + size_of_val(&self.rotations[..]) + self.motions.heap_bytes()
    }

    /// Whether a body and a body of `other` have poses and motions with the same bits.
    pub(crate) fn is_same(&self, body: usize, other: &Self, its: usize) -> bool {
        self.has_pose_of(body, other, its) && self.motions.is_same(body, &other.motions, its)
    }

    /// Whether a body and a body of `other` have poses with the same bits.
    fn has_pose_of(&self, body: usize, other: &Self, its: usize) -> bool {
        has_bits_of(&self.positions[3 * body..][..3], &other.positions[3 * its..][..3])
            && has_bits_of(&self.rotations[4 * body..][..4], &other.rotations[4 * its..][..4])
    }

    /// Exchanges the pose of a body with a pose of `other`. Returns whether they had different bits.
    pub(crate) fn exchange(&mut self, body: usize, other: &mut Self, its: usize) -> bool {
        let differ = !self.has_pose_of(body, other, its);
        self.positions[3 * body..][..3].swap_with_slice(&mut other.positions[3 * its..][..3]);
        self.rotations[4 * body..][..4].swap_with_slice(&mut other.rotations[4 * its..][..4]);
        differ
    }

    /// The pose of a body, or `None` if it or the body's motion is not usable.
    pub fn get(&self, body: usize) -> Option<Pose> {
        if !self.motions.is_absent() {
            self.motions.get(body)?;
        }
        let (positions, _) = self.positions.as_chunks::<3>();
        let (rotations, _) = self.rotations.as_chunks::<4>();
        Pose::new(positions[body], rotations[body]).ok()
    }
}

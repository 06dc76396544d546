//! The motion of the bodies of a scene during a step, and the margins of pairs that follow from it.
//!
//! The margin of the pair (A, B) is
//!
//! ```text
//! margin + (margins[A] + margins[B])                                          of every pair
//!   + the largest distance by which A and B approach each other in the step   if bodies move
//! ```
//!
//! in this order. The last term is that of [`hullcast_contact::approach`]. If it is not 0, the sum is rounded
//! up, so that no pair is missed that touches within the step. Without margins of bodies and without motion, a
//! pair's margin is that of the query, and costs nothing more.

use std::sync::Arc;

use hullcast_contact::{Motion, stop::Meter};

use crate::scene::{SceneError, SceneFault, has_length};

/// The largest margin of a body and the longest step.
const LARGEST: f64 = 1e100;

/// Elementary steps of checking the motion of a body.
pub(crate) const MOTION_STEPS: u64 = 10;

/// The motion of bodies as a program states it. The default is no motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MotionColumns {
    /// Empty, or for each body the velocity of its turning point: 3 numbers, world axes.
    pub linear_velocities: Vec<f64>,
    /// Empty, or for each body the rate at which it turns about its turning point: 3 numbers, world axes,
    /// radians per unit of time.
    pub angular_velocities: Vec<f64>,
    /// Empty, or for each body its turning point, which moves at the linear velocity: 3 numbers, hull frame.
    /// Without this column, bodies turn about the origins of their hulls' frames.
    pub turning_points: Vec<f64>,
    /// The length of the step, 0 to 1e100. At 0 nothing moves.
    pub time_step: f64,
}

impl MotionColumns {
    /// The columns with their names, and the number of entries of each.
    fn columns(&self) -> [(&'static str, &Vec<f64>); 3] {
        [
            ("linear_velocities", &self.linear_velocities),
            ("angular_velocities", &self.angular_velocities),
            ("turning_points", &self.turning_points),
        ]
    }

    /// Checks the lengths of the columns; `rule` says how long they are.
    ///
    /// # Errors
    /// A column is not empty and has another number of entries than `bodies` need.
    pub fn check_lengths(&self, bodies: usize, rule: &str) -> Result<(), SceneFault> {
        for (field, column) in self.columns() {
            if !column.is_empty() {
                has_length(column.len(), 3 * bodies, field, rule)?;
            }
        }
        Ok(())
    }

    /// Checks the time step.
    ///
    /// # Errors
    /// The time step is outside 0 to 1e100.
    pub fn check_time_step(&self) -> Result<(), SceneFault> {
        if (0.0..=LARGEST).contains(&self.time_step) {
            return Ok(());
        }
        Err(SceneFault::out_of_range("time_step", self.time_step, "0 to 1e100"))
    }
}

/// The motion of the bodies of a scene, checked. Clones share the columns.
#[derive(Clone, Debug, Default)]
pub struct Motions {
    linear_velocities: Arc<Vec<f64>>,
    angular_velocities: Arc<Vec<f64>>,
    turning_points: Arc<Vec<f64>>,
    time_step: f64,
}

impl Motions {
    /// The motion of `bodies` bodies.
    ///
    /// # Errors
    /// A column is neither empty nor has 3 numbers per body, or the time step is out of its range.
    pub fn new(bodies: usize, columns: MotionColumns) -> Result<Self, SceneFault> {
        columns.check_lengths(bodies, "none or 3 per body")?;
        columns.check_time_step()?;
        let MotionColumns { linear_velocities, angular_velocities, turning_points, time_step } = columns;
        let [linear_velocities, angular_velocities, turning_points] =
            [linear_velocities, angular_velocities, turning_points].map(Arc::new);
        Ok(Self { linear_velocities, angular_velocities, turning_points, time_step })
    }

    /// The motion of the next message of a stream, whose bodies and order are those of `self`.
    ///
    /// `sent` has the columns of the message: each is empty or has 3 numbers per body or, with `moved`, 3 per
    /// entry of `moved`. The entries of `moved` are ascending indices of bodies, each below `bodies`. A body
    /// without a new value keeps its value; before any value was sent it is 0. The time step is always that of
    /// the message. The caller takes [`Motions::next_bytes`] of memory first.
    ///
    /// # Errors
    /// A column has another length, the time step is out of its range, or the work was stopped.
    pub fn next(
        &self,
        bodies: usize,
        moved: Option<&[u32]>,
        sent: MotionColumns,
        meter: &Meter<'_>,
    ) -> Result<Self, SceneError> {
        match moved {
            None => sent.check_lengths(bodies, "none or 3 per body")?,
            Some(moved) => sent.check_lengths(moved.len(), "none or 3 per entry of moved")?,
        }
        sent.check_time_step()?;
        let next = |kept: &Arc<Vec<f64>>, sent: Vec<f64>| {
            let Some(moved) = moved else {
                return Ok(if sent.is_empty() { kept.clone() } else { Arc::new(sent) });
            };
            if sent.is_empty() {
                return Ok(kept.clone());
            }
            meter.spend((3 * bodies / 4) as u64)?;
            let mut column = if kept.is_empty() { vec![0.0; 3 * bodies] } else { kept.to_vec() };
            let (places, _) = column.as_chunks_mut::<3>();
            for (&body, &value) in moved.iter().zip(sent.as_chunks::<3>().0) {
                meter.spend(2)?;
                if let Some(place) = places.get_mut(body as usize) {
                    *place = value;
                }
            }
            Ok::<_, SceneError>(Arc::new(column))
        };
        Ok(Self {
            linear_velocities: next(&self.linear_velocities, sent.linear_velocities)?,
            angular_velocities: next(&self.angular_velocities, sent.angular_velocities)?,
            turning_points: next(&self.turning_points, sent.turning_points)?,
            time_step: sent.time_step,
        })
    }

    /// Whether the motion is that of `before` by its memory, so that no body has to be compared.
    pub fn is_kept_from(&self, before: &Self) -> bool {
        let columns = |motions: &Self| {
            [&motions.linear_velocities, &motions.angular_velocities, &motions.turning_points]
                .map(Arc::as_ptr)
        };
        columns(self) == columns(before) && self.step() == before.step()
    }

    /// The most bytes that [`Motions::next`] allocates for a message with `moved`.
    pub fn next_bytes(bodies: usize, sent: &MotionColumns) -> usize {
        let changed = sent.columns().iter().filter(|(_, column)| !column.is_empty()).count();
        changed * 3 * bodies * size_of::<f64>()
    }

    /// The bytes of the columns.
    pub fn heap_bytes(&self) -> usize {
        let columns = [&self.linear_velocities, &self.angular_velocities, &self.turning_points];
        columns.iter().map(|column| size_of_val(&column[..])).sum()
    }

    /// Whether a body adds to the margins of its pairs what a body of `other` adds: the bits of the two motions
    /// are the same, and the steps take the same time or the body is at rest.
    ///
    /// The margin of a pair of which both bodies are the same as before, and which has A and B as before, has the
    /// same bits: it depends on the motions, and on the step only through bodies that move.
    pub(crate) fn is_same(&self, body: usize, other: &Self, its: usize) -> bool {
        if self.is_absent() && other.is_absent() {
            return true;
        }
        let (mine, others) = (self.rows(body), other.rows(its));
        let [linear, angular, _] = mine;
        mine.iter().zip(&others).all(|(one, other)| has_bits_of(one, other))
            && (self.step() == other.step() || [linear, angular] == [[0.0; 3]; 2])
    }

    /// The entries of a body: linear and angular velocity, and turning point.
    fn rows(&self, body: usize) -> [[f64; 3]; 3] {
        [&self.linear_velocities, &self.angular_velocities, &self.turning_points]
            .map(|column| column.as_chunks::<3>().0.get(body).copied().unwrap_or_default())
    }

    /// Whether the scene has no column of motion.
    pub fn is_absent(&self) -> bool {
        self.linear_velocities.is_empty()
            && self.angular_velocities.is_empty()
            && self.turning_points.is_empty()
    }

    /// The length of the step, or `None` if no body moves in it.
    pub(crate) fn step(&self) -> Option<f64> {
        let moves = !self.linear_velocities.is_empty() || !self.angular_velocities.is_empty();
        (moves && self.time_step > 0.0).then_some(self.time_step)
    }

    /// The motion of a body, or `None` if a number of it is not usable.
    pub(crate) fn get(&self, body: usize) -> Option<Motion> {
        let [linear, angular, turning_point] = self.rows(body);
        Motion::new(linear, angular, turning_point)
    }
}

/// Whether two rows of numbers have the same bits.
pub(crate) fn has_bits_of(one: &[f64], other: &[f64]) -> bool {
    one.iter().zip(other).all(|(a, b)| a.to_bits() == b.to_bits())
}

/// Checks the margins of bodies.
///
/// # Errors
/// There is neither no margin nor one per body, a margin is outside 0 to 1e100, or the check was stopped.
pub(crate) fn check_margins(margins: &[f64], bodies: usize, meter: &Meter<'_>) -> Result<(), SceneError> {
    if margins.is_empty() {
        return Ok(());
    }
    margin_lengths(margins, bodies)?;
    for (some, first) in margins.chunks(1 << 16).zip((0..).step_by(1 << 16)) {
        meter.spend(some.len() as u64)?;
        if let Some(at) = some.iter().position(|margin| !(0.0..=LARGEST).contains(margin)) {
            let fault = SceneFault::out_of_range("margins", some[at], "0 to 1e100");
            return Err(SceneFault { index: Some(first + at), ..fault }.into());
        }
    }
    Ok(())
}

/// Checks the length of the column of margins.
///
/// # Errors
/// There is neither no margin nor one per body.
pub fn margin_lengths(margins: &[f64], bodies: usize) -> Result<(), SceneFault> {
    if margins.is_empty() {
        Ok(())
    } else {
        has_length(margins.len(), bodies, "margins", "none or one per body")
    }
}

#[cfg(test)]
mod tests {
    use hullcast_contact::Stop;

    use super::*;

    fn columns(motions: &Motions) -> [Vec<f64>; 3] {
        [&motions.linear_velocities, &motions.angular_velocities, &motions.turning_points]
            .map(|column| column.to_vec())
    }

    /// Catches a value that goes to another body, a column that is lost or kept although it was sent, and bytes that
    /// are not counted before they are taken.
    #[test]
    fn a_message_replaces_the_values_of_moved_bodies() {
        let stop = Stop::default();
        let meter = &Meter::new(&stop);
        let first =
            MotionColumns { linear_velocities: (0..9).map(f64::from).collect(), ..Default::default() };
        let first = Motions::new(3, first).unwrap();
        let sent = MotionColumns {
            linear_velocities: vec![10.0, 11.0, 12.0, 20.0, 21.0, 22.0],
            turning_points: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
            time_step: 0.5,
            ..Default::default()
        };
        assert_eq!(Motions::next_bytes(3, &sent), 2 * 9 * 8);
        let next = first.next(3, Some(&[0, 2]), sent, meter).unwrap();
        let [linear, angular, points] = columns(&next);
        assert_eq!(linear, [10.0, 11.0, 12.0, 3.0, 4.0, 5.0, 20.0, 21.0, 22.0]);
        assert_eq!((angular.len(), points), (0, vec![1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 4.0, 5.0, 6.0]));
        assert_eq!((next.step(), next.heap_bytes()), (Some(0.5), 18 * 8));
        // All bodies: a column that is sent replaces the other, and one that is not sent stays.
        let sent = MotionColumns { turning_points: vec![7.0; 9], ..Default::default() };
        let last = next.next(3, None, sent, meter).unwrap();
        assert_eq!(columns(&last), [linear, vec![], vec![7.0; 9]]);
        assert_eq!(last.step(), None, "the time step is that of the message");
        // No body has moved.
        let still = last.next(3, Some(&[]), MotionColumns::default(), meter).unwrap();
        assert_eq!(columns(&still), columns(&last));
        for (moved, length, rule) in
            [(None, 6, "none or 3 per body"), (Some(&[1_u32][..]), 9, "none or 3 per entry of moved")]
        {
            let sent = MotionColumns { angular_velocities: vec![0.0; length], ..Default::default() };
            let Err(SceneError::Fault(fault)) = last.next(3, moved, sent, meter) else { panic!("{rule}") };
            assert!(fault.field == "angular_velocities" && fault.message.contains(rule), "{fault}");
        }
        let sent = MotionColumns { time_step: -1.0, ..Default::default() };
        assert!(last.next(3, None, sent, meter).is_err());
    }
}

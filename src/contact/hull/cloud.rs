//! The points as given, checked and made ready for the quickhull.

use std::cmp::Ordering;

use glam::DVec3;

use super::{HullError, HullErrorKind};
use crate::contact::exact::{exponent_above, power_of_two};

/// Smallest and largest extent of a hull, caller's units.
const SIZES: std::ops::RangeInclusive<f64> = 1e-50..=1e50;

/// Distinct finite points in lexicographic order, so that nothing that is built
/// from them depends on the order in which they were given.
#[derive(Clone, Debug)]
pub(super) struct Cloud {
    /// Caller's units, -0.0 made 0.0: what exact tests look at.
    pub(super) points: Vec<DVec3>,
    /// Divided by [`Cloud::unit`]: what rounded arithmetic looks at.
    pub(super) scaled: Vec<DVec3>,
    /// Index of each point among those given; of duplicates the lowest.
    pub(super) registered: Vec<u32>,
    /// Power of two that brings the largest extent into [0.5, 1).
    pub(super) unit: f64,
    /// Per axis, of the scaled points; rounded up.
    pub(super) extent: DVec3,
}

impl Cloud {
    pub(super) fn new(given: &[[f64; 3]]) -> Result<Self, HullError> {
        check_finite(given)?;
        if u32::try_from(given.len()).is_err() {
            let detail = format!("{} points are more than indices of 32 bits can name", given.len());
            return Err(HullError { kind: HullErrorKind::TooManyVertices, index: None, detail });
        }
        // Adding 0.0 turns -0.0 into 0.0 and leaves everything else.
        let mut order: Vec<(DVec3, u32)> =
            given.iter().zip(0..).map(|(&p, i)| (DVec3::from_array(p) + 0.0, i)).collect();
        order.sort_unstable_by(|(p, i), (q, j)| lexicographic(*p, *q).then(i.cmp(j)));
        order.dedup_by_key(|(p, _)| *p);
        if order.len() < 4 {
            let detail = format!("{} distinct points of {}, at least 4 needed", order.len(), given.len());
            return Err(HullError { kind: HullErrorKind::TooFewPoints, index: None, detail });
        }
        let (points, registered): (Vec<_>, Vec<_>) = order.into_iter().unzip();
        let extent = extent(&points);
        let size = extent.max_element();
        if !SIZES.contains(&size) {
            let detail = format!("the largest extent, {size:e}, is outside [1e-50, 1e50]");
            return Err(HullError { kind: HullErrorKind::SizeOutOfRange, index: None, detail });
        }
        let exponent = exponent_above(size);
        let shrink = power_of_two(-exponent);
        let scaled = points.iter().map(|&p| p * shrink).collect();
        // One ulp up for the subtraction that made it.
        let extent = extent * shrink * (1.0 + f64::EPSILON);
        Ok(Self { points, scaled, registered, unit: power_of_two(exponent), extent })
    }

    /// These points alone; `keep` ascending.
    pub(super) fn subset(&self, keep: &[u32]) -> Self {
        let pick = |from: &[DVec3]| keep.iter().map(|&i| from[i as usize]).collect();
        Self {
            points: pick(&self.points),
            scaled: pick(&self.scaled),
            registered: keep.iter().map(|&i| self.registered[i as usize]).collect(),
            ..*self
        }
    }
}

fn check_finite(given: &[[f64; 3]]) -> Result<(), HullError> {
    for (index, point) in given.iter().enumerate() {
        if let Some((axis, value)) = ["x", "y", "z"].iter().zip(point).find(|(_, c)| !c.is_finite()) {
            let detail = format!("point {index}: {axis} is {value}");
            return Err(HullError { kind: HullErrorKind::NotFinite, index: Some(index), detail });
        }
    }
    Ok(())
}

/// Finite coordinates without -0.0, so that the order is total.
fn lexicographic(p: DVec3, q: DVec3) -> Ordering {
    p.to_array().partial_cmp(&q.to_array()).unwrap_or(Ordering::Equal)
}

/// Largest minus smallest coordinate, per axis.
fn extent(points: &[DVec3]) -> DVec3 {
    let (low, high) = points
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
    high - low
}

//! The points as given, checked and made ready for the quickhull.

use std::cmp::Ordering;

use glam::DVec3;

use super::{BuildError, HullError, HullErrorKind};
use crate::contact::exact::{exponent_above, power_of_two};
use crate::contact::sort::{COMPARISON, sort};
use crate::contact::stop::{Meter, Stopped};

/// Points that are read, moved or written between two looks at the meter.
const BLOCK: usize = 1 << 14;
/// Steps for each point of one pass over the points.
const PASS: u64 = 4;

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
    pub(super) fn new(given: &[[f64; 3]], meter: &Meter<'_>) -> Result<Self, BuildError> {
        check_finite(given, meter)?;
        if u32::try_from(given.len()).is_err() {
            let detail = format!("{} points are more than indices of 32 bits can name", given.len());
            return Err(HullError { kind: HullErrorKind::TooManyVertices, index: None, detail }.into());
        }
        // Adding 0.0 turns -0.0 into 0.0 and leaves everything else.
        let mut order: Vec<(DVec3, u32)> = Vec::with_capacity(given.len());
        for (block, start) in given.chunks(BLOCK).zip((0..).step_by(BLOCK)) {
            meter.spend(PASS * block.len() as u64)?;
            order.extend(block.iter().zip(start..).map(|(&p, i)| (DVec3::from_array(p) + 0.0, i)));
        }
        sort(&mut order, meter, COMPARISON, |(p, i), (q, j)| lexicographic(*p, *q).then(i.cmp(j)))?;
        drop_duplicates(&mut order, meter)?;
        if order.len() < 4 {
            let detail = format!("{} distinct points of {}, at least 4 needed", order.len(), given.len());
            return Err(HullError { kind: HullErrorKind::TooFewPoints, index: None, detail }.into());
        }
        let (mut points, mut registered) = (Vec::with_capacity(order.len()), Vec::with_capacity(order.len()));
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for block in order.chunks(BLOCK) {
            meter.spend(2 * PASS * block.len() as u64)?;
            points.extend(block.iter().map(|(p, _)| *p));
            registered.extend(block.iter().map(|(_, i)| *i));
            (low, high) = block.iter().fold((low, high), |(low, high), (p, _)| (low.min(*p), high.max(*p)));
        }
        let extent = high - low;
        let size = extent.max_element();
        if !SIZES.contains(&size) {
            let detail = format!("the largest extent, {size:e}, is outside [1e-50, 1e50]");
            return Err(HullError { kind: HullErrorKind::SizeOutOfRange, index: None, detail }.into());
        }
        let exponent = exponent_above(size);
        let shrink = power_of_two(-exponent);
        let mut scaled = Vec::with_capacity(points.len());
        for block in points.chunks(BLOCK) {
            meter.spend(PASS * block.len() as u64)?;
            scaled.extend(block.iter().map(|&p| p * shrink));
        }
        // One ulp up for the subtraction that made it.
        let extent = extent * shrink * (1.0 + f64::EPSILON);
        Ok(Self { points, scaled, registered, unit: power_of_two(exponent), extent })
    }

    /// These points alone; `keep` ascending.
    pub(super) fn subset(&self, keep: &[u32], meter: &Meter<'_>) -> Result<Self, Stopped> {
        let (points, scaled, registered) = (Vec::new(), Vec::new(), Vec::new());
        let mut subset = Self { points, scaled, registered, ..*self };
        subset.points.reserve_exact(keep.len());
        subset.scaled.reserve_exact(keep.len());
        subset.registered.reserve_exact(keep.len());
        for block in keep.chunks(BLOCK) {
            meter.spend(3 * PASS * block.len() as u64)?;
            subset.points.extend(block.iter().map(|&i| self.points[i as usize]));
            subset.scaled.extend(block.iter().map(|&i| self.scaled[i as usize]));
            subset.registered.extend(block.iter().map(|&i| self.registered[i as usize]));
        }
        Ok(subset)
    }
}

fn check_finite(given: &[[f64; 3]], meter: &Meter<'_>) -> Result<(), BuildError> {
    for (index, point) in given.iter().enumerate() {
        meter.spend(PASS)?;
        if let Some((axis, value)) = ["x", "y", "z"].iter().zip(point).find(|(_, c)| !c.is_finite()) {
            let detail = format!("point {index}: {axis} is {value}");
            return Err(HullError { kind: HullErrorKind::NotFinite, index: Some(index), detail }.into());
        }
    }
    Ok(())
}

/// Leaves the first of equal points, which are next to each other.
fn drop_duplicates(order: &mut Vec<(DVec3, u32)>, meter: &Meter<'_>) -> Result<(), Stopped> {
    let mut kept = 0;
    for i in 0..order.len() {
        meter.spend(PASS)?;
        if kept == 0 || order[kept - 1].0 != order[i].0 {
            order[kept] = order[i];
            kept += 1;
        }
    }
    order.truncate(kept);
    Ok(())
}

/// Finite coordinates without -0.0, so that the order is total.
fn lexicographic(p: DVec3, q: DVec3) -> Ordering {
    p.to_array().partial_cmp(&q.to_array()).unwrap_or(Ordering::Equal)
}

//! Checks the points that were given and prepares them for the quickhull.

use std::cmp::Ordering;

use glam::DVec3;

use super::error::plain;
use super::{BuildError, HullError, HullErrorKind};
use crate::exact::{exponent_above, power_of_two};
use crate::sort::{COMPARISON, sort};
use crate::stop::{Meter, Stopped};

/// The number of points that are read, moved or written between two checks of the meter.
const BLOCK: usize = 1 << 14;
/// Steps per point in one pass over the points.
const PASS: u64 = 4;

/// The allowed range of a hull's largest extent; caller's units.
const SIZES: std::ops::RangeInclusive<f64> = 1e-50..=1e50;

/// Distinct finite points in lexicographic order. Sorting makes everything that is built from
/// them independent of the order in which the points were given.
#[derive(Clone, Debug)]
pub(super) struct Cloud {
    /// The points in the caller's units, with -0.0 replaced by 0.0. Exact tests use these.
    pub(super) points: Vec<DVec3>,
    /// The points divided by [`Cloud::unit`]. Rounded arithmetic uses these.
    pub(super) scaled: Vec<DVec3>,
    /// For each point, its index among the given points; the lowest index of its duplicates.
    pub(super) registered: Vec<u32>,
    /// A power of two: dividing by it brings the largest extent into [0.5, 1).
    pub(super) unit: f64,
    /// The extent of the scaled points along each axis, rounded up.
    pub(super) extent: DVec3,
}

impl Cloud {
    pub(super) fn new(given: &[[f64; 3]], meter: &Meter<'_>) -> Result<Self, BuildError> {
        check_finite(given, meter)?;
        if u32::try_from(given.len()).is_err() {
            let detail = format!("{} points are more than indices of 32 bits can name", given.len());
            return Err(HullError { kind: HullErrorKind::TooManyVertices, index: None, detail }.into());
        }
        // Adding 0.0 turns -0.0 into 0.0 and leaves every other value as it is.
        let mut order: Vec<(DVec3, u32)> = Vec::with_capacity(given.len());
        for (block, start) in given.chunks(BLOCK).zip((0..).step_by(BLOCK)) {
            meter.spend(PASS * block.len() as u64)?;
            order.extend(block.iter().zip(start..).map(|(&p, i)| (DVec3::from_array(p) + 0.0, i)));
        }
        sort(&mut order, meter, COMPARISON, |(p, i), (q, j)| lexicographic(*p, *q).then(i.cmp(j)))?;
        drop_duplicates(&mut order, meter)?;
        if order.len() < 4 {
            let detail =
                format!("got {} distinct points of {}, at least 4 are needed", order.len(), given.len());
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
            let size = plain(size);
            let detail = format!("the largest extent, {size}, is outside [1e-50, 1e50]");
            return Err(HullError { kind: HullErrorKind::SizeOutOfRange, index: None, detail }.into());
        }
        let exponent = exponent_above(size);
        let shrink = power_of_two(-exponent);
        let mut scaled = Vec::with_capacity(points.len());
        for block in points.chunks(BLOCK) {
            meter.spend(PASS * block.len() as u64)?;
            scaled.extend(block.iter().map(|&p| p * shrink));
        }
        // Rounding up by one ulp covers the rounding of the subtraction.
        let extent = extent * shrink * (1.0 + f64::EPSILON);
        Ok(Self { points, scaled, registered, unit: power_of_two(exponent), extent })
    }

    /// Returns the cloud of the points whose indices are in `keep`, in the order of `keep`.
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

/// Keeps the first of each run of equal points. Equal points are adjacent in `order`.
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

/// Compares points by x, then y, then z. The order is total because all coordinates are finite
/// and none is -0.0.
fn lexicographic(p: DVec3, q: DVec3) -> Ordering {
    p.to_array().partial_cmp(&q.to_array()).unwrap_or(Ordering::Equal)
}

//! The rows of an answer that are kept for the next step.

use std::{ops::Range, sync::Arc};

use hullcast_contact::{Stop, Stopped};

use crate::{
    codes::{NO_INDEX, outcome},
    columns::Columns,
    scene::SceneTemplate,
};

/// Rows that are looked at between two checks of the stop flag.
const AT_A_TIME: usize = 1 << 16;

/// The rows of a whole answer, with the columns that the next step needs besides those that were sent.
#[derive(Debug)]
pub struct KeptRows {
    template: Arc<SceneTemplate>,
    columns: Columns,
    /// The first point of each row, and the number of all points. Empty if the answer has no points.
    offsets: Vec<u32>,
    are_certain: bool,
    are_settled: bool,
}

/// Whether a row with this outcome matches a row of the next answer.
pub(super) fn goes_on(code: u8) -> bool {
    code == outcome::CONTACT || code == outcome::UNDECIDED
}

impl KeptRows {
    /// Rows of pairs of `template`, or of pairs that were found.
    ///
    /// # Errors
    /// The work was stopped.
    pub fn new(template: Arc<SceneTemplate>, columns: Columns, stop: &Stop) -> Result<Self, Stopped> {
        let mut offsets = Vec::new();
        if !columns.point_counts.is_empty() {
            offsets.reserve_exact(columns.len() + 1);
            let mut end = 0_u32;
            offsets.push(end);
            for counts in columns.point_counts.chunks(AT_A_TIME) {
                stop.spend(counts.len() as u64)?;
                offsets.extend(counts.iter().map(|&count| {
                    end = end.saturating_add(count);
                    end
                }));
            }
        }
        let mut rows = Self { template, columns, offsets, are_certain: true, are_settled: true };
        for first in (0..rows.len()).step_by(AT_A_TIME) {
            let some = first..rows.len().min(first + AT_A_TIME);
            stop.spend(4 * some.len() as u64)?;
            rows.are_certain = rows.are_certain && some.clone().all(|row| rows.is_certain(row));
            rows.are_settled = rows.are_settled && some.clone().all(|row| rows.is_settled(row));
        }
        Ok(rows)
    }

    /// The most bytes that `rows` rows take besides their columns.
    pub fn bytes_besides(rows: usize) -> usize {
        (rows + 1) * size_of::<u32>()
    }

    /// The bytes of the rows.
    pub fn heap_bytes(&self) -> usize {
        self.columns.heap_bytes() + self.offsets.capacity() * size_of::<u32>()
    }

    /// The columns.
    pub fn columns(&self) -> &Columns {
        &self.columns
    }

    /// The number of rows.
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The bodies of the rows, 2 per row.
    pub(super) fn pairs(&self) -> &[u32] {
        if self.columns.pairs.is_empty() { self.template.pairs() } else { &self.columns.pairs }
    }

    /// The bodies of a row.
    pub(super) fn pair(&self, row: usize) -> [u32; 2] {
        let pairs = self.pairs();
        [pairs[2 * row], pairs[2 * row + 1]]
    }

    /// The points of a row among all points.
    pub(super) fn points(&self, row: usize) -> Range<usize> {
        match self.offsets.get(row..row + 2) {
            Some(&[first, end]) => first as usize..end as usize,
            _ => 0..0,
        }
    }

    /// The number of points of a row that points of the next answer can match. There are none if the answer was
    /// asked without the output MATCHES, because it then lacks ids or witnesses.
    pub(super) fn matchable_points(&self, row: usize) -> usize {
        let (points, columns) = (self.points(row), &self.columns);
        let has_all = columns.point_ids.len() >= 4 * points.end
            && columns.witness_as.len() >= 3 * points.end
            && columns.distances.len() >= points.end
            && columns.normals.len() > 3 * row;
        if has_all { points.len() } else { 0 }
    }

    /// Whether a row has an outcome that another computation could not change.
    pub(super) fn is_certain(&self, row: usize) -> bool {
        [outcome::CONTACT, outcome::SEPARATED].contains(&self.columns.outcomes[row])
    }

    /// Whether all rows are certain.
    pub(super) fn are_certain(&self) -> bool {
        self.are_certain
    }

    pub(super) fn goes_on(&self, row: usize) -> bool {
        goes_on(self.columns.outcomes[row])
    }

    /// Whether an answer that takes every row from these is the same as these, bit for bit: its rows took no
    /// work, and each matches itself.
    pub fn are_settled(&self) -> bool {
        self.are_settled
    }

    fn is_settled(&self, row: usize) -> bool {
        let columns = &self.columns;
        let took_work = [&columns.iterations, &columns.support_calls].iter().any(|counts| {
            counts.get(row).is_some_and(|&count| count != 0) // absent without the output DIAGNOSTICS
        });
        let Some(&previous) = columns.previous_pairs.get(row) else { return !took_work };
        let expected = if self.goes_on(row) { row as u32 } else { NO_INDEX };
        let points = columns.previous_points.get(self.points(row)).unwrap_or_default();
        !took_work && previous == expected && points.iter().zip(0..).all(|(&previous, at)| previous == at)
    }
}

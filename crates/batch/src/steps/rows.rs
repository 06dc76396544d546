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
        Ok(Self { template, columns, offsets })
    }

    /// The bytes of the rows with these columns.
    pub fn bytes(columns: &Columns) -> usize {
        columns.heap_bytes() + (columns.len() + 1) * size_of::<u32>()
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

    /// Whether a row has an outcome that another computation could not change.
    pub(super) fn is_certain(&self, row: usize) -> bool {
        [outcome::CONTACT, outcome::SEPARATED].contains(&self.columns.outcomes[row])
    }

    /// Whether all rows are certain.
    pub(super) fn are_certain(&self) -> bool {
        (0..self.len()).all(|row| self.is_certain(row))
    }

    pub(super) fn goes_on(&self, row: usize) -> bool {
        goes_on(self.columns.outcomes[row])
    }

    /// Whether an answer that takes every row from these is the same as these, bit for bit: its rows took no
    /// work, and each matches itself.
    pub fn are_settled(&self) -> bool {
        let columns = &self.columns;
        if columns.iterations.iter().chain(&columns.support_calls).any(|&count| count != 0) {
            return false;
        }
        // Without the output MATCHES there are no previous pairs.
        columns.previous_pairs.iter().enumerate().all(|(row, &previous)| {
            let points = columns.previous_points.get(self.points(row)).unwrap_or_default();
            let expected = if self.goes_on(row) { row as u32 } else { NO_INDEX };
            previous == expected && points.iter().zip(0..).all(|(&previous, point)| previous == point)
        })
    }
}

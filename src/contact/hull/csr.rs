//! Lists of indices, flattened.

/// List `i` is `items[starts[i]..starts[i + 1]]`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Csr {
    pub(crate) starts: Vec<u32>,
    pub(crate) items: Vec<u32>,
}

impl Csr {
    /// List `i`.
    pub(crate) fn row(&self, i: usize) -> &[u32] {
        &self.items[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    /// From `(row, item)` pairs, each row ascending and without repetitions.
    pub(super) fn from_pairs(rows: usize, pairs: impl Iterator<Item = (u32, u32)> + Clone) -> Self {
        let mut ends = vec![0_u32; rows + 1];
        pairs.clone().for_each(|(row, _)| ends[row as usize + 1] += 1);
        for i in 0..rows {
            ends[i + 1] += ends[i];
        }
        let mut filled = vec![0; ends[rows] as usize];
        let mut next = ends.clone();
        for (row, item) in pairs {
            filled[next[row as usize] as usize] = item;
            next[row as usize] += 1;
        }
        // Each row in place, then moved up against the one before.
        let mut starts = ends;
        let mut length = 0;
        let mut row_start = 0;
        for i in 0..rows {
            let row_end = starts[i + 1] as usize;
            sort(&mut filled[row_start..row_end]);
            let before = length;
            for place in row_start..row_end {
                let item = filled[place];
                if length == before || filled[length - 1] != item {
                    filled[length] = item;
                    length += 1;
                }
            }
            row_start = row_end;
            starts[i + 1] = length as u32;
        }
        filled.truncate(length);
        filled.shrink_to_fit();
        Self { starts, items: filled }
    }

    /// The rows that each item is in, ascending; items are below `items`.
    pub(super) fn transposed(&self, items: usize) -> Self {
        let mut starts = vec![0_u32; items + 1];
        self.items.iter().for_each(|&item| starts[item as usize + 1] += 1);
        for i in 0..items {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let mut rows = vec![0; self.items.len()];
        for row in 0..self.starts.len() - 1 {
            for &item in self.row(row) {
                rows[next[item as usize] as usize] = row as u32;
                next[item as usize] += 1;
            }
        }
        Self { starts, items: rows }
    }

    /// No rows, with room.
    pub(super) fn with_capacity(rows: usize, items: usize) -> Self {
        let mut starts = Vec::with_capacity(rows + 1);
        starts.push(0);
        Self { starts, items: Vec::with_capacity(items) }
    }

    /// Adds a row.
    pub(super) fn push_row(&mut self, row: &[u32]) {
        self.items.extend_from_slice(row);
        self.starts.push(self.items.len() as u32);
    }

    /// Bytes on the heap.
    pub(super) fn heap_bytes(&self) -> usize {
        (self.starts.capacity() + self.items.capacity()) * size_of::<u32>()
    }
}

/// Rows are mostly of a few items, in no order or in order.
fn sort(row: &mut [u32]) {
    if row.len() > 16 {
        return row.sort_unstable();
    }
    for end in 1..row.len() {
        let item = row[end];
        let mut place = end;
        while place > 0 && row[place - 1] > item {
            row[place] = row[place - 1];
            place -= 1;
        }
        row[place] = item;
    }
}

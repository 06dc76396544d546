//! Lists of indices, flattened.

/// List `i` is `items[starts[i]..starts[i + 1]]`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Csr {
    pub(crate) starts: Vec<u32>,
    pub(crate) items: Vec<u32>,
}

impl Csr {
    /// How many lists.
    pub(super) fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    /// How many items the longest list has.
    pub(super) fn longest_row(&self) -> usize {
        self.starts.windows(2).map(|ends| (ends[1] - ends[0]) as usize).max().unwrap_or(0)
    }

    /// List `i`.
    pub(crate) fn row(&self, i: usize) -> &[u32] {
        &self.items[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    /// From `(row, item)` pairs in any order, each row ascending and without repetitions.
    pub(super) fn from_pairs(
        rows: usize,
        items: usize,
        pairs: impl Iterator<Item = (u32, u32)> + Clone,
    ) -> Self {
        // By item first: no two are compared, whose order would be anyone's guess.
        let by_item = Self::from_ordered_pairs(items, pairs.map(|(row, item)| (item, row)));
        let mut lists = Self::from_ordered_pairs(rows, by_item.swapped());
        lists.drop_repetitions();
        lists
    }

    /// From `(row, item)` pairs, each row in their order.
    pub(super) fn from_ordered_pairs(rows: usize, pairs: impl Iterator<Item = (u32, u32)> + Clone) -> Self {
        // Counts, then where each row starts, which moves on as the row fills: to its end, where
        // the next one starts.
        let mut starts = vec![0_u32; rows + 1];
        pairs.clone().for_each(|(row, _)| starts[row as usize + 1] += 1);
        let mut sum = 0;
        for start in &mut starts[1..] {
            sum += std::mem::replace(start, sum);
        }
        let mut items = vec![0; sum as usize];
        pairs.for_each(|(row, item)| {
            let place = &mut starts[row as usize + 1];
            items[*place as usize] = item;
            *place += 1;
        });
        Self { starts, items }
    }

    /// Of each item, in turn, the row.
    fn swapped(&self) -> impl Iterator<Item = (u32, u32)> + Clone {
        let rows = self.starts.windows(2).zip(0..);
        rows.flat_map(|(ends, row)| {
            self.items[ends[0] as usize..ends[1] as usize].iter().map(move |&item| (item, row))
        })
    }

    /// Of ascending rows.
    fn drop_repetitions(&mut self) {
        let repeats = |row: usize| self.row(row).windows(2).any(|w| w[0] == w[1]);
        let Some(first) = (0..self.rows()).find(|&row| repeats(row)) else { return };
        let mut length = self.starts[first] as usize;
        let mut start = length;
        for row in first..self.rows() {
            let (end, before) = (self.starts[row + 1] as usize, length);
            for place in start..end {
                let item = self.items[place];
                if length == before || self.items[length - 1] != item {
                    self.items[length] = item;
                    length += 1;
                }
            }
            start = end;
            self.starts[row + 1] = length as u32;
        }
        self.items.truncate(length);
        self.items.shrink_to_fit();
    }

    /// No rows, with room.
    pub(crate) fn with_capacity(rows: usize, items: usize) -> Self {
        let mut starts = Vec::with_capacity(rows + 1);
        starts.push(0);
        Self { starts, items: Vec::with_capacity(items) }
    }

    /// Adds a row.
    pub(crate) fn push_row(&mut self, row: &[u32]) {
        self.items.extend_from_slice(row);
        self.starts.push(self.items.len() as u32);
    }

    /// Bytes on the heap.
    pub(crate) fn heap_bytes(&self) -> usize {
        (self.starts.capacity() + self.items.capacity()) * size_of::<u32>()
    }
}

//! Lists of indices, flattened into one array (*compressed sparse rows*).

/// Steps per pair of an index list: building the list counts and places each pair, twice.
pub(crate) const LISTED: u64 = 8;

/// Lists of indices, called rows. Row `i` is `items[starts[i]..starts[i + 1]]`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Csr {
    pub(crate) starts: Vec<u32>,
    pub(crate) items: Vec<u32>,
}

impl Csr {
    /// The number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    /// The number of items in the longest row.
    pub(crate) fn longest_row(&self) -> usize {
        self.starts.windows(2).map(|ends| (ends[1] - ends[0]) as usize).max().unwrap_or(0)
    }

    /// Row `i`.
    pub(crate) fn row(&self, i: usize) -> &[u32] {
        &self.items[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    /// Builds the lists from `(row, item)` pairs in any order. Each row is ascending and has no
    /// repetitions. Items are below `items`. Takes linear time: a radix sort with two passes.
    pub(crate) fn from_pairs(
        rows: usize,
        items: usize,
        pairs: impl Iterator<Item = (u32, u32)> + Clone,
    ) -> Self {
        // Bucketing the pairs by item first puts each row in order without comparing items. The
        // branches of comparisons would be unpredictable.
        let by_item = Self::from_ordered_pairs(items, pairs.map(|(row, item)| (item, row)));
        let mut lists = Self::from_ordered_pairs(rows, by_item.swapped());
        lists.drop_repetitions();
        lists
    }

    /// Builds the lists from `(row, item)` pairs. Each row keeps the order of the pairs.
    pub(crate) fn from_ordered_pairs(rows: usize, pairs: impl Iterator<Item = (u32, u32)> + Clone) -> Self {
        // `starts[row + 1]` first counts the items of the row, then holds the start of the row.
        // It advances while the row fills, and ends at the start of the next row.
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

    /// All pairs with both parts exchanged, `(item, row)`, ordered by row.
    fn swapped(&self) -> impl Iterator<Item = (u32, u32)> + Clone {
        let rows = self.starts.windows(2).zip(0..);
        rows.flat_map(|(ends, row)| {
            self.items[ends[0] as usize..ends[1] as usize].iter().map(move |&item| (item, row))
        })
    }

    /// Removes repeated items from rows that are ascending.
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

    /// No rows yet, with capacity for this many rows and items.
    pub(crate) fn with_capacity(rows: usize, items: usize) -> Self {
        let mut starts = Vec::with_capacity(rows + 1);
        starts.push(0);
        Self { starts, items: Vec::with_capacity(items) }
    }

    /// Appends a row.
    pub(crate) fn push_row(&mut self, row: &[u32]) {
        self.items.extend_from_slice(row);
        self.starts.push(self.items.len() as u32);
    }

    /// Bytes held on the heap.
    pub(crate) fn heap_bytes(&self) -> usize {
        (self.starts.capacity() + self.items.capacity()) * size_of::<u32>()
    }
}

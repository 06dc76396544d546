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
        let mut csr = Self { starts: Vec::with_capacity(rows + 1), items: Vec::with_capacity(filled.len()) };
        csr.starts.push(0);
        for i in 0..rows {
            let row = &mut filled[ends[i] as usize..ends[i + 1] as usize];
            row.sort_unstable();
            let before = csr.items.len();
            for &item in row.iter() {
                if csr.items[before..].last() != Some(&item) {
                    csr.items.push(item);
                }
            }
            csr.starts.push(csr.items.len() as u32);
        }
        csr.items.shrink_to_fit();
        csr
    }

    /// From rows in order.
    pub(super) fn from_rows<R: AsRef<[u32]>>(rows: impl Iterator<Item = R>) -> Self {
        let mut csr = Self { starts: vec![0], items: Vec::new() };
        for row in rows {
            csr.items.extend_from_slice(row.as_ref());
            csr.starts.push(csr.items.len() as u32);
        }
        csr.starts.shrink_to_fit();
        csr.items.shrink_to_fit();
        csr
    }

    /// Bytes on the heap.
    pub(super) fn heap_bytes(&self) -> usize {
        (self.starts.capacity() + self.items.capacity()) * size_of::<u32>()
    }
}

//! The part of an engine that every batch uses while it is computed.

use std::{
    fmt,
    sync::{Mutex, atomic::AtomicU64},
};

use crate::{columns::Columns, lock::locked};

/// The number of chunks' columns that are kept for reuse: those of a large batch.
const SPARE_CHUNKS: usize = 512;

/// The most bytes of a chunk's columns that are kept: about 8 points per pair with every output
/// except derivatives.
pub(super) const SPARE_BYTES: usize = 64 << 10;

/// A function that is called with the number of pairs of a chunk before the chunk is computed.
#[cfg(any(test, feature = "testing"))]
pub(super) type BeforeChunk = Box<dyn Fn(usize) + Send + Sync>;

/// The limit, the counter and the buffers that the batches of an engine share.
pub(super) struct EngineState {
    pub(super) max_answer_bytes: usize,
    pub(super) pairs_computed: AtomicU64,
    pub(super) spare: SpareColumns,
    #[cfg(any(test, feature = "testing"))]
    pub(super) before_chunk: Option<BeforeChunk>,
}

impl EngineState {
    pub(super) fn new(max_answer_bytes: usize) -> Self {
        Self {
            max_answer_bytes,
            pairs_computed: AtomicU64::new(0),
            spare: SpareColumns::default(),
            #[cfg(any(test, feature = "testing"))]
            before_chunk: None,
        }
    }

    #[cfg(any(test, feature = "testing"))]
    pub(super) fn before_chunk(&self, pairs: usize) {
        if let Some(before) = &self.before_chunk {
            before(pairs);
        }
    }
}

impl fmt::Debug for EngineState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { max_answer_bytes, pairs_computed, .. } = self;
        let mut text = f.debug_struct("EngineState");
        text.field("max_answer_bytes", max_answer_bytes).field("pairs_computed", pairs_computed);
        text.finish_non_exhaustive()
    }
}

/// Columns for reuse, so that chunks allocate nothing in the steady state.
#[derive(Debug, Default)]
pub(super) struct SpareColumns(Mutex<Vec<Columns>>);

impl SpareColumns {
    pub(super) fn take(&self) -> Columns {
        locked(&self.0).pop().unwrap_or_default()
    }

    pub(super) fn keep(&self, chunks: Vec<Columns>) {
        let mut spare = locked(&self.0);
        let room = SPARE_CHUNKS.saturating_sub(spare.len());
        let small = chunks.into_iter().filter(|columns| columns.heap_bytes() <= SPARE_BYTES);
        spare.extend(small.take(room).map(|mut columns| {
            columns.clear();
            columns
        }));
    }
}

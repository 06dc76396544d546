//! Cuts a batch into chunks by the estimated cost of its pairs.
//!
//! A chunk costs about a millisecond at most, so that threads can take turns and look at the
//! stop flag often, and has at most 64 pairs, so that every thread has its share of a small
//! batch. Batches whose most expensive pair allows 64 pairs in a chunk, which is nearly all of
//! them, are cut without looking at their pairs.

use std::ops::Range;

use super::Batch;
use crate::contact::{STEPS_BETWEEN_LOOKS, Stop, Stopped};

/// The most pairs of a chunk. 64 pairs of boxes take some 50 us: far above the cost of sharing,
/// far below a batch.
pub(super) const CHUNK_PAIRS: usize = 64;

/// The most estimated steps of a chunk, unless it is one pair.
const CHUNK_STEPS: u64 = STEPS_BETWEEN_LOOKS;

/// A batch of fewer estimated steps is computed on the thread that serves the call: about what
/// handing it to other threads and back costs.
const SMALL_STEPS: u64 = 40_000;

/// The chunks of a batch.
#[derive(Debug)]
pub(super) enum Chunks {
    /// As many pairs in each as [`CHUNK_PAIRS`] says.
    Equal,
    /// Every pair has to be looked at first.
    Unknown,
    /// Where each chunk ends.
    Ends(Vec<u32>),
}

impl Chunks {
    /// The chunks of a batch, as far as they are known from its hulls.
    pub(super) fn of(batch: &Batch) -> Self {
        let most = batch.most_steps().saturating_mul(CHUNK_PAIRS as u64);
        if most <= CHUNK_STEPS { Self::Equal } else { Self::Unknown }
    }

    /// The chunks of a batch, by its pairs.
    pub(super) fn by_pairs(batch: &Batch, stop: &Stop) -> Result<Self, Stopped> {
        let (mut ends, mut steps, mut first) = (Vec::new(), 0, 0);
        for pair in 0..batch.pair_count() {
            if pair % (1 << 14) == 0 {
                stop.spend(10 << 14)?;
            }
            let more = batch.pair_steps(pair);
            if pair > first && (pair - first == CHUNK_PAIRS || steps + more > CHUNK_STEPS) {
                ends.push(pair as u32);
                (steps, first) = (0, pair);
            }
            steps += more;
        }
        ends.push(batch.pair_count() as u32);
        Ok(Self::Ends(ends))
    }

    pub(super) fn is_unknown(&self) -> bool {
        matches!(self, Self::Unknown)
    }

    /// The number of chunks of a batch with `pairs` pairs.
    pub(super) fn count(&self, pairs: usize) -> usize {
        match self {
            Self::Equal | Self::Unknown => pairs.div_ceil(CHUNK_PAIRS),
            Self::Ends(ends) => ends.len(),
        }
    }

    /// The pairs of a chunk.
    pub(super) fn pairs(&self, index: usize, pairs: usize) -> Range<usize> {
        match self {
            Self::Equal | Self::Unknown => {
                let first = index * CHUNK_PAIRS;
                first..pairs.min(first + CHUNK_PAIRS)
            }
            Self::Ends(ends) => {
                let first = if index == 0 { 0 } else { ends[index - 1] as usize };
                first..ends[index] as usize
            }
        }
    }
}

impl Batch {
    /// Whether the batch costs less than it costs to hand it to other threads.
    pub(super) fn is_small(&self) -> bool {
        let pairs = self.pair_count();
        // With one pair more than a chunk has, no batch is small.
        pairs <= CHUNK_PAIRS && (0..pairs).map(|pair| self.pair_steps(pair)).sum::<u64>() < SMALL_STEPS
    }
}

//! Cuts a batch into chunks by the estimated cost of its pairs.
//!
//! A chunk costs at most about a millisecond, so that threads can take turns and check the stop
//! flag often. It has at most 64 pairs, so that every thread gets a share of a small batch. In
//! nearly all batches the most expensive pair allows 64 pairs per chunk; they are cut without
//! looking at their pairs.

use std::ops::Range;

use hullcast_contact::{STEPS_BETWEEN_LOOKS, Stop, Stopped};

use crate::batch::Batch;

/// The most pairs per chunk. 64 pairs of boxes take about 50 us: far more than the cost of sharing
/// them, and far less than a batch.
pub(super) const CHUNK_PAIRS: usize = 64;

/// The most estimated steps per chunk, unless the chunk is a single pair.
const CHUNK_STEPS: u64 = STEPS_BETWEEN_LOOKS;

/// A batch of fewer estimated steps is computed on the thread that asks for it. Handing it to
/// other threads and back costs about as much.
const SMALL_STEPS: u64 = 40_000;

/// The chunks of a batch.
#[derive(Debug)]
pub(super) enum Chunks {
    /// Every chunk has [`CHUNK_PAIRS`] pairs, except perhaps the last.
    Equal,
    /// The cost of every pair must be estimated first.
    Unknown,
    /// The end of each chunk.
    Ends(Vec<u32>),
}

impl Chunks {
    /// The chunks of a batch, as far as its hulls determine them.
    pub(super) fn of(batch: &Batch) -> Self {
        let most = batch.most_steps().saturating_mul(CHUNK_PAIRS as u64);
        if most <= CHUNK_STEPS { Self::Equal } else { Self::Unknown }
    }

    /// The chunks of a batch, by the estimated cost of each pair.
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
    /// Whether the batch costs less than handing it to other threads.
    pub(super) fn is_small(&self) -> bool {
        let pairs = self.pair_count();
        // A batch of more pairs than one chunk is never small.
        pairs <= CHUNK_PAIRS && (0..pairs).map(|pair| self.pair_steps(pair)).sum::<u64>() < SMALL_STEPS
    }
}

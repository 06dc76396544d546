//! Which bodies never meet, wherever they are.

use crate::contact::{
    Stop, Stopped,
    sort::{self, sort},
    stop::Meter,
};

/// Steps of comparing and moving two keys.
const COMPARISON: u64 = 2;

/// The world that meets every other.
pub const EVERY_WORLD: u32 = u32::MAX;

/// Which bodies never meet, wherever they are.
#[derive(Clone, Debug, Default)]
pub struct Rules {
    /// Empty, or one per body: only bodies of one world meet. [`EVERY_WORLD`] meets every other
    /// world, and not itself.
    worlds: Vec<u32>,
    /// Empty, or one per body: bodies of one group never meet; 0 is none.
    groups: Vec<u32>,
    /// Pairs of groups that ignore each other, as they were given; empty once sorted.
    given: Vec<u32>,
    /// The same pairs, each once, the lower group in the higher half; sorted.
    ignored: Vec<u64>,
}

impl Rules {
    /// Rules with these columns. `ignored` has 2 groups per pair, in either order.
    pub fn new(worlds: Vec<u32>, groups: Vec<u32>, ignored: Vec<u32>) -> Self {
        Self { worlds, groups, given: ignored, ignored: Vec::new() }
    }

    /// The most bytes that sorting takes beside the columns.
    pub fn sorting_bytes(&self) -> usize {
        // A key per pair, and as many again while they are merged.
        self.given.len() / 2 * 2 * size_of::<u64>()
    }

    /// The estimated steps of sorting.
    pub fn sorting_steps(&self) -> u64 {
        sort::steps(self.given.len() / 2, COMPARISON)
    }

    /// Sorts the ignored pairs, so that [`Self::may_meet`] knows them.
    pub(super) fn sort(&mut self, stop: &Stop) -> Result<(), Stopped> {
        if self.given.is_empty() {
            return Ok(());
        }
        let mut keys = Vec::with_capacity(self.given.len() / 2);
        for chunk in std::mem::take(&mut self.given).chunks(1 << 16) {
            keys.extend(chunk.as_chunks::<2>().0.iter().map(|&[g, h]| key(g, h)));
            stop.spend(2 * chunk.len() as u64)?;
        }
        sort(&mut keys, &Meter::new(stop), COMPARISON, Ord::cmp)?;
        keys.dedup();
        self.ignored = keys;
        Ok(())
    }

    /// The world of a body.
    pub(super) fn world(&self, body: u32) -> u32 {
        self.worlds.get(body as usize).copied().unwrap_or(0)
    }

    /// The group of a body.
    pub(super) fn group(&self, body: u32) -> u32 {
        self.groups.get(body as usize).copied().unwrap_or(0)
    }

    /// Whether bodies of groups `g` and `h` may meet.
    pub(super) fn may_meet(&self, g: u32, h: u32) -> bool {
        g == 0 || h == 0 || (g != h && self.ignored.binary_search(&key(g, h)).is_err())
    }

    /// The steps of [`Self::may_meet`]: a cache miss for most halvings of a long list.
    pub(super) fn steps(&self) -> u64 {
        2 + 10 * u64::from(self.ignored.len().checked_ilog2().map_or(0, |halvings| halvings + 1))
    }
}

fn key(g: u32, h: u32) -> u64 {
    u64::from(g.min(h)) << 32 | u64::from(g.max(h))
}

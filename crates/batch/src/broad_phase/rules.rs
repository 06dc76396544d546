//! The rules that keep bodies apart regardless of their positions: worlds and collision groups.

use hullcast_contact::{
    Stop, Stopped,
    sort::{self, sort},
    stop::Meter,
};

use crate::scene::{FaultKind, SceneFault, has_length};

/// Steps to compare and move two keys.
const COMPARISON: u64 = 2;

/// The world of a body that is in every world: it meets the bodies of every other world.
pub const EVERY_WORLD: u32 = u32::MAX;

/// The rules that keep bodies apart regardless of their positions.
#[derive(Clone, Debug, Default)]
pub struct Rules {
    /// The world of each body, or empty if all bodies are in world 0. Only bodies of the same world
    /// meet. A body of [`EVERY_WORLD`] meets the bodies of all other worlds, but no other body of
    /// [`EVERY_WORLD`].
    worlds: Vec<u32>,
    /// The group of each body, or empty if no body has a group. Bodies of the same group never
    /// meet. 0 means no group.
    groups: Vec<u32>,
    /// The pairs of groups that ignore each other, as given, 2 groups per pair. Empty once sorted.
    given: Vec<u32>,
    /// The pairs of groups that ignore each other, each once, in ascending order. The lower group is
    /// in the higher half of the number.
    ignored: Vec<u64>,
}

impl Rules {
    /// Rules with these worlds and groups per body, each possibly empty. `ignored` has 2 groups per
    /// pair of groups that ignore each other, in either order.
    pub fn new(worlds: Vec<u32>, groups: Vec<u32>, ignored: Vec<u32>) -> Self {
        Self { worlds, groups, given: ignored, ignored: Vec::new() }
    }

    /// Rules of a scene with `bodies` bodies, checked.
    ///
    /// # Errors
    /// A list does not have one entry per body, there is half a pair of groups, or a pair has the group 0.
    pub fn checked(
        bodies: usize,
        worlds: Vec<u32>,
        groups: Vec<u32>,
        ignored: Vec<u32>,
    ) -> Result<Self, SceneFault> {
        for (column, field) in [(&worlds, "worlds"), (&groups, "groups")] {
            if !column.is_empty() {
                has_length(column.len(), bodies, field, "none or one per body")?;
            }
        }
        has_length(ignored.len(), ignored.len() & !1, "ignored_groups", "2 per pair of groups")?;
        if let Some(at) = ignored.iter().position(|&group| group == 0) {
            let message = "got 0, which means no group: groups that ignore each other must be above 0";
            let (kind, field) = (FaultKind::Value, "ignored_groups");
            return Err(SceneFault { kind, field, index: Some(at), message: message.into() });
        }
        Ok(Self::new(worlds, groups, ignored))
    }

    /// The bytes of the lists.
    pub fn bytes(&self) -> usize {
        let lists = [&self.worlds, &self.groups, &self.given];
        lists.iter().map(|list| size_of_val(&list[..])).sum::<usize>() + size_of_val(&self.ignored[..])
    }

    /// The largest number of bytes that sorting takes besides the given lists.
    pub fn sorting_bytes(&self) -> usize {
        // Sorting keeps one key per pair, and a second copy of the keys while it merges runs.
        self.given.len() / 2 * 2 * size_of::<u64>()
    }

    /// The estimated number of steps that sorting takes.
    pub fn sorting_steps(&self) -> u64 {
        sort::steps(self.given.len() / 2, COMPARISON)
    }

    /// Sorts the ignored pairs. [`Self::may_meet`] needs them sorted.
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

    /// The number of steps of [`Self::may_meet`]: most halvings of a long list miss the cache.
    pub(super) fn steps(&self) -> u64 {
        2 + 10 * u64::from(self.ignored.len().checked_ilog2().map_or(0, |halvings| halvings + 1))
    }
}

/// The key of a pair of groups, independent of their order.
fn key(g: u32, h: u32) -> u64 {
    u64::from(g.min(h)) << 32 | u64::from(g.max(h))
}

//! A broad phase that is kept from one step of a scene to the next.
//!
//! ```text
//! let mut broad_phase = BroadPhase::new(bounds, rules, stop)?;            // the first step
//! loop {
//!     broad_phase = broad_phase.moved(&moved, &their_bounds, stop)?;          // the bodies that changed
//!     broad_phase.search(&mut PairSearch::new(0, bodies), ..)?;               // all pairs, or
//!     broad_phase.search_moved(&moved, &mut MovedSearch::new(0, count), ..)?; // those with a moved body
//! }
//! ```
//!
//! A body has *moved* if its bounds changed, that is if its pose, hull, margin or motion did. Bodies that come
//! and go, or whose world or group changes, need [`BroadPhase::renumbered`].
//!
//! **The answer does not depend on the past.** A search compares the boxes of nodes only to skip subtrees, and
//! decides about each pair by the present bounds of its two bodies. Every body with bounds is in exactly one
//! leaf, and the boxes above that leaf contain its bounds. So a search finds exactly the pairs whose bounds meet
//! and whose rules allow it, whatever the shape of the trees is, and sorts them: the same pairs in the same order
//! as those of a broad phase that is built anew.
//!
//! Two trees hold the bodies. The large one keeps its shape while bodies move a little (`tree/refit.rs`).
//! The small one has the *loose* bodies: those that have left their place in the large one, or are new. It is built
//! again in every step in which one of them changes. When there are too many loose bodies, both trees are
//! built again as one. Let `n` be the number of bodies and `t` the number that get loose in a step. A limit
//! of `sqrt(n t)` loose bodies makes the two costs equal, that of building the small tree in each step and that
//! of building the large tree now and then.
//!
//! Following costs about 50 ns per moved body, where building and searching cost some hundred each.

#[cfg(test)]
mod tests;

use hullcast_contact::{Bounds, Stop, Stopped, stop::Meter};

use super::{BroadPhase, EVERY_WORLD, Rules, STEPS_PER_BODY, Trees, tree::Follower};

/// Index of a body that was not in the scene before; see [`BroadPhase::renumbered`].
pub const NEW_BODY: u32 = u32::MAX;

/// The trees are built again when more than one in this many bodies is loose.
const MOST_LOOSE: usize = 2;
/// If more than one in this many bodies has moved, all nodes are adapted in one pass.
const REFIT_ALL_FROM: usize = 8;

/// The estimated number of steps per moved body to update a broad phase.
pub const UPDATE_STEPS_PER_BODY: u64 = 100;

/// Steps to change the bounds of a body in its leaf node.
const MOVE_STEPS: u64 = 20;

/// The place of a body in the trees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Place {
    /// In no tree: the body had no bounds when the trees were built.
    #[default]
    None,
    /// The place among the leaves of the large tree of worlds.
    Worlds(u32),
    /// The place among the leaves of the large tree of bodies that are in every world.
    Everywhere(u32),
    /// In the list of loose bodies.
    Loose,
}

/// The state of a kept broad phase besides its trees.
#[derive(Debug, Default)]
pub(super) struct Kept {
    /// For each body, its place.
    places: Vec<Place>,
    worlds: Follower,
    everywhere: Follower,
    /// The loose bodies, in the order in which they got loose.
    loose: Vec<u32>,
    /// The number of bodies that got loose in this step.
    got_loose: usize,
    /// Whether a loose body has changed.
    is_stale: bool,
}

impl Kept {
    fn new(trees: &Trees, bodies: usize, meter: &Meter<'_>) -> Result<Self, Stopped> {
        let mut places = vec![Place::None; bodies];
        meter.spend(bodies as u64)?;
        for (tree, place) in [
            (&trees.worlds, Place::Worlds as fn(u32) -> Place),
            (&trees.everywhere, Place::Everywhere as fn(u32) -> Place),
        ] {
            for (at, leaf) in (0..).zip(tree.leaves()) {
                meter.spend(2)?;
                places[leaf.body as usize] = place(at);
            }
        }
        let worlds = Follower::new(&trees.worlds, meter)?;
        let everywhere = Follower::new(&trees.everywhere, meter)?;
        Ok(Self { places, worlds, everywhere, ..Self::default() })
    }

    fn loosen(&mut self, body: u32) {
        self.places[body as usize] = Place::Loose;
        self.loose.push(body);
        self.got_loose += 1;
        self.is_stale = true;
    }
}

impl BroadPhase {
    /// The broad phase after some bodies have moved: `bounds[i]` are the new bounds of body `moved[i]`, or `None`
    /// if it is in no pair now. Indices that are out of range are ignored.
    ///
    /// # Errors
    /// The computation was stopped. The broad phase is then gone, because it would be incomplete.
    pub fn moved(mut self, moved: &[u32], bounds: &[Option<Bounds>], stop: &Stop) -> Result<Self, Stopped> {
        if moved.is_empty() {
            return Ok(self);
        }
        let meter = &Meter::new(stop);
        let mut kept = match self.kept.take() {
            Some(kept) => kept,
            None => Box::new(Kept::new(&self.trees, self.bounds.len(), meter)?),
        };
        for (&body, &bounds) in moved.iter().zip(bounds) {
            meter.spend(MOVE_STEPS)?;
            let Some(before) = self.bounds.get_mut(body as usize) else { continue };
            *before = bounds;
            let stays = match kept.places[body as usize] {
                Place::None => bounds.is_none(),
                Place::Worlds(at) => self.trees.worlds.place(at as usize, bounds, &kept.worlds),
                Place::Everywhere(at) => self.trees.everywhere.place(at as usize, bounds, &kept.everywhere),
                Place::Loose => {
                    kept.is_stale = true;
                    true
                }
            };
            if !stays {
                kept.loosen(body);
            }
        }
        self.settled(kept, moved, stop)
    }

    /// Adapts the boxes of the large trees to the moved bodies, and builds the small trees again. Builds all trees
    /// again if there are too many loose bodies.
    fn settled(mut self, mut kept: Box<Kept>, moved: &[u32], stop: &Stop) -> Result<Self, Stopped> {
        let (loose, bodies) = (kept.loose.len(), self.bounds.len());
        let got_loose = std::mem::take(&mut kept.got_loose) as u64;
        let is_worn = got_loose > 0 && (loose as u64).pow(2) > bodies as u64 * (got_loose + 1);
        if is_worn || MOST_LOOSE * loose > bodies || self.trees.places() > 2 * bodies {
            drop((kept, std::mem::take(&mut self.trees), std::mem::take(&mut self.loose)));
            return Self::new(self.bounds, self.rules, stop);
        }
        let meter = &Meter::new(stop);
        if REFIT_ALL_FROM * moved.len() > bodies {
            self.trees.worlds.refit_all(meter)?;
            self.trees.everywhere.refit_all(meter)?;
        } else {
            for &body in moved {
                meter.spend(1)?;
                match kept.places.get(body as usize) {
                    Some(&Place::Worlds(at)) => self.trees.worlds.refit(at as usize, &kept.worlds, meter)?,
                    Some(&Place::Everywhere(at)) => {
                        self.trees.everywhere.refit(at as usize, &kept.everywhere, meter)?;
                    }
                    _ => {}
                }
            }
        }
        if std::mem::take(&mut kept.is_stale) {
            let (mut worlds, mut everywhere) = (Vec::new(), Vec::new());
            for leaf in kept.loose.iter().filter_map(|&body| self.leaf(body)) {
                meter.spend(2)?;
                if leaf.world == EVERY_WORLD { everywhere.push(leaf) } else { worlds.push(leaf) }
            }
            self.loose = Trees::new(worlds, everywhere, stop)?;
        }
        self.kept = Some(kept);
        Ok(self)
    }

    /// The broad phase of another list of bodies, some of which were in the list before. `before[i]` is the index
    /// that body `i` had, or [`NEW_BODY`]. Every body has new bounds and rules. A body whose world or group has
    /// changed, or whose index in `before` appeared earlier in the list, counts as new.
    ///
    /// # Errors
    /// The computation was stopped. The broad phase is then gone.
    pub fn renumbered(
        mut self,
        before: &[u32],
        bounds: Vec<Option<Bounds>>,
        mut rules: Rules,
        stop: &Stop,
    ) -> Result<Self, Stopped> {
        rules.sort(stop)?;
        let meter = &Meter::new(stop);
        let old = match self.kept.take() {
            Some(kept) => kept,
            None => Box::new(Kept::new(&self.trees, self.bounds.len(), meter)?),
        };
        let Kept { places: mut old, worlds, everywhere, .. } = *old;
        let mut kept = Box::new(Kept { worlds, everywhere, is_stale: true, ..Kept::default() });
        kept.places = vec![Place::None; bounds.len()];
        (self.bounds, self.rules) = (bounds, rules);
        // Every place loses its body, and gets it back if the body stays.
        self.trees.worlds.clear(meter)?;
        self.trees.everywhere.clear(meter)?;
        let before = before.iter().copied().chain(std::iter::repeat(NEW_BODY));
        for (body, was) in (0..self.bounds.len() as u32).zip(before) {
            meter.spend(UPDATE_STEPS_PER_BODY / 4)?;
            let Some(leaf) = self.leaf(body) else { continue };
            let place = old.get_mut(was as usize).map(std::mem::take).unwrap_or_default();
            let stays = match place {
                Place::Worlds(at) => self.trees.worlds.settle(at as usize, leaf, &kept.worlds),
                Place::Everywhere(at) => self.trees.everywhere.settle(at as usize, leaf, &kept.everywhere),
                Place::None | Place::Loose => false,
            };
            if stays { kept.places[body as usize] = place } else { kept.loosen(body) }
        }
        self.trees.worlds.find_highest(meter)?;
        self.trees.everywhere.find_highest(meter)?;
        let all: Vec<u32> = (0..self.bounds.len() as u32).collect();
        self.settled(kept, &all, stop)
    }

    /// The estimated number of steps of an update in which so many bodies have moved.
    pub fn update_steps(&self, moved: usize) -> u64 {
        let (bodies, moved) = (self.bounds.len() as u64, moved as u64);
        let loose = self.kept.as_ref().map_or(0, |kept| kept.loose.len()) as u64;
        let may_build = self.kept.is_none() || (loose + moved).pow(2) > bodies;
        UPDATE_STEPS_PER_BODY * moved + if may_build { STEPS_PER_BODY * bodies } else { 0 }
    }

    /// The bytes of the broad phase, its rules included.
    pub fn heap_bytes(&self) -> usize {
        let kept = self.kept.as_ref().map_or(0, |kept| {
            size_of_val(&kept.places[..])
                + size_of_val(&kept.loose[..])
                + kept.worlds.heap_bytes()
                + kept.everywhere.heap_bytes()
        });
        size_of_val(&self.bounds[..])
            + self.trees.heap_bytes()
            + self.loose.heap_bytes()
            + kept
            + self.rules.bytes()
    }
}

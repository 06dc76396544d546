//! The broad phase: finds the pairs of bodies of a scene that may be in contact.
//!
//! A pair is found if the bounds of both bodies overlap and no rule keeps the bodies apart (worlds,
//! collision groups; [`Rules`]). The bounds are in a tree of boxes ([`tree`]), in which the
//! bodies of one world form one subtree. The *partners* of a body are the bodies with a higher index
//! that may meet it. So each pair is found once, and the pairs come out in ascending order without
//! ever being in memory all together:
//!
//! ```text
//! for each body, in order:
//!     search the subtree of its world, and the bodies that are in every world
//!     partners = the bodies found with a higher index that no rule keeps apart
//!     append (body, partner) for each partner, ascending
//! ```
//!
//! Building takes `O(n log n)` steps for `n` bodies. Building and searching check a stop flag
//! about once per millisecond. A search can also be suspended after any number of steps and resumed
//! later. So even a scene in which all boxes overlap and the rules keep all bodies apart never
//! occupies a thread for long.
//!
//! The tree is the project's own for two reasons. The construction of a general-purpose R-tree
//! crate cannot be interrupted. And one tree with the world as a fourth coordinate was slow for
//! scenes of many worlds.
//!
//! A broad phase can be kept from step to step of a simulation ([`BroadPhase::moved`],
//! [`BroadPhase::renumbered`]), and searched for the pairs with a body that has moved
//! ([`MovedSearch`]). Crates with dynamic trees of boxes exist (parry3d's `Bvh`, rstar, bvh). They
//! would bring a second geometry library, or the same two faults: their updates and searches cannot
//! be suspended or metered, and they know no worlds and groups, so that a scene of many worlds
//! would be searched as one.

mod moved;
mod rules;
mod tree;
mod update;

use std::ops::Range;

pub use self::{
    moved::{MovedBodies, MovedSearch},
    rules::{EVERY_WORLD, Rules},
    tree::{STEPS_PER_BODY, TREE_BYTES_PER_BODY},
    update::{NEW_BODY, UPDATE_STEPS_PER_BODY},
};
use self::{
    tree::{Leaf, PartnerSearch, Tree},
    update::Kept,
};
use hullcast_contact::{Bounds, STEPS_BETWEEN_LOOKS, Stop, Stopped};

/// Steps per partner to sort the partners of a body when all of them are known.
const STEPS_PER_PARTNER: u64 = 20;

/// The bodies of a scene, ready for searches for pairs.
#[derive(Debug, Default)]
pub struct BroadPhase {
    /// All bodies that had bounds when the broad phase was built, unless they are loose now.
    trees: Trees,
    /// The loose bodies of a broad phase that is kept.
    loose: Trees,
    kept: Option<Box<Kept>>,
    /// The bounds of each body; `None` for a body that is in no pair.
    bounds: Vec<Option<Bounds>>,
    rules: Rules,
}

/// Trees of some bodies.
#[derive(Debug, Default)]
struct Trees {
    /// The bodies that are in one world.
    worlds: Tree,
    /// The bodies that are in every world ([`EVERY_WORLD`]).
    everywhere: Tree,
}

impl Trees {
    fn new(worlds: Vec<Leaf>, everywhere: Vec<Leaf>, stop: &Stop) -> Result<Self, Stopped> {
        Ok(Self { worlds: Tree::new(worlds, stop)?, everywhere: Tree::new(everywhere, stop)? })
    }

    fn heap_bytes(&self) -> usize {
        self.worlds.heap_bytes() + self.everywhere.heap_bytes()
    }

    /// The number of places for bodies.
    fn places(&self) -> usize {
        self.worlds.leaves().len() + self.everywhere.leaves().len()
    }
}

/// A search for the pairs of a range of bodies. It can be suspended and resumed.
#[derive(Debug)]
pub struct PairSearch {
    /// The pairs found so far, in ascending order, 2 indices per pair. The owner may take them out
    /// at any time.
    pub pairs: Vec<u32>,
    /// The body whose partners are searched for next.
    next: u32,
    /// The first body after the range.
    end: u32,
    /// The partners of body `next` found so far.
    partners: Vec<u32>,
    /// How far the search for the partners of body `next` has got.
    progress: SearchProgress,
}

/// How far the search for the partners of one body has got.
#[derive(Clone, Debug, Default)]
struct SearchProgress {
    /// The number of trees that have been searched.
    trees: usize,
    /// The nodes of the next tree that are still to be visited, if its search has begun.
    nodes: Option<Range<usize>>,
}

impl PairSearch {
    /// Starts a search for the pairs whose lower index is in `first..end`.
    pub fn new(first: u32, end: u32) -> Self {
        let (pairs, partners) = (Vec::new(), Vec::new());
        Self { pairs, next: first, end, partners, progress: SearchProgress::default() }
    }

    /// Whether the search has found all its pairs.
    pub fn is_done(&self) -> bool {
        self.next >= self.end
    }
}

impl BroadPhase {
    /// Builds the broad phase of bodies with these bounds. A body without bounds is in no pair.
    ///
    /// # Errors
    /// The computation was stopped.
    pub fn new(bounds: Vec<Option<Bounds>>, mut rules: Rules, stop: &Stop) -> Result<Self, Stopped> {
        rules.sort(stop)?;
        let (mut leaves, mut everywhere) = (Vec::with_capacity(bounds.len()), Vec::new());
        for (chunk, first) in bounds.chunks(1 << 14).zip((0..).step_by(1 << 14)) {
            for (bounds, body) in chunk.iter().zip(first..) {
                let Some(bounds) = *bounds else { continue };
                let (world, group) = (rules.world(body), rules.group(body));
                let leaf = Leaf { bounds, body, world, group };
                if world == EVERY_WORLD { everywhere.push(leaf) } else { leaves.push(leaf) }
            }
            stop.spend(10 * chunk.len() as u64)?;
        }
        let trees = Trees::new(leaves, everywhere, stop)?;
        Ok(Self { trees, loose: Trees::default(), kept: None, bounds, rules })
    }

    /// The number of bodies, including those that are in no pair.
    pub fn bodies(&self) -> u32 {
        self.bounds.len() as u32
    }

    /// Resumes a search. Returns after about `steps` steps, or once the search is done or holds
    /// `most` indices of pairs.
    ///
    /// # Errors
    /// The computation was stopped.
    pub fn search(
        &self,
        search: &mut PairSearch,
        steps: u64,
        most: usize,
        stop: &Stop,
    ) -> Result<(), Stopped> {
        let mut rest = steps;
        while rest > 0 && !search.is_done() && search.pairs.len() < most {
            let some = rest.min(STEPS_BETWEEN_LOOKS);
            let mut left = some;
            while left > 0 && !search.is_done() && search.pairs.len() < most {
                self.advance(search, &mut left);
            }
            rest -= some - left;
            stop.spend(some - left)?;
        }
        Ok(())
    }

    /// Searches for partners of the next body, until they are all known or no steps are left.
    fn advance(&self, search: &mut PairSearch, left: &mut u64) {
        let body = search.next;
        if !self.find_partners(body, body + 1, &mut search.progress, &mut search.partners, left) {
            return;
        }
        search.partners.sort_unstable();
        let partners = search.partners.len() as u64;
        *left = left.saturating_sub(1 + STEPS_PER_PARTNER * partners);
        search.pairs.extend(search.partners.drain(..).flat_map(|other| [body, other]));
        search.next += 1;
    }

    /// Searches for the partners of a body whose index is at least `least`. Returns false if no steps are left
    /// before all are found.
    fn find_partners(
        &self,
        body: u32,
        least: u32,
        progress: &mut SearchProgress,
        found: &mut Vec<u32>,
        left: &mut u64,
    ) -> bool {
        let Some(leaf) = self.leaf(body) else { return true };
        let SearchProgress { trees: searched, mut nodes } = std::mem::take(progress);
        let mut query = PartnerSearch { leaf, least, rules: &self.rules, found, left };
        let trees =
            [&self.trees, &self.loose].into_iter().flat_map(|trees| [&trees.worlds, &trees.everywhere]);
        for (number, tree) in trees.enumerate().skip(searched) {
            let nodes = nodes.take().unwrap_or_else(|| match number % 2 {
                0 => tree.subtree_of(leaf.world),
                // Two bodies that are in every world do not meet each other.
                _ if leaf.world == EVERY_WORLD => 0..0,
                _ => tree.subtree_of(EVERY_WORLD),
            });
            if let Some(rest) = tree.partners(nodes, &mut query) {
                *progress = SearchProgress { trees: number, nodes: Some(rest) };
                return false;
            }
        }
        true
    }

    /// A body as the trees have it, or `None` if it is in no pair.
    fn leaf(&self, body: u32) -> Option<Leaf> {
        let bounds = self.bounds.get(body as usize).copied().flatten()?;
        Some(Leaf { bounds, body, world: self.rules.world(body), group: self.rules.group(body) })
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    /// A random generator that gives the same numbers every time.
    fn numbers() -> impl FnMut(u64) -> u64 {
        let mut state = 1_u64;
        move |below| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) % below
        }
    }

    fn cube(centre: DVec3, half: f64) -> Bounds {
        Bounds { low: centre - half, high: centre + half }
    }

    /// All pairs, found by searches of `bodies` bodies each that are suspended after `steps` steps.
    fn found(broad_phase: &BroadPhase, bodies: usize, steps: u64) -> (Vec<u32>, Stop) {
        let (mut pairs, stop) = (Vec::new(), Stop::default());
        for first in (0..broad_phase.bodies()).step_by(bodies) {
            let mut search = PairSearch::new(first, broad_phase.bodies().min(first + bodies as u32));
            while !search.is_done() {
                broad_phase.search(&mut search, steps, 1 << 14, &stop).unwrap();
                pairs.append(&mut search.pairs);
            }
        }
        (pairs, stop)
    }

    /// Catches a pair that the tree loses, invents or finds twice, pairs out of order, a rule that is
    /// not kept, and a search whose result depends on where it was suspended. Compares 200 scenes of
    /// boxes, worlds and groups with a check of every pair.
    #[test]
    fn the_pairs_are_those_of_every_pair_looked_at() {
        let mut next = numbers();
        let (mut pairs_found, mut kept_apart) = (0, 0);
        for scene in 0..200 {
            let bodies = next(120) as usize;
            let size = [1, 20, 1 << 20][scene % 3];
            let mut bounds = Vec::new();
            for _ in 0..bodies {
                let centre = DVec3::from_array([0; 3].map(|_| next(size) as f64));
                bounds.push(if next(20) == 0 {
                    None
                } else {
                    Some(cube(centre, 0.5 + next(size / 4 + 1) as f64))
                });
            }
            let mut some = |kinds: u64, of: [u32; 4]| -> Vec<u32> {
                if next(2) == 0 {
                    return Vec::new();
                }
                (0..bodies).map(|_| of[next(kinds) as usize]).collect()
            };
            let worlds = some(4, [0, 7, EVERY_WORLD, 9]);
            let groups = some(4, [0, 1, 2, 3]);
            let ignored = if groups.is_empty() { vec![] } else { vec![3, 1, 1, 3, 2, 2] };
            let rules = Rules::new(worlds.clone(), groups.clone(), ignored);
            let broad_phase = BroadPhase::new(bounds.clone(), rules, &Stop::default()).unwrap();
            let of = |column: &[u32], body: usize| column.get(body).copied().unwrap_or(0);
            let mut expected = Vec::new();
            for a in 0..bodies {
                for b in a + 1..bodies {
                    let (Some(one), Some(other)) = (bounds[a], bounds[b]) else { continue };
                    let (v, w) = (of(&worlds, a), of(&worlds, b));
                    let (g, h) = (of(&groups, a), of(&groups, b));
                    let apart = (v == w && v == EVERY_WORLD)
                        || (v != w && v != EVERY_WORLD && w != EVERY_WORLD)
                        || (g != 0 && g == h)
                        || (g.min(h) == 1 && g.max(h) == 3);
                    let meets = one.meets(&other);
                    kept_apart += u32::from(meets && apart);
                    if meets && !apart {
                        expected.extend([a as u32, b as u32]);
                    }
                }
            }
            pairs_found += expected.len() / 2;
            for (bodies, steps) in [(1 << 20, u64::MAX), (7, 1 << 10), (64, 1)] {
                assert_eq!(found(&broad_phase, bodies, steps).0, expected, "scene {scene}, {steps} steps");
            }
        }
        assert!(pairs_found > 20_000 && kept_apart > 20_000, "{pairs_found} found, {kept_apart} apart");
    }

    /// Catches a scene that occupies a thread although the rules exclude all its pairs. Measures the
    /// largest number of steps between two checks of the flag in scenes in which all boxes overlap.
    #[test]
    fn hostile_scenes_are_looked_up_from() {
        // The largest number of bodies of a request with the default limits.
        let bodies = 131_072_u32;
        let bounds = || vec![Some(cube(DVec3::ZERO, 1.0)); bodies as usize];
        let one_group = Rules::new(vec![], vec![1; bodies as usize], vec![]);
        let worlds = Rules::new((0..bodies).collect(), vec![], vec![]);
        let every_world = Rules::new(
            (0..bodies).map(|i| if i % 2 == 0 { EVERY_WORLD } else { i }).collect(),
            vec![],
            vec![],
        );
        // 1,000 groups, each of which ignores every other.
        let ignored = (1..=1000).flat_map(|g| (1..=1000).flat_map(move |h| [g, h])).collect();
        let groups = Rules::new(vec![], (0..bodies).map(|i| 1 + i % 1000).collect(), ignored);
        for (name, rules, most) in [
            ("one group", one_group, 0),
            ("a world each", worlds, 0),
            ("every world", every_world, 4_000_000),
            ("ignored pairs", groups, 0),
        ] {
            let stop = Stop::default();
            let broad_phase = BroadPhase::new(bounds(), rules, &stop).unwrap();
            let mut search = PairSearch::new(0, bodies);
            // Search only a part of the scene. The whole would take too long without the stop flag.
            for _ in 0..20 {
                broad_phase.search(&mut search, 1 << 20, usize::MAX, &stop).unwrap();
            }
            assert!(search.pairs.len() <= most, "{name}");
            assert!(stop.largest_between_looks() <= STEPS_BETWEEN_LOOKS, "{name}: {stop:?}");
            stop.stop();
            assert_eq!(broad_phase.search(&mut PairSearch::new(0, 9), 99, 99, &stop), Err(Stopped), "{name}");
            assert!(BroadPhase::new(bounds(), Rules::default(), &stop).is_err(), "{name}");
        }
    }
}

//! Which bodies of a scene may meet: an R*-tree a world over their bounds.
//!
//! A body's partners are those with a higher index, so that each pair is found once, and
//! pairs come out sorted without ever being together in memory.

use std::ops::ControlFlow;

use rstar::{AABB, RTree, RTreeObject};

use crate::contact::Bounds;

/// The world that meets every other.
pub const EVERY_WORLD: u32 = u32::MAX;

/// Which bodies never meet, wherever they are.
#[derive(Clone, Debug, Default)]
pub struct Rules {
    /// Empty, or one a body: only bodies of one world meet; [`EVERY_WORLD`] meets every
    /// other, not another such.
    pub worlds: Vec<u32>,
    /// Empty, or one a body: bodies of one group never meet; 0 is none.
    pub groups: Vec<u32>,
    /// Groups that ignore each other: both orders, sorted.
    ignored: Vec<[u32; 2]>,
}

impl Rules {
    /// `ignored` are pairs of groups, in either order.
    pub fn new(worlds: Vec<u32>, groups: Vec<u32>, ignored: &[[u32; 2]]) -> Self {
        let mut ignored: Vec<_> = ignored.iter().flat_map(|&[g, h]| [[g, h], [h, g]]).collect();
        ignored.sort_unstable();
        ignored.dedup();
        Self { worlds, groups, ignored }
    }

    fn world(&self, body: u32) -> u32 {
        self.worlds.get(body as usize).copied().unwrap_or(0)
    }

    /// Whether two bodies' groups let them meet.
    fn strangers(&self, a: u32, b: u32) -> bool {
        let [g, h] = [a, b].map(|body| self.groups.get(body as usize).copied().unwrap_or(0));
        g == 0 || h == 0 || (g != h && self.ignored.binary_search(&[g, h]).is_err())
    }
}

type Box3 = AABB<[f64; 3]>;

#[derive(Clone, Copy, Debug)]
struct Leaf {
    envelope: Box3,
    body: u32,
}

impl RTreeObject for Leaf {
    type Envelope = Box3;

    fn envelope(&self) -> Box3 {
        self.envelope
    }
}

/// The bodies of a scene, to be asked for each one's partners.
#[derive(Debug)]
pub struct BroadPhase {
    /// The bodies of each world but [`EVERY_WORLD`], by ascending world.
    worlds: Vec<(u32, RTree<Leaf>)>,
    everywhere: RTree<Leaf>,
    /// Per body; none where it is in no pair.
    envelopes: Vec<Option<Box3>>,
    rules: Rules,
}

impl BroadPhase {
    /// Per body its bounds; one without any is in no pair.
    pub fn new(bounds: impl IntoIterator<Item = Option<Bounds>>, rules: Rules) -> Self {
        let envelope = |Bounds { low, high }| AABB::from_corners(low.to_array(), high.to_array());
        let envelopes: Vec<_> = bounds.into_iter().map(|bounds| bounds.map(envelope)).collect();
        let leaves = envelopes.iter().zip(0..);
        let mut leaves: Vec<Leaf> =
            leaves.filter_map(|(&envelope, body)| Some(Leaf { envelope: envelope?, body })).collect();
        // Stable: a tree depends on its own bodies alone.
        leaves.sort_by_key(|leaf| rules.world(leaf.body));
        let by_world = leaves.chunk_by(|a, b| rules.world(a.body) == rules.world(b.body));
        let mut worlds: Vec<_> =
            by_world.map(|leaves| (rules.world(leaves[0].body), RTree::bulk_load(leaves.to_vec()))).collect();
        let everywhere = worlds.pop_if(|(world, _)| *world == EVERY_WORLD);
        let everywhere = everywhere.map(|(_, tree)| tree).unwrap_or_default();
        Self { worlds, everywhere, envelopes, rules }
    }

    /// How many bodies, those in no pair included.
    pub fn bodies(&self) -> u32 {
        self.envelopes.len() as u32
    }

    /// Adds the pairs of `body` with those of a higher index whose bounds meet its own and
    /// that the rules let meet, in ascending order; 2 indices a pair.
    pub fn pairs_of(&self, body: u32, pairs: &mut Vec<u32>, scratch: &mut Vec<u32>) {
        let Some(&Some(envelope)) = self.envelopes.get(body as usize) else { return };
        scratch.clear();
        let mut look_in = |tree: &RTree<Leaf>| {
            let _ = tree.locate_in_envelope_intersecting_int(envelope, |leaf: &Leaf| {
                if leaf.body > body && self.rules.strangers(body, leaf.body) {
                    scratch.push(leaf.body);
                }
                ControlFlow::<()>::Continue(())
            });
        };
        match self.rules.world(body) {
            EVERY_WORLD => self.worlds.iter().for_each(|(_, tree)| look_in(tree)),
            world => {
                if let Ok(at) = self.worlds.binary_search_by_key(&world, |(world, _)| *world) {
                    look_in(&self.worlds[at].1);
                }
                look_in(&self.everywhere);
            }
        }
        scratch.sort_unstable();
        pairs.extend(scratch.iter().flat_map(|&other| [body, other]));
    }
}

//! A static tree over boxes.
//!
//! The tree halves its bodies again and again at the median of their centres, along the axis on
//! which the centres are spread the most; the bodies of one world stay together. The nodes are
//! stored in the order in which a search visits them (preorder), and each node knows the node
//! that follows its subtree. A search is therefore one loop without a stack, and its whole state
//! is one index: it can be left and continued at any node.
//!
//! A node also has the highest body of its subtree, since only partners with a higher index are
//! looked for, and the group of its bodies if they are all of one: a body of that group has no
//! partner there.
//!
//! Building takes O(n log n) steps, and a search O(log n) for each partner in scenes whose boxes
//! overlap a few others each.

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::{EVERY_WORLD, Rules};
use crate::contact::{Bounds, Stop, Stopped};

/// The most bodies of a leaf node.
const LEAF_BODIES: usize = 4;

/// Steps of looking at a node, and at a body of a leaf node.
const NODE_STEPS: u64 = 12;
const BODY_STEPS: u64 = 8;

/// Steps of putting one body on one side of a median.
const SPLIT_STEPS: u64 = 12;

/// The estimated steps of building a tree, for each of its bodies.
pub const STEPS_PER_BODY: u64 = 250;

/// The most bytes that a broad phase takes for each body, with those of building it.
pub const TREE_BYTES_PER_BODY: usize =
    size_of::<Option<Bounds>>() + 2 * size_of::<Leaf>() + 2 * size_of::<Node>();

/// A body, as the tree knows it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leaf {
    pub(super) bounds: Bounds,
    pub(super) body: u32,
    pub(super) world: u32,
    pub(super) group: u32,
}

/// The bodies of one world, while the tree is built.
#[derive(Clone, Debug)]
struct World {
    bounds: Bounds,
    leaves: Range<usize>,
}

/// Bounds in single precision, rounded outward: nodes with them take half the cache, and the
/// bodies' own bounds decide.
#[derive(Clone, Copy, Debug)]
struct NodeBounds {
    low: Vec3,
    high: Vec3,
}

impl NodeBounds {
    fn around(Bounds { low, high }: Bounds) -> Self {
        let down = |x: f64| (x as f32).next_down();
        let up = |x: f64| (x as f32).next_up();
        Self {
            low: Vec3::new(down(low.x), down(low.y), down(low.z)),
            high: Vec3::new(up(high.x), up(high.y), up(high.z)),
        }
    }

    fn meets(&self, other: &Self) -> bool {
        (self.low.cmple(other.high) & other.low.cmple(self.high)).all()
    }
}

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: NodeBounds,
    /// The node that follows this one's subtree.
    next: u32,
    /// The first body of a leaf node, and how many it has; 0 of an inner node.
    first: u32,
    count: u32,
    /// The highest body of the subtree.
    highest: u32,
    /// The group of all bodies of the subtree; 0 if they have several or one has none.
    group: u32,
}

/// Bodies in a tree.
#[derive(Debug, Default)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
    /// Each world, and the node of its subtree; ascending.
    worlds: Vec<(u32, u32)>,
}

/// A search for the partners of one body.
pub(super) struct Query<'a> {
    pub(super) leaf: Leaf,
    pub(super) rules: &'a Rules,
    pub(super) found: &'a mut Vec<u32>,
    /// The steps that are left until the search is left.
    pub(super) left: &'a mut u64,
}

impl Tree {
    /// A tree of these bodies.
    pub(super) fn new(mut leaves: Vec<Leaf>, stop: &Stop) -> Result<Self, Stopped> {
        by_world(&mut leaves, stop)?;
        let mut worlds = Vec::new();
        let mut first = 0;
        for chunk in leaves.chunk_by(|a, b| a.world == b.world) {
            worlds.push(World { bounds: around(chunk), leaves: first..first + chunk.len() });
            first += chunk.len();
        }
        stop.spend(4 * leaves.len() as u64)?;
        let mut tree = Self { worlds: Vec::with_capacity(worlds.len()), ..Self::default() };
        tree.nodes.reserve(worlds.len() + leaves.len() / 2);
        if !worlds.is_empty() {
            tree.split_worlds(&mut worlds, &mut leaves, stop)?;
        }
        tree.nodes.shrink_to_fit();
        tree.worlds.sort_unstable();
        tree.leaves = leaves;
        Ok(tree)
    }

    /// Adds a subtree of several worlds.
    fn split_worlds(
        &mut self,
        worlds: &mut [World],
        leaves: &mut [Leaf],
        stop: &Stop,
    ) -> Result<(), Stopped> {
        if let [World { leaves: of_world, .. }] = worlds {
            let (of_world, first) = (&mut leaves[of_world.clone()], of_world.start);
            self.worlds.push((of_world[0].world, self.nodes.len() as u32));
            return self.split_bodies(of_world, first, stop);
        }
        let node = self.open();
        let (low, high) = halves(worlds, |world| world.bounds, stop)?;
        self.split_worlds(low, leaves, stop)?;
        self.split_worlds(high, leaves, stop)?;
        self.close(node);
        Ok(())
    }

    /// Adds a subtree of bodies of one world, which begin with leaf `first`.
    fn split_bodies(&mut self, leaves: &mut [Leaf], first: usize, stop: &Stop) -> Result<(), Stopped> {
        let node = self.open();
        if leaves.len() <= LEAF_BODIES {
            let group =
                if leaves.iter().all(|leaf| leaf.group == leaves[0].group) { leaves[0].group } else { 0 };
            let highest = leaves.iter().map(|leaf| leaf.body).max().unwrap_or(0);
            let (bounds, next) = (NodeBounds::around(around(leaves)), self.nodes.len() as u32);
            let (first, count) = (first as u32, leaves.len() as u32);
            self.nodes[node] = Node { bounds, next, first, count, highest, group };
            return Ok(());
        }
        let (low, high) = halves(leaves, |leaf| leaf.bounds, stop)?;
        let middle = first + low.len();
        self.split_bodies(low, first, stop)?;
        self.split_bodies(high, middle, stop)?;
        self.close(node);
        Ok(())
    }

    /// Adds a node whose subtree follows.
    fn open(&mut self) -> usize {
        let bounds = NodeBounds { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };
        self.nodes.push(Node { bounds, next: 0, first: 0, count: 0, highest: 0, group: 0 });
        self.nodes.len() - 1
    }

    /// Completes an inner node from its two children.
    fn close(&mut self, node: usize) {
        let low = self.nodes[node + 1];
        let high = self.nodes[low.next as usize];
        let bounds = NodeBounds {
            low: low.bounds.low.min(high.bounds.low),
            high: low.bounds.high.max(high.bounds.high),
        };
        let group = if low.group == high.group { low.group } else { 0 };
        let highest = low.highest.max(high.highest);
        self.nodes[node] = Node { bounds, next: high.next, first: 0, count: 0, highest, group };
    }

    /// The nodes of a search for bodies that meet `world`.
    pub(super) fn subtree_of(&self, world: u32) -> Range<usize> {
        if world == EVERY_WORLD {
            return 0..self.nodes.len();
        }
        match self.worlds.binary_search_by_key(&world, |&(world, _)| world) {
            Err(_) => 0..0,
            Ok(at) => {
                let node = self.worlds[at].1 as usize;
                node..self.nodes[node].next as usize
            }
        }
    }

    /// Adds the partners of a body from these nodes. Returns the nodes where the search was left,
    /// or none if it is complete.
    pub(super) fn partners(&self, nodes: Range<usize>, query: &mut Query<'_>) -> Option<Range<usize>> {
        let Range { start: mut at, end } = nodes;
        let Leaf { bounds, body, group, .. } = query.leaf;
        let node_bounds = NodeBounds::around(bounds);
        let rule_steps = query.rules.steps();
        let mut left = *query.left;
        while at < end {
            if left == 0 {
                *query.left = 0;
                return Some(at..end);
            }
            left = left.saturating_sub(NODE_STEPS);
            let node = &self.nodes[at];
            let may_have = node.highest > body && (group == 0 || node.group != group);
            if !may_have || !node.bounds.meets(&node_bounds) {
                at = node.next as usize;
                continue;
            }
            at += 1;
            let first = node.first as usize;
            for leaf in &self.leaves[first..first + node.count as usize] {
                left = left.saturating_sub(BODY_STEPS);
                if leaf.body > body && leaf.bounds.meets(&bounds) {
                    if group != 0 {
                        left = left.saturating_sub(rule_steps);
                    }
                    if query.rules.may_meet(group, leaf.group) {
                        query.found.push(leaf.body);
                    }
                }
            }
        }
        *query.left = left;
        None
    }
}

/// Sorts the bodies by world.
fn by_world(leaves: &mut [Leaf], stop: &Stop) -> Result<(), Stopped> {
    if !leaves.is_sorted_by_key(|leaf| leaf.world) {
        leaves.sort_unstable_by_key(|leaf| (leaf.world, leaf.body));
    }
    stop.spend(SPLIT_STEPS * leaves.len() as u64)
}

/// Two halves of `items`, the one below the other along the axis on which their centres are
/// spread the most.
fn halves<'a, T>(
    items: &'a mut [T],
    bounds: impl Fn(&T) -> Bounds,
    stop: &Stop,
) -> Result<(&'a mut [T], &'a mut [T]), Stopped> {
    // Twice the centre.
    let center = |item: &T| bounds(item).low + bounds(item).high;
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for item in &*items {
        let center = center(item);
        (low, high) = (low.min(center), high.max(center));
    }
    let spread = high - low;
    let axis = [0, 1, 2].into_iter().max_by(|&i, &j| spread[i].total_cmp(&spread[j])).unwrap_or(0);
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| center(a)[axis].total_cmp(&center(b)[axis]));
    stop.spend(SPLIT_STEPS * items.len() as u64)?;
    Ok(items.split_at_mut(middle))
}

/// The box around some bodies.
fn around(leaves: &[Leaf]) -> Bounds {
    let none = Bounds { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };
    leaves.iter().fold(none, |around, leaf| union(around, leaf.bounds))
}

fn union(a: Bounds, b: Bounds) -> Bounds {
    Bounds { low: a.low.min(b.low), high: a.high.max(b.high) }
}

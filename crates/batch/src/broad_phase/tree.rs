//! A tree of boxes (a bounding volume hierarchy) that is searched without a stack.
//!
//! Building splits the bodies into halves again and again, at the median of their centres along the
//! axis on which the centres are spread the most. First whole worlds are split, then the bodies of
//! each world, so that the bodies of one world form one subtree.
//!
//! The nodes are stored in the order in which a search visits them (preorder), and each node stores
//! the index of the node that follows its subtree. A search is one loop:
//!
//! ```text
//!           0              nodes: 0 1 2 3 4 5 6
//!         /   \            next:  7 4 3 4 7 6 7
//!       1       4
//!      / \     / \         at = 0
//!     2   3   5   6        while at < end:
//!                              if the box of node `at` does not overlap: at = next[at]
//!                              otherwise: test its bodies if it is a leaf; at = at + 1
//! ```
//!
//! So the whole state of a search is one index, and a search can be suspended and resumed at any
//! node. This layout is that of B. Smits, *Efficiency issues for ray tracing*, 1998,
//! doi:10.1080/10867651.1998.10487488.
//!
//! Two more tests skip subtrees. A node stores the highest body of its subtree, because only
//! partners with a higher index are wanted. And it stores the group of its bodies if they are all
//! of one group, because a body of that group has no partner there.
//!
//! Building takes `O(n log n)` steps. If each box overlaps only a few others, a search takes
//! `O(log n)` steps per partner.
//!
//! A tree can follow bodies that move ([`refit`]): its shape stays, and only boxes change.

mod refit;

use std::{cmp::Ordering, ops::Range};

use glam::{DVec3, Vec3};

use super::{EVERY_WORLD, Rules};
use hullcast_contact::{Bounds, Stop, Stopped, sort, stop::Meter};

#[cfg(test)]
pub(super) use self::refit::FOLLOWER_BYTES_PER_BODY;
pub(super) use self::refit::Follower;

/// The largest number of bodies in a leaf node.
const LEAF_BODIES: usize = 4;

/// Steps to visit a node.
const NODE_STEPS: u64 = 12;
/// Steps to test a body of a leaf node.
const BODY_STEPS: u64 = 8;

/// Steps per item to find the axis along which a list is split.
const AXIS_STEPS: u64 = 4;
/// Steps per item to split a list at a median.
const SPLIT_STEPS: u64 = 8;
/// The largest number of items that are split without a check of the stop flag.
const UNINTERRUPTED: usize = 32_768;
/// One of this many items is in the sample from which the pivot of a long list is taken.
const SAMPLED: usize = 64;

/// The estimated number of steps per body to build a tree.
pub const STEPS_PER_BODY: u64 = 250;

/// The largest number of bytes per body that a broad phase takes, including those of building it.
pub const TREE_BYTES_PER_BODY: usize =
    size_of::<Option<Bounds>>() + 2 * size_of::<Leaf>() + 2 * size_of::<Node>();

/// A body with all that the tree stores of it.
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

/// Bounds in single precision, rounded outward. So nodes take half as much of the CPU's cache. A pair is
/// decided by the bodies' own bounds in double precision.
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

/// A node of the tree: an inner node or a leaf.
#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: NodeBounds,
    /// The index of the node that follows the subtree of this node.
    next: u32,
    /// For a leaf node, the index of its first body in [`Tree::leaves`].
    first: u32,
    /// The number of bodies of a leaf node; 0 for an inner node.
    count: u32,
    /// The highest body index in the subtree.
    highest: u32,
    /// The group of all bodies in the subtree; 0 if they are of several groups or one has no group.
    group: u32,
}

/// A tree of bodies; see the module's documentation.
#[derive(Debug, Default)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
    /// The worlds, ascending, each with the root node of its subtree.
    worlds: Vec<(u32, u32)>,
}

/// A search for the partners of one body.
pub(super) struct PartnerSearch<'a> {
    pub(super) leaf: Leaf,
    /// The lowest index of the partners that are searched for.
    pub(super) least: u32,
    pub(super) rules: &'a Rules,
    pub(super) found: &'a mut Vec<u32>,
    /// The number of steps that are left until the search is suspended.
    pub(super) left: &'a mut u64,
}

impl Tree {
    /// Builds a tree of these bodies.
    pub(super) fn new(mut leaves: Vec<Leaf>, stop: &Stop) -> Result<Self, Stopped> {
        by_world(&mut leaves, stop)?;
        let mut worlds = Vec::new();
        let mut first = 0;
        for of_world in leaves.chunk_by(|a, b| a.world == b.world) {
            let mut bounds = EMPTY;
            for run in of_world.chunks(UNINTERRUPTED) {
                stop.spend(AXIS_STEPS * run.len() as u64)?;
                bounds = union(bounds, around(run));
            }
            worlds.push(World { bounds, leaves: first..first + of_world.len() });
            first += of_world.len();
        }
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

    /// Appends the subtree of one or more worlds.
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

    /// Appends the subtree of bodies of one world. `first` is the index of the first of them in
    /// [`Tree::leaves`].
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

    /// Appends a node that is completed once its subtree is known. Returns the index of the node.
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

    /// The nodes that a search for bodies of `world` visits; all nodes for [`EVERY_WORLD`].
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

    /// Searches `nodes` for partners of a body and adds them to the search. Returns the nodes that are
    /// still to be visited if the search is suspended, or `None` if it is complete.
    pub(super) fn partners(
        &self,
        nodes: Range<usize>,
        search: &mut PartnerSearch<'_>,
    ) -> Option<Range<usize>> {
        let Range { start: mut at, end } = nodes;
        let (Leaf { bounds, body, group, .. }, least) = (search.leaf, search.least);
        let node_bounds = NodeBounds::around(bounds);
        let rule_steps = search.rules.steps();
        let mut left = *search.left;
        while at < end {
            if left == 0 {
                *search.left = 0;
                return Some(at..end);
            }
            left = left.saturating_sub(NODE_STEPS);
            let node = &self.nodes[at];
            let may_have = node.highest >= least && (group == 0 || node.group != group);
            if !may_have || !node.bounds.meets(&node_bounds) {
                at = node.next as usize;
                continue;
            }
            at += 1;
            let first = node.first as usize;
            for leaf in &self.leaves[first..first + node.count as usize] {
                left = left.saturating_sub(BODY_STEPS);
                if leaf.body >= least && leaf.body != body && leaf.bounds.meets(&bounds) {
                    if group != 0 {
                        left = left.saturating_sub(rule_steps);
                    }
                    if search.rules.may_meet(group, leaf.group) {
                        search.found.push(leaf.body);
                    }
                }
            }
        }
        *search.left = left;
        None
    }
}

/// Sorts the bodies by world.
fn by_world(leaves: &mut Vec<Leaf>, stop: &Stop) -> Result<(), Stopped> {
    let meter = Meter::new(stop);
    if !leaves.is_sorted_by_key(|leaf| leaf.world) {
        sort::sort(leaves, &meter, sort::COMPARISON, |a, b| (a.world, a.body).cmp(&(b.world, b.body)))?;
    }
    meter.spend(leaves.len() as u64)
}

/// Splits `items` into two halves at the median of their centres, along the axis on which the centres
/// are spread the most. The first half is the lower one.
fn halves<'a, T>(
    items: &'a mut [T],
    bounds: impl Fn(&T) -> Bounds,
    stop: &Stop,
) -> Result<(&'a mut [T], &'a mut [T]), Stopped> {
    // This is twice the centre, which has the same order.
    let centre = |item: &T| bounds(item).low + bounds(item).high;
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for run in items.chunks(UNINTERRUPTED) {
        stop.spend(AXIS_STEPS * run.len() as u64)?;
        for item in run {
            let centre = centre(item);
            (low, high) = (low.min(centre), high.max(centre));
        }
    }
    let spread = high - low;
    let axis = [0, 1, 2].into_iter().max_by(|&i, &j| spread[i].total_cmp(&spread[j])).unwrap_or(0);
    let middle = items.len() / 2;
    select(items, middle, |item| centre(item)[axis], stop)?;
    Ok(items.split_at_mut(middle))
}

/// Reorders `items` so that none of the first `middle` items has a higher key than any of the rest.
///
/// This is quickselect (C. A. R. Hoare, *Algorithm 65: Find*, 1961, doi:10.1145/366622.366647). A long
/// list is partitioned under a meter, because the selection of the standard library, which handles the
/// rest, cannot be interrupted. The pivot is the median of every [`SAMPLED`]-th key. Each partition
/// therefore drops at least one item in `2 SAMPLED`, whatever the order of the items is, and the
/// selection takes at most about `2 SAMPLED n` steps.
fn select<T>(items: &mut [T], middle: usize, key: impl Fn(&T) -> f64, stop: &Stop) -> Result<(), Stopped> {
    let meter = Meter::new(stop);
    let (mut start, mut end) = (0, items.len());
    while end - start > UNINTERRUPTED {
        let part = &mut items[start..end];
        let mut sample: Vec<f64> = part.iter().step_by(SAMPLED).map(&key).collect();
        let at = sample.len() / 2;
        let pivot = *sample.select_nth_unstable_by(at, f64::total_cmp).1;
        let (below, above) = partition(part, pivot, &key, &meter)?;
        if middle < start + below {
            end = start + below;
        } else if middle >= start + above {
            start += above;
        } else {
            return Ok(());
        }
    }
    meter.spend(SPLIT_STEPS * (end - start) as u64)?;
    if middle < end {
        items[start..end].select_nth_unstable_by(middle - start, |a, b| key(a).total_cmp(&key(b)));
    }
    Ok(())
}

/// Moves the items whose key is below `pivot` to the front and those above it to the back. Returns the
/// range of the items between, whose key is `pivot`.
fn partition<T>(
    items: &mut [T],
    pivot: f64,
    key: impl Fn(&T) -> f64,
    meter: &Meter<'_>,
) -> Result<(usize, usize), Stopped> {
    let (mut below, mut at, mut above) = (0, 0, items.len());
    while at < above {
        meter.spend(SPLIT_STEPS)?;
        match key(&items[at]).total_cmp(&pivot) {
            Ordering::Less => {
                items.swap(below, at);
                (below, at) = (below + 1, at + 1);
            }
            Ordering::Equal => at += 1,
            Ordering::Greater => {
                above -= 1;
                items.swap(at, above);
            }
        }
    }
    Ok((below, above))
}

/// The box around nothing.
const EMPTY: Bounds = Bounds { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };

/// The box around some bodies.
fn around(leaves: &[Leaf]) -> Bounds {
    leaves.iter().fold(EMPTY, |around, leaf| union(around, leaf.bounds))
}

/// The box around two boxes.
fn union(a: Bounds, b: Bounds) -> Bounds {
    Bounds { low: a.low.min(b.low), high: a.high.max(b.high) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hullcast_contact::{STEPS_BETWEEN_LOOKS, workload::Random};

    /// Catches a partition that loses items or leaves a low item in the upper half, a pivot that makes no
    /// progress, an order of the items that makes the selection quadratic, and a unit of work that is too
    /// long. The keys are chosen against the pivot: the sampled ones are the lowest or the highest.
    #[test]
    fn long_lists_are_split_at_the_median_in_bounded_steps() {
        let mut random = Random::new(7);
        for length in [UNINTERRUPTED, UNINTERRUPTED + 1, 3 * UNINTERRUPTED + 5, 131_072] {
            let mut keys_of: Vec<(&str, Vec<f64>)> = vec![
                ("ascending", (0..length).map(|i| i as f64).collect()),
                ("descending", (0..length).map(|i| -(i as f64)).collect()),
                ("equal", vec![1.0; length]),
                ("two values", (0..length).map(|i| (i % 2) as f64).collect()),
                ("random", (0..length).map(|_| random.unit()).collect()),
            ];
            for (name, sign) in [("low sample", -1.0), ("high sample", 1.0)] {
                let key = |i: usize| {
                    if i.is_multiple_of(SAMPLED) { sign * 1e9 } else { (i * 7919 % length) as f64 }
                };
                keys_of.push((name, (0..length).map(key).collect()));
            }
            for (name, keys) in keys_of {
                let middle = length / 2;
                let mut items: Vec<usize> = (0..length).collect();
                let stop = Stop::default();
                assert_eq!(select(&mut items, middle, |&item| keys[item], &stop), Ok(()));
                let lowest = items[..middle].iter().map(|&item| keys[item]).fold(f64::MIN, f64::max);
                let highest = items[middle..].iter().map(|&item| keys[item]).fold(f64::MAX, f64::min);
                assert!(lowest <= highest, "{name}, {length} items: {lowest} before {highest}");
                items.sort_unstable();
                assert!(items.iter().enumerate().all(|(at, &item)| at == item), "{name}, {length} items");
                let bound = 2 * SAMPLED as u64 * SPLIT_STEPS * length as u64;
                assert!(stop.steps() <= bound, "{name}, {length} items: {stop:?}");
                assert!(stop.largest_between_looks() <= STEPS_BETWEEN_LOOKS, "{name}: {stop:?}");
                stop.stop();
                assert_eq!(select(&mut items, middle, |&item| keys[item], &stop), Err(Stopped), "{name}");
            }
        }
    }
}

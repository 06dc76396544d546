//! Lets a tree follow bodies that move a little, without building it again.
//!
//! The shape of the tree stays. A body that moves gets new bounds in its leaf node. If the box of the node no
//! longer contains them, the node gets a new box, a little larger than necessary, and so do the nodes above it
//! as far as they change. Because boxes are larger than necessary, most steps of a body that moves slowly
//! change no node.
//!
//! ```text
//! body b moves:
//!     node = the leaf node of b
//!     the centre of b is outside the home of the node: take b out, it does not belong here any more
//!     the box of the node does not contain its bodies, or is far too large: grow a box around them
//!     while the box of `node` changed: node = its parent; its box = the box around its two children
//! ```
//!
//! The *home* of a leaf node is the box of its parent when the tree was built. A body whose centre leaves it is
//! taken out. So no node's box ever exceeds its first box by more than the size of its bodies, and searches stay
//! fast however long the tree is kept.

use hullcast_contact::{Bounds, Stopped, stop::Meter};

use super::{EMPTY, Leaf, NODE_STEPS, Node, NodeBounds, Tree, around};

/// The part of its largest side by which the box of a leaf node is larger than necessary, on each side.
const GROWN: f32 = 1.0 / 32.0;
/// A box that is larger by more than this part is shrunk.
const TOO_LARGE: f32 = 4.0 * GROWN;

/// The memory per body that a [`Follower`] takes.
#[cfg(test)]
pub(in super::super) const FOLLOWER_BYTES_PER_BODY: usize =
    2 * (size_of::<u32>() + size_of::<NodeBounds>()) + size_of::<u32>();

/// The parts of a tree that only following its bodies needs.
#[derive(Debug, Default)]
pub(in super::super) struct Follower {
    /// For each node, its parent. The root's parent is the root.
    parents: Vec<u32>,
    /// For each node, its box when the tree was built.
    built: Vec<NodeBounds>,
    /// For each place in [`Tree::leaves`], its leaf node.
    nodes: Vec<u32>,
}

impl NodeBounds {
    const EVERYTHING: Self = Self { low: glam::Vec3::NEG_INFINITY, high: glam::Vec3::INFINITY };

    fn contains(&self, other: &Self) -> bool {
        (self.low.cmple(other.low) & other.high.cmple(self.high)).all()
    }

    /// The box that is larger by the part `by` of its largest side, on each side.
    fn grown(&self, by: f32) -> Self {
        let more = by * (self.high - self.low).max_element();
        Self { low: self.low - more, high: self.high + more }
    }

    /// Whether the box contains the centre of these bounds.
    fn contains_centre(&self, bounds: &Bounds) -> bool {
        let centre = (0.5 * (bounds.low + bounds.high)).as_vec3();
        (self.low.cmple(centre) & centre.cmple(self.high)).all()
    }
}

impl Follower {
    /// A follower of the bodies of this tree, which was just built.
    pub(in super::super) fn new(tree: &Tree, meter: &Meter<'_>) -> Result<Self, Stopped> {
        let mut follower = Self {
            parents: vec![0; tree.nodes.len()],
            built: Vec::with_capacity(tree.nodes.len()),
            nodes: vec![0; tree.leaves.len()],
        };
        for (at, node) in (0..).zip(&tree.nodes) {
            meter.spend(NODE_STEPS)?;
            follower.built.push(node.bounds);
            let first = node.first as usize;
            follower.nodes[first..first + node.count as usize].fill(at);
            if node.count == 0 {
                let low = at as usize + 1;
                for child in [low, tree.nodes[low].next as usize] {
                    follower.parents[child] = at;
                }
            }
        }
        Ok(follower)
    }

    /// The bytes of the follower.
    pub(in super::super) fn heap_bytes(&self) -> usize {
        size_of_val(&self.parents[..]) + size_of_val(&self.built[..]) + size_of_val(&self.nodes[..])
    }

    /// The home of a leaf node.
    fn home(&self, node: usize) -> NodeBounds {
        let parent = self.parents[node] as usize;
        if parent == node { NodeBounds::EVERYTHING } else { self.built[parent] }
    }
}

impl Tree {
    /// The bodies of the tree, in the order of their places.
    pub(in super::super) fn leaves(&self) -> &[Leaf] {
        &self.leaves
    }

    /// The bytes of the tree.
    pub(in super::super) fn heap_bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.leaves[..]) + size_of_val(&self.worlds[..])
    }

    /// Gives the body at `place` new bounds, or none. Returns false if the body has left the home of its leaf
    /// node; it is then no longer in the tree. The boxes of the nodes are not changed yet.
    pub(in super::super) fn place(
        &mut self,
        place: usize,
        bounds: Option<Bounds>,
        follower: &Follower,
    ) -> bool {
        let home = follower.home(follower.nodes[place] as usize);
        let stays = bounds.is_none_or(|bounds| home.contains_centre(&bounds));
        self.leaves[place].bounds = bounds.filter(|_| stays).unwrap_or(EMPTY);
        stays
    }

    /// Takes all bodies out of the tree, but keeps their places.
    pub(in super::super) fn clear(&mut self, meter: &Meter<'_>) -> Result<(), Stopped> {
        for leaf in &mut self.leaves {
            meter.spend(2)?;
            (leaf.bounds, leaf.body) = (EMPTY, 0);
        }
        Ok(())
    }

    /// Puts a body into a place that was cleared. Returns false if the body does not belong there: its world or
    /// group is another one, or it is outside the home of the leaf node.
    pub(in super::super) fn settle(&mut self, place: usize, leaf: Leaf, follower: &Follower) -> bool {
        let was = self.leaves[place];
        let stays = (was.world, was.group) == (leaf.world, leaf.group);
        if stays && self.place(place, Some(leaf.bounds), follower) {
            self.leaves[place].body = leaf.body;
            return true;
        }
        false
    }

    /// Finds the highest body of each node again, after the bodies have got other indices.
    pub(in super::super) fn find_highest(&mut self, meter: &Meter<'_>) -> Result<(), Stopped> {
        for node in (0..self.nodes.len()).rev() {
            meter.spend(NODE_STEPS)?;
            let Node { first, count, .. } = self.nodes[node];
            let leaves = &self.leaves[first as usize..(first + count) as usize];
            let of_leaves = leaves.iter().map(|leaf| leaf.body).max();
            self.nodes[node].highest = of_leaves.unwrap_or_else(|| {
                let low = self.nodes[node + 1];
                low.highest.max(self.nodes[low.next as usize].highest)
            });
        }
        Ok(())
    }

    /// Adapts the boxes of the nodes above the body at `place`.
    pub(in super::super) fn refit(
        &mut self,
        place: usize,
        follower: &Follower,
        meter: &Meter<'_>,
    ) -> Result<(), Stopped> {
        let mut node = follower.nodes[place] as usize;
        let mut changed = self.refit_leaf(node);
        while changed && follower.parents[node] as usize != node {
            meter.spend(NODE_STEPS)?;
            node = follower.parents[node] as usize;
            changed = self.refit_inner(node);
        }
        Ok(())
    }

    /// Adapts the boxes of all nodes.
    pub(in super::super) fn refit_all(&mut self, meter: &Meter<'_>) -> Result<(), Stopped> {
        // The children of a node come after it.
        for node in (0..self.nodes.len()).rev() {
            meter.spend(NODE_STEPS)?;
            if self.nodes[node].count > 0 {
                self.refit_leaf(node)
            } else {
                self.refit_inner(node)
            };
        }
        Ok(())
    }

    /// Adapts the box of a leaf node to its bodies. Returns whether it changed.
    fn refit_leaf(&mut self, node: usize) -> bool {
        let node = &mut self.nodes[node];
        let first = node.first as usize;
        let needed = NodeBounds::around(around(&self.leaves[first..first + node.count as usize]));
        if node.bounds.contains(&needed) && needed.grown(TOO_LARGE).contains(&node.bounds) {
            return false;
        }
        let fits = needed.low.cmple(needed.high).all();
        node.bounds = if fits { needed.grown(GROWN) } else { needed };
        true
    }

    /// Adapts the box of an inner node to its children. Returns whether it changed.
    fn refit_inner(&mut self, node: usize) -> bool {
        let low = self.nodes[node + 1];
        let high = self.nodes[low.next as usize].bounds;
        let bounds = NodeBounds { low: low.bounds.low.min(high.low), high: low.bounds.high.max(high.high) };
        let before = std::mem::replace(&mut self.nodes[node].bounds, bounds);
        before.low != bounds.low || before.high != bounds.high
    }
}

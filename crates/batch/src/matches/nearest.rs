//! A k-d tree over contact points that finds the nearest of those that are left.
//!
//! The tree is balanced and never changes its shape: node `i` has the children `2 i + 1` and `2 i + 2`, and its
//! points are a range of one list (J. L. Bentley, *Multidimensional binary search trees used for associative
//! searching*, 1975, doi:10.1145/361002.361007). A point has six coordinates, three on A and three on B. A
//! removed point stays in its place, and the nodes above it count one point less; a node without points is not
//! entered. Building takes `O(n log n)` time, and removing `O(log n)`.

use hullcast_contact::{Stopped, stop::Meter};

use super::{LocalPoint, POINT_STEPS, length};

/// The most points of a leaf.
const LEAF: usize = 8;

/// Steps to look at a node.
const NODE_STEPS: u64 = 15;

/// The number of coordinates of a point.
const AXES: usize = 6;

/// A tree over some points of a row.
#[derive(Debug)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    /// The points, each with its index in the row, in the order of the leaves.
    points: Vec<(LocalPoint, u32)>,
    /// For each index in the row that a point has: its place in `points`, or `None` if it is removed.
    places: Vec<Option<u32>>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    low: LocalPoint,
    high: LocalPoint,
    /// The range of the node's points, removed ones included.
    first: u32,
    end: u32,
    /// The number of points that are not removed.
    left: u32,
    /// The lowest index in the row of the node's points, removed ones included.
    lowest: u32,
}

fn coordinate(point: &LocalPoint, axis: usize) -> f64 {
    if axis < 3 { point.on_a[axis] } else { point.on_b[axis - 3] }
}

impl Tree {
    /// The tree of points, each with its index in the row.
    pub(super) fn new(mut points: Vec<(LocalPoint, u32)>, meter: &Meter<'_>) -> Result<Self, Stopped> {
        // A node is halved until it is a leaf, so all leaves have nearly the same depth.
        let levels = points.len().div_ceil(LEAF).next_power_of_two().ilog2();
        let mut nodes: Vec<Node> = Vec::with_capacity((2 << levels) - 1);
        let mut ranges = vec![0..points.len()];
        for level in 0..=levels {
            let mut halves = Vec::with_capacity(2 * ranges.len());
            for range in ranges {
                let some = &mut points[range.clone()];
                meter.spend(POINT_STEPS * (1 + 4 * some.len() as u64))?;
                let node = Node::new(some, range.start);
                nodes.push(node);
                if level < levels {
                    let middle = some.len() / 2;
                    let axis = node.widest();
                    if middle > 0 {
                        some.select_nth_unstable_by(middle, |one, other| {
                            coordinate(&one.0, axis).total_cmp(&coordinate(&other.0, axis))
                        });
                    }
                    let middle = range.start + middle;
                    halves.extend([range.start..middle, middle..range.end]);
                }
            }
            ranges = halves;
        }
        let rows = points.iter().map(|&(_, index)| index as usize + 1).max().unwrap_or(0);
        let mut places = vec![None; rows];
        for (place, &(_, index)) in (0..).zip(&points) {
            places[index as usize] = Some(place);
        }
        Ok(Self { nodes, points, places })
    }

    /// Whether the point with this index is there.
    pub(super) fn has(&self, index: u32) -> bool {
        self.places.get(index as usize).is_some_and(Option::is_some)
    }

    /// The point with this index, which must be there.
    pub(super) fn point(&self, index: u32) -> LocalPoint {
        let place = self.places[index as usize].unwrap_or_default();
        self.points[place as usize].0
    }

    /// Removes a point.
    pub(super) fn remove(&mut self, index: u32) {
        let Some(place) = self.places[index as usize].take() else { return };
        let mut at = 0;
        while let Some(node) = self.nodes.get_mut(at) {
            node.left -= 1;
            let second = self.nodes.get(2 * at + 2);
            at = match second {
                Some(second) if second.first <= place => 2 * at + 2,
                _ => 2 * at + 1,
            };
        }
    }

    /// The point nearest to `to` that is within `reach`, the one with the lowest index if several are.
    pub(super) fn nearest(
        &self,
        to: &LocalPoint,
        reach: f64,
        meter: &Meter<'_>,
    ) -> Result<Option<u32>, Stopped> {
        let mut best: Option<(f64, u32)> = None;
        // Whether a point that is not nearer and has no lower index could still be better.
        let is_worse = |best: Option<(f64, u32)>, distance: f64, index: u32| match best {
            None => distance > reach,
            Some((nearest, lowest)) => distance > nearest || (distance == nearest && index >= lowest),
        };
        let mut open = vec![(self.nodes[0].bound(to), 0)];
        while let Some((bound, at)) = open.pop() {
            meter.spend(NODE_STEPS)?;
            let node = &self.nodes[at];
            if node.left == 0 || is_worse(best, bound, node.lowest) {
                continue;
            }
            if let (Some(first), Some(second)) = (self.nodes.get(2 * at + 1), self.nodes.get(2 * at + 2)) {
                let (first, second) = ((first.bound(to), 2 * at + 1), (second.bound(to), 2 * at + 2));
                // The nearer child is looked at first.
                let (near, far) = if first.0 <= second.0 { (first, second) } else { (second, first) };
                open.extend([far, near]);
                continue;
            }
            meter.spend(POINT_STEPS * u64::from(node.end - node.first))?;
            for (point, index) in &self.points[node.first as usize..node.end as usize] {
                let distance = point.distance(to);
                if self.has(*index) && !is_worse(best, distance, *index) {
                    best = Some((distance, *index));
                }
            }
        }
        Ok(best.map(|(_, index)| index))
    }
}

impl Node {
    fn new(points: &[(LocalPoint, u32)], first: usize) -> Self {
        let corner = |of: f64| LocalPoint { on_a: glam::DVec3::splat(of), on_b: glam::DVec3::splat(of) };
        let (first, count) = (first as u32, points.len() as u32);
        let (low, high) = (corner(f64::INFINITY), corner(f64::NEG_INFINITY));
        let mut node = Self { low, high, first, end: first + count, left: count, lowest: u32::MAX };
        for (point, index) in points {
            node.low.on_a = node.low.on_a.min(point.on_a);
            node.low.on_b = node.low.on_b.min(point.on_b);
            node.high.on_a = node.high.on_a.max(point.on_a);
            node.high.on_b = node.high.on_b.max(point.on_b);
            node.lowest = node.lowest.min(*index);
        }
        node
    }

    /// The axis along which the points are farthest apart.
    fn widest(&self) -> usize {
        let extent = |axis: usize| coordinate(&self.high, axis) - coordinate(&self.low, axis);
        (1..AXES).fold(0, |widest, axis| if extent(axis) > extent(widest) { axis } else { widest })
    }

    /// A lower bound of the distance from `to` to the node's points. It is computed like a distance, and
    /// rounding keeps the order of numbers, so no computed distance is below it.
    fn bound(&self, to: &LocalPoint) -> f64 {
        let outside = |low: glam::DVec3, high: glam::DVec3, at: glam::DVec3| {
            length((low - at).max(at - high).max(glam::DVec3::ZERO))
        };
        let on_a = outside(self.low.on_a, self.high.on_a, to.on_a);
        on_a.max(outside(self.low.on_b, self.high.on_b, to.on_b))
    }
}

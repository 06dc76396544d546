//! A growing set of points that is asked for the point farthest along a direction.
//!
//! All points that may ever be in the set are known in advance. They are sorted into a tree
//! with four children for each node: their number is halved twice, along the longest side of
//! their box (a k-d tree; J. L. Bentley, *Multidimensional binary search trees used for
//! associative searching*, 1975, doi:10.1145/361002.361007). Each child has axes of its own, two
//! along the surface that its points lie on and one across it (an OBB tree; S. Gottschalk,
//! M. C. Lin and D. Manocha, *OBBTree*, 1996, doi:10.1145/237170.237244), and the box along
//! these axes around those of its points that are in the set. All this is done after a linear
//! map that makes the whole set about as wide as long, so that a needle is no harder than a
//! ball. The four boxes of a node are measured together in single precision, which compiles to
//! vector instructions.
//!
//! ```text
//! add(point):              grow the boxes on the way from the root to the point's leaf
//! farthest_along(n, near): best = the best of `near`; visit(root), where
//!   visit(node):           for each child, the one of the highest bound first:
//!                              if bound(child.box, n) is below the best height: leave it out
//!                              leaf: compare its points; else: visit(child)
//! ```
//!
//! The bound takes, for each axis of the node, the end of the box that is farther along `n`, and
//! adds an allowance for all roundings. A point that it leaves out is certainly lower, so the
//! answer is to the bit the one that looking at every point gives. Of equally high points the
//! answer is the one that was added first.
//!
//! A patch of a smooth surface is flat to the square of its size, and so is its box. A search
//! therefore opens few nodes beside those on the way to the answer: it takes about the logarithm
//! of the number of points, as adding a point does.

use std::ops::Range;

use glam::DVec3;

use crate::contact::stop::{Meter, Stopped};
use crate::contact::tolerance::{NOISE, U};

/// Points of a leaf at most.
const LEAF: usize = 8;
/// Not in the set yet.
const ABSENT: u32 = u32::MAX;
/// Children of a node.
const CHILDREN: usize = 4;
/// Steps of the bounds of a node's children.
const BOUNDS: u64 = 24;
/// Steps of the height of one point.
const HEIGHT: u64 = 3;
/// Nodes that wait in a search: three of each of 16 levels, and one.
const MOST_OPEN: usize = 64;

/// See the module.
pub(super) struct PointTree {
    /// In the order of the leaves.
    points: Vec<DVec3>,
    /// For each point, how many were added before it, or [`ABSENT`].
    added: Vec<u32>,
    /// The place of each point, by its index among those given.
    places: Vec<u32>,
    /// The root first.
    nodes: Vec<Node>,
    map: Map,
    first: Added,
    count: u32,
}

/// A point of the set, and how many were added before it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Added {
    pub(super) point: DVec3,
    before: u32,
}

/// A number for each child of a node.
type Each<T> = [T; CHILDREN];

/// The children of a node: their points, and the boxes around those in the set.
#[derive(Default)]
struct Node {
    /// For each axis its coordinates, unit: along the surface, along it, and across it.
    axes: [[Each<f32>; 3]; 3],
    /// Along each axis.
    low: [Each<f32>; 3],
    high: [Each<f32>; 3],
    /// 0 if a point of the child is in the set, otherwise negative infinity.
    filled: Each<f32>,
    /// The place of the child's own node, or 0 for a leaf.
    nodes: Each<u32>,
    /// The child's points are at `starts..ends`.
    starts: Each<u32>,
    ends: Each<u32>,
}

impl Node {
    /// No point of a child that is in the set is higher along `n`, but for rounding.
    #[inline]
    fn bounds(&self, n: [f32; 3]) -> Each<f32> {
        let mut bounds = self.filled;
        for axis in 0..3 {
            let [x, y, z] = &self.axes[axis];
            for c in 0..CHILDREN {
                let along = x[c] * n[0] + y[c] * n[1] + z[c] * n[2];
                let (low, high) = (along * self.low[axis][c], along * self.high[axis][c]);
                bounds[c] += if low > high { low } else { high };
            }
        }
        bounds
    }

    /// Grows the box of child `c`.
    fn add(&mut self, c: usize, point: DVec3) {
        let new = self.filled[c] != 0.0;
        self.filled[c] = 0.0;
        for axis in 0..3 {
            let along = DVec3::from_array(self.axes[axis].map(|each| f64::from(each[c]))).dot(point) as f32;
            let (low, high) = (&mut self.low[axis][c], &mut self.high[axis][c]);
            (*low, *high) = if new { (along, along) } else { (low.min(along), high.max(along)) };
        }
    }
}

/// Axes of points on a patch of a surface: towards the farthest from the first, in the plane of
/// these two and the point farthest from their line, and across that plane.
fn axes(points: impl Iterator<Item = DVec3> + Clone) -> [DVec3; 3] {
    let Some(first) = points.clone().next() else { return DVec3::AXES };
    let farthest = |size: &dyn Fn(DVec3) -> f64| {
        let larger = |best: (DVec3, f64), p: DVec3| if size(p) > best.1 { (p, size(p)) } else { best };
        points.clone().fold((first, 0.0), larger).0 - first
    };
    let along = farthest(&|p| (p - first).length_squared()).normalize_or(DVec3::X);
    let other = farthest(&|p| along.cross(p - first).length_squared());
    // Twice, so that the axes are orthogonal to rounding even if both directions are nearly one.
    let reject = |v: DVec3| (v - along * along.dot(v)).normalize_or(along.any_orthonormal_vector());
    let other = reject(reject(other));
    [along, other, along.cross(other)]
}

impl PointTree {
    /// The tree over `all` points, with the one of index `first` in the set.
    pub(super) fn new(all: &[DVec3], first: u32, meter: &Meter<'_>) -> Result<Self, Stopped> {
        let mut order: Vec<u32> = (0..all.len() as u32).collect();
        let map = Map::new(all);
        let round: Vec<DVec3> = all.iter().map(|&p| map.point(p)).collect();
        // Nodes to be made, with their points.
        let mut ranges = vec![0..all.len()];
        let mut nodes = Vec::new();
        while nodes.len() < ranges.len() {
            let range = ranges[nodes.len()].clone();
            meter.spend(32 * HEIGHT * range.len() as u64)?;
            let middle = range.start + halve(&round, &mut order[range.clone()]);
            let quarter = range.start + halve(&round, &mut order[range.start..middle]);
            let last = middle + halve(&round, &mut order[middle..range.end]);
            let ends = [quarter, middle, last, range.end];
            let mut node = Node { filled: [f32::NEG_INFINITY; CHILDREN], ..Node::default() };
            let mut start = range.start;
            for (c, end) in ends.into_iter().enumerate() {
                let own = axes(order[start..end].iter().map(|&i| round[i as usize]));
                for (axis, own) in own.iter().enumerate() {
                    (0..3).for_each(|k| node.axes[axis][k][c] = own[k] as f32);
                }
                (node.starts[c], node.ends[c]) = (start as u32, end as u32);
                if end - start > LEAF {
                    node.nodes[c] = ranges.len() as u32;
                    ranges.push(start..end);
                }
                start = end;
            }
            nodes.push(node);
        }
        let mut places = vec![0; all.len()];
        order.iter().zip(0..).for_each(|(&i, place)| places[i as usize] = place);
        let points = order.iter().map(|&i| all[i as usize]).collect();
        let (added, point) = (vec![ABSENT; all.len()], all[first as usize]);
        let first_added = Added { point, before: 0 };
        let mut tree = Self { points, added, places, nodes, map, first: first_added, count: 0 };
        tree.add(first);
        Ok(tree)
    }

    /// Adds the point of this index among all.
    pub(super) fn add(&mut self, index: u32) {
        let place = self.places[index as usize];
        let point = self.points[place as usize];
        self.added[place as usize] = self.count;
        self.count += 1;
        let point = self.map.point(point);
        let mut at = 0;
        loop {
            let node = &mut self.nodes[at];
            let child = (0..CHILDREN - 1).find(|&c| place < node.ends[c]).unwrap_or(CHILDREN - 1);
            node.add(child, point);
            at = node.nodes[child] as usize;
            if at == 0 {
                break;
            }
        }
    }

    /// The point that was added first.
    pub(super) fn first(&self) -> Added {
        self.first
    }

    /// The point of the set that is farthest along `n`, of equals the one added first. `near` are
    /// points of the set that are about as far.
    pub(super) fn farthest_along(
        &self,
        n: DVec3,
        near: &[Added],
        meter: &Meter<'_>,
    ) -> Result<Added, Stopped> {
        let mut best = Best { added: self.first, height: n.dot(self.first.point) };
        near.iter().for_each(|&added| best.improve(n, added));
        let (mapped, offset, rounding) = self.map.direction(n);
        // Nodes that wait, with their bounds.
        let mut open = [(0_u32, f64::INFINITY); MOST_OPEN];
        let mut count = 1;
        while count > 0 {
            count -= 1;
            let (node, bound) = open[count];
            if bound < best.height {
                continue;
            }
            meter.spend(BOUNDS)?;
            let node = &self.nodes[node as usize];
            let bounds = node.bounds(mapped).map(|bound| f64::from(bound) + offset + rounding);
            let highest = bounds.iter().fold(f64::NEG_INFINITY, |a, &b| if b > a { b } else { a });
            // The child of the highest bound is looked at first: a leaf at once, another pushed last.
            let is_leaf = |c: usize| node.nodes[c] == 0;
            let order = |c: usize| (bounds[c] == highest) == is_leaf(c);
            for first in [true, false] {
                for c in (0..CHILDREN).filter(|&c| order(c) == first) {
                    if bounds[c] < best.height {
                        continue;
                    }
                    if is_leaf(c) {
                        let places = node.starts[c] as usize..node.ends[c] as usize;
                        meter.count(HEIGHT * places.len() as u64);
                        self.look_at(places, n, &mut best);
                    } else if count < MOST_OPEN {
                        open[count] = (node.nodes[c], bounds[c]);
                        count += 1;
                    }
                }
            }
        }
        Ok(best.added)
    }

    /// The points of a leaf.
    #[inline]
    fn look_at(&self, places: Range<usize>, n: DVec3, best: &mut Best) {
        for (&point, &before) in self.points[places.clone()].iter().zip(&self.added[places]) {
            if before != ABSENT {
                best.improve(n, Added { point, before });
            }
        }
    }
}

/// The highest point so far.
struct Best {
    added: Added,
    height: f64,
}

impl Best {
    #[inline]
    fn improve(&mut self, n: DVec3, added: Added) {
        let height = n.dot(added.point);
        if height > self.height || (height == self.height && added.before < self.added.before) {
            *self = Self { added, height };
        }
    }
}

/// Makes a set about as wide in every direction: `p = mean + factor * q`, with the Cholesky
/// factor of the points' covariance.
struct Map {
    mean: DVec3,
    /// Of the factor: its first column, of the second the lower two, of the third the last.
    factor: [f64; 6],
    /// The largest coordinate of a mapped point.
    reach: f64,
}

/// Roundoffs of single precision in a bound, of the largest product in it: of three axes, of two
/// sums of products each, and of what was rounded before.
const SINGLE_ROUNDING: f64 = 64.0 * (f32::EPSILON / 2.0) as f64;

impl Map {
    fn new(all: &[DVec3]) -> Self {
        let count = all.len().max(1) as f64;
        let mean = all.iter().sum::<DVec3>() / count;
        let of = |i: usize, j: usize| all.iter().map(|&p| (p - mean)[i] * (p - mean)[j]).sum::<f64>() / count;
        // A variance that rounding makes zero or less leaves its coordinate as it is.
        let root = |x: f64| if x > 0.0 { x.sqrt() } else { 1.0 };
        let a = root(of(0, 0));
        let (b, d) = (of(1, 0) / a, of(2, 0) / a);
        let c = root(of(1, 1) - b * b);
        let e = (of(2, 1) - b * d) / c;
        let f = root(of(2, 2) - d * d - e * e);
        let mut map = Self { mean, factor: [a, b, d, c, e, f], reach: 0.0 };
        map.reach = all.iter().fold(0.0, |reach, &p| map.point(p).abs().max_element().max(reach));
        map
    }

    fn point(&self, p: DVec3) -> DVec3 {
        let [a, b, d, c, e, f] = self.factor;
        let p = p - self.mean;
        let x = p.x / a;
        let y = (p.y - b * x) / c;
        DVec3::new(x, y, (p.z - d * x - e * y) / f)
    }

    /// A direction, so that a point's height along `n` is the second number more than that of
    /// the mapped point along the mapped direction; and how much a bound of the height may be
    /// too low.
    fn direction(&self, n: DVec3) -> ([f32; 3], f64, f64) {
        let [a, b, d, c, e, f] = self.factor;
        let mapped = DVec3::new(a * n.x + b * n.y + d * n.z, c * n.y + e * n.z, f * n.z);
        let rounding = SINGLE_ROUNDING * mapped.abs().element_sum() * self.reach
            + 4.0 * NOISE * U * n.abs().element_sum() * (1.0 + self.reach);
        (mapped.to_array().map(|x| x as f32), n.dot(self.mean), rounding)
    }
}

/// Orders the indices so that the first half's points come before the others along the
/// longest side of their box; returns the size of the half.
fn halve(all: &[DVec3], indices: &mut [u32]) -> usize {
    if indices.len() < 2 {
        return indices.len();
    }
    let at = |i: &u32| all[*i as usize];
    let low = indices.iter().map(at).fold(DVec3::INFINITY, DVec3::min);
    let high = indices.iter().map(at).fold(DVec3::NEG_INFINITY, DVec3::max);
    let size = high - low;
    let axis = if size.x >= size.y && size.x >= size.z { 0 } else { 1 + usize::from(size.z > size.y) };
    let half = indices.len() / 2;
    indices.select_nth_unstable_by(half, |i, j| at(i)[axis].total_cmp(&at(j)[axis]).then(i.cmp(j)));
    half
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::stop::Stop;
    use crate::workload::Random;

    /// Catches a box that does not grow, a bound below one of its points, and a tie that goes to
    /// another point than the first: whole coordinates tie all the time, and every answer is
    /// compared with looking at all points in the order in which they were added.
    #[test]
    fn the_farthest_point_is_the_one_that_looking_at_all_finds() {
        let mut random = Random::new(11);
        let stop = Stop::default();
        let meter = Meter::new(&stop);
        let (mut ties, mut asked) = (0, 0);
        for count in [1, 2, 8, 9, 17, 100, 1000] {
            for fine in [0.1, 0.001] {
                let mut whole = || (3.0 * random.within(-1.0, 1.0)).round();
                let mut vector = || DVec3::new(whole(), whole(), whole());
                let all: Vec<DVec3> = (0..count).map(|_| vector() * fine).collect();
                let mut order: Vec<u32> = (0..count as u32).collect();
                for i in (1..count).rev() {
                    order.swap(i, random.below(i + 1));
                }
                let mut tree = PointTree::new(&all, order[0], &meter).unwrap();
                let mut set = vec![all[order[0] as usize]];
                for &i in &order[1..] {
                    tree.add(i);
                    set.push(all[i as usize]);
                    let n =
                        if random.below(2) == 0 { random.direction() } else { set[random.below(set.len())] };
                    let higher = |best: DVec3, &p: &DVec3| if n.dot(p) > n.dot(best) { p } else { best };
                    let expected = set.iter().fold(set[0], higher);
                    let near = [tree.first(), tree.farthest_along(-n, &[], &meter).unwrap()];
                    let found = tree.farthest_along(n, &near[..random.below(3)], &meter).unwrap();
                    assert_eq!(found.point, expected);
                    assert_eq!(found.before as usize, set.iter().position(|p| *p == expected).unwrap());
                    ties += usize::from(set.iter().filter(|p| n.dot(**p) == n.dot(expected)).count() > 1);
                    asked += 1;
                }
            }
        }
        assert!(asked > 2000 && ties > 500, "{asked} {ties}");
    }
}

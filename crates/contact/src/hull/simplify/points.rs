//! A growing set of points that answers which of its points is farthest along a direction.
//!
//! All points that may ever be in the set are known in advance. They are sorted into a tree in
//! which each node has four children: the points of a node are halved twice, each time at the
//! median along the longest side of their box (a k-d tree; J. L. Bentley, *Multidimensional binary
//! search trees used for associative searching*, 1975, doi:10.1145/361002.361007). Each child has
//! a box around those of its points that are in the set. The axes of the box are its own, two along
//! the surface that the points lie on and one across it (an OBB tree; S. Gottschalk, M. C. Lin and
//! D. Manocha, *OBBTree*, 1996, doi:10.1145/237170.237244).
//!
//! ```text
//! add(point):              grow the boxes on the way from the root to the leaf of the point
//! farthest_along(n, near): best = the farthest of `near`; visit(root); return best
//! visit(node):             for each child whose bound(box, n) is not below the height of best:
//!                              if the child is a leaf, compare its points with best;
//!                              otherwise visit(child)
//! ```
//!
//! The bound takes, for each axis of a box, the end that is farther along `n`, and adds an
//! allowance for all roundings. A point that the bound rules out is certainly lower than the best
//! one. So the answer is exactly the answer of a scan over all points. If several points are
//! equally high, the answer is the point that was added first.
//!
//! Two choices make it fast. The four boxes of a node are evaluated together in single precision,
//! which compiles to vector instructions. And the points are first mapped linearly so that the set
//! is about as wide as it is long; a needle is then no harder than a ball.
//!
//! A patch of a smooth surface of size `h` has a thickness of about `h^2`, and so does its box. A
//! search therefore opens few nodes besides those on the way to the answer. Searching and adding
//! both take about logarithmic time.

use glam::DVec3;

use crate::stop::{Meter, Stopped};
use crate::tolerance::{MAPPED_HEIGHT, SINGLE_ROUNDING, U};

/// The largest number of points in a leaf.
const LEAF: usize = 8;
/// Marks a point that is not in the set yet.
const ABSENT: u32 = u32::MAX;
/// The number of children of a node.
const CHILDREN: usize = 4;
/// Steps to compute the bounds of the children of a node.
const BOUNDS: u64 = 24;
/// Steps to compute the height of one point.
const HEIGHT: u64 = 3;
/// The largest number of nodes that wait in a search: three on each of 16 levels, and one more.
const MOST_OPEN: usize = 64;

/// A growing set of points in a tree; see the module's documentation.
pub(super) struct PointTree {
    /// The points in the order of the leaves. The index of a point here is its *place*.
    points: Vec<DVec3>,
    /// For each place, the number of points added before the point, or [`ABSENT`].
    added: Vec<u32>,
    /// For each point, by its given index, its place.
    places: Vec<u32>,
    /// The nodes. The root is first.
    nodes: Vec<Node>,
    map: Map,
    first: Added,
    count: u32,
}

/// A point of the set, and the number of points that were added before it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Added {
    pub(super) point: DVec3,
    before: u32,
    /// The place of the point in the tree.
    place: u32,
}

/// The place of the point that answered an earlier question. Any place is a valid guess, so the
/// default is the first place.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Guess(u32);

/// One value for each child of a node.
type Each<T> = [T; CHILDREN];

/// The children of a node: their points, and the boxes around the points that are in the set.
#[derive(Default)]
struct Node {
    /// The coordinates of the three unit axes of each box. Two axes are along the surface, and the
    /// third is across it.
    axes: [[Each<f32>; 3]; 3],
    /// The ends of each box along each axis.
    low: [Each<f32>; 3],
    high: [Each<f32>; 3],
    /// 0 if a point of the child is in the set, otherwise negative infinity.
    filled: Each<f32>,
    /// The index of the node with the children of this child, or 0 if the child is a leaf.
    nodes: Each<u32>,
    /// The points of the child are at the places `starts..ends`.
    starts: Each<u32>,
    ends: Each<u32>,
}

impl Node {
    /// For each child, an upper bound of the height along `n` of its points in the set, not counting
    /// rounding.
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

    /// Grows the box of child `c` to contain `point`.
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

/// Orthogonal axes for points on a patch of a surface. The first axis points from the first point to
/// the point farthest from it. The second is in the plane of these two points and the point
/// farthest from their line. The third is across that plane.
fn axes(points: impl Iterator<Item = DVec3> + Clone) -> [DVec3; 3] {
    let Some(first) = points.clone().next() else { return DVec3::AXES };
    let farthest = |size: &dyn Fn(DVec3) -> f64| {
        let larger = |best: (DVec3, f64), p: DVec3| if size(p) > best.1 { (p, size(p)) } else { best };
        points.clone().fold((first, 0.0), larger).0 - first
    };
    let along = farthest(&|p| (p - first).length_squared()).normalize_or(DVec3::X);
    let other = farthest(&|p| along.cross(p - first).length_squared());
    // Applied twice, so that the axes are orthogonal to rounding even if both directions are nearly
    // parallel.
    let reject = |v: DVec3| (v - along * along.dot(v)).normalize_or(along.any_orthonormal_vector());
    let other = reject(reject(other));
    [along, other, along.cross(other)]
}

impl PointTree {
    /// Builds the tree over `all` points. The set contains only the point with index `first`.
    pub(super) fn new(all: &[DVec3], first: u32, meter: &Meter<'_>) -> Result<Self, Stopped> {
        let mut order: Vec<u32> = (0..all.len() as u32).collect();
        meter.spend(16 * HEIGHT * all.len() as u64)?;
        let map = Map::new(all);
        let round: Vec<DVec3> = all.iter().map(|&p| map.point(p)).collect();
        // The points of each node; node `i` is made from `ranges[i]`.
        let mut ranges = Vec::new();
        ranges.push(0..all.len());
        let mut nodes = Vec::new();
        while nodes.len() < ranges.len() {
            let range = ranges[nodes.len()].clone();
            meter.spend(16 * HEIGHT * range.len() as u64)?;
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
        let first_added = Added { point, before: 0, place: places[first as usize] };
        let mut tree = Self { points, added, places, nodes, map, first: first_added, count: 0 };
        tree.add(first);
        Ok(tree)
    }

    /// Adds the point with this given index to the set.
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

    /// The point of the set that is farthest along `n`. If several are equally far, the point that
    /// was added first.
    ///
    /// `near` and `guess` only speed the search up: `near` holds points of the set that may be
    /// nearly as far, and `guess` is the answer to an earlier question. The new answer is stored in
    /// `guess`.
    pub(super) fn farthest_along(
        &self,
        n: DVec3,
        near: &[Added],
        guess: &mut Guess,
        meter: &Meter<'_>,
    ) -> Result<Added, Stopped> {
        let mut best = HighestPoint { added: self.first, height: n.dot(self.first.point) };
        near.iter().for_each(|&added| best.improve(n, added));
        best.improve(n, self.at(guess.0));
        let (mapped, offset, rounding) = self.map.direction(n);
        // The nodes that wait to be visited, with their bounds.
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
            for (c, bound) in bounds.into_iter().enumerate() {
                if bound < best.height {
                    continue;
                }
                if node.nodes[c] == 0 {
                    meter.count(HEIGHT * u64::from(node.ends[c] - node.starts[c]));
                    (node.starts[c]..node.ends[c]).for_each(|place| best.improve(n, self.at(place)));
                } else if count < MOST_OPEN {
                    open[count] = (node.nodes[c], bound);
                    count += 1;
                }
            }
        }
        guess.0 = best.added.place;
        Ok(best.added)
    }

    /// The point at a place of the tree.
    #[inline]
    fn at(&self, place: u32) -> Added {
        Added { point: self.points[place as usize], before: self.added[place as usize], place }
    }
}

/// The highest point so far.
struct HighestPoint {
    added: Added,
    height: f64,
}

impl HighestPoint {
    #[inline]
    fn improve(&mut self, n: DVec3, added: Added) {
        let height = n.dot(added.point);
        let better = height > self.height || (height == self.height && added.before < self.added.before);
        if better && added.before != ABSENT {
            *self = Self { added, height };
        }
    }
}

/// A linear map that makes a set about equally wide in all directions. A point `p` is mapped to `q`
/// with `p = mean + factor * q`, where `factor` is the Cholesky factor of the covariance of the
/// points.
struct Map {
    mean: DVec3,
    /// The lower triangle of the factor, column by column.
    factor: [f64; 6],
    /// The largest absolute coordinate of a mapped point.
    reach: f64,
}

impl Map {
    /// The map for these points.
    fn new(all: &[DVec3]) -> Self {
        let count = all.len().max(1) as f64;
        let mean = all.iter().sum::<DVec3>() / count;
        let of = |i: usize, j: usize| all.iter().map(|&p| (p - mean)[i] * (p - mean)[j]).sum::<f64>() / count;
        // If rounding makes a variance zero or negative, its coordinate is not scaled.
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

    /// The mapped point.
    fn point(&self, p: DVec3) -> DVec3 {
        let [a, b, d, c, e, f] = self.factor;
        let p = p - self.mean;
        let x = p.x / a;
        let y = (p.y - b * x) / c;
        DVec3::new(x, y, (p.z - d * x - e * y) / f)
    }

    /// The mapped direction, an offset, and a rounding allowance. The height of a point along `n` is
    /// the height of the mapped point along the mapped direction, plus the offset. A bound of a
    /// height that is computed in single precision is too low by at most the allowance.
    fn direction(&self, n: DVec3) -> ([f32; 3], f64, f64) {
        let [a, b, d, c, e, f] = self.factor;
        let mapped = DVec3::new(a * n.x + b * n.y + d * n.z, c * n.y + e * n.z, f * n.z);
        let rounding = SINGLE_ROUNDING * mapped.abs().element_sum() * self.reach
            + MAPPED_HEIGHT * U * n.abs().element_sum() * (1.0 + self.reach);
        (mapped.to_array().map(|x| x as f32), n.dot(self.mean), rounding)
    }
}

/// Orders the indices so that the points of the first half come before the others along the longest
/// side of their box. Returns the size of the first half.
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
    use crate::stop::Stop;
    use crate::workload::Random;

    /// Catches a box that does not grow, a bound that is below one of its points, and a tie that
    /// does not go to the point added first. Points with integer coordinates tie all the time. Every
    /// answer is compared with a scan over all points in the order in which they were added.
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
                let mut guess = Guess::default();
                let mut set = vec![all[order[0] as usize]];
                for &i in &order[1..] {
                    tree.add(i);
                    set.push(all[i as usize]);
                    let n =
                        if random.below(2) == 0 { random.direction() } else { set[random.below(set.len())] };
                    let higher = |best: DVec3, &p: &DVec3| if n.dot(p) > n.dot(best) { p } else { best };
                    let expected = set.iter().fold(set[0], higher);
                    let near =
                        [tree.first(), tree.farthest_along(-n, &[], &mut Guess::default(), &meter).unwrap()];
                    let found = tree.farthest_along(n, &near[..random.below(3)], &mut guess, &meter).unwrap();
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

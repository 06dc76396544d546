//! Matches the contact points of a pair with its points in the answer before.
//!
//! A simulation that keeps something for each contact point, such as an impulse, needs to know which points
//! are still the same. The rule has two parts:
//!
//! 1. Points with the same id match, in their order; each old point is taken once. The id names the features
//!    that make a point, so most points of a resting contact match here.
//! 2. Of the points that are left, those match that are close: every pair of a new and an old point has a
//!    distance, the pairs are taken by ascending (distance, new index, old index), and a pair counts if both
//!    of its points are free and the distance is within reach. The distance is the larger of two numbers: how
//!    far the witness on A has moved in A's frame, and how far the witness on B has moved in B's frame. So a
//!    contact that moves through the world with its bodies has not moved at all.
//!
//! Done as it is written, the second part compares all new points with all old ones and sorts the result. Two
//! large faces have thousands of points each, so it is done in another way with the same result. Call two
//! free points *mutual* if each is the first choice of the other, where a point prefers the other by
//! (distance, index). The order of the pairs is strict, so the next pair of the rule is always mutual, and
//! taking mutual pairs in any order gives the same matches (the argument is that of stable marriages). They
//! are found by a chain: go from a point to its first choice, from there to the first choice of that, and so
//! on. The pairs of the chain get ever smaller in the order, so it ends at a mutual pair. These are taken out,
//! and the chain continues from the point before (the nearest-neighbour chain of F. Murtagh, *A survey of
//! recent advances in hierarchical clustering algorithms*, 1983, doi:10.1093/comjnl/26.4.354). All chains
//! together ask `O(n)` times for a first choice, and a k-d tree ([`nearest`]) answers in about `O(log n)`.

mod nearest;

use glam::DVec3;
use hullcast_contact::{
    Stopped,
    sort::{self, sort},
    stop::Meter,
};

use self::nearest::Tree;
use crate::codes::NO_INDEX;

/// The farthest that a point may have moved to match by its distance, as a fraction of the smaller circumradius
/// of the two hulls.
pub const REACH: f64 = 0.02;

/// Up to this many points of a row are compared with each other, which takes less time than sorting them.
const FEW: usize = 16;

/// Steps to compare two ids, or to look at a point.
const POINT_STEPS: u64 = 3;

/// The id of a point: the features of A and of B that make it.
pub type PointId = [u32; 4];

/// A contact point in the frames of its bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalPoint {
    /// The witness on A, in A's frame.
    pub on_a: DVec3,
    /// The witness on B, in B's frame.
    pub on_b: DVec3,
}

impl LocalPoint {
    /// How far a point has moved: the larger of the distances on A and on B.
    #[inline]
    pub fn distance(&self, other: &Self) -> f64 {
        let on_a = self.on_a - other.on_a;
        let on_b = self.on_b - other.on_b;
        length(on_a).max(length(on_b))
    }
}

/// The length of a vector. The order of its operations is part of the rule, since it decides ties.
#[inline]
fn length(v: DVec3) -> f64 {
    (v.x * v.x + v.y * v.y + v.z * v.z).sqrt()
}

/// The points of a pair in two answers.
pub trait PointPair {
    /// The id of a new point.
    fn new_id(&self, index: usize) -> PointId;
    /// The id of an old point.
    fn old_id(&self, index: usize) -> PointId;
    /// A new point in the frames of its bodies as they are now.
    fn new_point(&self, index: usize) -> LocalPoint;
    /// An old point in the frames of its bodies as they were then.
    fn old_point(&self, index: usize) -> LocalPoint;
}

/// Matches points by the rule of this module: `matched` has one entry for each new point, which becomes the
/// index of the old point, or [`NO_INDEX`]. There are `old` old points. `reach` is the farthest that a point
/// may have moved; [`REACH`] gives it for a pair of hulls.
///
/// # Errors
/// The work was stopped.
pub fn match_points(
    points: &impl PointPair,
    matched: &mut [u32],
    old: usize,
    reach: f64,
    meter: &Meter<'_>,
) -> Result<(), Stopped> {
    meter.spend(POINT_STEPS * (matched.len() + old) as u64)?;
    // A resting contact has the same points in the same order.
    if matched.len() == old && (0..old).all(|index| points.new_id(index) == points.old_id(index)) {
        for (index, matched) in (0..).zip(matched) {
            *matched = index;
        }
        return Ok(());
    }
    matched.fill(NO_INDEX);
    let mut taken = vec![false; old];
    if matched.len().max(old) <= FEW {
        match_few_ids(points, matched, &mut taken);
    } else {
        match_many_ids(points, matched, &mut taken, meter)?;
    }
    let left = |is_left: &dyn Fn(usize) -> bool, count: usize| -> Vec<u32> {
        (0..count).filter(|&index| is_left(index)).map(|index| index as u32).collect()
    };
    let new_left = left(&|index| matched[index] == NO_INDEX, matched.len());
    let old_left = left(&|index| !taken[index], old);
    if new_left.is_empty() || old_left.is_empty() {
        return Ok(());
    }
    match_nearest(points, matched, new_left, old_left, reach, meter)
}

/// Matches equal ids by comparing all of them.
fn match_few_ids(points: &impl PointPair, matched: &mut [u32], taken: &mut [bool]) {
    for (new, matched) in matched.iter_mut().enumerate() {
        let id = points.new_id(new);
        let found = (0..taken.len()).find(|&old| !taken[old] && points.old_id(old) == id);
        if let Some(old) = found {
            taken[old] = true;
            *matched = old as u32;
        }
    }
}

/// Matches equal ids by sorting them. The `k`-th new point of an id gets the `k`-th old one, as when each new
/// point in turn takes the first that is free.
fn match_many_ids(
    points: &impl PointPair,
    matched: &mut [u32],
    taken: &mut [bool],
    meter: &Meter<'_>,
) -> Result<(), Stopped> {
    let sorted = |id: &dyn Fn(usize) -> PointId, count: usize| {
        let mut ids: Vec<(PointId, u32)> = (0..count).map(|index| (id(index), index as u32)).collect();
        sort(&mut ids, meter, sort::COMPARISON, Ord::cmp).map(|()| ids)
    };
    let new_ids = sorted(&|index| points.new_id(index), matched.len())?;
    let old_ids = sorted(&|index| points.old_id(index), taken.len())?;
    let (mut new_ids, mut old_ids) = (new_ids.iter().peekable(), old_ids.iter().peekable());
    while let (Some((new_id, new)), Some((old_id, old))) = (new_ids.peek(), old_ids.peek()) {
        meter.spend(POINT_STEPS)?;
        if new_id == old_id {
            matched[*new as usize] = *old;
            taken[*old as usize] = true;
        }
        if new_id <= old_id {
            new_ids.next();
        }
        if old_id <= new_id {
            old_ids.next();
        }
    }
    Ok(())
}

/// A set of points that are left, and whether it is the new or the old one.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    New,
    Old,
}

/// Matches the points that are left by their distance.
fn match_nearest(
    points: &impl PointPair,
    matched: &mut [u32],
    new_left: Vec<u32>,
    old_left: Vec<u32>,
    reach: f64,
    meter: &Meter<'_>,
) -> Result<(), Stopped> {
    let starts = new_left.clone();
    let new_points = new_left.into_iter().map(|index| (points.new_point(index as usize), index));
    let mut new_tree = Tree::new(new_points.collect(), meter)?;
    let old_points = old_left.into_iter().map(|index| (points.old_point(index as usize), index));
    let mut old_tree = Tree::new(old_points.collect(), meter)?;
    let mut starts = starts.iter();
    // The points of a chain are alternately new and old, each the first choice of the one before.
    let mut chain: Vec<(Side, u32)> = Vec::new();
    loop {
        let Some(&(side, index)) = chain.last() else {
            match starts.find(|&&index| new_tree.has(index)) {
                Some(&index) => chain.push((Side::New, index)),
                None => return Ok(()),
            }
            continue;
        };
        let (own, others) = match side {
            Side::New => (&mut new_tree, &mut old_tree),
            Side::Old => (&mut old_tree, &mut new_tree),
        };
        let before = chain.len().checked_sub(2).map(|at| chain[at].1);
        match others.nearest(&own.point(index), reach, meter)? {
            // No point is within reach, and there will not be one, since points only get fewer.
            None => {
                own.remove(index);
                chain.pop();
            }
            Some(choice) if before == Some(choice) => {
                own.remove(index);
                others.remove(choice);
                chain.truncate(chain.len() - 2);
                let (new, old) = if side == Side::New { (index, choice) } else { (choice, index) };
                matched[new as usize] = old;
            }
            Some(choice) => {
                let other = if side == Side::New { Side::Old } else { Side::New };
                chain.push((other, choice));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use hullcast_contact::{STEPS_BETWEEN_LOOKS, Stop, workload::Random};

    use super::*;

    /// The points of a pair as lists.
    struct Lists {
        new: Vec<(PointId, LocalPoint)>,
        old: Vec<(PointId, LocalPoint)>,
    }

    impl PointPair for Lists {
        fn new_id(&self, index: usize) -> PointId {
            self.new[index].0
        }

        fn old_id(&self, index: usize) -> PointId {
            self.old[index].0
        }

        fn new_point(&self, index: usize) -> LocalPoint {
            self.new[index].1
        }

        fn old_point(&self, index: usize) -> LocalPoint {
            self.old[index].1
        }
    }

    impl Lists {
        /// The matches by the words of the rule: all ids in turn, then all pairs by distance.
        fn naive(&self, reach: f64) -> Vec<u32> {
            let mut matched = vec![NO_INDEX; self.new.len()];
            let mut taken = vec![false; self.old.len()];
            for (new, (id, _)) in self.new.iter().enumerate() {
                if let Some(old) = (0..taken.len()).find(|&old| !taken[old] && self.old[old].0 == *id) {
                    (matched[new], taken[old]) = (old as u32, true);
                }
            }
            let mut pairs = Vec::new();
            for (new, (_, point)) in self.new.iter().enumerate() {
                for (old, (_, other)) in self.old.iter().enumerate() {
                    pairs.push((point.distance(other), new, old));
                }
            }
            pairs.sort_by(|one, other| {
                one.0.total_cmp(&other.0).then((one.1, one.2).cmp(&(other.1, other.2)))
            });
            for (distance, new, old) in pairs {
                if distance <= reach && matched[new] == NO_INDEX && !taken[old] {
                    (matched[new], taken[old]) = (old as u32, true);
                }
            }
            matched
        }

        fn matched(&self, reach: f64, stop: &Stop) -> Result<Vec<u32>, Stopped> {
            let mut matched = vec![7; self.new.len()];
            match_points(self, &mut matched, self.old.len(), reach, &Meter::new(stop))?;
            Ok(matched)
        }
    }

    /// Catches an old point that is matched twice, a match out of reach, a tie that is decided otherwise, equal
    /// ids out of order, and a chain that does not give the pairs of the rule. Random rows of up to 60 points,
    /// on a coarse grid so that many distances are equal, and with few ids so that many ids are equal.
    #[test]
    fn the_matches_are_those_of_the_rule() {
        let mut random = Random::new(3);
        let (mut by_id, mut by_distance, mut none, mut ties) = (0, 0, 0, 0);
        for case in 0..4_000_u64 {
            let most = [3, 12, 60][case as usize % 3];
            let grid = [4, 40, 1 << 20][case as usize / 3 % 3];
            let kinds = [2, 100, 1 << 20][case as usize / 9 % 3];
            let mut row = || {
                let count = random.bits() as usize % (most + 1);
                let points = (0..count).map(|_| {
                    let mut at = || (random.bits() % grid) as f64 / grid as f64;
                    let on_a = DVec3::new(at(), at(), 0.0);
                    let on_b = if case % 2 == 0 { on_a } else { DVec3::new(at(), at(), at()) };
                    let id = [(random.bits() % kinds) as u32, 0, 1, 2];
                    (id, LocalPoint { on_a, on_b })
                });
                points.collect::<Vec<_>>()
            };
            let lists = Lists { new: row(), old: row() };
            let reach = [0.3, 0.05, 2.0][case as usize / 27 % 3];
            let expected = lists.naive(reach);
            assert_eq!(lists.matched(reach, &Stop::default()), Ok(expected.clone()), "case {case}");
            for (new, &old) in expected.iter().enumerate() {
                match lists.old.get(old as usize) {
                    Some((id, _)) if *id == lists.new[new].0 => by_id += 1,
                    Some(_) => by_distance += 1,
                    None => none += 1,
                }
            }
            ties += u32::from(grid == 4);
        }
        let counts = [by_id, by_distance, none, ties];
        assert!(counts.iter().all(|&count| count > 1_000), "{counts:?}");
    }

    /// Catches a row of many points that takes a time with their square, and one that cannot be stopped. The
    /// points are those of the worst rows: all ids equal, all ids different and every point close to every
    /// other, and all points in one place.
    #[test]
    fn many_points_take_little_time() {
        let count = 20_000_u32;
        let ring = |turn: f64| -> Vec<LocalPoint> {
            let point = |index: u32| {
                let angle = (f64::from(index) + turn) / f64::from(count) * std::f64::consts::TAU;
                let on_a = DVec3::new(angle.cos(), angle.sin(), 0.0);
                LocalPoint { on_a, on_b: on_a }
            };
            (0..count).map(point).collect()
        };
        let place = vec![LocalPoint { on_a: DVec3::ZERO, on_b: DVec3::ONE }; count as usize];
        let same = |_: u32| [1; 4];
        let old_ids = |index: u32| [index, 0, 0, 0];
        let new_ids = |index: u32| [index, 1, 1, 1];
        let row = |points: Vec<LocalPoint>, id: &dyn Fn(u32) -> PointId| -> Vec<(PointId, LocalPoint)> {
            points.into_iter().zip(0..).map(|(point, index)| (id(index), point)).collect()
        };
        let cases = [
            ("equal ids", Lists { new: row(ring(0.2), &same), old: row(ring(0.0), &same) }),
            ("a turned ring", Lists { new: row(ring(0.2), &new_ids), old: row(ring(0.0), &old_ids) }),
            ("one place", Lists { new: row(place.clone(), &new_ids), old: row(place, &old_ids) }),
        ];
        for (name, lists) in cases {
            let stop = Stop::default();
            let matched = lists.matched(10.0, &stop).unwrap();
            assert!(matched.iter().all(|&old| old != NO_INDEX), "{name}");
            let per_point = stop.steps() / u64::from(count);
            // A comparison with every other point would take 20,000 steps.
            assert!(per_point < 10_000, "{name}: {per_point} steps per point");
            assert!(stop.largest_between_looks() <= STEPS_BETWEEN_LOOKS, "{name}");
            stop.stop();
            // Equal ids in order are matched before the meter looks.
            assert!(name == "equal ids" || lists.matched(10.0, &stop).is_err(), "{name}");
        }
    }
}

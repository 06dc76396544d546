//! Tests of updates: a kept broad phase is compared with one that is built anew.

use glam::DVec3;
use hullcast_contact::{STEPS_BETWEEN_LOOKS, workload::Random};

use super::*;
use crate::broad_phase::{
    MovedBodies, MovedSearch, PairSearch, TREE_BYTES_PER_BODY, tree::FOLLOWER_BYTES_PER_BODY,
};

/// The most bytes per body of a kept broad phase, including the memory of an update.
const KEPT_BYTES_PER_BODY: usize =
    2 * TREE_BYTES_PER_BODY + 2 * FOLLOWER_BYTES_PER_BODY + 2 * size_of::<Place>() + 2 * size_of::<u32>();

/// A scene that changes from step to step, and its broad phase.
struct Changing {
    random: Random,
    centres: Vec<DVec3>,
    halves: Vec<DVec3>,
    bounds: Vec<Option<Bounds>>,
    worlds: Vec<u32>,
    groups: Vec<u32>,
    side: f64,
}

impl Changing {
    /// `bodies` boxes of about unit size in a cube, so that each meets a few others.
    fn new(seed: u64, bodies: usize, has_rules: bool) -> Self {
        let (random, side) = (Random::new(seed), (bodies as f64).cbrt() * 1.2);
        let mut scene = Self {
            random,
            centres: Vec::new(),
            halves: Vec::new(),
            bounds: Vec::new(),
            worlds: Vec::new(),
            groups: Vec::new(),
            side,
        };
        for _ in 0..bodies {
            scene.add();
        }
        if has_rules {
            let random = &mut scene.random;
            scene.worlds = (0..bodies).map(|_| [0, 1, 7, EVERY_WORLD][random.below(4)]).collect();
            scene.groups = (0..bodies).map(|_| random.below(4) as u32).collect();
        }
        scene
    }

    fn place(&mut self) -> DVec3 {
        DVec3::from_array([0; 3].map(|_| self.random.within(0.0, self.side)))
    }

    fn add(&mut self) {
        let centre = self.place();
        let half = DVec3::from_array([0; 3].map(|_| self.random.within(0.2, 0.6)));
        self.centres.push(centre);
        self.halves.push(half);
        self.bounds.push(Some(Bounds { low: centre - half, high: centre + half }));
    }

    fn rules(&self) -> Rules {
        let ignored = if self.groups.is_empty() { Vec::new() } else { vec![1, 2] };
        Rules::new(self.worlds.clone(), self.groups.clone(), ignored)
    }

    /// Moves a body by about `by` along each axis.
    fn shift(&mut self, body: usize, by: f64) {
        self.centres[body] += DVec3::from_array([0; 3].map(|_| self.random.within(-by, by)));
        self.fit(body, 0.0);
    }

    fn fit(&mut self, body: usize, more: f64) {
        let (centre, half) = (self.centres[body], self.halves[body] + more);
        self.bounds[body] = Some(Bounds { low: centre - half, high: centre + half });
    }

    /// Changes a body in one of twelve ways.
    fn change(&mut self, body: usize, kind: usize) {
        match kind {
            0..=5 => self.shift(body, 0.01),
            6 | 7 => self.shift(body, 0.3),
            8 => {
                self.centres[body] = self.place();
                self.fit(body, 0.0);
            }
            9 => self.bounds[body] = None,
            // All drift in one direction.
            10 => {
                self.centres[body].x += 0.1;
                self.fit(body, 0.0);
            }
            _ => {
                let more = self.random.within(0.0, 3.0);
                self.fit(body, more);
            }
        }
    }

    /// Removes some bodies, adds others until there are `bodies`, and may reverse the order of those that stay.
    /// Returns the index that each body had.
    fn renumber(&mut self, step: u64, bodies: usize) -> Vec<u32> {
        let mut before: Vec<u32> = Vec::new();
        for body in 0..self.bounds.len() as u32 {
            if self.random.below(20) > 0 {
                before.push(body);
            }
        }
        if step.is_multiple_of(2) {
            before.reverse();
        }
        let was = |at: &u32| *at as usize;
        self.centres = before.iter().map(|at| self.centres[was(at)]).collect();
        self.halves = before.iter().map(|at| self.halves[was(at)]).collect();
        self.bounds = before.iter().map(|at| self.bounds[was(at)]).collect();
        while before.len() < bodies {
            before.push(NEW_BODY);
            self.add();
        }
        if !self.worlds.is_empty() {
            let known = |column: &[u32], at: &u32| column.get(was(at)).copied();
            self.worlds = before.iter().map(|at| known(&self.worlds, at).unwrap_or(1)).collect();
            self.groups = before.iter().map(|at| known(&self.groups, at).unwrap_or(0)).collect();
            // A body comes with another world, another with another group, and an index appears twice.
            self.worlds[3] = 7;
            self.groups[5] = 3;
            before[7] = before[8];
        }
        before
    }
}

fn all_pairs(broad_phase: &BroadPhase, steps: u64) -> Vec<u32> {
    let mut search = PairSearch::new(0, broad_phase.bodies());
    while !search.is_done() {
        broad_phase.search(&mut search, steps, usize::MAX, &Stop::default()).unwrap();
    }
    search.pairs
}

fn moved_pairs(broad_phase: &BroadPhase, moved: &MovedBodies, steps: u64) -> Vec<u32> {
    let count = moved.list().len();
    let searches = [(0, count / 3), (count / 3, count)].map(|(first, end)| {
        let mut search = MovedSearch::new(first, end);
        while !search.is_done() {
            broad_phase.search_moved(moved, &mut search, steps, usize::MAX, &Stop::default()).unwrap();
        }
        search
    });
    MovedSearch::pairs(searches, &Stop::default()).unwrap()
}

/// Thousands of random steps, in which bodies rest, jitter, drift, jump, grow, become invalid and return, and
/// are added, removed and exchanged. After each step the pairs are compared with those of a broad phase that is
/// built anew. Catches a body that is lost or found twice, a box that does not contain its bodies, a place that
/// belongs to another body, and pairs whose order depends on the past. The counts show that the trees were
/// really kept, and that each kind of change occurred.
#[test]
fn the_pairs_do_not_depend_on_the_past() {
    let (mut kept_steps, mut built_steps, mut loose_steps) = (0, 0, 0);
    let (mut pairs_found, mut invalid, mut renumbered, mut stayed) = (0, 0, 0, 0);
    for (seed, has_rules) in [(1, false), (2, true), (3, false), (4, true)] {
        let bodies = [150, 300, 60, 200][seed as usize - 1];
        let mut scene = Changing::new(seed, bodies, has_rules);
        let stop = Stop::default();
        let mut kept = BroadPhase::new(scene.bounds.clone(), scene.rules(), &stop).unwrap();
        for step in 0..800 {
            let count = scene.bounds.len();
            let mut moved = Vec::new();
            let share = [0, 1, 1, 4, 20, 100][scene.random.below(6)];
            let kind = scene.random.below(12);
            for body in 0..count {
                if scene.random.below(100) >= share {
                    continue;
                }
                moved.push(body as u32);
                scene.change(body, kind);
            }
            invalid += scene.bounds.iter().filter(|bounds| bounds.is_none()).count();
            if step % 9 == 8 {
                renumbered += 1;
                let before = scene.renumber(step, bodies);
                kept = kept.renumbered(&before, scene.bounds.clone(), scene.rules(), &stop).unwrap();
                moved = (0..scene.bounds.len() as u32).collect();
            } else {
                let new: Vec<_> = moved.iter().map(|&body| scene.bounds[body as usize]).collect();
                kept = kept.moved(&moved, &new, &stop).unwrap();
            }
            match &kept.kept {
                Some(state) => {
                    kept_steps += 1;
                    loose_steps += usize::from(!state.loose.is_empty());
                    stayed += state.places.iter().filter(|place| **place != Place::Loose).count();
                }
                None => built_steps += usize::from(!moved.is_empty()),
            }
            let anew = BroadPhase::new(scene.bounds.clone(), scene.rules(), &stop).unwrap();
            let expected = all_pairs(&anew, u64::MAX);
            pairs_found += expected.len() / 2;
            let steps = [u64::MAX, 1, 300][step as usize % 3];
            assert_eq!(all_pairs(&kept, steps), expected, "seed {seed}, step {step}, kind {kind}");
            let moved = MovedBodies::new(moved, scene.bounds.len() as u32);
            let with_moved = expected
                .as_chunks::<2>()
                .0
                .iter()
                .filter(|pair| pair.iter().any(|&body| moved.contains(body)));
            let with_moved: Vec<u32> = with_moved.flatten().copied().collect();
            assert_eq!(
                moved_pairs(&kept, &moved, steps),
                with_moved,
                "seed {seed}, step {step}, kind {kind}"
            );
            assert!(kept.heap_bytes() <= scene.bounds.len() * KEPT_BYTES_PER_BODY + 1000);
        }
    }
    let counts = format!(
        "{kept_steps} kept, {built_steps} built, {loose_steps} with loose bodies, {pairs_found} pairs, {invalid} invalid, {renumbered} renumbered, {stayed} stayed"
    );
    println!("{counts}");
    assert!(kept_steps > 1500 && built_steps > 100 && loose_steps > 500, "{counts}");
    assert!(pairs_found > 300_000 && invalid > 10_000 && renumbered > 300 && stayed > 100_000, "{counts}");
}

/// Catches trees that get worse the longer they are kept: after 2,000 steps of drift and some jumps, a search
/// takes at most twice the steps of one in new trees.
#[test]
fn searches_stay_fast() {
    let mut scene = Changing::new(7, 2000, false);
    let stop = Stop::default();
    let mut kept = BroadPhase::new(scene.bounds.clone(), Rules::default(), &stop).unwrap();
    let drifts: Vec<DVec3> =
        (0..2000).map(|_| scene.random.direction() * scene.random.within(0.0, 0.01)).collect();
    let cost = |broad_phase: &BroadPhase| {
        let stop = Stop::default();
        let mut search = PairSearch::new(0, broad_phase.bodies());
        broad_phase.search(&mut search, u64::MAX, usize::MAX, &stop).unwrap();
        stop.steps()
    };
    let mut worst = 0.0_f64;
    for step in 0..2000 {
        let mut moved = Vec::new();
        for (body, &drift) in drifts.iter().enumerate() {
            // Every other body rests; one in 2,000 jumps.
            if body % 2 == 0 {
                scene.centres[body] += drift;
                if scene.random.below(2000) == 0 {
                    scene.centres[body] = scene.place();
                }
                scene.fit(body, 0.0);
                moved.push(body as u32);
            }
        }
        let new: Vec<_> = moved.iter().map(|&body| scene.bounds[body as usize]).collect();
        kept = kept.moved(&moved, &new, &stop).unwrap();
        if step % 100 == 99 {
            let anew = BroadPhase::new(scene.bounds.clone(), Rules::default(), &stop).unwrap();
            worst = worst.max(cost(&kept) as f64 / cost(&anew) as f64);
        }
    }
    println!("{worst:.2} times the steps");
    assert!(worst < 2.0, "{worst}");
}

/// Catches an update that occupies a thread: each kind of update of the largest scene checks the flag about once
/// per millisecond, and ends once it is stopped.
#[test]
fn updates_are_looked_up_from() {
    let bodies = 131_072_usize;
    let mut scene = Changing::new(8, bodies, false);
    let all: Vec<u32> = (0..bodies as u32).collect();
    let first = BroadPhase::new(scene.bounds.clone(), Rules::default(), &Stop::default()).unwrap();
    let first = first.moved(&[0], &[scene.bounds[0]], &Stop::default()).unwrap();
    assert!(first.kept.is_some());
    let shifted: Vec<_> = (0..bodies)
        .map(|body| {
            scene.shift(body, 0.01);
            scene.bounds[body]
        })
        .collect();
    let stop = Stop::default();
    let moved = first.moved(&all, &shifted, &stop).unwrap();
    assert!(moved.kept.is_some());
    let renumbered = moved.renumbered(&all, shifted.clone(), Rules::default(), &stop).unwrap();
    assert!(renumbered.kept.is_some());
    let same_place = vec![shifted[0]; bodies];
    let built = renumbered.moved(&all, &same_place, &stop).unwrap();
    assert!(built.kept.is_none());
    assert!(stop.largest_between_looks() <= STEPS_BETWEEN_LOOKS, "{stop:?}");
    stop.stop();
    assert!(built.moved(&all, &shifted, &stop).is_err());
    let again = BroadPhase::new(shifted.clone(), Rules::default(), &Stop::default()).unwrap();
    assert!(again.renumbered(&all, shifted, Rules::default(), &stop).is_err());
}

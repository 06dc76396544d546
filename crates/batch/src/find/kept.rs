//! Searches of a scene whose broad phase is kept from step to step.
//!
//! ```text
//! first step:   finder = Finder::new(bodies, rules, ..)
//! later steps:  broad_phase = find::moved(broad_phase, &bodies, moved, ..)        some bodies have moved, or
//!               broad_phase = find::renumbered(broad_phase, &bodies, before, ..)  bodies have come and gone
//!               finder = Finder::kept(bodies, broad_phase, ..)                    all pairs, or
//!               finder = Finder::of_moved(bodies, broad_phase, moved, ..)         those with a moved body
//! after each:   broad_phase = finder.into_broad_phase()
//! ```
//!
//! A body has moved if its pose, hull or motion is another one, or if its hull was missing and is there now, or
//! the reverse. If the time step changes, all bodies with a velocity have moved. The candidates are those of a new
//! [`Finder`], in the same order. After an error the broad phase is gone, and the next step begins with a new
//! [`Finder`].

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex},
};

use hullcast_contact::{STEPS_BETWEEN_LOOKS, Stop, Stopped};

use super::{BOUNDS_STEPS, BoundsWork, Finder, SEARCHED_BODIES, SEARCHES};
use crate::{
    broad_phase::{BroadPhase, KEPT_BYTES_PER_BODY, MovedBodies, MovedSearch, Rules},
    compute::{CallerId, Compute, ComputeError, Job, Parts},
    lock::locked,
    scene::Bodies,
};

/// The most pairs with a moved body that are in memory together. If there are more, all pairs are searched, and
/// those without a moved body are left out.
const MOST_MOVED_PAIRS: usize = 1 << 17;

/// Few enough bodies for one part.
const FEW_BODIES: usize = 512;

/// The broad phase after the bodies `moved` have moved, which are ascending.
///
/// # Errors
/// The job was stopped, or the computation panicked.
pub async fn moved(
    broad_phase: BroadPhase,
    bodies: &Bodies,
    moved: Arc<MovedBodies>,
    compute: &Compute,
    job: &Job<impl CallerId>,
) -> Result<BroadPhase, ComputeError> {
    let count = moved.list().len();
    if count == 0 {
        return Ok(broad_phase);
    }
    let steps = broad_phase.update_steps(count);
    if count <= FEW_BODIES {
        let bodies = bodies.clone();
        let all = move |stop: &Stop| {
            stop.spend(BOUNDS_STEPS * count as u64)?;
            let bounds: Vec<_> = moved.list().iter().map(|&body| bodies.bounds(body)).collect();
            broad_phase.moved(moved.list(), &bounds, stop)
        };
        return Ok(compute.run_steps(BOUNDS_STEPS * count as u64 + steps, all, job).await??);
    }
    let work = BoundsWork { bodies: bodies.clone(), of: Some(moved.clone()), stop: job.stop.clone() };
    let bounds = compute.run_parts(work, job).await?;
    let update = move |stop: &Stop| broad_phase.moved(moved.list(), &bounds, stop);
    Ok(compute.run_steps(steps, update, job).await??)
}

/// The broad phase of other bodies and rules: `before[i]` is the index that body `i` had, or
/// [`NEW_BODY`](crate::broad_phase::NEW_BODY).
///
/// # Errors
/// The job was stopped, or the computation panicked.
pub async fn renumbered(
    broad_phase: BroadPhase,
    bodies: &Bodies,
    before: Vec<u32>,
    rules: Rules,
    compute: &Compute,
    job: &Job<impl CallerId>,
) -> Result<BroadPhase, ComputeError> {
    let steps = broad_phase.update_steps(bodies.count()) + rules.sorting_steps();
    let work = BoundsWork { bodies: bodies.clone(), of: None, stop: job.stop.clone() };
    let bounds = compute.run_parts(work, job).await?;
    let update = move |stop: &Stop| broad_phase.renumbered(&before, bounds, rules, stop);
    Ok(compute.run_steps(steps, update, job).await??)
}

impl Finder {
    /// A search for all pairs, with a broad phase that was kept. It gives at most `most` candidates at a time.
    pub fn kept(bodies: Bodies, broad_phase: BroadPhase, most: usize) -> Self {
        Self::of(bodies, Arc::new(broad_phase), most)
    }

    /// A search for the pairs in which at least one body is in `moved`, with a broad phase that was kept.
    ///
    /// # Errors
    /// The job was stopped, or the computation panicked.
    pub async fn of_moved(
        bodies: Bodies,
        broad_phase: BroadPhase,
        moved: Arc<MovedBodies>,
        most: usize,
        compute: &Compute,
        job: &Job<impl CallerId>,
    ) -> Result<Self, ComputeError> {
        let mut finder = Self::kept(bodies, broad_phase, most);
        match moved_pairs(&finder.broad_phase, &moved, compute, job).await? {
            Some(pairs) => {
                finder.next_body = finder.broad_phase.bodies();
                finder.waiting = pairs.chunks(2 * finder.most).map(<[u32]>::to_vec).collect();
            }
            None => finder.only = Some(moved),
        }
        Ok(finder)
    }

    /// The broad phase, to be kept for the next step; `None` after an error.
    pub fn into_broad_phase(self) -> Option<BroadPhase> {
        Arc::try_unwrap(self.broad_phase).ok()
    }

    /// The most bytes of a broad phase of these bodies that is kept, with its searches and updates.
    pub fn kept_bytes(bodies: &Bodies) -> usize {
        let pairs = 4 * MOST_MOVED_PAIRS * size_of::<u64>();
        let moved = MovedBodies::bytes(bodies.count(), bodies.count());
        Self::bytes(bodies) + bodies.count() * KEPT_BYTES_PER_BODY + moved + pairs
    }
}

/// The pairs with a moved body in ascending order, or `None` if there are too many.
async fn moved_pairs(
    broad_phase: &Arc<BroadPhase>,
    moved: &Arc<MovedBodies>,
    compute: &Compute,
    job: &Job<impl CallerId>,
) -> Result<Option<Vec<u32>>, ComputeError> {
    // With more moved bodies, a search for all pairs takes fewer steps: it finds each pair once.
    if 2 * moved.list().len() > broad_phase.bodies() as usize {
        return Ok(None);
    }
    let count = moved.list().len();
    let (mut open, mut done) = (VecDeque::new(), Vec::new());
    let (mut next, mut pairs) = (0, 0);
    while next < count || !open.is_empty() {
        while next < count && open.len() < SEARCHES as usize {
            let end = count.min(next + SEARCHED_BODIES as usize);
            open.push_back(MovedSearch::new(next, end));
            next = end;
        }
        let before: usize = open.iter().map(MovedSearch::pair_count).sum();
        let more = (MOST_MOVED_PAIRS - pairs) / open.len() + 1;
        let searches = open.drain(..).map(|search| Mutex::new(Some(search))).collect();
        let broad_phase = Mutex::new(Some(broad_phase.clone()));
        let work = MovedWork { broad_phase, moved: moved.clone(), searches, more, stop: job.stop.clone() };
        for search in compute.run_parts(work, job).await? {
            pairs += search.pair_count();
            if search.is_done() { done.push(search) } else { open.push_back(search) }
        }
        pairs -= before;
        if pairs > MOST_MOVED_PAIRS {
            return Ok(None);
        }
    }
    let steps = pairs as u64 * 40;
    Ok(Some(compute.run_steps(steps, move |stop| MovedSearch::pairs(done, stop), job).await??))
}

/// Continues searches for pairs with a moved body; each is one part.
struct MovedWork {
    /// Taken out at the end, so that the owner of the broad phase has it alone again.
    broad_phase: Mutex<Option<Arc<BroadPhase>>>,
    moved: Arc<MovedBodies>,
    searches: Vec<Mutex<Option<MovedSearch>>>,
    /// The number of further pairs after which a part leaves the rest for later.
    more: usize,
    stop: Arc<Stop>,
}

impl Parts for MovedWork {
    type Part = Option<MovedSearch>;
    type Whole = Vec<MovedSearch>;

    fn count(&self) -> usize {
        self.searches.len()
    }

    fn steps(&self, _: usize) -> u64 {
        1_000 * u64::from(SEARCHED_BODIES)
    }

    fn part(&self, index: usize) -> Result<Self::Part, Stopped> {
        let mut search = locked(&self.searches[index]).take();
        let broad_phase = locked(&self.broad_phase).clone();
        if let (Some(search), Some(broad_phase)) = (&mut search, broad_phase) {
            let most = search.pair_count() + self.more;
            broad_phase.search_moved(&self.moved, search, STEPS_BETWEEN_LOOKS, most, &self.stop)?;
        }
        Ok(search)
    }

    fn whole(&self, parts: Vec<Self::Part>) -> Result<Self::Whole, Stopped> {
        drop(locked(&self.broad_phase).take());
        Ok(parts.into_iter().flatten().collect())
    }
}

#[cfg(test)]
mod tests {
    use hullcast_contact::{ConvexHull, workload::Random};

    use super::*;
    use crate::{Missing, Scene, broad_phase::NEW_BODY, wait};

    /// A scene of cubes that move, with margins and velocities, and some missing hulls and unusable poses.
    fn scene(centres: &[[f64; 3]], missing: bool, time_step: f64) -> Bodies {
        let corner = |i: u32| [0, 1, 2].map(|axis| f64::from(i >> axis & 1) - 0.5);
        let cube = Arc::new(ConvexHull::new(&(0..8).map(corner).collect::<Vec<_>>()).unwrap());
        let bodies = centres.len();
        let scene = Scene {
            hulls: vec![Ok(cube.clone()), if missing { Err(Missing::Unknown) } else { Ok(cube) }],
            body_hulls: (0..bodies as u32).map(|body| u32::from(body % 7 == 3)).collect(),
            positions: centres.as_flattened().to_vec(),
            rotations: [0.0, 0.0, 0.0, 1.0].repeat(bodies),
            margin: 0.01,
            margins: (0..bodies).map(|body| 0.01 * (body % 5) as f64).collect(),
            motion: crate::MotionColumns {
                linear_velocities: (0..3 * bodies).map(|i| (i % 11) as f64 - 5.0).collect(),
                time_step,
                ..Default::default()
            },
            ..Scene::default()
        };
        scene.bodies(&Stop::default()).unwrap().0
    }

    fn candidates(finder: &mut Finder, compute: &Compute, job: &Job) -> Vec<Vec<u32>> {
        let mut all = Vec::new();
        while let Some(some) = wait(finder.next(compute, job)).unwrap() {
            all.push(some);
        }
        all
    }

    /// Catches bounds that are not computed again although margin, motion or hull have changed, candidates that
    /// differ from those of a new finder, a broad phase that is lost although nothing failed, and a search of moved
    /// bodies that leaves out a pair, for scenes that are prepared in one part and in many.
    #[test]
    fn a_kept_broad_phase_gives_the_candidates_of_a_new_one() {
        let (compute, job) = (Compute::new(2).unwrap(), Job::new(()));
        let (mut steps, mut found, mut few, mut filtered) = (0, 0, 0, 0);
        for (count, crowded) in [(60, false), (1500, false), (1200, true)] {
            let mut random = Random::new(count);
            let side = if crowded { 2.5 } else { (count as f64).cbrt() };
            let place = |random: &mut Random| [0; 3].map(|_| random.within(0.0, side));
            let mut centres: Vec<[f64; 3]> = (0..count).map(|_| place(&mut random)).collect();
            let bodies = scene(&centres, false, 0.0);
            let finder = wait(Finder::new(bodies, Rules::default(), 4096, &compute, &job)).unwrap();
            let mut broad_phase = finder.into_broad_phase().unwrap();
            let (mut is_missing, mut time_step) = (false, 0.0);
            for step in 0..if crowded { 12 } else { 40 } {
                let all_moved = step % 8 == 5;
                if all_moved {
                    (is_missing, time_step) = (!is_missing, 0.02 - time_step);
                }
                let mut list = Vec::new();
                for (body, centre) in centres.iter_mut().enumerate() {
                    let share = if crowded { 30 } else { 5 };
                    if random.below(100) < [0, share, 60][step % 3] {
                        *centre = match random.below(20) {
                            0 => place(&mut random),
                            1 => [f64::NAN; 3],
                            _ => {
                                centre.map(|x| if x.is_nan() { 0.5 } else { x + random.within(-0.05, 0.05) })
                            }
                        };
                        list.push(body as u32);
                    } else if all_moved {
                        list.push(body as u32);
                    }
                }
                if step % 11 == 10 {
                    let removed = random.below(centres.len());
                    let mut before: Vec<u32> = (0..centres.len() as u32).collect();
                    before.remove(removed);
                    before.push(NEW_BODY);
                    centres.remove(removed);
                    centres.push(place(&mut random));
                    let bodies = scene(&centres, is_missing, time_step);
                    let rules = Rules::default();
                    broad_phase =
                        wait(renumbered(broad_phase, &bodies, before, rules, &compute, &job)).unwrap();
                    list = (0..centres.len() as u32).collect();
                }
                let bodies = scene(&centres, is_missing, time_step);
                let list = Arc::new(MovedBodies::new(list, bodies.count() as u32));
                broad_phase = wait(moved(broad_phase, &bodies, list.clone(), &compute, &job)).unwrap();
                let finder = Finder::new(bodies.clone(), Rules::default(), 4096, &compute, &job);
                let expected = candidates(&mut wait(finder).unwrap(), &compute, &job);
                let mut finder = Finder::kept(bodies.clone(), broad_phase, 4096);
                assert_eq!(candidates(&mut finder, &compute, &job), expected, "{count} bodies, step {step}");
                broad_phase = finder.into_broad_phase().expect("nothing else holds it");
                let finder = Finder::of_moved(bodies, broad_phase, list.clone(), 4096, &compute, &job);
                let mut finder = wait(finder).unwrap();
                if finder.only.is_some() {
                    filtered += 1
                } else {
                    few += 1
                }
                let of_moved = candidates(&mut finder, &compute, &job).concat();
                let with_moved = expected.concat();
                let with_moved = with_moved.as_chunks::<2>().0.iter();
                let with_moved = with_moved.filter(|pair| pair.iter().any(|&body| list.contains(body)));
                let with_moved: Vec<u32> = with_moved.flatten().copied().collect();
                assert_eq!(of_moved, with_moved, "{count} bodies, step {step}");
                broad_phase = finder.into_broad_phase().expect("nothing else holds it");
                found += with_moved.len();
                steps += 1;
            }
        }
        assert!(steps == 92 && found > 100_000 && few > 20 && filtered > 20, "{found} {few} {filtered}");
    }
}

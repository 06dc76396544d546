//! Searches of a scene whose broad phase is kept from step to step.
//!
//! ```text
//! first step:   finder = Finder::new(bodies, rules, ..)
//! later steps:  finder = Finder::of_moved(bodies, broad_phase, moved, ..)             some bodies have moved, or
//!               finder = Finder::renumbered(bodies, broad_phase, before, rules, ..)   bodies have come and gone
//! after each:   broad_phase = finder.into_broad_phase()
//! ```
//!
//! A body has moved if its bounds may have changed ([`BroadPhase::moved`]): its pose, hull, margin or motion is
//! another one, or its hull has become available or unavailable. If the time step changes, all bodies with a
//! velocity have moved. The candidates are those of a new [`Finder`], in the same order. If at most half of the
//! bodies have moved, pairs without a moved body are left out. After an error the broad phase is gone, and the
//! next step begins with a new [`Finder`].
//!
//! The cost of a step in which few bodies have moved is proportional to their number: new bounds, an update of
//! the boxes above them in the tree, a search for the partners of each, and a sort of the pairs. All of it is then
//! one piece of work for the compute threads, because to hand work over costs as much as some hundred bodies.

use std::{collections::VecDeque, sync::Arc};

use hullcast_contact::{STEPS_BETWEEN_LOOKS, Stop, Stopped};

use super::{BOUNDS_STEPS, BoundsWork, Finder, SEARCH_STEPS, SEARCHED_BODIES, SEARCHES, SearchWork};
use crate::{
    broad_phase::{BroadPhase, MovedBodies, MovedSearch, Rules},
    compute::{CallerId, Compute, ComputeError, Job},
    scene::Bodies,
};

/// The most pairs with a moved body that are in memory together. If there are more, all pairs are searched.
const MOST_MOVED_PAIRS: usize = 1 << 17;

/// The steps to sort a pair and write it into the list of candidates.
const ORDER_STEPS: u64 = 40;

/// Up to this number of moved bodies, one part of work updates and searches: to hand work over costs as much as
/// some hundred bodies.
const MOST_IN_ONE_PART: usize = 512;

impl Finder {
    /// A search in a kept broad phase, after the bodies `moved` have moved. It gives at most `most` candidates at a
    /// time. If at most half of the bodies have moved, it gives only pairs with a moved body, and otherwise all
    /// pairs.
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
        let count = moved.list().len();
        // With more moved bodies, a search for all pairs takes fewer steps: it finds each pair once.
        let only_moved = 2 * count <= bodies.count();
        let (broad_phase, progress) = if count <= MOST_IN_ONE_PART {
            let (steps, bodies, moved) = (broad_phase.update_steps(count), bodies.clone(), moved.clone());
            let steps = steps + (BOUNDS_STEPS + SEARCH_STEPS) * count as u64;
            let all = move |stop: &Stop| update_and_search(broad_phase, &bodies, &moved, only_moved, stop);
            compute.run_steps(steps, all, job).await??
        } else {
            let steps = broad_phase.update_steps(count);
            let work = BoundsWork { bodies: bodies.clone(), of: Some(moved.clone()), stop: job.stop.clone() };
            let bounds = compute.run_parts(work, job).await?;
            let moved = moved.clone();
            let update = move |stop: &Stop| broad_phase.moved(moved.list(), &bounds, stop);
            (compute.run_steps(steps, update, job).await??, Progress::NotBegun)
        };
        let mut finder = Self::of(bodies, Arc::new(broad_phase), most);
        if only_moved {
            let broad_phase = &finder.broad_phase;
            let pairs = match progress {
                Progress::NotBegun => moved_pairs(broad_phase, &moved, None, compute, job).await?,
                Progress::Begun(search) => {
                    moved_pairs(broad_phase, &moved, Some(search), compute, job).await?
                }
                Progress::Done(pairs) => Some(pairs),
            };
            if let Some(pairs) = pairs {
                finder.next_body = finder.broad_phase.bodies();
                finder.waiting = pairs.chunks(2 * finder.most).map(<[u32]>::to_vec).collect();
            }
        }
        Ok(finder)
    }

    /// A search in a kept broad phase for all pairs of other bodies, or under other rules. `before[i]` is the index
    /// that body `i` had, or [`NEW_BODY`](crate::broad_phase::NEW_BODY).
    ///
    /// # Errors
    /// The job was stopped, or the computation panicked.
    pub async fn renumbered(
        bodies: Bodies,
        broad_phase: BroadPhase,
        before: Vec<u32>,
        rules: Rules,
        most: usize,
        compute: &Compute,
        job: &Job<impl CallerId>,
    ) -> Result<Self, ComputeError> {
        let steps = broad_phase.update_steps(bodies.count()) + rules.sorting_steps();
        let work = BoundsWork { bodies: bodies.clone(), of: None, stop: job.stop.clone() };
        let bounds = compute.run_parts(work, job).await?;
        let update = move |stop: &Stop| broad_phase.renumbered(&before, bounds, rules, stop);
        let broad_phase = compute.run_steps(steps, update, job).await??;
        Ok(Self::of(bodies, Arc::new(broad_phase), most))
    }

    /// The broad phase.
    pub fn broad_phase(&self) -> &BroadPhase {
        &self.broad_phase
    }

    /// The broad phase, to be kept for the next step; `None` after an error.
    pub fn into_broad_phase(self) -> Option<BroadPhase> {
        Arc::try_unwrap(self.broad_phase).ok()
    }

    /// The most bytes that a search in a kept broad phase takes besides that broad phase, if so many bodies have
    /// moved.
    pub fn kept_bytes(bodies: &Bodies, moved: usize) -> usize {
        let count = bodies.count();
        // The keys of the pairs, a copy while they are sorted, and the candidates with a copy.
        let pairs = MOST_MOVED_PAIRS.min(moved.saturating_mul(count)) * 4 * size_of::<u64>();
        // The list of the moved bodies may be there twice, as indices and as new bounds.
        let moved = MovedBodies::bytes(moved, count) + moved * size_of::<u32>();
        // An update takes no more than a broad phase that is built anew: the loose bodies are at most half of all.
        Self::bytes(bodies) + moved + pairs
    }
}

/// How far a search for the pairs with a moved body has got.
enum Progress {
    NotBegun,
    Begun(MovedSearch),
    /// The search is done; these are the pairs in ascending order.
    Done(Vec<u32>),
}

/// Updates a broad phase after few bodies have moved. With `only_moved`, searches for their pairs too, for about a
/// millisecond.
fn update_and_search(
    broad_phase: BroadPhase,
    bodies: &Bodies,
    moved: &MovedBodies,
    only_moved: bool,
    stop: &Stop,
) -> Result<(BroadPhase, Progress), Stopped> {
    let count = moved.list().len();
    stop.spend(BOUNDS_STEPS * count as u64)?;
    let bounds: Vec<_> = moved.list().iter().map(|&body| bodies.bounds(body)).collect();
    let broad_phase = broad_phase.moved(moved.list(), &bounds, stop)?;
    if !only_moved {
        return Ok((broad_phase, Progress::NotBegun));
    }
    let mut search = MovedSearch::new(0, count);
    broad_phase.search_moved(moved, &mut search, STEPS_BETWEEN_LOOKS, MOST_MOVED_PAIRS, stop)?;
    let progress = if search.is_done() {
        Progress::Done(MovedSearch::pairs([search], stop)?)
    } else {
        Progress::Begun(search)
    };
    Ok((broad_phase, progress))
}

/// The pairs with a moved body in ascending order, or `None` if there are too many. `begun` is a search for the
/// pairs of all moved bodies, if it has begun.
async fn moved_pairs(
    broad_phase: &Arc<BroadPhase>,
    moved: &Arc<MovedBodies>,
    begun: Option<MovedSearch>,
    compute: &Compute,
    job: &Job<impl CallerId>,
) -> Result<Option<Vec<u32>>, ComputeError> {
    let count = moved.list().len();
    let (mut next, mut pairs) = match &begun {
        Some(search) => (count, search.pair_count()),
        None => (0, 0),
    };
    let (mut open, mut done): (VecDeque<_>, _) = (begun.into_iter().collect(), Vec::new());
    while next < count || !open.is_empty() {
        while next < count && open.len() < SEARCHES as usize {
            let end = count.min(next + SEARCHED_BODIES as usize);
            open.push_back(MovedSearch::new(next, end));
            next = end;
        }
        if pairs > MOST_MOVED_PAIRS {
            return Ok(None);
        }
        let before: usize = open.iter().map(MovedSearch::pair_count).sum();
        // The number of further pairs after which a part leaves the rest for later.
        let more = (MOST_MOVED_PAIRS - pairs) / open.len() + 1;
        let moved = moved.clone();
        let advance = move |broad_phase: &BroadPhase, search: &mut MovedSearch, stop: &Stop| {
            let most = search.pair_count() + more;
            broad_phase.search_moved(&moved, search, STEPS_BETWEEN_LOOKS, most, stop)
        };
        let work = SearchWork::new(broad_phase, open.drain(..), &job.stop, advance);
        for search in compute.run_parts(work, job).await? {
            pairs += search.pair_count();
            if search.is_done() { done.push(search) } else { open.push_back(search) }
        }
        pairs -= before;
    }
    if pairs > MOST_MOVED_PAIRS {
        return Ok(None);
    }
    let order = move |stop: &Stop| MovedSearch::pairs(done, stop);
    Ok(Some(compute.run_steps(ORDER_STEPS * pairs as u64, order, job).await??))
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
        let (mut steps, mut found, mut few, mut all) = (0, 0, 0, 0);
        let (mut many_parts, mut too_many) = (0, 0);
        for (count, crowded) in [(60, false), (1500, false), (1200, true), (3000, false)] {
            let mut random = Random::new(count);
            let side = if crowded { 1.5 } else { (count as f64).cbrt() };
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
                    let share = if crowded || count == 3000 { 30 } else { 5 };
                    if random.below(100) < [0, share, 60][step % 3] {
                        *centre = match random.below(20) {
                            0 => place(&mut random),
                            1 => [f64::NAN; 3],
                            _ if centre[0].is_nan() => {
                                if crowded {
                                    [0.5; 3]
                                } else {
                                    place(&mut random)
                                }
                            }
                            _ => centre.map(|x| x + random.within(-0.05, 0.05)),
                        };
                        list.push(body as u32);
                    } else if all_moved {
                        list.push(body as u32);
                    }
                }
                let rules = Rules::default;
                let kept = if step % 11 == 10 {
                    let removed = random.below(centres.len());
                    let mut before: Vec<u32> = (0..centres.len() as u32).collect();
                    before.remove(removed);
                    before.push(NEW_BODY);
                    centres.remove(removed);
                    centres.push(place(&mut random));
                    let bodies = scene(&centres, is_missing, time_step);
                    list = (0..centres.len() as u32).collect();
                    wait(Finder::renumbered(bodies, broad_phase, before, rules(), 4096, &compute, &job))
                } else {
                    let bodies = scene(&centres, is_missing, time_step);
                    let list = Arc::new(MovedBodies::new(list.clone(), bodies.count() as u32));
                    wait(Finder::of_moved(bodies, broad_phase, list, 4096, &compute, &job))
                };
                let mut kept = kept.unwrap();
                let bodies = scene(&centres, is_missing, time_step);
                let anew = Finder::new(bodies.clone(), rules(), 4096, &compute, &job);
                let mut expected = candidates(&mut wait(anew).unwrap(), &compute, &job).concat();
                let list = MovedBodies::new(list, bodies.count() as u32);
                let is_few = kept.next_body == bodies.count() as u32;
                let may_be_few = 2 * list.list().len() <= bodies.count();
                many_parts += usize::from(is_few && list.list().len() > MOST_IN_ONE_PART);
                too_many += usize::from(!is_few && may_be_few);
                if is_few {
                    few += 1;
                    let pairs = expected.as_chunks::<2>().0.iter();
                    let with_moved = pairs.filter(|pair| pair.iter().any(|&body| list.contains(body)));
                    expected = with_moved.flatten().copied().collect();
                } else {
                    all += 1;
                }
                assert!(is_few || 2 * list.list().len() > bodies.count() || crowded, "step {step}");
                let groups = candidates(&mut kept, &compute, &job);
                assert!(groups.iter().all(|group| group.len() <= 2 * 4096));
                assert_eq!(groups.concat(), expected, "{count} bodies, step {step}");
                broad_phase = kept.into_broad_phase().expect("nothing else holds it");
                found += expected.len() / 2;
                steps += 1;
            }
        }
        println!(
            "steps {steps} found {found} few {few} all {all} many_parts {many_parts} too_many {too_many}"
        );
        assert!(steps == 132 && found > 100_000 && few > 20 && all > 20, "{found} {few} {all}");
        assert!(many_parts > 5 && too_many > 0, "{many_parts} {too_many}");
    }
}

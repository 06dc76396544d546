//! Searches a scene for the pairs that may meet.
//!
//! A [`Finder`] gives candidates, some thousand at a time and in ascending order, and continues its search
//! only when they are used up. [`Finder::batch`] makes the batch that computes candidates and keeps those
//! that are not separated.
//!
//! All work is done on the compute threads in parts of about a millisecond: the bounds of the bodies, the
//! tree, and the search, which pauses after a number of steps and continues in the next part. The progress
//! of a part depends on its steps and not on time, so the candidates are the same on every machine.

mod kept;

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex},
};

use hullcast_contact::{Bounds, STEPS_BETWEEN_LOOKS, Stop, Stopped};

use crate::{
    batch::Batch,
    broad_phase::{BroadPhase, MovedBodies, PairSearch, Rules, STEPS_PER_BODY, TREE_BYTES_PER_BODY},
    compute::{CallerId, Compute, ComputeError, Job, Parts},
    lock::locked,
    scene::Bodies,
};

/// The number of bodies whose bounds are computed in one part.
const BOUNDED_BODIES: usize = 256;

/// The estimated steps of a body's bounds: six support mappings.
const BOUNDS_STEPS: u64 = 2_000;

/// The estimated steps to search for the partners of a body in an ordinary scene.
const SEARCH_STEPS: u64 = 1_000;

/// A scene with fewer bodies is prepared in one part.
const SMALL_SCENE: usize = 512;

/// The number of bodies per search, and the number of searches that run before any of their pairs
/// is computed.
const SEARCHED_BODIES: u32 = 64;
const SEARCHES: u32 = 16;

/// The number of found indices after which a part leaves the rest of its bodies for later. It
/// limits the pairs that are found but not computed, however crowded the scene is.
const SEARCHED_INDICES: usize = 1 << 14;

/// A search for the pairs of a scene that may meet.
#[derive(Debug)]
pub struct Finder {
    bodies: Bodies,
    broad_phase: Arc<BroadPhase>,
    /// The most candidates that are given at a time.
    most: usize,
    /// The first body for which no search has been started.
    next_body: u32,
    /// The searches, in order, for the pairs of consecutive bodies before `next_body`.
    searches: VecDeque<PairSearch>,
    /// The pairs found by earlier searches, in order; 2 indices per pair. They come before the
    /// pairs of `searches`.
    found: Vec<u32>,
    /// Ordered candidates, cut into groups that are computed together.
    waiting: VecDeque<Vec<u32>>,
}

impl Finder {
    /// Builds the broad phase of the bodies. The search gives at most `most` candidates at a time.
    ///
    /// # Errors
    /// The job was stopped, or the computation panicked.
    pub async fn new(
        bodies: Bodies,
        rules: Rules,
        most: usize,
        compute: &Compute,
        job: &Job<impl CallerId>,
    ) -> Result<Self, ComputeError> {
        let broad_phase = Arc::new(broad_phase(&bodies, rules, compute, job).await?);
        Ok(Self::of(bodies, broad_phase, most))
    }

    fn of(bodies: Bodies, broad_phase: Arc<BroadPhase>, most: usize) -> Self {
        let (searches, found, waiting) = (VecDeque::new(), Vec::new(), VecDeque::new());
        let most = most.max(1);
        Self { bodies, broad_phase, most, next_body: 0, searches, found, waiting }
    }

    /// The most bytes that the broad phase and the searches of these bodies take.
    pub fn bytes(bodies: &Bodies) -> usize {
        let count = bodies.count();
        let searches = count.div_ceil(SEARCHED_BODIES as usize).min(SEARCHES as usize);
        // A body may have every other body as its partner.
        let search = size_of::<u32>() * (SEARCHED_INDICES + 3 * count);
        count * TREE_BYTES_PER_BODY + searches * search
    }

    /// The batch of some candidates. Its answer has only those that are not separated, and their `pairs`.
    pub fn batch(&self, candidates: Vec<u32>) -> Batch {
        Batch::of_candidates(self.bodies.clone(), candidates)
    }

    /// Whether all candidates have been given.
    pub fn is_done(&self) -> bool {
        let none_left = self.waiting.is_empty() && self.found.is_empty() && self.searches.is_empty();
        none_left && self.next_body >= self.broad_phase.bodies()
    }

    /// Gives candidates back in two halves, because their answer would be too large. Returns false if they
    /// are a single pair, which cannot be cut.
    pub fn split(&mut self, candidates: &[u32]) -> bool {
        if candidates.len() <= 2 {
            return false;
        }
        let (first, second) = candidates.split_at(candidates.len() / 4 * 2);
        self.waiting.push_front(second.to_vec());
        self.waiting.push_front(first.to_vec());
        true
    }

    /// The next candidates, 2 indices per pair, or `None` when all have been given.
    ///
    /// # Errors
    /// The job was stopped, or the computation panicked.
    pub async fn next(
        &mut self,
        compute: &Compute,
        job: &Job<impl CallerId>,
    ) -> Result<Option<Vec<u32>>, ComputeError> {
        while self.waiting.is_empty() {
            let most = 2 * self.most;
            if self.found.len() >= most || (self.searches.is_empty() && !self.found.is_empty()) {
                let found = std::mem::take(&mut self.found);
                // If no search is open, all pairs found. Otherwise as many of them as fill a whole
                // number of groups.
                let whole = if self.searches.is_empty() { found.len() } else { found.len() / most * most };
                let (now, later) = found.split_at(whole);
                self.waiting.extend(now.chunks(most).map(<[u32]>::to_vec));
                self.found = later.to_vec();
                break;
            }
            if self.searches.is_empty() && self.next_body >= self.broad_phase.bodies() {
                break;
            }
            self.search(compute, job).await?;
        }
        Ok(self.waiting.pop_front())
    }

    /// Continues each search by one part.
    async fn search(&mut self, compute: &Compute, job: &Job<impl CallerId>) -> Result<(), ComputeError> {
        if self.searches.is_empty() {
            let bodies = self.broad_phase.bodies();
            for _ in 0..SEARCHES {
                let end = bodies.min(self.next_body.saturating_add(SEARCHED_BODIES));
                if self.next_body < end {
                    self.searches.push_back(PairSearch::new(self.next_body, end));
                }
                self.next_body = end;
            }
        }
        let searches = std::mem::take(&mut self.searches);
        let work = SearchWork::new(&self.broad_phase, searches, &job.stop, |broad_phase, search, stop| {
            broad_phase.search(search, STEPS_BETWEEN_LOOKS, SEARCHED_INDICES, stop)
        });
        self.searches = compute.run_parts(work, job).await?.into();
        while let Some(first) = self.searches.front_mut() {
            self.found.append(&mut first.pairs);
            if !first.is_done() {
                break;
            }
            self.searches.pop_front();
        }
        Ok(())
    }
}

/// Builds the broad phase of a scene.
async fn broad_phase(
    bodies: &Bodies,
    rules: Rules,
    compute: &Compute,
    job: &Job<impl CallerId>,
) -> Result<BroadPhase, ComputeError> {
    let count = bodies.count();
    let building = STEPS_PER_BODY * count as u64 + rules.sorting_steps();
    let built = if count <= SMALL_SCENE {
        let bodies = bodies.clone();
        let all = move |stop: &Stop| {
            stop.spend(BOUNDS_STEPS * count as u64)?;
            BroadPhase::new((0..count as u32).map(|body| bodies.bounds(body)).collect(), rules, stop)
        };
        compute.run_steps(BOUNDS_STEPS * count as u64 + building, all, job).await
    } else {
        let bounding = BoundsWork { bodies: bodies.clone(), of: None, stop: job.stop.clone() };
        let bounds = compute.run_parts(bounding, job).await?;
        compute.run_steps(building, move |stop| BroadPhase::new(bounds, rules, stop), job).await
    };
    Ok(built??)
}

/// Computes the bounds of all bodies or of some, [`BOUNDED_BODIES`] per part.
struct BoundsWork {
    bodies: Bodies,
    /// The bodies; `None` for all.
    of: Option<Arc<MovedBodies>>,
    stop: Arc<Stop>,
}

impl BoundsWork {
    fn body_count(&self) -> usize {
        self.of.as_ref().map_or(self.bodies.count(), |some| some.list().len())
    }
}

impl Parts for BoundsWork {
    type Part = Vec<Option<Bounds>>;
    type Whole = Vec<Option<Bounds>>;

    fn count(&self) -> usize {
        self.body_count().div_ceil(BOUNDED_BODIES)
    }

    fn steps(&self, _: usize) -> u64 {
        BOUNDS_STEPS * BOUNDED_BODIES as u64
    }

    fn part(&self, index: usize) -> Result<Self::Part, Stopped> {
        let first = index * BOUNDED_BODIES;
        let bodies = first..self.body_count().min(first + BOUNDED_BODIES);
        self.stop.spend(BOUNDS_STEPS * bodies.len() as u64)?;
        Ok(match &self.of {
            None => bodies.map(|body| self.bodies.bounds(body as u32)).collect(),
            Some(some) => some.list()[bodies].iter().map(|&body| self.bodies.bounds(body)).collect(),
        })
    }

    fn whole(&self, parts: Vec<Self::Part>) -> Result<Self::Whole, Stopped> {
        Ok(parts.concat())
    }
}

/// Continues searches by `advance`; each is one part.
struct SearchWork<S, A> {
    /// Taken out at the end, so that the owner of the broad phase has it alone again.
    broad_phase: Mutex<Option<Arc<BroadPhase>>>,
    searches: Vec<Mutex<Option<S>>>,
    advance: A,
    stop: Arc<Stop>,
}

impl<S, A> SearchWork<S, A>
where
    A: Fn(&BroadPhase, &mut S, &Stop) -> Result<(), Stopped>,
{
    fn new(
        broad_phase: &Arc<BroadPhase>,
        searches: impl IntoIterator<Item = S>,
        stop: &Arc<Stop>,
        advance: A,
    ) -> Self {
        let searches = searches.into_iter().map(|search| Mutex::new(Some(search))).collect();
        Self { broad_phase: Mutex::new(Some(broad_phase.clone())), searches, advance, stop: stop.clone() }
    }
}

impl<S, A> Parts for SearchWork<S, A>
where
    S: Send + 'static,
    A: Fn(&BroadPhase, &mut S, &Stop) -> Result<(), Stopped> + Send + Sync + 'static,
{
    type Part = Option<S>;
    type Whole = Vec<S>;

    fn count(&self) -> usize {
        self.searches.len()
    }

    /// An estimate for an ordinary scene. It is replaced by the number of steps that the search
    /// counts.
    fn steps(&self, _: usize) -> u64 {
        SEARCH_STEPS * u64::from(SEARCHED_BODIES)
    }

    fn part(&self, index: usize) -> Result<Self::Part, Stopped> {
        let mut search = locked(&self.searches[index]).take();
        let broad_phase = locked(&self.broad_phase).clone();
        if let (Some(search), Some(broad_phase)) = (&mut search, broad_phase) {
            (self.advance)(&broad_phase, search, &self.stop)?;
        }
        Ok(search)
    }

    fn whole(&self, parts: Vec<Self::Part>) -> Result<Self::Whole, Stopped> {
        drop(locked(&self.broad_phase).take());
        Ok(parts.into_iter().flatten().collect())
    }
}

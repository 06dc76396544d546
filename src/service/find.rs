//! `FindContacts`: the broad phase finds candidate pairs, some thousand at a time, and those that
//! are not separated are streamed in order. Pairs are computed only when the caller has read the
//! pairs before them.
//!
//! All work is done on the compute threads in parts of about a millisecond: the bounds of the
//! bodies, the tree, and the search, which pauses after a number of steps and continues in the next
//! part. The progress of a part depends on its steps and not on time, so the messages are the same
//! on every machine.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex},
};

use super::{
    App, Limits, ServiceError,
    admission::Admission,
    answer::{answer, counted_answer},
    batch::Batch,
    context::{CallContext, grow},
    decode::decoded,
    scene::{fetch, missing},
    wire::{self, Columns, Poses, Scene, Setting},
};
use crate::{
    broad_phase::{BroadPhase, Rules, STEPS_PER_BODY, Search, TREE_BYTES_PER_BODY},
    budget::{Part, Permit},
    compute::{ComputeError, Parts},
    contact::{Body, Bounds, STEPS_BETWEEN_LOOKS, Stop, Stopped},
    lock::locked,
    log_limit::limited,
    proto::{Encoded, QueryContactsRequest, QueryContactsResponse},
    store::{Hulls, Lease, Missing},
};

/// The number of candidates that are computed together, and so the most pairs per message. At this
/// size a message costs next to nothing compared with its pairs.
const CANDIDATES: usize = 4096;

/// The number of bodies whose bounds are computed in one part.
const BOUNDED_BODIES: usize = 256;

/// The estimated steps of a body's bounds: six support mappings.
const BOUNDS_STEPS: u64 = 2_000;

/// A scene with fewer bodies is prepared in one part.
const SMALL_SCENE: usize = 512;

/// The number of bodies per search, and the number of searches that run before any of their pairs
/// is computed.
const SEARCHED_BODIES: u32 = 64;
const SEARCHES: u32 = 16;

/// The number of found indices after which a part leaves the rest of its bodies for later. It
/// limits the pairs that are found but not computed, however crowded the scene is.
const SEARCHED_INDICES: usize = 1 << 14;

/// A finite margin that is larger than every distance between bodies, because positions are within
/// 1e100.
const LARGEST_MARGIN: f64 = 1e101;

/// A `FindContacts` call in progress.
pub(super) struct Finding {
    app: Arc<App>,
    context: CallContext,
    request_id: u64,
    bodies: Bodies,
    _lease: Lease,
    /// The memory of the setting, the poses, the broad phase and the searches.
    memory: Option<Permit>,
    broad_phase: Arc<BroadPhase>,
    /// The first body for which no search has been started.
    next_body: u32,
    /// The searches, in order, for the pairs of consecutive bodies before `next_body`.
    searches: VecDeque<Search>,
    /// The pairs found by earlier searches, in order; 2 indices per pair. They come before the
    /// pairs of `searches`.
    found: Vec<u32>,
    /// Ordered candidates, cut into groups that are computed together.
    waiting: VecDeque<Vec<u32>>,
    /// The admission that the call took before any work. `None` after its first use.
    admission: Option<Admission>,
    /// The missing hulls and the unusable bodies, to be sent with the first message.
    left_out: Option<(Vec<u32>, Vec<u32>)>,
}

/// The bodies of a scene.
#[derive(Clone)]
struct Bodies {
    setting: Arc<Setting>,
    hulls: Arc<Hulls>,
    poses: Arc<Poses>,
}

impl Finding {
    /// Checks the request, takes an admission, and builds the tree of the bodies.
    pub(super) async fn begin(
        app: Arc<App>,
        context: CallContext,
        request: Encoded<QueryContactsRequest>,
    ) -> Result<Self, ServiceError> {
        let check = |request, memory, limits: &Limits, stop: &Stop| {
            let (scene, rules) = wire::find(request, limits, stop)?;
            Ok((scene, rules, memory))
        };
        let decoded = decoded(&app, &context, request, check).await?;
        let (setting, bytes) = (decoded.0.setting.clone(), decoded.2.bytes() as usize);
        // The caller may leave while the hulls are read; the scene may be large and must not be
        // freed on this thread.
        let waiting = app.engine().compute_threads().freed_here(decoded, bytes);
        let admission = app.engine().place(most_candidates(&app), &context.job.caller)?;
        let (hulls, lease) = fetch(&app, &setting.hull_ids, &context.job).await?;
        let (scene, rules, mut memory) = waiting.into_inner();
        let Scene { request_id, setting, poses, invalid_bodies, .. } = scene;
        let (hulls, poses) = (Arc::new(hulls), Arc::new(poses));
        // An unavailable hull fails the call: its bodies' pairs are unknown, so no pair could carry
        // the flag.
        if hulls.iter().any(|hull| matches!(hull, Err(Missing::Unavailable))) {
            return Err(super::hulls::unreadable());
        }
        let bodies = Bodies { setting, hulls, poses };
        let sorting = rules.sorting_bytes();
        grow(&app, &mut memory, bodies.searched_bytes() + sorting)?;
        let left_out = Some((missing(&bodies.hulls), invalid_bodies));
        let broad_phase = Arc::new(broad_phase(&app, &context, &bodies, rules).await?);
        memory.shrink_to(memory.bytes() - sorting as u64);
        Ok(Self {
            app,
            context,
            request_id,
            bodies,
            _lease: lease,
            memory: Some(memory),
            broad_phase,
            next_body: 0,
            searches: VecDeque::new(),
            found: Vec::new(),
            waiting: VecDeque::new(),
            admission: Some(admission),
            left_out,
        })
    }

    /// The bytes of the scene's memory.
    pub(super) fn bytes(&self) -> usize {
        self.memory.as_ref().map_or(0, |memory| memory.bytes() as usize)
    }

    /// The next message, or `None` at the end. There is always a first message.
    pub(super) async fn next(&mut self) -> Result<Option<QueryContactsResponse>, ServiceError> {
        while let Some(candidates) = self.candidates().await? {
            match self.answer(&candidates).await {
                Ok(None) => {}
                Ok(answer) => return Ok(answer),
                // Split the answer, as a client would split the request.
                Err(error) if error.reason == "RESPONSE_TOO_LARGE" && candidates.len() > 2 => {
                    let (first, second) = candidates.split_at(candidates.len() / 4 * 2);
                    self.waiting.push_front(second.to_vec());
                    self.waiting.push_front(first.to_vec());
                }
                Err(error) => return Err(error),
            }
        }
        let Some((hulls, bodies)) = self.left_out.take() else { return Ok(None) };
        let response = wire::response(self.request_id, Columns::default(), hulls, bodies);
        Ok(Some(answer(&self.app, &self.context, response).await?))
    }

    /// The answer for the candidates that are not separated, or `None` if all of them are.
    async fn answer(&mut self, candidates: &[u32]) -> Result<Option<QueryContactsResponse>, ServiceError> {
        let (engine, job) = (self.app.engine(), &self.context.job);
        let admission = match self.admission.take() {
            Some(admission) => admission,
            None => engine.next_place(candidates.len() / 2, &job.caller).await,
        };
        let Bodies { setting, hulls, poses } = self.bodies.clone();
        let batch = Batch::of_candidates(hulls, setting, poses, candidates.to_vec());
        let memory = self.context.take(&self.app, Part::Answers, 0)?;
        let (columns, memory) = engine.compute(batch, admission, job, memory).await?;
        if columns.is_empty() {
            return Ok(None);
        }
        let (hulls, bodies) = self.left_out.clone().unwrap_or_default();
        let answer = wire::response(self.request_id, columns, hulls, bodies);
        let answer = counted_answer(&self.app, &self.context, answer, memory).await?;
        self.left_out = None;
        Ok(Some(answer))
    }

    /// The next candidates to be computed together, or `None` when all have been.
    async fn candidates(&mut self) -> Result<Option<Vec<u32>>, ServiceError> {
        while self.waiting.is_empty() {
            let most = 2 * most_candidates(&self.app);
            if self.found.len() >= most || (self.searches.is_empty() && !self.found.is_empty()) {
                let found = std::mem::take(&mut self.found);
                // If no search is open, all pairs found. Otherwise as many of them as fill a whole
                // number of messages.
                let whole = if self.searches.is_empty() { found.len() } else { found.len() / most * most };
                let (now, later) = found.split_at(whole);
                self.waiting.extend(now.chunks(most).map(<[u32]>::to_vec));
                self.found = later.to_vec();
                break;
            }
            if self.searches.is_empty() && self.next_body >= self.broad_phase.bodies() {
                break;
            }
            self.search().await?;
        }
        Ok(self.waiting.pop_front())
    }

    /// Continues each search by one part.
    async fn search(&mut self) -> Result<(), ServiceError> {
        if self.searches.is_empty() {
            let bodies = self.broad_phase.bodies();
            for _ in 0..SEARCHES {
                let end = bodies.min(self.next_body.saturating_add(SEARCHED_BODIES));
                if self.next_body < end {
                    self.searches.push_back(Search::new(self.next_body, end));
                }
                self.next_body = end;
            }
        }
        let searches = std::mem::take(&mut self.searches);
        let searches = searches.into_iter().map(|search| Mutex::new(Some(search))).collect();
        let stop = self.context.job.stop.clone();
        let work = Searching { broad_phase: self.broad_phase.clone(), searches, stop };
        let searched = self.app.engine().compute_threads().split(work, &self.context.job).await;
        self.searches = searched.map_err(failed)?.into();
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

impl Drop for Finding {
    /// Leaves the large parts to a compute thread to free.
    fn drop(&mut self) {
        let broad_phase = std::mem::take(&mut self.broad_phase);
        let poses = std::mem::take(&mut self.bodies.poses);
        let searches = std::mem::take(&mut self.searches);
        self.app.engine().compute_threads().free((broad_phase, poses, searches, self.memory.take()));
    }
}

/// The number of pairs that are computed together.
fn most_candidates(app: &App) -> usize {
    CANDIDATES.min(app.limits().max_pairs_per_request as usize)
}

fn failed(error: ComputeError) -> ServiceError {
    match error {
        ComputeError::Stopped => ServiceError::deadline_exceeded(),
        ComputeError::Panicked(why) => {
            limited!(error, %why, "a broad phase failed");
            ServiceError::internal("the broad phase failed; the server's log has the reason")
        }
    }
}

impl Bodies {
    fn count(&self) -> usize {
        self.setting.body_hulls.len()
    }

    /// The most bytes that the broad phase and the searches take.
    fn searched_bytes(&self) -> usize {
        let searches = self.count().div_ceil(SEARCHED_BODIES as usize).min(SEARCHES as usize);
        // A body may have every other body as its partner.
        let search = size_of::<u32>() * (SEARCHED_INDICES + 3 * self.count());
        self.count() * TREE_BYTES_PER_BODY + searches * search
    }

    /// The bounds of a body, or `None` if it can be in no pair.
    fn bounds(&self, body: usize) -> Option<Bounds> {
        let hull = self.hulls[self.setting.body_hulls[body] as usize].as_ref().ok()?;
        let margin = self.setting.query.margin.min(LARGEST_MARGIN);
        Some(Body::new(hull, self.poses.get(body)?).bounds(margin))
    }
}

/// Builds the broad phase of a scene.
async fn broad_phase(
    app: &App,
    context: &CallContext,
    bodies: &Bodies,
    rules: Rules,
) -> Result<BroadPhase, ServiceError> {
    let (compute, job) = (app.engine().compute_threads(), &context.job);
    let count = bodies.count();
    let building = STEPS_PER_BODY * count as u64 + rules.sorting_steps();
    let built = if count <= SMALL_SCENE {
        let bodies = bodies.clone();
        let all = move |stop: &Stop| {
            stop.spend(BOUNDS_STEPS * count as u64)?;
            BroadPhase::new((0..count).map(|body| bodies.bounds(body)).collect(), rules, stop)
        };
        compute.run_steps(BOUNDS_STEPS * count as u64 + building, all, job).await
    } else {
        let bounding = Bounding { bodies: bodies.clone(), stop: job.stop.clone() };
        let bounds = compute.split(bounding, job).await.map_err(failed)?;
        compute.run_steps(building, move |stop| BroadPhase::new(bounds, rules, stop), job).await
    };
    built.map_err(failed)?.map_err(|stopped| failed(stopped.into()))
}

/// Computes the bounds of all bodies, [`BOUNDED_BODIES`] per part.
struct Bounding {
    bodies: Bodies,
    stop: Arc<Stop>,
}

impl Parts for Bounding {
    type Part = Vec<Option<Bounds>>;
    type Whole = Vec<Option<Bounds>>;

    fn count(&self) -> usize {
        self.bodies.count().div_ceil(BOUNDED_BODIES)
    }

    fn steps(&self, _: usize) -> u64 {
        BOUNDS_STEPS * BOUNDED_BODIES as u64
    }

    fn part(&self, index: usize) -> Result<Self::Part, Stopped> {
        let first = index * BOUNDED_BODIES;
        let bodies = first..self.bodies.count().min(first + BOUNDED_BODIES);
        self.stop.spend(BOUNDS_STEPS * bodies.len() as u64)?;
        Ok(bodies.map(|body| self.bodies.bounds(body)).collect())
    }

    fn whole(&self, parts: Vec<Self::Part>) -> Result<Self::Whole, Stopped> {
        Ok(parts.concat())
    }
}

/// Continues searches; each is one part.
struct Searching {
    broad_phase: Arc<BroadPhase>,
    searches: Vec<Mutex<Option<Search>>>,
    stop: Arc<Stop>,
}

impl Parts for Searching {
    type Part = Option<Search>;
    type Whole = Vec<Search>;

    fn count(&self) -> usize {
        self.searches.len()
    }

    /// An estimate for an ordinary scene. It is replaced by the number of steps that the search
    /// counts.
    fn steps(&self, _: usize) -> u64 {
        1_000 * u64::from(SEARCHED_BODIES)
    }

    fn part(&self, index: usize) -> Result<Self::Part, Stopped> {
        let mut search = locked(&self.searches[index]).take();
        if let Some(search) = &mut search {
            self.broad_phase.search(search, STEPS_BETWEEN_LOOKS, SEARCHED_INDICES, &self.stop)?;
        }
        Ok(search)
    }

    fn whole(&self, parts: Vec<Self::Part>) -> Result<Self::Whole, Stopped> {
        Ok(parts.into_iter().flatten().collect())
    }
}

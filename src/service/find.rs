//! `FindContacts`: the broad phase names candidates, some thousand at a time, and those
//! that are not apart are streamed, sorted. What is not read yet is not computed.

use std::{collections::VecDeque, sync::Arc};

use super::{
    App, Limits, ServiceError,
    admission::Admission,
    batch::Batch,
    contacts::{fetch, missing},
    context::CallContext,
    decode::decoded,
    wire::{self, Columns, Poses, Scene, Setting},
};
use crate::{
    broad_phase::{BroadPhase, Rules},
    budget::Permit,
    compute::{Panicked, Parts},
    contact::{Body, Stop},
    proto::{Encoded, QueryContactsRequest, QueryContactsResponse},
    store::{Hulls, Lease, Missing},
};

/// Candidates that are computed together, and so the most pairs of a message: the size at
/// which a message costs next to nothing beside its pairs.
const CANDIDATES: usize = 4096;

/// Bodies of which a thread looks for the partners at a time: some 100 us.
const BODIES_PER_PART: u32 = 64;

/// Bodies of which the partners are looked for before any of their pairs is computed.
const BODIES_AT_A_TIME: u32 = 1024;

/// Indices after which a thread leaves the rest of its bodies for later, so that what is
/// found and not yet computed stays small however crowded the scene is.
const INDICES_PER_PART: usize = 1 << 14;

/// Beyond every body's reach, and finite: positions are within 1e100.
const LARGEST_MARGIN: f64 = 1e101;

/// A `FindContacts` call under way.
pub(super) struct Finding {
    app: Arc<App>,
    context: CallContext,
    request_id: u64,
    setting: Arc<Setting>,
    hulls: Arc<Hulls>,
    _lease: Lease,
    /// Of the setting, the poses and the rules.
    _memory: Permit,
    poses: Arc<Poses>,
    broad_phase: Arc<BroadPhase>,
    /// Bodies from this one on have not been looked at.
    next_body: u32,
    /// Candidates in order, in parts; 2 indices a pair.
    waiting: VecDeque<Vec<u32>>,
    /// The place that was taken before there was any work, until it is used.
    admission: Option<Admission>,
    /// Sent with the first message: hulls and bodies that are in no pair.
    left_out: Option<(Vec<u32>, Vec<u32>)>,
}

impl Finding {
    /// Checks the request, takes a place, and puts the bodies in a tree.
    pub(super) async fn begin(
        app: Arc<App>,
        context: CallContext,
        request: Encoded<QueryContactsRequest>,
    ) -> Result<Self, ServiceError> {
        let check = |request, memory, limits: &Limits, stop: &Stop| {
            let (scene, rules) = wire::find(request, limits, stop)?;
            Ok((scene, rules, memory))
        };
        let (scene, rules, memory) = decoded(&app, &context, request, check).await?;
        let admission = app.engine().place(most_candidates(&app))?;
        let Scene { request_id, setting, poses, invalid_bodies, .. } = scene;
        let (hulls, lease) = fetch(&app, &setting.hull_ids, &context.job).await?;
        let hulls = Arc::new(hulls);
        // Nothing could be said of its bodies' pairs: there would be none to say it of.
        if hulls.iter().any(|hull| matches!(hull, Err(Missing::Unavailable))) {
            return Err(super::hulls::unreadable());
        }
        let poses = Arc::new(poses);
        let built = app.engine().compute_threads().run({
            let (setting, hulls, poses) = (setting.clone(), hulls.clone(), poses.clone());
            move || broad_phase(&setting, &hulls, &poses, rules)
        });
        let broad_phase = Arc::new(built.await.map_err(panicked)?);
        let left_out = Some((missing(&hulls), invalid_bodies));
        Ok(Self {
            app,
            context,
            request_id,
            setting,
            hulls,
            _lease: lease,
            _memory: memory,
            poses,
            broad_phase,
            next_body: 0,
            waiting: VecDeque::new(),
            admission: Some(admission),
            left_out,
        })
    }

    /// The next pairs; none at the end. The first message always comes.
    pub(super) async fn next(&mut self) -> Result<Option<QueryContactsResponse>, ServiceError> {
        while let Some(candidates) = self.candidates().await? {
            match self.answer(&candidates).await {
                Ok(None) => {}
                Ok(answer) => return Ok(answer),
                // What a client would do.
                Err(error) if error.reason == "RESPONSE_TOO_LARGE" && candidates.len() > 2 => {
                    let (first, second) = candidates.split_at(candidates.len() / 4 * 2);
                    self.waiting.push_front(second.to_vec());
                    self.waiting.push_front(first.to_vec());
                }
                Err(error) => return Err(error),
            }
        }
        let Some((hulls, bodies)) = self.left_out.take() else { return Ok(None) };
        let answer = wire::response(self.request_id, Columns::default(), hulls, bodies);
        Ok(Some(self.app.bounded_answer(&self.context, answer)?.into_inner()))
    }

    /// The candidates that are not apart; none where all are.
    async fn answer(&mut self, candidates: &[u32]) -> Result<Option<QueryContactsResponse>, ServiceError> {
        let admission = match self.admission.take() {
            Some(admission) => admission,
            None => self.app.engine().next_place(candidates.len() / 2).await?,
        };
        let (hulls, setting, poses) = (self.hulls.clone(), self.setting.clone(), self.poses.clone());
        let batch = Batch::of_candidates(hulls, setting, poses, candidates.to_vec());
        let columns = self.app.engine().compute(batch, admission).await?;
        if columns.is_empty() {
            return Ok(None);
        }
        let (hulls, bodies) = self.left_out.clone().unwrap_or_default();
        let answer = wire::response(self.request_id, columns, hulls, bodies);
        let answer = self.app.bounded_answer(&self.context, answer)?;
        self.left_out = None;
        Ok(Some(answer.into_inner()))
    }

    /// Candidates to be computed together; none when all have been.
    async fn candidates(&mut self) -> Result<Option<Vec<u32>>, ServiceError> {
        while self.waiting.is_empty() && self.next_body < self.broad_phase.bodies() {
            self.search().await?;
        }
        Ok(self.waiting.pop_front())
    }

    /// Looks for the partners of the next bodies.
    async fn search(&mut self) -> Result<(), ServiceError> {
        let first = self.next_body;
        let end = self.broad_phase.bodies().min(first.saturating_add(BODIES_AT_A_TIME));
        let search = Search { broad_phase: self.broad_phase.clone(), first, end };
        let Found { pairs, next_body } =
            self.app.engine().compute_threads().split(search).await.map_err(panicked)?;
        self.next_body = next_body;
        self.waiting.extend(pairs.chunks(2 * most_candidates(&self.app)).map(<[u32]>::to_vec));
        Ok(())
    }
}

/// Pairs that are computed together.
fn most_candidates(app: &App) -> usize {
    CANDIDATES.min(app.limits().max_pairs_per_request as usize)
}

fn panicked(why: Panicked) -> ServiceError {
    tracing::error!(%why, "a broad phase failed");
    ServiceError::internal("the broad phase failed")
}

/// The bodies that can be in a pair.
fn broad_phase(setting: &Setting, hulls: &Hulls, poses: &Poses, rules: Rules) -> BroadPhase {
    let margin = setting.query.margin.min(LARGEST_MARGIN);
    let bounds = setting.body_hulls.iter().enumerate().map(|(body, &hull)| {
        let hull = hulls[hull as usize].as_ref().ok()?;
        Some(Body::new(hull, poses.get(body)?).bounds(margin))
    });
    BroadPhase::new(bounds, rules)
}

/// The candidates of bodies `first` to `end`.
struct Search {
    broad_phase: Arc<BroadPhase>,
    first: u32,
    end: u32,
}

/// Candidates in order; 2 indices a pair.
struct Found {
    pairs: Vec<u32>,
    /// The body up to which they are all there.
    next_body: u32,
}

impl Parts for Search {
    type Part = Found;
    type Whole = Found;

    fn count(&self) -> usize {
        (self.end - self.first).div_ceil(BODIES_PER_PART) as usize
    }

    fn part(&self, index: usize) -> Found {
        let mut body = self.first + index as u32 * BODIES_PER_PART;
        let end = self.end.min(body + BODIES_PER_PART);
        let (mut pairs, mut scratch) = (Vec::new(), Vec::new());
        while body < end && pairs.len() < INDICES_PER_PART {
            self.broad_phase.pairs_of(body, &mut pairs, &mut scratch);
            body += 1;
        }
        Found { pairs, next_body: body }
    }

    /// Up to the first part that left some for later: what comes after is looked for again.
    fn whole(&self, parts: Vec<Found>) -> Found {
        let mut found = Found { pairs: Vec::new(), next_body: self.first };
        for (index, part) in (0..).zip(parts) {
            if found.next_body != self.first + index * BODIES_PER_PART {
                break;
            }
            found.pairs.extend_from_slice(&part.pairs);
            found.next_body = part.next_body;
        }
        found
    }
}

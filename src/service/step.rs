//! The answer to one message of a stream.
//!
//! A [`StepAnswer`] has the scene of the message with its hulls, and the [`Step`] that connects it with the message
//! before. Computed columns become messages here: they are matched with the rows before, compared with them, sent,
//! and kept for the next message. [`named`] answers the pairs that a request names, and [`find`] those that the
//! server finds.

pub(super) mod find;
pub(super) mod named;
mod state;

use std::sync::Arc;

use prost::Message as _;

use self::state::Keeping;
pub(super) use self::state::{AnswerBefore, Previous, StepState};
use super::{
    App, ServiceError,
    answer::{answer, counted_answer, kept_answer, too_large},
    context::{CallContext, grow},
    offload::offloaded,
    scene::{lease_for_stream, missing},
    wire::{self, Before, CheckedStep, StepStart},
};
use crate::{
    batch::{
        Columns,
        broad_phase::{BroadPhase, NEW_BODY},
        codes::NO_INDEX,
        scene::Bodies,
        steps::{KeptRows, Presence, Step, StepPairs},
    },
    budget::Permit,
    contact::{Stop, stop::Meter},
    proto::{CONTRACT, QueryContactsResponse},
    store::Lease,
};

/// The bytes of the flags that only the last message of an answer may have.
const LAST_BYTES: usize = 6;

/// The answer to a message of a stream, while it is made.
pub(super) struct StepAnswer {
    app: Arc<App>,
    context: CallContext,
    /// The parts that the next message may take.
    scene: Before,
    request_id: u64,
    missing_hulls: Vec<u32>,
    presence: Presence,
    bodies: Bodies,
    lease: Arc<Lease>,
    step: Option<Arc<Step>>,
    before: Option<AnswerBefore>,
    /// The broad phase that the bodies had before, for a search for pairs.
    broad_phase: Option<BroadPhase>,
    /// For each body, its number in that broad phase; `None` if they have the numbers that they had.
    numbers_before: Option<Vec<u32>>,
    /// The bytes of the broad phase of this answer, and whether there is room to keep it.
    broad_phase_bytes: usize,
    keeps_broad_phase: bool,
    /// Whether the client knows steps, and the answer may be sent as `unchanged`.
    knows_steps: bool,
    /// Whether each row of the answer before goes on; empty if the rows are not matched.
    seen: Vec<bool>,
    keeping: Keeping,
    /// Whether a message was sent.
    has_begun: bool,
    had_ended: bool,
}

/// A message of an answer.
pub(super) enum AnswerPart {
    /// Another message follows.
    More(QueryContactsResponse),
    /// The last message.
    Last(QueryContactsResponse),
    /// The message would be too large. Nothing has changed; fewer pairs may fit.
    TooLarge(ServiceError),
}

impl StepAnswer {
    /// Leases the hulls of a checked message and connects it with the message before, whose state held `earlier`.
    /// `memory` is the memory of the decoded message, and grows by what the connection takes.
    pub(super) async fn begin(
        app: &Arc<App>,
        context: &CallContext,
        checked: CheckedStep,
        mut before: Option<AnswerBefore>,
        earlier: Option<Permit>,
        knows_steps: bool,
        memory: &mut Permit,
    ) -> Result<Self, ServiceError> {
        let CheckedStep { scene, poses, rules, start, .. } = checked;
        let leased = lease_for_stream(app, context, &scene.hull_ids).await?;
        let presence = Presence::of(&leased.hulls);
        let bodies = Bodies::new(scene.template.clone(), leased.hulls.clone(), poses.clone())?;
        let mut broad_phase = before.as_mut().and_then(|before| before.broad_phase.take()).map(|kept| *kept);
        let mut numbers_before = None;
        match &start {
            StepStart::Inherited(_) => {}
            StepStart::Bodies { bodies_now, is_search: true, .. } if broad_phase.is_some() => {
                grow(app, memory, size_of::<u32>() * bodies.count())?;
                let meter = &Meter::new(&context.job.stop);
                numbers_before = Some(numbers(bodies_now, bodies.count(), meter)?);
            }
            _ => drop_broad_phase(app, broad_phase.take()),
        }
        let (step, before) = match before {
            Some(before) => {
                let scene = (&bodies, &presence);
                let connected = connect(app, context, scene, &before, start, knows_steps, memory).await?;
                (connected, Some(before))
            }
            None => (None, None),
        };
        let mut seen = Vec::new();
        if let Some(step) = &step
            && scene.template.outputs().matches
        {
            grow(app, memory, step.rows().len())?;
            seen = vec![false; step.rows().len()];
        }
        Ok(Self {
            app: app.clone(),
            context: context.clone(),
            request_id: scene.request_id,
            missing_hulls: missing(&leased.hulls),
            scene: Before {
                hull_ids: scene.hull_ids,
                template: scene.template,
                rules,
                poses,
                invalid_bodies: scene.invalid_bodies,
            },
            presence,
            bodies,
            lease: leased.lease,
            before: before.filter(|_| step.is_some()),
            broad_phase,
            numbers_before,
            broad_phase_bytes: 0,
            keeps_broad_phase: false,
            step,
            knows_steps,
            seen,
            keeping: Keeping::new(context.state_memory(), earlier),
            has_begun: false,
            had_ended: false,
        })
    }

    /// The answer if it is known to be the answer before, because nothing has changed.
    pub(super) async fn repeated(&mut self) -> Result<Option<QueryContactsResponse>, ServiceError> {
        let Some(step) = &self.step else { return Ok(None) };
        if !(self.may_repeat() && step.repeats() && step.rows().are_settled()) {
            return Ok(None);
        }
        let rows = step.rows().clone();
        let is_kept = self.keep_state(rows.heap_bytes());
        self.keeping.keep_rows(rows);
        let response = self.unchanged(!is_kept);
        answer(&self.app, &self.context, response).await.map(Some)
    }

    /// Makes a message of these columns. `pairs` are the pairs that were computed, if they were found; `memory` is
    /// the memory of the columns. Fewer pairs than there are may come with the last message.
    pub(super) async fn part(
        &mut self,
        columns: Columns,
        pairs: Option<Arc<StepPairs>>,
        mut memory: Permit,
        mut is_last: bool,
    ) -> Result<AnswerPart, ServiceError> {
        let outputs = self.scene.template.outputs();
        let may_repeat = is_last && self.may_repeat();
        let (mut columns, ended, is_same) = self.matched(columns, pairs, is_last, may_repeat).await?;
        if is_same {
            return self.part_unchanged(columns).await;
        }
        grow(&self.app, &mut memory, size_of_val(&ended[..]))?;
        self.had_ended = !ended.is_empty();
        let bytes = columns.heap_bytes() + KeptRows::bytes_besides(columns.len());
        let unsent = columns.take_unsent(outputs);
        let (hulls, bodies) = match self.has_begun {
            true => (Vec::new(), Vec::new()),
            false => (self.missing_hulls.clone(), self.scene.invalid_bodies.clone()),
        };
        let mut response = wire::response(self.request_id, columns, hulls, bodies);
        let limit = self.app.limits().max_message_bytes;
        let length = response.encoded_len() + LAST_BYTES;
        if length > limit {
            return Ok(AnswerPart::TooLarge(too_large(&self.app, length)));
        }
        response.ended_pairs = ended;
        let is_search = self.scene.rules.is_some();
        if is_search && !response.outcomes.is_empty() && response.encoded_len() + LAST_BYTES > limit {
            // The pairs that ended come in a message of their own.
            response.ended_pairs = Vec::new();
            is_last = false;
        }
        response.more = !is_last;
        let is_kept = if is_last {
            self.forget_before();
            self.keep_state(bytes)
        } else {
            self.keeping.take(bytes)
        };
        response.state_dropped = is_last && !is_kept;
        self.has_begun = true;
        let message = if is_kept {
            let (message, mut whole) = kept_answer(&self.app, &self.context, response, memory).await?;
            let mut columns = unsent;
            columns.unite(wire::take_columns(&mut whole));
            self.keeping.push(columns);
            message
        } else {
            counted_answer(&self.app, &self.context, response, memory).await?
        };
        Ok(if is_last { AnswerPart::Last(message) } else { AnswerPart::More(message) })
    }

    /// Makes the only message of an answer that is the answer before.
    async fn part_unchanged(&mut self, columns: Columns) -> Result<AnswerPart, ServiceError> {
        self.had_ended = false;
        self.forget_before();
        let bytes = columns.heap_bytes() + KeptRows::bytes_besides(columns.len());
        let is_kept = self.keep_state(bytes);
        self.keeping.push(columns);
        let response = self.unchanged(!is_kept);
        answer(&self.app, &self.context, response).await.map(AnswerPart::Last)
    }

    fn unchanged(&self, state_dropped: bool) -> QueryContactsResponse {
        let (request_id, contract) = (self.request_id, CONTRACT);
        QueryContactsResponse { request_id, contract, state_dropped, unchanged: true, ..Default::default() }
    }

    /// Whether the answer may be the answer before, as far as anything but its columns is concerned.
    fn may_repeat(&self) -> bool {
        let Some(before) = &self.before else { return false };
        let template = &self.scene.template;
        self.knows_steps
            && !self.has_begun
            && !before.had_ended
            && before.presence == self.presence
            && before.invalid_bodies == self.scene.invalid_bodies
            && before.template.pairs() == template.pairs()
            && before.template.outputs() == template.outputs()
    }

    /// Fills in the matches of columns. With the last columns, returns the pairs that have ended too, and, if the
    /// answer `may_repeat`, whether its columns are those of the answer before. The work is done on the compute
    /// threads if there are many rows.
    async fn matched(
        &mut self,
        mut columns: Columns,
        pairs: Option<Arc<StepPairs>>,
        is_last: bool,
        may_repeat: bool,
    ) -> Result<(Columns, Vec<u32>, bool), ServiceError> {
        let Some(step) = self.step.clone() else { return Ok((columns, Vec::new(), false)) };
        let outputs = self.scene.template.outputs();
        let (bodies, mut seen) = (self.bodies.clone(), std::mem::take(&mut self.seen));
        let steps = if outputs.matches { Step::match_steps(columns.len(), columns.point_count()) } else { 0 };
        let bytes = 2 * steps as usize + seen.len() + if may_repeat { columns.filled_bytes() } else { 0 };
        let work = move |stop: &Stop| {
            let mut ended = Vec::new();
            if outputs.matches {
                step.fill_matches(&bodies, pairs.as_deref(), &mut columns, &mut seen, stop)?;
                if is_last {
                    ended = step.ended_pairs(&seen, stop)?;
                }
            }
            let is_same = may_repeat && ended.is_empty() && columns.is_same(step.rows().columns(), outputs);
            Ok::<_, ServiceError>((columns, seen, ended, is_same))
        };
        let (columns, seen, ended, is_same) = offloaded(&self.app, &self.context, bytes, work).await?;
        self.seen = seen;
        Ok((columns, ended, is_same))
    }

    /// Drops the answer before, which the last message no longer needs. If it is large, another thread frees it.
    fn forget_before(&mut self) {
        let compute = self.app.engine().compute_threads();
        let bytes = self.step.as_ref().map_or(0, |step| step.rows().heap_bytes());
        drop(compute.defer_drop((self.step.take(), self.before.take()), bytes));
        self.seen = Vec::new();
    }

    /// Takes memory for the state that the next message may take: rows of `bytes` bytes, which are the last of the
    /// answer, and the scene. The broad phase is kept if there is room for it too. Returns whether there is room
    /// for the rest.
    fn keep_state(&mut self, bytes: usize) -> bool {
        let is_kept = self.keeping.take_last(bytes + self.scene_bytes());
        self.keeps_broad_phase = is_kept && self.keeping.take_more(self.broad_phase_bytes);
        is_kept
    }

    /// The bytes of the parts of the scene that the next message may take.
    fn scene_bytes(&self) -> usize {
        let Before { hull_ids, template, rules, poses, invalid_bodies } = &self.scene;
        size_of_val(&hull_ids[..])
            + template.heap_bytes()
            + rules.as_ref().map_or(0, |rules| rules.bytes())
            + poses.bytes()
            // The list is kept with the scene and with the answer.
            + 2 * size_of_val(&invalid_bodies[..])
            + self.presence.bytes()
    }

    /// The state for the next message, after the last message of the answer. `broad_phase` is that of the bodies, if
    /// their pairs were found.
    pub(super) async fn finish(self, broad_phase: Option<BroadPhase>) -> Result<Previous, ServiceError> {
        let mut bytes = self.scene_bytes();
        let Self { app, context, scene, presence, keeping, had_ended, .. } = self;
        let broad_phase = if self.keeps_broad_phase {
            bytes += self.broad_phase_bytes;
            broad_phase
        } else {
            drop_broad_phase(&app, broad_phase);
            None
        };
        let Some((rows, mut memory)) = keeping.rows(&app, &context, &scene.template).await? else {
            return Ok(Previous::Dropped);
        };
        // More may have been taken, for example to join the parts of the answer.
        memory.shrink_to((rows.heap_bytes() + bytes) as u64);
        let answer = AnswerBefore {
            template: scene.template.clone(),
            invalid_bodies: scene.invalid_bodies.clone(),
            presence,
            rows,
            had_ended,
            broad_phase: broad_phase.map(Box::new),
        };
        let bytes = memory.bytes() as usize;
        let state = app.engine().compute_threads().defer_drop(StepState { scene, answer }, bytes);
        Ok(Previous::Kept { state, memory })
    }
}

/// Drops a broad phase. If it is large, another thread frees it.
fn drop_broad_phase(app: &App, broad_phase: Option<BroadPhase>) {
    let bytes = broad_phase.as_ref().map_or(0, BroadPhase::heap_bytes);
    drop(app.engine().compute_threads().defer_drop(broad_phase, bytes));
}

/// For each body, the number that it had, or [`NEW_BODY`]. `bodies_now` has the numbers now.
fn numbers(bodies_now: &[u32], bodies: usize, meter: &Meter<'_>) -> Result<Vec<u32>, ServiceError> {
    let mut numbers = vec![NEW_BODY; bodies];
    for (&now, before) in bodies_now.iter().zip(0..) {
        meter.spend(2)?;
        if now != NO_INDEX {
            numbers[now as usize] = before;
        }
    }
    Ok(numbers)
}

/// Connects a message with the message before. `None` if they have nothing in common.
async fn connect(
    app: &App,
    context: &CallContext,
    (bodies, presence): (&Bodies, &Presence),
    before: &AnswerBefore,
    start: StepStart,
    knows_steps: bool,
    memory: &mut Permit,
) -> Result<Option<Arc<Step>>, ServiceError> {
    let (template, rows) = (bodies.template(), before.rows.clone());
    let reuses = knows_steps && before.template.has_options_of(template);
    let meter = || Meter::new(&context.job.stop);
    let step = match start {
        StepStart::Anew => return Ok(None),
        StepStart::Inherited(mut changes) => {
            changes.add_presence(template, &before.presence, presence, None, &meter())?;
            Step::inherited(rows, changes, reuses)
        }
        StepStart::Bodies { mut changes, bodies_now, hulls_before, is_search } => {
            changes.add_presence(template, &before.presence, presence, Some(&hulls_before), &meter())?;
            let bytes = Step::bytes(rows.len(), template.pair_count());
            grow(app, memory, bytes)?;
            let template = template.clone();
            offloaded(app, context, bytes, move |stop| {
                let named = (!is_search).then(|| template.pairs());
                Ok(Step::of_bodies(rows, changes, reuses, &bodies_now, named, stop)?)
            })
            .await?
        }
    };
    Ok(Some(Arc::new(step)))
}

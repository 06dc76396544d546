//! The answer to a message of a stream whose pairs the server finds.
//!
//! Candidates come from the broad phase in order, some thousand at a time, and are merged with the rows of the
//! answer before ([`Walk`]): a pair of which no body has changed takes its row, or is left out if it has none. The
//! rest is computed. If nothing has changed at all, the rows are enough, and nothing is searched.
//!
//! The broad phase is part of the stream's state. It follows the bodies that have changed, or is adapted to other
//! bodies, and gives the candidates that a new one would give: they depend on the bounds and rules of the present
//! bodies only ([`BroadPhase`]). It is left out of the state, and built anew, if there is no room for it.

use std::{collections::VecDeque, sync::Arc};

use super::{AnswerPart, Previous, StepAnswer};
use crate::{
    batch::{
        Batch, Columns, Finder, Missing,
        broad_phase::{BroadPhase, MovedBodies},
        steps::{StepPairs, Walk},
    },
    budget::{Part, Permit},
    compute::DeferredDrop,
    contact::stop::Meter,
    proto::QueryContactsResponse,
    service::{
        Reason, ServiceError,
        admission::Admission,
        context::grow,
        find::{failed, most_candidates},
        hulls::unreadable,
    },
};

/// An answer to a search for pairs in progress.
pub(in crate::service) struct FindStep {
    answer: StepAnswer,
    /// The broad phase with its memory; `None` if the rows of the answer before are enough.
    search: Option<DeferredDrop<(Finder, Permit)>>,
    /// The broad phase of the answer before, if there is no search.
    unsearched: Option<BroadPhase>,
    /// The memory of the scene, if there is no search.
    _memory: Option<Permit>,
    /// Candidates that the search has given, and how many of them were used.
    candidates: (Vec<u32>, usize),
    /// Whether the search has given all candidates.
    is_searched: bool,
    walk: Walk,
    /// Pairs whose answer would be too large together.
    again: VecDeque<StepPairs>,
    /// The admission that the call took before any work. `None` after its first use.
    admission: Option<Admission>,
}

impl FindStep {
    /// Begins the search, unless the rows of the answer before are enough. `memory` is the memory of the decoded
    /// message.
    pub(in crate::service) async fn begin(
        mut answer: StepAnswer,
        admission: Admission,
        mut memory: Permit,
    ) -> Result<Self, ServiceError> {
        // An unavailable hull fails the call: its bodies' pairs are unknown, so no pair could carry the flag.
        if answer.bodies.hulls().iter().any(|hull| matches!(hull, Err(Missing::Unavailable))) {
            return Err(unreadable());
        }
        let is_searched = answer.step.as_ref().is_some_and(|step| step.repeats());
        let broad_phase = answer.broad_phase.take();
        let (search, unsearched, memory) = if is_searched {
            answer.broad_phase_bytes = broad_phase.as_ref().map_or(0, BroadPhase::heap_bytes);
            (None, broad_phase, Some(memory))
        } else {
            let finder = begun(&mut answer, broad_phase, &mut memory).await?;
            answer.broad_phase_bytes = finder.broad_phase().heap_bytes();
            let bytes = memory.bytes() as usize;
            let compute = answer.app.engine().compute_threads();
            (Some(compute.defer_drop((finder, memory), bytes)), None, None)
        };
        Ok(Self {
            answer,
            search,
            unsearched,
            _memory: memory,
            candidates: (Vec::new(), 0),
            is_searched,
            walk: Walk::default(),
            again: VecDeque::new(),
            admission: Some(admission),
        })
    }

    /// The next message, and whether it is the last.
    pub(in crate::service) async fn next(&mut self) -> Result<(QueryContactsResponse, bool), ServiceError> {
        if let Some(response) = self.answer.repeated().await? {
            return Ok((response, true));
        }
        loop {
            let Some(pairs) = self.pairs().await? else {
                let memory = self.answer.context.take(&self.answer.app, Part::Answers, 0)?;
                return match self.answer.part(Columns::default(), None, memory, true).await? {
                    AnswerPart::More(response) => Ok((response, false)),
                    AnswerPart::Last(response) => Ok((response, true)),
                    AnswerPart::TooLarge(error) => Err(error),
                };
            };
            let pairs = Arc::new(pairs);
            let error = match self.computed(pairs.clone()).await {
                Ok((columns, memory)) => {
                    let is_last = self.is_exhausted();
                    if columns.is_empty() && !is_last {
                        continue;
                    }
                    match self.answer.part(columns, Some(pairs.clone()), memory, is_last).await? {
                        AnswerPart::More(response) => return Ok((response, false)),
                        AnswerPart::Last(response) => return Ok((response, true)),
                        AnswerPart::TooLarge(error) => error,
                    }
                }
                Err(error) if error.reason == Reason::ResponseTooLarge => error,
                Err(error) => return Err(error),
            };
            // Split the answer, as a client would split the request.
            let [first, second] = pairs.halves().ok_or(error)?;
            self.again.push_front(second);
            self.again.push_front(first);
        }
    }

    /// The state for the next message, after the last message.
    pub(in crate::service) async fn finish(self) -> Result<Previous, ServiceError> {
        let broad_phase = match self.search {
            Some(search) => search.into_inner().0.into_broad_phase(),
            None => self.unsearched,
        };
        self.answer.finish(broad_phase).await
    }

    async fn computed(&mut self, pairs: Arc<StepPairs>) -> Result<(Columns, Permit), ServiceError> {
        let (app, context) = (&self.answer.app, &self.answer.context);
        let admission = match self.admission.take() {
            Some(admission) => admission,
            None => app.engine().admit_when_free(pairs.len(), &context.job.caller).await,
        };
        let mut batch = Batch::of_step(self.answer.bodies.clone(), pairs, self.answer.step.clone());
        batch.keep_for_steps();
        let memory = context.take(app, Part::Answers, 0)?;
        let (columns, memory) = app.engine().compute(batch, None, admission, &context.job, memory).await?;
        context.note_flags(&columns.flags);
        Ok((columns, memory))
    }

    /// The next pairs to be computed together, or `None` if there are no more.
    async fn pairs(&mut self) -> Result<Option<StepPairs>, ServiceError> {
        if let Some(pairs) = self.again.pop_front() {
            return Ok(Some(pairs));
        }
        let most = most_candidates(&self.answer.app);
        let mut pairs = StepPairs::default();
        while pairs.len() < most && !self.is_exhausted() {
            self.refill().await?;
            let (candidates, used) = &mut self.candidates;
            let left = &candidates[*used..];
            match &self.answer.step {
                Some(step) => {
                    let meter = &Meter::new(&self.answer.context.job.stop);
                    let is_last = self.is_searched;
                    *used += 2 * self.walk.take(step, left, is_last, most, &mut pairs, meter)?;
                }
                None => *used += pairs.extend_anew(left, most),
            }
            if pairs.len() < most && !self.is_exhausted() {
                // Many rows may have passed.
                tokio::task::yield_now().await;
            }
        }
        Ok(Some(pairs).filter(|pairs| !pairs.is_empty()))
    }

    /// Gets the next candidates, if the ones before are used.
    async fn refill(&mut self) -> Result<(), ServiceError> {
        let (candidates, used) = &self.candidates;
        if *used < candidates.len() || self.is_searched {
            return Ok(());
        }
        let (compute, job) = (self.answer.app.engine().compute_threads(), &self.answer.context.job);
        let next = match &mut self.search {
            Some(search) => search.0.next(compute, job).await.map_err(failed)?,
            None => None,
        };
        self.is_searched = next.is_none();
        self.candidates = (next.unwrap_or_default(), 0);
        Ok(())
    }

    /// Whether all pairs have been given.
    fn is_exhausted(&self) -> bool {
        let (candidates, used) = &self.candidates;
        let is_searched = self.is_searched || self.search.as_ref().is_none_or(|search| search.0.is_done());
        let is_walked = self.answer.step.as_ref().is_none_or(|step| self.walk.is_done(step));
        self.again.is_empty() && *used == candidates.len() && is_searched && is_walked
    }
}

/// Begins a search for the pairs of a step: in the broad phase of the answer before, or in a new one. `memory` grows
/// by what the search takes besides that broad phase, which the state of the stream holds.
async fn begun(
    answer: &mut StepAnswer,
    broad_phase: Option<BroadPhase>,
    memory: &mut Permit,
) -> Result<Finder, ServiceError> {
    let numbers_before = answer.numbers_before.take();
    let (app, context, bodies) = (&answer.app, &answer.context, answer.bodies.clone());
    let (compute, job, most) = (app.engine().compute_threads(), &context.job, most_candidates(app));
    let rules = || answer.scene.rules.as_deref().cloned().unwrap_or_default();
    let finder = match (broad_phase, &answer.step, numbers_before) {
        (Some(broad_phase), Some(step), None) => {
            let moved = step.changes().bodies(&Meter::new(&job.stop))?;
            grow(app, memory, Finder::kept_bytes(&bodies, moved.len()))?;
            let moved = Arc::new(MovedBodies::new(moved, bodies.count() as u32));
            Finder::of_moved(bodies, broad_phase, moved, most, compute, job).await
        }
        (Some(broad_phase), Some(_), Some(numbers)) => {
            let rules = rules();
            grow(app, memory, Finder::bytes(&bodies) + rules.bytes() + rules.sorting_bytes())?;
            Finder::renumbered(bodies, broad_phase, numbers, rules, most, compute, job).await
        }
        _ => {
            let rules = rules();
            let sorting = rules.sorting_bytes();
            grow(app, memory, Finder::bytes(&bodies) + rules.bytes() + sorting)?;
            let finder = Finder::new(bodies, rules, most, compute, job).await;
            memory.shrink_to(memory.bytes() - sorting as u64);
            finder
        }
    };
    finder.map_err(failed)
}

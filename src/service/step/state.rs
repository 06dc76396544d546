//! The state that a stream keeps from one message to the next, and its memory.

use std::sync::Arc;

use crate::{
    batch::{
        Columns,
        broad_phase::BroadPhase,
        scene::SceneTemplate,
        steps::{KeptRows, Presence},
    },
    budget::Permit,
    compute::DeferredDrop,
    contact::Stop,
    service::{App, ServiceError, context::CallContext, offload::offloaded, wire::Before},
};

/// The state that a stream keeps from one message to the next.
#[derive(Debug)]
pub(in crate::service) struct StepState {
    /// The parts that the check of the next message needs.
    pub(in crate::service) scene: Before,
    /// The parts that its answer needs.
    pub(in crate::service) answer: AnswerBefore,
}

/// The answer to the message before.
#[derive(Debug)]
pub(in crate::service) struct AnswerBefore {
    pub(super) template: Arc<SceneTemplate>,
    pub(super) invalid_bodies: Vec<u32>,
    pub(super) presence: Presence,
    pub(super) rows: Arc<KeptRows>,
    /// Whether the answer had pairs that ended.
    pub(super) had_ended: bool,
    /// The broad phase of a search for pairs, if there was room for it.
    pub(super) broad_phase: Option<Box<BroadPhase>>,
}

/// The previous message of a stream.
#[derive(Debug)]
pub(in crate::service) enum Previous {
    /// The message is the first of the stream.
    None,
    /// The state of the previous message was not kept, because the budget had no room.
    Dropped,
    /// The state that the next message may inherit.
    Kept { state: DeferredDrop<StepState>, memory: Permit },
}

/// The rows of an answer that are kept while it is sent, with memory for them. If there is no room, nothing is
/// kept.
pub(super) struct Keeping {
    parts: Vec<Columns>,
    /// Rows that are kept as they are.
    rows: Option<Arc<KeptRows>>,
    /// The memory of the parts; `None` if there is no room.
    memory: Option<Permit>,
    /// The memory of the state of the message before, until the last message of the answer.
    earlier: Option<Permit>,
}

impl Keeping {
    /// Nothing is kept yet. `memory` is an empty permit, and `earlier` that of the state of the message before.
    pub(super) fn new(memory: Permit, earlier: Option<Permit>) -> Self {
        Self { parts: Vec::new(), rows: None, memory: Some(memory), earlier }
    }

    /// Takes memory for the next part. Returns whether there is room.
    pub(super) fn take(&mut self, bytes: usize) -> bool {
        let is_kept = self.memory.as_mut().is_some_and(|memory| memory.grow(bytes as u64).is_ok());
        if !is_kept {
            self.parts = Vec::new();
            self.memory = None;
        }
        is_kept
    }

    /// Takes memory for the last part, and for the rest of the state. The state of the message before is no longer
    /// needed, and its memory is free for this one.
    pub(super) fn take_last(&mut self, bytes: usize) -> bool {
        let earlier = self.earlier.take();
        let Some(memory) = &mut self.memory else { return false };
        let so_far = memory.bytes();
        // While several parts are joined, the rows are there twice.
        let joining = if self.parts.is_empty() { 0 } else { so_far + bytes as u64 };
        match earlier {
            // An answer in one message needs no more memory than one state.
            Some(mut earlier) if so_far == 0 => {
                let is_kept = earlier.resize(bytes as u64).is_ok();
                self.memory = is_kept.then_some(earlier);
                is_kept
            }
            earlier => {
                drop(earlier);
                self.take(bytes + joining as usize)
            }
        }
    }

    /// Takes memory for what the next step can do without, after [`Self::take_last`]. Returns whether there is room.
    pub(super) fn take_more(&mut self, bytes: usize) -> bool {
        self.memory.as_mut().is_some_and(|memory| memory.grow(bytes as u64).is_ok())
    }

    /// Keeps the columns of a part, if there is room.
    pub(super) fn push(&mut self, columns: Columns) {
        if self.memory.is_some() {
            self.parts.push(columns);
        }
    }

    /// Keeps rows as they are.
    pub(super) fn keep_rows(&mut self, rows: Arc<KeptRows>) {
        self.rows = Some(rows);
    }

    /// The rows of the whole answer, with at least the memory that they need, or `None` if there was no room.
    pub(super) async fn rows(
        self,
        app: &App,
        context: &CallContext,
        template: &Arc<SceneTemplate>,
    ) -> Result<Option<(Arc<KeptRows>, Permit)>, ServiceError> {
        let Some(memory) = self.memory else { return Ok(None) };
        if let Some(rows) = self.rows {
            return Ok(Some((rows, memory)));
        }
        let (template, mut parts) = (template.clone(), self.parts);
        let is_joined = parts.len() > 1;
        let copied: usize = if is_joined { parts.iter().map(Columns::heap_bytes).sum() } else { 0 };
        let bytes = copied + 4 * parts.iter().map(Columns::len).sum::<usize>();
        let join = move |stop: &Stop| {
            let columns = if is_joined {
                Columns::concatenated(&parts, stop)?
            } else {
                parts.pop().unwrap_or_default()
            };
            Ok::<_, ServiceError>(KeptRows::new(template, columns, stop)?)
        };
        let rows = offloaded(app, context, bytes, join).await?;
        Ok(Some((Arc::new(rows), memory)))
    }
}

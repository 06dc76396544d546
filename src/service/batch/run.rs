//! A batch while it is being computed.

#[cfg(test)]
mod tests;

use std::{
    cell::RefCell,
    ops::Range,
    slice,
    sync::{
        Arc, Mutex, OnceLock,
        atomic::{AtomicUsize, Ordering},
    },
};

use super::{Batch, Engine, chunks::Chunks, engine::Shared};
use crate::{
    budget::{NoMemory, Permit},
    compute::{Job, Parts},
    contact::{Stop, Stopped, Workspace},
    lock::locked,
    service::{admission::Admission, wire::Columns},
    store::Lease,
};

/// The number of chunks' columns that are kept for reuse: those of a large batch.
const SPARE_CHUNKS: usize = 512;

/// The most bytes of a chunk's columns that are kept: about 8 points per pair with every output.
const SPARE_BYTES: usize = 64 << 10;

/// Chunks with fewer bytes in total are joined by the thread that computed the last of them, in
/// about 1 ms.
const LARGE_BYTES: usize = 4 << 20;

/// Steps are counted locally up to this number before they are added to the meter, so that threads
/// do not contend for it.
const GATHERED_STEPS: u64 = 1 << 16;

/// The reason why the rest of a batch is not computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unanswered {
    TooLarge,
    NoMemory(NoMemory),
}

/// The state of a batch while it is computed.
pub(super) struct Run {
    pub(super) batch: Batch,
    pub(super) chunks: Chunks,
    pub(super) unanswered: Arc<OnceLock<Unanswered>>,
    job: Job,
    /// The memory of the columns computed so far.
    memory: Mutex<Option<Permit>>,
    answer_bytes: AtomicUsize,
    shared: Arc<Shared>,
    /// Released with the answer, so that the next request finds the capacity free.
    taken: Mutex<Option<(Admission, Option<Arc<Lease>>)>>,
}

/// The computed chunks of a batch.
pub(super) enum Chunked {
    Answer(Box<(Columns, Permit)>),
    /// The chunks must be joined as separate work.
    Large(Computed),
}

/// The chunks of an answer, in order.
pub(super) struct Computed {
    chunks: Vec<Columns>,
    memory: Permit,
    shared: Arc<Shared>,
}

/// Columns for reuse, so that chunks allocate nothing in the steady state.
#[derive(Debug, Default)]
pub(super) struct Spare(Mutex<Vec<Columns>>);

impl Spare {
    fn take(&self) -> Columns {
        locked(&self.0).pop().unwrap_or_default()
    }

    fn keep(&self, chunks: Vec<Columns>) {
        let mut spare = locked(&self.0);
        let room = SPARE_CHUNKS.saturating_sub(spare.len());
        let small = chunks.into_iter().filter(|columns| columns.heap_bytes() <= SPARE_BYTES);
        spare.extend(small.take(room).map(|mut columns| {
            columns.clear();
            columns
        }));
    }
}

thread_local! {
    static WORKSPACE: RefCell<Workspace> = RefCell::default();
    /// The columns of small batches that the thread computes itself.
    static COLUMNS: RefCell<Columns> = RefCell::default();
}

impl Parts for Run {
    type Part = Columns;
    type Whole = Chunked;

    fn count(&self) -> usize {
        self.chunks.count(self.batch.pair_count())
    }

    fn part(&self, index: usize) -> Result<Columns, Stopped> {
        self.chunk(self.chunks.pairs(index, self.batch.pair_count()))
    }

    fn whole(&self, chunks: Vec<Columns>) -> Result<Chunked, Stopped> {
        let computed = self.computed(chunks)?;
        drop(locked(&self.taken).take());
        if computed.bytes() > LARGE_BYTES {
            return Ok(Chunked::Large(computed));
        }
        Ok(Chunked::Answer(Box::new(computed.concatenated(&self.job.stop)?)))
    }
}

impl Run {
    pub(super) fn new(
        engine: &Engine,
        batch: Batch,
        chunks: Chunks,
        job: &Job,
        memory: Permit,
        taken: (Admission, Option<Arc<Lease>>),
    ) -> Self {
        Self {
            batch,
            chunks,
            unanswered: Arc::default(),
            job: job.clone(),
            memory: Mutex::new(Some(memory)),
            answer_bytes: AtomicUsize::new(0),
            shared: engine.shared().clone(),
            taken: Mutex::new(Some(taken)),
        }
    }

    /// Cuts the batch into chunks by its pairs.
    pub(super) fn cut(mut self, stop: &Stop) -> Result<Self, Stopped> {
        self.chunks = Chunks::by_pairs(&self.batch, stop)?;
        Ok(self)
    }

    /// Computes the whole batch on this thread.
    pub(super) fn inline(&self) -> Result<(Columns, Permit), Stopped> {
        let mut columns = COLUMNS.take();
        let answer = self.fill(0..self.batch.pair_count(), &mut columns).and_then(|()| {
            let mut memory = locked(&self.memory).take().ok_or(Stopped)?;
            let bytes = columns.filled_bytes() as u64;
            memory.grow(bytes).map_err(|why| self.unanswered(Unanswered::NoMemory(why)))?;
            Ok((Columns::concatenated(slice::from_ref(&columns), &self.job.stop)?, memory))
        });
        if columns.heap_bytes() <= SPARE_BYTES {
            columns.clear();
            COLUMNS.set(columns);
        }
        drop(locked(&self.taken).take());
        answer
    }

    fn computed(&self, chunks: Vec<Columns>) -> Result<Computed, Stopped> {
        let memory = locked(&self.memory).take().ok_or(Stopped)?;
        let mut computed = Computed { chunks, memory, shared: self.shared.clone() };
        let bytes = computed.bytes() as u64;
        computed.memory.grow(bytes).map_err(|why| self.unanswered(Unanswered::NoMemory(why)))?;
        Ok(computed)
    }

    /// The columns of these pairs, unless the computation is stopped.
    fn chunk(&self, pairs: Range<usize>) -> Result<Columns, Stopped> {
        let mut columns = self.shared.spare.take();
        self.fill(pairs, &mut columns)?;
        let mut memory = locked(&self.memory);
        let grown = memory.as_mut().map(|memory| memory.grow(columns.heap_bytes() as u64));
        drop(memory);
        if let Some(Err(why)) = grown {
            return Err(self.unanswered(Unanswered::NoMemory(why)));
        }
        Ok(columns)
    }

    /// Fills empty columns with these pairs. Fails if the computation is stopped, or if the answer gets too
    /// large.
    fn fill(&self, pairs: Range<usize>, columns: &mut Columns) -> Result<(), Stopped> {
        self.look()?;
        self.shared.injected.pass(pairs.len());
        // The workspace is taken out while the chunk is computed, so that the thread gets a new one after a
        // panic.
        let mut workspace = WORKSPACE.take();
        let computed = self.pairs(pairs, &mut workspace, columns);
        WORKSPACE.set(workspace);
        computed?;
        let bytes = columns.wire_bytes(self.batch.setting.outputs);
        if self.answer_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes > self.shared.max_answer_bytes {
            return Err(self.unanswered(Unanswered::TooLarge));
        }
        Ok(())
    }

    /// Adds these pairs to `columns`.
    fn pairs(
        &self,
        pairs: Range<usize>,
        workspace: &mut Workspace,
        columns: &mut Columns,
    ) -> Result<(), Stopped> {
        self.shared.pairs_computed.fetch_add(pairs.len() as u64, Ordering::Relaxed);
        let mut steps = 0;
        for pair in pairs {
            steps += self.batch.pair(pair, workspace, columns);
            if steps >= GATHERED_STEPS {
                self.job.stop.spend(std::mem::take(&mut steps))?;
                self.look()?;
            }
        }
        self.job.stop.spend(steps)
    }

    /// Fails if the caller has left, or if the batch cannot be answered any more.
    fn look(&self) -> Result<(), Stopped> {
        let ends = self.job.stop.is_stopped() || self.unanswered.get().is_some();
        if ends { Err(Stopped) } else { Ok(()) }
    }

    fn unanswered(&self, why: Unanswered) -> Stopped {
        // Only the first reason counts.
        let _ = self.unanswered.set(why);
        Stopped
    }
}

impl Computed {
    /// The bytes of all columns together.
    fn bytes(&self) -> usize {
        self.chunks.iter().map(Columns::filled_bytes).sum()
    }

    /// The estimated steps of joining the chunks.
    pub(super) fn steps(&self) -> u64 {
        (self.bytes() / Columns::BYTES_PER_STEP) as u64
    }

    /// The answer. Its permit covers the joined columns; the memory of the chunks is released.
    pub(super) fn concatenated(self, stop: &Stop) -> Result<(Columns, Permit), Stopped> {
        let Self { chunks, mut memory, shared } = self;
        let columns = Columns::concatenated(&chunks, stop)?;
        shared.spare.keep(chunks);
        memory.shrink_to(columns.heap_bytes() as u64);
        Ok((columns, memory))
    }
}

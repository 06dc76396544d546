//! A batch while it is being computed.

use std::{
    cell::RefCell,
    ops::Range,
    slice,
    sync::{
        Arc, Mutex, OnceLock,
        atomic::{AtomicUsize, Ordering},
    },
};

use hullcast_contact::{Stop, Stopped};

use super::{
    chunks::Chunks,
    state::{EngineState, SPARE_BYTES},
};
use crate::{
    batch::{Batch, Workspaces},
    columns::Columns,
    compute::Parts,
    lock::locked,
    memory::Memory,
};

/// Chunks with fewer bytes in total are joined by the thread that computed the last of them, in
/// about 1 ms.
const LARGE_BYTES: usize = 4 << 20;

/// Steps are counted locally up to this number before they are added to the meter, so that threads
/// do not contend for it.
const GATHERED_STEPS: u64 = 1 << 16;

/// The reason why the rest of a batch is not computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unanswered<R> {
    TooLarge,
    NoMemory(R),
}

/// The state of a batch while it is computed. `M` is the memory of its answer, and `H` is held until the
/// answer is complete.
pub(super) struct BatchRun<M: Memory, H> {
    pub(super) batch: Batch,
    pub(super) chunks: Chunks,
    pub(super) unanswered: Arc<OnceLock<Unanswered<M::Refused>>>,
    pub(super) stop: Arc<Stop>,
    /// The memory of the columns computed so far.
    pub(super) memory: Mutex<Option<M>>,
    answer_bytes: AtomicUsize,
    shared: Arc<EngineState>,
    /// Released with the answer, so that the next query finds free what the batch held.
    held: Mutex<Option<H>>,
}

/// The computed chunks of a batch.
pub(super) enum BatchResult<M> {
    Answer(Box<(Columns, M)>),
    /// The chunks must be joined as separate work.
    Large(ComputedChunks<M>),
}

/// The chunks of an answer, in order.
pub(super) struct ComputedChunks<M> {
    chunks: Vec<Columns>,
    memory: M,
    shared: Arc<EngineState>,
}

thread_local! {
    static WORKSPACES: RefCell<Workspaces> = RefCell::default();
    /// The columns of small batches that the thread computes itself.
    static COLUMNS: RefCell<Columns> = RefCell::default();
}

impl<M: Memory, H: Send + 'static> Parts for BatchRun<M, H> {
    type Part = Columns;
    type Whole = BatchResult<M>;

    fn count(&self) -> usize {
        self.chunks.count(self.batch.pair_count())
    }

    fn part(&self, index: usize) -> Result<Columns, Stopped> {
        self.chunk(self.chunks.pairs(index, self.batch.pair_count()))
    }

    fn whole(&self, chunks: Vec<Columns>) -> Result<BatchResult<M>, Stopped> {
        let computed = self.computed(chunks)?;
        drop(locked(&self.held).take());
        if computed.bytes() > LARGE_BYTES {
            return Ok(BatchResult::Large(computed));
        }
        Ok(BatchResult::Answer(Box::new(computed.concatenated(&self.stop)?)))
    }
}

impl<M: Memory, H: Send + 'static> BatchRun<M, H> {
    pub(super) fn new(shared: &Arc<EngineState>, batch: Batch, stop: &Arc<Stop>, memory: M, held: H) -> Self {
        Self {
            chunks: Chunks::of(&batch),
            batch,
            unanswered: Arc::default(),
            stop: stop.clone(),
            memory: Mutex::new(Some(memory)),
            answer_bytes: AtomicUsize::new(0),
            shared: shared.clone(),
            held: Mutex::new(Some(held)),
        }
    }

    /// Cuts the batch into chunks by its pairs.
    pub(super) fn cut(mut self, stop: &Stop) -> Result<Self, Stopped> {
        self.chunks = Chunks::by_pairs(&self.batch, stop)?;
        Ok(self)
    }

    /// Computes the whole batch on this thread.
    pub(super) fn inline(&self) -> Result<(Columns, M), Stopped> {
        let mut columns = COLUMNS.take();
        let answer = self.fill(0..self.batch.pair_count(), &mut columns).and_then(|()| {
            let mut memory = locked(&self.memory).take().ok_or(Stopped)?;
            let bytes = columns.filled_bytes() as u64;
            memory.grow(bytes).map_err(|why| self.unanswered(Unanswered::NoMemory(why)))?;
            Ok((Columns::concatenated(slice::from_ref(&columns), &self.stop)?, memory))
        });
        if columns.heap_bytes() <= SPARE_BYTES {
            columns.clear();
            COLUMNS.set(columns);
        }
        drop(locked(&self.held).take());
        answer
    }

    fn computed(&self, chunks: Vec<Columns>) -> Result<ComputedChunks<M>, Stopped> {
        let memory = locked(&self.memory).take().ok_or(Stopped)?;
        let mut computed = ComputedChunks { chunks, memory, shared: self.shared.clone() };
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
        #[cfg(any(test, feature = "testing"))]
        self.shared.before_chunk(pairs.len());
        // The workspaces are taken out while the chunk is computed, so that the thread gets new ones after a
        // panic.
        let mut workspaces = WORKSPACES.take();
        let computed = self.pairs(pairs, &mut workspaces, columns);
        WORKSPACES.set(workspaces);
        computed?;
        let bytes = columns.wire_bytes(self.batch.bodies.template().outputs());
        if self.answer_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes > self.shared.max_answer_bytes {
            return Err(self.unanswered(Unanswered::TooLarge));
        }
        Ok(())
    }

    /// Adds these pairs to `columns`.
    fn pairs(
        &self,
        pairs: Range<usize>,
        workspaces: &mut Workspaces,
        columns: &mut Columns,
    ) -> Result<(), Stopped> {
        self.shared.pairs_computed.fetch_add(pairs.len() as u64, Ordering::Relaxed);
        let mut steps = 0;
        self.batch.pairs_in_order(pairs, workspaces, columns, |of_pair| {
            steps += of_pair;
            if steps >= GATHERED_STEPS {
                self.stop.spend(std::mem::take(&mut steps))?;
                self.look()?;
            }
            Ok(())
        })?;
        self.stop.spend(steps)
    }

    /// Fails if the caller has left, or if the batch cannot be answered any more.
    fn look(&self) -> Result<(), Stopped> {
        let ends = self.stop.is_stopped() || self.unanswered.get().is_some();
        if ends { Err(Stopped) } else { Ok(()) }
    }

    fn unanswered(&self, why: Unanswered<M::Refused>) -> Stopped {
        // Only the first reason counts.
        let _ = self.unanswered.set(why);
        Stopped
    }
}

impl<M: Memory> ComputedChunks<M> {
    /// The bytes of all columns together.
    fn bytes(&self) -> usize {
        self.chunks.iter().map(Columns::filled_bytes).sum()
    }

    /// The estimated steps of joining the chunks.
    pub(super) fn steps(&self) -> u64 {
        (self.bytes() / Columns::BYTES_PER_STEP) as u64
    }

    /// The answer. Its memory holds the joined columns; that of the chunks is given back.
    pub(super) fn concatenated(self, stop: &Stop) -> Result<(Columns, M), Stopped> {
        let Self { chunks, mut memory, shared } = self;
        let columns = Columns::concatenated(&chunks, stop)?;
        shared.spare.keep(chunks);
        memory.shrink_to(columns.heap_bytes() as u64);
        Ok((columns, memory))
    }
}

//! Computes batches: split over the compute threads, stopped when nobody waits for
//! them, the same bytes however they were split.

use std::{
    cell::RefCell,
    ops::Range,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
    },
    time::Instant,
};

use tracing::Instrument;

use super::Batch;
use crate::{
    compute::{Compute, Panicked, Parts, caught},
    contact::Workspace,
    metrics::Metrics,
    service::{
        admission::{Admission, Room},
        error::ServiceError,
        injected::Injected,
        outputs::Outputs,
        wire::Columns,
    },
    store::Lease,
    trace,
};

/// Batches up to this many pairs are computed where they arrive: handing them to other
/// threads and back was measured to cost 20 to 40 us, as much as computing these.
const INLINE_PAIRS: usize = 32;

/// Pairs between two looks at whether somebody still waits, and the unit that threads
/// share. Some 50 us of boxes: far above the cost of sharing, far below a batch.
const CHUNK_PAIRS: usize = 64;

/// Chunks' columns that are kept to be filled again: those of a large batch.
const SPARE_CHUNKS: usize = 512;

/// A chunk's columns are kept up to this: some 8 points a pair, every output.
const SPARE_BYTES: usize = 64 << 10;

/// Computes batches, so many pairs at a time and no more.
#[derive(Debug)]
pub struct Engine {
    compute: Compute,
    room: Room,
    max_answer_bytes: usize,
    pairs_computed: Arc<AtomicU64>,
    spare: Arc<Spare>,
    metrics: Arc<Metrics>,
    injected: Arc<Injected>,
}

impl Engine {
    /// At most `max_pairs_in_flight` pairs at a time, at most `max_answer_bytes` an answer.
    pub fn new(
        compute: Compute,
        max_pairs_in_flight: u32,
        max_answer_bytes: usize,
        metrics: Arc<Metrics>,
    ) -> Self {
        Self {
            compute,
            room: Room::new(max_pairs_in_flight, metrics.clone()),
            max_answer_bytes,
            pairs_computed: Arc::default(),
            spare: Arc::default(),
            metrics,
            injected: Arc::default(),
        }
    }

    /// For tests of overload.
    #[doc(hidden)]
    pub fn injected(&self) -> &Injected {
        &self.injected
    }

    /// Pairs computed since the start.
    pub fn pairs_computed(&self) -> u64 {
        self.pairs_computed.load(Ordering::Relaxed)
    }

    /// How many threads compute.
    pub fn threads(&self) -> usize {
        self.compute.threads()
    }

    /// Refuses what can be refused before any work: answers too large, a server too busy.
    /// The place that is taken is free again when it is dropped.
    ///
    /// # Errors
    /// RESPONSE_TOO_LARGE, TOO_BUSY.
    pub fn admit(&self, pairs: usize, outputs: Outputs) -> Result<Admission, ServiceError> {
        let least = pairs * outputs.pair_bytes();
        if least > self.max_answer_bytes {
            return Err(too_large(self.max_answer_bytes));
        }
        self.place(pairs)
    }

    /// A place for so many pairs, whatever their answers' size.
    ///
    /// # Errors
    /// TOO_BUSY.
    pub fn place(&self, pairs: usize) -> Result<Admission, ServiceError> {
        self.room.admit(pairs, self.pairs_computed())
    }

    /// The same for the later parts of a call: waits until there is one.
    ///
    /// # Errors
    /// INTERNAL.
    pub async fn next_place(&self, pairs: usize) -> Result<Admission, ServiceError> {
        self.room.next(pairs).await
    }

    /// The threads that compute.
    pub fn compute_threads(&self) -> &Compute {
        &self.compute
    }

    /// The columns of all pairs, in pair order. Dropping the future stops the computation.
    ///
    /// # Errors
    /// RESPONSE_TOO_LARGE as soon as it is known; INTERNAL.
    pub async fn compute(&self, batch: Batch, mut admission: Admission) -> Result<Columns, ServiceError> {
        let pairs = batch.pairs().len() / 2;
        self.room.turn(&mut admission).instrument(trace::queue(pairs)).await;
        let started = Instant::now();
        let run = self.begin(batch, admission);
        let stop = run.stop.clone();
        let _stop_when_dropped = StopOnDrop(stop);
        let computed = match run.pairs() {
            ..=INLINE_PAIRS => trace::compute(pairs).in_scope(|| caught(|| run.inline())),
            _ => self.compute.split(run).instrument(trace::compute(pairs)).await,
        };
        match computed {
            Ok(Some(columns)) => {
                self.metrics.compute_seconds.observe(started.elapsed().as_secs_f64());
                self.metrics.solver_iterations.inc_by(columns.solver_iterations());
                self.metrics.answered(columns.outcome_counts(), columns.flags());
                Ok(columns)
            }
            Ok(None) => Err(too_large(self.max_answer_bytes)),
            Err(Panicked(why)) => {
                tracing::error!(why, "a batch panicked");
                Err(ServiceError::internal("the computation failed"))
            }
        }
    }

    fn begin(&self, mut batch: Batch, admission: Admission) -> Run {
        let taken = (admission, batch.lease.take());
        Run {
            batch,
            stop: Arc::default(),
            answer_bytes: AtomicUsize::new(0),
            max_answer_bytes: self.max_answer_bytes,
            pairs_computed: self.pairs_computed.clone(),
            spare: self.spare.clone(),
            injected: self.injected.clone(),
            taken: Mutex::new(Some(taken)),
        }
    }
}

fn too_large(limit: usize) -> ServiceError {
    ServiceError::refused(
        "RESPONSE_TOO_LARGE",
        format!("the answer would pass {limit} bytes: ask for fewer pairs or outputs"),
    )
}

struct StopOnDrop(Arc<AtomicBool>);

impl Drop for StopOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// A batch being computed.
struct Run {
    batch: Batch,
    /// Nobody waits any more, or the answer is too large already.
    stop: Arc<AtomicBool>,
    answer_bytes: AtomicUsize,
    max_answer_bytes: usize,
    pairs_computed: Arc<AtomicU64>,
    spare: Arc<Spare>,
    injected: Arc<Injected>,
    /// Given back with the answer: whoever asks next finds it free.
    taken: Mutex<Option<(Admission, Option<Lease>)>>,
}

/// Columns to be filled again, so that the steady state allocates none for chunks.
#[derive(Debug, Default)]
struct Spare(Mutex<Vec<Columns>>);

impl Spare {
    fn take(&self) -> Columns {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    fn keep(&self, chunks: Vec<Columns>) {
        let mut spare = self.0.lock().unwrap_or_else(PoisonError::into_inner);
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
}

impl Parts for Run {
    type Part = Columns;
    /// None when the answer is too large or nobody waits.
    type Whole = Option<Columns>;

    fn count(&self) -> usize {
        self.pairs().div_ceil(CHUNK_PAIRS)
    }

    fn part(&self, index: usize) -> Columns {
        let first = index * CHUNK_PAIRS;
        self.chunk(first..self.pairs().min(first + CHUNK_PAIRS), self.spare.take())
    }

    fn whole(&self, chunks: Vec<Columns>) -> Option<Columns> {
        let columns = (!self.stopped()).then(|| Columns::concatenated(&chunks));
        self.spare.keep(chunks);
        drop(self.taken.lock().unwrap_or_else(PoisonError::into_inner).take());
        columns
    }
}

impl Run {
    fn pairs(&self) -> usize {
        self.batch.pairs().len() / 2
    }

    /// Here and now; none when the answer is too large.
    fn inline(&self) -> Option<Columns> {
        self.whole(vec![self.chunk(0..self.pairs(), self.spare.take())])
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Adds these pairs to `columns`, unless nobody waits for them.
    fn chunk(&self, pairs: Range<usize>, mut columns: Columns) -> Columns {
        if self.stopped() {
            return columns;
        }
        self.injected.pass(pairs.len());
        // Taken out for the time of the chunk: one that panics leaves a new one behind.
        let mut workspace = WORKSPACE.take();
        self.pairs_computed.fetch_add(pairs.len() as u64, Ordering::Relaxed);
        for pair in pairs {
            self.batch.pair(pair, &mut workspace, &mut columns);
        }
        WORKSPACE.set(workspace);
        let bytes = columns.wire_bytes(self.batch.setting.outputs);
        if self.answer_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes > self.max_answer_bytes {
            self.stop.store(true, Ordering::Relaxed);
        }
        columns
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        contact::ConvexHull,
        proto::{Output, QueryContactsRequest},
        service::{limits::Limits, wire},
        workload::{Family, Regime, Workload},
    };

    /// Generated pairs, every output asked for.
    fn run(engine: &Engine, regime: Regime, pairs: usize) -> Run {
        let workload = Workload::generate(Family::Poly16, regime, pairs, 1).unwrap();
        let hulls = workload.hulls.iter().map(|points| Ok(Arc::new(ConvexHull::new(points).unwrap())));
        let request = QueryContactsRequest {
            hull_ids: (0..workload.hulls.len() as u8).map(|i| vec![i; 32]).collect(),
            body_hulls: workload.pairs.iter().flat_map(|pair| pair.hulls.map(|hull| hull as u32)).collect(),
            positions: workload.pairs.iter().flat_map(|pair| pair.positions).flatten().collect(),
            rotations: workload.pairs.iter().flat_map(|pair| pair.rotations).flatten().collect(),
            pairs: (0..2 * pairs as u32).collect(),
            outputs: (1..=Output::Diagnostics as i32).collect(),
            margin: 0.01,
            ..Default::default()
        };
        let scene = wire::scene(request, &Limits::default()).unwrap();
        let admission = engine.admit(pairs, scene.setting.outputs).unwrap();
        engine.begin(Batch::new(scene, hulls.collect()).0, admission)
    }

    /// Catches an allocation for every pair, or every chunk of pairs: once buffers have grown,
    /// chunks allocate nothing, and an answer only its columns.
    #[test]
    fn the_steady_state_allocates_nothing_per_pair() {
        let engine = Engine::new(Compute::new(1).unwrap(), 1 << 20, 64 << 20, Arc::default());
        for regime in Regime::ALL {
            for pairs in [1000, 4096] {
                // Again and again: chunks' buffers go round.
                for round in 0..8 {
                    let run = run(&engine, regime, pairs);
                    let mut chunks = Vec::with_capacity(run.count());
                    let made = allocation_counter::measure(|| {
                        chunks.extend((0..run.count()).map(|index| run.part(index)));
                    });
                    assert!(round < 4 || made.count_total == 0, "{regime:?} {pairs}: {made:?}");
                    let made = allocation_counter::measure(|| {
                        assert_eq!(run.whole(chunks).unwrap().len(), pairs);
                    });
                    assert!(made.count_total <= 21, "columns, each once: {made:?}");
                }
            }
        }
        assert!(engine.pairs_computed() > 100_000);
    }
}

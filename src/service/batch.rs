//! Computes a batch of pairs: split over the compute threads, stopped when
//! nobody waits for it, the same bytes however it was split.

use std::{
    cell::RefCell,
    ops::Range,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
    },
    time::Duration,
};

use rayon::iter::{IndexedParallelIterator, IntoParallelIterator, ParallelIterator};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::{
    error::ServiceError,
    outputs::Outputs,
    wire::{Columns, Invalid, Scene, Setting},
};
use crate::{
    compute::{Compute, Panicked, caught},
    contact::{Basis, Body, ConvexHull, Pose, Workspace, contact_manifold},
    store::Missing,
};

/// Batches up to this many pairs are computed where they arrive: handing them to other
/// threads and back was measured to cost 20 to 40 us, as much as computing these.
const INLINE_PAIRS: usize = 32;

/// Pairs between two looks at whether somebody still waits, and the unit that threads
/// share. Some 100 us of boxes: far above the cost of sharing, far below a batch.
const CHUNK_PAIRS: usize = 64;

/// When a server with too much to do asks to be asked again.
const BUSY_RETRY: Duration = Duration::from_millis(20);

/// A batch, ready to compute: checked, its hulls at hand.
#[derive(Debug)]
pub struct Batch {
    /// Pinned for as long as the batch lives.
    hulls: Vec<Result<Arc<ConvexHull>, Missing>>,
    setting: Arc<Setting>,
    /// Per body; none where not usable.
    poses: Vec<Option<Pose>>,
    /// Empty, or 6 per pair: registered indices of vertices, unchecked.
    warm_starts: Vec<u32>,
    /// What is kept of the answers: all that is sent, and perhaps bases.
    kept: Outputs,
}

impl Batch {
    /// A scene with its hulls at hand, and the indices of its bodies that are unusable.
    pub fn new(scene: Scene, hulls: Vec<Result<Arc<ConvexHull>, Missing>>) -> (Self, Vec<u32>) {
        let Scene { setting, poses, warm_starts, invalid_bodies, .. } = scene;
        let kept = setting.outputs;
        (Self { hulls, setting, poses, warm_starts, kept }, invalid_bodies)
    }

    /// Its columns have the bases, whether they are sent or not.
    pub fn keep_bases(&mut self) {
        self.kept.bases = true;
    }
}

/// Computes batches, so many pairs at a time and no more.
#[derive(Debug)]
pub struct Engine {
    compute: Compute,
    in_flight: Arc<Semaphore>,
    max_answer_bytes: usize,
    pairs_computed: Arc<AtomicU64>,
}

impl Engine {
    /// At most `max_pairs_in_flight` pairs at a time, at most `max_answer_bytes` an answer.
    pub fn new(compute: Compute, max_pairs_in_flight: u32, max_answer_bytes: usize) -> Self {
        let in_flight = Arc::new(Semaphore::new(max_pairs_in_flight as usize));
        Self { compute, in_flight, max_answer_bytes, pairs_computed: Arc::default() }
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
        let weight = u32::try_from(pairs.max(1)).unwrap_or(u32::MAX);
        let place = self.in_flight.clone().try_acquire_many_owned(weight);
        place.map(Admission).map_err(|_| {
            ServiceError::unavailable("TOO_BUSY", BUSY_RETRY, "too many pairs are being computed; ask again")
        })
    }

    /// The columns of all pairs, in pair order. Dropping the future stops the computation.
    ///
    /// # Errors
    /// RESPONSE_TOO_LARGE as soon as it is known; INTERNAL.
    pub async fn compute(&self, batch: Batch, admission: Admission) -> Result<Columns, ServiceError> {
        let run = Run {
            batch,
            stop: Arc::default(),
            answer_bytes: AtomicUsize::new(0),
            max_answer_bytes: self.max_answer_bytes,
            pairs_computed: self.pairs_computed.clone(),
        };
        let stop = run.stop.clone();
        let _stop_when_dropped = StopOnDrop(stop);
        let computed = if run.pairs() <= INLINE_PAIRS {
            caught(|| run.inline())
        } else {
            self.compute
                .run(move || {
                    let columns = run.split();
                    drop(admission);
                    columns
                })
                .await
        };
        match computed {
            Ok(Some(columns)) => Ok(columns),
            Ok(None) => Err(too_large(self.max_answer_bytes)),
            Err(Panicked(why)) => {
                tracing::error!(why, "a batch panicked");
                Err(ServiceError::internal("the computation failed"))
            }
        }
    }
}

fn too_large(limit: usize) -> ServiceError {
    ServiceError::refused(
        "RESPONSE_TOO_LARGE",
        format!("the answer would pass {limit} bytes: ask for fewer pairs or outputs"),
    )
}

/// A place among the pairs in flight.
#[derive(Debug)]
pub struct Admission(#[expect(dead_code, reason = "held for its drop")] OwnedSemaphorePermit);

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
}

thread_local! {
    static WORKSPACE: RefCell<Workspace> = RefCell::default();
}

impl Run {
    fn pairs(&self) -> usize {
        self.batch.setting.pair_count()
    }

    /// Here and now; none when the answer is too large.
    fn inline(&self) -> Option<Columns> {
        let columns = self.chunk(0..self.pairs());
        (!self.stopped()).then_some(columns)
    }

    /// Over all threads of the pool that this runs in; none when the answer is too large
    /// or nobody waits.
    fn split(&self) -> Option<Columns> {
        let pairs = self.pairs();
        let parts: Vec<Columns> = (0..pairs.div_ceil(CHUNK_PAIRS))
            .into_par_iter()
            .with_max_len(1)
            .map(|i| self.chunk(i * CHUNK_PAIRS..pairs.min((i + 1) * CHUNK_PAIRS)))
            .collect();
        (!self.stopped()).then(|| Columns::concatenated(parts, self.batch.kept))
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn chunk(&self, pairs: Range<usize>) -> Columns {
        if self.stopped() {
            return Columns::default();
        }
        let mut columns = Columns::with_capacity(pairs.len(), self.batch.kept);
        // Taken out for the time of the chunk: one that panics leaves a new one behind.
        let mut workspace = WORKSPACE.take();
        for pair in pairs {
            self.batch.pair(pair, &mut workspace, &mut columns);
        }
        WORKSPACE.set(workspace);
        self.pairs_computed.fetch_add(columns.len() as u64, Ordering::Relaxed);
        let bytes = columns.wire_bytes(self.batch.setting.outputs);
        if self.answer_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes > self.max_answer_bytes {
            self.stop.store(true, Ordering::Relaxed);
        }
        columns
    }
}

impl Batch {
    /// Computes pair `pair` and adds it to `columns`.
    fn pair(&self, pair: usize, workspace: &mut Workspace, columns: &mut Columns) {
        let mut invalid = Invalid::default();
        let [a, b] = [0, 1].map(|side| self.body(self.setting.pairs[2 * pair + side], &mut invalid));
        match (a, b) {
            (Some(a), Some(b)) => {
                let warm = self.warm_start(pair, &a, &b);
                let manifold = contact_manifold(&a, &b, &self.setting.query, warm.as_ref(), workspace);
                columns.push(manifold, self.kept);
            }
            _ => columns.push_invalid(invalid, self.kept),
        }
    }

    fn body(&self, index: u32, invalid: &mut Invalid) -> Option<Body<'_>> {
        let index = index as usize;
        let hull = match &self.hulls[self.setting.body_hulls[index] as usize] {
            Ok(hull) => Some(hull),
            Err(missing) => {
                invalid.hull(*missing);
                None
            }
        };
        let pose = self.poses[index];
        if pose.is_none() {
            invalid.body();
        }
        Some(Body::new(hull?, pose?))
    }

    /// An earlier basis; one that names no vertices of these hulls is none.
    fn warm_start(&self, pair: usize, a: &Body<'_>, b: &Body<'_>) -> Option<Basis> {
        let (bases, _) = self.warm_starts.as_chunks::<6>();
        let &[a0, a1, a2, b0, b1, b2] = bases.get(pair)?;
        let basis = Basis { a: [a0, a1, a2], b: [b0, b1, b2] };
        let of = |vertices: [u32; 3], body: &Body<'_>| {
            vertices.iter().all(|&vertex| (vertex as usize) < body.hull.registered_count())
        };
        (of(basis.a, a) && of(basis.b, b)).then_some(basis)
    }
}

//! The compute threads. They are separate from the threads of the async runtime, so that a long
//! computation never keeps the server from answering a short one.
//!
//! Work comes in parts that take about a millisecond at most. Threads take parts in turns: first
//! between callers, in equal shares of the cost of their parts ([`schedule`]), then between the pieces
//! of work of one caller:
//!
//! ```text
//! caller 1:  work a  [a0 a1 a2 a3 ...]  \
//!            work b  [b0 b1]             >  turns:  a0 c0 b0 c1 a1 c2 b1 a2 ...  ->  threads
//! caller 2:  work c  [c0 c1 c2]         /
//! ```
//!
//! Work with longer parts, such as building a large hull, has threads of its own that run at a
//! lower priority, so that it never delays short parts.
//!
//! Work ends early if its [`Job`] is stopped, or if the future that waits for it is dropped. Its
//! parts then leave the queue, and a compute thread frees its memory before it begins another part.
//!
//! This is our own code, because thread pools such as rayon run work in the order that suits their threads:
//! they know no callers, and waiting work cannot be withdrawn from them.

mod queue;
mod schedule;
#[cfg(test)]
mod tests;
mod work;

use std::{
    any::Any,
    fmt, io,
    ops::{Deref, DerefMut},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    thread,
};

use hullcast_contact::{STEPS_BETWEEN_LOOKS, Stop, Stopped};
use thiserror::Error;
use tokio::sync::oneshot;

use self::{queue::WorkQueue, work::SharedWork};
use crate::lock::locked;

/// Work with a part of more estimated steps than this runs on the threads for long parts. The value
/// is about 4 ms.
const LONG_STEPS: u64 = 4 * STEPS_BETWEEN_LOOKS;

/// The nice value of the threads for short parts. Serving threads have 0, which is a higher priority,
/// so the system runs a serving thread first.
const NICE: i32 = 5;
/// The nice value of the threads for long parts.
const NICE_OF_LONG: i32 = 10;

/// A pool of compute threads. The threads end when the last clone of this handle is dropped.
#[derive(Clone, Debug)]
pub struct Compute {
    pool: Arc<ComputePool>,
}

/// A caller for whom work is done. The threads take turns between callers.
pub trait CallerId: Clone + Send + Sync + 'static {
    /// A number that no other living caller has.
    fn id(&self) -> u64;
}

/// The caller of a process that has no others.
impl CallerId for () {
    fn id(&self) -> u64 {
        0
    }
}

/// The caller that asked for work, and the flag that stops it. Several pieces of work can share a
/// job.
#[derive(Clone, Debug)]
pub struct Job<C = ()> {
    /// The caller that is charged for the work, and whose turns the work takes.
    pub caller: C,
    /// Counts the steps of the work. It is stopped when no caller waits for the work any more.
    pub stop: Arc<Stop>,
    /// The number of steps of `stop` that the caller has been charged for.
    charged: Arc<AtomicU64>,
}

impl<C> Job<C> {
    /// A job of `caller` with a new stop flag.
    pub fn new(caller: C) -> Self {
        Self { caller, stop: Arc::default(), charged: Arc::default() }
    }

    /// The number of steps counted since the last call. Each step is returned once, whichever threads
    /// call.
    fn take_uncharged(&self) -> u64 {
        let steps = self.stop.steps();
        steps.saturating_sub(self.charged.fetch_max(steps, Ordering::Relaxed))
    }
}

/// Work that is divided into parts. Any thread may do any part, in any order and at any time.
pub trait Parts: Send + Sync + 'static {
    /// The result of a part.
    type Part: Send;
    /// The result of all parts together.
    type Whole: Send;

    /// The number of parts.
    fn count(&self) -> usize;

    /// The estimated number of steps of part `index`.
    fn steps(&self, _index: usize) -> u64 {
        STEPS_BETWEEN_LOOKS
    }

    /// Does part `index`. The part counts its steps in the [`Stop`] of the work's job.
    ///
    /// # Errors
    /// The job was stopped.
    fn part(&self, index: usize) -> Result<Self::Part, Stopped>;

    /// Combines the results of all parts, which are given in order.
    ///
    /// # Errors
    /// The job was stopped.
    fn whole(&self, parts: Vec<Self::Part>) -> Result<Self::Whole, Stopped>;
}

/// The computation panicked, with this message. A panic is a bug, and it ends only its own call.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("panicked: {0}")]
pub struct Panicked(pub String);

/// The reason why work has no result.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ComputeError {
    /// The work's job was stopped.
    #[error("{}", Stopped)]
    Stopped,
    /// The work panicked.
    #[error(transparent)]
    Panicked(Panicked),
}

impl From<Stopped> for ComputeError {
    fn from(_: Stopped) -> Self {
        Self::Stopped
    }
}

impl From<Panicked> for ComputeError {
    fn from(panicked: Panicked) -> Self {
        Self::Panicked(panicked)
    }
}

impl Compute {
    /// Starts `threads` threads for short parts and as many for long parts. 0 means one per core.
    ///
    /// # Errors
    /// The system refused to start a thread.
    pub fn new(threads: usize) -> io::Result<Self> {
        let threads = match threads {
            0 => thread::available_parallelism().map_or(1, usize::from),
            threads => threads,
        };
        let pool = ComputePool { short: Arc::default(), long: Arc::default(), threads };
        // If a thread cannot be started, `compute` is dropped, and the threads that started end.
        let compute = Self { pool: Arc::new(pool) };
        let kinds = [("compute", NICE, &compute.pool.short), ("long", NICE_OF_LONG, &compute.pool.long)];
        for (name, nice, queue) in kinds {
            for i in 0..threads {
                let queue = queue.clone();
                let run = move || {
                    lower_priority(nice);
                    queue.work();
                };
                thread::Builder::new().name(format!("{name}-{i}")).spawn(run)?;
            }
        }
        Ok(compute)
    }

    /// The number of threads for short parts.
    pub fn threads(&self) -> usize {
        self.pool.threads
    }

    /// Runs `work` as one part, which should take a few milliseconds at most.
    ///
    /// # Errors
    /// The work panicked, or was stopped before it began.
    pub async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Stop) -> T + Send + 'static,
        job: &Job<impl CallerId>,
    ) -> Result<T, ComputeError> {
        self.run_steps(STEPS_BETWEEN_LOOKS, work, job).await
    }

    /// Runs `work` as one part of about `steps` steps. If it is long, the work should check the stop
    /// flag that it is given.
    ///
    /// # Errors
    /// The work panicked, or was stopped before it began.
    pub async fn run_steps<T: Send + 'static>(
        &self,
        steps: u64,
        work: impl FnOnce(&Stop) -> T + Send + 'static,
        job: &Job<impl CallerId>,
    ) -> Result<T, ComputeError> {
        let piece = SinglePart { work: Mutex::new(Some(work)), steps, stop: job.stop.clone() };
        let whole = self.run_parts(piece, job).await?;
        whole.ok_or_else(|| Panicked("the work was done before".into()).into())
    }

    /// Does `work` in parts, on all threads that are free. If the future is dropped, the parts that
    /// have not begun are never done.
    ///
    /// # Errors
    /// A part panicked, or the job was stopped.
    pub async fn run_parts<W: Parts>(
        &self,
        work: W,
        job: &Job<impl CallerId>,
    ) -> Result<W::Whole, ComputeError> {
        let (send, receive) = oneshot::channel();
        let count = work.count();
        let is_long = (0..count).any(|index| work.steps(index) > LONG_STEPS);
        let queue = if is_long { &self.pool.long } else { &self.pool.short };
        let work = Arc::new(SharedWork::new(work, count, job, send));
        let _removed_when_dropped = match count {
            0 => {
                work.finish(Ok(Vec::new()));
                None
            }
            _ => Some(queue.push(work, count)),
        };
        let dropped = || Err(Panicked("the threads dropped the work".into()).into());
        receive.await.unwrap_or_else(|_| dropped())
    }

    /// Frees a value on a compute thread. Returning much memory to the system takes milliseconds, in
    /// which a thread that serves calls could not serve any.
    pub fn free(&self, value: impl Send + 'static) {
        self.pool.short.free(Box::new(value));
    }

    /// Wraps a value of about `bytes` bytes, so that a compute thread frees it if it is large.
    pub fn defer_drop<T: Send + 'static>(&self, value: T, bytes: usize) -> DeferredDrop<T> {
        DeferredDrop { value: Some(value), compute: (bytes > LARGE_BYTES).then(|| self.clone()) }
    }
}

/// Work on more bytes than this runs on the compute threads, and so does freeing them. Work on fewer
/// bytes takes at most about a millisecond, and a thread that serves calls may do it.
pub const LARGE_BYTES: usize = 256 << 10;

/// A value that a compute thread frees if it is large; see [`Compute::free`].
#[derive(Debug)]
pub struct DeferredDrop<T: Send + 'static> {
    /// `None` only while the wrapper is dropped or unwrapped.
    value: Option<T>,
    /// The threads that free the value if it is large.
    compute: Option<Compute>,
}

impl<T: Send + 'static> DeferredDrop<T> {
    /// Unwraps the value. Its new owner then frees it.
    pub fn into_inner(mut self) -> T {
        self.value.take().unwrap_or_else(|| unreachable!("a value is taken once"))
    }
}

impl<T: Send + 'static> Deref for DeferredDrop<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.value.as_ref().unwrap_or_else(|| unreachable!("a value that is taken is not used"))
    }
}

impl<T: Send + 'static> DerefMut for DeferredDrop<T> {
    fn deref_mut(&mut self) -> &mut T {
        self.value.as_mut().unwrap_or_else(|| unreachable!("a value that is taken is not used"))
    }
}

impl<T: Send + 'static> Drop for DeferredDrop<T> {
    fn drop(&mut self) {
        if let (Some(value), Some(compute)) = (self.value.take(), &self.compute) {
            compute.free(value);
        }
    }
}

/// Lowers the priority of the calling thread, so that the system prefers the serving threads. If the
/// system cannot do that, the thread keeps the priority of the process.
fn lower_priority(nice: i32) {
    // On Linux the call changes the calling thread, on other systems the whole process.
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::setpriority_process(None, nice) {
        tracing::debug!(%error, nice, "compute threads keep the priority of the process");
    }
    #[cfg(not(target_os = "linux"))]
    let _ = nice;
}

/// A closure as work with one part.
struct SinglePart<F> {
    work: Mutex<Option<F>>,
    steps: u64,
    stop: Arc<Stop>,
}

impl<T: Send + 'static, F: FnOnce(&Stop) -> T + Send + 'static> Parts for SinglePart<F> {
    type Part = Option<T>;
    type Whole = Option<T>;

    fn count(&self) -> usize {
        1
    }

    fn steps(&self, _: usize) -> u64 {
        self.steps
    }

    fn part(&self, _: usize) -> Result<Option<T>, Stopped> {
        let work = locked(&self.work).take();
        Ok(work.map(|work| work(&self.stop)))
    }

    fn whole(&self, parts: Vec<Option<T>>) -> Result<Option<T>, Stopped> {
        Ok(parts.into_iter().next().flatten())
    }
}

struct ComputePool {
    short: Arc<WorkQueue>,
    long: Arc<WorkQueue>,
    threads: usize,
}

impl fmt::Debug for ComputePool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ComputePool").field("threads", &self.threads).finish_non_exhaustive()
    }
}

impl Drop for ComputePool {
    fn drop(&mut self) {
        for queue in [&self.short, &self.long] {
            queue.close();
        }
    }
}

/// Runs `work` on the calling thread and catches a panic.
///
/// # Errors
/// The work panicked.
pub fn catch_panic<T>(work: impl FnOnce() -> T) -> Result<T, Panicked> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|payload| Panicked(panic_message(&*payload)))
}

/// The message of a panic.
fn panic_message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".into())
}

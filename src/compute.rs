//! The threads that compute, beside the async runtime's threads, so that a long computation
//! never keeps the server from answering a short one.
//!
//! Work comes in parts of about a millisecond at most. Threads take parts in turns: first
//! between callers, by what their parts cost ([`turns`]), then between one caller's pieces of
//! work. Work whose parts take longer, such as building a large hull, has threads of its own
//! that run at a lower priority, so that it never delays short parts.
//!
//! Work ends early when its [`Job`] is stopped, or when the future that waits for it is dropped.
//! Its parts then leave the queue, and a compute thread frees its memory before it begins
//! another part.

mod turns;

use std::{
    any::Any,
    fmt, io,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    thread,
};

use tokio::sync::oneshot;

use self::turns::{Taken, Turn, Turns};
use crate::{
    budget::Caller,
    contact::{STEPS_BETWEEN_LOOKS, Stop, Stopped},
};

/// Work with a part of more estimated steps than this has the threads of long parts: about 4 ms.
const LONG_STEPS: u64 = 4 * STEPS_BETWEEN_LOOKS;

/// What a part costs at least: a thread's way to it and back.
const LEAST_STEPS: u64 = 2_000;

/// The nice values of the threads: below the threads that serve, which have 0, so that the
/// system runs a serving thread first.
const NICE: i32 = 5;
const NICE_OF_LONG: i32 = 10;

/// Threads for computation; they end when the last clone is dropped.
#[derive(Clone, Debug)]
pub struct Compute {
    pool: Arc<Pool>,
}

/// Who asked for work, and how to stop it. Threads take turns between callers.
#[derive(Clone, Debug)]
pub struct Job {
    /// Whose turn is used.
    pub caller: Caller,
    /// Set when nobody waits for the work any more.
    pub stop: Arc<Stop>,
    /// The steps of `stop` that the caller was charged with.
    charged: Arc<AtomicU64>,
}

impl Job {
    /// Work for `caller`, with a flag of its own.
    pub fn new(caller: Caller) -> Self {
        Self { caller, stop: Arc::default(), charged: Arc::default() }
    }

    /// The steps that were counted since the last call: each step once, whichever threads call.
    fn take_uncharged(&self) -> u64 {
        let steps = self.stop.steps();
        steps.saturating_sub(self.charged.fetch_max(steps, Ordering::Relaxed))
    }
}

/// Work in parts that any threads do in any order, at any time.
pub trait Parts: Send + Sync + 'static {
    /// What a part gives.
    type Part: Send;
    /// What all parts together give.
    type Whole: Send;

    /// How many parts there are.
    fn count(&self) -> usize;

    /// The estimated steps of part `index`.
    fn steps(&self, _index: usize) -> u64 {
        STEPS_BETWEEN_LOOKS
    }

    /// Does part `index`. The part counts its steps with the stop flag of the work's job.
    ///
    /// # Errors
    /// The job was stopped.
    fn part(&self, index: usize) -> Result<Self::Part, Stopped>;

    /// Puts the parts together, in order.
    ///
    /// # Errors
    /// The job was stopped.
    fn whole(&self, parts: Vec<Self::Part>) -> Result<Self::Whole, Stopped>;
}

/// The computation panicked: a bug that ends its own call alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Panicked(pub String);

impl fmt::Display for Panicked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "panicked: {}", self.0)
    }
}

/// Why work has no result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ComputeError {
    /// The work's job was stopped.
    Stopped,
    /// The work panicked.
    Panicked(Panicked),
}

impl fmt::Display for ComputeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stopped => Stopped.fmt(f),
            Self::Panicked(panicked) => panicked.fmt(f),
        }
    }
}

impl std::error::Error for ComputeError {}

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
    /// Starts `threads` threads, and as many for long parts; 0: one for each core.
    ///
    /// # Errors
    /// The system has no more threads.
    pub fn new(threads: usize) -> io::Result<Self> {
        let threads = match threads {
            0 => thread::available_parallelism().map_or(1, usize::from),
            threads => threads,
        };
        let pool = Pool { short: Arc::default(), long: Arc::default(), threads };
        // Dropped on failure: the threads that started end.
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

    /// How many threads compute short parts.
    pub fn threads(&self) -> usize {
        self.pool.threads
    }

    /// Does `work` in one piece of a few milliseconds at most.
    ///
    /// # Errors
    /// The work panicked, or was stopped before it began.
    pub async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Stop) -> T + Send + 'static,
        job: &Job,
    ) -> Result<T, ComputeError> {
        self.run_steps(STEPS_BETWEEN_LOOKS, work, job).await
    }

    /// Does `work` in one piece of about `steps` steps, which looks at the stop flag while it
    /// goes on.
    ///
    /// # Errors
    /// The work panicked, or was stopped before it began.
    pub async fn run_steps<T: Send + 'static>(
        &self,
        steps: u64,
        work: impl FnOnce(&Stop) -> T + Send + 'static,
        job: &Job,
    ) -> Result<T, ComputeError> {
        let piece = Piece { work: Mutex::new(Some(work)), steps, stop: job.stop.clone() };
        let whole = self.split(piece, job).await?;
        whole.ok_or_else(|| Panicked("the work was done before".into()).into())
    }

    /// Does `work` in parts, on all threads that are free. Dropping the future ends the work.
    ///
    /// # Errors
    /// A part panicked, or the job was stopped.
    pub async fn split<W: Parts>(&self, work: W, job: &Job) -> Result<W::Whole, ComputeError> {
        let (send, receive) = oneshot::channel();
        let count = work.count();
        let is_long = (0..count).any(|index| work.steps(index) > LONG_STEPS);
        let queue = if is_long { &self.pool.long } else { &self.pool.short };
        let done = Done { left: count, parts: (0..count).map(|_| None).collect(), answer: Some(send) };
        let work = Arc::new(Shared { work, job: job.clone(), done: Mutex::new(done) });
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

    /// Has a compute thread free a value: giving much memory back to the system takes
    /// milliseconds, in which a thread that serves calls would serve none.
    pub fn free(&self, value: impl Send + 'static) {
        self.pool.short.free(Box::new(value));
    }
}

/// The system runs this thread after those that serve. Where it cannot, all are alike.
fn lower_priority(nice: i32) {
    // On Linux the call is about the calling thread, elsewhere about the whole process.
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::setpriority_process(None, nice) {
        tracing::debug!(%error, nice, "compute threads keep the priority of the process");
    }
    #[cfg(not(target_os = "linux"))]
    let _ = nice;
}

/// A closure as work of one part.
struct Piece<F> {
    work: Mutex<Option<F>>,
    steps: u64,
    stop: Arc<Stop>,
}

impl<T: Send + 'static, F: FnOnce(&Stop) -> T + Send + 'static> Parts for Piece<F> {
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

/// Work and what is done of it.
struct Shared<W: Parts> {
    work: W,
    job: Job,
    done: Mutex<Done<W>>,
}

struct Done<W: Parts> {
    left: usize,
    parts: Vec<Option<W::Part>>,
    /// None once answered.
    answer: Option<oneshot::Sender<Result<W::Whole, ComputeError>>>,
}

/// Work of any kind, as the threads see it.
trait Work: Send + Sync {
    fn job(&self) -> &Job;

    /// The estimated steps of a part.
    fn steps(&self, index: usize) -> u64;

    /// Does a part; the last one answers.
    fn part(&self, index: usize);

    /// Answers that the work was stopped.
    fn stopped(&self);
}

impl<W: Parts> Work for Shared<W> {
    fn job(&self) -> &Job {
        &self.job
    }

    fn steps(&self, index: usize) -> u64 {
        self.work.steps(index).max(LEAST_STEPS)
    }

    fn part(&self, index: usize) {
        let part = caught(|| self.work.part(index));
        let mut done = locked(&self.done);
        match part.map_err(ComputeError::from).and_then(|part| part.map_err(ComputeError::from)) {
            Err(error) => {
                drop(done);
                self.finish(Err(error));
            }
            Ok(part) => {
                done.parts[index] = Some(part);
                done.left -= 1;
                if done.left == 0 {
                    let parts = std::mem::take(&mut done.parts);
                    drop(done);
                    self.finish(Ok(parts.into_iter().flatten().collect()));
                }
            }
        }
    }

    fn stopped(&self) {
        self.finish(Err(ComputeError::Stopped));
    }
}

impl<W: Parts> Shared<W> {
    fn finish(&self, parts: Result<Vec<W::Part>, ComputeError>) {
        let awaited = locked(&self.done).answer.as_ref().is_some_and(|answer| !answer.is_closed());
        if !awaited {
            return;
        }
        let whole = parts.and_then(|parts| Ok(caught(|| self.work.whole(parts))??));
        let answer = locked(&self.done).answer.take();
        // The waiter may be gone: nothing is left to do then.
        let _ = answer.map(|answer| answer.send(whole));
    }
}

/// Parts that wait for the threads of one kind.
#[derive(Default)]
struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    turns: Turns<Arc<dyn Work>>,
    /// What a thread is to free before it begins another part.
    freed: Vec<Box<dyn Send>>,
    closed: bool,
}

/// What a thread does next.
enum Next {
    Part(Turn<Arc<dyn Work>>),
    Free(Vec<Box<dyn Send>>),
    /// Work that was stopped before a part of it began.
    Stopped(Arc<dyn Work>),
}

impl Queue {
    /// Queues work until it is done or the result is dropped.
    fn push(self: &Arc<Self>, work: Arc<dyn Work>, count: usize) -> Queued {
        let caller = work.job().caller.id();
        let number = locked(&self.state).turns.push(caller, work, count);
        match count {
            1 => self.changed.notify_one(),
            _ => self.changed.notify_all(),
        }
        Queued { queue: self.clone(), caller, number }
    }

    fn free(&self, value: Box<dyn Send>) {
        let mut state = locked(&self.state);
        if state.closed {
            // Freed here, after the lock.
            drop(state);
            return;
        }
        state.freed.push(value);
        drop(state);
        self.changed.notify_one();
    }

    /// Does parts until closed.
    fn work(&self) {
        while let Some(next) = self.next() {
            match next {
                Next::Part(turn) => {
                    turn.work.part(turn.index);
                    self.done(turn);
                }
                Next::Free(freed) => drop(freed),
                Next::Stopped(work) => work.stopped(),
            }
        }
    }

    /// The next part of the work whose turn it is; none when closed.
    fn next(&self) -> Option<Next> {
        let mut state = locked(&self.state);
        loop {
            if state.closed {
                return None;
            }
            if !state.freed.is_empty() {
                return Some(Next::Free(std::mem::take(&mut state.freed)));
            }
            let is_stopped = |work: &Arc<dyn Work>| work.job().stop.is_stopped();
            match state.turns.take(is_stopped, |work, index| work.steps(index)) {
                Some(Taken::Part(turn)) => return Some(Next::Part(turn)),
                Some(Taken::Stopped(work)) => return Some(Next::Stopped(work)),
                None => state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
            }
        }
    }

    /// Charges the caller of a part with what it cost.
    fn done(&self, turn: Turn<Arc<dyn Work>>) {
        let Turn { work, caller, estimate, .. } = turn;
        let metered = match work.job().take_uncharged() {
            0 => estimate,
            metered => metered.max(LEAST_STEPS),
        };
        locked(&self.state).turns.done(caller, estimate, metered);
        // The last reference may go here, outside the lock.
        drop(work);
    }
}

/// Work in a queue; dropped, it leaves the queue and its memory is freed.
struct Queued {
    queue: Arc<Queue>,
    caller: u64,
    number: u64,
}

impl Drop for Queued {
    fn drop(&mut self) {
        let removed = locked(&self.queue.state).turns.remove(self.caller, self.number);
        if let Some(work) = removed {
            self.queue.free(Box::new(work));
        }
    }
}

struct Pool {
    short: Arc<Queue>,
    long: Arc<Queue>,
    threads: usize,
}

impl fmt::Debug for Pool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pool").field("threads", &self.threads).finish_non_exhaustive()
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        for queue in [&self.short, &self.long] {
            let mut state = locked(&queue.state);
            state.closed = true;
            // Whoever waits for the work hears that it was dropped.
            let (works, freed) = (state.turns.clear(), std::mem::take(&mut state.freed));
            drop(state);
            drop((works, freed));
            queue.changed.notify_all();
        }
    }
}

/// No panic leaves what is locked here half done.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// `work`, here and now, its panic caught.
///
/// # Errors
/// It panicked.
pub fn caught<T>(work: impl FnOnce() -> T) -> Result<T, Panicked> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|payload| Panicked(text(&*payload)))
}

fn text(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".into())
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

    use super::*;

    fn job() -> Job {
        Job::new(Caller::alone())
    }

    /// Catches a bug in one call's computation that takes the process with it, or a thread.
    #[tokio::test]
    async fn a_panic_is_an_error_of_its_own_call() {
        let compute = Compute::new(2).unwrap();
        for _ in 0..10 {
            let failed = compute.run(|_| -> u32 { panic!("on purpose") }, &job()).await;
            assert_eq!(failed, Err(ComputeError::Panicked(Panicked("on purpose".into()))));
            assert_eq!(compute.run(|_| 7, &job()).await, Ok(7));
        }
    }

    /// Parts that number themselves, while they are not `held`.
    struct Numbers {
        count: usize,
        fails_at: Option<usize>,
        begun: Arc<AtomicUsize>,
        held: Arc<AtomicBool>,
    }

    fn wait_while(held: &AtomicBool) {
        while held.load(Ordering::SeqCst) {
            thread::yield_now();
        }
    }

    impl Parts for Numbers {
        type Part = usize;
        type Whole = Vec<usize>;

        fn count(&self) -> usize {
            self.count
        }

        fn part(&self, index: usize) -> Result<usize, Stopped> {
            self.begun.fetch_add(1, Ordering::SeqCst);
            wait_while(&self.held);
            assert_ne!(Some(index), self.fails_at, "on purpose");
            Ok(index)
        }

        fn whole(&self, parts: Vec<usize>) -> Result<Vec<usize>, Stopped> {
            Ok(parts)
        }
    }

    fn numbers(count: usize) -> Numbers {
        Numbers { count, fails_at: None, begun: Arc::default(), held: Arc::default() }
    }

    /// Catches parts lost, doubled or out of order, none at all, and a part's panic that is
    /// not heard of, or heard of while others of its kind go on.
    #[tokio::test]
    async fn parts_come_back_in_order() {
        for threads in [1, 2, 7] {
            let compute = Compute::new(threads).unwrap();
            assert_eq!(compute.threads(), threads);
            for count in [0, 1, 2, 3, 100, 1001] {
                assert_eq!(compute.split(numbers(count), &job()).await, Ok((0..count).collect()));
            }
            let failing = Numbers { fails_at: Some(50), ..numbers(100) };
            let failed = compute.split(failing, &job()).await.unwrap_err();
            assert!(failed.to_string().contains("on purpose"), "{failed}");
        }
    }

    /// Parts that say when their turn was.
    struct Turns {
        count: usize,
        turn: Arc<AtomicUsize>,
        held: Arc<AtomicBool>,
    }

    impl Parts for Turns {
        type Part = usize;
        type Whole = Vec<usize>;

        fn count(&self) -> usize {
            self.count
        }

        fn part(&self, _: usize) -> Result<usize, Stopped> {
            let turn = self.turn.fetch_add(1, Ordering::SeqCst);
            wait_while(&self.held);
            Ok(turn)
        }

        fn whole(&self, parts: Vec<usize>) -> Result<Vec<usize>, Stopped> {
            Ok(parts)
        }
    }

    /// Catches work that waits for all of the work before it: what comes while a long one is
    /// under way takes turns with it.
    #[tokio::test]
    async fn short_work_does_not_wait_for_long_work() {
        let compute = Compute::new(1).unwrap();
        let (turn, held) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicBool::new(true)));
        let turns = |count| Turns { count, turn: turn.clone(), held: held.clone() };
        let (one, other) = (job(), job());
        let mut long = Box::pin(compute.split(turns(1000), &one));
        assert!(futures_util::poll!(long.as_mut()).is_pending());
        while turn.load(Ordering::SeqCst) == 0 {
            thread::yield_now();
        }
        // Polled once: it is under way before the long one goes on.
        let mut short = Box::pin(compute.split(turns(2), &other));
        assert!(futures_util::poll!(short.as_mut()).is_pending());
        held.store(false, Ordering::SeqCst);
        assert_eq!(short.await, Ok(vec![2, 4]));
        assert_eq!(long.await.unwrap().len(), 1000);
    }

    /// Catches threads that outlive their owner, and work that nobody waits for any more.
    #[tokio::test]
    async fn dropping_the_threads_ends_them() {
        let compute = Compute::new(1).unwrap();
        let long = numbers(1000);
        let (held, begun) = (long.held.clone(), long.begun.clone());
        held.store(true, Ordering::SeqCst);
        let mut waiting = Box::pin({
            let compute = compute.clone();
            async move { compute.split(long, &job()).await }
        });
        assert!(futures_util::poll!(waiting.as_mut()).is_pending());
        while begun.load(Ordering::SeqCst) == 0 {
            thread::yield_now();
        }
        drop(waiting);
        drop(compute);
        held.store(false, Ordering::SeqCst);
        while Arc::strong_count(&held) > 1 {
            thread::yield_now();
        }
        assert!(begun.load(Ordering::SeqCst) < 1000, "all of it was done");
    }

    /// Catches queued work whose memory waits for its turn after its caller has left, or after
    /// its job was stopped: it is freed before the next part begins.
    #[tokio::test]
    async fn work_that_nobody_waits_for_is_freed_before_the_next_part() {
        let compute = Compute::new(1).unwrap();
        let first = numbers(1);
        let (held, begun) = (first.held.clone(), first.begun.clone());
        held.store(true, Ordering::SeqCst);
        let long = job();
        let mut under_way = Box::pin(compute.split(first, &long));
        assert!(futures_util::poll!(under_way.as_mut()).is_pending());
        while begun.load(Ordering::SeqCst) == 0 {
            thread::yield_now();
        }
        let (left, stopped, last) = (numbers(100), numbers(100), numbers(1));
        let counts = [&left, &stopped].map(|numbers| (numbers.begun.clone(), numbers.held.clone()));
        let (leaving, stopping, waiting) = (job(), job(), job());
        let mut leaves = Box::pin(compute.split(left, &leaving));
        let mut stops = Box::pin(compute.split(stopped, &stopping));
        let mut waits = Box::pin(compute.split(last, &waiting));
        assert!(futures_util::poll!(leaves.as_mut()).is_pending());
        assert!(futures_util::poll!(stops.as_mut()).is_pending());
        assert!(futures_util::poll!(waits.as_mut()).is_pending());
        drop(leaves);
        stopping.stop.stop();
        held.store(false, Ordering::SeqCst);
        assert_eq!(stops.await, Err(ComputeError::Stopped));
        assert_eq!(waits.await, Ok(vec![0]));
        assert_eq!(under_way.await, Ok(vec![0]));
        for (begun, held) in counts {
            assert_eq!(begun.load(Ordering::SeqCst), 0);
            while Arc::strong_count(&held) > 1 {
                thread::yield_now();
            }
        }
        // The same for a value that is only to be freed.
        let value = Arc::new(());
        compute.free(value.clone());
        while Arc::strong_count(&value) > 1 {
            thread::yield_now();
        }
    }

    /// Catches long parts that keep the threads of short ones: with one thread for each, a short
    /// part ends while a long one is held.
    #[tokio::test]
    async fn long_parts_do_not_delay_short_ones() {
        let compute = Compute::new(1).unwrap();
        let held = Arc::new(AtomicBool::new(true));
        let long = job();
        let wait = held.clone();
        let mut under_way =
            Box::pin(compute.run_steps(LONG_STEPS + 1, move |_| wait_while(&wait), &long));
        assert!(futures_util::poll!(under_way.as_mut()).is_pending());
        for i in 0..10 {
            assert_eq!(compute.run(move |_| i, &job()).await, Ok(i));
        }
        assert!(futures_util::poll!(under_way.as_mut()).is_pending());
        held.store(false, Ordering::SeqCst);
        assert_eq!(under_way.await, Ok(()));
    }

    /// Catches steps that are charged twice, or not at all, when several pieces of work share a
    /// job.
    #[test]
    fn each_step_is_charged_once() {
        let job = job();
        let clone = job.clone();
        assert_eq!(job.stop.spend(30), Ok(()));
        assert_eq!((job.take_uncharged(), clone.take_uncharged()), (30, 0));
        assert_eq!(clone.stop.spend(5), Ok(()));
        assert_eq!((clone.take_uncharged(), job.take_uncharged()), (5, 0));
    }
}

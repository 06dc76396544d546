//! The threads that compute, beside the async runtime's, so that a long batch
//! never keeps the server from answering a short one.
//!
//! Work comes in parts of some 100 us. Threads take parts from the work under way
//! in turn: whatever comes late waits for as many parts as there is other work, not
//! for all of it.

use std::{
    any::Any,
    collections::VecDeque,
    fmt, io,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread,
};

use tokio::sync::oneshot;

use crate::{budget::Caller, contact::Stop};

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
}

impl Job {
    /// Work for `caller`, with a flag of its own.
    pub fn new(caller: Caller) -> Self {
        Self { caller, stop: Arc::default() }
    }
}

/// Work in parts that any threads do in any order, at any time.
pub trait Parts: Send + Sync + 'static {
    /// What a part gives.
    type Part: Send;
    /// What all parts together give.
    type Whole: Send;

    /// How many.
    fn count(&self) -> usize;

    /// Does part `index`.
    fn part(&self, index: usize) -> Self::Part;

    /// Puts the parts together, in order.
    fn whole(&self, parts: Vec<Self::Part>) -> Self::Whole;
}

/// The computation panicked: a bug, that ends its own call alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Panicked(pub String);

impl fmt::Display for Panicked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "panicked: {}", self.0)
    }
}

impl Compute {
    /// Starts `threads` threads; 0: one a core.
    ///
    /// # Errors
    /// The system has no more threads.
    pub fn new(threads: usize) -> io::Result<Self> {
        let threads = match threads {
            0 => thread::available_parallelism().map_or(1, usize::from),
            threads => threads,
        };
        let queue = Arc::new(Queue::default());
        // Dropped on failure: those that started end.
        let compute = Self { pool: Arc::new(Pool { queue: queue.clone(), threads }) };
        for i in 0..threads {
            let queue = queue.clone();
            thread::Builder::new().name(format!("compute-{i}")).spawn(move || queue.work())?;
        }
        Ok(compute)
    }

    /// How many threads compute.
    pub fn threads(&self) -> usize {
        self.pool.threads
    }

    /// Does `work` in one piece.
    ///
    /// # Errors
    /// It panicked.
    pub async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Panicked> {
        let whole = self.split(Piece(Mutex::new(Some(work)))).await?;
        whole.ok_or_else(|| Panicked("the work was done before".into()))
    }

    /// Does `work` in parts, on all threads that are free.
    ///
    /// # Errors
    /// A part panicked.
    pub async fn split<W: Parts>(&self, work: W) -> Result<W::Whole, Panicked> {
        let (send, receive) = oneshot::channel();
        let count = work.count();
        let done = Done { left: count, parts: (0..count).map(|_| None).collect(), answer: Some(send) };
        let work = Arc::new(Shared { work, done: Mutex::new(done) });
        if count == 0 {
            work.finish(Ok(Vec::new()));
        } else {
            self.pool.queue.push(UnderWay { work, next: 0, count });
        }
        receive.await.unwrap_or_else(|_| Err(Panicked("the threads dropped the work".into())))
    }
}

/// A closure as work of one part.
struct Piece<F>(Mutex<Option<F>>);

impl<T: Send + 'static, F: FnOnce() -> T + Send + 'static> Parts for Piece<F> {
    type Part = Option<T>;
    type Whole = Option<T>;

    fn count(&self) -> usize {
        1
    }

    fn part(&self, _: usize) -> Option<T> {
        let work = locked(&self.0).take();
        work.map(|work| work())
    }

    fn whole(&self, parts: Vec<Option<T>>) -> Option<T> {
        parts.into_iter().next().flatten()
    }
}

/// Work and what is done of it.
struct Shared<W: Parts> {
    work: W,
    done: Mutex<Done<W>>,
}

struct Done<W: Parts> {
    left: usize,
    parts: Vec<Option<W::Part>>,
    /// None once answered.
    answer: Option<oneshot::Sender<Result<W::Whole, Panicked>>>,
}

/// Work of any kind, as the threads see it.
trait Work: Send + Sync {
    /// Does a part; the last one answers.
    fn part(&self, index: usize);
}

impl<W: Parts> Work for Shared<W> {
    fn part(&self, index: usize) {
        let part = caught(|| self.work.part(index));
        let mut done = locked(&self.done);
        match part {
            Err(panicked) => {
                drop(done);
                self.finish(Err(panicked));
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
}

impl<W: Parts> Shared<W> {
    fn finish(&self, parts: Result<Vec<W::Part>, Panicked>) {
        let whole = parts.and_then(|parts| caught(|| self.work.whole(parts)));
        let answer = locked(&self.done).answer.take();
        // Whoever waited may be gone: nothing to do then.
        let _ = answer.map(|answer| answer.send(whole));
    }
}

/// Work under way, some parts of which nobody has begun.
struct UnderWay {
    work: Arc<dyn Work>,
    next: usize,
    count: usize,
}

#[derive(Default)]
struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    under_way: VecDeque<UnderWay>,
    closed: bool,
}

impl Queue {
    fn push(&self, work: UnderWay) {
        let parts = work.count;
        locked(&self.state).under_way.push_back(work);
        match parts {
            1 => self.changed.notify_one(),
            _ => self.changed.notify_all(),
        }
    }

    /// Does parts until closed.
    fn work(&self) {
        while let Some((work, index)) = self.next() {
            work.part(index);
        }
    }

    /// The next part of the work whose turn it is; none when closed.
    fn next(&self) -> Option<(Arc<dyn Work>, usize)> {
        let mut state = locked(&self.state);
        loop {
            if state.closed {
                return None;
            }
            if let Some(mut first) = state.under_way.pop_front() {
                let index = first.next;
                first.next += 1;
                let work = first.work.clone();
                if first.next < first.count {
                    state.under_way.push_back(first);
                }
                return Some((work, index));
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

struct Pool {
    queue: Arc<Queue>,
    threads: usize,
}

impl fmt::Debug for Pool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pool").field("threads", &self.threads).finish_non_exhaustive()
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        let mut state = locked(&self.queue.state);
        state.closed = true;
        // Whoever waits for them hears that they were dropped.
        state.under_way.clear();
        drop(state);
        self.queue.changed.notify_all();
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

    /// Catches a bug in one call's computation that takes the process with it, or a thread.
    #[tokio::test]
    async fn a_panic_is_an_error_of_its_own_call() {
        let compute = Compute::new(2).unwrap();
        for _ in 0..10 {
            let failed = compute.run(|| -> u32 { panic!("on purpose") }).await;
            assert_eq!(failed, Err(Panicked("on purpose".into())));
            assert_eq!(compute.run(|| 7).await, Ok(7));
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

        fn part(&self, index: usize) -> usize {
            self.begun.fetch_add(1, Ordering::SeqCst);
            wait_while(&self.held);
            assert_ne!(Some(index), self.fails_at, "on purpose");
            index
        }

        fn whole(&self, parts: Vec<usize>) -> Vec<usize> {
            parts
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
                assert_eq!(compute.split(numbers(count)).await, Ok((0..count).collect()));
            }
            let failing = Numbers { fails_at: Some(50), ..numbers(100) };
            let failed = compute.split(failing).await.unwrap_err();
            assert!(failed.0.contains("on purpose"), "{failed}");
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

        fn part(&self, _: usize) -> usize {
            let turn = self.turn.fetch_add(1, Ordering::SeqCst);
            wait_while(&self.held);
            turn
        }

        fn whole(&self, parts: Vec<usize>) -> Vec<usize> {
            parts
        }
    }

    /// Catches work that waits for all of the work before it: what comes while a long one is
    /// under way takes turns with it.
    #[tokio::test]
    async fn short_work_does_not_wait_for_long_work() {
        let compute = Compute::new(1).unwrap();
        let (turn, held) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicBool::new(true)));
        let turns = |count| Turns { count, turn: turn.clone(), held: held.clone() };
        let mut long = Box::pin(compute.split(turns(1000)));
        assert!(futures_util::poll!(long.as_mut()).is_pending());
        while turn.load(Ordering::SeqCst) == 0 {
            thread::yield_now();
        }
        // Polled once: it is under way before the long one goes on.
        let mut short = Box::pin(compute.split(turns(2)));
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
            async move { compute.split(long).await }
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
}

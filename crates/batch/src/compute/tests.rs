//! Tests of the compute threads: turns, panics, and work that ends early.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::*;

fn job() -> Job {
    Job::new(())
}

/// Catches a panic in the computation of one call that ends the process or a thread.
#[tokio::test]
async fn a_panic_is_an_error_of_its_own_call() {
    let compute = Compute::new(2).unwrap();
    for _ in 0..10 {
        let failed = compute.run(|_| -> u32 { panic!("on purpose") }, &job()).await;
        assert_eq!(failed, Err(ComputeError::Panicked(Panicked("on purpose".into()))));
        assert_eq!(compute.run(|_| 7, &job()).await, Ok(7));
    }
}

/// Work whose parts return their own index. A part waits while `held` is set.
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

/// Catches parts that are lost, done twice or out of order, work of no parts that is never answered,
/// and the panic of a part that the caller is not told of.
#[tokio::test]
async fn parts_come_back_in_order() {
    for threads in [1, 2, 7] {
        let compute = Compute::new(threads).unwrap();
        assert_eq!(compute.threads(), threads);
        for count in [0, 1, 2, 3, 100, 1001] {
            assert_eq!(compute.run_parts(numbers(count), &job()).await, Ok((0..count).collect()));
        }
        let failing = Numbers { fails_at: Some(50), ..numbers(100) };
        let failed = compute.run_parts(failing, &job()).await.unwrap_err();
        assert!(failed.to_string().contains("on purpose"), "{failed}");
    }
}

/// Work whose parts return the number of their order. A part waits while `held` is set.
struct CountedParts {
    count: usize,
    order: Arc<AtomicUsize>,
    held: Arc<AtomicBool>,
}

impl Parts for CountedParts {
    type Part = usize;
    type Whole = Vec<usize>;

    fn count(&self) -> usize {
        self.count
    }

    fn part(&self, _: usize) -> Result<usize, Stopped> {
        let order = self.order.fetch_add(1, Ordering::SeqCst);
        wait_while(&self.held);
        Ok(order)
    }

    fn whole(&self, parts: Vec<usize>) -> Result<Vec<usize>, Stopped> {
        Ok(parts)
    }
}

/// Catches work that waits for all of the work before it: work that is queued while long work is
/// under way must take turns with it.
#[tokio::test]
async fn short_work_does_not_wait_for_long_work() {
    let compute = Compute::new(1).unwrap();
    let (order, held) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicBool::new(true)));
    let counted_parts = |count| CountedParts { count, order: order.clone(), held: held.clone() };
    let (one, other) = (job(), job());
    let mut long = Box::pin(compute.run_parts(counted_parts(1000), &one));
    assert!(futures_util::poll!(long.as_mut()).is_pending());
    while order.load(Ordering::SeqCst) == 0 {
        thread::yield_now();
    }
    // Polling once puts the short work into the queue before the long work goes on.
    let mut short = Box::pin(compute.run_parts(counted_parts(2), &other));
    assert!(futures_util::poll!(short.as_mut()).is_pending());
    held.store(false, Ordering::SeqCst);
    assert_eq!(short.await, Ok(vec![2, 4]));
    assert_eq!(long.await.unwrap().len(), 1000);
}

/// Catches threads that outlive their owner, and work that goes on although no caller waits for it.
#[tokio::test]
async fn dropping_the_threads_ends_them() {
    let compute = Compute::new(1).unwrap();
    let long = numbers(1000);
    let (held, begun) = (long.held.clone(), long.begun.clone());
    held.store(true, Ordering::SeqCst);
    let mut waiting = Box::pin({
        let compute = compute.clone();
        async move { compute.run_parts(long, &job()).await }
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

/// Catches queued work that keeps its memory until its turn although its caller has left or its job
/// was stopped: the memory must be freed before the next part begins.
#[tokio::test]
async fn work_that_nobody_waits_for_is_freed_before_the_next_part() {
    let compute = Compute::new(1).unwrap();
    let first = numbers(1);
    let (held, begun) = (first.held.clone(), first.begun.clone());
    held.store(true, Ordering::SeqCst);
    let long = job();
    let mut under_way = Box::pin(compute.run_parts(first, &long));
    assert!(futures_util::poll!(under_way.as_mut()).is_pending());
    while begun.load(Ordering::SeqCst) == 0 {
        thread::yield_now();
    }
    let (left, stopped, last) = (numbers(100), numbers(100), numbers(1));
    let counts = [&left, &stopped].map(|numbers| (numbers.begun.clone(), numbers.held.clone()));
    let (leaving, stopping, waiting) = (job(), job(), job());
    let mut leaves = Box::pin(compute.run_parts(left, &leaving));
    let mut stops = Box::pin(compute.run_parts(stopped, &stopping));
    let mut waits = Box::pin(compute.run_parts(last, &waiting));
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
    // A value that is handed over to be freed is freed in the same way.
    let value = Arc::new(());
    compute.free(value.clone());
    while Arc::strong_count(&value) > 1 {
        thread::yield_now();
    }
}

/// Catches long parts that occupy the threads for short parts. With one thread of each kind, short
/// parts must end while a long part is held.
#[tokio::test]
async fn long_parts_do_not_delay_short_ones() {
    let compute = Compute::new(1).unwrap();
    let held = Arc::new(AtomicBool::new(true));
    let long = job();
    let wait = held.clone();
    let mut under_way = Box::pin(compute.run_steps(LONG_STEPS + 1, move |_| wait_while(&wait), &long));
    assert!(futures_util::poll!(under_way.as_mut()).is_pending());
    for i in 0..10 {
        assert_eq!(compute.run(move |_| i, &job()).await, Ok(i));
    }
    assert!(futures_util::poll!(under_way.as_mut()).is_pending());
    held.store(false, Ordering::SeqCst);
    assert_eq!(under_way.await, Ok(()));
}

/// Catches steps that are charged twice or not at all if several pieces of work share a job.
#[test]
fn each_step_is_charged_once() {
    let job = job();
    let clone = job.clone();
    assert_eq!(job.stop.spend(30), Ok(()));
    assert_eq!((job.take_uncharged(), clone.take_uncharged()), (30, 0));
    assert_eq!(clone.stop.spend(5), Ok(()));
    assert_eq!((clone.take_uncharged(), job.take_uncharged()), (5, 0));
}

//! Work of any kind behind one interface for the threads, and the collection of its results.

use std::sync::Mutex;

use tokio::sync::oneshot;

use super::{CallerId, ComputeError, Job, Parts, catch_panic, locked};

/// The smallest number of steps that a part is charged with: those that a thread takes to get the
/// part and to return its result.
pub(super) const LEAST_STEPS: u64 = 2_000;

/// Work, and the results of its parts that are done.
pub(super) struct SharedWork<W: Parts, C> {
    work: W,
    job: Job<C>,
    done: Mutex<PartResults<W>>,
}

struct PartResults<W: Parts> {
    /// The number of parts that are not done.
    left: usize,
    /// The result of each part, once it is done.
    parts: Vec<Option<W::Part>>,
    /// The channel to the waiting future; `None` once the answer was sent.
    answer: Option<oneshot::Sender<Result<W::Whole, ComputeError>>>,
}

/// The interface of work for the threads.
pub(super) trait Work: Send + Sync {
    /// The id of the caller.
    fn caller(&self) -> u64;

    /// Whether the job was stopped.
    fn is_stopped(&self) -> bool;

    /// The steps of the job that its caller has not been charged for; see [`Job::take_uncharged`].
    fn take_uncharged(&self) -> u64;

    /// The estimated number of steps of a part.
    fn steps(&self, index: usize) -> u64;

    /// Does a part and stores its result. The answer is sent when the last part is done, or when a
    /// part fails.
    fn do_part(&self, index: usize);

    /// Sends the answer that the work was stopped.
    fn answer_stopped(&self);
}

impl<W: Parts, C: CallerId> Work for SharedWork<W, C> {
    fn caller(&self) -> u64 {
        self.job.caller.id()
    }

    fn is_stopped(&self) -> bool {
        self.job.stop.is_stopped()
    }

    fn take_uncharged(&self) -> u64 {
        self.job.take_uncharged()
    }

    fn steps(&self, index: usize) -> u64 {
        self.work.steps(index).max(LEAST_STEPS)
    }

    fn do_part(&self, index: usize) {
        let part = catch_panic(|| self.work.part(index));
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

    fn answer_stopped(&self) {
        self.finish(Err(ComputeError::Stopped));
    }
}

impl<W: Parts, C: CallerId> SharedWork<W, C> {
    /// Work of `count` parts whose result is sent through `answer`.
    pub(super) fn new(
        work: W,
        count: usize,
        job: &Job<C>,
        answer: oneshot::Sender<Result<W::Whole, ComputeError>>,
    ) -> Self {
        let parts = (0..count).map(|_| None).collect();
        let done = PartResults { left: count, parts, answer: Some(answer) };
        Self { work, job: job.clone(), done: Mutex::new(done) }
    }

    /// Combines the parts and sends the result, unless no caller waits for it.
    pub(super) fn finish(&self, parts: Result<Vec<W::Part>, ComputeError>) {
        let awaited = locked(&self.done).answer.as_ref().is_some_and(|answer| !answer.is_closed());
        if !awaited {
            return;
        }
        let whole = parts.and_then(|parts| Ok(catch_panic(|| self.work.whole(parts))??));
        let answer = locked(&self.done).answer.take();
        // The send fails if the waiting future is gone. Then nothing is left to do.
        let _ = answer.map(|answer| answer.send(whole));
    }
}

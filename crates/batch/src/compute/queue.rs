//! The queue between the calls that submit work and the threads that do it.

use std::sync::{Arc, Condvar, Mutex, PoisonError};

use super::{
    locked,
    schedule::{Next, Schedule, ScheduledPart},
    work::{LEAST_STEPS, Work},
};

/// Work that waits for the threads of one kind (short or long parts).
#[derive(Default)]
pub(super) struct WorkQueue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    schedule: Schedule<Arc<dyn Work>>,
    /// Values to be freed. A thread that looks for its next part frees them first.
    freed: Vec<Box<dyn Send>>,
    closed: bool,
}

/// The next action of a thread.
enum Action {
    Part(ScheduledPart<Arc<dyn Work>>),
    Free(Vec<Box<dyn Send>>),
    /// Work that was stopped before a part of it began.
    Stopped(Arc<dyn Work>),
}

impl WorkQueue {
    /// Adds work of `count` parts to the queue. The work leaves the queue when all of its parts are
    /// taken, or when the returned guard is dropped.
    pub(super) fn push(self: &Arc<Self>, work: Arc<dyn Work>, count: usize) -> QueueGuard {
        let caller = work.caller();
        let number = locked(&self.state).schedule.push(caller, work, count);
        match count {
            1 => self.changed.notify_one(),
            _ => self.changed.notify_all(),
        }
        QueueGuard { queue: self.clone(), caller, number }
    }

    /// Hands a value to the threads, which free it before they begin another part.
    pub(super) fn free(&self, value: Box<dyn Send>) {
        let mut state = locked(&self.state);
        if state.closed {
            // No thread is left, so the value is freed here, after the lock is released.
            drop(state);
            return;
        }
        state.freed.push(value);
        drop(state);
        self.changed.notify_one();
    }

    /// Ends the threads and drops the work that waits for them.
    pub(super) fn close(&self) {
        let mut state = locked(&self.state);
        state.closed = true;
        // Dropping the work closes its channels, so the callers that wait for it get an error.
        let (works, freed) = (state.schedule.clear(), std::mem::take(&mut state.freed));
        drop(state);
        drop((works, freed));
        self.changed.notify_all();
    }

    /// The loop of a thread, which does parts until the queue is closed.
    pub(super) fn work(&self) {
        let mut done = None;
        while let Some(next) = self.next(done.take()) {
            match next {
                Action::Part(part) => {
                    part.work.do_part(part.index);
                    done = Some(PartCost::new(part));
                }
                Action::Free(freed) => drop(freed),
                Action::Stopped(work) => work.answer_stopped(),
            }
        }
    }

    /// Charges the part that was `done`, then waits for the next action of this thread. Returns `None`
    /// once the queue is closed.
    fn next(&self, done: Option<PartCost>) -> Option<Action> {
        let mut state = locked(&self.state);
        if let Some(PartCost { caller, estimate, metered }) = done {
            state.schedule.done(caller, estimate, metered);
        }
        loop {
            if state.closed {
                return None;
            }
            if !state.freed.is_empty() {
                return Some(Action::Free(std::mem::take(&mut state.freed)));
            }
            let is_stopped = |work: &Arc<dyn Work>| work.is_stopped();
            match state.schedule.take(is_stopped, |work, index| work.steps(index)) {
                Some(Next::Part(part)) => return Some(Action::Part(part)),
                Some(Next::Stopped(work)) => return Some(Action::Stopped(work)),
                None => state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
            }
        }
    }
}

/// The cost of a part that is done, in steps.
struct PartCost {
    caller: u64,
    estimate: u64,
    metered: u64,
}

impl PartCost {
    /// The cost of this part. If the part holds the last reference to the work, the work
    /// is freed here, outside the lock.
    fn new(part: ScheduledPart<Arc<dyn Work>>) -> Self {
        let ScheduledPart { work, caller, estimate, .. } = part;
        let metered = match work.take_uncharged() {
            0 => estimate,
            metered => metered.max(LEAST_STEPS),
        };
        Self { caller, estimate, metered }
    }
}

/// A guard for work in a queue. When it is dropped, the work leaves the queue and is freed.
pub(super) struct QueueGuard {
    queue: Arc<WorkQueue>,
    caller: u64,
    number: u64,
}

impl Drop for QueueGuard {
    fn drop(&mut self) {
        let removed = locked(&self.queue.state).schedule.remove(self.caller, self.number);
        if let Some(work) = removed {
            self.queue.free(Box::new(work));
        }
    }
}

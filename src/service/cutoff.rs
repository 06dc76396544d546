//! Ends calls whose peer does not read the answer.
//!
//! The peer decides how fast it reads, and an unread answer holds memory for as long as its stream lives. A
//! timer inside the response's body cannot end such a stream, because the transport polls the body only
//! while the peer makes room for more. Therefore each stream's future runs together with a [`Cutoff`]: a
//! time at which the stream ends, whatever the peer does.
//!
//! Over HTTP/2, the connection's executor ([`StreamExecutor`](super::streams::StreamExecutor)) runs the stream's future together with the
//! cutoff, and drops the future at that time. h2 then discards the bytes that the stream has queued and
//! resets the stream, so the caller sees CANCELLED. If bytes of the answer remain after that, because the
//! socket takes nothing at all, the connection is closed. The connection is also closed if the future of a
//! small answer has ended and the answer is not sent in time: then there is no future to drop.
//!
//! Over HTTP/1.1 a connection has one call at a time, and the cutoff closes the connection.

use std::{
    future::Future,
    sync::{
        Arc,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
    task::{Context, Poll},
    time::Duration,
};

use bytes::Bytes;
use futures_util::task::AtomicWaker;
use tokio::{
    sync::Notify,
    time::{Instant, sleep, sleep_until},
};

use super::App;
use crate::metrics::CutReason;

/// The time for h2 to discard the answer of a stream that was cut, which takes one turn of the connection's
/// task.
const DISCARD: Duration = Duration::from_secs(1);

tokio::task_local! {
    /// The cutoff of the stream, or of the HTTP/1.1 connection, that the current task serves.
    static CURRENT: Cutoff;
}

/// The latest time at which a stream ends, and the number of bytes of its answer that are not sent yet.
///
/// A stream may answer hundreds of thousands of messages per second, and each of them sets the time and
/// clears it again. Therefore both are plain stores. The waiting side is woken only if the new time is
/// earlier than the time at which it wakes up anyway. When it wakes up, it checks whether the time has moved.
#[derive(Clone, Debug)]
pub(super) struct Cutoff(Arc<State>);

#[derive(Debug)]
struct State {
    /// The zero of the times below.
    start: Instant,
    /// The time at which the stream ends, and the reason ([`packed`]). It is [`NEVER`] while the peer has
    /// nothing to read.
    due: AtomicU64,
    /// The `due` for which the waiting side wakes up.
    awaited: AtomicU64,
    /// Notified when `due` becomes earlier than `awaited`.
    is_earlier: Notify,
    unsent: AtomicUsize,
    /// Wakes the task that waits until everything is sent.
    sent: AtomicWaker,
}

/// The time of a stream that may go on.
const NEVER: u64 = u64::MAX;

/// Longer than any connection lives.
const FAR: Duration = Duration::from_secs(1 << 30);

/// A time in milliseconds and, in the two lowest bits, the reason.
fn packed(milliseconds: u64, why: CutReason) -> u64 {
    milliseconds << 2 | why as u64
}

/// The reason of a packed time.
fn reason(packed: u64) -> Option<CutReason> {
    CutReason::ALL.get((packed & 3) as usize).copied()
}

impl Cutoff {
    /// A cutoff whose time is not set.
    pub(super) fn new() -> Self {
        Self(Arc::new(State {
            start: Instant::now(),
            due: NEVER.into(),
            awaited: NEVER.into(),
            is_earlier: Notify::new(),
            unsent: 0.into(),
            sent: AtomicWaker::new(),
        }))
    }

    /// The cutoff of the stream that the current task serves. If there is none, as in tests that call a
    /// service directly, a cutoff that nothing waits for.
    pub(super) fn current() -> Self {
        CURRENT.try_with(Clone::clone).unwrap_or_else(|_| Self::new())
    }

    /// Sets the time and the reason of the stream's end. A later call replaces them.
    pub(super) fn set(&self, (at, why): (Instant, CutReason)) {
        let state = &*self.0;
        let milliseconds = at.saturating_duration_since(state.start).as_nanos().div_ceil(1_000_000);
        let due = packed(milliseconds as u64, why);
        state.due.store(due, Ordering::SeqCst);
        if due < state.awaited.load(Ordering::SeqCst) {
            state.is_earlier.notify_one();
        }
    }

    /// Whether the transport has sent all of the answer so far.
    pub(super) fn is_all_sent(&self) -> bool {
        self.0.unsent.load(Ordering::SeqCst) == 0
    }

    /// Completes when the transport has sent all of the answer so far. One task at a time may wait.
    pub(super) fn poll_sent(&self, cx: &mut Context<'_>) -> Poll<()> {
        if self.is_all_sent() {
            return Poll::Ready(());
        }
        self.0.sent.register(cx.waker());
        if self.is_all_sent() { Poll::Ready(()) } else { Poll::Pending }
    }

    /// Removes the cutoff if the peer has taken all of the answer so far.
    pub(super) fn clear_if_all_is_sent(&self) {
        let due = self.0.due.load(Ordering::SeqCst);
        let change =
            |from, to| self.0.due.compare_exchange(from, to, Ordering::SeqCst, Ordering::SeqCst).is_ok();
        if due != NEVER && self.is_all_sent() && change(due, NEVER) && !self.is_all_sent() {
            // More bytes were queued in the meantime, and their time may be the same millisecond.
            change(NEVER, due);
        }
    }

    /// The bytes for the transport, which count as unsent until it has freed them. `held` is held until then.
    pub(super) fn until_sent<T: Send + 'static>(&self, bytes: Bytes, held: T) -> Bytes {
        self.queued(bytes.len());
        Bytes::from_owner(Unsent { bytes, cutoff: self.clone(), _held: held })
    }

    /// Counts `bytes` of the answer that the transport has not sent yet.
    pub(super) fn queued(&self, bytes: usize) {
        self.0.unsent.fetch_add(bytes, Ordering::SeqCst);
    }

    /// Records that the memory of `bytes` is free, because they were sent or discarded.
    pub(super) fn freed(&self, bytes: usize) {
        if self.0.unsent.fetch_sub(bytes, Ordering::SeqCst) == bytes {
            self.clear_if_all_is_sent();
            self.0.sent.wake();
        }
    }

    /// Runs `work`. Returns none if the cutoff ended it.
    pub(super) async fn guard<T>(&self, app: &App, work: impl Future<Output = T>) -> Option<T> {
        let ended = tokio::select! {
            biased;
            done = CURRENT.scope(self.clone(), work) => Ok(done),
            why = self.due() => Err(why),
        };
        // The work has already been dropped here.
        ended.map_err(|why| report(app, why)).ok()
    }

    /// Runs `stream` to its end, and returns whether the connection may go on: false means that the transport
    /// still holds bytes of an answer that was cut.
    pub(super) async fn run(&self, app: &App, stream: impl Future) -> bool {
        if self.guard(app, stream).await.is_some() || self.is_all_sent() {
            return true;
        }
        sleep(DISCARD).await;
        self.is_all_sent()
    }

    /// The time at which the stream ends.
    pub(super) fn time(&self) -> Instant {
        match self.0.due.load(Ordering::SeqCst) {
            NEVER => self.0.start + FAR,
            due => self.0.start + Duration::from_millis(due >> 2),
        }
    }

    /// Whether the time has come.
    pub(super) fn is_overdue(&self) -> bool {
        self.time() <= Instant::now()
    }

    /// Counts and logs that the stream was cut.
    pub(super) fn report(&self, app: &App) {
        if let Some(why) = reason(self.0.due.load(Ordering::SeqCst)) {
            report(app, why);
        }
    }

    /// Waits for the cutoff and returns its reason.
    async fn due(&self) -> CutReason {
        let state = &*self.0;
        loop {
            let due = state.due.load(Ordering::SeqCst);
            state.awaited.store(due, Ordering::SeqCst);
            if state.due.load(Ordering::SeqCst) < due {
                // The time was set before `awaited` showed that this side has to be woken.
                continue;
            }
            let Some(why) = reason(due).filter(|_| due != NEVER) else {
                state.is_earlier.notified().await;
                continue;
            };
            tokio::select! {
                () = sleep_until(state.start + Duration::from_millis(due >> 2)) => {
                    if state.due.load(Ordering::SeqCst) <= due {
                        return why;
                    }
                }
                () = state.is_earlier.notified() => {}
            }
        }
    }
}

/// Bytes of an answer that are not sent yet, and everything that is held until they are.
struct Unsent<T> {
    bytes: Bytes,
    cutoff: Cutoff,
    _held: T,
}

impl<T> AsRef<[u8]> for Unsent<T> {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl<T> Drop for Unsent<T> {
    fn drop(&mut self) {
        self.cutoff.freed(self.bytes.len());
    }
}

fn report(app: &App, why: CutReason) {
    app.metrics().cut(why);
    tracing::debug!(why = why.name(), "cut a call whose answer was not read in time");
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a cutoff that fires although it was removed or changed, and one that never fires.
    #[tokio::test(start_paused = true)]
    async fn the_last_time_that_was_set_counts() {
        let cutoff = Cutoff::new();
        let start = Instant::now();
        let second = Duration::from_secs(1);
        cutoff.set((start + second, CutReason::AnswerNotRead));
        let due = tokio::spawn({
            let cutoff = cutoff.clone();
            async move { cutoff.due().await }
        });
        tokio::task::yield_now().await;
        cutoff.clear_if_all_is_sent();
        sleep(5 * second).await;
        assert!(!due.is_finished());
        cutoff.set((start + 10 * second, CutReason::AnswerNotRead));
        cutoff.set((start + 20 * second, CutReason::Deadline));
        assert_eq!(due.await.unwrap(), CutReason::Deadline);
        assert_eq!(start.elapsed().as_secs(), 20);
    }

    /// Catches a cutoff that is removed although a part of the answer has not been read.
    #[tokio::test(start_paused = true)]
    async fn a_part_that_is_not_read_keeps_the_cutoff() {
        let cutoff = Cutoff::new();
        cutoff.queued(10);
        cutoff.queued(5);
        cutoff.set((Instant::now() + Duration::from_secs(1), CutReason::AnswerNotRead));
        cutoff.freed(10);
        cutoff.clear_if_all_is_sent();
        assert_eq!(cutoff.due().await, CutReason::AnswerNotRead);
        cutoff.freed(5);
        assert_eq!(cutoff.0.due.load(Ordering::SeqCst), NEVER);
    }
}

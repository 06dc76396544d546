//! Runs the streams of one HTTP/2 connection. A peer that begins streams faster than they run or are answered
//! has to wait.
//!
//! h2 reads frames until the socket is empty. It keeps a record of each stream that has begun, and hands the
//! stream to hyper, which hands a future to the connection's executor. Four things could pile up:
//!
//! - *Records.* h2 never shrinks its table of streams, so the largest number of streams at a time decides
//!   how much memory the connection holds. The connection takes memory for that number.
//! - *Tasks that have not run.* A stream that its peer resets no longer counts as one of the connection's
//!   concurrent streams, but its future lives until its task has run. A peer that resets calls as fast as it
//!   makes them ("rapid reset", CVE-2023-44487) queues tasks in front of everybody else's.
//! - *Answers that are not sent.* While the socket takes nothing, h2 keeps the answers that consist of headers
//!   only, although their tasks have ended.
//! - *Tasks of many connections.* A caller may have thousands of connections, each with few tasks or frames.
//!
//! ```text
//! peer -> socket -> h2's records -> execute: waiting += 1 -> task's first run: waiting -= 1 -> middleware
//!           ^                                                      |
//!           '---- is not read while too many wait <-- is woken ----'
//! ```
//!
//! Therefore [`Streams`] decides when the connection may be read. It is not read
//!
//! - while h2 holds more than a few streams that it has not handed on;
//! - while too many tasks wait for their first run;
//! - while the socket takes no bytes and many streams have begun since it stopped;
//! - until it is the connection's turn ([`ReadTurn`]): a poll of a connection reads few frames, and needs one
//!   of the few permits of its address. Permits go to the connections in the order in which they ask.
//!
//! The peer then waits as it does for any slow receiver, and tasks of other addresses wait behind few of its
//! tasks.
//!
//! A stream's task ends when its answer is handed to h2. Whether the socket takes the answer in time is
//! watched by the connection ([`Streams::until_overdue`]): a task that waited for it would be woken twice
//! for each call.

use std::{
    future::Future,
    io,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll},
};

use futures_util::task::AtomicWaker;
use tokio::{
    sync::{Notify, Semaphore},
    time::sleep_until,
};

use super::{App, cutoff::Cutoff, peers::Peer, read_turn::ReadTurn};
use crate::{budget::Permit, lock::locked};

/// The number of futures that may be alive for each concurrent stream that a connection may have. A
/// connection with more is closed.
const FUTURES_PER_STREAM: u64 = 4;

/// The connection is not read while more tasks than this have not run yet, or while h2 has not handed on more
/// streams than this. Tasks run at once unless the threads are busy, so ordinary peers are not slowed down.
const MOST_WAITING: u64 = 16;

/// The number of streams that a peer may begin while its socket takes nothing.
const MOST_UNSENT: u64 = 64;

/// The memory of a stream in h2's table: 1.6 kB were measured with 1,000 streams on each of 1,000 connections.
const RECORD_BYTES: u64 = 2 << 10;

/// The number of streams for which memory is taken at a time. The memory of this many streams is also part of
/// the fixed cost of a connection.
const RECORDS: u64 = 32;

/// The streams of one connection.
#[derive(Debug)]
pub(super) struct Streams {
    /// The number of futures that have not ended.
    living: AtomicU64,
    /// The number of tasks that have not run yet.
    waiting: AtomicU64,
    /// The number of streams that have been handed to the executor so far.
    begun: AtomicU64,
    /// `begun` when the socket last stopped taking bytes, or [`OPEN`] while it takes them.
    begun_at_block: AtomicU64,
    /// Wakes the task that waits until the connection may be read.
    reader: AtomicWaker,
    turn: Mutex<ReadTurn>,
    /// The cutoffs of the streams whose tasks have ended and whose answers the transport still held.
    unsent: Mutex<Vec<Cutoff>>,
    /// Notified when `unsent` gets longer.
    is_longer: Notify,
}

/// The socket takes bytes.
const OPEN: u64 = u64::MAX;

impl Streams {
    /// `read_permits` are the permits to read of the connection's address.
    pub(super) fn new(read_permits: Arc<Semaphore>) -> Self {
        Self {
            living: 0.into(),
            waiting: 0.into(),
            begun: 0.into(),
            begun_at_block: OPEN.into(),
            reader: AtomicWaker::new(),
            turn: Mutex::new(ReadTurn::new(read_permits)),
            unsent: Mutex::default(),
            is_longer: Notify::new(),
        }
    }

    /// Runs one poll of the connection.
    pub(super) fn within_poll<T>(&self, poll: impl FnOnce() -> T) -> T {
        locked(&self.turn).begin_poll();
        let polled = poll();
        let mut turn = locked(&self.turn);
        if self.waiting.load(Ordering::SeqCst) == 0 {
            turn.give_back();
        }
        turn.end_poll();
        polled
    }

    /// Completes when the connection may be read. One task at a time may wait.
    pub(super) fn poll_may_read(&self, pending: &mut PendingStreams, cx: &mut Context<'_>) -> Poll<()> {
        if !pending.are_handed_on(self.begun.load(Ordering::SeqCst)) {
            cx.waker().wake_by_ref();
            return Poll::Pending;
        }
        if !self.may_read() {
            self.reader.register(cx.waker());
            if !self.may_read() {
                return Poll::Pending;
            }
        }
        locked(&self.turn).poll_begin(cx)
    }

    fn may_read(&self) -> bool {
        let most = if locked(&self.turn).is_wanted() { 0 } else { MOST_WAITING };
        self.waiting.load(Ordering::SeqCst) <= most && self.begun_while_blocked() <= MOST_UNSENT
    }

    /// Counts frames that were read.
    pub(super) fn count_frames(&self, frames: u64) {
        locked(&self.turn).count_frames(frames);
    }

    fn begun_while_blocked(&self) -> u64 {
        match self.begun_at_block.load(Ordering::SeqCst) {
            OPEN => 0,
            at => self.begun.load(Ordering::SeqCst) - at,
        }
    }

    /// Notes that the socket does not take all bytes that it was given.
    pub(super) fn note_blocked(&self) {
        let begun = self.begun.load(Ordering::SeqCst);
        let _ = self.begun_at_block.compare_exchange(OPEN, begun, Ordering::SeqCst, Ordering::SeqCst);
    }

    /// Notes that the socket has taken all bytes that it was given.
    pub(super) fn note_flushed(&self) {
        if self.begun_at_block.swap(OPEN, Ordering::SeqCst) != OPEN {
            self.reader.wake();
        }
    }

    /// The number of streams that h2 has records of, at most.
    pub(super) fn count(&self, pending: &PendingStreams) -> u64 {
        self.living.load(Ordering::SeqCst) + pending.count + self.begun_while_blocked()
    }

    /// A task runs for the first time.
    fn task_runs(&self) {
        let waiting = self.waiting.fetch_sub(1, Ordering::SeqCst) - 1;
        if waiting == 0 {
            locked(&self.turn).give_back();
        }
        if [0, MOST_WAITING].contains(&waiting) {
            self.reader.wake();
        }
    }

    /// The task of a stream has ended.
    fn task_ended(&self, cutoff: Cutoff) {
        if cutoff.is_all_sent() {
            self.living.fetch_sub(1, Ordering::SeqCst);
        } else {
            locked(&self.unsent).push(cutoff);
            self.is_longer.notify_one();
        }
    }

    /// Completes when the transport did not take the answer of a stream in time.
    pub(super) async fn until_overdue(&self, app: &App) {
        loop {
            let Some(cutoff) = self.next_unsent() else {
                self.is_longer.notified().await;
                continue;
            };
            tokio::select! {
                biased;
                () = self.is_longer.notified() => {}
                () = sleep_until(cutoff.time()) => if cutoff.is_overdue() {
                    return cutoff.report(app);
                }
            }
        }
    }

    /// The unsent answer whose time ends first. Forgets those that have been sent.
    fn next_unsent(&self) -> Option<Cutoff> {
        let mut unsent = locked(&self.unsent);
        let before = unsent.len();
        unsent.retain(|cutoff| !cutoff.is_all_sent());
        self.living.fetch_sub((before - unsent.len()) as u64, Ordering::SeqCst);
        unsent.iter().min_by_key(|cutoff| cutoff.time()).cloned()
    }
}

/// The memory of h2's records of a connection's streams.
#[derive(Debug)]
pub(super) struct StreamRecordMemory {
    peer: Peer,
    /// The memory of [`RECORDS`] streams each, for those beyond the first.
    memory: Vec<Permit>,
}

impl StreamRecordMemory {
    pub(super) fn new(peer: Peer) -> Self {
        Self { peer, memory: Vec::new() }
    }

    /// Takes memory until it suffices for this number of concurrent streams.
    ///
    /// # Errors
    /// The budget has no room.
    pub(super) fn charge(&mut self, streams: u64) -> io::Result<()> {
        while RECORDS * (1 + self.memory.len() as u64) < streams {
            let memory = self.peer.take(RECORDS * RECORD_BYTES).ok_or_else(|| {
                io::Error::other("the memory budget has no room for more streams on this connection")
            })?;
            self.memory.push(memory);
        }
        Ok(())
    }
}

/// Spawns the futures of a connection's streams, each with its own cutoff.
#[derive(Clone, Debug)]
pub(super) struct StreamExecutor {
    app: Arc<App>,
    abort: Arc<Notify>,
    streams: Arc<Streams>,
}

/// The streams that have arrived and that h2 has not handed on yet.
#[derive(Debug, Default)]
pub(super) struct PendingStreams {
    /// Their number, at most: frames of headers also end streams, and h2 refuses some.
    count: u64,
    /// The number of streams that had been handed on when `count` was last corrected.
    handed_on: u64,
    /// Whether reading has been put off since then, so that h2 hands streams on.
    put_off: bool,
}

impl PendingStreams {
    pub(super) fn add(&mut self, streams: u64) {
        self.count += streams;
    }

    /// Whether h2 has handed on all streams but a few, where `handed_on` is the number of those handed on so far.
    ///
    /// hyper asks h2 for one stream at a time, and h2 reads each time before it hands one on. So reading is
    /// put off for as long as streams are handed on. If none was, h2 has no more of them.
    fn are_handed_on(&mut self, handed_on: u64) -> bool {
        let more = handed_on - self.handed_on;
        self.handed_on = handed_on;
        self.count = self.count.saturating_sub(more);
        if self.count > MOST_WAITING {
            if more > 0 || !self.put_off {
                self.put_off = true;
                return false;
            }
            self.count = 0;
        }
        self.put_off = false;
        true
    }
}

impl StreamExecutor {
    /// `abort` is notified when the connection has to be closed.
    pub(super) fn new(app: Arc<App>, abort: Arc<Notify>, streams: Arc<Streams>) -> Self {
        Self { app, abort, streams }
    }
}

impl<F> hyper::rt::Executor<F> for StreamExecutor
where
    F: Future + Send + 'static,
    F::Output: Send,
{
    fn execute(&self, stream: F) {
        let most = FUTURES_PER_STREAM * u64::from(self.app.limits().max_streams_per_connection);
        if self.streams.living.fetch_add(1, Ordering::SeqCst) >= most {
            self.streams.living.fetch_sub(1, Ordering::SeqCst);
            self.abort.notify_one();
            return;
        }
        self.streams.begun.fetch_add(1, Ordering::SeqCst);
        self.streams.waiting.fetch_add(1, Ordering::SeqCst);
        let Self { app, abort, streams } = self.clone();
        tokio::spawn(async move {
            streams.task_runs();
            let cutoff = Cutoff::new();
            let is_usable = cutoff.run(&app, stream).await;
            streams.task_ended(cutoff);
            if !is_usable {
                abort.notify_one();
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a connection that is read although h2 holds many streams, for which its table would grow, and a
    /// connection that is never read again after headers that begin no stream.
    #[test]
    fn reading_waits_until_streams_are_handed_on() {
        let mut pending = PendingStreams::default();
        assert!(pending.are_handed_on(0));
        pending.add(76);
        let put_off = (0..76).take_while(|&begun| !pending.are_handed_on(begun)).count() as u64;
        assert_eq!(put_off, 76 - MOST_WAITING);
        assert_eq!(pending.count, MOST_WAITING);
        pending.add(100);
        assert!(!pending.are_handed_on(70));
        assert!(pending.are_handed_on(70), "h2 has nothing more to hand on");
        assert_eq!(pending.count, 0);
    }

    /// Catches connections of one address that all queue tasks at the same time, a permit that is never
    /// given back, and one that is kept by a connection which h2 does not read.
    #[test]
    fn the_connections_of_an_address_are_read_in_turns() {
        let mut cx = Context::from_waker(std::task::Waker::noop());
        let permits = Arc::new(Semaphore::new(1));
        let (first, second) = (Streams::new(permits.clone()), Streams::new(permits.clone()));
        let mut reads = |streams: &Streams| {
            streams.within_poll(|| streams.poll_may_read(&mut PendingStreams::default(), &mut cx).is_ready())
        };
        assert!(reads(&first) && reads(&second), "a permit is held within a poll");
        first.waiting.store(2, Ordering::SeqCst);
        assert!(
            locked(&first.turn).poll_begin(&mut Context::from_waker(std::task::Waker::noop())).is_ready()
        );
        assert!(!reads(&second) && !reads(&first), "tasks of the first connection wait");
        first.task_runs();
        assert!(!reads(&second));
        first.task_runs();
        assert!(reads(&second) && reads(&first));
        let held = permits.clone().try_acquire_owned().unwrap();
        assert!(!reads(&first));
        first.within_poll(|| ());
        drop(held);
        assert_eq!(permits.available_permits(), 1, "a connection that h2 does not read leaves the queue");
    }

    /// Catches a poll that reads as many frames as the peer sends, while others wait for the thread.
    #[test]
    fn a_poll_reads_few_frames() {
        let mut cx = Context::from_waker(std::task::Waker::noop());
        let streams = Streams::new(Arc::new(Semaphore::new(1)));
        let mut frames_read = || {
            streams.within_poll(|| {
                let mut polls = 0;
                while streams.poll_may_read(&mut PendingStreams::default(), &mut cx).is_ready() {
                    streams.count_frames(50);
                    polls += 1;
                }
                50 * polls
            })
        };
        assert_eq!([frames_read(), frames_read()], [150; 2]);
    }
}

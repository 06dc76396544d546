//! Runs the streams of one HTTP/2 connection, and lets a peer wait that begins them faster than they run or
//! are answered.
//!
//! h2 reads frames until the socket is empty. It keeps a record of each stream that has begun, and hands the
//! stream to hyper, which hands a future to the connection's executor. Three things could pile up:
//!
//! - *Records.* h2 never shrinks its table of streams, so the largest number of streams at a time decides
//!   how much memory the connection holds. The connection takes memory for that number.
//! - *Tasks that have not run.* A stream that its peer resets no longer counts as one of the connection's
//!   concurrent streams, but its future lives until its task has run. A peer that resets calls as fast as it
//!   makes them ("rapid reset", CVE-2023-44487) queues tasks in front of everybody else's.
//! - *Answers that are not sent.* An answer of headers only is held by h2 alone while the socket takes nothing.
//! - *Tasks of many connections.* A caller may have thousands of connections, each with few tasks.
//!
//! ```text
//! peer -> socket -> h2's records -> execute: waiting += 1 -> task's first run: waiting -= 1 -> middleware
//!           ^                                                      |
//!           '---- is not read while too many wait <-- is woken ----'
//! ```
//!
//! Therefore [`Streams`] says when the connection may be read: after a few streams have begun, h2 has to
//! hand them on first; while too many tasks wait for their first run, nothing is read; and nothing is read
//! while the socket takes no bytes and many streams have begun since it stopped. Last, the connections of one
//! address are read in turns: a connection needs one of the address's few permits to read, and holds it until
//! all tasks that it spawned have run once. Connections get permits in the order in which they ask. A peer
//! then waits as it does for any slow receiver, and tasks of other addresses wait behind few of its tasks.

use std::{
    future::Future,
    io,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll, ready},
};

use futures_util::task::AtomicWaker;
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::PollSemaphore;

use super::{App, cutoff::Cutoff, peers::Peer};
use crate::{budget::Permit, lock::locked};

/// The number of futures that may be alive for each concurrent stream that a connection may have. A
/// connection with more is closed.
const FUTURES_PER_STREAM: u64 = 4;

/// The connection is not read while more tasks than these have not run yet, nor before h2 has handed on that
/// many streams. Tasks run at once unless the threads are busy, so ordinary peers are not slowed down.
const MOST_WAITING: u64 = 16;

/// The number of streams that a peer may begin while its socket takes nothing.
const MOST_UNSENT: u64 = 64;

/// The memory of a stream in h2's table: 1.6 kB were measured with 1,000 streams on each of 1,000 connections.
const RECORD_BYTES: u64 = 2 << 10;

/// The number of streams for which memory is taken at a time. The first as many belong to the fixed cost of a
/// connection.
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
    reader: AtomicWaker,
    /// The permit with which the connection is read, until no task waits.
    read_permit: Mutex<Option<OwnedSemaphorePermit>>,
}

/// The socket takes bytes.
const OPEN: u64 = u64::MAX;

impl Default for Streams {
    fn default() -> Self {
        Self {
            living: 0.into(),
            waiting: 0.into(),
            begun: 0.into(),
            begun_at_block: OPEN.into(),
            reader: AtomicWaker::new(),
            read_permit: Mutex::default(),
        }
    }
}

impl Streams {
    /// Completes when the connection may be read. One task at a time may wait.
    pub(super) fn poll_may_read(
        &self,
        arrived: &mut Arrived,
        readers: &mut Readers,
        cx: &mut Context<'_>,
    ) -> Poll<()> {
        if !arrived.are_handed_on(self.begun.load(Ordering::SeqCst)) {
            cx.waker().wake_by_ref();
            return Poll::Pending;
        }
        if !self.may_read(readers) {
            self.reader.register(cx.waker());
            if !self.may_read(readers) {
                return Poll::Pending;
            }
        }
        if locked(&self.read_permit).is_none() {
            let permit = ready!(readers.0.poll_acquire(cx));
            *locked(&self.read_permit) = permit;
        }
        Poll::Ready(())
    }

    fn may_read(&self, readers: &Readers) -> bool {
        self.release_read_permit();
        // Other connections of the address ask for a permit, so they are next.
        let is_asked_for = readers.0.available_permits() == 0 && locked(&self.read_permit).is_some();
        let most = if is_asked_for { 0 } else { MOST_WAITING };
        self.waiting.load(Ordering::SeqCst) <= most && self.begun_while_blocked() <= MOST_UNSENT
    }

    /// Gives the permit to read to the next connection that asks for one, unless tasks of this connection wait.
    pub(super) fn release_read_permit(&self) {
        if self.waiting.load(Ordering::SeqCst) == 0 {
            locked(&self.read_permit).take();
        }
    }

    fn begun_while_blocked(&self) -> u64 {
        match self.begun_at_block.load(Ordering::SeqCst) {
            OPEN => 0,
            at => self.begun.load(Ordering::SeqCst) - at,
        }
    }

    /// Notes whether the socket took bytes when it was last asked to.
    pub(super) fn wrote(&self, is_blocked: bool, readers: &mut Readers) {
        let was_blocked = self.begun_at_block.load(Ordering::SeqCst) != OPEN;
        if is_blocked {
            // h2 does not read before the socket takes bytes again, so that other connections are next.
            readers.ask_no_more();
            self.release_read_permit();
        }
        if is_blocked && !was_blocked {
            self.begun_at_block.store(self.begun.load(Ordering::SeqCst), Ordering::SeqCst);
        }
        if was_blocked && !is_blocked {
            self.begun_at_block.store(OPEN, Ordering::SeqCst);
            self.reader.wake();
        }
    }

    /// The number of streams that h2 has records of, at most.
    pub(super) fn count(&self, arrived: &Arrived) -> u64 {
        self.living.load(Ordering::SeqCst) + arrived.count + self.begun_while_blocked()
    }

    /// A task runs for the first time.
    fn runs(&self) {
        let waiting = self.waiting.fetch_sub(1, Ordering::SeqCst) - 1;
        if waiting == 0 {
            self.release_read_permit();
        }
        if [0, MOST_WAITING].contains(&waiting) {
            self.reader.wake();
        }
    }
}

/// The permits to read that the connections of one address share.
#[derive(Debug)]
pub(super) struct Readers(PollSemaphore);

impl Readers {
    pub(super) fn new(permits: Arc<Semaphore>) -> Self {
        Self(PollSemaphore::new(permits))
    }

    /// Leaves the queue for a permit.
    fn ask_no_more(&mut self) {
        self.0 = self.0.clone();
    }
}

/// The memory of h2's records of a connection's streams.
#[derive(Debug)]
pub(super) struct Records {
    peer: Peer,
    /// The memory of [`RECORDS`] streams each, for those beyond the first.
    memory: Vec<Permit>,
}

impl Records {
    pub(super) fn new(peer: Peer) -> Self {
        Self { peer, memory: Vec::new() }
    }

    /// Takes memory for this number of streams at a time.
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
pub(super) struct Arrived {
    /// Their number, at most: frames of headers also end streams, and h2 refuses some.
    count: u64,
    /// The number of streams that had been handed on when `count` was last corrected.
    begun: u64,
    /// Reading has been put off since then, so that h2 hands streams on.
    put_off: bool,
}

impl Arrived {
    pub(super) fn add(&mut self, streams: u64) {
        self.count += streams;
    }

    /// Whether h2 has handed on all streams but a few, where `begun` is the number of those handed on so far.
    ///
    /// hyper asks h2 for one stream at a time, and h2 reads each time before it hands one on. So reading is
    /// put off for as long as streams are handed on. If none was, h2 has no more of them.
    fn are_handed_on(&mut self, begun: u64) -> bool {
        let handed_on = begun - self.begun;
        self.begun = begun;
        self.count = self.count.saturating_sub(handed_on);
        if self.count > MOST_WAITING {
            if handed_on > 0 || !self.put_off {
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
            streams.runs();
            let may_go_on = Cutoff::new().run(&app, stream).await;
            streams.living.fetch_sub(1, Ordering::SeqCst);
            if !may_go_on {
                abort.notify_one();
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a connection that reads on although h2 holds many streams, which its table would have to hold
    /// at a time, and one that is never read again after headers that begin no stream.
    #[test]
    fn reading_waits_until_streams_are_handed_on() {
        let mut arrived = Arrived::default();
        assert!(arrived.are_handed_on(0));
        arrived.add(76);
        let put_off = (0..76).take_while(|&begun| !arrived.are_handed_on(begun)).count() as u64;
        assert_eq!(put_off, 76 - MOST_WAITING);
        assert_eq!(arrived.count, MOST_WAITING);
        arrived.add(100);
        assert!(!arrived.are_handed_on(70));
        assert!(arrived.are_handed_on(70), "h2 has nothing more to hand on");
        assert_eq!(arrived.count, 0);
    }

    /// Catches connections of one address that all queue tasks at the same time, a permit that is never
    /// given back, and one that is kept by a connection which h2 does not read.
    #[test]
    fn the_connections_of_an_address_are_read_in_turns() {
        let mut cx = Context::from_waker(std::task::Waker::noop());
        let permits = Arc::new(Semaphore::new(1));
        let connection = || (Streams::default(), Arrived::default(), Readers::new(permits.clone()));
        let (mut first, mut second) = (connection(), connection());
        let mut may_read = |(streams, arrived, readers): &mut (Streams, Arrived, Readers)| {
            streams.poll_may_read(arrived, readers, &mut cx).is_ready()
        };
        assert!(may_read(&mut first));
        first.0.waiting.store(2, Ordering::SeqCst);
        assert!(!may_read(&mut second) && !may_read(&mut first), "tasks of the first connection wait");
        first.0.runs();
        assert!(!may_read(&mut second));
        first.0.runs();
        assert!(may_read(&mut second) && !may_read(&mut first));
        second.0.wrote(true, &mut second.2);
        assert!(may_read(&mut first) && !may_read(&mut second));
        second.0.wrote(true, &mut second.2);
        first.0.release_read_permit();
        assert_eq!(permits.available_permits(), 1, "the second connection no longer asks");
    }
}

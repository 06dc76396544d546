//! Lets the connections of one address be read in turns.
//!
//! A poll of a connection reads few frames, and needs one of the few permits of its address. Permits go to the
//! connections in the order in which they ask.
//!
//! A connection holds its permit over several polls only while tasks that it spawned have not run, and otherwise
//! gives it back at the end of each poll. So a connection that h2 does not read, for example because its socket
//! takes no bytes, keeps no permit.

use std::{
    sync::Arc,
    task::{Context, Poll, ready},
};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::PollSemaphore;

/// The number of frames after which a poll of a connection ends, because other connections wait for the same
/// thread. A frame costs some 100 ns besides the task that it begins.
const FRAMES_PER_POLL: u64 = 128;

/// The turn of a connection to be read.
#[derive(Debug)]
pub(super) struct ReadTurn {
    permits: PollSemaphore,
    held: Option<OwnedSemaphorePermit>,
    /// Whether the connection waits in the queue for a permit.
    is_queued: bool,
    /// Whether the connection wanted to read in the current poll and had no permit.
    asks: bool,
    /// The number of frames read in the current poll.
    frames: u64,
}

impl ReadTurn {
    /// `permits` are the permits to read of the connection's address.
    pub(super) fn new(permits: Arc<Semaphore>) -> Self {
        let permits = PollSemaphore::new(permits);
        Self { permits, held: None, is_queued: false, asks: false, frames: 0 }
    }

    /// Begins a poll of the connection.
    pub(super) fn begin_poll(&mut self) {
        (self.asks, self.frames) = (false, 0);
    }

    /// Ends a poll of the connection. A connection that did not want to read leaves the queue.
    pub(super) fn end_poll(&mut self) {
        if self.is_queued && !self.asks {
            // A copy of the handle does not wait in the queue.
            self.permits = self.permits.clone();
            self.is_queued = false;
        }
    }

    /// Completes when it is the connection's turn.
    pub(super) fn poll_begin(&mut self, cx: &mut Context<'_>) -> Poll<()> {
        if self.frames >= FRAMES_PER_POLL {
            cx.waker().wake_by_ref();
            return Poll::Pending;
        }
        if self.held.is_none() {
            (self.asks, self.is_queued) = (true, true);
            self.held = ready!(self.permits.poll_acquire(cx));
            (self.asks, self.is_queued) = (false, false);
        }
        Poll::Ready(())
    }

    /// Gives the permit back.
    pub(super) fn give_back(&mut self) {
        self.held = None;
    }

    /// Counts frames that were read in the current poll.
    pub(super) fn count_frames(&mut self, frames: u64) {
        self.frames += frames;
    }

    /// Whether other connections of the address may wait for the permit that this one holds.
    pub(super) fn is_wanted(&self) -> bool {
        self.held.is_some() && self.permits.available_permits() == 0
    }
}

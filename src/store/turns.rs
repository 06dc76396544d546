//! Slots that callers take in turn.
//!
//! A slot is the right to run one operation of the store, or to load one hull. Callers share the
//! slots by dynamic thresholds (see [`budget`](crate::budget)), so that a single caller never has
//! more than half of them. Waiting callers take turns: a caller with a thousand requests delays
//! another caller's single request by at most one of its own. The number of waiting requests is
//! limited in the same way.

use std::{
    collections::{BTreeMap, HashMap, VecDeque},
    sync::{Arc, Mutex},
};

use tokio::sync::oneshot;

use crate::budget::{Caller, Shares};
use crate::lock::locked;

/// The slots, and the requests that wait for one.
#[derive(Debug)]
pub(super) struct Turns {
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    slots: Shares,
    places: Shares,
    /// The queues by the caller's id. Each id in it is in `order` exactly once.
    waiting: HashMap<u64, Queue>,
    order: VecDeque<u64>,
    next_ticket: u64,
}

/// One caller's waiting requests, the oldest first.
#[derive(Debug)]
struct Queue {
    caller: Caller,
    tickets: BTreeMap<u64, oneshot::Sender<()>>,
}

/// The reason why a request gets no slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NoTurn {
    /// Too many of this caller's requests wait already.
    Busy,
    /// All waiting requests were refused.
    SentAway,
}

impl Turns {
    /// `slots` may be used at a time, and `places` requests may wait. `shares` says whether callers
    /// share both by dynamic thresholds; a single slot cannot be shared.
    pub(super) fn new(slots: u64, places: u64, shares: bool) -> Arc<Self> {
        Arc::new(Self {
            state: Mutex::new(State {
                slots: Shares::new(slots, shares && slots > 1),
                places: Shares::new(places, shares),
                waiting: HashMap::new(),
                order: VecDeque::new(),
                next_ticket: 0,
            }),
        })
    }

    /// Waits for the turn of `caller` and takes a slot.
    ///
    /// # Errors
    /// No more of this caller's requests may wait, or all waiting requests were refused.
    pub(super) async fn take(self: &Arc<Self>, caller: &Caller) -> Result<Turn, NoTurn> {
        let mut waiting = {
            let mut state = locked(&self.state);
            // Requests of this caller that already wait come first.
            let is_first = !state.waiting.contains_key(&caller.id());
            if is_first && state.slots.take(caller, 1).is_ok() {
                return Ok(Turn { turns: self.clone(), caller: caller.clone() });
            }
            state.places.take(caller, 1).map_err(|_| NoTurn::Busy)?;
            let (grant, granted) = oneshot::channel();
            let ticket = state.wait(caller, grant);
            Waiting { turns: self, caller, ticket, granted: Some(granted) }
        };
        let granted = match &mut waiting.granted {
            Some(granted) => granted.await,
            None => return Err(NoTurn::SentAway),
        };
        waiting.granted = None;
        match granted {
            Ok(()) => Ok(Turn { turns: self.clone(), caller: caller.clone() }),
            Err(_) => Err(NoTurn::SentAway),
        }
    }

    /// Refuses all waiting requests.
    pub(super) fn send_away(&self) {
        let mut state = locked(&self.state);
        let state = &mut *state;
        for queue in state.waiting.values() {
            state.places.give_back(&queue.caller, queue.tickets.len() as u64);
        }
        state.waiting.clear();
        state.order.clear();
    }
}

impl State {
    fn wait(&mut self, caller: &Caller, grant: oneshot::Sender<()>) -> u64 {
        let ticket = self.next_ticket;
        self.next_ticket += 1;
        let order = &mut self.order;
        let queue = self.waiting.entry(caller.id()).or_insert_with(|| {
            order.push_back(caller.id());
            Queue { caller: caller.clone(), tickets: BTreeMap::new() }
        });
        queue.tickets.insert(ticket, grant);
        ticket
    }

    /// Gives free slots to the callers whose turn it is.
    fn grant(&mut self) {
        let mut refused = 0;
        while refused < self.order.len() {
            let Some(id) = self.order.pop_front() else { return };
            let Some(queue) = self.waiting.get_mut(&id) else { continue };
            if self.slots.take(&queue.caller, 1).is_err() {
                // The next caller may hold fewer slots and be granted one.
                self.order.push_back(id);
                refused += 1;
                continue;
            }
            let caller = queue.caller.clone();
            let granted = queue.tickets.pop_first().is_some_and(|(_, grant)| {
                self.places.give_back(&caller, 1);
                grant.send(()).is_ok()
            });
            if !granted {
                self.slots.give_back(&caller, 1);
            }
            if queue.tickets.is_empty() {
                self.waiting.remove(&id);
            } else {
                self.order.push_back(id);
            }
            refused = 0;
        }
    }

    /// Removes a ticket from its queue; returns whether it was there.
    fn leave(&mut self, caller: &Caller, ticket: u64) -> bool {
        let Some(queue) = self.waiting.get_mut(&caller.id()) else { return false };
        if queue.tickets.remove(&ticket).is_none() {
            return false;
        }
        if queue.tickets.is_empty() {
            self.waiting.remove(&caller.id());
            self.order.retain(|id| *id != caller.id());
        }
        self.places.give_back(caller, 1);
        true
    }
}

/// A waiting request; it leaves the queue when its caller leaves.
struct Waiting<'a> {
    turns: &'a Arc<Turns>,
    caller: &'a Caller,
    ticket: u64,
    /// `None` when the grant has been received.
    granted: Option<oneshot::Receiver<()>>,
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        let Some(mut granted) = self.granted.take() else { return };
        let mut state = locked(&self.turns.state);
        // A slot that was granted but not received goes to the next request.
        if !state.leave(self.caller, self.ticket) && granted.try_recv().is_ok() {
            state.slots.give_back(self.caller, 1);
            state.grant();
        }
    }
}

/// A slot, free again when this is dropped.
#[derive(Debug)]
pub(super) struct Turn {
    turns: Arc<Turns>,
    caller: Caller,
}

impl Drop for Turn {
    fn drop(&mut self) {
        let mut state = locked(&self.turns.state);
        state.slots.give_back(&self.caller, 1);
        state.grant();
    }
}

#[cfg(test)]
mod tests {
    use std::{future::Future, pin::Pin};

    use futures_util::{FutureExt, poll};

    use super::*;
    use crate::budget::{CallerKey, Callers};

    type Taking<'a> = Pin<Box<dyn Future<Output = Result<Turn, NoTurn>> + 'a>>;

    fn callers() -> Vec<Caller> {
        let callers = Arc::new(Callers::default());
        (0..3).map(|user| callers.get(CallerKey::User(user))).collect()
    }

    /// Whether all slots are free and no request waits.
    fn is_idle(turns: &Turns) -> bool {
        let state = locked(&turns.state);
        state.slots.used() + state.places.used() == 0 && state.waiting.is_empty() && state.order.is_empty()
    }

    /// Takes slots until a request would have to wait.
    fn take_all(turns: &Arc<Turns>, caller: &Caller) -> Vec<Turn> {
        std::iter::from_fn(|| turns.take(caller).now_or_never().and_then(Result::ok)).collect()
    }

    /// Catches one caller that gets all slots, and a caller whose many requests all come before
    /// another caller's single request.
    #[tokio::test]
    async fn callers_take_turns() {
        let (turns, callers) = (Turns::new(8, 100, true), callers());
        let mut greedy = take_all(&turns, &callers[0]);
        assert_eq!(greedy.len(), 4, "half of the slots");
        let others = [take_all(&turns, &callers[1]), take_all(&turns, &callers[2])];
        assert_eq!(others.each_ref().map(Vec::len), [2, 1]);
        let mut many: Vec<Taking<'_>> =
            (0..10).map(|_| Box::pin(turns.take(&callers[0])) as Taking<'_>).collect();
        for waiting in &mut many {
            assert!(poll!(waiting.as_mut()).is_pending());
        }
        let mut single: Taking<'_> = Box::pin(turns.take(&callers[2]));
        assert!(poll!(single.as_mut()).is_pending());
        greedy.truncate(2);
        assert!(poll!(single.as_mut()).is_ready());
        assert!(poll!(many[0].as_mut()).is_pending());
        drop((greedy, others));
        // Four of them are granted now, the rest when those end.
        let mut served = 0;
        while let Some(next) = many.first_mut() {
            assert!(poll!(next.as_mut()).is_ready(), "{served}");
            drop(many.remove(0));
            served += 1;
        }
        assert_eq!(served, 10);
    }

    /// Catches a place or a slot that is lost when a request leaves: while it waits, after it was
    /// granted a slot that it has not received, and when all waiting requests are refused.
    #[tokio::test]
    async fn requests_that_go_away_leave_nothing_behind() {
        let (turns, callers) = (Turns::new(2, 8, true), callers());
        for _ in 0..3 {
            let held = take_all(&turns, &callers[0]);
            assert_eq!(held.len(), 1);
            let mut waiting: Vec<Taking<'_>> =
                (0..4).map(|_| Box::pin(turns.take(&callers[0])) as Taking<'_>).collect();
            for waiting in &mut waiting {
                assert!(poll!(waiting.as_mut()).is_pending());
            }
            assert_eq!(turns.take(&callers[0]).await.unwrap_err(), NoTurn::Busy);
            drop(waiting.remove(2));
            drop(held);
            drop(waiting.remove(0));
            assert!(poll!(waiting[0].as_mut()).is_ready(), "granted in place of the one that went");
            drop(waiting);
            assert!(is_idle(&turns));
        }
        let held = take_all(&turns, &callers[0]);
        let mut waiting: Taking<'_> = Box::pin(turns.take(&callers[0]));
        assert!(poll!(waiting.as_mut()).is_pending());
        turns.send_away();
        assert_eq!(waiting.await.unwrap_err(), NoTurn::SentAway);
        drop(held);
        assert!(is_idle(&turns));
    }
}

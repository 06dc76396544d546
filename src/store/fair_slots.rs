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
pub(super) struct FairSlots {
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    slots: Shares,
    queued: Shares,
    /// The queues by the caller's id. Each id in it is in `order` exactly once.
    waiting: HashMap<u64, CallerQueue>,
    order: VecDeque<u64>,
    next_ticket: u64,
}

/// One caller's waiting requests, the oldest first.
#[derive(Debug)]
struct CallerQueue {
    caller: Caller,
    tickets: BTreeMap<u64, oneshot::Sender<()>>,
}

/// The reason why a request gets no slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NoSlot {
    /// Too many of this caller's requests wait already.
    Busy,
    /// All waiting requests were refused.
    Refused,
}

impl FairSlots {
    /// `slots` may be used at a time, and `most_waiting` requests may wait. `shares` says whether callers
    /// share both by dynamic thresholds; a single slot cannot be shared.
    pub(super) fn new(slots: u64, most_waiting: u64, shares: bool) -> Arc<Self> {
        Arc::new(Self {
            state: Mutex::new(State {
                slots: Shares::new(slots, shares && slots > 1),
                queued: Shares::new(most_waiting, shares),
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
    pub(super) async fn take(self: &Arc<Self>, caller: &Caller) -> Result<FairSlot, NoSlot> {
        let mut waiting = {
            let mut state = locked(&self.state);
            // Requests of this caller that already wait come first.
            let is_first = !state.waiting.contains_key(&caller.id());
            if is_first && state.slots.take(caller, 1).is_ok() {
                return Ok(FairSlot { slots: self.clone(), caller: caller.clone() });
            }
            state.queued.take(caller, 1).map_err(|_| NoSlot::Busy)?;
            let (grant, granted) = oneshot::channel();
            let ticket = state.wait(caller, grant);
            WaitingRequest { slots: self, caller, ticket, granted, is_answered: false }
        };
        let granted = (&mut waiting.granted).await;
        waiting.is_answered = true;
        match granted {
            Ok(()) => Ok(FairSlot { slots: self.clone(), caller: caller.clone() }),
            Err(_) => Err(NoSlot::Refused),
        }
    }

    /// Refuses all waiting requests.
    pub(super) fn refuse_waiting(&self) {
        let mut state = locked(&self.state);
        let state = &mut *state;
        for queue in state.waiting.values() {
            state.queued.give_back(&queue.caller, queue.tickets.len() as u64);
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
            CallerQueue { caller: caller.clone(), tickets: BTreeMap::new() }
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
                self.queued.give_back(&caller, 1);
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
        self.queued.give_back(caller, 1);
        true
    }
}

/// A waiting request; it leaves the queue when its caller leaves.
struct WaitingRequest<'a> {
    slots: &'a Arc<FairSlots>,
    caller: &'a Caller,
    ticket: u64,
    granted: oneshot::Receiver<()>,
    /// Whether the grant or the refusal has been received.
    is_answered: bool,
}

impl Drop for WaitingRequest<'_> {
    fn drop(&mut self) {
        if self.is_answered {
            return;
        }
        let mut state = locked(&self.slots.state);
        // A slot that was granted but not received goes to the next request.
        if !state.leave(self.caller, self.ticket) && self.granted.try_recv().is_ok() {
            state.slots.give_back(self.caller, 1);
            state.grant();
        }
    }
}

/// A slot, free again when this is dropped.
#[derive(Debug)]
pub(super) struct FairSlot {
    slots: Arc<FairSlots>,
    caller: Caller,
}

impl Drop for FairSlot {
    fn drop(&mut self) {
        let mut state = locked(&self.slots.state);
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

    type SlotRequest<'a> = Pin<Box<dyn Future<Output = Result<FairSlot, NoSlot>> + 'a>>;

    fn callers() -> Vec<Caller> {
        let callers = Arc::new(Callers::default());
        (0..3).map(|user| callers.get(CallerKey::User(user))).collect()
    }

    /// Whether all slots are free and no request waits.
    fn is_idle(slots: &FairSlots) -> bool {
        let state = locked(&slots.state);
        state.slots.used() + state.queued.used() == 0 && state.waiting.is_empty() && state.order.is_empty()
    }

    /// Takes slots until a request would have to wait.
    fn take_all(slots: &Arc<FairSlots>, caller: &Caller) -> Vec<FairSlot> {
        std::iter::from_fn(|| slots.take(caller).now_or_never().and_then(Result::ok)).collect()
    }

    /// Catches one caller that gets all slots, and a caller whose many requests all come before
    /// another caller's single request.
    #[tokio::test]
    async fn callers_take_turns() {
        let (slots, callers) = (FairSlots::new(8, 100, true), callers());
        let mut greedy = take_all(&slots, &callers[0]);
        assert_eq!(greedy.len(), 4, "half of the slots");
        let others = [take_all(&slots, &callers[1]), take_all(&slots, &callers[2])];
        assert_eq!(others.each_ref().map(Vec::len), [2, 1]);
        let mut many: Vec<SlotRequest<'_>> =
            (0..10).map(|_| Box::pin(slots.take(&callers[0])) as SlotRequest<'_>).collect();
        for waiting in &mut many {
            assert!(poll!(waiting.as_mut()).is_pending());
        }
        let mut single: SlotRequest<'_> = Box::pin(slots.take(&callers[2]));
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

    /// Catches a slot, or a place among the waiting requests, that is lost when a request leaves: while it
    /// waits, after it was granted a slot that it has not received, and when all waiting requests are refused.
    #[tokio::test]
    async fn requests_that_go_away_leave_nothing_behind() {
        let (slots, callers) = (FairSlots::new(2, 8, true), callers());
        for _ in 0..3 {
            let held = take_all(&slots, &callers[0]);
            assert_eq!(held.len(), 1);
            let mut waiting: Vec<SlotRequest<'_>> =
                (0..4).map(|_| Box::pin(slots.take(&callers[0])) as SlotRequest<'_>).collect();
            for waiting in &mut waiting {
                assert!(poll!(waiting.as_mut()).is_pending());
            }
            assert_eq!(slots.take(&callers[0]).await.unwrap_err(), NoSlot::Busy);
            drop(waiting.remove(2));
            drop(held);
            drop(waiting.remove(0));
            assert!(poll!(waiting[0].as_mut()).is_ready(), "granted in place of the one that went");
            drop(waiting);
            assert!(is_idle(&slots));
        }
        let held = take_all(&slots, &callers[0]);
        let mut waiting: SlotRequest<'_> = Box::pin(slots.take(&callers[0]));
        assert!(poll!(waiting.as_mut()).is_pending());
        slots.refuse_waiting();
        assert_eq!(waiting.await.unwrap_err(), NoSlot::Refused);
        drop(held);
        assert!(is_idle(&slots));
    }
}

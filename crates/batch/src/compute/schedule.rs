//! The order in which threads take work: turns between callers, then between the pieces of work of
//! one caller. The algorithm is start-time fair queueing.
//!
//! Callers share the threads by cost, not by number of parts. Each caller has a *virtual time*, which
//! advances by the steps that its parts cost. The next part comes from the caller with the least
//! virtual time:
//!
//! ```text
//! push(caller, work):  if the caller has no waiting work: time = max(time, now)
//!                      append the work to the caller's list
//! take():              caller = the one with waiting work and the least time
//!                      part = the next part of the caller's first piece of work
//!                      move that piece of work to the end of the list, or remove it if it has no more parts
//!                      now = max(now, time);  time = time + estimate(part)
//! done(part):          time = time - estimate(part) + metered steps
//! ```
//!
//! Callers that always have work therefore get equal shares of the threads, whatever their parts
//! cost. A part is charged with an estimate when it is taken, so that several threads do not all
//! take parts of one caller, and the charge is corrected by the metered steps when the part is done.
//! `now` is the virtual time at which the last part began. A caller that returns after a pause
//! starts at `now` at least. So no caller saves up turns while it is idle; and since a time above
//! `now` is kept, no caller gets rid of a debt by pausing.
//!
//! Each operation takes `O(log n)` steps for `n` callers, besides finding a piece of work that is
//! removed. Fairness by a fixed order of callers (round robin) would favour callers with costly
//! parts. The paper is P. Goyal, H. M. Vin and H. Cheng, *Start-time Fair Queueing*, IEEE/ACM
//! Transactions on Networking 5(5), 1997, section II, doi:10.1109/90.649569. A departure: the paper
//! knows the length of a packet when it is sent; here the cost of a part is known only afterwards.

use std::collections::{BTreeMap, VecDeque};

use crate::ById;

/// Settled accounts are swept out once there are more accounts than this plus twice the number of
/// callers with waiting work. Fewer accounts are not worth a sweep.
const SPARE_ACCOUNTS: usize = 64;

/// The work of all callers that waits for threads.
#[derive(Debug)]
pub(super) struct Schedule<W> {
    accounts: ById<u64, Account<W>>,
    /// The callers with waiting work, by virtual time and place. If callers have the same time, the one
    /// that has waited longest is first.
    order: BTreeMap<(u64, u64), u64>,
    /// The virtual time at which the last part began.
    now: u64,
    /// The number of parts that are taken and not done.
    running: usize,
    /// The last number given to a piece of work or to a place in the order.
    next_number: u64,
}

/// The account of one caller.
#[derive(Debug)]
struct Account<W> {
    /// The virtual time of the caller, in steps.
    time: u64,
    /// The second half of the caller's key in the order; the time is the first half.
    place: u64,
    /// The number of parts of this caller that are taken and not done.
    running: usize,
    waiting: VecDeque<WaitingWork<W>>,
}

/// A piece of work of which some parts have not been taken.
#[derive(Debug)]
struct WaitingWork<W> {
    number: u64,
    work: W,
    next: usize,
    count: usize,
}

/// The result of [`Schedule::take`].
#[derive(Debug)]
pub(super) enum Next<W> {
    /// The next part.
    Part(ScheduledPart<W>),
    /// Work that was stopped before all of its parts were taken.
    Stopped(W),
}

/// A part that a thread has taken.
#[derive(Debug)]
pub(super) struct ScheduledPart<W> {
    pub(super) work: W,
    pub(super) index: usize,
    pub(super) caller: u64,
    /// The number of steps that the caller was charged with.
    pub(super) estimate: u64,
}

impl<W> Default for Schedule<W> {
    fn default() -> Self {
        Self { accounts: ById::default(), order: BTreeMap::new(), now: 0, running: 0, next_number: 0 }
    }
}

impl<W: Clone> Schedule<W> {
    /// Adds work of `count` parts, at least one. Returns a number that identifies the work.
    pub(super) fn push(&mut self, caller: u64, work: W, count: usize) -> u64 {
        if self.accounts.len() > SPARE_ACCOUNTS + 2 * self.order.len() {
            let now = self.now;
            self.accounts.retain(|_, account| !account.is_settled(now));
        }
        let number = self.number();
        let now = self.now;
        let account = self.accounts.entry(caller).or_insert_with(Account::new);
        let was_idle = account.waiting.is_empty();
        account.waiting.push_back(WaitingWork { number, work, next: 0, count });
        if was_idle {
            account.time = account.time.max(now);
            self.enqueue(caller);
        }
        number
    }

    /// Takes the next part and charges its caller with `estimate(work, index)` steps. If the next work
    /// `is_stopped`, removes it and returns [`Next::Stopped`]. Returns `None` if no work waits.
    pub(super) fn take(
        &mut self,
        is_stopped: impl Fn(&W) -> bool,
        estimate: impl Fn(&W, usize) -> u64,
    ) -> Option<Next<W>> {
        loop {
            let ((time, _), caller) = self.order.pop_first()?;
            let Some(account) = self.accounts.get_mut(&caller) else { continue };
            let Some(mut first) = account.waiting.pop_front() else { continue };
            if is_stopped(&first.work) {
                self.enqueue(caller);
                self.forget_if_settled(caller);
                return Some(Next::Stopped(first.work));
            }
            let (work, index) = (first.work.clone(), first.next);
            first.next += 1;
            if first.next < first.count {
                account.waiting.push_back(first);
            }
            let estimate = estimate(&work, index);
            account.time = time.saturating_add(estimate);
            account.running += 1;
            self.running += 1;
            self.now = self.now.max(time);
            self.enqueue(caller);
            return Some(Next::Part(ScheduledPart { work, index, caller, estimate }));
        }
    }

    /// Records that a part is done, and replaces its estimated cost by the `metered` steps.
    pub(super) fn done(&mut self, caller: u64, estimate: u64, metered: u64) {
        self.running = self.running.saturating_sub(1);
        if let Some(account) = self.accounts.get_mut(&caller) {
            self.order.remove(&(account.time, account.place));
            account.running = account.running.saturating_sub(1);
            account.time = account.time.saturating_sub(estimate).saturating_add(metered);
            self.enqueue(caller);
        }
        if self.running == 0 && self.order.is_empty() {
            // No caller has work, so no caller owes anything to another.
            self.accounts.clear();
            return;
        }
        self.forget_if_settled(caller);
    }

    /// Removes the work with this number, because no caller waits for it any more. Returns `None` if all
    /// of its parts have been taken.
    pub(super) fn remove(&mut self, caller: u64, number: u64) -> Option<W> {
        let account = self.accounts.get_mut(&caller)?;
        let at = account.waiting.iter().position(|waiting| waiting.number == number)?;
        let removed = account.waiting.remove(at);
        if account.waiting.is_empty() {
            self.order.remove(&(account.time, account.place));
            self.forget_if_settled(caller);
        }
        removed.map(|removed| removed.work)
    }

    /// Removes and returns all work.
    pub(super) fn clear(&mut self) -> Vec<W> {
        self.order.clear();
        let accounts = self.accounts.drain().flat_map(|(_, account)| account.waiting);
        accounts.map(|waiting| waiting.work).collect()
    }

    /// Puts a caller into the order, if it has waiting work, behind other callers of the same time.
    fn enqueue(&mut self, caller: u64) {
        let place = self.number();
        if let Some(account) = self.accounts.get_mut(&caller)
            && !account.waiting.is_empty()
        {
            account.place = place;
            self.order.insert((account.time, place), caller);
        }
    }

    /// Removes the account of a caller that has neither work nor a debt.
    fn forget_if_settled(&mut self, caller: u64) {
        if self.accounts.get(&caller).is_some_and(|account| account.is_settled(self.now)) {
            self.accounts.remove(&caller);
        }
    }

    fn number(&mut self) -> u64 {
        self.next_number += 1;
        self.next_number
    }
}

impl<W> Account<W> {
    fn new() -> Self {
        Self { time: 0, place: 0, running: 0, waiting: VecDeque::new() }
    }

    /// Whether the account can be removed: a new account would get the same turns.
    fn is_settled(&self, now: u64) -> bool {
        self.waiting.is_empty() && self.running == 0 && self.time <= now
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    /// Work for the tests: a letter, and the steps that each of its parts costs.
    type Work = (char, u64);

    /// Takes `count` parts on one thread, each estimated at 10 steps. Returns the letters in order, and
    /// the sum of the steps of each letter.
    fn taken(schedule: &mut Schedule<Work>, count: usize) -> (String, HashMap<char, u64>) {
        let (mut letters, mut steps) = (String::new(), HashMap::new());
        for _ in 0..count {
            let Some(Next::Part(part)) = schedule.take(|_| false, |_, _| 10) else { break };
            let (letter, cost) = part.work;
            letters.push(letter);
            *steps.entry(letter).or_default() += cost;
            schedule.done(part.caller, part.estimate, cost);
        }
        (letters, steps)
    }

    /// Catches a caller that gets more of the threads than another because its parts cost more, or
    /// because it has more pieces of work.
    #[test]
    fn callers_get_equal_steps_whatever_their_parts_cost() {
        let mut schedule = Schedule::default();
        schedule.push(1, ('a', 1000), 10_000);
        for _ in 0..50 {
            schedule.push(2, ('b', 10), 10_000);
        }
        schedule.push(3, ('c', 70), 10_000);
        let (_, steps) = taken(&mut schedule, 20_000);
        let most = steps.values().max().unwrap();
        for (letter, steps) in &steps {
            assert!(most - steps <= 2 * 1000, "{letter} got {steps} of {most}");
        }
        assert!(*most > 100_000);
    }

    /// Catches parts out of order, and a piece of work that waits for all of another piece of the same
    /// caller.
    #[test]
    fn one_callers_pieces_take_turns() {
        let mut schedule = Schedule::default();
        schedule.push(1, ('a', 10), 4);
        schedule.push(1, ('b', 10), 2);
        schedule.push(2, ('c', 10), 3);
        assert_eq!(taken(&mut schedule, 100).0, "acbcacbaa");
        assert!(schedule.accounts.is_empty() && schedule.order.is_empty());
    }

    /// Catches turns that are saved up while a caller is idle, and a debt that a pause wipes out: a
    /// caller that sends one costly part at a time must get no more than a caller with cheap parts.
    #[test]
    fn pauses_neither_save_nor_wipe_out() {
        let mut schedule = Schedule::default();
        schedule.push(1, ('a', 10), 100_000);
        assert_eq!(taken(&mut schedule, 1000).1[&'a'], 10_000);
        // The second caller comes late and gets nothing for the turns that it missed.
        schedule.push(2, ('b', 10), 100);
        let (letters, _) = taken(&mut schedule, 100);
        assert_eq!(letters.matches('b').count(), 50);
        let mut steps = HashMap::from([('a', 0), ('c', 0)]);
        for _ in 0..2000 {
            if schedule.accounts.get(&3).is_none_or(|account| account.waiting.is_empty()) {
                schedule.push(3, ('c', 500), 1);
            }
            for (letter, more) in taken(&mut schedule, 1).1 {
                *steps.entry(letter).or_default() += more;
            }
        }
        assert!(steps[&'c'] > 1000 && steps[&'c'] <= steps[&'a'] + 2 * 500, "{steps:?}");
    }

    /// Catches several threads that all take parts of one caller before the first part is metered.
    #[test]
    fn parts_under_way_count_by_their_estimate() {
        let mut schedule = Schedule::default();
        schedule.push(1, ('a', 10), 100);
        schedule.push(2, ('b', 10), 100);
        let mut letters = String::new();
        for _ in 0..6 {
            let Some(Next::Part(part)) = schedule.take(|_| false, |_, _| 10) else { panic!("no part") };
            letters.push(part.work.0);
        }
        assert_eq!(letters, "ababab");
    }

    /// Catches stopped work that is begun, removed work that is begun all the same, and accounts that
    /// are never removed.
    #[test]
    fn stopped_and_removed_work_is_not_begun() {
        let mut schedule = Schedule::default();
        schedule.push(1, ('a', 10), 3);
        let b = schedule.push(1, ('b', 10), 3);
        let c = schedule.push(2, ('c', 10), 3);
        schedule.push(3, ('d', 10), 2);
        assert_eq!(schedule.remove(1, b), Some(('b', 10)));
        assert_eq!(schedule.remove(1, b), None);
        assert_eq!(schedule.remove(2, c), Some(('c', 10)));
        let (mut stopped, mut begun) = (Vec::new(), String::new());
        while let Some(taken) = schedule.take(|work| work.0 == 'a', |_, _| 10) {
            match taken {
                Next::Stopped(work) => stopped.push(work),
                Next::Part(part) => {
                    begun.push(part.work.0);
                    schedule.done(part.caller, part.estimate, 10);
                }
            }
        }
        assert_eq!((&stopped[..], &begun[..]), (&[('a', 10)][..], "dd"));
        assert!(schedule.accounts.is_empty());
        for caller in 0..10_000 {
            schedule.push(caller, ('e', 10), 1);
            if caller % 2 == 0 {
                taken(&mut schedule, 1);
            }
        }
        assert!(schedule.accounts.len() <= SPARE_ACCOUNTS + 2 * schedule.order.len() + 1);
        assert_eq!(schedule.clear().len(), 5000);
    }
}

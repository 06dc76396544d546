//! Shares a quantity between callers by dynamic thresholds.
//!
//! A caller may take more only if it then holds at most as much as stays free. A single caller can
//! therefore use half of the quantity. With n greedy callers, each gets 1/(n+1) of it, and a share of
//! 1/(n+1) always stays free for a caller that comes later. The rule needs no configuration and no count of
//! callers, and costs one comparison. It is used for the memory budget, the leases on cached hulls, the
//! places of admission and of the store, and connections.
//!
//! A. K. Choudhury and E. L. Hahne, *Dynamic Queue Length Thresholds for Shared-Memory Packet
//! Switches*, IEEE/ACM Transactions on Networking 6(2), 1998, section III,
//! doi:10.1109/90.664262 (with their factor alpha = 1).

use std::sync::{Arc, Mutex};

use super::{ById, Caller};
use crate::lock::locked;

/// The reason why a caller cannot take more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShareRefusal {
    /// There is not enough left for this caller now. A later retry can succeed.
    Busy,
    /// The amount would not fit even if no other caller held anything.
    TooLarge,
}

/// A quantity that callers share by dynamic thresholds. Its owner has to lock it.
#[derive(Debug)]
pub struct Shares {
    limit: u64,
    /// If false, any caller may take everything that is free.
    dynamic: bool,
    used: u64,
    held: ById<u64, u64>,
}

impl Shares {
    /// A quantity of `limit`, all of it free.
    pub fn new(limit: u64, dynamic: bool) -> Self {
        Self { limit, dynamic, used: 0, held: ById::default() }
    }

    /// The whole quantity.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// The amount that all callers hold together.
    pub fn used(&self) -> u64 {
        self.used
    }

    /// The amount that one caller holds.
    pub fn held(&self, caller: &Caller) -> u64 {
        self.held.get(&caller.id()).copied().unwrap_or(0)
    }

    /// The most that one caller can hold if no other caller holds anything.
    pub fn most_alone(&self) -> u64 {
        if self.dynamic { self.limit / 2 } else { self.limit }
    }

    /// Adds `amount` to the holding of `caller`.
    ///
    /// # Errors
    /// The caller would hold more than its share. Then nothing is added.
    pub fn take(&mut self, caller: &Caller, amount: u64) -> Result<(), ShareRefusal> {
        self.take_shared(caller, amount, amount)
    }

    /// Adds `amount` to the holding of `caller`. Other callers hold all of it already, except `new`.
    ///
    /// # Errors
    /// The caller would hold more than its share. Then nothing is added.
    pub fn take_shared(&mut self, caller: &Caller, amount: u64, new: u64) -> Result<(), ShareRefusal> {
        if amount == 0 {
            return Ok(());
        }
        let held_after = self.held(caller).saturating_add(amount);
        if held_after > self.most_alone() {
            return Err(ShareRefusal::TooLarge);
        }
        let free_after = self.limit.saturating_sub(self.used).checked_sub(new).ok_or(ShareRefusal::Busy)?;
        if self.dynamic && held_after > free_after {
            return Err(ShareRefusal::Busy);
        }
        self.used += new;
        self.held.insert(caller.id(), held_after);
        Ok(())
    }

    /// Subtracts `amount` from the holding of `caller`.
    pub fn give_back(&mut self, caller: &Caller, amount: u64) {
        self.give_back_shared(caller, amount, amount);
    }

    /// Subtracts `amount` from the holding of `caller`. Other callers still hold all of it, except `free`.
    pub fn give_back_shared(&mut self, caller: &Caller, amount: u64, free: u64) {
        self.used = self.used.saturating_sub(free);
        if let Some(held) = self.held.get_mut(&caller.id()) {
            *held = held.saturating_sub(amount);
            if *held == 0 {
                self.held.remove(&caller.id());
            }
        }
    }
}

/// Slots that callers share by dynamic thresholds.
#[derive(Debug)]
pub struct Slots(Mutex<Shares>);

impl Slots {
    /// `count` slots, all free.
    pub fn new(count: u64) -> Arc<Self> {
        Arc::new(Self(Mutex::new(Shares::new(count, true))))
    }

    /// A slot for `caller`, or `None` if the caller already has its share.
    pub fn take(self: &Arc<Self>, caller: &Caller) -> Option<Slot> {
        locked(&self.0).take(caller, 1).ok()?;
        Some(Slot { slots: self.clone(), caller: caller.clone() })
    }
}

/// One slot, free again when this is dropped.
#[derive(Debug)]
pub struct Slot {
    slots: Arc<Slots>,
    caller: Caller,
}

impl Drop for Slot {
    fn drop(&mut self) {
        locked(&self.slots.0).give_back(&self.caller, 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::{CallerKey, Callers};

    fn callers(count: u32) -> Vec<Caller> {
        let callers = Arc::new(Callers::default());
        (0..count).map(|user| callers.get(CallerKey::User(user))).collect()
    }

    /// Catches a greedy caller that leaves nothing for callers that come later: n greedy callers must get
    /// 1/(n+1) each, in whatever order they take.
    #[test]
    fn greedy_callers_leave_a_share_free() {
        for count in [1, 2, 5] {
            let callers = callers(count);
            let mut shares = Shares::new(1 << 20, true);
            let mut refused = 0;
            while refused < count {
                refused = 0;
                for caller in &callers {
                    refused += u32::from(shares.take(caller, 64).is_err());
                }
            }
            let fair = (1 << 20) / (u64::from(count) + 1);
            for caller in &callers {
                assert!(shares.held(caller).abs_diff(fair) <= 64 * u64::from(count), "{count}");
            }
            let late = Caller::alone();
            assert_eq!(shares.take(&late, fair / 4), Ok(()));
        }
    }

    /// Catches a request that can never fit but is told to retry.
    #[test]
    fn an_amount_that_never_fits_is_not_refused_as_busy() {
        let callers = callers(2);
        let mut shares = Shares::new(1000, true);
        assert_eq!(shares.take(&callers[0], 501), Err(ShareRefusal::TooLarge));
        assert_eq!(shares.take(&callers[0], 500), Ok(()));
        assert_eq!(shares.take(&callers[1], 300), Err(ShareRefusal::Busy));
        shares.give_back(&callers[0], 500);
        assert_eq!(shares.take(&callers[1], 300), Ok(()));
        assert_eq!(shares.used(), 300);
    }

    /// Catches a slot that is not given back, and a caller that takes the last one.
    #[test]
    fn slots_are_shared_and_given_back() {
        let slots = Slots::new(8);
        let callers = callers(2);
        let greedy: Vec<_> = std::iter::from_fn(|| slots.take(&callers[0])).collect();
        assert_eq!(greedy.len(), 4);
        assert!(slots.take(&callers[1]).is_some());
        drop(greedy);
        assert_eq!(locked(&slots.0).used(), 0);
    }
}

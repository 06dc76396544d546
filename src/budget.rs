//! Limits the memory that callers can make the server hold, and shares it between them.
//!
//! [`MemoryBudget`] limits everything that a caller can make the server hold: bytes that arrive, decoded
//! columns, hulls being built, answers until they are sent, the state of streams, and the windows of
//! connections. Code takes a [`Permit`] before it allocates memory, and drops it when the memory is free
//! again. Each permit belongs to one [`Part`], so that operators see which part is full. Callers
//! ([`Caller`]) share the budget by the rule of [`Shares`].
//!
//! This module knows neither gRPC nor HTTP.

mod caller;
mod shares;

use std::sync::{Arc, Mutex};

pub use caller::{Caller, CallerKey, CallerStream, Callers, is_reserved_name};
pub(crate) use hullcast_batch::ById;
pub use shares::{ShareRefusal, Shares, Slot, Slots};

use thiserror::Error;

use crate::lock::locked;

/// Declares every part of the budget in one place: its variant, its name in metrics and in `GetServerInfo`,
/// and the memory that it counts.
macro_rules! parts {
    ($($(#[doc = $doc:literal])* $part:ident = $name:literal;)*) => {
        /// The use of a permit's memory.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Part {
            $($(#[doc = $doc])* $part,)*
        }

        impl Part {
            /// All parts, in the order of the enum.
            pub const ALL: &'static [Self] = &[$(Self::$part),*];

            /// The part's name in metrics and in `GetServerInfo`.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$part => $name,)*
                }
            }
        }
    };
}

parts! {
    /// HTTP/2 windows, and the fixed cost of each open connection.
    Connections = "connections";
    /// Bytes of request messages that have arrived and are not decoded yet.
    Arriving = "arriving";
    /// Decoded requests: columns, scenes, hull definitions.
    Decoded = "decoded";
    /// Hulls that wait to be built or are being built, with the memory that building takes.
    Building = "building";
    /// Answers, from their first computed column until the transport has sent them.
    Answers = "answers";
    /// The state that streams keep from one message to the next.
    StreamState = "stream_state";
}

const PARTS: usize = Part::ALL.len();

/// The reason why a caller gets no memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("{} (part {})", refused(*.refusal), .part.name())]
pub struct NoMemory {
    /// The part for which the memory was requested.
    pub part: Part,
    /// Whether a retry can succeed.
    pub refusal: ShareRefusal,
}

/// The refusal as a sentence.
fn refused(refusal: ShareRefusal) -> &'static str {
    match refusal {
        ShareRefusal::Busy => "the memory budget has no room for this caller now",
        ShareRefusal::TooLarge => "the call needs more memory than one caller may hold",
    }
}

/// The memory that all callers together can make the server hold.
#[derive(Debug)]
pub struct MemoryBudget {
    limit: u64,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    shares: Shares,
    parts: [u64; PARTS],
    /// The parts with a cap. Callers share each of them as they share the whole budget, since one caller
    /// could otherwise hold all of it.
    capped: [Option<Shares>; PARTS],
}

impl MemoryBudget {
    /// A budget of `limit` bytes. `shares` tells whether callers share it by dynamic thresholds. `caps`
    /// limit single parts.
    pub fn new(limit: u64, shares: bool, caps: &[(Part, u64)]) -> Arc<Self> {
        let mut state = State {
            shares: Shares::new(limit, shares),
            parts: [0; PARTS],
            capped: std::array::from_fn(|_| None),
        };
        for &(part, cap) in caps {
            state.capped[part as usize] = Some(Shares::new(cap, shares));
        }
        Arc::new(Self { limit, state: Mutex::new(state) })
    }

    /// A budget without a limit, for code that runs outside a server.
    pub fn unlimited() -> Arc<Self> {
        Self::new(u64::MAX, false, &[])
    }

    /// The size of the whole budget in bytes.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// The most bytes that all callers together may hold for `part`, or `None` if only the whole budget
    /// limits it.
    pub fn cap(&self, part: Part) -> Option<u64> {
        locked(&self.state).capped[part as usize].as_ref().map(Shares::limit)
    }

    /// The bytes that one caller holds.
    pub fn held(&self, caller: &Caller) -> u64 {
        locked(&self.state).shares.held(caller)
    }

    /// The bytes that all callers hold for `part`.
    pub fn used_by(&self, part: Part) -> u64 {
        locked(&self.state).parts[part as usize]
    }

    /// The bytes that all callers hold together.
    pub fn used(&self) -> u64 {
        locked(&self.state).shares.used()
    }

    /// Takes `bytes` for `caller`. The bytes are free again when the permit is dropped.
    ///
    /// # Errors
    /// The budget, its part or the caller's share has no room. In that case nothing is taken.
    pub fn take(self: &Arc<Self>, caller: &Caller, part: Part, bytes: u64) -> Result<Permit, NoMemory> {
        self.of(caller).take(part, bytes)
    }

    /// The budget as one caller uses it.
    pub fn of(self: &Arc<Self>, caller: &Caller) -> CallerBudget {
        CallerBudget(Arc::new(Holder { budget: self.clone(), caller: caller.clone() }))
    }
}

/// The budget as one caller uses it. Each call has an `Arc` of its own, because each permit clones and drops
/// it: a reference count that all calls share would be contended.
#[derive(Clone, Debug)]
pub struct CallerBudget(Arc<Holder>);

#[derive(Debug)]
struct Holder {
    budget: Arc<MemoryBudget>,
    caller: Caller,
}

impl CallerBudget {
    /// Takes `bytes`. They are free again when the permit is dropped.
    ///
    /// # Errors
    /// The budget, its part or the caller's share has no room. Then nothing is taken.
    pub fn take(&self, part: Part, bytes: u64) -> Result<Permit, NoMemory> {
        let mut permit = self.covered(part, 0);
        permit.grow(bytes)?;
        Ok(permit)
    }

    /// An empty permit whose first `covered` bytes take nothing from the budget, because another permit of
    /// the call has already taken them.
    pub fn covered(&self, part: Part, covered: u64) -> Permit {
        Permit { holder: self.0.clone(), part, bytes: 0, covered }
    }
}

/// Bytes that a caller holds for one part. They are free again when this is dropped.
#[derive(Debug)]
pub struct Permit {
    holder: Arc<Holder>,
    part: Part,
    bytes: u64,
    /// The number of the first bytes, which another permit has taken from the budget.
    covered: u64,
}

impl Permit {
    /// A permit without a limit, for code that runs outside a server.
    pub fn unbounded(part: Part) -> Self {
        MemoryBudget::unlimited().of(&Caller::alone()).covered(part, 0)
    }

    /// The number of bytes that the permit holds, including the covered ones.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Takes `more` bytes.
    ///
    /// # Errors
    /// There is no room for them. The permit keeps the bytes that it had.
    pub fn grow(&mut self, more: u64) -> Result<(), NoMemory> {
        let bytes_after = self.bytes.saturating_add(more);
        self.charge(bytes_after.saturating_sub(self.covered) - self.charged())?;
        self.bytes = bytes_after;
        Ok(())
    }

    /// Takes the covered bytes from the budget too, for a permit that outlives the one that covers them.
    ///
    /// # Errors
    /// There is no room for them. The permit keeps the bytes that it had.
    pub fn uncover(&mut self) -> Result<(), NoMemory> {
        self.charge(self.bytes - self.charged())?;
        self.covered = 0;
        Ok(())
    }

    /// Takes or gives back bytes, so that the permit then holds `bytes` bytes.
    ///
    /// # Errors
    /// There is no room for more. The permit keeps the bytes that it had.
    pub fn resize(&mut self, bytes: u64) -> Result<(), NoMemory> {
        self.shrink_to(bytes);
        self.grow(bytes - self.bytes)
    }

    /// Gives all bytes but the first `bytes` back. A permit that holds fewer stays as it is.
    pub fn shrink_to(&mut self, bytes: u64) {
        let charged_before = self.charged();
        self.bytes = self.bytes.min(bytes);
        let less = charged_before - self.charged();
        if less == 0 {
            return;
        }
        let Holder { budget, caller } = &*self.holder;
        let mut state = locked(&budget.state);
        state.parts[self.part as usize] = state.parts[self.part as usize].saturating_sub(less);
        state.shares.give_back(caller, less);
        if let Some(shares) = &mut state.capped[self.part as usize] {
            shares.give_back(caller, less);
        }
    }

    /// The bytes that this permit has taken from the budget.
    fn charged(&self) -> u64 {
        self.bytes.saturating_sub(self.covered)
    }

    /// Takes `more` bytes from the budget. If `more` is 0, as for small messages, nothing is locked.
    fn charge(&self, more: u64) -> Result<(), NoMemory> {
        if more == 0 {
            return Ok(());
        }
        let refused = |refusal| NoMemory { part: self.part, refusal };
        let Holder { budget, caller } = &*self.holder;
        let mut guard = locked(&budget.state);
        let state = &mut *guard;
        state.shares.take(caller, more).map_err(refused)?;
        if let Some(shares) = &mut state.capped[self.part as usize]
            && shares.take(caller, more).is_err()
        {
            state.shares.give_back(caller, more);
            return Err(refused(ShareRefusal::Busy));
        }
        state.parts[self.part as usize] += more;
        Ok(())
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        self.shrink_to(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches bytes that are not given back, given back twice, or counted for another part.
    #[test]
    fn permits_count_their_bytes_until_they_are_dropped() {
        let caller = Caller::alone();
        let budget = MemoryBudget::new(1000, false, &[(Part::Arriving, 300)]);
        let mut arriving = budget.take(&caller, Part::Arriving, 200).unwrap();
        assert_eq!(arriving.grow(101), Err(NoMemory { part: Part::Arriving, refusal: ShareRefusal::Busy }));
        arriving.grow(100).unwrap();
        let answers = budget.take(&caller, Part::Answers, 700).unwrap();
        assert_eq!(budget.used(), 1000);
        assert!(budget.take(&caller, Part::Decoded, 1).is_err());
        arriving.shrink_to(150);
        assert_eq!((arriving.bytes(), budget.used_by(Part::Arriving)), (150, 150));
        arriving.shrink_to(200);
        assert_eq!(budget.used_by(Part::Arriving), 150);
        arriving.shrink_to(50);
        assert_eq!(budget.used(), 750);
        drop((arriving, answers));
        assert!(Part::ALL.iter().all(|&part| budget.used_by(part) == 0));
        assert_eq!(budget.used(), 0);
    }

    /// Catches covered bytes that are taken from the budget, other bytes that are not, and bytes that are
    /// given back although they were never taken.
    #[test]
    fn a_permit_takes_what_is_beyond_its_covered_bytes() {
        let caller = Caller::alone();
        let budget = MemoryBudget::new(1000, false, &[]);
        let used = || budget.used_by(Part::Answers);
        let mut permit = budget.of(&caller).covered(Part::Answers, 100);
        permit.grow(60).unwrap();
        assert_eq!((permit.bytes(), used()), (60, 0));
        permit.grow(60).unwrap();
        assert_eq!((permit.bytes(), used()), (120, 20));
        assert!(permit.grow(981).is_err());
        assert_eq!((permit.bytes(), used()), (120, 20));
        permit.shrink_to(110);
        assert_eq!(used(), 10);
        permit.resize(130).unwrap();
        assert_eq!((permit.bytes(), used()), (130, 30));
        assert!(permit.resize(1101).is_err());
        assert_eq!((permit.bytes(), used()), (130, 30));
        permit.resize(50).unwrap();
        assert_eq!((permit.bytes(), used()), (50, 0));
        permit.uncover().unwrap();
        assert_eq!((permit.bytes(), used()), (50, 50));
        drop(permit);
        assert_eq!((used(), budget.used()), (0, 0));
    }

    /// Catches a caller that takes a whole part and leaves none of it for others, although the budget has
    /// room.
    #[test]
    fn callers_share_a_capped_part() {
        let callers = Arc::new(Callers::default());
        let [greedy, other] = [1, 2].map(|user| callers.get(CallerKey::User(user)));
        let budget = MemoryBudget::new(1000, true, &[(Part::Arriving, 300)]);
        let all: Vec<_> =
            std::iter::from_fn(|| budget.take(&greedy, Part::Arriving, 10).ok()).take(100).collect();
        assert_eq!(budget.used_by(Part::Arriving), 150);
        let of_other = budget.take(&other, Part::Arriving, 70).unwrap();
        let elsewhere = budget.take(&greedy, Part::Answers, 300).unwrap();
        drop((all, of_other, elsewhere));
        assert_eq!((budget.used_by(Part::Arriving), budget.used()), (0, 0));
        assert!(budget.take(&other, Part::Arriving, 150).is_ok());
    }
}

//! The memory that callers can make the server hold, and each caller's share of it.
//!
//! [`MemoryBudget`] bounds everything that a caller can make the server hold: bytes that
//! arrive, columns that are decoded, hulls that are built, answers until they are sent, the
//! state of streams, and the windows of connections. Code takes a [`Permit`] before it
//! allocates and drops it when the memory is free again. Each permit belongs to one [`Part`],
//! so that operators see which part is full.
//!
//! # Shares
//!
//! Several callers share one budget by dynamic thresholds: a caller may take more only while
//! it then holds at most as much as stays free. One caller alone can therefore use half of the
//! budget; n greedy callers each get 1/(n+1) of it, and a share of 1/(n+1) always stays free
//! for a caller who comes later. The rule needs no configuration and no count of callers, and
//! it costs one comparison. [`Shares`] is that rule; the memory budget and the leases on
//! cached hulls both use it.
//!
//! A. K. Choudhury and E. L. Hahne, *Dynamic Queue Length Thresholds for Shared-Memory Packet
//! Switches*, IEEE/ACM Transactions on Networking 6(2), 1998, section III,
//! doi:10.1109/90.664262 (with their factor alpha = 1).
//!
//! This module knows neither gRPC nor HTTP.

use std::{
    collections::HashMap,
    fmt,
    net::{IpAddr, Ipv6Addr},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError, Weak,
        atomic::{AtomicU64, Ordering},
    },
};

/// Declares every part of the budget once: its variant, its name in metrics and in
/// `GetServerInfo`, and what it counts.
macro_rules! parts {
    ($($(#[doc = $doc:literal])* $part:ident = $name:literal;)*) => {
        /// What a permit's memory is used for.
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
    /// What streams keep from one message to the next.
    StreamState = "stream_state";
}

const PARTS: usize = Part::ALL.len();

/// Who calls: the unit that shares are counted by.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum CallerKey {
    /// The name of the token that authenticated the call.
    Token(String),
    /// The peer's address; of an IPv6 address its /64 network.
    Address(IpAddr),
    /// The user at the other end of a Unix socket.
    User(u32),
    /// One connection of a trusted proxy, behind which many callers may be.
    Connection(u64),
    /// Everybody, where shares are off, and calls that did not come over a connection.
    Everyone,
}

impl CallerKey {
    /// The key of a peer's address: an IPv6 host can choose its last 64 bits freely, so they
    /// do not count.
    pub fn of_address(address: IpAddr) -> Self {
        Self::Address(match address.to_canonical() {
            IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() & !u128::from(u64::MAX)).into(),
            address @ IpAddr::V4(_) => address,
        })
    }
}

impl fmt::Display for CallerKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Token(name) => f.write_str(name),
            Self::Address(address @ IpAddr::V4(_)) => write!(f, "{address}"),
            Self::Address(address @ IpAddr::V6(_)) => write!(f, "{address}/64"),
            Self::User(user) => write!(f, "uid {user}"),
            Self::Connection(connection) => write!(f, "connection {connection}"),
            Self::Everyone => f.write_str("everyone"),
        }
    }
}

/// The callers that are known at the moment.
#[derive(Debug, Default)]
pub struct Callers {
    known: Mutex<HashMap<CallerKey, Weak<Account>>>,
    next: AtomicU64,
}

/// One caller; clones are the same caller. The caller is forgotten with the last clone.
#[derive(Clone, Debug)]
pub struct Caller(Arc<Account>);

#[derive(Debug)]
struct Account {
    key: CallerKey,
    id: u64,
    callers: Weak<Callers>,
}

impl Callers {
    /// The caller with this key: the same one for as long as anybody holds it.
    pub fn get(self: &Arc<Self>, key: CallerKey) -> Caller {
        let mut known = locked(&self.known);
        if let Some(account) = known.get(&key).and_then(Weak::upgrade) {
            return Caller(account);
        }
        let id = self.next.fetch_add(1, Ordering::Relaxed);
        let account = Arc::new(Account { key: key.clone(), id, callers: Arc::downgrade(self) });
        known.insert(key, Arc::downgrade(&account));
        Caller(account)
    }

    /// The callers that are known at the moment by the name of a token.
    pub fn named(&self) -> Vec<Caller> {
        let known = locked(&self.known);
        let named = known.iter().filter(|(key, _)| matches!(key, CallerKey::Token(_)));
        let accounts: Vec<_> = named.filter_map(|(_, account)| account.upgrade()).collect();
        // The last clone of an account takes the lock when it is dropped.
        drop(known);
        accounts.into_iter().map(Caller).collect()
    }

    /// How many callers are known at the moment.
    pub fn count(&self) -> usize {
        locked(&self.known).len()
    }
}

impl Drop for Account {
    fn drop(&mut self) {
        let Some(callers) = self.callers.upgrade() else { return };
        let mut known = locked(&callers.known);
        // Another thread may have made a new account of this key in the meantime.
        if known.get(&self.key).is_some_and(|account| account.strong_count() == 0) {
            known.remove(&self.key);
        }
    }
}

impl Caller {
    /// A caller of its own, known to nobody: for calls that did not come over a connection.
    pub fn alone() -> Self {
        Self(Arc::new(Account { key: CallerKey::Everyone, id: u64::MAX, callers: Weak::new() }))
    }

    /// A number that no other living caller has.
    pub fn id(&self) -> u64 {
        self.0.id
    }

    /// Who it is, for logs.
    pub fn key(&self) -> &CallerKey {
        &self.0.key
    }
}

/// Why a caller cannot take more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// There is not enough left for this caller now; trying again later may help.
    Busy,
    /// It would not fit even if nobody else held anything.
    TooLarge,
}

/// A quantity that callers share by dynamic thresholds. The owner locks it.
#[derive(Debug)]
pub struct Shares {
    limit: u64,
    /// Off: any caller may take all that is free.
    dynamic: bool,
    used: u64,
    held: HashMap<u64, u64>,
}

impl Shares {
    /// Nobody holds anything of `limit` yet.
    pub fn new(limit: u64, dynamic: bool) -> Self {
        Self { limit, dynamic, used: 0, held: HashMap::new() }
    }

    /// What all callers hold together.
    pub fn used(&self) -> u64 {
        self.used
    }

    /// What one caller holds.
    pub fn held(&self, caller: &Caller) -> u64 {
        self.held.get(&caller.id()).copied().unwrap_or(0)
    }

    /// The most that one caller can hold when nobody else holds anything.
    pub fn most_alone(&self) -> u64 {
        if self.dynamic { self.limit / 2 } else { self.limit }
    }

    /// Adds `amount` to what `caller` holds.
    ///
    /// # Errors
    /// The caller would hold more than its share; nothing is added.
    pub fn take(&mut self, caller: &Caller, amount: u64) -> Result<(), Refusal> {
        self.take_shared(caller, amount, amount)
    }

    /// Adds `amount` to what `caller` holds, of which only `new` is not held by others already.
    ///
    /// # Errors
    /// The caller would hold more than its share; nothing is added.
    pub fn take_shared(&mut self, caller: &Caller, amount: u64, new: u64) -> Result<(), Refusal> {
        if amount == 0 {
            return Ok(());
        }
        let held_after = self.held(caller).saturating_add(amount);
        if held_after > self.most_alone() {
            return Err(Refusal::TooLarge);
        }
        let free_after = self.limit.saturating_sub(self.used).checked_sub(new).ok_or(Refusal::Busy)?;
        if self.dynamic && held_after > free_after {
            return Err(Refusal::Busy);
        }
        self.used += new;
        self.held.insert(caller.id(), held_after);
        Ok(())
    }

    /// Subtracts `amount` from what `caller` holds.
    pub fn give_back(&mut self, caller: &Caller, amount: u64) {
        self.give_back_shared(caller, amount, amount);
    }

    /// Subtracts `amount` from what `caller` holds, of which `free` is held by nobody else.
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

/// Why there is no memory for a caller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoMemory {
    /// What the memory was wanted for.
    pub part: Part,
    /// Whether trying again may help.
    pub refusal: Refusal,
}

impl fmt::Display for NoMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.part.name();
        match self.refusal {
            Refusal::Busy => write!(f, "the memory budget has no room for this caller now (part {name})"),
            Refusal::TooLarge => write!(f, "one caller may not hold that much memory (part {name})"),
        }
    }
}

impl std::error::Error for NoMemory {}

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
    caps: [u64; PARTS],
}

impl MemoryBudget {
    /// A budget of `limit` bytes. `shares`: whether callers share it by dynamic thresholds.
    /// `caps` bound single parts.
    pub fn new(limit: u64, shares: bool, caps: &[(Part, u64)]) -> Arc<Self> {
        let mut state =
            State { shares: Shares::new(limit, shares), parts: [0; PARTS], caps: [u64::MAX; PARTS] };
        for &(part, cap) in caps {
            state.caps[part as usize] = cap;
        }
        Arc::new(Self { limit, state: Mutex::new(state) })
    }

    /// A budget without a bound: for code that runs outside a server.
    pub fn unlimited() -> Arc<Self> {
        Self::new(u64::MAX, false, &[])
    }

    /// The bytes of the whole budget.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// The most that all callers may hold for `part`; none where only the whole budget bounds it.
    pub fn cap(&self, part: Part) -> Option<u64> {
        let cap = locked(&self.state).caps[part as usize];
        (cap != u64::MAX).then_some(cap)
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
    /// The budget, its part or the caller's share has no room; nothing is taken.
    pub fn take(self: &Arc<Self>, caller: &Caller, part: Part, bytes: u64) -> Result<Permit, NoMemory> {
        let mut permit = Permit { budget: self.clone(), caller: caller.clone(), part, bytes: 0 };
        permit.grow(bytes)?;
        Ok(permit)
    }
}

/// Bytes that a caller holds for one part; they are free again when it is dropped.
#[derive(Debug)]
pub struct Permit {
    budget: Arc<MemoryBudget>,
    caller: Caller,
    part: Part,
    bytes: u64,
}

impl Permit {
    /// A permit without a bound: for code that runs outside a server.
    pub fn unbounded(part: Part) -> Self {
        Self { budget: MemoryBudget::unlimited(), caller: Caller::alone(), part, bytes: 0 }
    }

    /// How many bytes it holds.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Takes `more` bytes.
    ///
    /// # Errors
    /// There is no room for them; the permit keeps what it had.
    pub fn grow(&mut self, more: u64) -> Result<(), NoMemory> {
        let refused = |refusal| NoMemory { part: self.part, refusal };
        let mut state = locked(&self.budget.state);
        let part_after = state.parts[self.part as usize].saturating_add(more);
        if part_after > state.caps[self.part as usize] {
            return Err(refused(Refusal::Busy));
        }
        state.shares.take(&self.caller, more).map_err(refused)?;
        state.parts[self.part as usize] = part_after;
        drop(state);
        self.bytes += more;
        Ok(())
    }

    /// Gives all but `bytes` back; a permit that holds less stays as it is.
    pub fn shrink_to(&mut self, bytes: u64) {
        let less = self.bytes.saturating_sub(bytes);
        if less == 0 {
            return;
        }
        self.bytes -= less;
        let mut state = locked(&self.budget.state);
        state.parts[self.part as usize] = state.parts[self.part as usize].saturating_sub(less);
        state.shares.give_back(&self.caller, less);
    }

    /// Moves `bytes` of this permit into a permit of their own; at most what this one holds.
    #[must_use = "the bytes are given back when the permit is dropped"]
    pub fn split(&mut self, bytes: u64) -> Self {
        let bytes = bytes.min(self.bytes);
        self.bytes -= bytes;
        Self { budget: self.budget.clone(), caller: self.caller.clone(), part: self.part, bytes }
    }

    /// Counts the bytes under another part from now on. A part's cap is not asked: the memory
    /// is there already.
    pub fn move_to(&mut self, part: Part) {
        let mut state = locked(&self.budget.state);
        state.parts[self.part as usize] = state.parts[self.part as usize].saturating_sub(self.bytes);
        state.parts[part as usize] = state.parts[part as usize].saturating_add(self.bytes);
        drop(state);
        self.part = part;
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        self.shrink_to(0);
    }
}

/// No panic leaves what is locked here half done.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn callers(count: u32) -> Vec<Caller> {
        let callers = Arc::new(Callers::default());
        (0..count).map(|user| callers.get(CallerKey::User(user))).collect()
    }

    /// Catches bytes that are not given back, given back twice, or counted under another part.
    #[test]
    fn permits_count_their_bytes_until_they_are_dropped() {
        let caller = Caller::alone();
        let budget = MemoryBudget::new(1000, false, &[(Part::Arriving, 300)]);
        let mut arriving = budget.take(&caller, Part::Arriving, 200).unwrap();
        assert_eq!(arriving.grow(101), Err(NoMemory { part: Part::Arriving, refusal: Refusal::Busy }));
        arriving.grow(100).unwrap();
        let answers = budget.take(&caller, Part::Answers, 700).unwrap();
        assert_eq!(budget.used(), 1000);
        assert!(budget.take(&caller, Part::Decoded, 1).is_err());
        let half = arriving.split(150);
        assert_eq!((arriving.bytes(), half.bytes(), budget.used_by(Part::Arriving)), (150, 150, 300));
        drop(half);
        arriving.move_to(Part::Decoded);
        assert_eq!((budget.used_by(Part::Arriving), budget.used_by(Part::Decoded)), (0, 150));
        arriving.shrink_to(50);
        assert_eq!(budget.used(), 750);
        drop((arriving, answers));
        assert!(Part::ALL.iter().all(|&part| budget.used_by(part) == 0));
        assert_eq!(budget.used(), 0);
    }

    /// Catches a greedy caller who leaves nothing for those who come later: n greedy callers
    /// get 1/(n+1) each, however they take turns.
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

    /// Catches a request that can never fit and is told to come back.
    #[test]
    fn what_never_fits_is_told_apart_from_what_does_not_fit_now() {
        let callers = callers(2);
        let mut shares = Shares::new(1000, true);
        assert_eq!(shares.take(&callers[0], 501), Err(Refusal::TooLarge));
        assert_eq!(shares.take(&callers[0], 500), Ok(()));
        assert_eq!(shares.take(&callers[1], 300), Err(Refusal::Busy));
        shares.give_back(&callers[0], 500);
        assert_eq!(shares.take(&callers[1], 300), Ok(()));
        assert_eq!(shares.used(), 300);
    }

    /// Catches callers that are remembered for ever, and one caller who is taken for two.
    #[test]
    fn callers_are_known_while_somebody_holds_them() {
        let callers = Arc::new(Callers::default());
        let address = |text: &str| callers.get(CallerKey::of_address(text.parse().unwrap()));
        let (a, b) = (address("2001:db8::1"), address("2001:db8::ffff:2"));
        assert_eq!(a.id(), b.id(), "one /64 is one caller");
        let c = address("2001:db8:0:1::1");
        assert_ne!(a.id(), c.id());
        assert_eq!(address("::ffff:10.0.0.1").key(), address("10.0.0.1").key());
        assert_eq!(callers.count(), 2);
        drop((a, b, c));
        assert_eq!(callers.count(), 0);
    }
}

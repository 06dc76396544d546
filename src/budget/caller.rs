//! Identifies callers.

use std::{
    collections::HashMap,
    fmt,
    net::{IpAddr, Ipv6Addr},
    sync::{
        Arc, Mutex, Weak,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
};

use crate::lock::locked;

/// The key of a caller, the unit by which shares are counted.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum CallerKey {
    /// The name of the token that authenticated the call.
    Token(String),
    /// The peer's address. For IPv6, the address of its /64 network.
    Address(IpAddr),
    /// The user at the other end of a Unix socket.
    User(u32),
    /// One connection of a trusted proxy, which may carry the calls of many clients.
    Connection(u64),
    /// The one caller that stands for all callers if shares are off, and for calls that did not come
    /// over a connection.
    Everyone,
}

impl CallerKey {
    /// The key of a peer's address. The last 64 bits of an IPv6 address are left out, because a host can
    /// choose them freely.
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

/// Whether logs and metrics may give this name, or a similar one, to a caller without a token: an address, a
/// user id, a connection, or everyone. A token with such a name could be mistaken for that caller.
pub fn is_reserved_name(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    let is_one_of = |kind: &str| {
        name.strip_prefix(kind)
            .is_some_and(|rest| rest.trim_start_matches(['-', '_', '.']).parse::<u64>().is_ok())
    };
    ["anonymous", "everyone", "address", "uid", "connection"].contains(&&*name)
        || ["uid", "connection"].into_iter().any(is_one_of)
        || name.parse::<IpAddr>().is_ok()
}

/// The callers that are currently known.
#[derive(Debug, Default)]
pub struct Callers {
    known: Mutex<HashMap<CallerKey, Weak<CallerState>>>,
    next: AtomicU64,
}

/// One caller. Clones are the same caller, and the caller is forgotten with the last clone.
#[derive(Clone, Debug)]
pub struct Caller(Arc<CallerState>);

#[derive(Debug)]
struct CallerState {
    key: CallerKey,
    id: u64,
    streams: AtomicUsize,
    callers: Weak<Callers>,
}

/// A stream of a caller; it counts until it is dropped.
#[derive(Debug)]
pub struct CallerStream(Caller);

impl Callers {
    /// The caller with this key. It is the same caller for as long as a clone of it exists.
    pub fn get(self: &Arc<Self>, key: CallerKey) -> Caller {
        let mut known = locked(&self.known);
        if let Some(account) = known.get(&key).and_then(Weak::upgrade) {
            return Caller(account);
        }
        let id = self.next.fetch_add(1, Ordering::Relaxed);
        let account =
            Arc::new(CallerState { key: key.clone(), id, streams: 0.into(), callers: Arc::downgrade(self) });
        known.insert(key, Arc::downgrade(&account));
        Caller(account)
    }

    /// The currently known callers that are identified by a token.
    pub fn named(&self) -> Vec<Caller> {
        let known = locked(&self.known);
        let named = known.iter().filter(|(key, _)| matches!(key, CallerKey::Token(_)));
        let accounts: Vec<_> = named.filter_map(|(_, account)| account.upgrade()).collect();
        // The last clone of an account takes the lock when it is dropped.
        drop(known);
        accounts.into_iter().map(Caller).collect()
    }

    /// The number of currently known callers.
    pub fn count(&self) -> usize {
        locked(&self.known).len()
    }
}

impl Drop for CallerState {
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
    /// A new caller that is not registered anywhere, for calls that did not come over a connection.
    pub fn alone() -> Self {
        Self(Arc::new(CallerState {
            key: CallerKey::Everyone,
            id: u64::MAX,
            streams: 0.into(),
            callers: Weak::new(),
        }))
    }

    /// A number that no other living caller has.
    pub fn id(&self) -> u64 {
        self.0.id
    }

    /// Counts a stream of this caller.
    pub fn stream(&self) -> CallerStream {
        self.0.streams.fetch_add(1, Ordering::Relaxed);
        CallerStream(self.clone())
    }

    /// The caller's identity, for logs.
    pub fn key(&self) -> &CallerKey {
        &self.0.key
    }
}

impl CallerStream {
    /// The number of streams of this caller, including this one.
    pub fn count(&self) -> usize {
        self.0.0.streams.load(Ordering::Relaxed)
    }
}

impl Drop for CallerStream {
    fn drop(&mut self) {
        self.0.0.streams.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a kind of caller whose name a token may have.
    #[test]
    fn names_of_callers_without_a_token_are_reserved() {
        let ip = |text: &str| CallerKey::of_address(text.parse().unwrap());
        for key in [CallerKey::User(7), CallerKey::Connection(3), CallerKey::Everyone, ip("10.0.0.1")] {
            let name = key.to_string().replace(' ', "-");
            assert!(is_reserved_name(&name), "{name}");
        }
        // No token may have a name with a slash.
        assert!(ip("2001:db8::1").to_string().contains('/'));
        assert!(!is_reserved_name("trainer") && !is_reserved_name("uid-x"));
    }

    /// Catches callers that are never forgotten, and one caller that counts as two.
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

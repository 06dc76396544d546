//! Who calls.

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
    streams: AtomicUsize,
    callers: Weak<Callers>,
}

/// A stream of a caller; it counts until it is dropped.
#[derive(Debug)]
pub struct CallerStream(Caller);

impl Callers {
    /// The caller with this key: the same one for as long as anybody holds it.
    pub fn get(self: &Arc<Self>, key: CallerKey) -> Caller {
        let mut known = locked(&self.known);
        if let Some(account) = known.get(&key).and_then(Weak::upgrade) {
            return Caller(account);
        }
        let id = self.next.fetch_add(1, Ordering::Relaxed);
        let account =
            Arc::new(Account { key: key.clone(), id, streams: 0.into(), callers: Arc::downgrade(self) });
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
        Self(Arc::new(Account {
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

    /// Who it is, for logs.
    pub fn key(&self) -> &CallerKey {
        &self.0.key
    }
}

impl CallerStream {
    /// The number of streams of this caller, with this one.
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

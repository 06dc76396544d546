//! Identifies the peers of connections, and limits the number of connections.
//!
//! All connections together are at most `max_connections`. The last slots are reserved for
//! addresses that have no open connection yet, so that one address that opens as many as it can
//! does not shut out a health checker. The number of TLS handshakes in progress is limited too,
//! because each costs a signature. Addresses share it by dynamic thresholds (see [`Slots`]).
//!
//! Only a few connections of an address are read at a time (see [`streams`](super::streams)).

use std::{
    collections::HashMap,
    net::IpAddr,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
    thread,
};

use tokio::sync::Semaphore;

use super::{
    App,
    sizes::{CONNECTION_BYTES, LARGE_WINDOW},
};
use crate::{
    budget::{Caller, CallerKey, Part, Permit, Slot, Slots},
    lock::locked,
    metrics::{GaugeGuard, Shed},
};

/// The slots reserved for addresses without an open connection.
const RESERVED_SLOTS: u32 = 16;

/// TLS handshakes in progress at a time, over all addresses.
const HANDSHAKES: u64 = 256;

/// The HTTP/2 window of a connection for which the budget has no room for a [`LARGE_WINDOW`].
const SMALL_WINDOW: u32 = 64 << 10;

/// Large windows together may take the memory budget divided by this number.
const WINDOWS_SHARE: u64 = 4;

/// Health checks per connection that are answered at a time without asking the budget.
const FREE_HEALTH_CHECKS: usize = 16;

/// Watch and reflection streams per connection.
const WATCHES: usize = 8;

/// The peer's address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Address {
    /// The peer's IP address.
    Ip(IpAddr),
    /// The user id of the peer of a Unix socket.
    User(u32),
}

/// The open connections.
#[derive(Debug)]
pub(super) struct Peers {
    app: Arc<App>,
    /// The addresses of proxies: each of their connections is a separate caller.
    trusted_proxies: Vec<IpAddr>,
    /// If false, all connections are one caller.
    shares: bool,
    open: Mutex<OpenConnections>,
    handshakes: Arc<Slots>,
    count: AtomicU64,
}

#[derive(Debug, Default)]
struct OpenConnections {
    all: u32,
    by_address: HashMap<CallerKey, AddressConnections>,
}

/// The connections of one address.
#[derive(Debug)]
struct AddressConnections {
    count: u32,
    /// Permits to read, for as many connections at a time as the server has threads.
    read_permits: Arc<Semaphore>,
}

impl Default for AddressConnections {
    fn default() -> Self {
        let threads = thread::available_parallelism().map_or(1, usize::from);
        Self { count: 0, read_permits: Arc::new(Semaphore::new(threads)) }
    }
}

impl Peers {
    pub(super) fn new(app: Arc<App>, trusted_proxies: Vec<IpAddr>, shares: bool) -> Self {
        let handshakes = Slots::new(HANDSHAKES);
        Self { app, trusted_proxies, shares, open: Mutex::default(), handshakes, count: AtomicU64::new(0) }
    }

    /// Admits a connection from `address`. Returns `None` if there are too many.
    pub(super) fn admit(self: &Arc<Self>, address: Address) -> Option<Peer> {
        let admitted = self.try_admit(address);
        if admitted.is_none() {
            self.app.metrics().shed(Shed::Connection);
        }
        admitted
    }

    fn try_admit(self: &Arc<Self>, address: Address) -> Option<Peer> {
        let (slot, read_permits) = ConnectionSlot::take(self, key(address))?;
        let caller = self.app.callers().get(self.caller_key(address));
        // Each connection of a trusted proxy counts by itself.
        let is_proxy = matches!(caller.key(), CallerKey::Connection(_));
        let read_permits = if is_proxy { AddressConnections::default().read_permits } else { read_permits };
        let (window, memory) = self.window(&caller)?;
        let counted = GaugeGuard::new(&self.app.metrics().connections, 1);
        let connection = Arc::new(ConnectionState {
            caller,
            health_checks: AtomicUsize::new(0),
            watches: AtomicUsize::new(0),
            read_permits,
            _memory: memory,
            _slot: slot,
            _counted: counted,
        });
        Some(Peer { peers: self.clone(), connection, window })
    }

    fn caller_key(&self, address: Address) -> CallerKey {
        match address {
            _ if !self.shares => CallerKey::Everyone,
            Address::Ip(ip) if self.trusted_proxies.contains(&ip.to_canonical()) => {
                CallerKey::Connection(self.count.fetch_add(1, Ordering::Relaxed))
            }
            address => key(address),
        }
    }

    /// The window of a new connection, and the memory for the connection with that window. None if
    /// there is no room even for a small window.
    fn window(&self, caller: &Caller) -> Option<(u32, Permit)> {
        let memory = self.app.memory();
        let take = |window: u32| {
            let bytes = CONNECTION_BYTES + u64::from(window);
            memory.take(caller, Part::Connections, bytes).ok().map(|permit| (window, permit))
        };
        let large = memory.used_by(Part::Connections) + u64::from(LARGE_WINDOW);
        let may_be_large = large <= memory.limit() / WINDOWS_SHARE;
        may_be_large.then(|| take(LARGE_WINDOW)).flatten().or_else(|| take(SMALL_WINDOW))
    }
}

fn key(address: Address) -> CallerKey {
    match address {
        Address::Ip(ip) => CallerKey::of_address(ip),
        Address::User(user) => CallerKey::User(user),
    }
}

/// The slot of one connection; free again when this is dropped.
#[derive(Debug)]
struct ConnectionSlot {
    peers: Arc<Peers>,
    address: CallerKey,
}

impl ConnectionSlot {
    /// A slot for a connection from `address`, and the permits to read of that address. None if there are
    /// too many connections.
    fn take(peers: &Arc<Peers>, address: CallerKey) -> Option<(Self, Arc<Semaphore>)> {
        let most = peers.app.limits().max_connections;
        let mut open = locked(&peers.open);
        // If there are few slots, at most an eighth of them is reserved.
        let reserved = if open.by_address.contains_key(&address) { RESERVED_SLOTS.min(most / 8) } else { 0 };
        if open.all.saturating_add(reserved) >= most {
            return None;
        }
        open.all += 1;
        let of_address = open.by_address.entry(address.clone()).or_default();
        of_address.count += 1;
        let read_permits = of_address.read_permits.clone();
        drop(open);
        Some((Self { peers: peers.clone(), address }, read_permits))
    }
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        let mut open = locked(&self.peers.open);
        open.all = open.all.saturating_sub(1);
        if let Some(of_address) = open.by_address.get_mut(&self.address) {
            of_address.count -= 1;
            if of_address.count == 0 {
                open.by_address.remove(&self.address);
            }
        }
    }
}

/// The peer of an open connection. Clones refer to the same connection.
#[derive(Clone, Debug)]
pub(super) struct Peer {
    peers: Arc<Peers>,
    connection: Arc<ConnectionState>,
    window: u32,
}

#[derive(Debug)]
struct ConnectionState {
    caller: Caller,
    health_checks: AtomicUsize,
    watches: AtomicUsize,
    read_permits: Arc<Semaphore>,
    _memory: Permit,
    _slot: ConnectionSlot,
    _counted: GaugeGuard,
}

impl Peer {
    /// The HTTP/2 window of the connection and of each of its streams, in bytes.
    pub(super) fn window(&self) -> u32 {
        self.window
    }

    /// The permits to read of the connections of this address.
    pub(super) fn read_permits(&self) -> Arc<Semaphore> {
        self.connection.read_permits.clone()
    }

    /// More memory for the connection, or `None` if the budget has no room.
    pub(super) fn take(&self, bytes: u64) -> Option<Permit> {
        self.peers.app.memory().take(&self.connection.caller, Part::Connections, bytes).ok()
    }

    /// The caller of a call: the token's name if the call has a token, otherwise the connection's
    /// caller.
    pub(super) fn caller(&self, token: Option<&str>) -> Caller {
        match token {
            Some(name) if self.peers.shares => self.peers.app.callers().get(CallerKey::Token(name.into())),
            _ => self.connection.caller.clone(),
        }
    }

    /// Permission for a TLS handshake, or `None` while too many are in progress.
    pub(super) fn handshake(&self) -> Option<Slot> {
        self.peers.handshakes.take(&self.connection.caller)
    }

    /// A slot for a health check that needs no room in the budget, or `None` if the connection
    /// has too many.
    pub(super) fn health_check(&self) -> Option<CallSlot> {
        CallSlot::take(&self.connection, |connection| &connection.health_checks, FREE_HEALTH_CHECKS)
    }

    /// A slot for a Watch or reflection stream, or `None` if the connection has too many.
    pub(super) fn watch(&self) -> Option<CallSlot> {
        CallSlot::take(&self.connection, |connection| &connection.watches, WATCHES)
    }
}

/// A slot among a limited number of calls of a connection; free again when this is dropped.
#[derive(Debug)]
pub(super) struct CallSlot {
    connection: Arc<ConnectionState>,
    of: fn(&ConnectionState) -> &AtomicUsize,
}

impl CallSlot {
    fn take(
        connection: &Arc<ConnectionState>,
        of: fn(&ConnectionState) -> &AtomicUsize,
        most: usize,
    ) -> Option<Self> {
        let taken = of(connection)
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |count| (count < most).then_some(count + 1));
        taken.ok().map(|_| Self { connection: connection.clone(), of })
    }
}

impl Drop for CallSlot {
    fn drop(&mut self) {
        (self.of)(&self.connection).fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{service::Limits, store::blobs};

    fn peers(limits: Limits) -> Arc<Peers> {
        let app = Arc::new(App::new(blobs::open("memory://").unwrap(), limits, 1).unwrap());
        Arc::new(Peers::new(app, vec!["10.0.0.9".parse().unwrap()], true))
    }

    fn ip(text: &str) -> Address {
        Address::Ip(text.parse().unwrap())
    }

    /// Catches an address that takes the last slot from an address without connections, and a
    /// slot that is not released.
    #[test]
    fn the_last_slots_are_for_new_addresses() {
        let peers = peers(Limits { max_connections: 200, ..Limits::default() });
        let greedy: Vec<_> = std::iter::from_fn(|| peers.admit(ip("10.0.0.1"))).collect();
        assert_eq!(greedy.len(), 200 - RESERVED_SLOTS as usize);
        let others: Vec<_> = (2..).map_while(|i| peers.admit(ip(&format!("10.0.1.{i}")))).collect();
        assert_eq!(others.len(), RESERVED_SLOTS as usize);
        drop((greedy, others));
        assert_eq!(locked(&peers.open).all, 0);
        assert!(locked(&peers.open).by_address.is_empty());
        assert_eq!(peers.app.memory().used(), 0);
        assert_eq!(peers.app.callers().count(), 0);
    }

    /// Catches windows that are not counted in the budget. When many connections are open, new
    /// ones must get small windows.
    #[test]
    fn windows_shrink_with_the_budget() {
        let peers = peers(Limits {
            max_memory_bytes: 256 << 20,
            max_message_bytes: 16 << 20,
            max_points_per_hull: 50_000,
            ..Limits::default()
        });
        let open: Vec<_> = (0..200).filter_map(|_| peers.admit(ip("10.0.0.1"))).collect();
        let large = open.iter().filter(|peer| peer.window() == LARGE_WINDOW).count();
        assert_eq!(large, 7, "a quarter of the budget");
        assert_eq!(open.len(), 200);
        assert!(peers.app.memory().used() <= 128 << 20);
        // One address may have half of the budget at most, so another address still finds room.
        let more: Vec<_> = (0..2000).filter_map(|_| peers.admit(ip("10.0.0.1"))).collect();
        assert!(more.len() < 800);
        assert!(peers.admit(ip("10.0.0.2")).is_some());
    }

    /// Catches a proxy whose clients count as one caller, and a host with many addresses that
    /// counts as many.
    #[test]
    fn connections_of_a_trusted_proxy_count_one_by_one() {
        let peers = peers(Limits::default());
        let caller = |text| peers.admit(ip(text)).unwrap().caller(None).key().clone();
        assert_eq!(caller("10.0.0.1"), caller("10.0.0.1"));
        assert_ne!(caller("10.0.0.9"), caller("10.0.0.9"));
        assert_eq!(caller("2001:db8::1"), caller("2001:db8::2"));
        let named = peers.admit(ip("10.0.0.1")).unwrap().caller(Some("trainer"));
        assert_eq!(named.key(), &CallerKey::Token("trainer".into()));
    }
}

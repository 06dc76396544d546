//! Attacks on the real server, and what a bystander notices of them.
//!
//! Each attack comes from one loopback address while a bystander on another one alternates
//! small queries, larger queries and health checks. The tests assert what issue reports of
//! denial of service are about: memory stays within the configured budget, everything that an
//! attack held is free soon after it ends, each answer to the bystander is right, and the
//! bystander is served before the attacker's backlog is. Latencies are reported, never
//! asserted.
//!
//! Each attack has two forms. `tenth` runs in `make test-abuse-short`: a tenth of the size against
//! a tenth of the budgets. `full` runs in `make test-abuse`: default limits. One attack runs at a time.
//!
//! `HULLCAST_ABUSE_BIN` names another server to attack, for example one of an older version.
//! Settings that such a server does not know have to be removed by a wrapper script.
#![cfg(feature = "server")]

#[path = "../service/support/raw.rs"]
#[allow(dead_code, reason = "shared with the tests of the service")]
mod raw;
#[path = "../service/support/scenes.rs"]
#[allow(dead_code, reason = "shared with the tests of the service")]
mod scenes;

#[macro_use]
mod support;

mod admin;
mod building;
mod collected;
mod connections;
mod declared;
mod drained;
mod elements;
mod floods;
mod idle;
mod messages;
#[cfg(feature = "playground")]
mod over_http1;
mod queries;
mod shares;
mod stored;
mod unfinished;
mod unread;

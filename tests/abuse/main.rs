//! Attacks on the real server, and their effect on a bystander.
//!
//! Each attack comes from one loopback address. Meanwhile a bystander on another address alternates small
//! queries, larger queries and health checks. The tests assert the properties that denial-of-service
//! reports are about: memory stays within the configured budget; all memory that an attack held is free
//! soon after it ends; each answer to the bystander is right; and the bystander is served before the
//! attacker's backlog. Latencies are reported, never asserted.
//!
//! Each attack has two tests. `tenth` is run by `make test-abuse-short`: the attack at a tenth of its size
//! against a tenth of the budgets. `full` is run by `make test-abuse`, with the default limits. One attack
//! runs at a time.
//!
//! `HULLCAST_ABUSE_BIN` names another server binary to attack, for example an older version. If that server
//! does not know some of the settings, it needs a wrapper script that removes them.

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
mod refused;
mod shares;
mod stored;
mod unfinished;
mod unread;

//! Tests of the real server on port 0 and of the real binary, from a client's point of view.

mod answers;
mod client;
mod contract;
mod determinism;
mod durability;
mod errors;
mod find;
mod hostile;
mod hulls;
mod lifecycle;
mod limits;
mod memory;
mod messages;
mod overload;
#[cfg(feature = "playground")]
mod playground;
mod security;
mod sight;
mod steps;
mod stopping;
mod store_hung;
mod store_tampered;
mod support;
mod unread;

//! The real server on port 0, and the real binary, from the outside.
#![cfg(feature = "server")]

mod answers;
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

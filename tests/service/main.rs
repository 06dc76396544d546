//! Tests of the real server on port 0 and of the real binary, from a client's point of view.

mod abuse;
mod answers;
#[cfg(feature = "playground")]
mod browsers;
mod client;
mod contact_stream;
mod contract;
mod determinism;
mod durability;
mod errors;
mod find;
mod hulls;
mod lifecycle;
mod limits;
mod margins;
mod memory;
mod messages;
mod observability;
mod overload;
mod security;
mod steps;
mod stopping;
mod store_hung;
mod store_tampered;
mod support;
mod unread;

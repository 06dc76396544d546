//! Measuring the server from the outside: its process, calls of raw bytes, an echo
//! to compare with, requests, a slow network.

pub mod process;
pub mod raw;
pub mod requests;
pub mod shaped;

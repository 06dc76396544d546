//! Measures the server from outside: its process and CPU time, calls of raw bytes, load in
//! closed loops, an echo server for comparison, requests, and a simulated slow network.

pub mod load;
pub mod process;
pub mod raw;
pub mod requests;
pub mod shaped;

//! The subcommands.

mod answer;
mod checked;
mod descriptors;
pub(crate) mod load;
mod memory;
mod npz;
mod options;
pub(crate) mod prune;
pub(crate) mod query;
mod reach;
mod remote;
mod report;
mod scene;
pub(crate) mod serve;
pub(crate) mod settings;
#[cfg_attr(not(feature = "otlp"), path = "no_traces.rs")]
mod traces;
pub(crate) mod tradeoff;

/// The error of a subcommand. Its text is shown to the user as it is.
pub(crate) type Error = Box<dyn std::error::Error>;

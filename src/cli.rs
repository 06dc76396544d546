//! The subcommands.

mod answer;
mod arrays;
pub(crate) mod completions;
mod descriptors;
pub(crate) mod exit;
pub(crate) mod help;
pub(crate) mod load;
mod log;
mod memory;
mod npz;
mod options;
mod progress;
pub(crate) mod prune;
pub(crate) mod query;
#[cfg(test)]
mod refusals;
mod remote;
pub(crate) mod replay;
mod report;
mod runtime;
mod scene;
pub(crate) mod serve;
mod serve_values;
pub(crate) mod settings;
mod table;
#[cfg_attr(not(feature = "otlp"), path = "cli/no_traces.rs")]
mod traces;
mod values;

/// The error of a subcommand. Its text is shown to the user as it is.
pub(crate) type Error = Box<dyn std::error::Error>;

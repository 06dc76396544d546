//! The subcommands.

pub(crate) mod serve;
pub(crate) mod settings;

/// What a subcommand fails with: shown to the user as it is.
pub(crate) type Error = Box<dyn std::error::Error>;

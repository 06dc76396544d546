//! `hullcast completions`: scripts for shells.

use std::io::{self, Write};

use clap::Command;
use clap_complete::Shell;

use super::Error;

/// Prints a script that completes hullcast's commands, options and their values in a shell.
///
/// For bash: `hullcast completions bash > ~/.local/share/bash-completion/completions/hullcast`.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Args {
    /// The shell.
    #[arg(value_enum)]
    shell: Shell,
}

/// Runs `hullcast completions` for the command line `command`.
///
/// # Errors
/// The script cannot be written.
pub(crate) fn run(args: &Args, mut command: Command) -> Result<(), Error> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "hullcast", &mut script);
    match io::stdout().lock().write_all(&script) {
        // A closed pipe, as in `hullcast completions bash | head`, is not a failure.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => Ok(other?),
    }
}

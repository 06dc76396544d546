//! The laboratory: measurements that need no server. Each subcommand is a module with its `Args` and its
//! `run`.

mod planarity;
mod progress;
mod tradeoff;

use std::{
    io::{self, Write},
    process::ExitCode,
};

use clap::{Parser, Subcommand};

/// Measures the geometry of hullcast in this process.
#[derive(Parser)]
#[command(name = "lab", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Measures the time and the errors of every setting.
    Tradeoff(tradeoff::Args),
    /// Measures the patches of rounded shapes for each planarity of faces.
    Planarity(planarity::Args),
}

/// The error of a subcommand. Its text is shown to the user as it is.
type Error = Box<dyn std::error::Error>;

/// Prints a text. A closed pipe, as in `lab tradeoff | head`, is not a failure.
///
/// # Errors
/// The text cannot be written.
fn print(text: &str) -> Result<(), Error> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => Ok(other?),
    }
}

fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Tradeoff(args) => tradeoff::run(&args),
        Command::Planarity(args) => planarity::run(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("lab: {error}");
            ExitCode::FAILURE
        }
    }
}

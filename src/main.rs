//! The command line. It parses the arguments and calls the subcommand. Each subcommand is a
//! module with its `Args` and its `run`.

#![warn(unreachable_pub)]

mod allocator;
mod cli;

use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

/// Computes certified contact manifolds of convex hulls, as a service.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Runs the server, which answers queries over gRPC until it is told to stop.
    Serve(Box<cli::serve::Args>),
    /// Computes the contacts of a scene file, in this process or on a server.
    Query(Box<cli::query::Args>),
    /// Sends batches in a closed or an open loop, times them and checks a sample of the answers.
    Load(Box<cli::load::Args>),
    /// Computes recorded calls again, and names the first that differs.
    Replay(Box<cli::replay::Args>),
    /// Removes old hulls from a store.
    Prune(cli::prune::Args),
    /// Prints a script that completes commands and options in a shell.
    Completions(cli::completions::Args),
}

fn main() -> ExitCode {
    let mut command = cli::help::complete(Arguments::command());
    let matches = command.get_matches_mut();
    let arguments =
        Arguments::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut command).exit());
    let result = match arguments.command {
        Command::Serve(args) => cli::serve::run(*args),
        Command::Query(args) => cli::query::run(&args),
        Command::Load(args) => cli::load::run(&args),
        Command::Replay(args) => cli::replay::run(&args),
        Command::Prune(args) => cli::prune::run(&args),
        Command::Completions(args) => cli::completions::run(&args, command),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("hullcast: {error}");
            cli::exit::code(&error)
        }
    }
}

//! The command line: parses, then calls. One module a subcommand, each with
//! its `Args` and its `run`.

#![warn(unreachable_pub)]

mod cli;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Transport and batches allocate in large blocks from several threads; measured some 30 %
/// less CPU than with the system's allocator.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Certified contact manifolds of convex hulls, as a service.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Answers queries over gRPC until told to stop.
    Serve(Box<cli::serve::Args>),
    /// Answers for a scene file's pairs, in this process or from a server.
    Query(Box<cli::query::Args>),
    /// Measures speed against accuracy: every setting's time and errors.
    Tradeoff(cli::tradeoff::Args),
    /// Sends batches in a closed or an open loop, times them and checks a sample of the answers.
    Load(Box<cli::load::Args>),
    /// Removes old hulls from a store.
    Prune(cli::prune::Args),
}

fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Serve(args) => cli::serve::run(*args),
        Command::Query(args) => cli::query::run(&args),
        Command::Tradeoff(args) => cli::tradeoff::run(&args),
        Command::Load(args) => cli::load::run(&args),
        Command::Prune(args) => cli::prune::run(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("hullcast: {error}");
            ExitCode::FAILURE
        }
    }
}

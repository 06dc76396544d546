//! `hullcast load`: sends batches in a closed or an open loop, times them and checks the answers.

mod batches;
mod levels;
mod progress;
mod runner;
mod sheet;
mod tally;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use batches::Batches;
use levels::{Level, Plan, Range};
use runner::Runner;

use super::Error;
use super::answer::{Answerer, another_connection};
use super::options::{AccuracyArgs, OutputArg};
use super::progress::Progress;
use super::remote::RemoteArgs;
use super::scene::HullPoints;
use super::settings::MOST_THREADS;
use super::values::{count, margin, number};
use hullcast::store::HullId;
use hullcast::workload::{Family, Regime};

/// Sends batches and checks a sample of the answers.
///
/// In a closed loop (`--concurrency`, or level by level `--concurrency-range`)
/// each loop sends its next batch when its last is answered. In an open loop
/// (`--request-rate-range`) batches are sent at their times whether or not
/// earlier ones are answered, and latency counts from the time at which a batch
/// was due. A batch that a busy server refuses is shed: it is sent again when
/// the server asks (RetryInfo), up to `--retries` times; so is one whose server
/// or connection is lost, to the next of several servers. Answers are checked to
/// the last bit against the library, called in this process a pair at a time.
/// An interrupt ends the run, and what was counted is printed. The exit code is 1
/// where a call failed or an answer was wrong.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Args {
    /// Batches from a scene file: each of its configurations in turn [default: generated batches].
    #[arg(long, value_name = "FILE", conflicts_with_all = ["family", "regime"], help_heading = "Batches")]
    scene: Option<PathBuf>,
    /// Batches of generated hulls.
    #[arg(long, value_enum, ignore_case = true, default_value_t, help_heading = "Batches")]
    family: FamilyArg,
    /// How the generated pairs meet.
    #[arg(long, value_enum, ignore_case = true, default_value_t, help_heading = "Batches")]
    regime: RegimeArg,
    /// Pairs a batch; a scene's pairs are repeated up to it [default: 4096, or the scene's].
    #[arg(long, value_name = "COUNT", value_parser = count(1, u32::MAX), allow_negative_numbers = true,
          help_heading = "Batches")]
    pairs: Option<u32>,
    /// Distinct generated batches.
    #[arg(long, value_name = "COUNT", default_value_t = 8, value_parser = count(1, u32::MAX),
          allow_negative_numbers = true, help_heading = "Batches")]
    batches: u32,
    /// Of the generated hulls and poses.
    #[arg(long, default_value_t = 1, value_parser = count(0, u64::MAX), allow_negative_numbers = true,
          help_heading = "Batches")]
    seed: u64,
    /// Contact points are wanted within it; inf: everywhere [default: 0.005, or the scene's].
    #[arg(long, value_name = "LENGTH", value_parser = margin, allow_negative_numbers = true,
          help_heading = "Batches")]
    margin: Option<f64>,
    /// Column groups to compute.
    #[arg(
        long,
        value_enum,
        ignore_case = true,
        value_delimiter = ',',
        value_name = "NAMES",
        help_heading = "Batches",
        default_value = "alpha,normal,points"
    )]
    outputs: Vec<OutputArg>,
    #[command(flatten)]
    accuracy: AccuracyArgs,
    /// Batches under way at once.
    #[arg(long, value_name = "COUNT", default_value_t = 4, value_parser = count(1, u32::MAX),
          allow_negative_numbers = true, help_heading = "Load")]
    concurrency: u32,
    /// Closed loops level by level: start:end:step batches under way at once [default: one level].
    #[arg(
        long,
        value_name = "RANGE",
        conflicts_with = "concurrency",
        allow_negative_numbers = true,
        help_heading = "Load"
    )]
    concurrency_range: Option<Range>,
    /// An open loop level by level: start:end:step batches a second [default: a closed loop].
    #[arg(long, value_name = "RANGE", conflicts_with_all = ["concurrency", "concurrency_range"],
          allow_negative_numbers = true, help_heading = "Load")]
    request_rate_range: Option<Range>,
    /// When the batches of an open loop are due.
    #[arg(long, value_enum, ignore_case = true, default_value_t, help_heading = "Load")]
    request_distribution: Distribution,
    /// A level whose latency is above this, in milliseconds, is too much: the last.
    #[arg(long, value_name = "MS", default_value_t = f64::INFINITY, value_parser = number(0.0, f64::INFINITY),
          allow_negative_numbers = true, help_heading = "Load")]
    latency_threshold: f64,
    /// The percentile that the threshold is held against.
    #[arg(long, value_name = "PERCENT", default_value_t = 99.0, value_parser = number(0.0, 100.0),
          allow_negative_numbers = true, help_heading = "Load")]
    percentile: f64,
    /// Search the range for the most load within the threshold.
    #[arg(long, requires = "latency_threshold", help_heading = "Load")]
    binary_search: bool,
    /// How long each level lasts.
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0, value_parser = number(0.0, 1e7),
          allow_negative_numbers = true, help_heading = "Load")]
    duration: f64,
    /// End after this many batches; 0: by time alone.
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = count(0, u64::MAX),
          allow_negative_numbers = true, help_heading = "Load")]
    count: u64,
    /// Times that a batch is sent again that was shed, or whose server was lost.
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = count(0, u32::MAX),
          allow_negative_numbers = true, help_heading = "Load")]
    retries: u32,
    /// Check one answer in so many; 1: every one, 0: none.
    #[arg(long, value_name = "COUNT", default_value_t = 16, value_parser = count(0, u64::MAX),
          allow_negative_numbers = true, help_heading = "Results")]
    verify: u64,
    /// Write the levels as comma-separated values [default: no file].
    #[arg(long, value_name = "FILE", help_heading = "Results")]
    csv: Option<PathBuf>,
    /// Draw latency against offered load, as SVG [default: no file].
    #[arg(long, value_name = "FILE", help_heading = "Results")]
    plot: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long, help_heading = "Results")]
    json: bool,
    /// Compute threads in this process; 0: one a core.
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = count(0, MOST_THREADS),
          allow_negative_numbers = true, help_heading = "Who answers")]
    threads: usize,
    #[command(flatten)]
    remote: RemoteArgs,
    /// Connections, shared evenly: `--remote` may be several servers on one store,
    /// separated by commas, which take turns [default: one a server].
    #[arg(long, value_name = "COUNT", value_parser = count(1, u32::MAX), allow_negative_numbers = true,
          help_heading = "Who answers")]
    connections: Option<u32>,
}

#[derive(clap::ValueEnum, Clone, Copy, Debug, Default)]
enum FamilyArg {
    #[default]
    Box,
    Poly16,
    Poly64,
    Poly256,
}

#[derive(clap::ValueEnum, Clone, Copy, Debug, Default)]
enum RegimeArg {
    #[default]
    Shallow,
    Resting,
    Separated,
}

/// When the batches of an open loop are due.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Distribution {
    /// At even intervals.
    #[default]
    Constant,
    /// As independent clients send.
    Poisson,
}

/// Runs `hullcast load`.
///
/// # Errors
/// The load cannot be prepared, or a call failed, or an answer was wrong. The summary is printed in
/// all but the first case.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    super::runtime::with_threads()?.block_on(loaded(args))
}

async fn loaded(args: &Args) -> Result<(), Error> {
    let progress = Progress::waiting("making batches");
    let batches = args.batches()?;
    drop(progress);
    let (answerers, ids) = args.answerers(batches.hulls()).await?;
    let margin = args.margin.unwrap_or(batches.margin());
    let sampled =
        Arc::new(batches.prepare(&ids, &args.accuracy.asked(margin, &args.outputs), args.verify)?);
    let interrupted = Arc::new(AtomicBool::new(false));
    tokio::spawn(note_interrupt(interrupted.clone()));
    let runner = Runner { answerers, sampled, interrupted: interrupted.clone(), args: args.clone() };
    let mut plan = args.plan();
    let (mut rows, mut clean) = (Vec::new(), Ok(()));
    while let Some(level) = plan.level() {
        let (tally, elapsed) = runner.measure(level).await?;
        let row = tally.row(level, elapsed, args.percentile);
        plan.went(level, row.latency[4] <= args.latency_threshold);
        rows.push(row);
        let title = format!("{}, {} {}", batches.title(), level.kind(), level.value());
        if args.json {
            println!("{}", tally.json(&title, elapsed)?);
        } else {
            print!("{}", tally.text(&title, elapsed));
        }
        clean = clean.and(tally.verdict());
        if interrupted.load(Ordering::Relaxed) {
            break;
        }
    }
    if rows.len() > 1 && !args.json {
        print!("{}", sheet::table(&rows));
    }
    if let Some(path) = &args.csv {
        write("--csv", path, sheet::csv(&rows))?;
    }
    if let Some(path) = &args.plot {
        write("--plot", path, sheet::svg(batches.title(), &rows))?;
    }
    clean.map_err(Into::into)
}

fn write(option: &str, path: &Path, text: String) -> Result<(), String> {
    std::fs::write(path, text).map_err(|error| format!("{option} {}: {error}", path.display()))
}

impl Args {
    fn plan(&self) -> Plan {
        let concurrency: fn(f64) -> Level = |count| Level::Concurrency(count.round() as u32);
        match (self.request_rate_range, self.concurrency_range) {
            (Some(range), _) => Plan::new(Level::Rate, range, self.binary_search),
            (None, Some(range)) => Plan::new(concurrency, range, self.binary_search),
            (None, None) => Plan::new(concurrency, Range::one(self.concurrency), false),
        }
    }

    /// The connections, which go to the servers in turn, or this process; and the ids of the hulls there.
    async fn answerers(&self, hulls: &[HullPoints]) -> Result<(Vec<Answerer>, Vec<HullId>), Error> {
        let Some(remote) = &self.remote.remote else {
            let (local, ids) = Answerer::local(hulls, self.threads)?;
            return Ok((vec![local], ids));
        };
        let addresses: Vec<&str> = remote.split(',').collect();
        let (first, ids) = Answerer::remote(addresses[0], &self.remote, hulls).await?;
        let mut answerers = vec![first];
        for place in 1..self.connections.map_or(addresses.len(), |count| count as usize) {
            let address = addresses[place % addresses.len()];
            answerers.push(another_connection(address, &self.remote).await?);
        }
        Ok((answerers, ids))
    }

    fn batches(&self) -> Result<Batches, Error> {
        if let Some(path) = &self.scene {
            return Batches::of_scene(path, self.pairs);
        }
        let family = match self.family {
            FamilyArg::Box => Family::Box,
            FamilyArg::Poly16 => Family::Poly16,
            FamilyArg::Poly64 => Family::Poly64,
            FamilyArg::Poly256 => Family::Poly256,
        };
        let regime = match self.regime {
            RegimeArg::Shallow => Regime::Shallow,
            RegimeArg::Resting => Regime::Resting,
            RegimeArg::Separated => Regime::Separated,
        };
        Batches::generated(family, regime, self.pairs.unwrap_or(4096), self.batches, self.seed)
    }
}

/// Sets `interrupted` when the user interrupts the run. A second interrupt ends the process.
async fn note_interrupt(interrupted: Arc<AtomicBool>) {
    // On a system without signals, only the time limit ends a run.
    while tokio::signal::ctrl_c().await.is_ok() {
        if interrupted.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    }
}

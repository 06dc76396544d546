//! `hullcast load`: sends batches in a closed or an open loop, times them and checks the answers.

mod batches;
mod levels;
mod progress;
mod runner;
mod sheet;
mod steps;
mod tally;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use batches::Batches;
use levels::{Level, LevelRange, Plan};
use runner::Runner;
use steps::StepRunner;
use tally::Tally;

use super::Error;
use super::answer::{Answerer, another_connection, in_scene};
use super::options::{AccuracyArgs, OutputArg, QueryOptions};
use super::progress::Progress;
use super::remote::RemoteArgs;
use super::scene::{HullPoints, shown};
use super::settings::MOST_THREADS;
use super::values::{count, margin, number};
use hullcast::store::HullId;
use hullcast::workload::{Family, Regime};

/// The pairs of the generated workload whose hulls the bodies of sessions have.
const SESSION_PAIRS: u32 = 64;

/// Sends batches and checks a sample of the answers.
///
/// In a closed loop (`--concurrency`, or `--concurrency-range` for several levels) each loop sends its
/// next batch when its last one is answered. In an open loop (`--request-rate-range`) batches are sent at
/// fixed times, whether or not earlier ones are answered, and the latency of a batch counts from the time
/// at which it was due. If a busy server refuses a batch, the batch counts as shed and is sent again
/// after the time that the server states (RetryInfo), up to `--retries` times. If a server or its
/// connection is lost, its batch is sent again to the next server. Answers are compared bit for bit with
/// those of the library, which this process calls for one pair at a time. With `--session`, each loop is a
/// simulation whose pairs the server finds, and one step in `--verify` is compared with a new search. An interrupt ends the run, and
/// the counts so far are printed. The exit code is 1 if a call failed or an answer was wrong.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Args {
    /// Send the configurations of this scene file in turn [default: generated batches].
    #[arg(long, value_name = "FILE", conflicts_with_all = ["family", "regime"], help_heading = "Batches")]
    scene: Option<PathBuf>,
    /// The kind of hull in generated batches.
    #[arg(long, value_enum, ignore_case = true, default_value_t, help_heading = "Batches")]
    family: FamilyArg,
    /// How the generated pairs meet.
    #[arg(long, value_enum, ignore_case = true, default_value_t, help_heading = "Batches")]
    regime: RegimeArg,
    /// Pairs per batch. The pairs of a scene are repeated to reach this number [default: 4096, or the
    /// number of the scene].
    #[arg(long, value_name = "COUNT", value_parser = count(1, u32::MAX), allow_negative_numbers = true,
          help_heading = "Batches")]
    pairs: Option<u32>,
    /// Distinct generated batches.
    #[arg(long, value_name = "COUNT", default_value_t = 8, value_parser = count(1, u32::MAX),
          allow_negative_numbers = true, help_heading = "Batches")]
    batches: u32,
    /// The seed of the generated hulls and poses.
    #[arg(long, default_value_t = 1, value_parser = count(0, u64::MAX), allow_negative_numbers = true,
          help_heading = "Batches")]
    seed: u64,
    /// Compute contact points for hulls within this distance. `inf` means at any distance [default:
    /// 0.005, or the margin of the scene].
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
    /// Make the steps of simulations, in place of batches: each loop is a session with bodies of its own,
    /// in which the server finds the pairs.
    #[arg(long, requires = "remote", help_heading = "Step loops",
          conflicts_with_all = ["scene", "regime", "pairs", "batches", "request_rate_range", "retries"])]
    session: bool,
    /// The bodies of each session.
    #[arg(long, value_name = "COUNT", default_value_t = 1000, value_parser = count(1, u32::MAX),
          allow_negative_numbers = true, requires = "session", help_heading = "Step loops")]
    bodies: u32,
    /// The share of the bodies that move a little in each step, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 1.0, value_parser = number(0.0, 1.0),
          allow_negative_numbers = true, requires = "session", help_heading = "Step loops")]
    moved: f64,
    /// The share of the bodies that jump to another place in each step, 0 to 1. Their pairs end, and
    /// others begin.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = number(0.0, 1.0),
          allow_negative_numbers = true, requires = "session", help_heading = "Step loops")]
    churn: f64,
    /// Batches in flight at once.
    #[arg(long, value_name = "COUNT", default_value_t = 4, value_parser = count(1, u32::MAX),
          allow_negative_numbers = true, help_heading = "Load")]
    concurrency: u32,
    /// Measure closed loops at several levels: start:end:step batches in flight at once [default: one
    /// level].
    #[arg(
        long,
        value_name = "RANGE",
        conflicts_with = "concurrency",
        allow_negative_numbers = true,
        help_heading = "Load"
    )]
    concurrency_range: Option<LevelRange>,
    /// Measure an open loop at several levels: start:end:step batches per second [default: a closed
    /// loop].
    #[arg(long, value_name = "RANGE", conflicts_with_all = ["concurrency", "concurrency_range"],
          allow_negative_numbers = true, help_heading = "Load")]
    request_rate_range: Option<LevelRange>,
    /// The times at which the batches of an open loop are due.
    #[arg(long, value_enum, ignore_case = true, default_value_t, help_heading = "Load")]
    request_distribution: Distribution,
    /// End after the first level whose latency is above this, in milliseconds.
    #[arg(long, value_name = "MS", default_value_t = f64::INFINITY, value_parser = number(0.0, f64::INFINITY),
          allow_negative_numbers = true, help_heading = "Load")]
    latency_threshold: f64,
    /// The percentile of latency that is compared with the threshold.
    #[arg(long, value_name = "PERCENT", default_value_t = 99.0, value_parser = number(0.0, 100.0),
          allow_negative_numbers = true, help_heading = "Load")]
    percentile: f64,
    /// Search the range for the highest load within the threshold.
    #[arg(long, requires = "latency_threshold", help_heading = "Load")]
    binary_search: bool,
    /// How long each level lasts.
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0, value_parser = number(0.0, 1e7),
          allow_negative_numbers = true, help_heading = "Load")]
    duration: f64,
    /// End each level after this many batches. 0 means that only the time ends it.
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = count(0, u64::MAX),
          allow_negative_numbers = true, help_heading = "Load")]
    count: u64,
    /// Most repetitions of a batch that was refused or whose server was lost.
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = count(0, u32::MAX),
          allow_negative_numbers = true, help_heading = "Load")]
    retries: u32,
    /// Check one answer in this many. 1 means every answer, 0 means none.
    #[arg(long, value_name = "COUNT", default_value_t = 16, value_parser = count(0, u64::MAX),
          allow_negative_numbers = true, help_heading = "Results")]
    verify: u64,
    /// Write the levels as comma-separated values [default: no file].
    #[arg(long, value_name = "FILE", help_heading = "Results")]
    csv: Option<PathBuf>,
    /// Draw a diagram of latency against offered load, as SVG [default: no file].
    #[arg(long, value_name = "FILE", help_heading = "Results")]
    plot: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long, help_heading = "Results")]
    json: bool,
    /// Compute threads in this process. 0 means one per core.
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = count(0, MOST_THREADS),
          allow_negative_numbers = true, help_heading = "Who answers")]
    threads: usize,
    #[command(flatten)]
    remote: RemoteArgs,
    /// The number of connections. `--remote` may name several servers on one store, separated by commas;
    /// the connections go to them in turn [default: one per server].
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

/// The times at which the batches of an open loop are due.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Distribution {
    /// At even intervals.
    #[default]
    Constant,
    /// At random times, as independent clients send.
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
    let (answerers, ids) = args.answerers(batches.hulls()).await.map_err(|error| match &args.scene {
        Some(path) => in_scene(error, &shown("--scene", path)),
        None => error,
    })?;
    let margin = args.margin.unwrap_or(batches.margin());
    let options = args.accuracy.query_options(margin, &args.outputs);
    let interrupted = Arc::new(AtomicBool::new(false));
    tokio::spawn(note_interrupt(interrupted.clone()));
    let work = Work::new(args, answerers, &batches, &ids, &options, &interrupted)?;
    let mut plan = args.plan();
    let (mut rows, mut clean) = (Vec::new(), Ok(()));
    while let Some(level) = plan.level() {
        let (tally, elapsed) = work.measure(level).await?;
        let row = tally.row(level, elapsed, args.percentile);
        plan.went(level, row.latency[4] <= args.latency_threshold);
        rows.push(row);
        let title = format!("{}, {} {}", work.title(), level.kind(), level.value());
        if args.json {
            println!("{}", tally.json(&title, elapsed)?);
        } else {
            print!("{}", tally.text(&title, work.unit(), elapsed));
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
        write("--plot", path, sheet::svg(&work.title(), &rows))?;
    }
    clean.map_err(Into::into)
}

/// The kind of work that the loops send.
enum Work {
    Batches(String, Runner),
    Steps(StepRunner),
}

impl Work {
    fn new(
        args: &Args,
        answerers: Vec<Answerer>,
        batches: &Batches,
        ids: &[HullId],
        options: &QueryOptions,
        interrupted: &Arc<AtomicBool>,
    ) -> Result<Self, Error> {
        let (args, interrupted) = (args.clone(), interrupted.clone());
        if !args.session {
            let sampled = Arc::new(batches.prepare(ids, options, args.verify)?);
            let title = batches.title().to_owned();
            return Ok(Self::Batches(title, Runner { answerers, sampled, interrupted, args }));
        }
        steps::check_margin(options.margin)?;
        let (hulls, ids) = (Arc::new(batches.hulls().to_vec()), Arc::new(ids.to_vec()));
        Ok(Self::Steps(StepRunner { answerers, hulls, ids, options: options.clone(), interrupted, args }))
    }

    fn title(&self) -> String {
        match self {
            Self::Batches(title, _) => title.clone(),
            Self::Steps(runner) => runner.title(),
        }
    }

    fn unit(&self) -> &'static str {
        match self {
            Self::Batches(..) => tally::BATCH,
            Self::Steps(_) => tally::STEP,
        }
    }

    async fn measure(&self, level: Level) -> Result<(Tally, Duration), Error> {
        match self {
            Self::Batches(_, runner) => runner.measure(level).await,
            Self::Steps(runner) => runner.measure(level).await,
        }
    }
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
            (None, None) => Plan::new(concurrency, LevelRange::one(self.concurrency), false),
        }
    }

    /// The sources of answers, and the ids of the hulls there. The sources are connections, which go to
    /// the servers in turn, or this process.
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
        if self.session {
            // Only the hulls are used.
            return Batches::generated(family, regime, SESSION_PAIRS, 1, self.seed);
        }
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

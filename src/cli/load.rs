//! `hullcast load`: a closed loop of batches, timed and checked.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use super::Error;
use super::answer::{Answerer, another_connection};
use super::batches::{Batches, Sampled};
use super::options::{AccuracyArgs, OutputArg};
use super::remote::RemoteArgs;
use super::tally::Tally;
use hullcast::workload::{Family, Regime};

/// How often the progress line is renewed.
const REFRESH: Duration = Duration::from_millis(200);
/// Before a refused batch is sent again: what a busy server asks for by default.
const PAUSE_WHEN_REFUSED: Duration = Duration::from_millis(20);

/// Sends batches in a closed loop, and checks a sample of the answers.
///
/// Each of `--concurrency` loops sends its next batch when its last is
/// answered. Answers are checked to the last bit against the library, called
/// in this process a pair at a time. The exit code is 1 where a call failed or
/// an answer was wrong.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Args {
    /// Batches from a scene file: each of its configurations in turn.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["family", "regime"])]
    scene: Option<PathBuf>,
    /// Batches of generated hulls.
    #[arg(long, value_enum, default_value_t)]
    family: FamilyArg,
    /// How the generated pairs meet.
    #[arg(long, value_enum, default_value_t)]
    regime: RegimeArg,
    /// Pairs a batch; a scene's pairs are repeated up to it [default: 4096, or the scene's].
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u32).range(1..))]
    pairs: Option<u32>,
    /// Distinct generated batches.
    #[arg(long, value_name = "COUNT", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    batches: u32,
    /// Of the generated hulls and poses.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    remote: RemoteArgs,
    /// Batches under way at once.
    #[arg(long, value_name = "COUNT", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..))]
    concurrency: u32,
    /// Connections to the server, shared evenly.
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    connections: u32,
    /// How long.
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0, value_parser = seconds)]
    duration: f64,
    /// End after this many batches; 0: by time alone.
    #[arg(long, value_name = "COUNT", default_value_t = 0)]
    count: u64,
    /// Check one answer in so many; 1: every one, 0: none.
    #[arg(long, value_name = "COUNT", default_value_t = 16)]
    verify: u64,
    /// Contact points are wanted within it; inf: everywhere [default: 0.005, or the scene's].
    #[arg(long, value_name = "LENGTH")]
    margin: Option<f64>,
    /// Column groups to compute.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "NAMES",
          default_values_t = [OutputArg::Alpha, OutputArg::Normal, OutputArg::Points])]
    outputs: Vec<OutputArg>,
    /// Compute threads in this process; 0: one a core.
    #[arg(long, value_name = "COUNT", default_value_t = 0)]
    threads: usize,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    accuracy: AccuracyArgs,
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

fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|e| format!("{e}"))?;
    if (0.0..=1e7).contains(&value) { Ok(value) } else { Err("expected 0 to 1e7".into()) }
}

/// Runs `hullcast load`.
///
/// # Errors
/// The load cannot be prepared, or the run was not clean; its summary is printed either way.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    tokio::runtime::Runtime::new()?.block_on(loaded(args))
}

async fn loaded(args: &Args) -> Result<(), Error> {
    let batches = args.batches()?;
    let (first, ids) = match &args.remote.remote {
        Some(address) => Answerer::remote(address, &args.remote, batches.hulls()).await?,
        None => Answerer::local(batches.hulls(), args.threads)?,
    };
    let mut answerers = vec![first];
    if let Some(address) = &args.remote.remote {
        for _ in 1..args.connections {
            answerers.push(another_connection(address, &args.remote).await?);
        }
    }
    let margin = args.margin.unwrap_or(batches.margin());
    let sampled =
        Arc::new(batches.prepare(&ids, &args.accuracy.asked(margin, &args.outputs), args.verify)?);
    let live = Arc::new(Live::default());
    let started = Instant::now();
    let loops: Vec<_> = (0..args.concurrency)
        .map(|i| {
            let answerer = answerers[i as usize % answerers.len()].clone();
            let plan = Plan { answerer, sampled: sampled.clone(), live: live.clone(), args: args.clone() };
            tokio::spawn(plan.run(started))
        })
        .collect();
    let progress = tokio::spawn(show_progress(live, started, Duration::from_secs_f64(args.duration)));
    let mut tally = Tally::default();
    for one in loops {
        tally.add(one.await??)?;
    }
    let elapsed = started.elapsed();
    progress.abort();
    // Aborted or done: either way the line is gone before the summary comes.
    let _ = progress.await;
    let title = format!("{}, {} at a time", batches.title(), args.concurrency);
    if args.json {
        println!("{}", tally.json(&title, elapsed)?);
    } else {
        print!("{}", tally.text(&title, elapsed));
    }
    tally.verdict().map_err(Into::into)
}

impl Args {
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

/// What the progress line shows.
#[derive(Debug, Default)]
struct Live {
    /// Batches begun.
    begun: AtomicU64,
    pairs: AtomicU64,
    errors: AtomicU64,
    last_nanos: AtomicU64,
}

/// One of the concurrent loops.
struct Plan {
    answerer: Answerer,
    sampled: Arc<Sampled>,
    live: Arc<Live>,
    args: Args,
}

impl Plan {
    async fn run(self, started: Instant) -> Result<Tally, String> {
        let mut tally = Tally::default();
        let limit = Duration::from_secs_f64(self.args.duration);
        while started.elapsed() < limit {
            let number = self.live.begun.fetch_add(1, Ordering::Relaxed);
            if self.args.count > 0 && number >= self.args.count {
                break;
            }
            self.one(number, &mut tally).await?;
        }
        Ok(tally)
    }

    /// Sends batch `number` and counts its answer.
    async fn one(&self, number: u64, tally: &mut Tally) -> Result<(), String> {
        let request = self.sampled.request(number);
        let sent = Instant::now();
        match self.answerer.answer(request).await {
            Ok(response) => {
                let took = sent.elapsed();
                let pairs = response.outcomes.len() as u64;
                tally.answered(pairs, took).map_err(|e| e.to_string())?;
                self.live.pairs.fetch_add(pairs, Ordering::Relaxed);
                self.live.last_nanos.store(took.as_nanos() as u64, Ordering::Relaxed);
                if let Some(right) = self.sampled.check(number, &response) {
                    tally.checked(pairs, right);
                }
            }
            Err(why) => {
                self.live.errors.fetch_add(1, Ordering::Relaxed);
                tally.failed(why);
                tokio::time::sleep(PAUSE_WHEN_REFUSED).await;
            }
        }
        Ok(())
    }
}

/// A line on standard error, where that is a terminal.
async fn show_progress(live: Arc<Live>, started: Instant, limit: Duration) {
    let bar = ProgressBar::new(limit.as_millis().max(1) as u64);
    if let Ok(style) = ProgressStyle::with_template("{wide_bar} {msg}") {
        bar.set_style(style);
    }
    let _clear = ClearWhenDropped(bar.clone());
    let (mut then, mut before) = (started, 0);
    loop {
        tokio::time::sleep(REFRESH).await;
        let (now, pairs) = (Instant::now(), live.pairs.load(Ordering::Relaxed));
        let rate = (pairs - before) as f64 / (now - then).as_secs_f64();
        (then, before) = (now, pairs);
        bar.set_position(started.elapsed().as_millis() as u64);
        bar.set_message(format!(
            "{:.3} M pairs/s, last batch {:.2} ms, {} errors",
            rate / 1e6,
            live.last_nanos.load(Ordering::Relaxed) as f64 / 1e6,
            live.errors.load(Ordering::Relaxed)
        ));
    }
}

struct ClearWhenDropped(ProgressBar);

impl Drop for ClearWhenDropped {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

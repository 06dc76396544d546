//! `hullcast load`: batches in a closed or an open loop, timed and checked.

mod levels;
mod sheet;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
pub(crate) use levels::Level;
use levels::{Plan, Range};
use tokio::task::JoinSet;

use super::Error;
use super::answer::{Answerer, Refusal, another_connection};
use super::batches::{Batches, Sampled};
use super::options::{AccuracyArgs, OutputArg};
use super::remote::RemoteArgs;
use super::scene::HullPoints;
use super::tally::Tally;
use hullcast::store::HullId;
use hullcast::workload::{Family, Random, Regime};
pub(crate) use sheet::Row;

/// How often the progress line is renewed.
const REFRESH: Duration = Duration::from_millis(200);
/// After a call that failed, so that a server that is gone is not called in a tight loop;
/// twice as long each time, so that `--retries 10` last longer than a balancer needs to see it.
const PAUSE_AFTER_ERROR: Duration = Duration::from_millis(20);
/// The longest of those pauses.
const LONGEST_PAUSE: Duration = Duration::from_secs(2);
/// Batches of an open loop that may be under way: past them it waits, and what waits is late.
const MOST_UNDER_WAY: usize = 16_384;

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
    /// Closed loops level by level: start:end:step batches under way at once.
    #[arg(long, value_name = "RANGE", conflicts_with = "concurrency")]
    concurrency_range: Option<Range>,
    /// An open loop level by level: start:end:step batches a second.
    #[arg(long, value_name = "RANGE", conflicts_with_all = ["concurrency", "concurrency_range"])]
    request_rate_range: Option<Range>,
    /// When the batches of an open loop are due.
    #[arg(long, value_enum, default_value_t)]
    request_distribution: Distribution,
    /// A level whose latency is above this, in milliseconds, is too much: the last.
    #[arg(long, value_name = "MS", default_value_t = f64::INFINITY)]
    latency_threshold: f64,
    /// The percentile that the threshold is held against.
    #[arg(long, value_name = "PERCENT", default_value_t = 99.0, value_parser = percent)]
    percentile: f64,
    /// Search the range for the most load within the threshold.
    #[arg(long, requires = "latency_threshold")]
    binary_search: bool,
    /// Times that a batch is sent again that was shed, or whose server was lost.
    #[arg(long, value_name = "COUNT", default_value_t = 0)]
    retries: u32,
    /// Write the levels as comma-separated values.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw latency against offered load, as SVG.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Connections, shared evenly: `--remote` may be several servers on one store,
    /// separated by commas, which take turns [default: one a server].
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u32).range(1..))]
    connections: Option<u32>,
    /// How long each level lasts.
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

/// When the batches of an open loop are due.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Distribution {
    /// At even intervals.
    #[default]
    Constant,
    /// As independent clients send.
    Poisson,
}

fn percent(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|e| format!("{e}"))?;
    if (0.0..=100.0).contains(&value) { Ok(value) } else { Err("expected 0 to 100".into()) }
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
        std::fs::write(path, sheet::csv(&rows))?;
    }
    if let Some(path) = &args.plot {
        std::fs::write(path, sheet::svg(batches.title(), &rows))?;
    }
    clean.map_err(Into::into)
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

    /// Connections to the servers in turn, or this process; and the hulls there.
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

/// What the progress line shows.
#[derive(Debug, Default)]
struct Live {
    /// Batches begun.
    begun: AtomicU64,
    pairs: AtomicU64,
    errors: AtomicU64,
    last_nanos: AtomicU64,
}

/// Measures levels.
#[derive(Clone)]
struct Runner {
    answerers: Vec<Answerer>,
    sampled: Arc<Sampled>,
    interrupted: Arc<AtomicBool>,
    args: Args,
}

impl Runner {
    /// One level, and how long it took to be answered.
    async fn measure(&self, level: Level) -> Result<(Tally, Duration), Error> {
        let live = Arc::new(Live::default());
        let started = Instant::now();
        let limit = Duration::from_secs_f64(self.args.duration);
        let progress = tokio::spawn(show_progress(live.clone(), started, limit));
        let tally = match level {
            Level::Concurrency(count) => self.closed(count, &live, started + limit).await,
            Level::Rate(rate) => self.open(rate, &live, started).await,
        };
        let elapsed = started.elapsed();
        progress.abort();
        // Aborted or done: either way the line is gone before the summary comes.
        let _ = progress.await;
        Ok((tally?, elapsed))
    }

    async fn closed(&self, loops: u32, live: &Arc<Live>, end: Instant) -> Result<Tally, Error> {
        let mut running = JoinSet::new();
        for _ in 0..loops {
            let (one, live) = (self.clone(), live.clone());
            running.spawn(async move {
                let mut tally = Tally::default();
                while Instant::now() < end && !one.interrupted.load(Ordering::Relaxed) {
                    let number = live.begun.fetch_add(1, Ordering::Relaxed);
                    if one.args.count > 0 && number >= one.args.count {
                        break;
                    }
                    one.batch(number, Instant::now(), &live, &mut tally).await?;
                }
                Ok(tally)
            });
        }
        added(running).await
    }

    async fn open(&self, rate: f64, live: &Arc<Live>, started: Instant) -> Result<Tally, Error> {
        let mut due = started;
        let mut random = Random::new(self.args.seed);
        let (mut tally, mut running) = (Tally::default(), JoinSet::new());
        for number in 0.. {
            let gap = match self.args.request_distribution {
                Distribution::Constant => 1.0,
                Distribution::Poisson => exponential(&mut random),
            };
            due += Duration::try_from_secs_f64(gap / rate)?;
            let over = due.duration_since(started).as_secs_f64() > self.args.duration;
            let enough = self.args.count > 0 && number >= self.args.count;
            if over || enough || self.interrupted.load(Ordering::Relaxed) {
                break;
            }
            tokio::time::sleep_until(due.into()).await;
            while let Some(done) = running.try_join_next() {
                tally.add(done??)?;
            }
            if running.len() >= MOST_UNDER_WAY
                && let Some(done) = running.join_next().await
            {
                tally.add(done??)?;
            }
            let (one, live) = (self.clone(), live.clone());
            live.begun.fetch_add(1, Ordering::Relaxed);
            running.spawn(async move {
                let mut tally = Tally::default();
                one.batch(number, due, &live, &mut tally).await?;
                Ok::<_, String>(tally)
            });
        }
        tally.add(added(running).await?)?;
        Ok(tally)
    }

    /// Sends batch `number`, due at `due`, and counts its answer.
    async fn batch(&self, number: u64, due: Instant, live: &Live, tally: &mut Tally) -> Result<(), String> {
        tally.sent();
        for attempt in 0..=self.args.retries {
            // The servers take turns. Again at the next one: the one that was lost may be for long.
            let answerer = &self.answerers[(number as usize + attempt as usize) % self.answerers.len()];
            match answerer.answer(self.sampled.request(number)).await {
                Ok(response) => {
                    let took = due.elapsed();
                    let pairs = response.outcomes.len() as u64;
                    tally.answered(pairs, took).map_err(|e| e.to_string())?;
                    live.pairs.fetch_add(pairs, Ordering::Relaxed);
                    live.last_nanos.store(took.as_nanos() as u64, Ordering::Relaxed);
                    if let Some(right) = self.sampled.check(number, &response) {
                        tally.checked(pairs, right);
                    }
                    return Ok(());
                }
                Err(Refusal { retry_after: Some(pause), .. }) => {
                    tally.shed();
                    // A closed loop waits before its next batch, too: it was asked to.
                    let closed = self.args.request_rate_range.is_none();
                    if closed || attempt < self.args.retries {
                        tokio::time::sleep(pause).await;
                    }
                }
                Err(Refusal { lost: true, .. }) if attempt < self.args.retries => {
                    tally.lost();
                    tokio::time::sleep((PAUSE_AFTER_ERROR * (1 << attempt.min(10))).min(LONGEST_PAUSE)).await;
                }
                Err(Refusal { text, .. }) => {
                    live.errors.fetch_add(1, Ordering::Relaxed);
                    tally.failed(text);
                    tokio::time::sleep(PAUSE_AFTER_ERROR).await;
                    return Ok(());
                }
            }
        }
        Ok(())
    }
}

/// All counts together.
async fn added(mut running: JoinSet<Result<Tally, String>>) -> Result<Tally, Error> {
    let mut tally = Tally::default();
    while let Some(done) = running.join_next().await {
        tally.add(done??)?;
    }
    Ok(tally)
}

/// Sets it when the user has had enough; a second interrupt ends the process.
async fn note_interrupt(interrupted: Arc<AtomicBool>) {
    // Where the system has no signals, time alone ends a run.
    while tokio::signal::ctrl_c().await.is_ok() {
        if interrupted.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    }
}

/// Exponentially distributed, of mean 1.
fn exponential(random: &mut Random) -> f64 {
    // Of (0, 1]: the logarithm is finite.
    -(1.0 - random.unit()).ln()
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches intervals that are not those of independent clients: their mean is 1, their
    /// variance too, and one in e is above the mean.
    #[test]
    fn poisson_intervals_are_exponential() {
        let mut random = Random::new(1);
        let gaps: Vec<f64> = (0..100_000).map(|_| exponential(&mut random)).collect();
        let mean = gaps.iter().sum::<f64>() / 1e5;
        let variance = gaps.iter().map(|gap| (gap - mean).powi(2)).sum::<f64>() / 1e5;
        let above = gaps.iter().filter(|gap| **gap > 1.0).count() as f64 / 1e5;
        assert!((mean - 1.0).abs() < 0.02 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
        assert!((above - (-1.0_f64).exp()).abs() < 0.01, "{above}");
    }
}

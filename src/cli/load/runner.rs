//! Sends the batches of a level, in a closed or an open loop, and counts the answers.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use tokio::task::JoinSet;

use super::batches::SampledRequests;
use super::levels::Level;
use super::progress::{LiveCounts, timed};
use super::tally::Tally;
use super::{Args, Distribution};
use crate::cli::Error;
use crate::cli::answer::{Answerer, QueryRefusal};
use hullcast::workload::Random;

/// Pause after a failed call, so that a lost server is not called in a tight loop. The pause doubles
/// each time, so that `--retries 10` lasts longer than a load balancer needs to notice the loss.
pub(super) const PAUSE_AFTER_ERROR: Duration = Duration::from_millis(20);
/// The longest of those pauses.
const LONGEST_PAUSE: Duration = Duration::from_secs(2);
/// Largest number of batches in flight in an open loop. At this number the loop waits, and later batches
/// are late.
const MOST_UNDER_WAY: usize = 16_384;

/// Measures levels.
#[derive(Clone)]
pub(super) struct Runner {
    pub(super) answerers: Vec<Answerer>,
    pub(super) sampled: Arc<SampledRequests>,
    pub(super) interrupted: Arc<AtomicBool>,
    pub(super) args: Args,
}

impl Runner {
    /// Measures one level. Returns its counts, and the time until all batches were answered.
    pub(super) async fn measure(&self, level: Level) -> Result<(Tally, Duration), Error> {
        let (tally, elapsed) = timed(self.args.duration, async |live, started, end| match level {
            Level::Concurrency(count) => self.closed(count, &live, end).await,
            Level::Rate(rate) => self.open(rate, &live, started).await,
        })
        .await;
        Ok((tally?, elapsed))
    }

    async fn closed(&self, loops: u32, live: &Arc<LiveCounts>, end: Instant) -> Result<Tally, Error> {
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

    async fn open(&self, rate: f64, live: &Arc<LiveCounts>, started: Instant) -> Result<Tally, Error> {
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
    async fn batch(
        &self,
        number: u64,
        due: Instant,
        live: &LiveCounts,
        tally: &mut Tally,
    ) -> Result<(), String> {
        tally.sent();
        for attempt in 0..=self.args.retries {
            // The servers take turns. A repeated batch goes to the next server, because the lost one
            // may stay lost.
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
                Err(QueryRefusal { retry_after: Some(pause), .. }) => {
                    tally.shed();
                    // The server asked for a pause, so a closed loop waits before its next batch, too.
                    let closed = self.args.request_rate_range.is_none();
                    if closed || attempt < self.args.retries {
                        tokio::time::sleep(pause).await;
                    }
                }
                Err(QueryRefusal { lost: true, .. }) if attempt < self.args.retries => {
                    tally.lost();
                    tokio::time::sleep((PAUSE_AFTER_ERROR * (1 << attempt.min(10))).min(LONGEST_PAUSE)).await;
                }
                Err(QueryRefusal { text, .. }) => {
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

/// The sum of all counts.
pub(super) async fn added(mut running: JoinSet<Result<Tally, String>>) -> Result<Tally, Error> {
    let mut tally = Tally::default();
    while let Some(done) = running.join_next().await {
        tally.add(done??)?;
    }
    Ok(tally)
}

/// An exponentially distributed number with mean 1.
fn exponential(random: &mut Random) -> f64 {
    // The argument is in (0, 1], so the logarithm is finite.
    -(1.0 - random.unit()).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean of the intervals must be 1, and so must their variance; one in e must be above the mean.
    /// Catches intervals that are not those of independent clients.
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

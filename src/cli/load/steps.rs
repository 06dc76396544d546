//! Step loops: each loop of a level is a session in which the server finds the pairs.
//!
//! The bodies lie in a cube in which each touches a few others. Every body has a place of its own. In a step, a
//! share of the bodies moves to a random pose near its place, and a share jumps to another place, so that its
//! pairs end and other pairs begin. So the number of pairs stays about the same, however long the loop runs.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use hullcast_client::{Client, Hull, Session};
use tokio::task::JoinSet;

use super::Args;
use super::levels::Level;
use super::progress::{LiveCounts, timed};
use super::runner::{PAUSE_AFTER_ERROR, added};
use super::tally::Tally;
use crate::cli::Error;
use crate::cli::answer::{Answerer, QueryRefusal, client_hull};
use crate::cli::exit::Exit;
use crate::cli::options::QueryOptions;
use crate::cli::scene::HullPoints;
use hullcast::proto::{QueryContactsRequest, QueryContactsResponse};
use hullcast::store::HullId;
use hullcast::workload::Random;

/// The side of the cube per body: with the hulls of the generated batches, there are one to three pairs per body.
const SPACING: f64 = 1.45;
/// The standard deviation of a body's distance from its place, and of its quaternion from that of its place.
const SHAKE: f64 = 0.005;
/// The relative difference that is allowed between the growth scales of a step and of a search: the solver of a
/// session starts from the solution of the step before.
const ROUNDING: f64 = 1e-12;

/// Measures step loops.
#[derive(Clone)]
pub(super) struct StepRunner {
    pub(super) answerers: Vec<Answerer>,
    pub(super) hulls: Arc<Vec<HullPoints>>,
    pub(super) ids: Arc<Vec<HullId>>,
    pub(super) options: QueryOptions,
    pub(super) interrupted: Arc<AtomicBool>,
    pub(super) args: Args,
}

impl StepRunner {
    /// The title for display.
    pub(super) fn title(&self) -> String {
        let Args { bodies, moved, churn, .. } = &self.args;
        let percent = |share: &f64| (1e4 * share).round() / 100.0;
        format!(
            "sessions of {bodies} bodies, of which {} % move and {} % jump in each step",
            percent(moved),
            percent(churn)
        )
    }

    /// Measures one level: as many sessions as its concurrency. Returns its counts, and the time until all steps
    /// were answered.
    pub(super) async fn measure(&self, level: Level) -> Result<(Tally, Duration), Error> {
        let (tally, elapsed) = timed(self.args.duration, async |live, _, end| {
            let mut running = JoinSet::new();
            for number in 0..level.value() as u64 {
                let (runner, live) = (self.clone(), live.clone());
                running.spawn(async move { runner.session(number, &live, end).await });
            }
            added(running).await
        })
        .await;
        Ok((tally?, elapsed))
    }

    /// Makes the steps of one session until `end`.
    async fn session(&self, number: u64, live: &LiveCounts, end: Instant) -> Result<Tally, String> {
        let mut tally = Tally::default();
        let Answerer::Remote(client) = &self.answerers[number as usize % self.answerers.len()] else {
            return Err("a session needs a server".into());
        };
        let mut bodies = Heap::new(self.args.bodies, self.hulls.len(), self.args.seed.wrapping_add(number));
        let hulls: Vec<Hull> = self.hulls.iter().map(client_hull).collect();
        let mut session = client.session(self.request(&bodies), hulls);
        while Instant::now() < end && !self.interrupted.load(Ordering::Relaxed) {
            let step = live.begun.fetch_add(1, Ordering::Relaxed);
            if self.args.count > 0 && step >= self.args.count {
                break;
            }
            self.step(step, client, &mut session, &bodies, live, &mut tally).await?;
            bodies.step(self.args.moved, self.args.churn);
        }
        Ok(tally)
    }

    async fn step(
        &self,
        number: u64,
        client: &Client,
        session: &mut Session,
        bodies: &Heap,
        live: &LiveCounts,
        tally: &mut Tally,
    ) -> Result<(), String> {
        tally.sent();
        let began = Instant::now();
        match session.step(&bodies.positions, &bodies.rotations).await {
            Ok(answer) => {
                let took = began.elapsed();
                let pairs = answer.outcomes.len() as u64;
                tally.answered(pairs, took).map_err(|error| error.to_string())?;
                live.pairs.fetch_add(pairs, Ordering::Relaxed);
                live.last_nanos.store(took.as_nanos() as u64, Ordering::Relaxed);
                if self.args.verify > 0 && number.is_multiple_of(self.args.verify) {
                    let mut request = self.request(bodies);
                    request.find = false;
                    match client.find_all(&request).await {
                        Ok(found) => tally.checked(pairs, agree(&answer, &found)),
                        Err(error) => failed(QueryRefusal::from(error), live, tally).await,
                    }
                }
            }
            Err(error) => failed(QueryRefusal::from(error), live, tally).await,
        }
        Ok(())
    }

    /// The whole request for the bodies where they are.
    fn request(&self, bodies: &Heap) -> QueryContactsRequest {
        QueryContactsRequest {
            hull_ids: self.ids.iter().map(|id| id.0.to_vec()).collect(),
            body_hulls: bodies.hulls.clone(),
            positions: bodies.positions.as_flattened().to_vec(),
            rotations: bodies.rotations.as_flattened().to_vec(),
            margin: self.options.margin,
            accuracy: Some(self.options.accuracy),
            outputs: self.options.outputs.clone(),
            find: true,
            ..Default::default()
        }
    }
}

/// Counts a call that was refused or failed, and waits before the next one.
async fn failed(refusal: QueryRefusal, live: &LiveCounts, tally: &mut Tally) {
    if let Some(pause) = refusal.retry_after {
        tally.shed();
        tokio::time::sleep(pause).await;
    } else {
        live.errors.fetch_add(1, Ordering::Relaxed);
        tally.failed(refusal.text);
        tokio::time::sleep(PAUSE_AFTER_ERROR).await;
    }
}

/// Whether a step has the pairs and outcomes of a search, and, if both have them, its growth scales.
fn agree(step: &QueryContactsResponse, found: &QueryContactsResponse) -> bool {
    let is_near = |(a, b): (&f64, &f64)| (a - b).abs() <= ROUNDING * b.abs() || a.to_bits() == b.to_bits();
    step.pairs == found.pairs
        && step.outcomes == found.outcomes
        && step.alphas.len() == found.alphas.len()
        && step.alphas.iter().zip(&found.alphas).all(is_near)
}

/// The bodies of one loop.
struct Heap {
    random: Random,
    side: f64,
    hulls: Vec<u32>,
    /// The pose around which each body moves.
    places: Vec<([f64; 3], [f64; 4])>,
    positions: Vec<[f64; 3]>,
    rotations: Vec<[f64; 4]>,
}

impl Heap {
    fn new(bodies: u32, hulls: usize, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let side = SPACING * f64::from(bodies).cbrt();
        let places: Vec<_> = (0..bodies).map(|_| place(&mut random, side)).collect();
        Self {
            hulls: (0..bodies).map(|_| random.below(hulls) as u32).collect(),
            positions: places.iter().map(|(position, _)| *position).collect(),
            rotations: places.iter().map(|(_, rotation)| *rotation).collect(),
            random,
            side,
            places,
        }
    }

    /// Moves a share of the bodies about their places, and gives a share another place.
    fn step(&mut self, moved: f64, jump: f64) {
        for body in 0..self.places.len() {
            let jumps = self.random.unit() < jump;
            if jumps {
                self.places[body] = place(&mut self.random, self.side);
            }
            if jumps || self.random.unit() < moved {
                let (position, rotation) = self.places[body];
                self.positions[body] = position.map(|x| x + SHAKE * self.random.normal());
                // The server normalises the quaternion.
                self.rotations[body] = rotation.map(|x| x + SHAKE * self.random.normal());
            }
        }
    }
}

fn place(random: &mut Random, side: f64) -> ([f64; 3], [f64; 4]) {
    ([(); 3].map(|()| random.within(0.0, side)), random.rotation().to_array())
}

/// Refuses a margin with which a server cannot find pairs.
///
/// # Errors
/// The margin is infinite.
pub(super) fn check_margin(margin: f64) -> Result<(), Error> {
    if margin.is_finite() {
        return Ok(());
    }
    Err(Exit::Usage
        .error("--margin is inf, but --session needs a finite margin: the server finds only pairs within a finite margin"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a share of bodies that is not the one asked for, and bodies that drift away from their places.
    #[test]
    fn the_shares_of_bodies_move_and_jump() {
        let mut heap = Heap::new(10_000, 4, 1);
        let is_near = |heap: &Heap, body: usize| {
            heap.positions[body].iter().zip(heap.places[body].0).all(|(x, at)| (x - at).abs() < 10.0 * SHAKE)
        };
        for (moved, jump) in [(0.0, 0.0), (0.1, 0.0), (0.0, 0.01), (0.1, 0.01), (1.0, 0.0), (1.0, 1.0)] {
            let (places, positions) = (heap.places.clone(), heap.positions.clone());
            heap.step(moved, jump);
            let share = |changed: &dyn Fn(usize) -> bool| {
                (0..places.len()).filter(|body| changed(*body)).count() as f64 / places.len() as f64
            };
            let jumped = share(&|body| heap.places[body] != places[body]);
            let changed = share(&|body| heap.positions[body] != positions[body]);
            let expected = jump + (1.0 - jump) * moved;
            assert!((jumped - jump).abs() < 0.005, "{jumped} {jump}");
            assert!((changed - expected).abs() < 0.015, "{changed} {expected}");
            assert!((0..places.len()).all(|body| is_near(&heap, body)));
        }
    }

    /// Catches a check that passes another pair, outcome or growth scale, or fails because of rounding.
    #[test]
    fn answers_that_differ_are_found() {
        let answer = QueryContactsResponse {
            pairs: vec![0, 1],
            outcomes: vec![1],
            alphas: vec![0.75],
            ..Default::default()
        };
        let with = |change: fn(&mut QueryContactsResponse)| {
            let mut other = answer.clone();
            change(&mut other);
            agree(&other, &answer)
        };
        assert!(with(|_| {}) && with(|other| other.alphas[0] = 0.75_f64.next_up()));
        assert!(!with(|other| other.pairs[1] = 2) && !with(|other| other.outcomes[0] = 2));
        assert!(!with(|other| other.alphas[0] += 1e-9) && !with(|other| other.alphas.clear()));
        assert!(!with(|other| other.alphas[0] = f64::NAN));
    }
}

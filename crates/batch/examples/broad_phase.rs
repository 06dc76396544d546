//! Measures the broad phase of a pile from step to step: built anew, or kept and updated, on one thread.
//!
//! `cargo run --release --package hullcast-batch --example broad_phase`

use std::{hint::black_box, time::Instant};

use glam::DVec3;
use hullcast_batch::broad_phase::{BroadPhase, MovedBodies, MovedSearch, PairSearch, Rules};
use hullcast_contact::{Bounds, Stop, workload::Random};

const STEPS: usize = 60;

fn main() {
    println!("bodies  moved  pairs  built: build + search  kept: update + search, or of the moved bodies");
    for bodies in [1_000, 10_000] {
        for percent in [100, 10, 0] {
            measure(bodies, percent);
        }
    }
}

/// Boxes of about 0.9 m that lie as densely as a heap. In each step, every moved body moves by some millimetres.
fn measure(bodies: usize, percent: usize) {
    let mut random = Random::new(1);
    let side = (bodies as f64).cbrt();
    let mut vector = |low: f64, high: f64| DVec3::from_array([0; 3].map(|_| random.within(low, high)));
    let mut centres: Vec<DVec3> = (0..bodies).map(|_| vector(0.0, side)).collect();
    let halves: Vec<DVec3> = (0..bodies).map(|_| vector(0.35, 0.55)).collect();
    let bounds_of = |centre: DVec3, half: DVec3| Some(Bounds { low: centre - half, high: centre + half });
    let mut bounds: Vec<_> = centres.iter().zip(&halves).map(|(&c, &h)| bounds_of(c, h)).collect();
    let stop = Stop::default();
    let mut kept = build(&bounds, &stop);
    let mut times = [(); 5].map(|()| Vec::new());
    let mut pairs = 0;
    for _ in 0..STEPS {
        let moved: Vec<u32> =
            (0..bodies as u32).filter(|body| (*body as usize * 37) % 100 < percent).collect();
        for &body in &moved {
            let body = body as usize;
            centres[body] += vector(-0.005, 0.005);
            bounds[body] = bounds_of(centres[body], halves[body]);
        }
        let new: Vec<_> = moved.iter().map(|&body| bounds[body as usize]).collect();
        let (anew, time) = timed(|| build(&bounds, &stop));
        times[0].push(time);
        let (expected, time) = timed(|| search(&anew, &stop));
        times[1].push(time);
        let (updated, time) = timed(|| kept.moved(&moved, &new, &stop).expect("nothing stops it"));
        times[2].push(time);
        kept = updated;
        let (found, time) = timed(|| search(&kept, &stop));
        times[3].push(time);
        assert_eq!(found, expected);
        let moved = MovedBodies::new(moved, bodies as u32);
        let (of_moved, time) = timed(|| search_moved(&kept, &moved, &stop));
        times[4].push(time);
        pairs = found.len() / 2;
        black_box(of_moved);
    }
    let [built, all, update, kept_all, kept_moved] = times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        1e3 * times[times.len() / 2]
    });
    println!(
        "{bodies:6}  {percent:4}%  {pairs:5}  {built:.3} + {all:.3} ms  {update:.3} + {kept_all:.3} ms, or {kept_moved:.3} ms"
    );
}

fn build(bounds: &[Option<Bounds>], stop: &Stop) -> BroadPhase {
    BroadPhase::new(bounds.to_vec(), Rules::default(), stop).expect("nothing stops it")
}

fn search(broad_phase: &BroadPhase, stop: &Stop) -> Vec<u32> {
    let mut search = PairSearch::new(0, broad_phase.bodies());
    broad_phase.search(&mut search, u64::MAX, usize::MAX, stop).expect("nothing stops it");
    search.pairs
}

fn search_moved(broad_phase: &BroadPhase, moved: &MovedBodies, stop: &Stop) -> Vec<u32> {
    let mut search = MovedSearch::new(0, moved.list().len());
    broad_phase.search_moved(moved, &mut search, u64::MAX, usize::MAX, stop).expect("nothing stops it");
    MovedSearch::pairs([search], stop).expect("nothing stops it")
}

/// The result of `work`, and the seconds that it took.
fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let started = Instant::now();
    let result = work();
    (result, started.elapsed().as_secs_f64())
}

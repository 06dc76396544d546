//! Tests of chunks, their memory and their cost, and of the engine.

use std::sync::Mutex;

use hullcast_contact::{
    ConvexHull, KinkScratch, STEPS_BETWEEN_LOOKS, Stop, Workspace, contact_manifold, derivatives,
    workload::{Family, Random, Regime, Workload},
};

use super::*;
use crate::{
    Unlimited,
    columns::InvalidPair,
    compute::Parts,
    memory::{MemoryPool, PoolIsFull, PooledMemory},
    motion::MotionColumns,
    outputs::{Output, Outputs},
    scene::{Hulls, Missing, Scene},
    wait,
};

type TestRun = super::BatchRun<PooledMemory, ()>;

fn engine(max_answer_bytes: usize) -> Engine {
    Engine::new(Compute::new(1).unwrap(), max_answer_bytes)
}

/// A batch of generated pairs with all outputs.
fn batch(family: Family, regime: Regime, pairs: usize) -> Batch {
    batch_of(family, regime, pairs, Outputs::of(Output::ALL.iter().copied()))
}

fn batch_of(family: Family, regime: Regime, pairs: usize, outputs: Outputs) -> Batch {
    let workload = Workload::generate(family, regime, pairs, 1).unwrap();
    let hulls = workload.hulls.iter().map(|points| Ok(Arc::new(ConvexHull::new(points).unwrap())));
    let scene = Scene {
        hulls: hulls.collect(),
        body_hulls: workload.pairs.iter().flat_map(|pair| pair.hulls.map(|hull| hull as u32)).collect(),
        positions: workload.pairs.iter().flat_map(|pair| pair.positions).flatten().collect(),
        rotations: workload.pairs.iter().flat_map(|pair| pair.rotations).flatten().collect(),
        pairs: (0..2 * pairs as u32).collect(),
        outputs,
        margin: 0.01,
        ..Scene::default()
    };
    scene.batch(&Stop::default()).unwrap()
}

fn run_in(engine: &Engine, batch: Batch, pool: &MemoryPool) -> TestRun {
    TestRun::new(&engine.shared, batch, &Arc::default(), pool.memory(), ())
}

fn run(engine: &Engine, batch: Batch) -> TestRun {
    run_in(engine, batch, &MemoryPool::new(u64::MAX))
}

fn answer(run: &TestRun, chunks: Vec<Columns>) -> (Columns, PooledMemory) {
    match run.whole(chunks).unwrap() {
        BatchResult::Answer(answer) => *answer,
        BatchResult::Large(computed) => computed.concatenated(&run.stop).unwrap(),
    }
}

/// Catches an allocation per pair or per chunk. Once the buffers have grown, chunks must allocate
/// nothing, and an answer only its columns. The columns of derivatives are too large to be kept for reuse.
#[test]
fn the_steady_state_allocates_nothing_per_pair() {
    let engine = engine(64 << 20);
    let outputs = Outputs {
        alpha_gradient: false,
        separation_gradient: false,
        normal_jacobian: false,
        ..Outputs::of(Output::ALL.iter().copied())
    };
    for (family, regime) in
        [Family::Box, Family::Poly16].into_iter().flat_map(|f| Regime::ALL.map(|r| (f, r)))
    {
        for pairs in [1000, 4096] {
            // Several rounds, so that the chunks' buffers are reused.
            for round in 0..8 {
                let run = run(&engine, batch_of(family, regime, pairs, outputs));
                let mut chunks = Vec::with_capacity(run.count());
                let made = allocation_counter::measure(|| {
                    chunks.extend((0..run.count()).map(|index| run.part(index).unwrap()));
                });
                assert!(round < 4 || made.count_total == 0, "{family:?} {regime:?} {pairs}: {made:?}");
                let made = allocation_counter::measure(|| {
                    assert_eq!(answer(&run, chunks).0.len(), pairs);
                });
                assert!(made.count_total <= 24, "columns, each once: {made:?}");
            }
        }
    }
    assert!(engine.pairs_computed() > 100_000);
}

/// Catches columns that are in no budget while they are computed, or after they are joined, and a
/// batch that goes on without memory.
#[test]
fn columns_are_counted_from_the_first_chunk_on() {
    let engine = engine(64 << 20);
    let of = || batch(Family::Poly16, Regime::Resting, 1000);
    let pool = MemoryPool::new(16 << 20);
    let run = run_in(&engine, of(), &pool);
    let mut held = 0;
    let mut chunks = Vec::new();
    for index in 0..run.count() {
        let chunk = run.part(index).unwrap();
        held += chunk.heap_bytes() as u64;
        assert_eq!(pool.used(), held);
        chunks.push(chunk);
    }
    let (columns, memory) = answer(&run, chunks);
    assert_eq!((memory.bytes(), pool.used()), (columns.heap_bytes() as u64, memory.bytes()));
    assert!(memory.bytes() > 100_000);
    let tight = held / 2;
    let run = run_in(&engine, of(), &MemoryPool::new(tight));
    let refused = (0..run.count()).find(|&index| run.part(index).is_err()).unwrap();
    assert!(refused > 3 && refused < run.count());
    let Some(Unanswered::NoMemory(PoolIsFull { limit, .. })) = run.unanswered.get() else { panic!() };
    assert_eq!(*limit, tight);
    assert!(run.part(refused + 1).is_err());
}

/// Catches a value that is held for longer than the answer takes, or not as long: for a batch that is computed
/// at once, one that is computed in chunks, and one whose answer is too large.
#[test]
fn held_values_are_dropped_with_the_answer() {
    let engine = engine(1 << 20);
    for (pairs, fits) in [(1, true), (500, true), (20_000, false)] {
        let held = Arc::new(Mutex::new(()));
        let (kept, mut batch) = (Arc::new(()), batch(Family::Box, Regime::Resting, pairs));
        batch.keep(kept.clone());
        let computed = wait(engine.compute(batch, &Job::new(()), Unlimited, held.clone()));
        match computed {
            Ok((columns, Unlimited)) => assert_eq!((columns.len(), fits), (pairs, true)),
            Err(error) => assert_eq!((error, fits), (EngineError::TooLarge(1 << 20), false)),
        }
        if fits {
            assert_eq!(Arc::strong_count(&held), 1, "{pairs}");
        }
        // The threads drop the rest of a batch that has no answer soon after.
        while Arc::strong_count(&held) > 1 || Arc::strong_count(&kept) > 1 {
            std::thread::yield_now();
        }
    }
}

/// Catches an engine that goes on after its job was stopped, and a panic that ends more than its own batch.
#[test]
fn stops_and_panics_are_errors() {
    let panics = |pairs: usize| assert_ne!(pairs, 7, "a bug");
    let engine = Engine::with_hook(Compute::new(1).unwrap(), 1 << 30, panics);
    let compute = |pairs: usize, job: &Job| {
        wait(engine.compute(batch(Family::Box, Regime::Resting, pairs), job, Unlimited, ())).map(|_| ())
    };
    let stopped = Job::new(());
    stopped.stop.stop();
    for pairs in [1, 1000] {
        assert_eq!(compute(pairs, &stopped), Err(EngineError::Stopped));
    }
    assert_eq!(engine.pairs_computed(), 0);
    for pairs in [7, 64 + 7] {
        let Err(EngineError::Panicked(why)) = compute(pairs, &Job::new(())) else { panic!("{pairs}") };
        assert!(why.0.contains("a bug"), "{why}");
    }
    assert_eq!(compute(1000, &Job::new(())), Ok(()));
}

/// Cuts the same pairs equally and by their cost. Catches bytes that depend on the chunks, chunks
/// that lose or repeat a pair, and a chunk that costs much more than a millisecond.
#[test]
fn the_same_columns_whatever_the_chunks() {
    let engine = engine(1 << 30);
    let mut most = 0;
    for family in [Family::Box, Family::Poly16, Family::Poly256] {
        let [equal, by_pairs] = [false, true].map(|by_pairs| {
            let run = run(&engine, batch(family, Regime::Shallow, 500));
            let run = if by_pairs { run.cut(&Stop::default()).unwrap() } else { run };
            let mut next = 0;
            let chunks = (0..run.count()).map(|index| {
                let pairs = run.chunks.pairs(index, 500);
                assert_eq!(pairs.start, next);
                next = pairs.end;
                run.part(index).unwrap()
            });
            let chunks = chunks.collect();
            assert_eq!(next, 500);
            most = most.max(run.stop.largest_between_looks());
            answer(&run, chunks).0
        });
        // NaN is not equal to itself, so compare the text.
        assert_eq!(format!("{equal:?}"), format!("{by_pairs:?}"), "{family:?}");
    }
    assert!(most > 0 && most <= 2 * STEPS_BETWEEN_LOOKS, "{most}");
}

/// Boxes, other hulls, and bodies without a hull or a usable pose, in every order. Catches an answer of a group
/// of boxes at the place of another pair, a group that loses or repeats a pair, and an answer that is not that
/// of the pair by itself. In some rounds pairs have margins of their own, from their bodies or their motion: also
/// catches a pair that is computed with the margin of another one.
#[test]
fn mixed_pairs_are_answered_one_by_one_and_together() {
    let engine = engine(1 << 30);
    let mut random = Random::new(5);
    let (mut seen, mut wider) = ([0; 3], 0);
    for round in 0..20 {
        let pairs = 1 + 13 * round;
        let [boxes, others] = [Family::Box, Family::Poly16]
            .map(|family| Workload::generate(family, Regime::ALL[round % 3], pairs, round as u64).unwrap());
        // The hulls of the boxes, those of the others, and a missing one.
        let hulls = boxes.hulls.iter().chain(&others.hulls);
        let mut hulls: Hulls = hulls.map(|points| Ok(Arc::new(ConvexHull::new(points).unwrap()))).collect();
        let first_other = boxes.hulls.len();
        hulls.push(Err(Missing::Unknown));
        let (mut body_hulls, mut positions, mut rotations) = (vec![], vec![], vec![]);
        for i in 0..pairs {
            let kind = [0, 0, 1, 2][random.below(4)];
            seen[kind] += 1;
            let pair = &[&boxes, &others][kind % 2].pairs[i];
            let offset = if kind == 1 { first_other } else { 0 };
            body_hulls.extend(pair.hulls.map(|hull| (offset + hull) as u32));
            positions.extend_from_slice(pair.positions.as_flattened());
            rotations.extend_from_slice(pair.rotations.as_flattened());
            if kind == 2 && random.below(2) == 0 {
                *body_hulls.last_mut().unwrap() = hulls.len() as u32 - 1;
            } else if kind == 2 {
                *positions.last_mut().unwrap() = f64::NAN;
            }
        }
        let mut column = |entries: usize, used: bool| -> Vec<f64> {
            (0..if used { entries } else { 0 }).map(|_| random.within(0.0, 0.5)).collect()
        };
        let (margins, moves) = (column(2 * pairs, round % 4 > 1), round % 2 == 1);
        let motion = MotionColumns {
            linear_velocities: column(6 * pairs, moves),
            angular_velocities: column(6 * pairs, moves),
            time_step: if moves { 0.1 } else { 0.0 },
            ..MotionColumns::default()
        };
        let scene = Scene {
            hulls,
            body_hulls,
            positions,
            rotations,
            pairs: (0..2 * pairs as u32).collect(),
            outputs: Outputs::of(Output::ALL.iter().copied()),
            margin: 0.01,
            margins,
            motion,
            ..Scene::default()
        };
        let run = run(&engine, scene.batch(&Stop::default()).unwrap());
        let chunks = (0..run.count()).map(|index| run.part(index).unwrap()).collect();
        let together = answer(&run, chunks).0;

        let bodies = &run.batch.bodies;
        let (mut workspace, mut kinks) = (Workspace::default(), KinkScratch::default());
        let outputs = bodies.template().outputs();
        let mut alone = Columns::default();
        for pair in 0..pairs as u32 {
            let [a, b] = [0, 1].map(|side| bodies.body(2 * pair + side));
            let (Some(a), Some(b)) = (a, b) else {
                let mut invalid = InvalidPair::default();
                for body in [2 * pair, 2 * pair + 1] {
                    if let Err(missing) = bodies.hull(body) {
                        invalid.hull(*missing);
                    }
                    if bodies.pose(body).is_none() {
                        invalid.body();
                    }
                }
                alone.push_invalid(invalid, outputs);
                continue;
            };
            let query = bodies.query([2 * pair, 2 * pair + 1], [&a, &b]);
            wider += usize::from(query.margin > 0.01);
            let manifold = contact_manifold(&a, &b, &query, None, &mut workspace);
            alone.push(manifold, outputs);
            alone.push_derivatives(derivatives(&a, &b, manifold, &mut kinks).as_ref(), outputs);
        }
        assert_eq!(format!("{together:?}"), format!("{alone:?}"), "{round}");
    }
    assert!(seen.iter().all(|&count| count > 500) && wider > 1_000, "{seen:?}, {wider}");
}

/// Prisms of 2,048 sides whose end faces overlap. Catches chunks that are cut by the number of
/// pairs although each pair is expensive, and a pair whose estimate is far below its cost.
#[test]
fn chunks_of_costly_pairs_are_short() {
    let sides = 2048;
    let corner = |i: u32| {
        let angle = std::f64::consts::TAU * f64::from(i / 2) / f64::from(sides);
        [angle.cos(), angle.sin(), f64::from(i % 2)]
    };
    let prism: Vec<_> = (0..2 * sides).map(corner).collect();
    let pairs = 100;
    let scene = Scene {
        hulls: vec![Ok(Arc::new(ConvexHull::new(&prism).unwrap()))],
        body_hulls: vec![0, 0],
        positions: vec![0.0, 0.0, 0.0, 0.3, 0.1, 0.99],
        rotations: [0.0, 0.0, 0.0, 1.0].repeat(2),
        pairs: [0, 1].repeat(pairs),
        ..Scene::default()
    };
    let engine = engine(1 << 30);
    let run = run(&engine, scene.batch(&Stop::default()).unwrap());
    assert!(run.chunks.is_unknown() && !run.batch.is_small());
    let run = run.cut(&Stop::default()).unwrap();
    assert!(run.count() > 10, "{}", run.count());
    let (mut points, mut before) = (0, 0);
    for index in 0..run.count() {
        points += run.part(index).unwrap().filled_bytes();
        let steps = run.stop.steps() - before;
        assert!(steps <= 2 * STEPS_BETWEEN_LOOKS, "{steps} steps in chunk {index}");
        before += steps;
    }
    assert!(points > 1000 * pairs && run.stop.largest_between_looks() <= 1 << 20);
}

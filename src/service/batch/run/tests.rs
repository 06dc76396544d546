//! Tests of chunks, their memory and their cost, without threads.

use super::*;
use crate::{
    budget::{Caller, MemoryBudget, Part, Refusal},
    compute::Compute,
    contact::ConvexHull,
    proto::{Output, QueryContactsRequest},
    service::{batch::Bounds, limits::Limits, wire},
    workload::{Family, Regime, Workload},
};

fn engine(max_answer_bytes: usize) -> Engine {
    let bounds = Bounds { max_pairs_in_flight: 1 << 20, shares: true, max_answer_bytes };
    Engine::new(Compute::new(1).unwrap(), bounds, Arc::default())
}

/// A batch of generated pairs with all outputs.
fn batch(family: Family, regime: Regime, pairs: usize) -> Batch {
    let workload = Workload::generate(family, regime, pairs, 1).unwrap();
    let hulls = workload.hulls.iter().map(|points| Ok(Arc::new(ConvexHull::new(points).unwrap())));
    let request = QueryContactsRequest {
        hull_ids: (0..workload.hulls.len() as u8).map(|i| vec![i; 32]).collect(),
        body_hulls: workload.pairs.iter().flat_map(|pair| pair.hulls.map(|hull| hull as u32)).collect(),
        positions: workload.pairs.iter().flat_map(|pair| pair.positions).flatten().collect(),
        rotations: workload.pairs.iter().flat_map(|pair| pair.rotations).flatten().collect(),
        pairs: (0..2 * pairs as u32).collect(),
        outputs: (1..=Output::Diagnostics as i32).collect(),
        margin: 0.01,
        ..Default::default()
    };
    let scene = wire::scene(request, &Limits::default()).unwrap();
    Batch::new(scene, Arc::new(hulls.collect())).0
}

fn run(engine: &Engine, batch: Batch) -> Run {
    let job = Job::new(Caller::alone());
    let admission = engine.place(batch.pair_count(), &job.caller).unwrap();
    let mut memory = Permit::unbounded(Part::Answers);
    // As in a server, the caller already has an account.
    memory.grow(1).unwrap();
    engine.begin(batch, admission, &job, memory)
}

fn answer(run: &Run, chunks: Vec<Columns>) -> (Columns, Permit) {
    match run.whole(chunks).unwrap() {
        Chunked::Answer(answer) => *answer,
        Chunked::Large(computed) => computed.concatenated(&run.job.stop).unwrap(),
    }
}

/// Catches an allocation per pair or per chunk. Once the buffers have grown, chunks must allocate
/// nothing, and an answer only its columns.
#[test]
fn the_steady_state_allocates_nothing_per_pair() {
    let engine = engine(64 << 20);
    for regime in Regime::ALL {
        for pairs in [1000, 4096] {
            // Several rounds, so that the chunks' buffers are reused.
            for round in 0..8 {
                let run = run(&engine, batch(Family::Poly16, regime, pairs));
                let mut chunks = Vec::with_capacity(run.count());
                let made = allocation_counter::measure(|| {
                    chunks.extend((0..run.count()).map(|index| run.part(index).unwrap()));
                });
                assert!(round < 4 || made.count_total == 0, "{regime:?} {pairs}: {made:?}");
                let made = allocation_counter::measure(|| {
                    assert_eq!(answer(&run, chunks).0.len(), pairs);
                });
                assert!(made.count_total <= 22, "columns, each once: {made:?}");
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
    let budget = MemoryBudget::new(16 << 20, true, &[]);
    let mut run = run(&engine, of());
    run.memory = Mutex::new(Some(budget.take(&run.job.caller, Part::Answers, 0).unwrap()));
    let mut held = 0;
    let mut chunks = Vec::new();
    for index in 0..run.count() {
        let chunk = run.part(index).unwrap();
        held += chunk.heap_bytes() as u64;
        assert_eq!(budget.used_by(Part::Answers), held);
        chunks.push(chunk);
    }
    let (columns, memory) = answer(&run, chunks);
    assert_eq!((memory.bytes(), budget.used()), (columns.heap_bytes() as u64, memory.bytes()));
    assert!(memory.bytes() > 100_000);
    let tight = MemoryBudget::new(held, true, &[]);
    let run = Run {
        memory: Mutex::new(Some(tight.take(&run.job.caller, Part::Answers, 0).unwrap())),
        ..self::run(&engine, of())
    };
    let refused = (0..run.count()).find(|&index| run.part(index).is_err()).unwrap();
    assert!(refused > 3 && refused < run.count());
    let no_memory = NoMemory { part: Part::Answers, refusal: Refusal::TooLarge };
    assert_eq!(run.unanswered.get(), Some(&Unanswered::NoMemory(no_memory)));
    assert!(run.part(refused + 1).is_err());
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
            most = most.max(run.job.stop.largest_between_looks());
            answer(&run, chunks).0
        });
        // NaN is not equal to itself, so compare the text.
        assert_eq!(format!("{equal:?}"), format!("{by_pairs:?}"), "{family:?}");
    }
    assert!(most > 0 && most <= 2 * crate::contact::STEPS_BETWEEN_LOOKS, "{most}");
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
    let request = QueryContactsRequest {
        hull_ids: vec![vec![0; 32]],
        body_hulls: vec![0, 0],
        positions: vec![0.0, 0.0, 0.0, 0.3, 0.1, 0.99],
        rotations: [0.0, 0.0, 0.0, 1.0].repeat(2),
        pairs: [0, 1].repeat(pairs),
        ..Default::default()
    };
    let scene = wire::scene(request, &Limits::default()).unwrap();
    let hull = Arc::new(ConvexHull::new(&prism).unwrap());
    let engine = engine(1 << 30);
    let run = run(&engine, Batch::new(scene, Arc::new([Ok(hull)].into_iter().collect())).0);
    assert!(run.chunks.is_unknown() && !run.batch.is_small());
    let run = run.cut(&Stop::default()).unwrap();
    assert!(run.count() > 10, "{}", run.count());
    let (mut points, mut before) = (0, 0);
    for index in 0..run.count() {
        points += run.part(index).unwrap().filled_bytes();
        let steps = run.job.stop.steps() - before;
        assert!(steps <= 2 * crate::contact::STEPS_BETWEEN_LOOKS, "{steps} steps in chunk {index}");
        before += steps;
    }
    assert!(points > 1000 * pairs && run.job.stop.largest_between_looks() <= 1 << 20);
}

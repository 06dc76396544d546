//! The allocator of the binary, and how freed memory goes back to the system.
//!
//! mimalloc does not return freed memory at once. A block that another thread frees stays with the thread that
//! allocated it until that thread collects, and free pages go back to the system when some thread collects a
//! second later. A thread collects after 10,000 allocations that take mimalloc's slow path, or when it ends.
//! A server whose callers have left does neither, so the memory of their last requests would stay resident.
//!
//! Therefore [`return_freed_memory`] looks every second. If the threads of the runtime have worked since they
//! last collected, each of them makes as many allocations as let it collect, which takes about half a
//! millisecond. And a short-lived thread ends every second, which returns free pages.

use std::{
    hint::black_box,
    io,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use tokio::runtime::Handle;

/// Messages and batches are large blocks, and several threads allocate them. With mimalloc this takes some
/// 30 % less CPU than with the system's allocator.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// The time after which mimalloc's marked memory may be returned.
const PERIOD: Duration = Duration::from_secs(1);

/// A thread that allocates this often through the slow path collects at least once. mimalloc counts in
/// thousands, hence the second term.
const ALLOCATIONS: usize = 10_000 + 1_000;

/// A block of this size always takes the slow path; mimalloc's fast path ends at 1 KiB.
const BLOCK_BYTES: usize = 2 << 10;

/// The threads collect again after each of them has worked for this time on average. Collecting itself takes
/// less, so an idle server does not collect for ever.
const WORK: Duration = Duration::from_millis(5);

/// The longest time for which a thread waits for the other threads to collect.
const MEETING: Duration = Duration::from_millis(2);

/// Starts a thread that returns freed memory to the system every second, for as long as the process runs.
/// `runtime` is the runtime whose threads serve the calls.
pub(crate) fn return_freed_memory(runtime: Handle) -> io::Result<()> {
    let end = || drop(black_box(Box::new(0_u8)));
    thread::Builder::new().name("freed-memory".into()).spawn(move || {
        let mut collected_at = Duration::ZERO;
        loop {
            thread::sleep(PERIOD);
            let metrics = runtime.metrics();
            let threads = metrics.num_workers();
            let worked: Duration = (0..threads).map(|i| metrics.worker_total_busy_duration(i)).sum();
            if worked >= collected_at + WORK * threads as u32 {
                collected_at = worked;
                collect_on_all(&runtime, threads);
            }
            // mimalloc collects at the end of each thread that has allocated. If no thread can be started
            // now, the next attempt comes a second later.
            if let Ok(ending) = thread::Builder::new().spawn(end) {
                let _ = ending.join();
            }
        }
    })?;
    Ok(())
}

/// Lets each thread of the runtime collect. A thread that has collected waits a moment for the others, so that
/// an idle runtime runs each task on a thread of its own. A thread that is busy may miss its turn; it allocates
/// by itself, or gets its turn a second later.
fn collect_on_all(runtime: &Handle, threads: usize) {
    let have_collected = Arc::new(AtomicUsize::new(0));
    for _ in 0..threads {
        let have_collected = have_collected.clone();
        runtime.spawn(async move {
            for _ in 0..ALLOCATIONS {
                drop(black_box(Vec::<u8>::with_capacity(BLOCK_BYTES)));
            }
            have_collected.fetch_add(1, Ordering::Relaxed);
            let end = Instant::now() + MEETING;
            while have_collected.load(Ordering::Relaxed) < threads && Instant::now() < end {
                thread::yield_now();
            }
        });
    }
}

//! Runs one attack: measures before it, during it and after it, and asserts the limits that must hold.

use std::{
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use hullcast::contact::STEPS_BETWEEN_LOOKS;

use super::{
    arena::{Arena, Begun, parts},
    bystander::Experience,
    server::{status_bytes, value},
    setup::{Setup, Size},
};

/// Memory in bytes that the server may use in addition to its budget and its cache.
const BESIDE_BUDGETS: u64 = 256 << 20;

/// Memory in bytes that the server may keep after an attack has ended.
const KEPT: u64 = 64 << 20;

/// The time within which all memory that an attack held must be free after its end.
const FREE_WITHIN: Duration = Duration::from_secs(10);

/// If an attack takes longer, the server counts as stopped.
const LONGEST: Duration = Duration::from_secs(300);

/// Held by the test whose attack is running.
static ALONE: Mutex<()> = Mutex::new(());

/// Waits for the right to attack, which only one test has at a time.
pub(crate) fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Starts a server, runs the attack on it, and asserts the limits that must hold. The attack prepares its
/// data, calls [`Arena::begin`], and has released everything when it returns.
pub(crate) fn trial(title: &str, setup: Setup, attack: impl AsyncFnOnce(&Arena)) {
    let _alone = alone();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.expect("a runtime");
    runtime.block_on(run(title, setup, attack));
    runtime.shutdown_background();
}

async fn run(title: &str, setup: Setup, attack: impl AsyncFnOnce(&Arena)) {
    let bound = setup.memory_bytes() + setup.cache_bytes() + BESIDE_BUDGETS;
    let idle = match setup.size {
        Size::Full => Duration::from_secs(2),
        Size::Tenth => Duration::from_millis(100),
    };
    let arena = Arena::new(setup).await;
    let working = arena.bystander.start();
    tokio::time::sleep(idle).await;
    let undisturbed = working.stop().await;
    let pid = arena.server.pid();
    let guard = Guard::default();
    let attacked = Instant::now();
    std::thread::scope(|scope| {
        scope.spawn(|| guard.watch(pid, bound));
        let _done = Done(&guard);
        tokio::task::block_in_place(|| {
            tokio::runtime::Handle::current().block_on(async {
                tokio::select! {
                    () = guard.tripped() => panic!(
                        "{title}: the server uses {} MiB after {:?} of the attack; at most {} MiB are allowed",
                        guard.most.load(Ordering::SeqCst) >> 20, attacked.elapsed(), bound >> 20
                    ),
                    ended = tokio::time::timeout(LONGEST, attack(&arena)) => {
                        ended.unwrap_or_else(|_| panic!("{title}: the attack does not end"));
                    }
                }
            });
        });
    });
    let Begun { working, idle_bytes, idle_parts } = arena.take_begun();
    let left = Instant::now();
    let experience = working.stop().await;
    let freed = freed(title, &arena, left, idle_bytes, &idle_parts).await;
    let peak = status_bytes(pid, "VmHWM");
    assert!(
        peak <= bound,
        "{title}: the server's peak is {} MiB; at most {} MiB are allowed",
        peak >> 20,
        bound >> 20
    );
    assert!(experience.health.count() > 0 && experience.queries.count() > 0);
    let log = arena.server.log();
    assert!(!log.contains("panicked"), "{title}: {log}");
    if let Some(steps) = arena.server.metric("hullcast_largest_steps_between_looks").await {
        let most = STEPS_BETWEEN_LOOKS as f64;
        assert!(
            steps <= most,
            "{title}: {steps} steps between two checks of the stop flag; at most {most} are allowed"
        );
    }
    report(title, &undisturbed, &experience, peak, freed);
}

/// Whether every part of the budget holds at most as much as before the attack.
fn are_free(parts: &[String], idle_parts: &[String]) -> bool {
    let value = |line: &str| line.rsplit_once(' ').and_then(|(_, value)| value.parse::<f64>().ok());
    let named = |line: &String| line.rsplit_once(' ').map(|(name, _)| name.to_owned());
    parts
        .iter()
        .all(|part| idle_parts.iter().any(|idle| named(idle) == named(part) && value(part) <= value(idle)))
}

/// Waits until all memory that the attack held is free, and returns how long that took.
async fn freed(
    title: &str,
    arena: &Arena,
    left: Instant,
    idle_bytes: u64,
    idle_parts: &[String],
) -> Duration {
    loop {
        let metrics = arena.server.metrics().await;
        let cached = value(&metrics, "hullcast_cache_bytes").unwrap_or(0.0) as u64;
        let bytes = status_bytes(arena.server.pid(), "VmRSS");
        let parts = parts(&metrics);
        let elapsed = left.elapsed();
        if are_free(&parts, idle_parts) && bytes <= idle_bytes + cached + KEPT {
            return elapsed;
        }
        assert!(
            elapsed < FREE_WITHIN,
            "{title}: {elapsed:?} after the attack {} MiB are resident ({} MiB before it), {} MiB of hulls \
             are cached, and the budget holds {parts:?}, before it {idle_parts:?}",
            bytes >> 20,
            idle_bytes >> 20,
            cached >> 20
        );
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Prints a row of the table of attacks.
fn report(title: &str, undisturbed: &Experience, attacked: &Experience, peak: u64, freed: Duration) {
    println!(
        "\n| {title} | {} | {} | {} | {} | {} | {} | {:.1} |",
        undisturbed.queries,
        attacked.queries,
        undisturbed.health,
        attacked.health,
        attacked.retries,
        peak >> 20,
        freed.as_secs_f64()
    );
}

/// Kills the server if it exceeds its memory bound, so that it does not exhaust the machine's memory.
#[derive(Default)]
struct Guard {
    most: AtomicU64,
    tripped: AtomicBool,
    done: AtomicBool,
}

impl Guard {
    fn watch(&self, pid: u32, bound: u64) {
        while !self.done.load(Ordering::SeqCst) {
            let bytes = status_bytes(pid, "VmRSS");
            self.most.fetch_max(bytes, Ordering::SeqCst);
            if bytes > bound {
                let _ = std::process::Command::new("kill").args(["-9", &pid.to_string()]).status();
                self.tripped.store(true, Ordering::SeqCst);
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    async fn tripped(&self) {
        while !self.tripped.load(Ordering::SeqCst) {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }
}

/// Ends the watch, even if the attack panics.
struct Done<'a>(&'a Guard);

impl Drop for Done<'_> {
    fn drop(&mut self) {
        self.0.done.store(true, Ordering::SeqCst);
    }
}

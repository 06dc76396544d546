//! `hullcast prune`: removes old hulls from a store.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::Error;
use super::exit::Exit;
use super::progress::Progress;
use super::values::counted;
use hullcast::store::blobs;

/// Hulls listed per page.
const PAGE: usize = 10_000;

/// Removes hulls that were last written longer ago than this.
///
/// Servers on the store need not be stopped. They use a removed hull from their caches for up to
/// `cache_age_seconds`; after that it is unknown until it is registered again. A hull is written
/// when it is first registered, and again when it is registered with a server that has not
/// written it before.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Args {
    /// The store from which hulls are removed: a directory or file://PATH.
    #[arg(long, env = "HULLCAST_STORE", value_name = "URL", help_heading = "What is removed")]
    store: String,
    /// The age from which hulls are removed: a number and its unit (s, m, h or d), as in 30d.
    #[arg(long, value_name = "TIME", value_parser = age, help_heading = "What is removed",
          allow_negative_numbers = true)]
    older_than: Duration,
    /// Only print which hulls would be removed.
    #[arg(long, help_heading = "What is removed")]
    dry_run: bool,
}

fn age(text: &str) -> Result<Duration, String> {
    let wrong = || "expected a whole number of at least 0 and its unit, s, m, h or d, as in 30d".to_owned();
    let unit = text.chars().last().ok_or_else(wrong)?;
    let seconds = match unit {
        's' => 1,
        'm' => 60,
        'h' => 3600,
        'd' => 86_400,
        _ => return Err(wrong()),
    };
    let count: u64 = text[..text.len() - 1].parse().map_err(|_| wrong())?;
    count.checked_mul(seconds).map(Duration::from_secs).ok_or_else(wrong)
}

/// Runs `hullcast prune`.
///
/// # Errors
/// The store cannot be opened, listed or written to. Hulls removed before the error stay removed.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    super::runtime::with_threads()?.block_on(prune(args))
}

async fn prune(args: &Args) -> Result<(), Error> {
    let store = blobs::open_existing(&args.store).map_err(|error| Exit::Usage.error(format!("--{error}")))?;
    let progress = Progress::counting("hulls seen:");
    let now = SystemTime::now().duration_since(UNIX_EPOCH)?;
    let before = i64::try_from(now.saturating_sub(args.older_than).as_millis())?;
    let (mut kept, mut removed, mut bytes, mut after) = (0_u64, 0_u64, 0_u64, None);
    loop {
        let page = blobs::list(&*store, after, PAGE, u64::MAX).await?;
        let Some(last) = page.last() else { break };
        after = Some(last.id);
        for blob in page {
            progress.add(1);
            if blob.created_unix_ms >= before {
                kept += 1;
                continue;
            }
            if !args.dry_run {
                store.delete(blob.id).await?;
            }
            removed += 1;
            bytes += blob.bytes;
        }
    }
    let verb = if args.dry_run { "would remove" } else { "removed" };
    drop(progress);
    println!("{verb} {}, {}; kept {kept}", counted(removed, "hull"), counted(bytes, "byte"));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a wrong unit, which could empty a store of hulls that are minutes old.
    #[test]
    fn ages_have_units() {
        for (text, seconds) in [("90s", 90), ("2m", 120), ("3h", 10_800), ("30d", 2_592_000), ("0d", 0)] {
            assert_eq!(age(text), Ok(Duration::from_secs(seconds)));
        }
        for text in
            ["", "d", "30", "-1d", "1.5h", "30 d", "1w", "99999999999999999999d", "9999999999999999999d"]
        {
            assert!(age(text).is_err(), "{text}");
        }
    }
}

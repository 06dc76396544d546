//! Compares two versions of the server under the same load. Run by `make bench-versions BASELINE=path`.
//! An argument selects the rows whose label contains it.
//!
//! Both servers run all the time. The rounds alternate between them, so that a change of the machine's
//! speed meets both alike, and each figure is the median over the rounds of the ratio within one round.
//! A ratio above 1 means that the version in HULLCAST_BIN costs more, or answers more, than the one in
//! HULLCAST_BASELINE.

use std::error::Error;
use std::time::Duration;

use hullcast_benches::service::load::{latencies, load, measured, median, streamed};
use hullcast_benches::service::process::Server;
use hullcast_benches::service::raw::RawClient;
use hullcast_benches::service::requests::{GeneratedBatch, QUERY};
use hullcast_contact::workload::{Family, Regime};

type Failure = Box<dyn Error>;

/// Number of rounds; each measures both servers once.
const ROUNDS: usize = 15;
/// Number of messages in flight at once.
const UNDER_WAY: usize = 4;
/// Calls per round of one-pair calls.
const CALLS: usize = 1000;

/// CPU time per pair, and pairs per second, of one server in one round.
type Sample = (f64, f64);

#[tokio::main]
async fn main() -> Result<(), Failure> {
    let servers = [server("HULLCAST_BASELINE")?, server("HULLCAST_BIN")?];
    println!("| load | CPU per pair, before | after / before | spread | pairs/s, after / before | spread |");
    println!("|---|--:|--:|---|--:|---|");
    for (family, regime, pairs) in [
        (Family::Box, Regime::Shallow, 4096),
        (Family::Box, Regime::Resting, 4096),
        (Family::Box, Regime::Separated, 4096),
        (Family::Poly16, Regime::Shallow, 4096),
        (Family::Poly16, Regime::Resting, 4096),
        (Family::Box, Regime::Shallow, 200),
        (Family::Box, Regime::Shallow, 32),
    ] {
        let batch = GeneratedBatch::generate(family, regime, pairs, 1)?;
        let message = batch.message(&[]);
        let mut clients = vec![];
        for server in &servers {
            batch.register(&server.address).await?;
            clients.push(RawClient::connect(&server.address, QUERY).await?);
        }
        let label = format!("{} {}, {pairs} pairs per message", family.name(), regime.name());
        compare(&label, async |which| {
            let work = async {
                Ok(pairs as u64 * load(&clients[which], &message, UNDER_WAY, Duration::ZERO).await?)
            };
            let (cpu, rate) = measured(&servers[which], work).await?;
            Ok((cpu.total(), rate))
        })
        .await?;
    }
    single_pairs(&servers).await
}

async fn single_pairs(servers: &[Server; 2]) -> Result<(), Failure> {
    let batch = GeneratedBatch::generate(Family::Box, Regime::Shallow, 1, 1)?;
    let message = batch.message(&[]);
    for server in servers {
        batch.register(&server.address).await?;
    }
    compare("one pair per unary call", async |which| {
        let mut client = RawClient::connect(&servers[which].address, QUERY).await?;
        let work = async {
            latencies(&mut client, &message, CALLS).await?;
            Ok(CALLS as u64)
        };
        let (cpu, rate) = measured(&servers[which], work).await?;
        Ok((cpu.total(), rate))
    })
    .await?;
    for (label, streams, under_way, next) in [
        ("one pair per message, one stream", 1, 1, message.clone()),
        ("one pair per message, 4 streams with 256 in flight", 4, 256, message.clone()),
        ("poses only (`inherit`), 4 streams with 256 in flight", 4, 256, batch.poses()),
    ] {
        compare(label, async |which| {
            let work = streamed(&servers[which].address, streams, under_way, &message, &next);
            let (cpu, rate) = measured(&servers[which], work).await?;
            Ok((cpu.total(), rate))
        })
        .await?;
    }
    Ok(())
}

/// Measures both servers in alternation and prints one row.
async fn compare(
    label: &str,
    measure: impl AsyncFn(usize) -> Result<Sample, Failure>,
) -> Result<(), Failure> {
    if !std::env::args().nth(1).is_none_or(|part| label.contains(&part)) {
        return Ok(());
    }
    let (mut before, mut cpu, mut rate) = (vec![], vec![], vec![]);
    for round in 0..ROUNDS {
        // Each version comes first in every second round.
        let first = round % 2;
        let mut samples = [(0.0, 0.0); 2];
        for which in [first, 1 - first] {
            samples[which] = measure(which).await?;
        }
        let [old, new] = samples;
        before.push(old.0);
        cpu.push(new.0 / old.0);
        rate.push(new.1 / old.1);
    }
    let before = median(before);
    println!("| {label} | {before:.0} ns | {} | {} |", with_spread(cpu), with_spread(rate));
    Ok(())
}

/// The median and the middle half of these ratios.
fn with_spread(mut ratios: Vec<f64>) -> String {
    ratios.sort_by(f64::total_cmp);
    let at = |share: usize| ratios[ratios.len() * share / 4];
    format!("{:.3} | {:.3} to {:.3}", at(2), at(1), at(3))
}

fn server(variable: &str) -> Result<Server, Failure> {
    let path = std::env::var(variable).map_err(|_| format!("{variable} names a server's binary"))?;
    Server::binary(&path, &[])
}

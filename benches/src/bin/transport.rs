//! Measures the cost that the service adds to the geometry. Run by `make bench-service`; arguments name
//! the sections to run.
//!
//! The server is the binary in HULLCAST_BIN, in a process of its own on the same cores. An echo server
//! that moves as many bytes runs for comparison. Prints the tables and puts them into
//! docs/performance.md.

use std::error::Error;
use std::fmt::Write as _;
use std::time::{Duration, Instant};

use bytes::Bytes;
use hullcast_benches::report::{provenance, replace_section};
use hullcast_benches::service::load::{latencies, load, measured, median, streamed};
use hullcast_benches::service::process::Server;
use hullcast_benches::service::raw::{RawClient, serve_echo};
use hullcast_benches::service::requests::{GeneratedBatch, QUERY};
use hullcast_benches::service::shaped;
use hullcast_contact::workload::{Family, Regime};
use hullcast_proto::Output;

type Failure = Box<dyn Error>;

/// Pairs per message; the size that performed best.
const PAIRS: usize = 4096;
/// Number of messages in flight at once.
const UNDER_WAY: usize = 4;
/// Number of measurements per row.
const ROUNDS: usize = 7;

#[tokio::main]
async fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().collect();
    if let [_, mode, bytes] = &arguments[..]
        && mode == "echo"
    {
        return serve_echo(bytes.parse()?).await;
    }
    let asked = &arguments[1..];
    let wanted = |section: &str| asked.is_empty() || asked.iter().any(|name| name == section);
    let stamp = provenance()?;
    for section in ["batches", "small", "sizes", "networks"].into_iter().filter(|name| wanted(name)) {
        let text = match section {
            "batches" => batches().await?,
            "small" => small().await?,
            "sizes" => sizes().await?,
            _ => networks().await?,
        };
        println!("{text}\n");
        replace_section(section, &format!("{text}\n\n{stamp}"))?;
    }
    Ok(())
}

fn echo(bytes: usize) -> Result<Server, Failure> {
    let own = std::env::current_exe()?;
    Server::start(own.to_str().ok_or("a path that is no text")?, &["echo", &bytes.to_string()])
}

/// Large messages: the server's CPU time besides computing, and that of an echo of the same bytes.
async fn batches() -> Result<String, Failure> {
    let mut text = String::from(
        "| 4,096 pairs per message | bytes per pair, request + answer | transport | echo | ratio | computing | library only | pairs/s |\n\
         |---|---|---|---|---|---|---|---|",
    );
    for (family, regime) in [
        (Family::Box, Regime::Shallow),
        (Family::Box, Regime::Resting),
        (Family::Box, Regime::Separated),
        (Family::Poly16, Regime::Shallow),
        (Family::Poly16, Regime::Resting),
    ] {
        let batch = GeneratedBatch::generate(family, regime, PAIRS, 1)?;
        let server = Server::hullcast()?;
        batch.register(&server.address).await?;
        let message = batch.message(&[]);
        let mut client = RawClient::connect(&server.address, QUERY).await?;
        let answer = client.call(message.clone()).await?.len();
        let echo = echo(answer)?;
        let echoing = RawClient::connect(&echo.address, QUERY).await?;
        let pairs = PAIRS as u64;
        let mut columns = [vec![], vec![], vec![], vec![], vec![]];
        for _ in 0..ROUNDS {
            let ours = async { Ok(pairs * load(&client, &message, UNDER_WAY, Duration::ZERO).await?) };
            let (cpu, rate) = measured(&server, ours).await?;
            // The cost of a message depends on the rate, so send as many per second.
            let pause = Duration::from_secs_f64((UNDER_WAY * PAIRS) as f64 / rate);
            let theirs = async { Ok(pairs * load(&echoing, &message, UNDER_WAY, pause).await?) };
            let (other, _) = measured(&echo, theirs).await?;
            for (column, value) in
                columns.iter_mut().zip([cpu.rest, other.rest, cpu.rest / other.rest, cpu.compute, rate])
            {
                column.push(value);
            }
        }
        let [rest, other, ratio, compute, rate] = columns.map(median);
        let per_pair = |bytes: usize| bytes as f64 / PAIRS as f64;
        write!(
            text,
            "\n| {} {} | {:.0} + {:.0} | {rest:.0} ns | {other:.0} ns | {ratio:.2} | {compute:.0} ns | {:.0} ns | {:.2} M |",
            family.name(),
            regime.name(),
            per_pair(message.len()),
            per_pair(answer),
            batch.library()?,
            rate / 1e6,
        )?;
        eprintln!("{}", text.lines().last().unwrap_or_default());
    }
    Ok(text)
}

/// One pair per message: unary calls beside calls that do nothing, and streams.
async fn small() -> Result<String, Failure> {
    let batch = GeneratedBatch::generate(Family::Box, Regime::Shallow, 1, 1)?;
    let server = Server::hullcast()?;
    batch.register(&server.address).await?;
    let message = batch.message(&[]);
    let mut client = RawClient::connect(&server.address, QUERY).await?;
    let nothing = echo(0)?;
    let mut no_op = RawClient::connect(&nothing.address, QUERY).await?;
    let (mut ours, mut theirs, mut ratios) = (vec![], vec![], vec![]);
    for _ in 0..41 {
        let one = median(latencies(&mut client, &message, 400).await?);
        let other = median(latencies(&mut no_op, &Bytes::new(), 400).await?);
        ours.push(one);
        theirs.push(other);
        ratios.push(one / other);
    }
    let mut text = format!(
        "One pair per unary call: median {:.1} us; a call that does nothing {:.1} us, ratio {:.2}.\n\n\
         | one pair per message | messages under way | messages/s | server's CPU per message |\n|---|---|---|---|",
        median(ours),
        median(theirs),
        median(ratios)
    );
    let step = batch.poses();
    for (label, streams, under_way, next) in [
        ("one stream", 1, 1, &message),
        ("one stream", 1, 256, &message),
        ("four streams", 4, 256, &message),
        ("four streams, only poses (`inherit`)", 4, 256, &step),
    ] {
        let mut rows = [vec![], vec![]];
        for _ in 0..ROUNDS {
            let work = streamed(&server.address, streams, under_way, &message, next);
            let (cpu, rate) = measured(&server, work).await?;
            rows[0].push(rate);
            rows[1].push(cpu.rest + cpu.compute);
        }
        let [rate, cpu] = rows.map(median);
        write!(text, "\n| {label} | {} | {rate:.0} | {:.2} us |", streams * under_way, cpu / 1e3)?;
        eprintln!("{}", text.lines().last().unwrap_or_default());
    }
    Ok(text)
}

/// The size of the answers in bytes per pair, by the outputs that are asked for.
async fn sizes() -> Result<String, Failure> {
    let masks: [(&str, &[Output]); 8] = [
        ("OUTCOME", &[Output::Outcome]),
        ("ALPHA", &[Output::Alpha]),
        ("NORMAL", &[Output::Normal]),
        ("POINTS", &[Output::Points]),
        ("default: ALPHA, NORMAL, POINTS", &[]),
        ("default and BASES", &[Output::Alpha, Output::Normal, Output::Points, Output::Bases]),
        ("default and FEATURES", &[Output::Alpha, Output::Normal, Output::Points, Output::Features]),
        (
            "everything",
            &[
                Output::Alpha,
                Output::Normal,
                Output::Points,
                Output::WitnessB,
                Output::Features,
                Output::Bases,
                Output::Diagnostics,
            ],
        ),
    ];
    let cells = [Regime::Separated, Regime::Shallow, Regime::Resting];
    let mut text = String::from(
        "| bytes of the answer per pair, boxes | separated | shallow | resting |\n|---|---|---|---|",
    );
    let server = Server::hullcast()?;
    for (label, mask) in masks {
        write!(text, "\n| {label} |")?;
        for regime in cells {
            let batch = GeneratedBatch::generate(Family::Box, regime, PAIRS, 1)?;
            batch.register(&server.address).await?;
            let mut client = RawClient::connect(&server.address, QUERY).await?;
            let bytes = client.call(batch.message(mask)).await?.len();
            write!(text, " {:.1} |", bytes as f64 / PAIRS as f64)?;
        }
    }
    Ok(text)
}

/// Throughput through a proxy that delays bytes and limits their rate.
async fn networks() -> Result<String, Failure> {
    let batch = GeneratedBatch::generate(Family::Box, Regime::Shallow, PAIRS, 1)?;
    let server = Server::hullcast()?;
    batch.register(&server.address).await?;
    let message = batch.message(&[]);
    let mut text = String::from(
        "| box shallow, 4,096 pairs per message | 1 under way | 4 under way | 16 under way |\n|---|---|---|---|",
    );
    for (label, delay, bytes_per_second) in [
        ("the proxy without limits", Duration::ZERO, 1e12),
        ("1 Gbit/s, 1 ms each way", Duration::from_millis(1), 125e6),
        ("1 Gbit/s, 10 ms each way", Duration::from_millis(10), 125e6),
    ] {
        let address = shaped::proxy(server.address.clone(), delay, bytes_per_second).await?;
        let client = RawClient::connect(&address, QUERY).await?;
        write!(text, "\n| {label} |")?;
        for under_way in [1, 4, 16] {
            let mut rates = vec![];
            for _ in 0..ROUNDS {
                let start = Instant::now();
                let calls = load(&client, &message, under_way, Duration::ZERO).await?;
                rates.push(calls as f64 * PAIRS as f64 / start.elapsed().as_secs_f64());
            }
            write!(text, " {:.2} M pairs/s |", median(rates) / 1e6)?;
        }
        eprintln!("{}", text.lines().last().unwrap_or_default());
    }
    Ok(text)
}

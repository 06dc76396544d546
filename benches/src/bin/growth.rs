//! Measures how cost grows with the number of vertices, pairs, registered hulls and cores. Run by
//! `make bench-growth`.
//!
//! Prints the tables and puts them into docs/performance.md. The figures go into docs/growth.csv, which
//! benches/growth.py plots.

use std::error::Error;
use std::fmt::Write as _;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use hullcast::batch::scene::Bodies;
use hullcast::budget::{self, Part, Permit};
use hullcast::compute::{Compute, Job};
use hullcast::service::{EngineLimits, Limits, ServiceEngine, wire};
use hullcast::store::{self, identity::id_of};
use hullcast_benches::cells::{MARGIN, sphere};
use hullcast_benches::report::{DOCS, provenance, replace_section};
use hullcast_benches::service::process::Server;
use hullcast_benches::service::raw::RawClient;
use hullcast_benches::service::requests::{GeneratedBatch, QUERY};
use hullcast_contact::workload::{Family, Random, Regime};
use hullcast_contact::{Body, ConvexHull, Pose, Query, Workspace, contact_manifold};
use hullcast_proto::hull_service_client::HullServiceClient;
use hullcast_proto::{HullDefinition, QueryContactsRequest, RegisterHullsRequest};
use prost::Message;
use tonic::transport::Endpoint;

type Failure = Box<dyn Error>;

const PAIRS: usize = 4096;
/// Number of messages in flight at once.
const UNDER_WAY: usize = 4;
/// The best of this many rounds counts: in that round the machine was the least disturbed.
const ROUNDS: usize = 7;

#[tokio::main]
async fn main() -> Result<(), Failure> {
    let stamp = provenance()?;
    let (vertices, mut csv) = vertices()?;
    let (batches, part) = batches().await?;
    csv += &part;
    let (hulls, part) = hulls().await?;
    csv += &part;
    let registering = registering().await?;
    let cores = cores().await?;
    let text = [vertices, batches, hulls, registering, cores, stamp].join("\n\n");
    println!("{text}");
    replace_section("growth", &text)?;
    std::fs::write(format!("{DOCS}/growth.csv"), format!("what,size,value\n{csv}"))?;
    Ok(())
}

/// The exponent of growth: the slope of a line through the logarithms of the points from `from` on.
fn exponent(points: &[(f64, f64)], from: f64) -> f64 {
    let logs: Vec<_> = points.iter().filter(|p| p.0 >= from).map(|p| (p.0.ln(), p.1.ln())).collect();
    let count = logs.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| logs.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let covariance: f64 = logs.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    covariance / logs.iter().map(|p| (p.0 - x) * (p.0 - x)).sum::<f64>()
}

fn least(mut work: impl FnMut() -> f64) -> f64 {
    (0..ROUNDS).map(|_| work()).fold(f64::INFINITY, f64::min)
}

/// Two hulls of points on a sphere that overlap by a few percent, in random poses.
fn vertices() -> Result<(String, String), Failure> {
    let mut text = String::from(
        "| vertices | manifold, cold | manifold, warm | building | heap | bytes per vertex |\n|---|---|---|---|---|---|",
    );
    let mut csv = String::new();
    let mut lines = [vec![], vec![], vec![]];
    for count in [4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 10_000] {
        let cloud = sphere(count, count as u64);
        let hull = ConvexHull::new(&cloud)?;
        let repeats = (20_000 / count).max(1);
        let building = least(|| {
            let start = Instant::now();
            for _ in 0..repeats {
                black_box(ConvexHull::new(&cloud).is_ok());
            }
            start.elapsed().as_nanos() as f64 / repeats as f64
        });
        let mut random = Random::new(1);
        let query = Query { margin: MARGIN, ..Query::default() };
        let mut workspace = Workspace::default();
        let mut pairs = Vec::new();
        while pairs.len() < 500 {
            let [turn_a, turn_b] = [random.rotation(), random.rotation()].map(|q| q.to_array());
            let way = random.direction();
            // The growth scale is linear in the offset, so the first answer determines where to put B.
            let at = |offset: f64| Pose::new((way * offset).to_array(), turn_b);
            let a = Body::new(&hull, Pose::new([0.0; 3], turn_a)?);
            let far = Query { margin: f64::INFINITY, ..query };
            let far = contact_manifold(&a, &Body::new(&hull, at(1.0)?), &far, None, &mut workspace).alpha;
            pairs.push((a, Body::new(&hull, at(0.97 / far)?)));
        }
        let mut bases = vec![None; pairs.len()];
        let mut pass = |warm: bool| {
            let start = Instant::now();
            for ((a, b), basis) in pairs.iter().zip(&mut bases) {
                let from = basis.as_ref().filter(|_| warm);
                let manifold = contact_manifold(a, b, &query, from, &mut workspace);
                let found = manifold.basis;
                *basis = found;
            }
            start.elapsed().as_nanos() as f64 / pairs.len() as f64
        };
        let (cold, warm) = (least(|| pass(false)), least(|| pass(true)));
        let heap = hull.heap_bytes();
        write!(
            text,
            "\n| {count} | {cold:.0} ns | {warm:.0} ns | {:.1} us | {:.1} KB | {:.0} |",
            building / 1e3,
            heap as f64 / 1e3,
            heap as f64 / count as f64
        )?;
        eprintln!("{}", text.lines().last().unwrap_or_default());
        for (line, (name, value)) in lines.iter_mut().zip([
            ("manifold, cold", cold),
            ("manifold, warm", warm),
            ("building a hull", building),
        ]) {
            line.push((count as f64, value));
            writeln!(csv, "\"{name}\",{count},{value:.1}")?;
        }
    }
    let [cold, warm, building] = lines.map(|line| exponent(&line, 256.0));
    write!(
        text,
        "\n\nExponents from 256 vertices on: cold {cold:.2}, warm {warm:.2}, building {building:.2}. \
         A warm query has the poses of its basis."
    )?;
    Ok((text, csv))
}

/// One query, by its number of pairs, split into messages as the client splits it.
async fn batches() -> Result<(String, String), Failure> {
    let mut text = String::from("| pairs in a query | time | ns per pair |\n|---|---|---|");
    let (mut csv, mut line) = (String::new(), vec![]);
    let server = Server::hullcast()?;
    let mut count = 1;
    while count <= 1 << 20 {
        let batch = GeneratedBatch::generate(Family::Poly16, Regime::Shallow, count.min(PAIRS), 1)?;
        batch.register(&server.address).await?;
        let message = batch.message(&[]);
        let client = RawClient::connect(&server.address, QUERY).await?;
        let messages = count.div_ceil(PAIRS);
        let mut best = f64::INFINITY;
        for _ in 0..ROUNDS {
            let start = Instant::now();
            closed_loops(&client, vec![message.clone(); messages]).await?;
            best = best.min(start.elapsed().as_nanos() as f64);
        }
        write!(text, "\n| {count} | {:.3} ms | {:.0} |", best / 1e6, best / count as f64)?;
        eprintln!("{}", text.lines().last().unwrap_or_default());
        writeln!(csv, "\"a query through the server\",{count},{best:.0}")?;
        line.push((count as f64, best));
        count *= 4;
    }
    write!(
        text,
        "\n\nExponent from 4,096 pairs on: {:.2}. poly16 shallow, {UNDER_WAY} messages of at most {PAIRS} pairs under way.",
        exponent(&line, PAIRS as f64)
    )?;
    Ok((text, csv))
}

/// Sends the messages, with `UNDER_WAY` of them in flight.
async fn closed_loops(client: &RawClient, messages: Vec<Bytes>) -> Result<(), Failure> {
    let messages = Arc::new(std::sync::Mutex::new(messages));
    let loops = (0..UNDER_WAY).map(|_| {
        let (mut client, messages) = (client.clone(), messages.clone());
        tokio::spawn(async move {
            loop {
                let next = messages.lock().ok().and_then(|mut messages| messages.pop());
                match next {
                    Some(message) => client.call(message).await?,
                    None => return Ok::<(), tonic::Status>(()),
                };
            }
        })
    });
    for each in loops.collect::<Vec<_>>() {
        each.await??;
    }
    Ok(())
}

/// Pairs of hulls drawn at random from the registered hulls, by the number of these.
async fn hulls() -> Result<(String, String), Failure> {
    let mut text = String::from(
        "| registered hulls | time to register one | ns per pair, one message at a time |\n|---|---|---|",
    );
    let (mut csv, mut line) = (String::new(), vec![]);
    let server = Server::hullcast()?;
    let channel = Endpoint::from_shared(format!("http://{}", server.address))?.connect().await?;
    let mut ids: Vec<Vec<u8>> = Vec::new();
    for count in [1, 10, 100, 1000, 10_000, 100_000] {
        let start = Instant::now();
        let new = count - ids.len();
        while ids.len() < count {
            let clouds: Vec<_> =
                (ids.len()..count.min(ids.len() + 1000)).map(|seed| sphere(16, seed as u64)).collect();
            let request = registration(&clouds);
            HullServiceClient::new(channel.clone()).register_hulls(request).await?;
            ids.extend(clouds.into_iter().map(|points| {
                let definition = store::HullDefinition { points, ..store::HullDefinition::default() };
                id_of(&definition.identity_bytes()).0.to_vec()
            }));
        }
        let registering = start.elapsed().as_nanos() as f64 / new as f64;
        let mut random = Random::new(1);
        let mut requests = Vec::new();
        for _ in 0..4 {
            requests.push(drawn(&ids, &mut random));
        }
        let mut client = RawClient::connect(&server.address, QUERY).await?;
        let mut best = f64::INFINITY;
        for _ in 0..ROUNDS {
            for message in &requests {
                let start = Instant::now();
                client.call(message.clone()).await?;
                best = best.min(start.elapsed().as_nanos() as f64 / PAIRS as f64);
            }
        }
        write!(text, "\n| {count} | {:.1} us | {best:.0} |", registering / 1e3)?;
        eprintln!("{}", text.lines().last().unwrap_or_default());
        writeln!(csv, "\"a pair, hulls drawn from those registered\",{count},{best:.1}")?;
        line.push((count as f64, best));
    }
    write!(
        text,
        "\n\nExponent: {:.2}. 16-vertex hulls in memory; each message has 4,096 pairs of hulls drawn at random.",
        exponent(&line, 1.0)
    )?;
    Ok((text, csv))
}

fn registration(clouds: &[Vec<[f64; 3]>]) -> RegisterHullsRequest {
    let hull = |points: &Vec<[f64; 3]>| HullDefinition {
        vertices: points.as_flattened().to_vec(),
        ..Default::default()
    };
    RegisterHullsRequest { hulls: clouds.iter().map(hull).collect() }
}

/// Registering many hulls in one call, with servers of one compute thread and of two.
async fn registering() -> Result<String, Failure> {
    let mut text =
        String::from("| hulls registered in one call | 1 thread | 2 threads | ratio |\n|---|---|---|---|");
    for (count, vertices) in [(4096, 16), (1024, 256), (64, 4096)] {
        let mut best = [f64::INFINITY; 2];
        for round in 0..ROUNDS {
            let seeds = count * round..count * (round + 1);
            let request = registration(&seeds.map(|seed| sphere(vertices, seed as u64)).collect::<Vec<_>>());
            for (threads, best) in ["1", "2"].into_iter().zip(&mut best) {
                // A new server, so that every hull is new to it.
                let server = Server::hullcast_with(&["--compute-threads", threads])?;
                let channel = Endpoint::from_shared(format!("http://{}", server.address))?.connect().await?;
                let mut hulls = HullServiceClient::new(channel);
                let start = Instant::now();
                hulls.register_hulls(request.clone()).await?;
                *best = best.min(start.elapsed().as_secs_f64() / count as f64);
            }
        }
        let [one, two] = best.map(|seconds| seconds * 1e6);
        write!(
            text,
            "\n| {count} of {vertices} points | {one:.1} us per hull | {two:.1} us | {:.2} |",
            one / two
        )?;
        eprintln!("{}", text.lines().last().unwrap_or_default());
    }
    Ok(text)
}

/// A request of pairs that overlap, of hulls of radius 1 drawn from `ids`.
fn drawn(ids: &[Vec<u8>], random: &mut Random) -> Bytes {
    let mut request = QueryContactsRequest { margin: MARGIN, ..Default::default() };
    let mut place = std::collections::HashMap::new();
    for pair in 0..PAIRS as u32 {
        let way = random.direction() * 1.5;
        for side in 0..2 {
            let hull = random.below(ids.len());
            let next = place.len() as u32;
            request.body_hulls.push(*place.entry(hull).or_insert(next));
            if place.len() > request.hull_ids.len() {
                request.hull_ids.push(ids[hull].clone());
            }
            request.positions.extend((way * f64::from(side)).to_array());
            request.rotations.extend(random.rotation().to_array());
        }
        request.pairs.extend([2 * pair, 2 * pair + 1]);
    }
    request.encode_to_vec().into()
}

/// The batch engine by itself, on one thread and on two.
async fn cores() -> Result<String, Failure> {
    let mut text = String::from(
        "| batch engine, 4,096 pairs per batch | 1 thread | 2 threads | ratio |\n|---|---|---|---|",
    );
    for (family, regime, under_way) in [
        (Family::Box, Regime::Resting, 1),
        (Family::Box, Regime::Resting, UNDER_WAY),
        (Family::Poly16, Regime::Shallow, 1),
        (Family::Poly16, Regime::Shallow, UNDER_WAY),
        (Family::Poly256, Regime::Shallow, UNDER_WAY),
    ] {
        let pairs = GeneratedBatch::generate(family, regime, PAIRS, 1)?;
        let hulls: Vec<_> = pairs
            .used()
            .iter()
            .map(|points| ConvexHull::new(points).map(Arc::new))
            .collect::<Result<_, _>>()?;
        let request = pairs.request(&[]);
        let mut rates = [0.0_f64; 2];
        for _ in 0..3 * ROUNDS {
            for (threads, rate) in (1..).zip(&mut rates) {
                let limits = Limits::default();
                let engine = Arc::new(ServiceEngine::new(
                    Compute::new(threads)?,
                    EngineLimits {
                        max_pairs_in_flight: limits.max_pairs_in_flight,
                        shares: false,
                        max_answer_bytes: limits.max_message_bytes,
                    },
                    Arc::default(),
                ));
                let mut answered = 0;
                let start = Instant::now();
                while answered < 16 {
                    let mut tasks = Vec::new();
                    for _ in 0..under_way {
                        let scene = wire::scene(request.clone(), &limits)?;
                        let job = Job::new(budget::Caller::alone());
                        let admission = engine.admit(PAIRS, scene.template.outputs(), &job.caller)?;
                        let found = Arc::new(hulls.iter().cloned().map(Ok).collect());
                        let bodies = Bodies::new(scene.template, found, Arc::new(scene.poses))?;
                        let batch = hullcast::batch::Batch::new(bodies, scene.warm_starts)?;
                        let engine = engine.clone();
                        let memory = Permit::unbounded(Part::Answers);
                        tasks.push(tokio::spawn(async move {
                            engine.compute(batch, None, admission, &job, memory).await
                        }));
                        answered += 1;
                    }
                    for task in tasks {
                        black_box(task.await??.0.len());
                    }
                }
                *rate = rate.max(answered as f64 * PAIRS as f64 / start.elapsed().as_secs_f64());
            }
        }
        let [one, two] = rates.map(|rate| rate / 1e6);
        write!(
            text,
            "\n| {} {}, {under_way} under way | {one:.2} M pairs/s | {two:.2} M pairs/s | {:.2} |",
            family.name(),
            regime.name(),
            two / one
        )?;
        eprintln!("{}", text.lines().last().unwrap_or_default());
    }
    Ok(text)
}

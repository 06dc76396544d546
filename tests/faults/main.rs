//! Injects faults into the real server and its store: `make test-faults`.
//!
//! The tests are ignored otherwise, because they take minutes and some need root (they mount a
//! tmpfs). Each prints its actions and its losses; these lines are the rows of
//! docs/reliability.md.

#[path = "../service/support/process.rs"]
#[allow(dead_code, reason = "shared with the tests of the service")]
mod process;
#[path = "../service/support/scenes.rs"]
#[allow(dead_code, reason = "shared with the tests of the service")]
mod scenes;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    process::Command,
    time::{Duration, Instant},
};

use hullcast::{
    proto::{
        DeleteHullsRequest, HasHullsRequest, QueryContactsRequest, hull_service_client::HullServiceClient,
        register_hull_result::Result as Registered,
    },
    store::HullDefinition,
};
use process::{BINARY, Process, tracer};
use scenes::{Random, assert_same, expected, id, plain, register_request, round_points, scene};
use tonic::{Code, transport::Channel};

const UNKNOWN_HULL: u8 = 16;
const HULL_UNAVAILABLE: u8 = 32;

fn shape(seed: u64) -> HullDefinition {
    plain(round_points(20, seed))
}

fn hex(shape: &HullDefinition) -> String {
    id(shape).iter().map(|byte| format!("{byte:02x}")).collect()
}

fn blob(store: &Path, shape: &HullDefinition) -> PathBuf {
    let name = hex(shape);
    store.join(&name[..2]).join(name)
}

/// Registers one hull; an error if it was not acknowledged.
async fn register(
    hulls: &mut HullServiceClient<Channel>,
    shape: &HullDefinition,
) -> Result<(), tonic::Status> {
    let request = register_request(std::slice::from_ref(shape));
    let results = hulls.register_hulls(request).await?.into_inner().results;
    assert!(matches!(results[0].result, Some(Registered::Hull(_))), "{results:?}");
    Ok(())
}

async fn present(hulls: &mut HullServiceClient<Channel>, shapes: &[HullDefinition]) -> Vec<bool> {
    let mut present = Vec::new();
    for part in shapes.chunks(1000) {
        let ids = part.iter().map(id).collect();
        present.extend(hulls.has_hulls(HasHullsRequest { ids }).await.unwrap().into_inner().present);
    }
    present
}

/// The server's answers about all these hulls must equal the library's bit by bit.
async fn expect_answers(server: &Process, shapes: &[HullDefinition]) {
    for part in shapes.chunks(50) {
        let request = scene(part, part.len(), 2 * part.len(), 1);
        let answer = server.contacts().await.query_contacts(request.clone()).await.unwrap().into_inner();
        assert_same(&answer, &expected(&request, part));
    }
}

/// The flags of the pair of a hull with itself.
async fn flags(server: &Process, shape: &HullDefinition) -> u8 {
    let request: QueryContactsRequest = scene(std::slice::from_ref(shape), 2, 1, 1);
    server.contacts().await.query_contacts(request).await.unwrap().into_inner().flags[0]
}

/// Kills the server a thousand times (HULLCAST_ROUNDS) while it registers hulls as fast as it can.
/// Catches an acknowledgement that is sent before the data is safe.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "minutes"]
async fn killed_in_the_middle_nothing_acknowledged_is_lost() {
    let rounds: u64 = std::env::var("HULLCAST_ROUNDS").map_or(1000, |rounds| rounds.parse().unwrap());
    let directory = tempfile::tempdir().unwrap();
    let (mut acknowledged, mut unanswered, mut seed) = (Vec::new(), 0, 0);
    let mut random = Random::new(7);
    for round in 0..rounds {
        let mut server = Process::plain(directory.path());
        let mut hulls = server.hulls().await;
        let writer = tokio::spawn(async move {
            let mut done = Vec::new();
            loop {
                seed += 1;
                let shape = shape(seed);
                if register(&mut hulls, &shape).await.is_err() {
                    return (done, seed);
                }
                done.push(shape);
            }
        });
        // The kill comes at a random moment of the first registrations, sometimes before the first
        // one.
        tokio::time::sleep(Duration::from_micros(random.below(20_000) as u64)).await;
        server.signal("-9");
        assert!(!server.wait().success());
        let (done, last) = writer.await.unwrap();
        unanswered += last - seed - done.len() as u64;
        seed = last;
        acknowledged.extend(done);
        if round % 100 == 99 || round + 1 == rounds {
            let server = Process::plain(directory.path());
            let lost =
                present(&mut server.hulls().await, &acknowledged).await.iter().filter(|p| !**p).count();
            assert_eq!(lost, 0, "of {} acknowledged after {round} kills", acknowledged.len());
        }
    }
    let server = Process::plain(directory.path());
    expect_answers(&server, &acknowledged[..acknowledged.len().min(2000)]).await;
    println!(
        "FAULT kill -9 at a random moment: {rounds} kills, {} acknowledged, {unanswered} killed under way, 0 lost",
        acknowledged.len()
    );
}

/// Kills the server before each sync, rename and send of a registration in turn. Catches an order
/// of calls with one unsafe moment.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "a minute"]
async fn killed_at_every_call_nothing_acknowledged_is_lost() {
    let scratch = tempfile::tempdir().unwrap();
    let tracer = tracer(scratch.path());
    let (mut kills, mut acknowledged, mut there) = (0, 0, 0);
    for call in 1..200 {
        let store = scratch.path().join(format!("store-{call}"));
        let mut command = Command::new(BINARY);
        command.env("LD_PRELOAD", &tracer).env("CALL_KILL", call.to_string());
        let Some(mut server) = Process::try_start(command, &store, &[]) else {
            kills += 1; // before it listened
            continue;
        };
        let shapes = [shape(1), shape(2)];
        let mut done = 0;
        if let Ok(channel) =
            Channel::from_shared(format!("http://{}", server.address)).unwrap().connect().await
        {
            let mut hulls = HullServiceClient::new(channel);
            for shape in &shapes {
                match register(&mut hulls, shape).await {
                    Ok(()) => done += 1,
                    Err(_) => break,
                }
            }
        }
        if done == shapes.len() {
            server.signal("-9");
            server.wait();
            break;
        }
        kills += 1;
        server.wait();
        let next = Process::plain(&store);
        let mut hulls = next.hulls().await;
        let found = present(&mut hulls, &shapes).await;
        assert!(found[..done].iter().all(|found| *found), "call {call}: {done} acknowledged, {found:?}");
        acknowledged += done;
        there += found.iter().filter(|found| **found).count();
        // A hull that was not acknowledged is stored whole or not at all, and can be registered
        // again.
        for shape in &shapes {
            register(&mut hulls, shape).await.unwrap();
        }
        expect_answers(&next, &shapes).await;
    }
    assert!((10..199).contains(&kills), "{kills}");
    println!(
        "FAULT kill -9 before each sync, rename and send: {kills} kills, {acknowledged} acknowledged, {there} there, 0 lost"
    );
}

/// Damages blobs in five ways. Catches a damaged blob that is served as its hull, one that is not
/// kept in quarantine, and one that a new registration does not repair.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "with the other faults"]
async fn torn_blobs_are_set_aside_and_registered_again() {
    let store = tempfile::tempdir().unwrap();
    let first = Process::plain(store.path());
    let shapes: Vec<_> = (1..=64).map(shape).collect();
    first.hulls().await.register_hulls(register_request(&shapes)).await.unwrap();
    drop(first);
    let mut kinds = BTreeMap::new();
    let mut random = Random::new(3);
    for (i, shape) in shapes.iter().enumerate() {
        let path = blob(store.path(), shape);
        let mut bytes = std::fs::read(&path).unwrap();
        let at = random.below(bytes.len());
        let kind = match i % 5 {
            0 => (bytes.truncate(at), "torn").1,
            1 => (bytes[at] ^= 1, "a bit flipped").1,
            2 => (bytes.clear(), "empty").1,
            3 => (bytes.extend_from_slice(&[0; 512]), "too long").1,
            _ => (bytes[at..].fill(0), "zeroed from somewhere").1,
        };
        if kind == "zeroed from somewhere" && bytes == std::fs::read(&path).unwrap() {
            bytes[0] ^= 0xff;
        }
        *kinds.entry(kind).or_insert(0) += 1;
        std::fs::write(&path, bytes).unwrap();
    }
    let server = Process::plain(store.path());
    for shape in &shapes {
        assert_eq!(flags(&server, shape).await, UNKNOWN_HULL);
    }
    let set_aside = || std::fs::read_dir(store.path().join("quarantine")).unwrap().count();
    assert_eq!(set_aside(), shapes.len());
    assert_eq!(present(&mut server.hulls().await, &shapes).await, vec![false; shapes.len()]);
    assert_eq!(set_aside(), shapes.len(), "a blob was copied to quarantine twice");
    server.hulls().await.register_hulls(register_request(&shapes)).await.unwrap();
    expect_answers(&server, &shapes).await;
    drop(server);
    expect_answers(&Process::plain(store.path()), &shapes).await;
    println!(
        "FAULT blobs spoilt on disk {kinds:?}: {} set aside, 0 served, all registered again",
        shapes.len()
    );
}

/// A tmpfs mount, unmounted when dropped. Mounting needs root.
struct Tmpfs(PathBuf);

impl Tmpfs {
    fn mount(path: &Path, size: &str) -> Self {
        std::fs::create_dir_all(path).unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"])
            .arg(path)
            .status()
            .unwrap();
        assert!(mounted.success(), "this test needs root, to mount a tmpfs");
        Self(path.to_owned())
    }

    fn remount(&self, option: &str) {
        let options = format!("remount,{option}");
        assert!(Command::new("mount").args(["-o", &options]).arg(&self.0).status().unwrap().success());
    }
}

impl Drop for Tmpfs {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

/// Fills a disk of 512 KiB with hulls. Catches a full disk that loses acknowledged hulls, is
/// reported as another error, or still refuses hulls after some were deleted.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs root"]
async fn a_full_disk_is_said_and_loses_nothing() {
    let scratch = tempfile::tempdir().unwrap();
    let disk = Tmpfs::mount(&scratch.path().join("disk"), "512k");
    let store = disk.0.join("store");
    let server = Process::plain(&store);
    let mut hulls = server.hulls().await;
    let mut acknowledged = Vec::new();
    let mut refused = 0;
    for seed in 1.. {
        match register(&mut hulls, &shape(seed)).await {
            Ok(()) => acknowledged.push(shape(seed)),
            Err(status) => {
                assert_eq!(status.code(), Code::ResourceExhausted, "{status:?}");
                assert!(status.message().contains("STORE_FULL"), "{status:?}");
                refused += 1;
                if refused == 20 {
                    break;
                }
            }
        }
    }
    assert!(acknowledged.len() > 50, "{}", acknowledged.len());
    expect_answers(&server, &acknowledged).await;
    drop(server);
    let server = Process::plain(&store);
    expect_answers(&server, &acknowledged).await;
    let mut hulls = server.hulls().await;
    let ids = acknowledged[..20].iter().map(id).collect();
    hulls.delete_hulls(DeleteHullsRequest { ids }).await.unwrap();
    register(&mut hulls, &shape(1_000_000)).await.unwrap();
    println!(
        "FAULT disk full (tmpfs): {} acknowledged, {refused} refused STORE_FULL, 0 lost",
        acknowledged.len()
    );
}

/// Makes the store's directory read-only, then moves it away, and undoes both. Catches a server
/// that stops serving the hulls it has in its cache, or that does not report the fault in its
/// readiness.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs root"]
async fn a_read_only_or_vanished_directory_degrades() {
    let scratch = tempfile::tempdir().unwrap();
    let disk = Tmpfs::mount(&scratch.path().join("disk"), "16m");
    let store = disk.0.join("store");
    let (cached, other, new) = (shape(1), shape(2), shape(3));
    let arguments = ["--probe-seconds", "0.05", "--admin-listen", "127.0.0.1:0"];
    let first = Process::plain(&store);
    register(&mut first.hulls().await, &cached).await.unwrap();
    register(&mut first.hulls().await, &other).await.unwrap();
    drop(first);
    let server = Process::start(Command::new(BINARY), &store, &arguments);
    let mut hulls = server.hulls().await;
    assert_eq!(flags(&server, &cached).await & (UNKNOWN_HULL | HULL_UNAVAILABLE), 0);

    disk.remount("ro");
    let status = register(&mut hulls, &new).await.unwrap_err();
    assert_eq!(status.code(), Code::Unavailable, "{status:?}");
    assert_eq!(flags(&server, &cached).await & (UNKNOWN_HULL | HULL_UNAVAILABLE), 0);
    server.until_ready_says("degraded").await;
    disk.remount("rw");
    server.until_ready_says("ready").await;
    register(&mut hulls, &new).await.unwrap();

    let away = disk.0.join("away");
    std::fs::rename(&store, &away).unwrap();
    assert_eq!(flags(&server, &cached).await & (UNKNOWN_HULL | HULL_UNAVAILABLE), 0);
    assert_eq!(flags(&server, &other).await & (UNKNOWN_HULL | HULL_UNAVAILABLE), HULL_UNAVAILABLE);
    let status = register(&mut hulls, &shape(4)).await.unwrap_err();
    assert_eq!(status.code(), Code::Unavailable, "{status:?}");
    server.until_ready_says("degraded").await;
    std::fs::rename(&away, &store).unwrap();
    server.until_ready_says("ready").await;
    register(&mut hulls, &shape(4)).await.unwrap();
    expect_answers(&server, &[cached, other, new, shape(4)]).await;
    println!(
        "FAULT directory read-only, then gone: cached served, others HULL_UNAVAILABLE, 0 lost, recovered"
    );
}

/// Two servers register 600 hulls in one directory, a third of them both. Catches servers that lose
/// or damage each other's hulls.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "with the other faults"]
async fn two_servers_share_a_directory() {
    let store = tempfile::tempdir().unwrap();
    let servers = [Process::plain(store.path()), Process::plain(store.path())];
    let mut writers = Vec::new();
    for (place, server) in servers.iter().enumerate() {
        let mut hulls = server.hulls().await;
        writers.push(tokio::spawn(async move {
            // A third of the hulls are registered by both servers.
            for seed in (1..=600).filter(|seed| seed % 3 == 2 || *seed as usize % 3 == place) {
                register(&mut hulls, &shape(seed)).await.unwrap();
            }
        }));
    }
    for writer in writers {
        writer.await.unwrap();
    }
    let shapes: Vec<_> = (1..=600).map(shape).collect();
    for server in &servers {
        assert!(present(&mut server.hulls().await, &shapes).await.iter().all(|found| *found));
        expect_answers(server, &shapes).await;
    }
    println!("FAULT two servers on one directory: 600 hulls, 200 of both, 0 lost");
}

/// Registers and deletes the same hulls at the same time, on two servers. Catches a delete that
/// leaves half a hull, a registration after the delete that is acknowledged but not stored, and a
/// hull that can no longer be registered.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "with the other faults"]
async fn delete_racing_register() {
    const ROUNDS: u64 = 500;
    let store = tempfile::tempdir().unwrap();
    let servers = [Process::plain(store.path()), Process::plain(store.path())];
    let [mut one, mut two] = [servers[0].hulls().await, servers[1].hulls().await];
    let (mut there, started) = (0, Instant::now());
    for round in 0..ROUNDS {
        let shape = shape(1 + round % 7);
        let (registered, deleted) = tokio::join!(
            register(&mut one, &shape),
            two.delete_hulls(DeleteHullsRequest { ids: vec![id(&shape)] })
        );
        // Deleting a hull leaves its shard's directory, so neither call may fail.
        registered.unwrap();
        deleted.unwrap();
        there += u64::from(present(&mut two, std::slice::from_ref(&shape)).await[0]);
        register(&mut two, &shape).await.unwrap();
        assert!(present(&mut two, std::slice::from_ref(&shape)).await[0], "round {round}");
        assert_eq!(flags(&servers[1], &shape).await & (UNKNOWN_HULL | HULL_UNAVAILABLE), 0);
    }
    println!(
        "FAULT delete racing register on two servers: {ROUNDS} races in {:.1} s, register won {there}, 0 lost or torn",
        started.elapsed().as_secs_f64()
    );
}

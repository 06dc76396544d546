//! Tests of the real binary that kill, trace or stop it.

use std::{
    io::Read,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, SystemTime},
};

use crate::support::{
    channel,
    process::{BINARY, Process, tracer},
    scenes::{assert_same, expected, id, plain, register_request, round_points, scene},
};
use hullcast::proto::{
    HasHullsRequest, contact_service_client::ContactServiceClient, hull_service_client::HullServiceClient,
};

/// Kills a server in the middle of registrations, four times. The last server must answer for every
/// hull that any of them acknowledged. Catches a hull that is acknowledged before it is stored.
#[tokio::test(flavor = "multi_thread")]
async fn a_killed_server_answers_for_every_acknowledged_hull() {
    let directory = tempfile::tempdir().unwrap();
    let mut acknowledged = Vec::new();
    let mut seed = 0;
    for round in 0..4 {
        let mut server = Process::plain(directory.path());
        let mut hulls = server.hulls().await;
        let (send, mut acknowledgements) = tokio::sync::mpsc::unbounded_channel();
        let writer = tokio::spawn(async move {
            loop {
                seed += 1;
                let shape = plain(round_points(20, seed));
                let request = register_request(std::slice::from_ref(&shape));
                if hulls.register_hulls(request).await.is_err() {
                    return seed;
                }
                let _ = send.send(shape);
            }
        });
        for _ in 0..10 + round {
            acknowledged.push(acknowledgements.recv().await.unwrap());
        }
        server.signal("-9");
        assert!(!server.wait().success());
        seed = writer.await.unwrap();
        while let Some(shape) = acknowledgements.recv().await {
            acknowledged.push(shape);
        }
    }
    assert!(acknowledged.len() >= 46);

    let server = Process::plain(directory.path());
    let ids: Vec<_> = acknowledged.iter().map(id).collect();
    let present = server.hulls().await.has_hulls(HasHullsRequest { ids }).await.unwrap().into_inner();
    assert_eq!(present.present, vec![true; acknowledged.len()]);
    let request = scene(&acknowledged, 100, 300, 1);
    let mut contacts = ContactServiceClient::new(channel(&server.address).await);
    let answer = contacts.query_contacts(request.clone()).await.unwrap().into_inner();
    assert_same(&answer, &expected(&request, &acknowledged));
}

/// Traces every sync, rename and send of the server in order. Catches an acknowledgement that is
/// sent before the file or a directory is synced.
#[tokio::test(flavor = "multi_thread")]
async fn file_and_directories_are_synced_before_the_acknowledgement() {
    let directory = tempfile::tempdir().unwrap();
    let store = directory.path().join("store");
    let trace = directory.path().join("trace");
    let mut command = Command::new(BINARY);
    command.env("LD_PRELOAD", tracer(directory.path())).env("CALL_TRACE", &trace);
    let mut server = Process::start(command, &store, &["--until-stdin-closes"]);
    let shape = plain(round_points(20, 1));
    let name: String = id(&shape).iter().map(|byte| format!("{byte:02x}")).collect();
    server.hulls().await.register_hulls(register_request(&[shape])).await.unwrap();
    drop(server.stdin.take());
    server.wait();

    let root = store.canonicalize().unwrap();
    let shard = root.join(&name[..2]);
    let events = events(&std::fs::read_to_string(&trace).unwrap());
    let synced = |path: &Path| {
        events.iter().rposition(|event| matches!(event, Event::Synced(synced) if synced == path))
    };
    let file = events
        .iter()
        .position(|event| matches!(event, Event::Synced(path) if path.starts_with(&shard) && *path != shard))
        .expect("the file is synced");
    let published = events
        .iter()
        .position(|event| matches!(event, Event::Renamed(line) if line.contains(&name)))
        .expect("the file is renamed into place");
    let shard = synced(&shard).expect("its directory is synced");
    let root = synced(&root).expect("the directory's directory is synced");
    let answered = events.iter().rposition(|event| *event == Event::Sent).expect("an answer");
    assert!(file < published, "the file is whole before it has its name");
    assert!(published < shard, "its name is synced after it has it");
    let acknowledged = events[shard.max(root)..].iter().position(|event| *event == Event::Sent);
    assert!(acknowledged.is_some() && answered > shard.max(root), "and then it is acknowledged");
    let premature = events[file..shard.max(root)].iter().filter(|event| **event == Event::Sent).count();
    assert_eq!(premature, 0, "nothing is sent while it is being stored");
}

#[derive(Debug, PartialEq)]
enum Event {
    Synced(PathBuf),
    Renamed(String),
    Sent,
}

/// The events in a trace, one per line.
fn events(trace: &str) -> Vec<Event> {
    let event = |line: &str| match line.split_once(' ') {
        Some(("synced", path)) => Event::Synced(path.into()),
        Some(("renamed", path)) => Event::Renamed(path.to_owned()),
        _ => Event::Sent,
    };
    trace.lines().map(event).collect()
}

/// Prunes a store whose files have chosen ages. Catches a prune that removes younger hulls, keeps
/// older ones, or disturbs a server that uses a removed hull. That server goes on with its cached
/// copy for the cache age, other servers report the hull as unknown, and registering it again
/// restores it.
#[tokio::test(flavor = "multi_thread")]
async fn pruning_removes_what_is_old_and_nothing_else() {
    const HOUR: Duration = Duration::from_secs(3600);
    let directory = tempfile::tempdir().unwrap();
    let store = directory.path();
    let server = Process::start(Command::new(BINARY), store, &["--cache-age-seconds", "1000000"]);
    let shapes: Vec<_> = (0..5).map(|seed| plain(round_points(20, seed))).collect();
    server.hulls().await.register_hulls(register_request(&shapes)).await.unwrap();
    let now = SystemTime::now();
    let ages = [now - 240 * HOUR, now - 217 * HOUR, now - 215 * HOUR, now, now + 240 * HOUR];
    let file = |shape| {
        let name: String = id(shape).iter().map(|byte| format!("{byte:02x}")).collect();
        store.join(&name[..2]).join(name)
    };
    let date = |path: &Path, time| std::fs::File::options().write(true).open(path)?.set_modified(time);
    shapes.iter().zip(ages).for_each(|(shape, age)| date(&file(shape), age).unwrap());
    let aside = store.join("quarantine");
    std::fs::create_dir(&aside).unwrap();
    std::fs::write(aside.join("kept"), "for people").unwrap();
    date(&aside.join("kept"), ages[0]).unwrap();

    let bytes = shapes[0].identity_bytes().len() + shapes[1].identity_bytes().len();
    let prune = |more: &[&str]| {
        let mut command = Command::new(BINARY);
        let output = command.args(["prune", "--older-than", "9d", "--store"]).arg(store).args(more).output();
        let output = output.unwrap();
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    let there = || shapes.iter().map(|shape| file(shape).exists()).collect::<Vec<_>>();
    assert_eq!(prune(&["--dry-run"]), format!("would remove 2 hulls, {bytes} bytes; kept 3\n"));
    assert_eq!(there(), [true; 5]);
    assert_eq!(prune(&[]), format!("removed 2 hulls, {bytes} bytes; kept 3\n"));
    assert_eq!(there(), [false, false, true, true, true]);
    assert!(aside.join("kept").exists());
    assert_eq!(prune(&[]), "removed 0 hulls, 0 bytes; kept 3\n");

    let request = scene(&shapes, 10, 50, 3);
    let good = expected(&request, &shapes);
    assert_same(&server.contacts().await.query_contacts(request.clone()).await.unwrap().into_inner(), &good);
    let other = Process::plain(store);
    let answer = other.contacts().await.query_contacts(request.clone()).await.unwrap().into_inner();
    assert_eq!(answer.missing_hulls, [0, 1]);
    server.hulls().await.register_hulls(register_request(&shapes)).await.unwrap();
    assert_eq!(there(), [true; 5]);
    assert_same(&other.contacts().await.query_contacts(request).await.unwrap().into_inner(), &good);
}

/// Catches a number of threads, each with its own memory, that grows with the number of reads and
/// writes.
#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn a_store_in_use_takes_a_bounded_number_of_threads() {
    let directory = tempfile::tempdir().unwrap();
    let server = Process::plain(directory.path());
    let threads = || {
        let status = std::fs::read_to_string(format!("/proc/{}/status", server.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("Threads:")).unwrap();
        line.trim().parse::<usize>().unwrap()
    };
    let registering = (0..8).map(|caller| {
        let address = server.address.clone();
        tokio::spawn(async move {
            let shapes: Vec<_> = (0..100).map(|i| plain(round_points(8, 100 * caller + i))).collect();
            let mut hulls = HullServiceClient::new(channel(&address).await);
            hulls.register_hulls(register_request(&shapes)).await.unwrap()
        })
    });
    for call in futures_util::future::join_all(registering).await {
        assert_eq!(call.unwrap().into_inner().results.len(), 100);
    }
    // The threads of the file store, those that serve and those that compute, and a few more.
    let cores = std::thread::available_parallelism().unwrap().get();
    let found = threads();
    assert!((8..=32 + 2 * cores + 8).contains(&found), "{found} threads");
}

/// A server that is asked to stop, by either signal or by the end of standard input, must exit with
/// 0. Catches a stop that a supervisor takes for a crash.
#[tokio::test(flavor = "multi_thread")]
async fn asked_to_stop_it_exits_with_success() {
    let directory = tempfile::tempdir().unwrap();
    for signal in ["-TERM", "-INT"] {
        let mut server = Process::start(Command::new(BINARY), directory.path(), &["--grace-seconds", "0"]);
        // Without the flag, the end of standard input must have no effect.
        drop(server.stdin.take());
        server.hulls().await.has_hulls(HasHullsRequest::default()).await.unwrap();
        server.signal(signal);
        assert!(server.wait().success(), "{signal}");
    }
    let mut server = Process::start(Command::new(BINARY), directory.path(), &["--until-stdin-closes"]);
    server.hulls().await.has_hulls(HasHullsRequest::default()).await.unwrap();
    drop(server.stdin.take());
    assert!(server.wait().success());
}

/// Catches an order of precedence other than the documented one: flags over the environment, and
/// the environment over the file. Uses the real command line.
#[test]
fn flags_win_over_the_environment_and_the_environment_over_the_file() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("hullcast.toml");
    std::fs::write(&file, "max_page_size = 1\ncache_bytes = 1\nstore_bytes = 1\n").unwrap();
    let run = |arguments: &[&str]| {
        let output = Command::new(BINARY)
            .args(["serve", "--config"])
            .arg(&file)
            .args(arguments)
            .env("HULLCAST_CACHE_BYTES", "2")
            .env("HULLCAST_STORE_BYTES", "2")
            .output()
            .unwrap();
        let text = |mut bytes: &[u8]| {
            let mut text = String::new();
            bytes.read_to_string(&mut text).unwrap();
            text
        };
        (output.status, text(&output.stdout), text(&output.stderr))
    };
    let (status, printed, _) =
        run(&["--print-config", "--store-bytes", "3", "--listen", "unix:a", "--listen", "unix:b"]);
    assert!(status.success());
    for line in ["max_page_size = 1", "cache_bytes = 2", "store_bytes = 3", "max_pairs_per_request = 131072"]
    {
        assert!(printed.lines().any(|printed| printed == line), "{line} in {printed}");
    }
    assert!(printed.contains(r#"listen = ["unix:a", "unix:b"]"#), "{printed}");

    std::fs::write(&file, "max_page_sizes = 1\n").unwrap();
    let (status, _, said) = run(&[]);
    assert!(!status.success() && said.contains("max_page_sizes"), "{said}");
    let (status, _, said) = run(&["--max-pairs-in-flight", "1", "--store", "memory://"]);
    assert!(!status.success(), "{said}");
}

/// Catches a build without OTLP that accepts a collector's address and never sends anything to it.
#[test]
#[cfg(not(feature = "otlp"))]
fn a_build_without_traces_says_so() {
    let arguments = ["serve", "--store", "memory://", "--otlp-endpoint", "http://127.0.0.1:4317"];
    let output = Command::new(BINARY).args(arguments).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && said.contains("--features otlp"), "{said}");
}

/// Catches a server that offers plain text to other machines by default.
#[test]
fn plain_text_off_this_machine_has_to_be_asked_for() {
    let refused = |address: &str| {
        let mut command = Command::new(BINARY);
        let output = command.args(["serve", "--store", "memory://", "--listen", address]).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && output.stdout.is_empty(), "{said}");
        said
    };
    for address in ["0.0.0.0:0", "[::]:0"] {
        assert!(refused(address).contains("--allow-plaintext"));
    }
    let directory = tempfile::tempdir().unwrap();
    let mut command = Command::new(BINARY);
    command.args(["serve", "--listen", "0.0.0.0:0", "--allow-plaintext", "--until-stdin-closes", "--store"]);
    let output = command.arg(directory.path()).stdin(Stdio::null()).output().unwrap();
    assert!(output.status.success());
    assert!(String::from_utf8_lossy(&output.stdout).starts_with("listening on 0.0.0.0:"));
}

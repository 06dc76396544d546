//! Attacks on the store and the cache: missing hulls, hulls of other callers, and a store directory that
//! someone has tampered with.

use std::{
    fs::File,
    io::Write,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::Command,
};

use futures_util::future::join_all;
use hullcast::proto::{HasHullsRequest, ListHullsRequest, QueryContactsRequest};

use crate::{
    messages::same_pair,
    scenes::{plain, round_points},
    support::{arena::Arena, bystander::with_token, setup::Size},
};

attacks! {
    /// Catches a log line or a read of the store for each of many missing hulls.
    missing: "HasHulls and queries of 16,384 hulls that are not there" => missing;
    /// Catches a log line for each of many corrupt hulls.
    corrupt: "HasHulls of 1,000 corrupt hulls", |s: Setup| Setup { fill_store: Some(corrupt_blobs), ..s }
        => corrupt;
    /// Catches listings and look-ups of a large store that delay other callers.
    listings: "ListHulls of a large store and HasHulls of uncached hulls in a loop",
        |s: Setup| s.cache(2 << 20) => listings;
    /// Catches one caller's hulls that keep the hulls of all others out of the cache.
    evicting: "one caller's hulls that evict those of all others", |s: Setup| s.cache(4 << 20) => evicting;
    /// Catches page tokens that the server trusts without a check.
    page_tokens: "forged page tokens" => page_tokens;
    /// Catches files that are opened before their kind and size are checked. A bad entry may only fail its
    /// own hull.
    tampered: "a store with a sparse file of 3 GiB, a FIFO, links in a loop and out of the store",
        |s: Setup| Setup { fill_store: Some(tamper), ..s } => tampered;
}

/// A hull id that was never registered.
fn name(kind: u8, number: usize) -> Vec<u8> {
    let mut id = vec![kind; 32];
    id[1..9].copy_from_slice(&(number as u64 * 0x9e37_79b9).to_be_bytes());
    id
}

/// The file in which the store keeps the hull `id`.
fn file(store: &Path, id: &[u8]) -> PathBuf {
    let name: String = id.iter().map(|byte| format!("{byte:02x}")).collect();
    let directory = store.join(&name[..2]);
    std::fs::create_dir_all(&directory).expect("a directory");
    directory.join(name)
}

/// Asks for all of `ids` with HasHulls from 4 callers, again and again, until the bystander has been
/// answered often enough. Each call must be answered or refused, whatever the store contains. Returns the
/// number of calls.
async fn ask(arena: &Arena, ids: &[Vec<u8>]) -> usize {
    let asked = std::sync::atomic::AtomicUsize::new(0);
    let callers = join_all((0..4).map(async |_| {
        let mut hulls = arena.hulls().await;
        loop {
            let request = HasHullsRequest { ids: ids.to_vec() };
            let _ = hulls.has_hulls(with_token(request)).await;
            asked.fetch_add(1, std::sync::atomic::Ordering::SeqCst);
        }
    }));
    tokio::select! {
        () = arena.bystander_answered(arena.size().of(400)) => {}
        _ = callers => {}
    }
    asked.into_inner()
}

async fn missing(arena: &Arena) {
    let ids: Vec<_> = (0..arena.size().of(16_384) - 1).map(|number| name(7, number)).collect();
    arena.begin().await;
    let asked = ask(arena, &ids).await;
    let mut contacts = arena.contacts().await;
    let request = QueryContactsRequest { pairs: vec![0, 1], ..same_pair(&ids, 1, 0.5) };
    let answer = contacts.query_contacts(with_token(request)).await.expect("an answer").into_inner();
    assert_eq!(answer.missing_hulls.len(), ids.len());
    let lines = arena.server.log().lines().count();
    assert!(lines <= asked + 20, "{lines} lines for {asked} requests");
}

fn corrupt_blobs(store: &Path) {
    for number in 0..1000 {
        std::fs::write(file(store, &name(8, number)), [0; 100]).expect("a blob");
    }
}

async fn corrupt(arena: &Arena) {
    let ids: Vec<_> = (0..1000).map(|number| name(8, number)).collect();
    arena.begin().await;
    let asked = ask(arena, &ids).await;
    let lines = arena.server.log().lines().count();
    assert!(lines <= asked + 20, "{lines} lines for {asked} requests");
}

/// Registers more hulls than fit in the cache, and returns their ids.
async fn many_hulls(arena: &Arena) -> Vec<Vec<u8>> {
    let shapes: Vec<_> =
        (0..arena.size().of(2000)).map(|seed| plain(round_points(60, seed as u64))).collect();
    arena.register(&shapes).await
}

async fn listings(arena: &Arena) {
    let ids = many_hulls(arena).await;
    arena.begin().await;
    let lists = join_all((0..4).map(async |_| {
        let mut hulls = arena.hulls().await;
        loop {
            let request = ListHullsRequest { page_size: 10, page_token: String::new() };
            let _ = hulls.list_hulls(with_token(request)).await;
        }
    }));
    tokio::select! {
        _ = ask(arena, &ids) => {}
        _ = lists => {}
    }
}

async fn evicting(arena: &Arena) {
    let ids = many_hulls(arena).await;
    arena.begin().await;
    let callers = join_all((0..4).map(async |i| {
        let mut contacts = arena.contacts().await;
        loop {
            for some in ids.chunks(20).skip(i).step_by(4) {
                let request = same_pair(some, 100, 1.5);
                // A call is refused if its caller would hold more than its share.
                let _ = contacts.query_contacts(with_token(request)).await;
            }
        }
    }));
    tokio::select! {
        () = arena.bystander_answered(arena.size().of(400)) => {}
        _ = callers => {}
    }
}

async fn page_tokens(arena: &Arena) {
    arena.begin().await;
    let mut hulls = arena.hulls().await;
    let long = "f".repeat(1 << 20);
    for token in ["x", "../../etc/passwd", "\u{0}", "ff", "-1", &"f".repeat(63), &"g".repeat(64), &long] {
        let request = ListHullsRequest { page_size: u32::MAX, page_token: token.into() };
        hulls.list_hulls(with_token(request)).await.expect_err("a forged token");
    }
    arena.bystander_answered(arena.size().of(100)).await;
}

/// The number of bad entries of each kind.
const BAD: usize = 70;

/// The content of a file outside the store, which no client may see.
const SECRET: &str = "root of all evil";

fn tamper(store: &Path) {
    let secret = store.parent().expect("its directory").join("secret");
    std::fs::write(&secret, SECRET).expect("a file");
    let sparse = File::create(file(store, &name(1, 0))).expect("a file");
    sparse.set_len(3 << 30).expect("a sparse file");
    for number in 0..BAD {
        let fifo = file(store, &name(2, number));
        assert!(Command::new("mkfifo").arg(fifo).status().expect("mkfifo").success());
        let there = file(store, &name(3, number));
        symlink(&there, &there).expect("a link to itself");
        symlink(&secret, file(store, &name(4, number))).expect("a link out of the store");
        std::fs::create_dir(file(store, &name(5, number))).expect("a directory");
    }
    let mut stranger = File::create(store.join("a file that is no hull")).expect("a file");
    stranger.write_all(b"hullcast").expect("its content");
}

async fn tampered(arena: &Arena) {
    let ids: Vec<_> = (1..=5).flat_map(|kind| (0..BAD).map(move |number| name(kind, number))).collect();
    arena.begin().await;
    // Each kind is asked for separately, so that the failure of one does not hide the others.
    for kind in ids.chunks(BAD) {
        ask(arena, kind).await;
    }
    let mut hulls = arena.hulls().await;
    let request = ListHullsRequest { page_size: 1000, page_token: String::new() };
    let listed = hulls.list_hulls(with_token(request)).await.expect("a listing").into_inner().hulls;
    assert!(listed.len() >= 5, "the bystander's hulls are listed");
    // Another hull can still be stored, and no file of the store contains the content of the linked file.
    arena.register(&[plain(round_points(20, 1))]).await;
    let copies = Command::new("grep").args(["-rlsD", "skip", SECRET]).arg(arena.server.store()).output();
    let copies = copies.expect("grep").stdout;
    assert!(copies.is_empty(), "{}", String::from_utf8_lossy(&copies));
    assert!(arena.size() == Size::Full || arena.server.log().lines().count() < 2000);
}

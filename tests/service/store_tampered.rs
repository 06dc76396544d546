//! A store's directory that was tampered with.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    os::unix::{fs::symlink, net::UnixListener},
    path::{Path, PathBuf},
    process::Command,
    time::Instant,
};

use hullcast::{
    proto::{GetHullsRequest, HasHullsRequest, ListHullsRequest, register_hull_result::Result as Registered},
    service::Limits,
    store::{HullDefinition, blobs},
};
use tonic::Code;

use crate::support::{
    Setup, TestServer,
    process::Process,
    refusal, refused,
    scenes::{assert_same, expected, id, plain, register_request, round_points, scene},
};

fn shapes(count: u64) -> Vec<HullDefinition> {
    (0..count).map(|seed| plain(round_points(20, seed))).collect()
}

fn hex(shape: &HullDefinition) -> String {
    id(shape).iter().map(|byte| format!("{byte:02x}")).collect()
}

fn file(store: &Path, shape: &HullDefinition) -> PathBuf {
    let name = hex(shape);
    store.join(&name[..2]).join(name)
}

async fn server(store: &Path, limits: Limits) -> TestServer {
    let store = blobs::open(store.to_str().unwrap()).unwrap();
    Setup { store, limits, ..Setup::default() }.start().await
}

async fn register(server: &TestServer, shapes: &[HullDefinition]) {
    let answer = server.hulls().register_hulls(register_request(shapes)).await.unwrap().into_inner();
    assert!(answer.results.iter().all(|result| matches!(result.result, Some(Registered::Hull(_)))));
}

async fn listed(server: &TestServer, page_size: u32) -> Vec<Vec<u8>> {
    let (mut ids, mut page_token) = (Vec::new(), String::new());
    loop {
        let request = ListHullsRequest { page_size, page_token };
        let page = server.hulls().list_hulls(request).await.unwrap().into_inner();
        ids.extend(page.hulls.into_iter().map(|hull| hull.id));
        page_token = page.next_page_token;
        if page_token.is_empty() {
            return ids;
        }
    }
}

async fn has(server: &TestServer, shapes: &[HullDefinition]) -> Vec<bool> {
    let ids = shapes.iter().map(id).collect();
    server.hulls().has_hulls(HasHullsRequest { ids }).await.unwrap().into_inner().present
}

/// Puts an entry in the place of a blob; returns whether that was possible.
type Tamper = fn(&Path) -> bool;

fn made(program: &str, path: &Path, arguments: &[&str]) -> bool {
    Command::new(program).arg(path).args(arguments).status().unwrap().success()
}

/// Entries that replace a blob. None is a regular file within the size limit.
const CASES: [(&str, Tamper); 8] = [
    ("a sparse file of 3 GiB", |path| File::create(path).and_then(|file| file.set_len(3 << 30)).is_ok()),
    ("a FIFO", |path| made("mkfifo", path, &[])),
    ("a socket", |path| UnixListener::bind(path).is_ok()),
    // Only root may create one.
    ("a device", |path| made("mknod", path, &["c", "1", "5"])),
    ("a directory", |path| fs::create_dir(path).and_then(|()| fs::write(path.join("kept"), "kept")).is_ok()),
    ("a link to itself", |path| symlink(path, path).is_ok()),
    ("a link to nowhere", |path| symlink("/nowhere", path).is_ok()),
    ("a link to a file", |path| symlink(path.ancestors().nth(3).unwrap().join("secret"), path).is_ok()),
];

/// Catches an entry that is opened before it is examined. Such an entry may block a thread forever,
/// be read into memory whole, make a listing fail, or cause a copy of the file that it links to.
/// Each entry must cost only its own hull, until that hull is registered again.
#[tokio::test(flavor = "multi_thread")]
async fn a_bad_entry_costs_its_own_hull_only() {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("secret"), "secret").unwrap();
    let store = directory.path().canonicalize().unwrap().join("store");
    let shapes = shapes(24);
    register(&server(&store, Limits::default()).await, &shapes).await;
    let mut bad = BTreeMap::new();
    for ((what, tamper), index) in CASES.into_iter().zip((0..24).step_by(3)) {
        let path = file(&store, &shapes[index]);
        let good = fs::read(&path).unwrap();
        fs::remove_file(&path).unwrap();
        if tamper(&path) {
            bad.insert(index, what);
        } else {
            fs::write(&path, good).unwrap();
        }
    }
    assert!(bad.len() >= 7, "{bad:?}");
    let is_good: Vec<bool> = (0..shapes.len()).map(|i| !bad.contains_key(&i)).collect();
    let good_ids = || {
        let good = shapes.iter().zip(&is_good).filter(|(_, good)| **good);
        let mut ids: Vec<_> = good.map(|(shape, _)| id(shape)).collect();
        ids.sort();
        ids
    };

    let here = server(&store, Limits::default()).await;
    let request = scene(&shapes, 48, 100, 1);
    let answer = here.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
    assert_eq!(answer.missing_hulls, bad.keys().map(|&i| i as u32).collect::<Vec<_>>());
    assert_eq!(has(&here, &shapes).await, is_good);
    let ids = shapes.iter().map(id).collect();
    let records = here.hulls().get_hulls(GetHullsRequest { ids, field_mask: None }).await.unwrap();
    let found: Vec<_> = records.into_inner().hulls.iter().map(|record| record.found).collect();
    assert_eq!(found, is_good);
    for page_size in [1, 5, 1000] {
        assert_eq!(listed(&here, page_size).await, good_ids());
    }
    assert!(!store.join("quarantine").exists(), "nothing of it was copied");

    register(&here, &shapes).await;
    let answer = here.contacts().query_contacts(request.clone()).await.unwrap().into_inner();
    assert_same(&answer, &expected(&request, &shapes));
    let after = server(&store, Limits::default()).await;
    assert_eq!(has(&after, &shapes).await, vec![true; shapes.len()]);
    assert_eq!(listed(&after, 1000).await.len(), shapes.len());
    assert_eq!(fs::read(directory.path().join("secret")).unwrap(), b"secret", "the link was written through");
    let kept: Vec<_> = fs::read_dir(store.join("quarantine")).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(kept.len(), 1, "{kept:?}");
    assert_eq!(fs::read(kept[0].join("kept")).unwrap(), b"kept", "the content of the directory was not kept");
}

/// A file of the largest size is read and set aside; a file one byte larger is not read. Catches a
/// size limit that is off by one, or that is checked only after the file was read.
#[tokio::test(flavor = "multi_thread")]
async fn the_size_limit_holds_at_the_limit_and_one_past() {
    let directory = tempfile::tempdir().unwrap();
    let limits = Limits { max_message_bytes: 4096, ..Limits::default() };
    let most = limits.max_blob_bytes();
    let shapes = shapes(2);
    register(&server(directory.path(), Limits::default()).await, &shapes).await;
    for (shape, size) in shapes.iter().zip([most, most + 1]) {
        File::create(file(directory.path(), shape)).unwrap().set_len(size).unwrap();
    }
    let here = server(directory.path(), limits).await;
    assert_eq!(has(&here, &shapes).await, [false, false]);
    let kept: Vec<_> = fs::read_dir(directory.path().join("quarantine")).unwrap().collect();
    let [kept] = &kept[..] else { panic!("{kept:?}") };
    let kept = kept.as_ref().unwrap();
    assert!(kept.file_name().to_str().unwrap().starts_with(&hex(&shapes[0])));
    assert_eq!(kept.metadata().unwrap().len(), most);
    assert_eq!(listed(&here, 10).await, [id(&shapes[0])]);
}

/// Catches a file without read permission that is reported as an outage of the store.
#[tokio::test(flavor = "multi_thread")]
async fn an_unreadable_file_is_a_missing_hull() {
    use std::os::unix::fs::PermissionsExt;
    let directory = tempfile::tempdir().unwrap();
    let shapes = shapes(2);
    register(&server(directory.path(), Limits::default()).await, &shapes).await;
    let path = file(directory.path(), &shapes[0]);
    fs::set_permissions(&path, fs::Permissions::from_mode(0o000)).unwrap();
    // Root may read every file.
    let readable = File::open(&path).is_ok();
    let here = server(directory.path(), Limits::default()).await;
    assert_eq!(has(&here, &shapes).await, [readable, true]);
    register(&server(directory.path(), Limits::default()).await, &shapes).await;
    assert_eq!(has(&here, &shapes).await, [true, true]);
}

/// Catches a shard directory that was replaced by a link and is read or written through it, and one
/// that ends the listing of the other shards.
#[tokio::test(flavor = "multi_thread")]
async fn links_in_place_of_directories_are_not_followed() {
    let directory = tempfile::tempdir().unwrap();
    let store = directory.path().join("store");
    let shapes = shapes(12);
    register(&server(&store, Limits::default()).await, &shapes).await;
    let shard = store.join(&hex(&shapes[0])[..2]);
    let elsewhere = directory.path().join("elsewhere");
    fs::rename(&shard, &elsewhere).unwrap();
    symlink(&elsewhere, &shard).unwrap();
    let is_there: Vec<bool> = shapes.iter().map(|shape| !file(&store, shape).starts_with(&shard)).collect();
    let here = server(&store, Limits::default()).await;
    assert_eq!(has(&here, &shapes).await, is_there);
    assert_eq!(listed(&here, 5).await.len(), is_there.iter().filter(|there| **there).count());
    let status = here.hulls().register_hulls(register_request(&shapes[..1])).await.unwrap_err();
    assert_eq!(refusal(&status), refused(Code::Unavailable, "STORE_UNAVAILABLE", ""));
    assert!(status.message().contains("is not a directory"), "{status:?}");

    // A quarantine directory that is a link must receive no copies.
    fs::remove_file(&shard).unwrap();
    fs::rename(&elsewhere, &shard).unwrap();
    fs::create_dir(&elsewhere).unwrap();
    symlink(&elsewhere, store.join("quarantine")).unwrap();
    fs::write(file(&store, &shapes[1]), "not a hull").unwrap();
    let mut expected = vec![true; shapes.len()];
    expected[1] = false;
    assert_eq!(has(&here, &shapes).await, expected);
    assert_eq!(fs::read_dir(&elsewhere).unwrap().count(), 0);
}

/// Catches a log that a caller can fill, with one line per bad hull of a request or one line per
/// request.
#[tokio::test(flavor = "multi_thread")]
async fn a_request_of_many_bad_hulls_writes_one_line() {
    const REQUESTS: usize = 30;
    let directory = tempfile::tempdir().unwrap();
    let (store, log) = (directory.path().join("store"), directory.path().join("log"));
    let shapes = shapes(50);
    let started = Instant::now();
    let server = Process::logging(&store, &["--cache-bytes", "1000"], &log);
    server.hulls().await.register_hulls(register_request(&shapes)).await.unwrap();
    for shape in &shapes {
        fs::write(file(&store, shape), "not a hull").unwrap();
    }
    let mut hulls = server.hulls().await;
    for _ in 0..REQUESTS {
        let ids = shapes.iter().map(id).collect();
        let answer = hulls.has_hulls(HasHullsRequest { ids }).await.unwrap().into_inner();
        assert_eq!(answer.present, [false; 50]);
    }
    let lines = fs::read_to_string(&log).unwrap();
    let lines: Vec<_> = lines.lines().filter(|line| line.contains("could not be read")).collect();
    assert!(lines[0].contains("hulls=50") && lines[0].contains("left_out=0"), "{lines:?}");
    let seconds = started.elapsed().as_secs() as usize;
    assert!(lines.len() <= REQUESTS.min(1 + seconds), "{} lines in {seconds} s", lines.len());
    assert!(fs::metadata(&log).unwrap().len() < 64 << 10);
}

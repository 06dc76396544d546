//! The command line as a user meets it: the real binary, its output and its exit code.

use std::error::Error;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;

#[path = "cli/failures.rs"]
mod failures;
#[path = "cli/limited.rs"]
mod limited;
#[path = "cli/recorded.rs"]
mod recorded;
#[path = "cli/secured.rs"]
mod secured;
#[path = "cli/serving.rs"]
mod serving;
#[path = "cli/shown.rs"]
mod shown;
#[path = "cli/texts.rs"]
mod texts;

type Outcome = Result<(), Box<dyn Error>>;

const BINARY: &str = env!("CARGO_BIN_EXE_hullcast");

fn scenes() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/scenes")
}

/// An empty folder for one test.
fn scratch(name: &str) -> Result<PathBuf, Box<dyn Error>> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("cli-{name}"));
    if folder.exists() {
        std::fs::remove_dir_all(&folder)?;
    }
    std::fs::create_dir_all(&folder)?;
    Ok(folder)
}

/// A running server, killed when dropped.
struct Server {
    process: Child,
    address: String,
}

impl Server {
    fn start(store: &Path) -> Result<Self, Box<dyn Error>> {
        Self::start_with(store, &[])
    }

    fn start_with(store: &Path, arguments: &[&str]) -> Result<Self, Box<dyn Error>> {
        let mut process = Command::new(BINARY)
            .args(["serve", "--listen", "127.0.0.1:0", "--until-stdin-closes", "--store"])
            .arg(store)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let mut line = String::new();
        BufReader::new(process.stdout.take().ok_or("no output")?).read_line(&mut line)?;
        let address = line.trim().strip_prefix("listening on ").ok_or("not listening")?.to_owned();
        Ok(Self { process, address })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn hullcast(arguments: &[&str]) -> Result<Output, Box<dyn Error>> {
    Ok(Command::new(BINARY).args(arguments).stdin(Stdio::null()).output()?)
}

/// The standard output of a command that must succeed.
fn printed(arguments: &[&str]) -> Result<Vec<u8>, Box<dyn Error>> {
    let output = hullcast(arguments)?;
    if output.status.success() {
        return Ok(output.stdout);
    }
    Err(format!("{arguments:?}: {}", String::from_utf8_lossy(&output.stderr)).into())
}

fn text(path: &Path) -> &str {
    path.to_str().expect("the repository's path is text")
}

/// Queries the same scenes in this process and on a server, and compares the output byte by byte.
/// Catches another order, another split of the batch, and a number that loses bits on its way.
#[test]
fn a_server_answers_as_this_process_does() -> Outcome {
    let folder = scratch("same")?;
    let server = Server::start(&folder.join("store"))?;
    let mut contacts = 0;
    for (scene, frame, extra) in [
        ("panda.json", "2", &[][..]),
        ("panda.json", "5", &["--solver", "gjk-ray-cast"]),
        (
            "anymal_c.json",
            "4",
            &["--margin", "inf", "--outputs", "alpha,normal,points,witness-b,diagnostics"],
        ),
        ("pile.json", "0", &["--max-points", "4"]),
    ] {
        let scene = scenes().join(scene);
        let ask =
            |form: &[&str]| printed(&[&["query", text(&scene), "--frame", frame], extra, form].concat());
        let remote = ["--remote", &server.address];
        let json = ask(&["--json"])?;
        assert_eq!(json, ask(&[&["--json"], &remote[..]].concat())?);
        assert_eq!(ask(&["--all"])?, ask(&[&["--all"], &remote[..]].concat())?);
        let files = [folder.join("local.npz"), folder.join("remote.npz")];
        ask(&["--out", text(&files[0])])?;
        ask(&[&["--out", text(&files[1])], &remote[..]].concat())?;
        assert_eq!(std::fs::read(&files[0])?, std::fs::read(&files[1])?);
        let answer: Value = serde_json::from_slice(&json)?;
        let pairs = answer["pairs"].as_array().ok_or("no pairs")?;
        contacts += pairs.iter().filter(|pair| pair["outcome"] == "CONTACT").count();
    }
    assert!(contacts > 500, "{contacts} contacts compared");
    Ok(())
}

/// Unusable poses must be counted on standard error and give exit code 1, in this process and on a
/// server. Catches a diverged scene that looks to a script like a scene without contacts.
#[test]
fn unusable_poses_are_counted_and_fail() -> Outcome {
    let folder = scratch("unusable")?;
    let server = Server::start(&folder.join("store"))?;
    let scene = |rotation: &str| -> Result<PathBuf, Box<dyn Error>> {
        let path = folder.join("scene.json");
        let content = format!(
            r#"{{"format": "hullcast.scene.v1", "name": "two", "margin": 0.5,
            "hulls": [{{"vertices": [[0,0,0],[1,0,0],[0,1,0],[0,0,1]]}}],
            "bodies": [{{"hull": 0, "position": [0,0,0], "rotation": [0,0,0,1]}},
                       {{"hull": 0, "position": [0,0,0.5], "rotation": {rotation}}}],
            "pairs": [[0,1],[0,0]]}}"#
        );
        std::fs::write(&path, content)?;
        Ok(path)
    };
    let path = scene("[0,0,0,0]")?;
    let output = hullcast(&["load", "--count", "1", "--scene", text(&path)])?;
    let said = String::from_utf8(output.stderr)?;
    assert_eq!(output.status.code(), Some(6), "{said}");
    assert!(said.contains("1 of 2 bodies (bodies 1)"), "{said}");
    for remote in [&[][..], &["--remote", &server.address]] {
        for rotation in ["[0,0,0,0]", "[0,0,0,0.2]", "[0,0,0,4.1]"] {
            let output = hullcast(&[&["query", text(&scene(rotation)?), "--json"], remote].concat())?;
            assert_eq!(output.status.code(), Some(6), "{rotation}");
            let said = String::from_utf8(output.stderr)?;
            assert!(said.contains("1 of 2 bodies (bodies 1)") && said.contains("1 of 2 pairs is"), "{said}");
            let answer: Value = serde_json::from_slice(&output.stdout)?;
            assert_eq!(answer["pairs"].as_array().ok_or("no pairs")?.len(), 2, "the answer is printed");
        }
        for rotation in ["[0,0,0,0.3]", "[0,0,0,3.9]", "[0,0,0,1.01]"] {
            printed(&[&["query", text(&scene(rotation)?)], remote].concat())?;
        }
    }
    Ok(())
}

/// Each broken scene must be refused with the field and the index of the error. Catches a message
/// that leaves the user to search the file.
#[test]
fn bad_scenes_are_refused_by_field_and_index() -> Outcome {
    let folder = scratch("bad")?;
    let server = Server::start(&folder.join("store"))?;
    let good = r#"{"format": "hullcast.scene.v1", "name": "two", "margin": 0.5,
        "hulls": [{"vertices": [[0,0,0],[1,0,0],[0,1,0],[0,0,1]]}],
        "bodies": [{"hull": 0, "position": [0,0,0], "rotation": [0,0,0,1]},
                   {"hull": 0, "position": [0,0,2], "rotation": [0,0,0,1]}],
        "pairs": [[0,1]]}"#;
    let path = folder.join("scene.json");
    std::fs::write(&path, good)?;
    printed(&["query", text(&path)])?;
    for (from, to, place) in [
        ("[0,0,1]]", "[0,0]]", "hulls[0].vertices[3]: "),
        ("[0,0,1]]", "[1,1,0]]", "hulls[0].vertices: COPLANAR"),
        (
            "1]]}]",
            "1]], \"contraction_point\": [1,1,1]}]",
            "hulls[0].contraction_point: CONTRACTION_POINT_NOT_INSIDE",
        ),
        ("{\"hull\": 0, \"position\": [0,0,2]", "{\"hull\": 1, \"position\": [0,0,2]", "bodies[1].hull: "),
        ("[[0,1]]", "[[0,1],[0,2]]", "pairs[1][1]: "),
    ] {
        std::fs::write(&path, good.replacen(from, to, 1))?;
        for remote in [&[][..], &["--remote", &server.address]] {
            let output = hullcast(&[&["query", text(&path)], remote].concat())?;
            let said = String::from_utf8(output.stderr)?;
            assert_eq!(output.status.code(), Some(3), "{place}{said}");
            assert!(said.contains(place), "expected {place:?} in {said:?}");
            assert!(output.stdout.is_empty());
        }
    }
    std::fs::write(&path, good)?;
    Ok(())
}

/// A pose with a quaternion of norm 5 must invalidate only its own pairs. Catches an invalid pose
/// that ends the whole query, or that the answer does not name.
#[test]
fn an_unusable_pose_costs_its_own_pairs() -> Outcome {
    let path = scratch("pose")?.join("scene.json");
    let scene = r#"{"format": "hullcast.scene.v1", "name": "three",
        "hulls": [{"vertices": [[0,0,0],[1,0,0],[0,1,0],[0,0,1]]}],
        "bodies": [{"hull": 0, "position": [0,0,0], "rotation": [0,0,0,1]},
                   {"hull": 0, "position": [0,0,0.1], "rotation": [0,0,0,5]},
                   {"hull": 0, "position": [0,0,0.1], "rotation": [0,0,0,1]}],
        "pairs": [[0,1],[0,2]]}"#;
    std::fs::write(&path, scene)?;
    let answer: Value = serde_json::from_slice(&hullcast(&["query", text(&path), "--json"])?.stdout)?;
    assert_eq!(answer["invalid_bodies"], serde_json::json!([1]));
    assert_eq!(answer["pairs"][0]["outcome"], "INVALID");
    assert_eq!(answer["pairs"][0]["flags"], serde_json::json!(["INVALID_BODY"]));
    assert_eq!(answer["pairs"][1]["outcome"], "CONTACT");
    Ok(())
}

/// Runs `hullcast load` with verification of every batch. Catches a run that leaves out some
/// checks, or that loses batches.
#[test]
fn load_counts_and_checks_every_batch() -> Outcome {
    let folder = scratch("load")?;
    let server = Server::start(&folder.join("store"))?;
    let pile = scenes().join("pile.json");
    let everything = "alpha,normal,points,witness-b,features,bases,diagnostics";
    for (source, pairs) in [
        (&["--family", "box", "--regime", "shallow", "--pairs", "100"][..], 100),
        (&["--family", "poly16", "--regime", "resting", "--pairs", "64", "--outputs", everything], 64),
        (&["--family", "poly256", "--regime", "separated", "--pairs", "17", "--solver", "gjk-ray-cast"], 17),
        (&["--scene", text(&pile), "--pairs", "500"], 500),
    ] {
        for place in [&["--threads", "2"][..], &["--remote", &server.address, "--connections", "2"]] {
            let run = [
                "load",
                "--count",
                "12",
                "--duration",
                "60",
                "--concurrency",
                "3",
                "--verify",
                "1",
                "--json",
            ];
            let summary: Value = serde_json::from_slice(&printed(&[&run, source, place].concat())?)?;
            assert_eq!(summary["batches"], 12, "{summary}");
            assert_eq!(summary["pairs"], 12 * pairs);
            assert_eq!((&summary["checked_batches"], &summary["wrong_batches"]), (&12.into(), &0.into()));
            assert_eq!(summary["errors"], serde_json::json!({}));
        }
    }
    Ok(())
}

/// Runs the step loops of `hullcast load --session`, each step of which is compared with a search. Catches a
/// share of bodies that is not applied, steps that are lost, and options that are silently ignored.
#[test]
fn load_steps_sessions_and_checks_every_step() -> Outcome {
    let folder = scratch("load-session")?;
    let server = Server::start(&folder.join("store"))?;
    for family in ["box", "poly64"] {
        for (moved, churn) in [("1", "0"), ("0.1", "0.05"), ("0", "0")] {
            let steps =
                ["load", "--session", "--remote", &server.address, "--family", family, "--bodies", "200"];
            let run =
                ["--moved", moved, "--churn", churn, "--count", "20", "--concurrency", "2", "--verify", "1"];
            let summary: Value =
                serde_json::from_slice(&printed(&[&steps[..], &run, &["--json"]].concat())?)?;
            assert_eq!(
                (&summary["batches"], &summary["checked_batches"]),
                (&20.into(), &20.into()),
                "{summary}"
            );
            assert_eq!((&summary["wrong_batches"], &summary["errors"]), (&0.into(), &serde_json::json!({})));
            assert!(summary["pairs"].as_u64() > Some(20 * 20), "{summary}");
        }
    }
    let text = printed(&["load", "--session", "--remote", &server.address, "--bodies", "9", "--count", "3"])?;
    let text = String::from_utf8(text)?;
    assert!(text.starts_with("sessions of 9 bodies, of which 100 % move and 0 % jump"), "{text}");
    assert!(text.contains("3 steps, ") && text.contains("checked against new searches: 1 step"), "{text}");
    for (more, named) in [
        (&["--margin", "inf"][..], "--margin is inf"),
        (&["--pairs", "3"], "--pairs <COUNT>"),
        (&["--request-rate-range", "3"], "--request-rate-range <RANGE>"),
    ] {
        let output = hullcast(&[&["load", "--session", "--remote", &server.address], more].concat())?;
        assert_eq!(output.status.code(), Some(2));
        let why = String::from_utf8(output.stderr)?;
        assert!(why.contains(named), "{why}");
    }
    let without = hullcast(&["load", "--session"])?;
    assert!(String::from_utf8(without.stderr)?.contains("--remote <ADDRESS>"));
    Ok(())
}

/// A load run on two servers, of which the second drops every connection at once. Catches a run
/// that gives up a lost server's batch although another server is there, and a run that hides the
/// loss.
#[test]
fn load_sends_again_what_a_lost_server_did_not_answer() -> Outcome {
    let folder = scratch("lost")?;
    let server = Server::start(&folder.join("store"))?;
    let listener = std::net::TcpListener::bind("127.0.0.1:0")?;
    let both = format!("{},{}", server.address, listener.local_addr()?);
    std::thread::spawn(move || listener.incoming().for_each(drop));
    let run = ["load", "--remote", &both, "--pairs", "10", "--count", "12", "--concurrency", "2", "--json"];
    let patient: Value = serde_json::from_slice(&printed(&[&run[..], &["--retries", "3"]].concat())?)?;
    assert_eq!((&patient["batches"], &patient["sent"]), (&12.into(), &12.into()), "{patient}");
    assert_eq!(patient["errors"], serde_json::json!({}));
    assert!(patient["lost"].as_u64() >= Some(1), "{patient}");
    let hasty = hullcast(&run)?;
    assert_eq!(hasty.status.code(), Some(1));
    let hasty: Value = serde_json::from_slice(&hasty.stdout)?;
    assert_eq!(hasty["lost"], 0, "{hasty}");
    assert!(hasty["errors"].as_object().is_some_and(|errors| !errors.is_empty()), "{hasty}");
    Ok(())
}

/// Catches a command that reports success although there is no server.
#[test]
fn no_server_is_an_error() -> Outcome {
    let panda = scenes().join("panda.json");
    // A port that was free a moment ago.
    let address = std::net::TcpListener::bind("127.0.0.1:0")?.local_addr()?.to_string();
    for command in [&["query", text(&panda)][..], &["load", "--pairs", "10"]] {
        let output = hullcast(&[command, &["--remote", &address]].concat())?;
        assert_eq!(output.status.code(), Some(4));
        let said = String::from_utf8(output.stderr)?;
        assert!(said.contains(&format!("no hullcast server at {address} (connection refused)")), "{said}");
    }
    Ok(())
}

/// Catches a scene file that is damaged, has become larger, or is published without its licence.
#[test]
fn committed_scenes_are_whole() -> Outcome {
    for (name, bodies, frames, licence) in [
        ("panda.json", 28, 6, Some("panda-Apache-2.0.txt")),
        ("anymal_c.json", 57, 6, Some("anymal_c-BSD-3-Clause.txt")),
        ("pile.json", 1005, 0, None),
    ] {
        let file = std::fs::read(scenes().join(name))?;
        assert!(file.len() < 1_500_000, "{name}: {} bytes", file.len());
        let scene: Value = serde_json::from_slice(&file)?;
        let list = |key: &str| scene[key].as_array().map_or(0, Vec::len);
        assert_eq!((list("bodies"), list("frames")), (bodies, frames), "{name}");
        if let Some(licence) = licence {
            assert!(scene["license"].as_str().is_some_and(|text| text.contains(licence)));
            assert!(std::fs::metadata(scenes().join("LICENSES").join(licence))?.len() > 1000);
            assert!(scene["origin"].as_str().is_some_and(|text| text.contains("example-robot-data")));
        }
        for hull in scene["hulls"].as_array().ok_or("no hulls")? {
            assert!(hull["volume_ratio"].as_f64().is_none_or(|ratio| ratio > 0.99), "{}", hull["name"]);
        }
        let bodies = scene["bodies"].as_array().into_iter().flatten().map(|body| &body["rotation"]);
        let frames = scene["frames"].as_array().into_iter().flatten();
        let moved = frames.flat_map(|frame| frame["rotations"].as_array().into_iter().flatten());
        for rotation in bodies.chain(moved) {
            let parts = rotation.as_array().ok_or("no rotation")?.iter().filter_map(Value::as_f64);
            let norm = parts.map(|x| x * x).sum::<f64>().sqrt();
            assert!((norm - 1.0).abs() < 1e-12, "{name}: a rotation of norm {norm}");
        }
    }
    Ok(())
}

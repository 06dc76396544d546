//! Runs the laboratory's program as `make tradeoff` and `make planarity` do, on few pairs.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

type Outcome = Result<(), Box<dyn Error>>;

fn lab(arguments: &[&str]) -> std::io::Result<Output> {
    Command::new(env!("CARGO_BIN_EXE_lab")).args(arguments).output()
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a path of ASCII letters")
}

fn panda() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/scenes/panda.json")
}

/// Runs a command that must fail with this exit code, print these texts, and print no result.
fn refused(command: &[&str], exit: i32, texts: &[&str]) -> Outcome {
    let output = lab(command)?;
    let said = String::from_utf8(output.stderr)?;
    assert_eq!(output.status.code(), Some(exit), "{command:?}: {said}");
    for text in texts {
        assert!(said.contains(text), "{command:?}: {text:?} is not in {said}");
    }
    assert!(output.stdout.is_empty(), "{command:?}");
    Ok(())
}

/// Catches a faulty file or value for which the message does not name the file, the option or the value.
#[test]
fn wrong_files_and_values_are_refused_by_name() -> Outcome {
    let folder = tempfile::tempdir()?;
    let page = folder.path().join("page.md");
    std::fs::write(&page, "# A page\n")?;
    let (page, absent) = (text(&page), folder.path().join("absent"));
    let (absent, nowhere) = (text(&absent), absent.join("file"));
    let nowhere = text(&nowhere);
    for command in ["tradeoff", "planarity"] {
        refused(&[command, page], 1, &[page, "not JSON (", "expected a scene file, hullcast.scene.v1"])?;
        refused(&[command, absent], 1, &[absent, "cannot be read: No such file"])?;
    }
    let few = ["tradeoff", "--pairs", "1"];
    refused(&[&few[..], &["--ask", nowhere]].concat(), 1, &["--ask", nowhere, "No such file"])?;
    refused(&[&few[..], &["--peer", absent]].concat(), 1, &["--peer", absent, "cannot be read"])?;
    refused(&[&few[..], &["--peer", page]].concat(), 1, &["--peer", page, "as JSON"])?;
    refused(&["planarity", "--orientations", "1", "--out", nowhere], 1, &["--out", nowhere, "No such file"])?;
    for (command, option) in [("tradeoff", "--pairs"), ("planarity", "--orientations")] {
        for value in ["0", "-1", "1.5", "4294967296", "many", ""] {
            refused(&[command, &format!("{option}={value}")], 2, &[option, &format!("'{value}'")])?;
        }
    }
    Ok(())
}

/// Catches a scene with an unusable pose that is measured without its pairs.
#[test]
fn unusable_poses_are_counted_and_fail() -> Outcome {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("scene.json");
    let scene = r#"{"format": "hullcast.scene.v1", "name": "two", "margin": 0.5,
        "hulls": [{"vertices": [[0,0,0],[1,0,0],[0,1,0],[0,0,1]]}],
        "bodies": [{"hull": 0, "position": [0,0,0], "rotation": [0,0,0,1]},
                   {"hull": 0, "position": [0,0,0.5], "rotation": [0,0,0,0]}],
        "pairs": [[0,1],[0,0]]}"#;
    std::fs::write(&path, scene)?;
    refused(&["tradeoff", "--pairs", "1", text(&path)], 1, &["configuration 0", "1 of 2 bodies (bodies 1)"])
}

/// Catches a chart that lacks settings, recommendations or other libraries, a coordinate that a
/// logarithmic axis cannot show, and a table with other rows than the chart.
#[test]
fn a_study_writes_its_table_and_the_points_of_its_chart() -> Outcome {
    const SETTINGS: usize = 3888;
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("study");
    let asked = folder.path().join("pairs.json");
    let scene = panda();
    let study = ["tradeoff", text(&scene), "--pairs", "2"];
    let output = lab(&[&study[..], &["--ask", text(&asked)]].concat())?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let asked: Value = serde_json::from_slice(&std::fs::read(&asked)?)?;
    let pairs = asked["cells"][0]["pairs"].as_array().ok_or("no pairs")?;
    let contact = serde_json::json!({ "normal": [0, 0, 1], "separation": -0.001, "points": [[0, 0, 0]] });
    let answer = serde_json::json!({ "nanoseconds": 5000, "contact": contact, "nudged": contact });
    let cell = serde_json::json!({ "name": asked["cells"][0]["name"], "pairs": vec![answer; pairs.len()] });
    let peer = folder.path().join("peer.json");
    std::fs::write(&peer, serde_json::json!({ "name": "another 1.0", "cells": [cell] }).to_string())?;

    let output = lab(&[&study[..], &["--peer", text(&peer), "--out", text(&out)]].concat())?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let said = String::from_utf8(output.stdout)?;
    assert!(said.contains("exact: growth scale") && said.contains("\nanother 1.0 "), "{said}");
    // One row for the scene and one for the pool of all scenes.
    let table = std::fs::read_to_string(out.with_extension("csv"))?;
    assert_eq!(table.lines().count(), 1 + 2 * (SETTINGS + 1));

    let chart: Value = serde_json::from_slice(&std::fs::read(out.with_extension("json"))?)?;
    let panels = chart["panels"].as_array().ok_or("no panels")?;
    assert_eq!(panels.len(), 3);
    for panel in panels {
        let list = |name: &str| panel[name].as_array().cloned().unwrap_or_default();
        let (settings, front) = (list("settings"), list("front"));
        assert_eq!(settings.len(), SETTINGS);
        assert!(!front.is_empty() && front.iter().all(|point| settings.contains(point)));
        assert_eq!(list("others")[0]["name"], "another 1.0");
        let advised = list("advised");
        assert!(!advised.is_empty() && advised.iter().all(|named| settings.contains(&named["at"])));
        let named = advised.iter().chain(&list("others")).map(|named| named["at"].clone()).collect();
        for point in [settings, named].concat() {
            let coordinates = [0, 1].map(|k| point[k].as_f64().unwrap_or(f64::NAN));
            assert!(coordinates.iter().all(|&x| x > 0.0 && x.is_finite()), "{coordinates:?}");
        }
    }
    Ok(())
}

/// Catches a table without some of the groups, roundings or planarities, and the hulls of a scene that are
/// not measured.
#[test]
fn planarity_measures_every_group_with_every_rounding() -> Outcome {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("planarity.csv");
    let scene = folder.path().join("scene.json");
    let cube: Vec<[i32; 3]> = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2]).collect();
    let one = serde_json::json!({ "format": "hullcast.scene.v1", "name": "cubes", "bodies": [], "pairs": [],
        "hulls": [{ "vertices": cube }] });
    std::fs::write(&scene, one.to_string())?;
    let output = lab(&["planarity", text(&scene), "--orientations", "1", "--out", text(&out)])?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let table = std::fs::read_to_string(&out)?;
    let [groups, roundings, planarities] = [7, 5, 11];
    assert_eq!(table.lines().count(), 1 + groups * roundings * planarities);
    // A cube whose coordinates are not rounded keeps its whole patch.
    assert!(table.contains("\ncubes,unrounded,1e-3,1,1.00000,1.00000,"), "{table}");
    let said = String::from_utf8(output.stdout)?;
    assert!(
        said.starts_with("Each shape stands on its largest face") && said.contains("cubes, 4 decimals"),
        "{said}"
    );
    Ok(())
}

/// Runs the command with an output that nobody reads, as in `lab planarity | head`. Catches a panic after the
/// whole measurement.
#[test]
fn a_reader_that_leaves_is_no_failure() -> Outcome {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("planarity.csv");
    let (reader, writer) = std::io::pipe()?;
    drop(reader);
    let output = Command::new(env!("CARGO_BIN_EXE_lab"))
        .args(["planarity", "--orientations", "1", "--out", text(&out)])
        .stdout(writer)
        .output()?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(out.is_file());
    Ok(())
}

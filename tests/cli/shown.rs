//! The output of a query: the table, the JSON, configurations by name.

use serde_json::Value;

use super::{Outcome, Server, printed, scenes, scratch, text};

fn lines(arguments: &[&str]) -> Result<Vec<String>, Box<dyn std::error::Error>> {
    Ok(String::from_utf8(printed(arguments)?)?.lines().map(str::to_owned).collect())
}

/// Catches numbers with sixteen digits, negative zeros, a count of points that were not
/// requested, and columns that are not aligned with their headings.
#[test]
fn the_table_is_for_people() -> Outcome {
    let panda = scenes().join("panda.json");
    let table = lines(&["query", text(&panda), "--frame", "grasp"])?;
    assert!(table.iter().all(|line| !line.contains("-0.0000 ") && line.len() < 140), "{table:#?}");
    let (head, rest) = table.split_first().ok_or("no table")?;
    let (sums, rows) = rest.split_last().ok_or("no sums")?;
    assert_eq!(rows.len(), 13);
    let place = |heading: &str| head.find(heading).map(|at| at + heading.len());
    for row in rows {
        for heading in ["alpha", "bracket", "separation", "normal", "points", "deepest"] {
            let end = place(heading).ok_or("no heading")?;
            let after = row.as_bytes().get(end).copied().unwrap_or(b' ');
            assert!(row.as_bytes()[end - 1] != b' ' && after == b' ', "{heading} in {row}");
        }
    }
    assert!(rows[0].contains("0.998377 ") && rows[0].contains("-0.0001325"), "{}", rows[0]);
    assert!(
        sums.starts_with(
            "Panda over a table, grasp: 81 pairs, 13 in contact, 68 separated; 84 contact points"
        ),
        "{sums}"
    );
    assert_eq!(lines(&["query", text(&panda), "--frame", "grasp", "--all"])?.len(), 83);
    let alone = lines(&["query", text(&panda), "--frame", "grasp", "--outputs", "OUTCOME"])?;
    let words: Vec<&str> = alone[1].split_whitespace().collect();
    assert_eq!(words[words.len() - 7..], ["CONTACT", "-", "-", "-", "-", "-", "-"]);
    assert!(!alone.last().ok_or("no sums")?.contains("contact point"));
    Ok(())
}

/// Catches "1 pairs" and "1 points", and headings without rows.
#[test]
fn one_is_singular() -> Outcome {
    let path = scratch("one")?.join("scene.json");
    let scene = |height: f64| {
        format!(
            r#"{{"format": "hullcast.scene.v1", "name": "two",
            "hulls": [{{"vertices": [[0,0,0],[1,0,0],[0,1,0],[0.2,0.2,1]]}}, {{"vertices": [[0,0,0],[1,0,1],[0,1,1],[0,0,1]]}}],
            "bodies": [{{"hull": 0, "position": [0,0,0], "rotation": [0,0,0,1]}},
                       {{"hull": 1, "position": [0.2,0.2,{height}], "rotation": [0,0,0,1]}}],
            "pairs": [[0,1]]}}"#
        )
    };
    std::fs::write(&path, scene(0.99))?;
    let table = lines(&["query", text(&path)])?;
    assert_eq!(
        table.last().map(String::as_str),
        Some("two: 1 pair, 1 in contact, 0 separated; 1 contact point")
    );
    std::fs::write(&path, scene(2.0))?;
    let table = lines(&["query", text(&path)])?;
    let expected =
        "two: 1 pair, 0 in contact, 1 separated; 0 contact points (--all lists the separated pairs too)";
    assert_eq!(table, [expected]);
    Ok(())
}

/// Catches a configuration that is not found by its name.
#[test]
fn a_frame_is_found_by_name_and_by_number() -> Outcome {
    let panda = scenes().join("panda.json");
    let file: Value = serde_json::from_slice(&std::fs::read(&panda)?)?;
    let ask = |frame: &[&str]| printed(&[&["query", text(&panda), "--json"], frame].concat());
    let mut answers = std::collections::BTreeSet::new();
    for (number, frame) in file["frames"].as_array().ok_or("no frames")?.iter().enumerate() {
        let name = frame["name"].as_str().ok_or("no name")?;
        let answer = ask(&["--frame", name])?;
        assert_eq!(answer, ask(&["--frame", &number.to_string()])?);
        answers.insert(answer);
    }
    assert_eq!(answers.len(), 6, "each configuration has an answer of its own");
    assert_eq!(ask(&[])?, ask(&["--frame", "0"])?);
    Ok(())
}

/// Catches a column of the output DIAGNOSTICS that is missing in the JSON.
#[test]
fn the_kept_area_is_in_the_json() -> Outcome {
    let folder = scratch("kept")?;
    let server = Server::start(&folder.join("store"))?;
    let panda = scenes().join("panda.json");
    for remote in [&[][..], &["--remote", &server.address]] {
        let ask = ["query", text(&panda), "--json", "--outputs", "points,diagnostics", "--max-points", "3"];
        let answer: Value = serde_json::from_slice(&printed(&[&ask[..], remote].concat())?)?;
        let pairs = answer["pairs"].as_array().ok_or("no pairs")?;
        let areas: Vec<f64> = pairs.iter().filter_map(|pair| pair["kept_area"].as_f64()).collect();
        assert_eq!(areas.len(), pairs.len());
        assert!(areas.iter().any(|area| (0.1..0.99).contains(area)), "{areas:?}");
    }
    Ok(())
}

//! Lets parry3d answer the pairs of `lab tradeoff --ask`, so that `lab tradeoff` can judge the answers.
//!
//! `cargo run --release --bin peer -- PAIRS FOLDER` writes FOLDER/parry3d.json and
//! FOLDER/parry3d-f64.json. The time of a pair is that of the fastest of three calls without a warm
//! start, in this process, with shapes and poses prepared.

use std::path::{Path, PathBuf};

use hullcast_benches::parry::{double, single};
use hullcast_benches::peer_files::{
    AnsweredCell, PeerAnswer, PeerAnswers, QuestionCell, QuestionPair, Questions,
};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1).map(PathBuf::from);
    let (Some(pairs), Some(folder)) = (arguments.next(), arguments.next()) else {
        return Err("which pairs, and where to?".into());
    };
    let questions: Questions = serde_json::from_slice(&std::fs::read(pairs)?)?;
    std::fs::create_dir_all(&folder)?;
    write(&folder, "parry3d", "parry3d 0.31", &questions, |cell| {
        let hulls = single::built(&cell.hulls)?;
        Some(cell.pairs.iter().map(|pair: &QuestionPair| single::answer(&hulls, pair, cell.margin)).collect())
    })?;
    write(&folder, "parry3d-f64", "parry3d-f64 0.31", &questions, |cell| {
        let hulls = double::built(&cell.hulls)?;
        Some(cell.pairs.iter().map(|pair: &QuestionPair| double::answer(&hulls, pair, cell.margin)).collect())
    })
}

fn write(
    folder: &Path,
    file: &str,
    name: &str,
    questions: &Questions,
    answers: impl Fn(&QuestionCell) -> Option<Vec<PeerAnswer>>,
) -> Result<(), Failure> {
    let mut cells = Vec::new();
    for cell in &questions.cells {
        let pairs = answers(cell).ok_or_else(|| format!("{name} refuses a hull of {}", cell.name))?;
        cells.push(AnsweredCell { name: cell.name.clone(), pairs });
    }
    let text = serde_json::to_string(&PeerAnswers { name: name.into(), cells })?;
    Ok(std::fs::write(folder.join(file).with_extension("json"), text)?)
}

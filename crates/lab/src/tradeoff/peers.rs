//! Other libraries on the same pairs: the questions for them, and their answers.
//!
//! The other libraries run in programs of their own (`benches`, `client/examples`). Their answers are
//! judged in the same way as ours.

use std::path::Path;

use super::cases::{Case, Cell, HullPose};
use super::peer_files::{PeerAnswer, PeerAnswers, PeerContact, QuestionCell, QuestionPair, Questions};
use crate::Error;
use glam::DVec3;

impl PeerContact {
    /// The contact points.
    pub(super) fn positions(&self) -> Vec<DVec3> {
        self.points.iter().map(|&p| DVec3::from_array(p)).collect()
    }
}

/// Writes the questions for other libraries.
///
/// # Errors
/// The file cannot be written.
pub(super) fn ask(cells: &[Cell], path: &Path) -> Result<(), Error> {
    let pose = |at: &HullPose| {
        let ([x, y, z], [i, j, k, w]) = (at.position.to_array(), at.rotation.to_array());
        [x, y, z, i, j, k, w]
    };
    let pair = |case: &Case| QuestionPair {
        hulls: case.hulls,
        a: pose(&case.a),
        b: pose(&case.b),
        nudged: pose(&case.nudged),
    };
    let cells = cells.iter().map(|cell| QuestionCell {
        name: cell.name.clone(),
        margin: cell.margin,
        hulls: cell.hulls.clone(),
        pairs: cell.cases.iter().map(pair).collect(),
    });
    let text = serde_json::to_vec(&Questions { cells: cells.collect() })?;
    std::fs::write(path, text).map_err(|e| format!("--ask {}: {e}", path.display()).into())
}

impl PeerAnswers {
    /// Reads the answers of another library.
    ///
    /// # Errors
    /// The file is not valid, or it answers other pairs than those of `cells`.
    pub(super) fn read(path: &Path, cells: &[Cell]) -> Result<Self, Error> {
        let at = |why: &dyn std::fmt::Display| Error::from(format!("--peer {}: {why}", path.display()));
        let text = std::fs::read(path).map_err(|e| at(&format!("cannot be read: {e}")))?;
        let expected = "expected the answers to the pairs that --ask writes, as JSON";
        let peer: Self = serde_json::from_slice(&text).map_err(|e| at(&format!("{expected} ({e})")))?;
        let asked = cells.iter().map(|cell| (cell.name.as_str(), cell.cases.len()));
        let answered = peer.cells.iter().map(|cell| (cell.name.as_str(), cell.pairs.len()));
        if asked.eq(answered) {
            Ok(peer)
        } else {
            Err(at(&"answers other pairs than these; ask again with the same scenes and --pairs"))
        }
    }

    /// The answers for a cell, by its index.
    pub(super) fn answers(&self, cell: usize) -> &[PeerAnswer] {
        &self.cells[cell].pairs
    }
}

#[cfg(test)]
mod tests {
    use super::super::cases;
    use super::*;

    /// A file for fewer pairs or for another cell must be refused, and a file for these pairs must be read as
    /// it was written. Catches answers that are compared with the true answers of other pairs.
    #[test]
    fn answers_belong_to_their_pairs() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("peer.json");
        let cells = cases::generated(2).unwrap();
        ask(&cells, &path).unwrap();
        let asked: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        let case = &cells[1].cases[1];
        assert_eq!(asked["cells"][1]["pairs"][1]["b"][2], case.b.position.z);
        assert_eq!(asked["cells"][1]["pairs"][1]["nudged"][6], case.nudged.rotation.w);
        let contact = serde_json::json!({ "normal": [0, 0, 1], "separation": -0.5, "points": [[1, 2, 3]] });
        let answer = serde_json::json!({ "nanoseconds": 7, "contact": contact, "nudged": null });
        let written = |count: usize, name: &str| {
            let of = |cell: &Cell| serde_json::json!({ "name": format!("{}{name}", cell.name), "pairs": vec![answer.clone(); count] });
            let all: Vec<_> = cells.iter().map(of).collect();
            std::fs::write(&path, serde_json::json!({ "name": "peer", "cells": all }).to_string()).unwrap();
            PeerAnswers::read(&path, &cells)
        };
        let peer = written(2, "").unwrap();
        let [_, second] = peer.answers(3) else { panic!("two") };
        assert_eq!(second.contact.as_ref().unwrap().positions(), [DVec3::new(1.0, 2.0, 3.0)]);
        assert!(second.nudged.is_none());
        assert!(written(1, "").is_err() && written(2, "x").is_err());
    }
}

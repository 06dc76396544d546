//! Other libraries on the same pairs: what they are asked, and what they answer.
//!
//! They run in programs of their own (`benches`, `client/examples`); their answers are judged
//! as ours are.

use std::path::Path;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::super::{Error, exit::Exit};
use super::cases::{Case, Cell, Placement};

/// What a peer is asked: every cell's hulls and pairs.
#[derive(Debug, Serialize)]
struct Asked<'a> {
    cells: Vec<AskedCell<'a>>,
}

#[derive(Debug, Serialize)]
struct AskedCell<'a> {
    name: &'a str,
    /// Contacts are wanted within it.
    margin: f64,
    hulls: &'a [Vec<[f64; 3]>],
    pairs: Vec<AskedPair>,
}

/// Poses are a position and a quaternion x, y, z, w.
#[derive(Debug, Serialize)]
struct AskedPair {
    hulls: [usize; 2],
    a: [f64; 7],
    b: [f64; 7],
    /// B moved by next to nothing.
    nudged: [f64; 7],
}

/// What a peer answers to all of it.
#[derive(Debug, Deserialize)]
pub(super) struct Peer {
    /// With its version.
    pub(super) name: String,
    cells: Vec<AnsweredCell>,
}

#[derive(Debug, Deserialize)]
struct AnsweredCell {
    name: String,
    pairs: Vec<Answer>,
}

/// To one pair.
#[derive(Debug, Deserialize)]
pub(super) struct Answer {
    /// The fastest of as many calls as are made of ours.
    pub(super) nanoseconds: f64,
    /// None: no contact within the margin.
    pub(super) contact: Option<Contact>,
    /// With B nudged.
    pub(super) nudged: Option<Contact>,
}

/// World frame.
#[derive(Debug, Deserialize)]
pub(super) struct Contact {
    /// Unit, from A to B.
    pub(super) normal: [f64; 3],
    /// Signed; negative: overlapping.
    pub(super) separation: f64,
    /// Midway between the two hulls, in any order.
    points: Vec<[f64; 3]>,
}

impl Contact {
    #[cfg(test)]
    pub(super) fn new(normal: [f64; 3], separation: f64, points: Vec<[f64; 3]>) -> Self {
        Self { normal, separation, points }
    }

    pub(super) fn points(&self) -> Vec<DVec3> {
        self.points.iter().map(|&p| DVec3::from_array(p)).collect()
    }
}

/// Writes what peers are asked.
///
/// # Errors
/// The file cannot be written.
pub(super) fn ask(cells: &[Cell], path: &Path) -> Result<(), Error> {
    let pose = |at: &Placement| {
        let ([x, y, z], [i, j, k, w]) = (at.position.to_array(), at.rotation.to_array());
        [x, y, z, i, j, k, w]
    };
    let pair = |case: &Case| AskedPair {
        hulls: case.hulls,
        a: pose(&case.a),
        b: pose(&case.b),
        nudged: pose(&case.nudged),
    };
    let cells = cells.iter().map(|cell| AskedCell {
        name: &cell.name,
        margin: cell.margin,
        hulls: &cell.hulls,
        pairs: cell.cases.iter().map(pair).collect(),
    });
    let text = serde_json::to_vec(&Asked { cells: cells.collect() })?;
    std::fs::write(path, text).map_err(|e| format!("--ask {}: {e}", path.display()).into())
}

impl Peer {
    /// Reads a peer's answers.
    ///
    /// # Errors
    /// The file is faulty, or answers other pairs than those of `cells`.
    pub(super) fn read(path: &Path, cells: &[Cell]) -> Result<Self, Error> {
        let at = |why: &dyn std::fmt::Display| Exit::Input.error(format!("--peer {}: {why}", path.display()));
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

    /// Of a cell, by its place among all.
    pub(super) fn answers(&self, cell: usize) -> &[Answer] {
        &self.cells[cell].pairs
    }
}

#[cfg(test)]
mod tests {
    use super::super::cases;
    use super::*;

    /// Catches answers that are held against the truth of other pairs: a file for fewer pairs,
    /// or for another cell, is refused; one for these is read as it was written.
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
            Peer::read(&path, &cells)
        };
        let peer = written(2, "").unwrap();
        let [_, second] = peer.answers(3) else { panic!("two") };
        assert_eq!(second.contact.as_ref().unwrap().points(), [DVec3::new(1.0, 2.0, 3.0)]);
        assert!(second.nudged.is_none());
        assert!(written(1, "").is_err() && written(2, "x").is_err());
    }
}

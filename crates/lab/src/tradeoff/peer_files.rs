//! The files that `lab tradeoff` exchanges with other libraries: the pairs it asks about, and the answers.
//!
//! The package in `benches/`, which is not part of this workspace, compiles this file too, so that both sides
//! have one format.

use serde::{Deserialize, Serialize};

/// The questions for another library.
#[derive(Debug, Deserialize, Serialize)]
pub struct Questions {
    /// The pairs, grouped by kind.
    pub cells: Vec<QuestionCell>,
}

/// Pairs of one kind.
#[derive(Debug, Deserialize, Serialize)]
pub struct QuestionCell {
    /// Name of the kind, for display.
    pub name: String,
    /// Contacts are wanted for hulls within this distance.
    pub margin: f64,
    /// Points of each hull, in the hull's own frame.
    pub hulls: Vec<Vec<[f64; 3]>>,
    /// Pairs of those hulls.
    pub pairs: Vec<QuestionPair>,
}

/// A pair with its poses. A pose is a position and a unit quaternion x, y, z, w.
#[derive(Debug, Deserialize, Serialize)]
pub struct QuestionPair {
    /// Indices into the cell's hulls.
    pub hulls: [usize; 2],
    /// Pose of the first hull.
    pub a: [f64; 7],
    /// Pose of the second hull.
    pub b: [f64; 7],
    /// Pose of the second hull after a tiny movement.
    pub nudged: [f64; 7],
}

/// The answers of another library to all questions.
#[derive(Debug, Deserialize, Serialize)]
pub struct PeerAnswers {
    /// The library's name and version.
    pub name: String,
    /// The answers to each cell of the questions, in the same order.
    pub cells: Vec<AnsweredCell>,
}

/// The answers for pairs of one kind.
#[derive(Debug, Deserialize, Serialize)]
pub struct AnsweredCell {
    /// Name of the kind.
    pub name: String,
    /// The answer for each pair.
    pub pairs: Vec<PeerAnswer>,
}

/// The answer for one pair.
#[derive(Debug, Deserialize, Serialize)]
pub struct PeerAnswer {
    /// Duration of the fastest of three calls. hullcast is called equally often.
    pub nanoseconds: f64,
    /// The contact, or `None` if there is no contact within the margin.
    pub contact: Option<PeerContact>,
    /// The contact with the second hull at its nudged pose.
    pub nudged: Option<PeerContact>,
}

/// A contact, world frame.
#[derive(Debug, Deserialize, Serialize)]
pub struct PeerContact {
    /// Unit normal from A to B.
    pub normal: [f64; 3],
    /// Separation of the deepest point; negative if overlapping.
    pub separation: f64,
    /// Contact points midway between the hulls, in any order.
    pub points: Vec<[f64; 3]>,
}

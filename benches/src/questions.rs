//! The files that `lab tradeoff` exchanges with other libraries: the pairs it asks about, and
//! the answers.

use serde::{Deserialize, Serialize};

/// A file of questions.
#[derive(Debug, Deserialize)]
pub struct Questions {
    /// The pairs, grouped by kind.
    pub cells: Vec<QuestionCell>,
}

/// Pairs of one kind.
#[derive(Debug, Deserialize)]
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
#[derive(Debug, Deserialize)]
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

/// The answer for one pair.
#[derive(Debug, Serialize)]
pub struct Answer {
    /// Duration of the fastest of three calls.
    pub nanoseconds: f64,
    /// The contact, or `None` if there is no contact within the margin.
    pub contact: Option<Contact>,
    /// The contact with the second hull at its nudged pose.
    pub nudged: Option<Contact>,
}

/// A contact, world frame.
#[derive(Debug, Serialize)]
pub struct Contact {
    /// Unit normal from A to B.
    pub normal: [f64; 3],
    /// Separation of the deepest point; negative if overlapping.
    pub separation: f64,
    /// Contact points, each midway between the hulls.
    pub points: Vec<[f64; 3]>,
}

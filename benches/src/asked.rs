//! Files of `hullcast tradeoff`: the pairs that it asks others about, and their answers.

use serde::{Deserialize, Serialize};

/// All of them.
#[derive(Debug, Deserialize)]
pub struct Asked {
    /// Of one kind each.
    pub cells: Vec<AskedCell>,
}

/// Pairs of one kind.
#[derive(Debug, Deserialize)]
pub struct AskedCell {
    /// For people.
    pub name: String,
    /// Contacts are wanted within it.
    pub margin: f64,
    /// Each in its own frame.
    pub hulls: Vec<Vec<[f64; 3]>>,
    /// Of those hulls.
    pub pairs: Vec<AskedPair>,
}

/// Poses are a position and a unit quaternion x, y, z, w.
#[derive(Debug, Deserialize)]
pub struct AskedPair {
    /// Indices into the cell's hulls.
    pub hulls: [usize; 2],
    /// Of the first hull.
    pub a: [f64; 7],
    /// Of the second.
    pub b: [f64; 7],
    /// Of the second, moved by next to nothing.
    pub nudged: [f64; 7],
}

/// To one pair.
#[derive(Debug, Serialize)]
pub struct Answer {
    /// The fastest of three calls.
    pub nanoseconds: f64,
    /// None: no contact within the margin.
    pub contact: Option<Contact>,
    /// With B nudged.
    pub nudged: Option<Contact>,
}

/// World frame.
#[derive(Debug, Serialize)]
pub struct Contact {
    /// Unit, from A to B.
    pub normal: [f64; 3],
    /// Of the deepest point; negative: overlapping.
    pub separation: f64,
    /// Midway between the hulls.
    pub points: Vec<[f64; 3]>,
}

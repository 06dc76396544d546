//! The points of the chart of time against errors, as JSON. `client/examples/tradeoff.py` draws them.

use serde::Serialize;

/// Panels side by side, all with the same horizontal axis.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Chart {
    /// The label of the horizontal axis.
    pub(super) x: &'static str,
    pub(super) panels: Vec<Panel>,
}

/// A panel for one measure of error. Both axes are logarithmic, and all coordinates are positive.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Panel {
    /// The measure on the vertical axis.
    pub(super) title: &'static str,
    /// All settings.
    pub(super) settings: Vec<[f64; 2]>,
    /// The settings that no other one beats, in ascending order of time.
    pub(super) front: Vec<[f64; 2]>,
    /// The recommended settings, with the needs that they suit.
    pub(super) advised: Vec<LabelledPoint>,
    /// Other libraries.
    pub(super) others: Vec<LabelledPoint>,
}

/// A point with a label.
#[derive(Clone, Debug, Serialize)]
pub(super) struct LabelledPoint {
    pub(super) name: String,
    pub(super) at: [f64; 2],
}

//! The faults of a scene.

use hullcast_contact::Stopped;
use thiserror::Error;

/// A fault of a scene.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{field}{}: {message}", .index.map(|index| format!("[{index}]")).unwrap_or_default())]
pub struct SceneFault {
    /// The kind of fault.
    pub kind: FaultKind,
    /// The field at fault; a dotted path for a field of the accuracy.
    pub field: &'static str,
    /// The index of the element at fault, if a single element is.
    pub index: Option<usize>,
    /// The value that was found and the values that are allowed.
    pub message: String,
}

/// The kinds of faults of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultKind {
    /// A column does not have one entry, or as many as are needed, for each body or pair.
    Length,
    /// An index is too large.
    Index,
    /// A number is outside its range.
    Value,
}

/// The reason why a scene cannot be computed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SceneError {
    /// The scene has a fault.
    #[error(transparent)]
    Fault(SceneFault),
    /// The check was stopped.
    #[error("{}", Stopped)]
    Stopped,
}

impl SceneFault {
    pub(super) fn new(kind: FaultKind, field: &'static str, message: String) -> Self {
        Self { kind, field, index: None, message }
    }

    /// The fault of a number outside its range.
    pub fn out_of_range(field: &'static str, value: f64, rule: &str) -> Self {
        Self::new(FaultKind::Value, field, format!("got {value}, must be {rule}"))
    }
}

impl From<SceneFault> for SceneError {
    fn from(fault: SceneFault) -> Self {
        Self::Fault(fault)
    }
}

impl From<Stopped> for SceneError {
    fn from(_: Stopped) -> Self {
        Self::Stopped
    }
}

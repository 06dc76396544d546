//! The only modules that know both protobuf and the types of `hullcast-batch`. They convert requests, columns
//! of answers, and errors.

mod columns;
mod decode;
mod fields;
mod find;
mod hulls;
mod info;
mod request;
mod status;
mod steps;

pub(super) use columns::take_columns;
pub use columns::{response, response_columns};
#[cfg(feature = "testing")]
pub use decode::{CONSTANT_BYTES, decoded_bytes};
pub(super) use decode::{DecodeRequest, DecodeResources};
pub(super) use find::find;
pub(super) use hulls::{
    CheckedDefinition, RecordParts, hull_error, not_found, page, record, record_bytes, register_result,
    repeated,
};
pub(super) use info::server_info;
pub(super) use request::stoppable_scene;
pub use request::{CheckedScene, scene};
pub use status::DOMAIN;
pub(super) use status::complete;
pub(super) use steps::{Before, CheckedStep, StepStart, step};

/// The memory of a request's hull besides its points, or of an id, for the fuzz target of decoding.
#[cfg(feature = "testing")]
pub const HULL_BYTES: usize = super::sizes::HULL_BYTES;

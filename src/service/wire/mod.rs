//! The only files that know both protobuf and the domain's types: requests
//! in, columns out, errors to statuses.

mod columns;
mod find;
mod hulls;
mod info;
mod request;
mod status;

pub use columns::{Columns, Invalid, response};
pub(super) use find::find;
pub(super) use hulls::{
    Definition, Parts, definitions, hull_error, ids, not_found, page, page_token, parts, record,
    register_result,
};
pub(super) use info::server_info;
pub use request::{Poses, Scene, Setting, inherited, scene};
pub use status::DOMAIN;
pub(super) use status::complete;

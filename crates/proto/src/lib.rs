//! The wire contract of [hullcast](https://github.com/hullcast/hullcast), generated from `proto/hullcast/v1`:
//! messages, the stubs of clients and servers, and the descriptor set.
//!
//! [`Codec`] reads and writes messages with their numeric columns in bulk. The server's stubs receive
//! requests encoded ([`Encoded`]), so that the server can bound the size of a request before it decodes
//! it.

#![allow(missing_docs, unreachable_pub, clippy::all, clippy::pedantic)]

#[doc(hidden)]
pub mod bulk;
mod codec;

pub use codec::{Codec, Encoded, ServerCodec};

tonic::include_proto!("hullcast.v1");
// The servers' side of the services, whose methods receive encoded requests.
tonic::include_proto!("hullcast.v1.ContactService");
tonic::include_proto!("hullcast.v1.HullService");
tonic::include_proto!("hullcast.v1.ServerService");

/// Names the columns of messages, as in `proto/`. A message without columns needs only
/// its name.
macro_rules! columnar {
    ($($message:ident { $($kind:ident $field:ident = $tag:literal;)* })*) => {
        $(impl bulk::Columnar for $message {
            const COLUMNS: &'static [u32] = &[$($tag),*];

            fn column(&mut self, tag: u32) -> Option<bulk::Column<'_>> {
                match tag {
                    $($tag => Some(bulk::Column::$kind(&mut self.$field)),)*
                    _ => None,
                }
            }
        })*

        /// Each message that has columns, by its name in the contract.
        #[cfg(test)]
        fn columnar_messages() -> Vec<(&'static str, &'static [u32])> {
            let all = [$((stringify!($message), <$message as bulk::Columnar>::COLUMNS)),*];
            all.into_iter().filter(|(_, columns)| !columns.is_empty()).collect()
        }
    };
}

columnar! {
    QueryContactsRequest {
        Fixed32s body_hulls = 4;
        Doubles positions = 5;
        Doubles rotations = 6;
        Fixed32s pairs = 7;
        Fixed32s worlds = 8;
        Fixed32s groups = 9;
        Fixed32s ignored_groups = 10;
        Fixed32s warm_starts = 14;
    }
    QueryContactsResponse {
        Doubles alphas = 4;
        Doubles alpha_lowers = 5;
        Doubles alpha_uppers = 6;
        Doubles separations = 7;
        Doubles normals = 8;
        Fixed32s point_counts = 9;
        Doubles witness_as = 10;
        Doubles distances = 11;
        Doubles witness_bs = 12;
        Fixed32s feature_indices = 14;
        Fixed32s point_ids = 15;
        Fixed32s bases = 16;
        Fixed32s pairs = 17;
        Fixed32s missing_hulls = 18;
        Fixed32s invalid_bodies = 19;
        Fixed32s iterations = 20;
        Fixed32s support_calls = 21;
        Doubles kept_areas = 22;
    }
    RegisterHullsRequest {}
    RegisterHullsResponse {}
    GetHullsRequest {}
    GetHullsResponse {}
    HasHullsRequest {}
    HasHullsResponse {}
    ListHullsRequest {}
    ListHullsResponse {}
    DeleteHullsRequest {}
    DeleteHullsResponse {}
    GetServerInfoRequest {}
    GetServerInfoResponse {}
}

/// The contract's descriptor set, for reflection and for breaking-change checks.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/hullcast.v1.binpb"));

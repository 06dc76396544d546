//! The wire contract of [hullcast](https://github.com/hullcast/hullcast), generated from `proto/hullcast/v1`:
//! messages, the stubs of clients and servers, and the descriptor set.
//!
//! [`Codec`] reads and writes messages with their numeric columns in bulk. The server's stubs receive
//! requests encoded ([`Encoded`]), so that the server can bound the size of a request before it decodes
//! it.

#![allow(missing_docs, unreachable_pub, clippy::all, clippy::pedantic)]

pub mod bulk;
mod codec;

pub use codec::{Codec, Encoded, ServerCodec};

tonic::include_proto!("hullcast.v1");
// The servers' side of the services, whose methods receive encoded requests.
tonic::include_proto!("hullcast.v1.ContactService");
tonic::include_proto!("hullcast.v1.HullService");
tonic::include_proto!("hullcast.v1.ServerService");

/// The version of the request fields that this contract has: `QueryContactsResponse.contract`. It rises
/// whenever a field is added that changes answers, because a server ignores the fields that it does not know.
pub const CONTRACT: u32 = 1;

/// The names of the methods: each is the method's path without the leading slash.
pub mod methods {
    include!(concat!(env!("OUT_DIR"), "/methods.rs"));
}

/// The tags of the fields of every message, for code that reads encoded messages field by field.
pub mod tags {
    include!(concat!(env!("OUT_DIR"), "/tags.rs"));
}

/// Names the columns of messages. The build script writes the call of this macro from the contract.
macro_rules! columnar {
    ($($message:ident { $($kind:ident $field:ident = $tag:literal;)* })*) => {
        $(impl bulk::Columnar for $message {
            const COLUMNS: &'static [u32] = &[$($tag),*];

            fn column(&mut self, tag: u32) -> Option<bulk::ColumnMut<'_>> {
                match tag {
                    $($tag => Some(bulk::ColumnMut::$kind(&mut self.$field)),)*
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

include!(concat!(env!("OUT_DIR"), "/columns.rs"));

/// The contract's descriptor set, for reflection and for breaking-change checks.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/hullcast.v1.binpb"));

//! A client of [hullcast](https://github.com/hullcast/hullcast), the service that caches convex hulls and
//! answers batches of contact queries over gRPC.
//!
//! [`Client`] is a connection. Its methods register hulls, query pairs and search a scene for pairs; a
//! [`Session`] steps the same pairs through a simulation. The messages are those of the contract
//! ([`proto`]): a request and an answer are columns, with one array per quantity. [`Scene`] builds a request,
//! and [`pairs`] reads an answer pair by pair.
//!
//! ```no_run
//! use hullcast_client::{Client, Error, Hull, Scene, pairs};
//!
//! # #[tokio::main]
//! # async fn main() -> Result<(), Error> {
//! let client = Client::connect("localhost:50051").await?;
//!
//! // A cube with edges of 1 m. Registering is idempotent: the id of a hull is the hash of its content.
//! let corner = |i: u8| [0, 1, 2].map(|axis| if i >> axis & 1 == 1 { 0.5 } else { -0.5 });
//! let cube = client.register(&[Hull::new((0..8).map(corner).collect::<Vec<_>>())]).await?[0];
//!
//! // Two bodies; the second rests on the first and overlaps it by 1 cm.
//! let upright = [0.0, 0.0, 0.0, 1.0];
//! let mut scene = Scene::new(0.005);
//! let below = scene.add_body(cube, [0.0, 0.0, 0.0], upright);
//! let above = scene.add_body(cube, [0.0, 0.0, 0.99], upright);
//!
//! // The contacts of the pairs that the caller lists.
//! scene.add_pair(below, above);
//! let answer = client.query(&scene.request).await?;
//! for pair in pairs(&answer) {
//!     println!("{:?}: separation {:?}, {} points", pair.outcome, pair.separation, pair.witness_as.len());
//! }
//!
//! // The same pairs, step after step: each step sends only the poses.
//! let mut session = client.session(scene.request.clone(), Vec::new());
//! for step in 0..10 {
//!     let height = 0.99 + 0.001 * f64::from(step);
//!     let answer = session.step(&[[0.0; 3], [0.0, 0.0, height]], &[upright; 2]).await?;
//!     println!("{height}: {:?}", answer.separations);
//! }
//!
//! // The pairs that the server finds.
//! scene.request.pairs.clear();
//! let mut search = client.find(&scene.request).await?;
//! while let Some(part) = search.next().await? {
//!     for pair in pairs(&part) {
//!         println!("bodies {:?} touch at {:?}", pair.bodies, pair.witness_as);
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! # Errors
//!
//! [`Error`] distinguishes what a caller can do: [`Error::Unreachable`] has the cause of a failed connection,
//! [`Error::Refused`] the server's code, reason and field, [`Error::HullsRefused`] the fault of each hull.
//! A server that is too busy, and a server that was lost, are called again by default ([`Builder::retries`]),
//! within the timeout ([`Builder::timeout`]). A fault of a single body or pair is no error: the pair has the
//! outcome INVALID.
//!
//! Every answer is checked before it is returned: it answers this request, its columns fit together and its
//! numbers are in range. An answer that fails a check is [`Error::Malformed`]. So code that reads columns by
//! the pairs of its request cannot index beyond their end.
//!
//! # Conventions
//!
//! Lengths are in the caller's unit, metres in the documentation. Frames are right-handed, and quaternions are
//! x, y, z, w. A pose maps the hull's own frame to the world. The contact normal is a unit vector in the world
//! frame, from A to B. Separations and distances are negative for overlapping hulls.
//!
//! The client needs a tokio runtime.

#![warn(unreachable_pub)]

mod address;
mod builder;
mod checked;
mod client;
mod columns;
mod contract;
mod error;
mod find;
mod hull;
mod matches;
mod pairs;
mod query;
mod raw;
mod reach;
mod registry;
mod scene;
mod session;
mod trust;

/// The examples of the guide are compiled as tests.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/rust.md")]
struct Guide;

pub use address::{Address, AddressError};
pub use builder::Builder;
pub use checked::Malformed;
pub use client::Client;
pub use columns::append;
pub use error::{Defect, Error, HullRefused, Refusal, Setting, SettingError};
pub use find::Search;
pub use hull::{Hull, HullId, NotAnId};
pub use hullcast_proto as proto;
pub use pairs::{Pair, pairs};
pub use reach::{Cause, Unreachable};
pub use registry::HullPart;
pub use scene::Scene;
pub use session::Session;

#[cfg(test)]
mod tests {
    use super::*;

    /// This test does not compile if a future of the client cannot be spawned on a runtime of several threads.
    #[test]
    fn futures_can_be_spawned() {
        fn is_send<T: Send>(_: T) {}
        fn check(client: &Client, session: &mut Session, search: &mut Search) {
            let request = proto::QueryContactsRequest::default();
            is_send(Client::connect(""));
            is_send(client.info());
            is_send(client.register(&[]));
            is_send(client.get(&[], &[]));
            is_send(client.query_registering(&request, &[]));
            is_send(client.find_all(&request));
            is_send(session.step(&[], &[]));
            is_send(search.next());
        }
        let _ = check;
    }
}

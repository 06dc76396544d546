//! The parts that all attacks share: a server as a process, an attacker's tools, a bystander, and the
//! assertions after each attack.

pub(crate) mod arena;
pub(crate) mod bystander;
pub(crate) mod dial;
pub(crate) mod http2;
pub(crate) mod latency;
pub(crate) mod server;
pub(crate) mod setup;
pub(crate) mod trial;

pub(crate) const QUERY: &str = "/hullcast.v1.ContactService/QueryContacts";
pub(crate) const FIND: &str = "/hullcast.v1.ContactService/FindContacts";
pub(crate) const STREAM: &str = "/hullcast.v1.ContactService/StreamContacts";
pub(crate) const REGISTER: &str = "/hullcast.v1.HullService/RegisterHulls";
pub(crate) const GET: &str = "/hullcast.v1.HullService/GetHulls";
pub(crate) const HAS: &str = "/hullcast.v1.HullService/HasHulls";
pub(crate) const INFO: &str = "/hullcast.v1.ServerService/GetServerInfo";
pub(crate) const CHECK: &str = "/grpc.health.v1.Health/Check";
pub(crate) const WATCH: &str = "/grpc.health.v1.Health/Watch";
pub(crate) const REFLECTION: &str = "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo";

/// Declares attacks. Each attack becomes two tests: one of a tenth of the size, which `make
/// test-abuse-short` runs, and one of the full size, which `make test-abuse` runs.
macro_rules! attacks {
    ($($(#[doc = $doc:literal])* $name:ident: $title:literal $(, $with:expr)? => $attack:path;)*) => { $(
        $(#[doc = $doc])*
        mod $name {
            #[allow(unused_imports, reason = "some attacks need no settings of their own")]
            use super::*;
            use crate::support::{setup::{Setup, Size}, trial::trial};

            fn setup(size: Size) -> Setup {
                let setup = Setup::new(size);
                $(let setup = ($with)(setup);)?
                setup
            }

            #[test]
            fn tenth() {
                trial($title, setup(Size::Tenth), $attack);
            }

            #[test]
            #[ignore = "takes long: make test-abuse runs it"]
            fn full() {
                trial($title, setup(Size::Full), $attack);
            }
        }
    )* };
}

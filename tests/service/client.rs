//! The Rust client (`crates/client`) with the real server; and with a server that lies, because the real one
//! does not.

mod calls;
mod connecting;
mod lies;
mod steps;

use hullcast::service::Reason;
use hullcast::store::HullDefinition;
use hullcast_client::{Builder, Client, Hull, HullId};

use super::support::TestServer;

/// The settings of a client of this server.
fn builder(server: &TestServer) -> Builder {
    Client::builder(server.address.as_str())
}

/// The same hull for the client.
fn hull(definition: &HullDefinition) -> Hull {
    let simplification = definition.simplification.map(|wanted| hullcast_client::proto::Simplification {
        max_vertices: wanted.max_vertices,
        max_deviation: wanted.max_deviation,
    });
    Hull {
        points: definition.points.clone(),
        contraction_point: definition.contraction_point,
        simplification,
        planarity: definition.planarity,
    }
}

fn hulls(definitions: &[HullDefinition]) -> Vec<Hull> {
    definitions.iter().map(hull).collect()
}

fn ids(hulls: &[Hull]) -> Vec<HullId> {
    hulls.iter().map(Hull::id).collect()
}

/// The client acts on some reasons of the server. Catches a reason that the server does not have, for example
/// because it was renamed.
#[test]
fn the_client_acts_on_reasons_of_the_server() {
    let sources = ["query", "registry", "session"].map(|name| {
        let path = format!("{}/crates/client/src/{name}.rs", env!("CARGO_MANIFEST_DIR"));
        std::fs::read_to_string(path).unwrap()
    });
    let known: Vec<&str> = Reason::ALL.iter().map(|reason| reason.name()).collect();
    let is_reason = |word: &&str| word.len() > 3 && word.bytes().all(|b| b.is_ascii_uppercase() || b == b'_');
    let acted_on: Vec<&str> =
        sources.iter().flat_map(|source| source.split('"').skip(1).step_by(2)).filter(is_reason).collect();
    for reason in &acted_on {
        assert!(known.contains(reason), "{reason}");
    }
    assert_eq!(acted_on.len(), 8, "{acted_on:?}");
}

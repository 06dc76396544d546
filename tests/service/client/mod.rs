//! The Rust client (`crates/client`) with the real server; and with a server that lies, because the real one
//! does not.

mod calls;
mod connecting;
mod lies;
mod steps;

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

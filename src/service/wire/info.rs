//! Describes the server.

use crate::{
    budget::{MemoryBudget, Part},
    proto,
    service::limits::Limits,
};

/// The server's version, limits and resources.
pub(in crate::service) fn server_info(
    limits: &Limits,
    threads: usize,
    memory: &MemoryBudget,
) -> proto::GetServerInfoResponse {
    let part = |&part: &Part| proto::MemoryPart {
        name: part.name().into(),
        bytes: memory.used_by(part),
        max_bytes: memory.cap(part).unwrap_or(0),
    };
    proto::GetServerInfoResponse {
        version: env!("CARGO_PKG_VERSION").into(),
        limits: Some(proto::Limits {
            max_message_bytes: limits.max_message_bytes as u64,
            max_pairs_per_request: limits.max_pairs_per_request,
            max_bodies_per_request: limits.max_bodies_per_request,
            max_hulls_per_request: limits.max_hulls_per_request,
            max_vertices_per_hull: limits.max_vertices_per_hull,
            max_pairs_in_flight: limits.max_pairs_in_flight.into(),
            cache_bytes: limits.cache_bytes,
            store_bytes: limits.store_bytes,
            max_streams_per_connection: limits.max_streams_per_connection,
            max_page_size: limits.max_page_size,
            cache_age_seconds: limits.cache_age_seconds,
            max_request_bytes_in_flight: limits.max_request_bytes_in_flight,
            max_deadline_seconds: limits.max_deadline_seconds,
            max_connections: limits.max_connections,
            max_stream_state_bytes: limits.max_stream_state_bytes,
            max_points_per_hull: limits.max_points_per_hull,
            max_memory_bytes: limits.max_memory_bytes,
        }),
        instruction_set: crate::contact::instruction_set().into(),
        compute_threads: threads as u32,
        memory_parts: Part::ALL.iter().map(part).collect(),
        contract: proto::CONTRACT,
    }
}

//! Hulls in and out.

use crate::{
    contact::{ConvexHull, HullError, Simplification},
    proto,
    service::{
        error::ServiceError,
        limits::Limits,
        wire::request::{at_most, hull_id},
    },
    store::{HullDefinition, HullId, StoredBlob},
};

/// A hull of a `RegisterHulls` request: its definition, or why this hull alone is refused.
pub(in crate::service) type Definition = Result<HullDefinition, proto::HullError>;

/// Checks a `RegisterHulls` request.
pub(in crate::service) fn definitions(
    request: proto::RegisterHullsRequest,
    limits: &Limits,
) -> Result<Vec<Definition>, ServiceError> {
    at_most(request.hulls.len(), limits.max_hulls_per_request, "TOO_MANY_HULLS", "hulls")?;
    Ok(request.hulls.into_iter().map(definition).collect())
}

fn definition(hull: proto::HullDefinition) -> Definition {
    let (points, rest) = hull.vertices.as_chunks::<3>();
    if !rest.is_empty() {
        return Err(malformed("vertices", hull.vertices.len(), "3 per point"));
    }
    let contraction_point = match *hull.contraction_point {
        [] => None,
        [x, y, z] => Some([x, y, z]),
        _ => return Err(malformed("contraction_point", hull.contraction_point.len(), "none or 3")),
    };
    let simplification = hull.simplification.map(|wanted| Simplification {
        max_vertices: wanted.max_vertices,
        max_deviation: wanted.max_deviation,
    });
    let planarity = hull.planarity;
    Ok(HullDefinition { points: points.to_vec(), contraction_point, simplification, planarity })
}

fn malformed(field: &str, found: usize, rule: &str) -> proto::HullError {
    proto::HullError {
        reason: "MALFORMED".into(),
        message: format!("{found} entries, expected {rule}"),
        field: field.into(),
        index: None,
    }
}

/// Why a hull was refused.
pub(in crate::service) fn hull_error(error: &HullError) -> proto::HullError {
    proto::HullError {
        reason: error.kind.reason().into(),
        message: error.detail.clone(),
        field: error.kind.field().into(),
        index: error.index.and_then(|index| u32::try_from(index).ok()),
    }
}

/// One result of `RegisterHulls`.
pub(in crate::service) fn register_result(
    result: Result<(HullId, &ConvexHull), proto::HullError>,
) -> proto::RegisterHullResult {
    use proto::register_hull_result::Result as Wire;
    let result = match result {
        Ok((id, hull)) => Wire::Hull(hull_info(id, hull)),
        Err(error) => Wire::Error(error),
    };
    proto::RegisterHullResult { result: Some(result) }
}

/// What is known of a hull, without its geometry.
fn hull_info(id: HullId, hull: &ConvexHull) -> proto::HullInfo {
    let inertia = hull.inertia();
    let (x, y, z) = (inertia.x_axis, inertia.y_axis, inertia.z_axis);
    proto::HullInfo {
        id: id.0.to_vec(),
        contraction_point: hull.contraction_point().to_array().to_vec(),
        vertex_count: hull.vertex_count() as u32,
        face_count: hull.face_count() as u32,
        edge_count: hull.edge_count() as u32,
        volume: hull.volume(),
        center_of_mass: hull.center_of_mass().to_array().to_vec(),
        inertia: vec![x.x, y.y, z.z, x.y, x.z, y.z],
        inradius: hull.inradius(),
        circumradius: hull.circumradius(),
        geometric_error: hull.geometric_error(),
        registered_count: hull.registered_count() as u32,
        deviation: hull.deviation(),
        planarity: hull.planarity(),
    }
}

/// What `GetHulls` is asked for.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::service) struct Parts {
    pub(in crate::service) info: bool,
    pub(in crate::service) vertices: bool,
    pub(in crate::service) faces: bool,
}

/// Checks a `GetHulls` field mask.
pub(in crate::service) fn parts(mask: Option<prost_types::FieldMask>) -> Result<Parts, ServiceError> {
    let paths = mask.unwrap_or_default().paths;
    if paths.is_empty() {
        return Ok(Parts { info: true, ..Parts::default() });
    }
    let mut parts = Parts::default();
    for (index, path) in paths.iter().enumerate() {
        match path.as_str() {
            "info" => parts.info = true,
            "vertices" => parts.vertices = true,
            "faces" => parts.faces = true,
            _ => {
                let message = format!("{path:?} is none of \"info\", \"vertices\", \"faces\"");
                let field = "field_mask.paths";
                return Err(ServiceError::invalid_at("UNKNOWN_PATH", field, index, message));
            }
        }
    }
    Ok(parts)
}

/// Checks the ids of a request.
pub(in crate::service) fn ids<B: AsRef<[u8]>>(
    ids: &[B],
    limits: &Limits,
) -> Result<Vec<HullId>, ServiceError> {
    at_most(ids.len(), limits.max_hulls_per_request, "TOO_MANY_HULLS", "ids")?;
    ids.iter().enumerate().map(|(index, bytes)| hull_id(bytes.as_ref(), "ids", index)).collect()
}

/// A hull that is not there.
pub(in crate::service) fn not_found(id: HullId) -> proto::HullRecord {
    proto::HullRecord { id: id.0.to_vec(), ..Default::default() }
}

/// A hull, as far as it is asked for. The vertices are those of its definition, bit for bit:
/// the hull keeps its own scaled.
pub(in crate::service) fn record(
    id: HullId,
    hull: &ConvexHull,
    definition: Option<&HullDefinition>,
    parts: Parts,
) -> proto::HullRecord {
    let mut record = proto::HullRecord { found: true, ..not_found(id) };
    if parts.info {
        record.info = Some(hull_info(id, hull));
    }
    if let Some(definition) = definition {
        record.vertex_indices = hull.registered_indices().to_vec();
        let points = record.vertex_indices.iter().filter_map(|&i| definition.points.get(i as usize));
        record.vertices = points.flatten().copied().collect();
    }
    if parts.faces {
        record.face_offsets.push(0);
        for face in 0..hull.face_count() {
            record.face_vertices.extend(hull.face_outline(face));
            record.face_offsets.push(record.face_vertices.len() as u32);
            record.face_normals.extend(hull.face_normal(face).to_array());
        }
    }
    record
}

/// Checks a `ListHulls` page token: the last id of the page before.
pub(in crate::service) fn page_token(token: &str) -> Result<Option<HullId>, ServiceError> {
    if token.is_empty() {
        return Ok(None);
    }
    token.parse().map(Some).map_err(|_| {
        ServiceError::invalid("MALFORMED_PAGE_TOKEN", "page_token", "not a token that this server gave")
    })
}

/// A page of `ListHulls`.
pub(in crate::service) fn page(blobs: Vec<StoredBlob>, more: bool) -> proto::ListHullsResponse {
    let next_page_token = match blobs.last() {
        Some(last) if more => last.id.to_string(),
        _ => String::new(),
    };
    let stored = |blob: StoredBlob| proto::StoredHull {
        id: blob.id.0.to_vec(),
        created_unix_ms: blob.created_unix_ms,
        bytes: blob.bytes,
    };
    proto::ListHullsResponse { hulls: blobs.into_iter().map(stored).collect(), next_page_token }
}

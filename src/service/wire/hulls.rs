//! Converts hulls from and to the wire.

use hullcast_batch::counted;
use prost::Message;

use super::fields::BYTES_PER_STEP;
use crate::{
    contact::{ConvexHull, HullError, Simplification, Stop, stop::Meter},
    proto,
    service::{HullReason, Reason, ServiceError},
    store::{HullDefinition, HullId, StoredBlob},
};

/// A hull of a `RegisterHulls` request: its definition, or the reason why only this hull is
/// refused.
pub(in crate::service) type CheckedDefinition = Result<HullDefinition, proto::HullError>;

/// The definition of a hull whose columns have valid lengths.
pub(super) fn definition(hull: proto::HullDefinition) -> HullDefinition {
    let contraction_point = hull.contraction_point.first_chunk().copied();
    let simplification = hull.simplification.map(|wanted| Simplification {
        max_vertices: wanted.max_vertices,
        max_deviation: wanted.max_deviation,
    });
    // Reuses the memory of the vertices instead of copying them.
    let planarity = hull.planarity;
    let points = bytemuck::try_cast_vec(hull.vertices);
    let points = points.unwrap_or_else(|(_, vertices)| vertices.as_chunks().0.to_vec());
    HullDefinition { points, contraction_point, simplification, planarity }
}

/// The error for a hull with a column of the wrong length.
pub(super) fn malformed(field: &str, found: usize, rule: &str) -> proto::HullError {
    proto::HullError {
        reason: HullReason::Malformed.name().into(),
        message: format!("got {found} entries, expected {rule}"),
        field: field.into(),
        index: None,
    }
}

/// The error for a hull with more points than the server accepts.
pub(super) fn too_many_points(points: usize, limit: u32) -> proto::HullError {
    proto::HullError {
        reason: HullReason::TooManyPoints.name().into(),
        message: format!(
            "got {points} points, at most {limit} are allowed: leave out points that are not extreme"
        ),
        field: "vertices".into(),
        index: None,
    }
}

/// The error for a hull that the builder refused.
pub(in crate::service) fn hull_error(error: &HullError) -> proto::HullError {
    proto::HullError {
        reason: HullReason::NotBuilt(error.kind).name().into(),
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

/// The properties of a hull, without its geometry.
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

/// The parts of a hull that a `GetHulls` request asks for.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::service) struct RecordParts {
    pub(in crate::service) info: bool,
    pub(in crate::service) vertices: bool,
    pub(in crate::service) faces: bool,
}

/// The most letters of an unknown path that the error repeats.
const SHOWN_LETTERS: usize = 40;

impl RecordParts {
    /// The parts named by the field mask of `GetHulls`; "info" if it names none.
    pub(super) fn named(paths: &[&str]) -> Result<Self, ServiceError> {
        let mut parts = Self { info: paths.is_empty(), ..Self::default() };
        for (index, path) in paths.iter().enumerate() {
            match *path {
                "info" => parts.info = true,
                "vertices" => parts.vertices = true,
                "faces" => parts.faces = true,
                _ => {
                    let shown: String = path.chars().take(SHOWN_LETTERS).collect();
                    let message = format!("got {shown:?}, expected \"info\", \"vertices\" or \"faces\"");
                    let field = "field_mask.paths";
                    return Err(ServiceError::in_entry(Reason::UnknownPath, field, index, message));
                }
            }
        }
        Ok(parts)
    }
}

/// The record of a hull that was not found.
pub(in crate::service) fn not_found(id: HullId) -> proto::HullRecord {
    proto::HullRecord { id: id.0.to_vec(), ..Default::default() }
}

/// Bytes of the columns of a hull's record. Its encoded size is some hundred bytes more.
pub(in crate::service) fn record_bytes(hull: &ConvexHull, parts: RecordParts) -> usize {
    let (vertices, faces) = (hull.vertex_count(), hull.face_count());
    let vertices = if parts.vertices { vertices * (size_of::<[f64; 3]>() + size_of::<u32>()) } else { 0 };
    let faces = match parts.faces {
        true => (1 + faces + corners(hull)) * size_of::<u32>() + faces * size_of::<[f64; 3]>(),
        false => 0,
    };
    vertices + faces
}

/// The number of corners of all faces together.
fn corners(hull: &ConvexHull) -> usize {
    (0..hull.face_count()).map(|face| hull.face_outline(face).len()).sum()
}

/// The records in the order of the answer: entry i is record `indices[i]`.
///
/// # Errors
/// The work was stopped.
pub(in crate::service) fn repeated(
    records: Vec<proto::HullRecord>,
    indices: &[usize],
    stop: &Stop,
) -> Result<Vec<proto::HullRecord>, ServiceError> {
    if records.len() == indices.len() {
        // No hull is repeated, so the records are in order already.
        return Ok(records);
    }
    let meter = Meter::new(stop);
    let mut repeated = Vec::with_capacity(indices.len());
    for &index in indices {
        meter.spend((records[index].encoded_len() / BYTES_PER_STEP) as u64)?;
        repeated.push(records[index].clone());
    }
    Ok(repeated)
}

/// The record of a hull with the requested parts. Its vertices are taken from the definition, bit
/// for bit, because the hull keeps scaled ones.
pub(in crate::service) fn record(
    id: HullId,
    hull: &ConvexHull,
    definition: Option<&HullDefinition>,
    parts: RecordParts,
) -> proto::HullRecord {
    let mut record = proto::HullRecord { found: true, ..not_found(id) };
    if parts.info {
        record.info = Some(hull_info(id, hull));
    }
    if let Some(definition) = definition {
        record.vertex_indices = hull.registered_indices().to_vec();
        let points = record.vertex_indices.iter().filter_map(|&i| definition.points.get(i as usize));
        record.vertices.reserve_exact(3 * record.vertex_indices.len());
        record.vertices.extend(points.flatten());
    }
    if parts.faces {
        record.face_offsets.reserve_exact(1 + hull.face_count());
        record.face_vertices.reserve_exact(corners(hull));
        record.face_normals.reserve_exact(3 * hull.face_count());
        record.face_offsets.push(0);
        for face in 0..hull.face_count() {
            record.face_vertices.extend(hull.face_outline(face));
            record.face_offsets.push(record.face_vertices.len() as u32);
            record.face_normals.extend(hull.face_normal(face).to_array());
        }
    }
    record
}

/// Checks a page token of `ListHulls`: the last id of the previous page.
pub(super) fn page_token(token: &str) -> Result<Option<HullId>, ServiceError> {
    if token.is_empty() {
        return Ok(None);
    }
    token.parse().map(Some).map_err(|_| {
        const SHOWN: usize = 40;
        let start: String = token.chars().take(SHOWN).collect();
        let more = if start.len() < token.len() { "..." } else { "" };
        let why = format!(
            "got {start:?}{more} ({}), expected the `next_page_token` of an earlier answer, or nothing for the \
             first page",
            counted(token.len(), "byte")
        );
        ServiceError::in_field(Reason::MalformedPageToken, "page_token", why)
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

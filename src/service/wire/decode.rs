//! Decodes requests within bounds.
//!
//! Each request is read twice. The first pass allocates nothing: it counts the elements of every
//! repeated field and refuses counts over a limit, with the field's name. Then the memory of the
//! decoded request is taken from the call's budget, and the second pass reserves every column once
//! and fills it. A request of n bytes therefore needs at most 2 n bytes, plus [`HULL_BYTES`] for
//! each hull or id, whose number is limited, plus [`CONSTANT_BYTES`]. The factor 2 covers what
//! validation adds to the columns themselves, which need at most n.
//!
//! Every message that prost accepts is accepted, with the same meaning.

#[cfg(test)]
mod tests;

use super::{
    fields::{Field, Fields, append},
    find::find,
    hulls::{Definition, Parts, definition, malformed, page_token, too_many_points},
    request::{at_most, hull_id, stoppable_scene},
};
use crate::{
    contact::{Stop, stop::Meter},
    proto::{
        self,
        bulk::{Column, Columnar},
    },
    service::{Reason, error::ServiceError, limits::Limits, sizes::HULL_BYTES},
    store::HullId,
};

/// The most entries of `outputs`: many times the number of current values, to leave room for newer ones.
const MAX_OUTPUTS: u32 = 256;

/// The most entries of `field_mask.paths`: many times the number of current paths.
const MAX_PATHS: u32 = 256;

/// The memory that any request may need for its outputs, the paths of its field mask, and an error.
pub const CONSTANT_BYTES: usize = 8 << 10;

/// The bounds for decoding one request.
pub(in crate::service) struct Bounds<'a> {
    limits: &'a Limits,
    meter: Meter<'a>,
    take: &'a mut (dyn FnMut(usize) -> Result<(), ServiceError> + Send),
}

impl<'a> Bounds<'a> {
    /// `take` takes memory from the call's budget before it is allocated; `stop` ends the work.
    pub(in crate::service) fn new(
        limits: &'a Limits,
        stop: &'a Stop,
        take: &'a mut (dyn FnMut(usize) -> Result<(), ServiceError> + Send),
    ) -> Self {
        Self { limits, meter: Meter::new(stop), take }
    }
}

/// A message that a client may send.
pub(in crate::service) trait Request: Send + Sync + 'static {
    /// The decoded message.
    type Decoded: Send + 'static;

    /// Decodes a message.
    ///
    /// # Errors
    /// MALFORMED_MESSAGE, a limit that the message exceeds, a budget without room for it, or that
    /// the work was stopped.
    fn read(message: &[u8], bounds: &mut Bounds<'_>) -> Result<Self::Decoded, ServiceError>;
}

/// The number of elements of each repeated field of a `QueryContactsRequest`.
#[derive(Debug, Default)]
struct QueryCounts {
    hull_ids: usize,
    hull_id_bytes: usize,
    outputs: usize,
    /// The counts are in the order of the message's `COLUMNS`.
    columns: [usize; proto::QueryContactsRequest::COLUMNS.len()],
    column_bytes: usize,
}

impl QueryCounts {
    fn of(message: &[u8], meter: &Meter<'_>) -> Result<Self, ServiceError> {
        let mut counts = Self::default();
        // An empty message that says which tags are columns.
        let mut empty = proto::QueryContactsRequest::default();
        let mut fields = Fields::new(message);
        while let Some(field) = fields.next(meter)? {
            match field.tag {
                3 => {
                    counts.hull_ids += 1;
                    counts.hull_id_bytes += field.bytes()?.len();
                }
                13 => field.varints(meter, |_| counts.outputs += 1)?,
                tag => {
                    let (elements, width) = match empty.column(tag) {
                        Some(Column::Doubles(_)) => (field.elements::<8>()?.len(), 8),
                        Some(Column::Fixed32s(_)) => (field.elements::<4>()?.len(), 4),
                        None => continue,
                    };
                    *counts.column(tag) += elements;
                    counts.column_bytes += elements * width;
                }
            }
        }
        Ok(counts)
    }

    fn column(&mut self, tag: u32) -> &mut usize {
        let columns = proto::QueryContactsRequest::COLUMNS;
        &mut self.columns[columns.iter().position(|&column| column == tag).unwrap_or(0)]
    }

    fn check(&mut self, limits: &Limits) -> Result<(), ServiceError> {
        at_most(self.hull_ids, limits.max_hulls_per_request, Reason::TooManyHulls, "hull_ids")?;
        at_most(*self.column(4), limits.max_bodies_per_request, Reason::TooManyBodies, "body_hulls")?;
        at_most(*self.column(7) / 2, limits.max_pairs_per_request, Reason::TooManyPairs, "pairs")?;
        at_most(self.outputs, MAX_OUTPUTS, Reason::TooManyOutputs, "outputs")
    }

    /// The memory of the decoded request, and of the list that validation makes of it: the bodies
    /// with an unusable pose, at most one number per body.
    fn bytes(&mut self) -> usize {
        let unusable = *self.column(4) * size_of::<u32>();
        let outputs = self.outputs * size_of::<i32>();
        self.column_bytes + unusable + outputs + self.hull_id_bytes + self.hull_ids * HULL_BYTES
    }
}

impl Request for proto::QueryContactsRequest {
    type Decoded = Self;

    fn read(message: &[u8], bounds: &mut Bounds<'_>) -> Result<Self, ServiceError> {
        let meter = &bounds.meter;
        let mut counts = QueryCounts::of(message, meter)?;
        counts.check(bounds.limits)?;
        (bounds.take)(counts.bytes())?;
        let mut request = Self::default();
        request.hull_ids.reserve_exact(counts.hull_ids);
        request.outputs.reserve_exact(counts.outputs);
        for (&tag, &elements) in Self::COLUMNS.iter().zip(&counts.columns) {
            match request.column(tag) {
                Some(Column::Doubles(column)) => column.reserve_exact(elements),
                Some(Column::Fixed32s(column)) => column.reserve_exact(elements),
                None => {}
            }
        }
        let mut fields = Fields::new(message);
        while let Some(field) = fields.next(meter)? {
            match field.tag {
                1 => request.request_id = field.varint()?,
                2 => request.inherit = field.varint()? != 0,
                3 => request.hull_ids.push(field.bytes()?.to_vec()),
                11 => request.margin = field.double()?,
                12 => read_accuracy(request.accuracy.get_or_insert_default(), &field, meter)?,
                13 => field.varints(meter, |output| request.outputs.push(output as i32))?,
                tag => match request.column(tag) {
                    Some(Column::Doubles(column)) => {
                        append(column, field.elements()?, f64::from_le_bytes, meter)?;
                    }
                    Some(Column::Fixed32s(column)) => {
                        append(column, field.elements()?, u32::from_le_bytes, meter)?;
                    }
                    None => {}
                },
            }
        }
        Ok(request)
    }
}

fn read_accuracy(
    accuracy: &mut proto::Accuracy,
    field: &Field<'_>,
    meter: &Meter<'_>,
) -> Result<(), ServiceError> {
    let mut fields = Fields::nested(field.bytes()?, 1);
    while let Some(field) = fields.next(meter)? {
        match field.tag {
            1 => accuracy.solver = field.varint()? as i32,
            3 => accuracy.relative_tolerance = field.double()?,
            4 => accuracy.feature_angle = Some(field.double()?),
            5 => accuracy.max_points = field.varint()? as u32,
            _ => {}
        }
    }
    Ok(())
}

impl Request for proto::RegisterHullsRequest {
    type Decoded = Vec<Definition>;

    fn read(message: &[u8], bounds: &mut Bounds<'_>) -> Result<Vec<Definition>, ServiceError> {
        let (meter, limits) = (&bounds.meter, bounds.limits);
        let (mut hulls, mut doubles) = (0, 0);
        let mut fields = Fields::new(message);
        while let Some(field) = fields.next(meter)? {
            if field.tag == 1 {
                hulls += 1;
                let counts = HullCounts::of(&field, meter)?;
                if counts.refusal(limits).is_none() {
                    doubles += counts.vertices;
                }
            }
        }
        at_most(hulls, limits.max_hulls_per_request, Reason::TooManyHulls, "hulls")?;
        (bounds.take)(doubles * size_of::<f64>() + hulls * HULL_BYTES)?;
        let mut definitions = Vec::with_capacity(hulls);
        let mut fields = Fields::new(message);
        while let Some(field) = fields.next(meter)? {
            if field.tag == 1 {
                let counts = HullCounts::of(&field, meter)?;
                definitions.push(match counts.refusal(limits) {
                    Some(error) => Err(error),
                    None => Ok(definition(read_hull(&field, &counts, meter)?)),
                });
            }
        }
        Ok(definitions)
    }
}

/// The number of elements in each column of a `HullDefinition`.
#[derive(Debug, Default)]
struct HullCounts {
    vertices: usize,
    contraction_point: usize,
}

impl HullCounts {
    fn of(hull: &Field<'_>, meter: &Meter<'_>) -> Result<Self, ServiceError> {
        let mut counts = Self::default();
        let mut fields = Fields::nested(hull.bytes()?, 1);
        while let Some(field) = fields.next(meter)? {
            match field.tag {
                1 => counts.vertices += field.elements::<8>()?.len(),
                2 => counts.contraction_point += field.elements::<8>()?.len(),
                // The values are read here to find their faults, because the hull may be refused before it
                // is read again.
                3 => read_simplification(&mut proto::Simplification::default(), &field, meter)?,
                4 => drop(field.double()?),
                _ => {}
            }
        }
        Ok(counts)
    }

    /// The reason why the hull is refused, or `None` if it is accepted.
    fn refusal(&self, limits: &Limits) -> Option<proto::HullError> {
        if !self.vertices.is_multiple_of(3) {
            return Some(malformed("vertices", self.vertices, "3 per point"));
        }
        if self.vertices / 3 > limits.max_points_per_hull as usize {
            return Some(too_many_points(self.vertices / 3, limits.max_points_per_hull));
        }
        if ![0, 3].contains(&self.contraction_point) {
            return Some(malformed("contraction_point", self.contraction_point, "none or 3"));
        }
        None
    }
}

fn read_hull(
    hull: &Field<'_>,
    counts: &HullCounts,
    meter: &Meter<'_>,
) -> Result<proto::HullDefinition, ServiceError> {
    let mut read = proto::HullDefinition {
        vertices: Vec::with_capacity(counts.vertices),
        contraction_point: Vec::with_capacity(counts.contraction_point),
        simplification: None,
        planarity: None,
    };
    let mut fields = Fields::nested(hull.bytes()?, 1);
    while let Some(field) = fields.next(meter)? {
        match field.tag {
            1 => append(&mut read.vertices, field.elements()?, f64::from_le_bytes, meter)?,
            2 => append(&mut read.contraction_point, field.elements()?, f64::from_le_bytes, meter)?,
            3 => read_simplification(read.simplification.get_or_insert_default(), &field, meter)?,
            4 => read.planarity = Some(field.double()?),
            _ => {}
        }
    }
    Ok(read)
}

fn read_simplification(
    simplification: &mut proto::Simplification,
    field: &Field<'_>,
    meter: &Meter<'_>,
) -> Result<(), ServiceError> {
    let mut fields = Fields::nested(field.bytes()?, 2);
    while let Some(field) = fields.next(meter)? {
        match field.tag {
            1 => simplification.max_vertices = Some(field.varint()? as u32),
            2 => simplification.max_deviation = Some(field.double()?),
            _ => {}
        }
    }
    Ok(())
}

/// The hull ids of a message that has them as field 1.
fn ids(message: &[u8], bounds: &mut Bounds<'_>) -> Result<Vec<HullId>, ServiceError> {
    let mut count = 0;
    let mut fields = Fields::new(message);
    while let Some(field) = fields.next(&bounds.meter)? {
        if field.tag == 1 {
            field.bytes()?;
            count += 1;
        }
    }
    at_most(count, bounds.limits.max_hulls_per_request, Reason::TooManyHulls, "ids")?;
    (bounds.take)(count * HULL_BYTES)?;
    let mut ids = Vec::with_capacity(count);
    let mut fields = Fields::new(message);
    while let Some(field) = fields.next(&bounds.meter)? {
        if field.tag == 1 {
            ids.push(hull_id(field.bytes()?, "ids", ids.len())?);
        }
    }
    Ok(ids)
}

impl Request for proto::HasHullsRequest {
    type Decoded = Vec<HullId>;

    fn read(message: &[u8], bounds: &mut Bounds<'_>) -> Result<Vec<HullId>, ServiceError> {
        ids(message, bounds)
    }
}

impl Request for proto::DeleteHullsRequest {
    type Decoded = Vec<HullId>;

    fn read(message: &[u8], bounds: &mut Bounds<'_>) -> Result<Vec<HullId>, ServiceError> {
        ids(message, bounds)
    }
}

impl Request for proto::GetHullsRequest {
    type Decoded = (Vec<HullId>, Parts);

    fn read(message: &[u8], bounds: &mut Bounds<'_>) -> Result<Self::Decoded, ServiceError> {
        let ids = ids(message, bounds)?;
        let paths = paths(message, &bounds.meter)?;
        Ok((ids, Parts::named(&paths)?))
    }
}

/// The paths of the field mask: at most [`MAX_PATHS`] references into the message.
fn paths<'a>(message: &'a [u8], meter: &Meter<'_>) -> Result<Vec<&'a str>, ServiceError> {
    let (mut paths, mut count) = (Vec::new(), 0);
    let mut fields = Fields::new(message);
    while let Some(field) = fields.next(meter)? {
        if field.tag != 2 {
            continue;
        }
        let mut fields = Fields::nested(field.bytes()?, 1);
        while let Some(field) = fields.next(meter)? {
            if field.tag == 1 {
                let path = field.text()?;
                count += 1;
                if count <= MAX_PATHS as usize {
                    paths.push(path);
                }
            }
        }
    }
    at_most(count, MAX_PATHS, Reason::TooManyPaths, "field_mask.paths")?;
    Ok(paths)
}

/// The contents of a `ListHulls` request.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::service) struct Listing {
    /// The size of the page; 0 means the server's default.
    pub(in crate::service) page_size: u32,
    /// The last hull of the previous page.
    pub(in crate::service) after: Option<HullId>,
}

impl Request for proto::ListHullsRequest {
    type Decoded = Listing;

    fn read(message: &[u8], bounds: &mut Bounds<'_>) -> Result<Listing, ServiceError> {
        let (mut page_size, mut token) = (0, "");
        let mut fields = Fields::new(message);
        while let Some(field) = fields.next(&bounds.meter)? {
            match field.tag {
                1 => page_size = field.varint()? as u32,
                2 => token = field.text()?,
                _ => {}
            }
        }
        Ok(Listing { page_size, after: page_token(token)? })
    }
}

impl Request for proto::GetServerInfoRequest {
    type Decoded = ();

    fn read(message: &[u8], bounds: &mut Bounds<'_>) -> Result<(), ServiceError> {
        let mut fields = Fields::new(message);
        while fields.next(&bounds.meter)?.is_some() {}
        Ok(())
    }
}

/// Decodes and checks a message as the handler of `method` does. Returns the memory that this takes from
/// the budget. Used by the fuzz target and by tests of memory.
///
/// # Errors
/// The errors of the handler.
#[cfg(feature = "testing")]
pub fn decoded_bytes(
    method: &str,
    message: &[u8],
    limits: &Limits,
    stop: &Stop,
) -> Result<usize, ServiceError> {
    fn decode<M: Request>(
        message: &[u8],
        limits: &Limits,
        stop: &Stop,
    ) -> Result<(M::Decoded, usize), ServiceError> {
        let mut taken = 0;
        let mut take = |bytes| {
            taken += bytes;
            Ok(())
        };
        let decoded = M::read(message, &mut Bounds::new(limits, stop, &mut take))?;
        Ok((decoded, taken))
    }
    let bytes = match method {
        "FindContacts" => {
            let (request, bytes) = decode::<proto::QueryContactsRequest>(message, limits, stop)?;
            find(request, limits, stop)?;
            bytes
        }
        "RegisterHulls" => decode::<proto::RegisterHullsRequest>(message, limits, stop)?.1,
        "GetHulls" => decode::<proto::GetHullsRequest>(message, limits, stop)?.1,
        "HasHulls" => decode::<proto::HasHullsRequest>(message, limits, stop)?.1,
        "DeleteHulls" => decode::<proto::DeleteHullsRequest>(message, limits, stop)?.1,
        "ListHulls" => decode::<proto::ListHullsRequest>(message, limits, stop)?.1,
        "GetServerInfo" => decode::<proto::GetServerInfoRequest>(message, limits, stop)?.1,
        _ => {
            let (request, bytes) = decode::<proto::QueryContactsRequest>(message, limits, stop)?;
            stoppable_scene(request, limits, stop)?;
            bytes
        }
    };
    Ok(bytes)
}

//! Decodes the requests of queries: their columns, outputs and accuracy.

use super::{
    super::{
        fields::{Field, Fields, append},
        request::at_most,
    },
    DecodeRequest, DecodeResources,
};
use crate::{
    contact::stop::Meter,
    proto::{
        self,
        bulk::{ColumnMut, Columnar},
        tags::{accuracy as accuracy_tags, query_contacts_request as tags},
    },
    service::{Reason, error::ServiceError, limits::Limits, sizes::HULL_BYTES},
};

/// The most entries of `outputs`: many times the number of current values, to leave room for newer ones.
const MAX_OUTPUTS: u32 = 256;

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
                tags::HULL_IDS => {
                    counts.hull_ids += 1;
                    counts.hull_id_bytes += field.bytes()?.len();
                }
                tags::OUTPUTS => field.varints(meter, |_| counts.outputs += 1)?,
                tag => {
                    let (elements, width) = match empty.column(tag) {
                        Some(ColumnMut::Doubles(_)) => (field.elements::<8>()?.len(), 8),
                        Some(ColumnMut::Fixed32s(_)) => (field.elements::<4>()?.len(), 4),
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
        at_most(
            *self.column(tags::BODY_HULLS),
            limits.max_bodies_per_request,
            Reason::TooManyBodies,
            "body_hulls",
        )?;
        at_most(*self.column(tags::PAIRS) / 2, limits.max_pairs_per_request, Reason::TooManyPairs, "pairs")?;
        at_most(self.outputs, MAX_OUTPUTS, Reason::TooManyOutputs, "outputs")
    }

    /// The memory of the decoded request, and of the list that validation makes of it: the bodies
    /// with an unusable pose, at most one number per body.
    fn bytes(&mut self) -> usize {
        let unusable = *self.column(tags::BODY_HULLS) * size_of::<u32>();
        let outputs = self.outputs * size_of::<i32>();
        self.column_bytes + unusable + outputs + self.hull_id_bytes + self.hull_ids * HULL_BYTES
    }
}

impl DecodeRequest for proto::QueryContactsRequest {
    type Decoded = Self;

    fn read(message: &[u8], resources: &mut DecodeResources<'_>) -> Result<Self, ServiceError> {
        let meter = &resources.meter;
        let mut counts = QueryCounts::of(message, meter)?;
        counts.check(resources.limits)?;
        (resources.take)(counts.bytes())?;
        let mut request = Self::default();
        request.hull_ids.reserve_exact(counts.hull_ids);
        request.outputs.reserve_exact(counts.outputs);
        for (&tag, &elements) in Self::COLUMNS.iter().zip(&counts.columns) {
            match request.column(tag) {
                Some(ColumnMut::Doubles(column)) => column.reserve_exact(elements),
                Some(ColumnMut::Fixed32s(column)) => column.reserve_exact(elements),
                None => {}
            }
        }
        let mut fields = Fields::new(message);
        while let Some(field) = fields.next(meter)? {
            match field.tag {
                tags::REQUEST_ID => request.request_id = field.varint()?,
                tags::INHERIT => request.inherit = field.varint()? != 0,
                tags::HULL_IDS => request.hull_ids.push(field.bytes()?.to_vec()),
                tags::MARGIN => request.margin = field.double()?,
                tags::ACCURACY => read_accuracy(request.accuracy.get_or_insert_default(), &field, meter)?,
                tags::OUTPUTS => field.varints(meter, |output| request.outputs.push(output as i32))?,
                tags::FIND => request.find = field.varint()? != 0,
                tags::TIME_STEP => request.time_step = field.double()?,
                tag => match request.column(tag) {
                    Some(ColumnMut::Doubles(column)) => {
                        append(column, field.elements()?, f64::from_le_bytes, meter)?;
                    }
                    Some(ColumnMut::Fixed32s(column)) => {
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
            accuracy_tags::SOLVER => accuracy.solver = field.varint()? as i32,
            accuracy_tags::RELATIVE_TOLERANCE => accuracy.relative_tolerance = field.double()?,
            accuracy_tags::FEATURE_ANGLE => accuracy.feature_angle = Some(field.double()?),
            accuracy_tags::MAX_POINTS => accuracy.max_points = field.varint()? as u32,
            _ => {}
        }
    }
    Ok(())
}

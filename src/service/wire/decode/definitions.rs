//! Decodes `RegisterHulls`: the definitions of hulls.

use super::{
    super::{
        fields::{Field, Fields, append},
        hulls::{CheckedDefinition, definition, malformed, too_many_points},
        request::at_most,
    },
    DecodeRequest, DecodeResources,
};
use crate::{
    contact::stop::Meter,
    proto::{
        self,
        tags::{
            hull_definition as hull_tags, register_hulls_request as tags,
            simplification as simplification_tags,
        },
    },
    service::{Reason, error::ServiceError, limits::Limits, sizes::HULL_BYTES},
};

impl DecodeRequest for proto::RegisterHullsRequest {
    type Decoded = Vec<CheckedDefinition>;

    fn read(
        message: &[u8],
        resources: &mut DecodeResources<'_>,
    ) -> Result<Vec<CheckedDefinition>, ServiceError> {
        let (meter, limits) = (&resources.meter, resources.limits);
        let (mut hulls, mut doubles) = (0, 0);
        let mut fields = Fields::new(message);
        while let Some(field) = fields.next(meter)? {
            if field.tag == tags::HULLS {
                hulls += 1;
                let counts = HullCounts::of(&field, meter)?;
                if counts.refusal(limits).is_none() {
                    doubles += counts.vertices;
                }
            }
        }
        at_most(hulls, limits.max_hulls_per_request, Reason::TooManyHulls, "hulls")?;
        (resources.take)(doubles * size_of::<f64>() + hulls * HULL_BYTES)?;
        let mut definitions = Vec::with_capacity(hulls);
        let mut fields = Fields::new(message);
        while let Some(field) = fields.next(meter)? {
            if field.tag == tags::HULLS {
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
                hull_tags::VERTICES => counts.vertices += field.elements::<8>()?.len(),
                hull_tags::CONTRACTION_POINT => counts.contraction_point += field.elements::<8>()?.len(),
                // The values are read here to find their faults, because the hull may be refused before it
                // is read again.
                hull_tags::SIMPLIFICATION => {
                    read_simplification(&mut proto::Simplification::default(), &field, meter)?
                }
                hull_tags::PLANARITY => drop(field.double()?),
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
            hull_tags::VERTICES => append(&mut read.vertices, field.elements()?, f64::from_le_bytes, meter)?,
            hull_tags::CONTRACTION_POINT => {
                append(&mut read.contraction_point, field.elements()?, f64::from_le_bytes, meter)?
            }
            hull_tags::SIMPLIFICATION => {
                read_simplification(read.simplification.get_or_insert_default(), &field, meter)?
            }
            hull_tags::PLANARITY => read.planarity = Some(field.double()?),
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
            simplification_tags::MAX_VERTICES => simplification.max_vertices = Some(field.varint()? as u32),
            simplification_tags::MAX_DEVIATION => simplification.max_deviation = Some(field.double()?),
            _ => {}
        }
    }
    Ok(())
}

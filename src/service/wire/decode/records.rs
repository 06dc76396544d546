//! Decodes the requests about registered hulls: `GetHulls`, `HasHulls`, `DeleteHulls` and `ListHulls`.

use super::{
    super::{
        fields::Fields,
        hulls::{RecordParts, page_token},
        request::{at_most, hull_id},
    },
    DecodeRequest, DecodeResources,
};
use crate::{
    contact::stop::Meter,
    proto::{self, tags},
    service::{Reason, error::ServiceError, sizes::HULL_BYTES},
    store::HullId,
};

/// The most entries of `field_mask.paths`: many times the number of current paths.
const MAX_PATHS: u32 = 256;

/// The hull ids of a message: the elements of its field with this tag.
fn ids(message: &[u8], tag: u32, resources: &mut DecodeResources<'_>) -> Result<Vec<HullId>, ServiceError> {
    let mut count = 0;
    let mut fields = Fields::new(message);
    while let Some(field) = fields.next(&resources.meter)? {
        if field.tag == tag {
            field.bytes()?;
            count += 1;
        }
    }
    at_most(count, resources.limits.max_hulls_per_request, Reason::TooManyHulls, "ids")?;
    (resources.take)(count * HULL_BYTES)?;
    let mut ids = Vec::with_capacity(count);
    let mut fields = Fields::new(message);
    while let Some(field) = fields.next(&resources.meter)? {
        if field.tag == tag {
            ids.push(hull_id(field.bytes()?, "ids", ids.len())?);
        }
    }
    Ok(ids)
}

impl DecodeRequest for proto::HasHullsRequest {
    type Decoded = Vec<HullId>;

    fn read(message: &[u8], resources: &mut DecodeResources<'_>) -> Result<Vec<HullId>, ServiceError> {
        ids(message, tags::has_hulls_request::IDS, resources)
    }
}

impl DecodeRequest for proto::DeleteHullsRequest {
    type Decoded = Vec<HullId>;

    fn read(message: &[u8], resources: &mut DecodeResources<'_>) -> Result<Vec<HullId>, ServiceError> {
        ids(message, tags::delete_hulls_request::IDS, resources)
    }
}

impl DecodeRequest for proto::GetHullsRequest {
    type Decoded = (Vec<HullId>, RecordParts);

    fn read(message: &[u8], resources: &mut DecodeResources<'_>) -> Result<Self::Decoded, ServiceError> {
        let ids = ids(message, tags::get_hulls_request::IDS, resources)?;
        let paths = paths(message, &resources.meter)?;
        Ok((ids, RecordParts::named(&paths)?))
    }
}

/// The paths of the field mask: at most [`MAX_PATHS`] references into the message.
fn paths<'a>(message: &'a [u8], meter: &Meter<'_>) -> Result<Vec<&'a str>, ServiceError> {
    let (mut paths, mut count) = (Vec::new(), 0);
    let mut fields = Fields::new(message);
    while let Some(field) = fields.next(meter)? {
        if field.tag != tags::get_hulls_request::FIELD_MASK {
            continue;
        }
        let mut fields = Fields::nested(field.bytes()?, 1);
        while let Some(field) = fields.next(meter)? {
            if field.tag == tags::field_mask::PATHS {
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

impl DecodeRequest for proto::ListHullsRequest {
    type Decoded = Listing;

    fn read(message: &[u8], resources: &mut DecodeResources<'_>) -> Result<Listing, ServiceError> {
        let (mut page_size, mut token) = (0, "");
        let mut fields = Fields::new(message);
        while let Some(field) = fields.next(&resources.meter)? {
            match field.tag {
                tags::list_hulls_request::PAGE_SIZE => page_size = field.varint()? as u32,
                tags::list_hulls_request::PAGE_TOKEN => token = field.text()?,
                _ => {}
            }
        }
        Ok(Listing { page_size, after: page_token(token)? })
    }
}

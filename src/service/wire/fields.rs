//! Reads the fields of an encoded message one by one.
//!
//! [`Fields`] walks over a message without allocating. It accepts the bytes that prost accepts:
//! packed and unpacked columns, columns in several parts, repeated singular fields, unknown fields,
//! and groups nested up to prost's depth. It counts its steps, so that reading a large message can
//! be stopped.

use prost::encoding::{WireType, decode_key, decode_varint};

use crate::{
    contact::{Stopped, stop::Meter},
    service::{Reason, ServiceError},
};

/// How deep messages and groups may be nested: prost's limit.
pub(super) const DEPTH: u32 = 100;

/// Elementary steps of reading one field, which takes some nanoseconds.
const FIELD_STEPS: u64 = 5;

/// Bytes copied per elementary step, including the system's work for new pages.
pub(super) const BYTES_PER_STEP: usize = 4;

/// The reason why reading ended early.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum FieldError {
    /// The bytes are not a message of this type.
    Malformed(String),
    /// The work was stopped.
    Stopped,
}

impl FieldError {
    fn malformed(why: impl ToString) -> Self {
        Self::Malformed(why.to_string())
    }
}

impl From<Stopped> for FieldError {
    fn from(_: Stopped) -> Self {
        Self::Stopped
    }
}

impl From<FieldError> for ServiceError {
    fn from(error: FieldError) -> Self {
        match error {
            FieldError::Malformed(why) => {
                Self::new(Reason::MalformedMessage, format!("the message cannot be decoded: {why}"))
            }
            FieldError::Stopped => Stopped.into(),
        }
    }
}

/// A field in a message.
#[derive(Clone, Copy, Debug)]
pub(super) struct Field<'a> {
    /// The field's number in the contract.
    pub(super) tag: u32,
    wire_type: WireType,
    /// The content of a length-delimited field, or the bytes of a fixed-width number.
    payload: &'a [u8],
    /// The value of a varint.
    varint: u64,
}

impl<'a> Field<'a> {
    fn checked(&self, expected: WireType) -> Result<(), FieldError> {
        if self.wire_type == expected {
            return Ok(());
        }
        let (tag, found) = (self.tag, self.wire_type);
        Err(FieldError::malformed(format!("field {tag} has wire type {found:?}, expected {expected:?}")))
    }

    /// The value of an integer, an enum or a bool.
    pub(super) fn varint(&self) -> Result<u64, FieldError> {
        self.checked(WireType::Varint)?;
        Ok(self.varint)
    }

    /// The value of a double.
    pub(super) fn double(&self) -> Result<f64, FieldError> {
        self.checked(WireType::SixtyFourBit)?;
        let bytes = self.payload.try_into().map_err(FieldError::malformed)?;
        Ok(f64::from_le_bytes(bytes))
    }

    /// The content of bytes or of a message.
    pub(super) fn bytes(&self) -> Result<&'a [u8], FieldError> {
        self.checked(WireType::LengthDelimited)?;
        Ok(self.payload)
    }

    /// The content of a string.
    pub(super) fn text(&self) -> Result<&'a str, FieldError> {
        std::str::from_utf8(self.bytes()?).map_err(FieldError::malformed)
    }

    /// The elements of a column that this field has: many if the column is packed, otherwise one.
    pub(super) fn elements<const WIDTH: usize>(&self) -> Result<&'a [[u8; WIDTH]], FieldError> {
        if self.wire_type != WireType::LengthDelimited {
            self.checked(if WIDTH == 8 { WireType::SixtyFourBit } else { WireType::ThirtyTwoBit })?;
        }
        let (elements, rest) = self.payload.as_chunks();
        if rest.is_empty() {
            return Ok(elements);
        }
        let (tag, length) = (self.tag, self.payload.len());
        Err(FieldError::malformed(format!("field {tag} has {length} bytes, expected a multiple of {WIDTH}")))
    }

    /// Passes the elements of a column of varints to `each`.
    pub(super) fn varints(&self, meter: &Meter<'_>, mut each: impl FnMut(u64)) -> Result<(), FieldError> {
        if self.wire_type != WireType::LengthDelimited {
            each(self.varint()?);
            return Ok(());
        }
        let mut rest = self.payload;
        while !rest.is_empty() {
            meter.spend(FIELD_STEPS)?;
            each(decode_varint(&mut rest).map_err(FieldError::malformed)?);
        }
        Ok(())
    }
}

/// The fields of a message that have not been read yet.
#[derive(Debug)]
pub(super) struct Fields<'a> {
    rest: &'a [u8],
    /// How many levels of messages or groups may still be opened.
    depth: u32,
}

impl<'a> Fields<'a> {
    /// The fields of a whole message.
    pub(super) fn new(message: &'a [u8]) -> Self {
        Self { rest: message, depth: DEPTH }
    }

    /// The fields of a message that is a field of another one, `levels` below the outermost
    /// message.
    pub(super) fn nested(message: &'a [u8], levels: u32) -> Self {
        Self { rest: message, depth: DEPTH - levels }
    }

    /// The next field, or `None` at the end. A group counts as one field without content.
    pub(super) fn next(&mut self, meter: &Meter<'_>) -> Result<Option<Field<'a>>, FieldError> {
        if self.rest.is_empty() {
            return Ok(None);
        }
        let (tag, wire_type) = decode_key(&mut self.rest).map_err(FieldError::malformed)?;
        self.value(tag, wire_type, self.depth, meter).map(Some)
    }

    fn value(
        &mut self,
        tag: u32,
        wire_type: WireType,
        depth: u32,
        meter: &Meter<'_>,
    ) -> Result<Field<'a>, FieldError> {
        meter.spend(FIELD_STEPS)?;
        let mut field = Field { tag, wire_type, payload: &[], varint: 0 };
        match wire_type {
            WireType::Varint => {
                field.varint = decode_varint(&mut self.rest).map_err(FieldError::malformed)?
            }
            WireType::SixtyFourBit => field.payload = self.take(8)?,
            WireType::ThirtyTwoBit => field.payload = self.take(4)?,
            WireType::LengthDelimited => {
                let length = decode_varint(&mut self.rest).map_err(FieldError::malformed)?;
                field.payload = self.take(length)?;
            }
            WireType::StartGroup => self.skip_group(tag, depth, meter)?,
            WireType::EndGroup => {
                return Err(FieldError::malformed(format!("group {tag} ends before it begins")));
            }
        }
        Ok(field)
    }

    fn take(&mut self, length: u64) -> Result<&'a [u8], FieldError> {
        let split = usize::try_from(length).ok().and_then(|length| self.rest.split_at_checked(length));
        let ended =
            || FieldError::malformed(format!("a field of {length} bytes has only {}", self.rest.len()));
        let (payload, rest) = split.ok_or_else(ended)?;
        self.rest = rest;
        Ok(payload)
    }

    /// Skips the content of a group, up to its end.
    fn skip_group(&mut self, tag: u32, depth: u32, meter: &Meter<'_>) -> Result<(), FieldError> {
        loop {
            let (inner, wire_type) = decode_key(&mut self.rest).map_err(FieldError::malformed)?;
            if wire_type == WireType::EndGroup {
                if inner == tag {
                    return Ok(());
                }
                return Err(FieldError::malformed(format!("group {tag} ends as group {inner}")));
            }
            if depth <= 1 {
                return Err(FieldError::malformed(format!("groups are nested deeper than {DEPTH} levels")));
            }
            self.value(inner, wire_type, depth - 1, meter)?;
        }
    }
}

/// Appends elements to a column whose memory is already reserved.
pub(super) fn append<T, const WIDTH: usize>(
    column: &mut Vec<T>,
    elements: &[[u8; WIDTH]],
    read: fn([u8; WIDTH]) -> T,
    meter: &Meter<'_>,
) -> Result<(), FieldError> {
    const AT_A_TIME: usize = 256 << 10;
    for some in elements.chunks(AT_A_TIME / WIDTH) {
        meter.spend((some.len() * WIDTH / BYTES_PER_STEP) as u64)?;
        column.extend(some.iter().map(|&element| read(element)));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use prost::encoding::encode_key;

    use super::*;
    use crate::contact::{STEPS_BETWEEN_LOOKS, Stop};

    /// A quarter of a millisecond.
    const GATHERED_STEPS: u64 = STEPS_BETWEEN_LOOKS / 4;

    /// Groups within groups; the innermost is empty.
    fn nested_groups(levels: usize) -> Vec<u8> {
        let mut bytes = Vec::new();
        (0..levels).for_each(|_| encode_key(900, WireType::StartGroup, &mut bytes));
        (0..levels).for_each(|_| encode_key(900, WireType::EndGroup, &mut bytes));
        bytes
    }

    fn count(bytes: &[u8], stop: &Stop) -> Result<usize, FieldError> {
        let (mut fields, meter, mut count) = (Fields::new(bytes), Meter::new(stop), 0);
        while fields.next(&meter)?.is_some() {
            count += 1;
        }
        Ok(count)
    }

    /// Catches groups that are refused although prost accepts them, and a stack overflow on groups
    /// that are nested without limit.
    #[test]
    fn groups_are_nested_as_deep_as_prost_allows() {
        use prost::Message;
        for (levels, accepted) in [(1, true), (99, true), (100, true), (101, false), (1_000_000, false)] {
            let bytes = nested_groups(levels);
            assert_eq!(count(&bytes, &Stop::default()).is_ok(), accepted, "{levels}");
            assert_eq!(crate::proto::QueryContactsRequest::decode(&bytes[..]).is_ok(), accepted, "{levels}");
        }
        assert!(count(&[nested_groups(3), nested_groups(2)].concat()[..15], &Stop::default()).is_err());
    }

    /// Catches reading that goes on for more than a millisecond without checking the stop flag:
    /// through many small fields, and within one group.
    #[test]
    fn reading_looks_at_the_flag() {
        let group = [&nested_groups(1)[..2], &[8, 1].repeat(1 << 20)[..], &nested_groups(1)[2..]].concat();
        for (bytes, fields) in [([0x1a, 0].repeat(1 << 20), 1 << 20), (group, 1)] {
            let stop = Stop::default();
            assert_eq!(count(&bytes, &stop), Ok(fields));
            assert!(stop.steps() >= FIELD_STEPS << 20, "{}", stop.steps());
            assert!(stop.largest_between_looks() <= 2 * GATHERED_STEPS);
            let stopped = Stop::default();
            stopped.stop();
            assert_eq!(count(&bytes, &stopped), Err(FieldError::Stopped));
            assert!(stopped.steps() <= 2 * GATHERED_STEPS, "{}", stopped.steps());
        }
    }
}

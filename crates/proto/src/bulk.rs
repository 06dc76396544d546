//! Reads and writes packed numeric columns in bulk. prost's generated code handles them one element at a
//! time, which took most of the server's time for a batch apart from the computation.
//!
//! The messages are prost's own. Their bytes are also those of prost, except that the columns come last.
//! Anything that is not a well-formed packed column is left to prost: a sender may split a column or leave
//! it unpacked, and the bytes may be arbitrary.
//!
//! This is our own code, because prost lets nobody replace the encoding of a single field.

use bytes::{Buf, BufMut, Bytes};
use prost::{
    DecodeError, Message,
    encoding::{DecodeContext, WireType, decode_key, decode_varint, encode_key, encode_varint},
};

/// A column of a message.
#[derive(Debug)]
pub enum ColumnMut<'a> {
    /// `repeated double`.
    Doubles(&'a mut Vec<f64>),
    /// `repeated fixed32`.
    Fixed32s(&'a mut Vec<u32>),
}

/// A message that knows its columns. By default it has none.
pub trait Columnar: Message + Default {
    /// The tags of the message's columns, in ascending order.
    const COLUMNS: &'static [u32] = &[];

    /// The column with this tag.
    fn column(&mut self, _tag: u32) -> Option<ColumnMut<'_>> {
        None
    }
}

/// Reads a message.
///
/// # Errors
/// The errors of prost for the same bytes.
pub fn decode<M: Columnar>(mut bytes: Bytes) -> Result<M, DecodeError> {
    let mut message = M::default();
    while bytes.has_remaining() {
        let (tag, wire_type) = decode_key(&mut bytes)?;
        let packed = match wire_type {
            WireType::LengthDelimited => message.column(tag),
            _ => None,
        };
        if !packed.is_some_and(|column| column.extend(&mut bytes)) {
            message.merge_field(tag, wire_type, &mut bytes, DecodeContext::default())?;
        }
    }
    Ok(message)
}

/// Writes a message with its columns last. The number of bytes is prost's `encoded_len`. The message is the same
/// afterwards.
pub fn encode<M: Columnar>(message: &mut M, buffer: &mut impl BufMut) {
    let mut columns = M::default();
    let swap = |one: &mut M, other: &mut M| {
        for &tag in M::COLUMNS {
            if let (Some(one), Some(other)) = (one.column(tag), other.column(tag)) {
                one.swap(other);
            }
        }
    };
    swap(message, &mut columns);
    message.encode_raw(buffer);
    for &tag in M::COLUMNS {
        if let Some(column) = columns.column(tag) {
            column.put(tag, buffer);
        }
    }
    swap(message, &mut columns);
}

impl ColumnMut<'_> {
    /// Appends the elements of a packed column. Returns false and reads nothing if `bytes` do not begin
    /// with one.
    fn extend(self, bytes: &mut Bytes) -> bool {
        let width = match self {
            Self::Doubles(_) => size_of::<f64>(),
            Self::Fixed32s(_) => size_of::<u32>(),
        };
        let mut ahead = bytes.clone();
        let length = decode_varint(&mut ahead).ok().and_then(|length| usize::try_from(length).ok());
        let Some(length) = length.filter(|length| *length <= ahead.len() && length % width == 0) else {
            return false;
        };
        let elements = ahead.split_to(length);
        match self {
            Self::Doubles(column) => {
                column.extend(elements.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)));
            }
            Self::Fixed32s(column) => {
                column.extend(elements.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes)));
            }
        }
        *bytes = ahead;
        true
    }

    fn swap(self, other: Self) {
        match (self, other) {
            (Self::Doubles(a), Self::Doubles(b)) => std::mem::swap(a, b),
            (Self::Fixed32s(a), Self::Fixed32s(b)) => std::mem::swap(a, b),
            _ => unreachable!("the columns of a tag have one type"),
        }
    }

    fn put(self, tag: u32, buffer: &mut impl BufMut) {
        match self {
            Self::Doubles(column) => put(tag, column, buffer, |buffer, &element| buffer.put_f64_le(element)),
            Self::Fixed32s(column) => put(tag, column, buffer, |buffer, &element| buffer.put_u32_le(element)),
        }
    }
}

fn put<T: bytemuck::NoUninit, B: BufMut>(tag: u32, column: &[T], buffer: &mut B, put_one: fn(&mut B, &T)) {
    if column.is_empty() {
        return;
    }
    encode_key(tag, WireType::LengthDelimited, buffer);
    encode_varint(size_of_val(column) as u64, buffer);
    if cfg!(target_endian = "little") {
        buffer.put_slice(bytemuck::cast_slice(column));
    } else {
        column.iter().for_each(|element| put_one(buffer, element));
    }
}

#[cfg(test)]
mod tests {
    use prost_types::{FileDescriptorSet, field_descriptor_proto::Type};

    use super::*;
    use crate::{
        Accuracy, FILE_DESCRIPTOR_SET, QueryContactsRequest, QueryContactsResponse, columnar_messages,
    };

    /// Fills every column with its own values, including unusual bit patterns.
    fn filled<M: Columnar>(mut message: M) -> M {
        for &tag in M::COLUMNS {
            match message.column(tag).expect("each listed tag has a column") {
                ColumnMut::Doubles(column) => {
                    column.extend((0..100 + tag).map(|i| f64::from(i) / f64::from(tag)));
                    column.extend([f64::NAN, -0.0, f64::INFINITY, 5e-324]);
                }
                ColumnMut::Fixed32s(column) => column.extend((0..100).map(|i| u32::MAX - tag * i)),
            }
        }
        message
    }

    fn request() -> QueryContactsRequest {
        filled(QueryContactsRequest {
            request_id: 7,
            inherit: true,
            hull_ids: vec![vec![3; 32], vec![4; 32]],
            margin: 0.25,
            accuracy: Some(Accuracy { max_points: 9, feature_angle: Some(0.0), ..Accuracy::default() }),
            outputs: vec![1, 300, 8],
            ..Default::default()
        })
    }

    fn response() -> QueryContactsResponse {
        filled(QueryContactsResponse {
            request_id: 8,
            outcomes: vec![1; 300],
            flags: vec![2; 300],
            feature_kinds: vec![3; 600],
            ..Default::default()
        })
    }

    /// Compares bit by bit, NaN included.
    #[track_caller]
    fn assert_same<M: Columnar>(found: &M, expected: &M) {
        assert_eq!(found.encode_to_vec(), expected.encode_to_vec());
    }

    fn written<M: Columnar>(mut message: M) -> Bytes {
        let (mut buffer, before) = (Vec::new(), message.encode_to_vec());
        encode(&mut message, &mut buffer);
        assert_eq!(message.encode_to_vec(), before);
        buffer.into()
    }

    /// Catches a column with the tag of another, of the wrong type, or missing from the list. A missing
    /// column would still be read by prost, only slowly.
    #[test]
    fn the_columns_are_those_of_the_contract() {
        let set = FileDescriptorSet::decode(FILE_DESCRIPTOR_SET).unwrap();
        let mut checked = 0;
        for (name, tags) in columnar_messages() {
            let message = set.file.iter().flat_map(|file| &file.message_type).find(|m| m.name() == name);
            let packed = message.unwrap().field.iter().filter(|field| {
                field.label() == prost_types::field_descriptor_proto::Label::Repeated
                    && matches!(field.r#type(), Type::Double | Type::Fixed32)
            });
            assert_eq!(packed.map(|field| field.number() as u32).collect::<Vec<_>>(), tags, "{name}");
            checked += tags.len();
        }
        assert_eq!(checked, 14 + 25);
    }

    /// Catches bytes that prost reads differently from the written message, a length that differs from the
    /// announced one, and an empty column that is sent.
    #[test]
    fn what_is_written_prost_reads() {
        let bytes = written(request());
        assert_eq!(bytes.len(), request().encoded_len());
        assert_same(&QueryContactsRequest::decode(bytes).unwrap(), &request());
        let bytes = written(response());
        assert_eq!(bytes.len(), response().encoded_len());
        assert_same(&QueryContactsResponse::decode(bytes).unwrap(), &response());
        assert!(written(QueryContactsResponse::default()).is_empty());
    }

    /// Catches a message of prost or of any other sender that is read differently: columns in their place,
    /// split, unpacked, empty, mixed, or with unknown fields between them.
    #[test]
    fn what_any_sender_writes_is_read_as_prost_reads_it() {
        assert_same(&decode::<QueryContactsRequest>(request().encode_to_vec().into()).unwrap(), &request());
        assert_same(
            &decode::<QueryContactsResponse>(response().encode_to_vec().into()).unwrap(),
            &response(),
        );

        let mut mixed = Vec::new();
        for part in 0..5u32 {
            // The column is packed, and split by other fields and by an unknown one.
            encode_key(5, WireType::LengthDelimited, &mut mixed);
            encode_varint(u64::from(8 * part), &mut mixed);
            (0..part).for_each(|i| mixed.put_f64_le(f64::from(10 * part + i)));
            encode_key(5, WireType::SixtyFourBit, &mut mixed);
            mixed.put_f64_le(f64::from(part) + 0.5);
            encode_key(7, WireType::ThirtyTwoBit, &mut mixed);
            mixed.put_u32_le(part);
            encode_key(7, WireType::LengthDelimited, &mut mixed);
            encode_varint(8, &mut mixed);
            mixed.put_u32_le(100 + part);
            mixed.put_u32_le(200 + part);
            encode_key(900, WireType::LengthDelimited, &mut mixed);
            encode_varint(3, &mut mixed);
            mixed.put_slice(&[1, 2, 3]);
        }
        let found = decode::<QueryContactsRequest>(mixed.clone().into()).unwrap();
        assert_same(&found, &QueryContactsRequest::decode(&mixed[..]).unwrap());
        assert_eq!((found.positions.len(), found.pairs.len()), (5 + 10, 15));
        assert_eq!(found.positions[..4], [0.5, 10.0, 1.5, 20.0]);
    }

    /// Catches truncated or changed bytes that are accepted although prost refuses them, that are read
    /// differently from prost, or that make the reader panic.
    #[test]
    fn damaged_bytes_are_refused_as_prost_refuses_them() {
        let mut short = request();
        for &tag in QueryContactsRequest::COLUMNS {
            match short.column(tag).unwrap() {
                ColumnMut::Doubles(column) => column.truncate(3),
                ColumnMut::Fixed32s(column) => column.truncate(3),
            }
        }
        let good = short.encode_to_vec();
        let cut = (0..good.len()).map(|end| good[..end].to_vec());
        let flipped = (0..8 * good.len()).map(|bit| {
            let mut bytes = good.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            bytes
        });
        let (mut read, mut refused) = (0, 0);
        for bytes in cut.chain(flipped) {
            let ours = decode::<QueryContactsRequest>(bytes.clone().into());
            match (ours, QueryContactsRequest::decode(&bytes[..])) {
                (Ok(ours), Ok(theirs)) => {
                    assert_same(&ours, &theirs);
                    read += 1;
                }
                (Err(_), Err(_)) => refused += 1,
                (ours, theirs) => panic!("{bytes:?}: {ours:?}, prost {theirs:?}"),
            }
        }
        assert!(read > 500 && refused > 200, "{read} read, {refused} refused");
    }
}

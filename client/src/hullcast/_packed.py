"""Message classes in which packed numeric columns are declared as `bytes`.

On the wire, a packed `repeated double` or `repeated fixed32` has the same bytes as a `bytes` field
that contains the numbers in little-endian order. With this declaration a column is copied once
between the message and a numpy array; otherwise each element would become a Python object. The
declarations are derived from the generated descriptors, in a descriptor pool of their own.

A sender may legally split a packed field into several records, or not pack it at all. A `bytes`
field would then keep only the last record, or none. Therefore the reader of such a column must know
its length, and parse the message again with the original declaration if the length is wrong
(`_answers.py`). Columns of unknown length keep their original declaration.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
from google.protobuf import (
    descriptor_pb2,
    descriptor_pool,
    field_mask_pb2,
    message_factory,
)

from ._pb import contacts_pb2, hulls_pb2

_Field = descriptor_pb2.FieldDescriptorProto
_PACKED_TYPES: dict[int, str] = {_Field.TYPE_DOUBLE: "<f8", _Field.TYPE_FIXED32: "<u4"}

# Columns whose length the reader cannot know in advance.
_KEEP = {
    "QueryContactsResponse": {"missing_hulls", "invalid_bodies", "ended_pairs"},
    "HullInfo": {"contraction_point", "center_of_mass", "inertia"},
    "HullRecord": {"vertices", "vertex_indices", "face_offsets", "face_vertices", "face_normals"},
}


def _pool_of_bytes() -> descriptor_pool.DescriptorPool:
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(field_mask_pb2.DESCRIPTOR.serialized_pb)
    for module in (hulls_pb2, contacts_pb2):
        file = descriptor_pb2.FileDescriptorProto.FromString(module.DESCRIPTOR.serialized_pb)
        for message in file.message_type:
            kept = _KEEP.get(message.name, ())
            for field in message.field:
                repeated = field.label == _Field.LABEL_REPEATED
                if repeated and field.type in _PACKED_TYPES and field.name not in kept:
                    field.type = _Field.TYPE_BYTES
                    field.label = _Field.LABEL_OPTIONAL
        pool.AddSerializedFile(file.SerializeToString())
    return pool


_pool = _pool_of_bytes()


def _message(name: str) -> Any:
    return message_factory.GetMessageClass(_pool.FindMessageTypeByName(f"hullcast.v1.{name}"))


#: Like `contacts_pb2.QueryContactsResponse`, with the columns of known length as bytes.
QueryContactsResponse = _message("QueryContactsResponse")
#: Like `hulls_pb2.RegisterHullsRequest`, with vertices and contraction point as bytes.
RegisterHullsRequest = _message("RegisterHullsRequest")

#: The numpy type of each column of a response.
COLUMN_TYPES = {
    field.name: _PACKED_TYPES[field.type]
    for field in contacts_pb2.QueryContactsResponse.DESCRIPTOR.fields
    if field.type in _PACKED_TYPES and field.name not in _KEEP["QueryContactsResponse"]
}

_request = descriptor_pb2.DescriptorProto()
contacts_pb2.QueryContactsRequest.DESCRIPTOR.CopyToProto(_request)
#: The field number of each column of a request.
_REQUEST_COLUMNS = {
    field.name: field.number
    for field in _request.field
    if field.type in _PACKED_TYPES and field.label == _Field.LABEL_REPEATED
}


def request(
    rest: contacts_pb2.QueryContactsRequest, columns: Iterable[tuple[str, npt.NDArray[Any]]]
) -> bytes:
    """Serialises a QueryContactsRequest that has the fields of `rest` and the given columns.

    The columns are appended here rather than by protobuf, because each further large buffer costs
    more in page faults than all the other work. This function allocates one.
    """
    parts: list[Any] = [rest.SerializeToString()]
    for name, values in columns:
        if values.size:
            # A record: the tag (wire type 2, length-delimited), the length, the array's bytes.
            tag = _REQUEST_COLUMNS[name] << 3 | 2
            parts += [_varint(tag) + _varint(values.nbytes), np.ascontiguousarray(values)]
    return b"".join(parts)


def _varint(number: int) -> bytes:
    """Encodes a number as a protobuf varint: seven bits per byte, the lowest first."""
    coded = bytearray()
    while number > 127:
        coded.append(number & 127 | 128)
        number >>= 7
    coded.append(number)
    return bytes(coded)

"""Messages whose packed numeric columns are `bytes`.

On the wire a packed `repeated double` or `repeated fixed32` is the same bytes
as a `bytes` field that holds the numbers little-endian. Declared so, a column
goes between message and numpy array in one copy instead of one Python object
an element. The declarations are derived from the generated descriptors, in a
pool of their own.

A sender may however split a packed field into several records, or not pack it
at all; both are legal for the real type, while a `bytes` field keeps the last
record or none. So whoever reads such a column has to know its length, and
reads the message again with its real type where the length is wrong
(`_answers.py`). Columns of unknown length keep their real type.
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

# Of no length that a reader could foretell.
_KEEP = {
    "QueryContactsResponse": {"missing_hulls", "invalid_bodies"},
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


#: As `contacts_pb2.QueryContactsResponse`, columns of foreseeable length as bytes.
QueryContactsResponse = _message("QueryContactsResponse")
#: As `hulls_pb2.RegisterHullsRequest`, vertices and contraction point as bytes.
RegisterHullsRequest = _message("RegisterHullsRequest")

#: Per column of an answer its numpy type.
COLUMN_TYPES = {
    field.name: _PACKED_TYPES[field.type]
    for field in contacts_pb2.QueryContactsResponse.DESCRIPTOR.fields
    if field.type in _PACKED_TYPES and field.name not in _KEEP["QueryContactsResponse"]
}

_request = descriptor_pb2.DescriptorProto()
contacts_pb2.QueryContactsRequest.DESCRIPTOR.CopyToProto(_request)
#: Of each column of a request its number.
_REQUEST_COLUMNS = {
    field.name: field.number
    for field in _request.field
    if field.type in _PACKED_TYPES and field.label == _Field.LABEL_REPEATED
}


def request(
    rest: contacts_pb2.QueryContactsRequest, columns: Iterable[tuple[str, npt.NDArray[Any]]]
) -> bytes:
    """A serialised QueryContactsRequest: `rest`, and columns that it does not have.

    Written here, since each large buffer that protobuf takes on the way costs
    more in page faults than all else: this makes one.
    """
    parts: list[Any] = [rest.SerializeToString()]
    for name, values in columns:
        if values.size:
            # Tag (wire type 2: so many bytes), length, and the array's own bytes.
            tag = _REQUEST_COLUMNS[name] << 3 | 2
            parts += [_varint(tag) + _varint(values.nbytes), np.ascontiguousarray(values)]
    return b"".join(parts)


def _varint(number: int) -> bytes:
    """Seven bits a byte, the lowest first."""
    coded = bytearray()
    while number > 127:
        coded.append(number & 127 | 128)
        number >>= 7
    coded.append(number)
    return bytes(coded)

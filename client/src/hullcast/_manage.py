"""Requests about the server and its stored hulls, and the checks of their responses."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _checked
from ._arguments import iterable, kind
from ._errors import Error, InvalidArgument
from ._hulls import Hull
from ._pb import hulls_pb2, server_pb2

INFO = "/hullcast.v1.ServerService/GetServerInfo"
LIST = "/hullcast.v1.HullService/ListHulls"
DELETE = "/hullcast.v1.HullService/DeleteHulls"
GET = "/hullcast.v1.HullService/GetHulls"

#: The number of hulls in one message; the default limit of a server is 16 times as high.
_PER_MESSAGE = 1024
#: The last moment that a `datetime` can represent (end of the year 9999), in Unix milliseconds.
_LAST_MOMENT = 253_402_300_799_999


@dataclass(frozen=True)
class ServerInfo:
    """A server's version, instruction set, threads and limits."""

    #: The version, such as "0.1.0".
    version: str
    #: The instruction set of the support mapping: "scalar", "avx2" or "avx512".
    instruction_set: str
    #: The number of threads that compute contacts.
    compute_threads: int
    #: The limits by name, such as "max_pairs_per_request". A value equal to its limit is allowed.
    limits: Mapping[str, int]
    #: The contract number, which rises whenever requests get fields that change answers. 0 for a
    #: server from before find sessions, which need 1.
    contract: int = 0

    @classmethod
    def read(cls, data: bytes) -> ServerInfo:
        """Reads the response of GetServerInfo."""
        answer = _checked.parsed(server_pb2.GetServerInfoResponse.FromString, data)
        limits = {
            field.name: int(getattr(answer.limits, field.name))
            for field in answer.limits.DESCRIPTOR.fields
        }
        return cls(
            answer.version,
            answer.instruction_set,
            answer.compute_threads,
            MappingProxyType(limits),
            answer.contract,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return _server_info, (
            self.version,
            self.instruction_set,
            self.compute_threads,
            dict(self.limits),
            self.contract,
        )


def max_calls(data: bytes) -> int:
    """The most calls at once on one connection, by a response of GetServerInfo; 0 if unknown."""
    try:
        return ServerInfo.read(data).limits["max_streams_per_connection"]
    except Error:  # the caller that asked for the server's information reports it
        return 0


def _server_info(
    version: str, simd: str, threads: int, limits: dict[str, int], contract: int = 0
) -> ServerInfo:
    return ServerInfo(version, simd, threads, MappingProxyType(limits), contract)


@dataclass(frozen=True)
class StoredHull:
    """A hull in a server's store."""

    #: The 32 bytes of its id, which a `Scene` accepts in place of a `Hull`.
    id: bytes
    #: When the hull was stored, in UTC.
    created: datetime
    #: The hull's size in the store, in bytes.
    size: int

    def __repr__(self) -> str:
        when = f"{self.created:%Y-%m-%d %H:%M:%S}"
        return f"StoredHull({self.id.hex()[:12]}: {self.size} bytes, {when} UTC)"


def list_request(token: str) -> bytes:
    """The request for one page of stored hulls."""
    return hulls_pb2.ListHullsRequest(page_token=token).SerializeToString()


def read_page(data: bytes, before: bytes) -> tuple[list[StoredHull], str]:
    """Reads one page of stored hulls, and the token of the next page; "" after the last page.

    Args:
        data: the response.
        before: the last id of the previous pages. The ids must ascend, so the pages come to an end.
    """
    answer = _checked.parsed(hulls_pb2.ListHullsResponse.FromString, data)
    found: list[StoredHull] = []
    for hull in answer.hulls:
        if len(hull.id) != 32 or hull.id <= before:
            raise _checked.malformed("hulls is not sorted by ids of 32 bytes")
        if not 0 <= hull.created_unix_ms <= _LAST_MOMENT:
            raise _checked.malformed(f"created_unix_ms is {hull.created_unix_ms}")
        before = hull.id
        created = datetime.fromtimestamp(0, timezone.utc)
        created += timedelta(milliseconds=hull.created_unix_ms)
        found.append(StoredHull(hull.id, created, hull.bytes))
    if answer.next_page_token and not found:
        raise _checked.malformed("a page without hulls names a next page")
    return found, answer.next_page_token


def ids_of(hulls: Any) -> list[bytes]:
    """The ids of one hull or of an iterable of hulls, given as `Hull`, `StoredHull` or bytes."""
    single = isinstance(hulls, (Hull, StoredHull, bytes))
    if not single and (isinstance(hulls, (str, Mapping)) or not iterable(hulls)):
        raise InvalidArgument(
            f"expected hulls or their ids, got {kind(hulls)}", reason="WRONG_TYPE", field="hulls"
        )
    ids: list[bytes] = []
    given: Iterable[Any] = (hulls,) if single else hulls  # pyright: ignore[reportUnknownVariableType]
    for i, hull in enumerate(given):
        id = hull if isinstance(hull, bytes) else getattr(hull, "id", None)
        if not isinstance(id, bytes) or len(id) != 32:
            raise InvalidArgument(
                f"expected a Hull or the 32 bytes of its id, got {kind(hull)}",
                reason="NOT_A_HULL",
                field="hulls",
                index=i,
            )
        ids.append(id)
    return ids


def delete_parts(ids: Sequence[bytes]) -> Iterator[Sequence[bytes]]:
    """Splits ids into those of each message."""
    for start in range(0, len(ids), _PER_MESSAGE):
        yield ids[start : start + _PER_MESSAGE]


def delete_request(ids: Sequence[bytes]) -> bytes:
    """The request that removes some hulls."""
    return hulls_pb2.DeleteHullsRequest(ids=ids).SerializeToString()


def read_deleted(data: bytes, count: int) -> list[bool]:
    """For each hull of a message, whether it was in the store."""
    answer = _checked.parsed(hulls_pb2.DeleteHullsResponse.FromString, data)
    _checked.length("deleted", len(answer.deleted), count)
    return list(answer.deleted)


def faces_request(id: bytes) -> bytes:
    """The request for a hull's vertices and faces."""
    request = hulls_pb2.GetHullsRequest(ids=[id])
    request.field_mask.paths.extend(["vertices", "faces"])
    return request.SerializeToString()


def read_faces(data: bytes, id: bytes) -> tuple[npt.NDArray[np.uint32], ...]:
    """The corners of each face, as indices of the registered points."""
    answer = _checked.parsed(hulls_pb2.GetHullsResponse.FromString, data)
    _checked.echoed("hulls", [record.id for record in answer.hulls], [id])
    (record,) = answer.hulls
    if not record.found:
        raise Error("the server does not have this hull", reason="UNKNOWN_HULL")
    offsets = np.array(record.face_offsets, dtype="<u4")
    corners = np.array(record.face_vertices, dtype="<u4")
    normals = np.array(record.face_normals, dtype="<f8")
    ids = np.array(record.vertex_indices, dtype="<u4")
    _checked.mesh("hulls[0]", ids, offsets, corners, normals)
    ends = itertools.pairwise(offsets.tolist())
    return tuple(corners[start:stop] for start, stop in ends)

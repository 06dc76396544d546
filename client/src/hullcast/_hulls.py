"""Hulls: their identity, and what registering them asks and answers."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from . import _arrays, _packed
from ._arrays import Floats
from ._errors import HullRejected, InvalidArgument
from ._pb import hulls_pb2

#: Of vertices in one message: far below the server's message limit, large
#: enough that the call costs nothing beside the hulls.
_BYTES_PER_MESSAGE = 8 << 20
_HULLS_PER_MESSAGE = 1024


@dataclass(frozen=True)
class Hull:
    """A registered hull. Lengths are the caller's units, in the hull's own frame."""

    #: SHA-256 of the content: the same on every server.
    id: bytes
    #: (3,): the point about which it grows; the centre of mass unless given.
    contraction_point: Floats = field(compare=False, repr=False)
    #: Of the largest ball about the contraction point inside, rounded down.
    inradius: float = field(compare=False)
    #: Of the smallest ball about the contraction point around, rounded up.
    circumradius: float = field(compare=False)
    volume: float = field(compare=False)
    #: Extreme vertices kept.
    vertex_count: int = field(compare=False)
    #: After merging coplanar triangles.
    face_count: int = field(compare=False)
    edge_count: int = field(compare=False)
    #: How far merged faces are from planar, plus what simplification cost.
    geometric_error: float = field(compare=False, repr=False)
    #: (3,)
    center_of_mass: Floats = field(compare=False, repr=False)
    #: (3, 3): about the centre of mass, at unit density.
    inertia: Floats = field(compare=False, repr=False)


def hull_id(
    vertices: Any,
    contraction_point: Any = None,
    *,
    max_vertices: int | None = None,
    max_deviation: float | None = None,
) -> bytes:
    """The 32 bytes by which every server knows the hull of these points.

    They are the SHA-256 of the byte string that docs/identity.md states.

    Args:
        vertices: (n, 3), in the order in which they are registered; or an
            object with such `.vertices`, as trimesh's.
        contraction_point: (3,), or None for the centre of mass.
        max_vertices, max_deviation: the simplification asked for, if any.
    """
    # Adding 0.0 turns -0.0 into 0.0 and changes nothing else.
    points = points_of(vertices) + 0.0
    parts = [b"hullcast", struct.pack("<I", 1)]
    if contraction_point is None:
        parts.append(b"\0")
    else:
        center = _arrays.floats("contraction_point", contraction_point, 3) + 0.0
        parts += [b"\1", center.tobytes()]
    if max_vertices is None and max_deviation is None:
        parts.append(b"\0")
    else:
        parts.append(b"\1")
        for form, value in (("<I", max_vertices), ("<d", max_deviation)):
            parts.append(b"\0" if value is None else b"\1" + struct.pack(form, value))
    parts += [struct.pack("<I", len(points)), points.tobytes()]
    return hashlib.sha256(b"".join(parts)).digest()


def points_of(hull: Any, name: str = "vertices") -> Floats:
    """(n, 3) of an array or of an object with `.vertices`."""
    return _arrays.floats(name, getattr(hull, "vertices", hull), None, 3)


class Registration:
    """One `register` call: the messages to send and the answer they make."""

    def __init__(
        self,
        hulls: Iterable[Any],
        contraction_points: Any = None,
        max_vertices: int | None = None,
        max_deviation: float | None = None,
    ) -> None:
        if hasattr(hulls, "vertices") or (isinstance(hulls, np.ndarray) and hulls.ndim == 2):
            raise InvalidArgument(
                "register takes a list of hulls", reason="NOT_A_LIST", field="hulls"
            )
        self._points = [points_of(hull, f"hulls[{i}]") for i, hull in enumerate(hulls)]
        if contraction_points is None:
            contraction_points = [None] * len(self._points)
        if len(contraction_points) != len(self._points):
            raise InvalidArgument(
                f"{len(contraction_points)} for {len(self._points)} hulls",
                reason="LENGTH_MISMATCH",
                field="contraction_points",
            )
        self._centers = [
            None if center is None else _arrays.floats(f"contraction_points[{i}]", center, 3)
            for i, center in enumerate(contraction_points)
        ]
        self._max_vertices = max_vertices
        self._max_deviation = max_deviation

    def requests(self) -> Iterator[bytes]:
        """The messages, in order, none of them large."""
        request, size = _packed.RegisterHullsRequest(), 0
        for points, center in zip(self._points, self._centers, strict=True):
            too_large = size + points.nbytes > _BYTES_PER_MESSAGE
            if request.hulls and (too_large or len(request.hulls) == _HULLS_PER_MESSAGE):
                yield request.SerializeToString()
                request, size = _packed.RegisterHullsRequest(), 0
            hull = request.hulls.add(vertices=points.tobytes())
            if center is not None:
                hull.contraction_point = center.tobytes()
            if self._max_vertices is not None:
                hull.simplification.max_vertices = self._max_vertices
            if self._max_deviation is not None:
                hull.simplification.max_deviation = self._max_deviation
            size += points.nbytes
        if request.hulls:
            yield request.SerializeToString()

    def read(self, answers: Sequence[bytes]) -> list[Hull]:
        """The hulls, in the call's order.

        Raises:
            HullRejected: some were refused; it has the others.
        """
        results: list[Any] = []
        for answer in answers:
            for result in hulls_pb2.RegisterHullsResponse.FromString(answer).results:
                if result.WhichOneof("result") == "hull":
                    results.append(_hull(result.hull))
                else:
                    results.append(_rejected(len(results), result.error))
        refused = [result for result in results if isinstance(result, HullRejected)]
        if not refused:
            return results
        first = refused[0]
        error = HullRejected(
            f"{first.message} ({len(refused)} of {len(results)} hulls refused)",
            reason=first.reason,
            field=first.field,
            index=first.index,
            point=first.point,
        )
        error.results = results
        raise error


def _rejected(place: int, error: hulls_pb2.HullError) -> HullRejected:
    return HullRejected(
        error.message,
        reason=error.reason,
        field=error.field,
        index=place,
        point=error.index if error.HasField("index") else None,
    )


def _hull(info: hulls_pb2.HullInfo) -> Hull:
    xx, yy, zz, xy, xz, yz = info.inertia
    return Hull(
        id=info.id,
        contraction_point=np.array(info.contraction_point),
        inradius=info.inradius,
        circumradius=info.circumradius,
        volume=info.volume,
        vertex_count=info.vertex_count,
        face_count=info.face_count,
        edge_count=info.edge_count,
        geometric_error=info.geometric_error,
        center_of_mass=np.array(info.center_of_mass),
        inertia=np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
    )

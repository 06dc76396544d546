"""Hulls: their identity, and what registering them asks and answers."""

from __future__ import annotations

import hashlib
import os
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from . import _arrays, _mesh, _packed
from ._arrays import Floats
from ._errors import HullRejected, InvalidArgument
from ._pb import hulls_pb2

#: Of vertices in one message: far below the server's message limit, large
#: enough that the call costs nothing beside the hulls.
_BYTES_PER_MESSAGE = 8 << 20
_HULLS_PER_MESSAGE = 1024


@dataclass(frozen=True, eq=False)
class Content:
    """All that a hull's identity is made of: what it can be registered by again."""

    #: (n, 3), not to be written to.
    points: Floats
    #: (3,), or None: the centre of mass.
    center: Floats | None = None
    max_vertices: int | None = None
    max_deviation: float | None = None


@dataclass(frozen=True, repr=False)
class Hull:
    """A registered hull. Lengths are the caller's units, in the hull's own frame.

    It keeps the points that it was registered with, so that it can be registered
    again where a server lost it; a `Scene` of ids keeps none.
    """

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
    #: What it was registered by.
    content: Content = field(compare=False, repr=False)

    @property
    def vertices(self) -> Floats:
        """(n, 3): the points as registered, which bases, features and point ids number."""
        return self.content.points

    def __repr__(self) -> str:
        return (
            f"Hull({self.id.hex()[:12]}: {self.vertex_count} vertices, {self.face_count} faces, "
            f"radii {self.inradius:.4g} to {self.circumradius:.4g}, volume {self.volume:.4g})"
        )


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
        self, contents: Sequence[Content], volumes: Sequence[_mesh.Volume | None] = ()
    ) -> None:
        self._contents = contents
        self._volumes = volumes

    @classmethod
    def of(
        cls,
        hulls: Iterable[Any],
        contraction_points: Any = None,
        max_vertices: int | None = None,
        max_deviation: float | None = None,
    ) -> Registration:
        """The call of `Client.register`'s arguments."""
        if hasattr(hulls, "vertices") or (isinstance(hulls, np.ndarray) and hulls.ndim == 2):
            raise InvalidArgument(
                "register takes a list of hulls", reason="NOT_A_LIST", field="hulls"
            )
        if isinstance(hulls, (str, os.PathLike)):
            raise InvalidArgument(
                "register takes a list of files", reason="NOT_A_LIST", field="hulls"
            )
        shapes = [_shape(hull) for hull in hulls]
        if contraction_points is None:
            contraction_points = [None] * len(shapes)
        if len(contraction_points) != len(shapes):
            raise InvalidArgument(
                f"{len(contraction_points)} for {len(shapes)} hulls",
                reason="LENGTH_MISMATCH",
                field="contraction_points",
            )
        contents: list[Content] = []
        for i, (shape, center) in enumerate(zip(shapes, contraction_points, strict=True)):
            if center is not None:
                center = _arrays.floats(f"contraction_points[{i}]", center, 3)
            if isinstance(shape, Hull) and center is None and max_vertices is max_deviation is None:
                contents.append(shape.content)
                continue
            # A copy of the caller's array, which may change later.
            points = _arrays.frozen(points_of(shape, f"hulls[{i}]"))
            contents.append(Content(points, center, max_vertices, max_deviation))
        volumes = [
            _mesh.closed(f"hulls[{i}]", content.points, getattr(shape, "faces", None))
            for i, (shape, content) in enumerate(zip(shapes, contents, strict=True))
        ]
        return cls(contents, volumes)

    def requests(self) -> Iterator[bytes]:
        """The messages, in order, none of them large."""
        request, size = _packed.RegisterHullsRequest(), 0
        for content in self._contents:
            too_large = size + content.points.nbytes > _BYTES_PER_MESSAGE
            if request.hulls and (too_large or len(request.hulls) == _HULLS_PER_MESSAGE):
                yield request.SerializeToString()
                request, size = _packed.RegisterHullsRequest(), 0
            hull = request.hulls.add(vertices=content.points.tobytes())
            if content.center is not None:
                hull.contraction_point = content.center.tobytes()
            if content.max_vertices is not None:
                hull.simplification.max_vertices = content.max_vertices
            if content.max_deviation is not None:
                hull.simplification.max_deviation = content.max_deviation
            size += content.points.nbytes
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
                place = len(results)
                if result.WhichOneof("result") == "hull":
                    results.append(_hull(result.hull, self._contents[place]))
                else:
                    results.append(_rejected(place, result.error))
        for i, (volume, hull) in enumerate(zip(self._volumes, results, strict=False)):
            if volume is not None and isinstance(hull, Hull):
                _mesh.warn_unless_convex(f"hulls[{i}]", volume, hull.volume)
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


def _shape(hull: Any) -> Any:
    """What has the points: a mesh file's mesh, else the thing itself."""
    return _mesh.load(hull) if isinstance(hull, (str, os.PathLike)) else hull


def _rejected(place: int, error: hulls_pb2.HullError) -> HullRejected:
    return HullRejected(
        error.message,
        reason=error.reason,
        field=error.field,
        index=place,
        point=error.index if error.HasField("index") else None,
    )


def _hull(info: hulls_pb2.HullInfo, content: Content) -> Hull:
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
        content=content,
    )

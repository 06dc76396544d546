"""Registering: what it asks and answers."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, cast

import numpy as np

from . import _arrays, _convexity, _mesh, _packed
from ._errors import HullRejected, InvalidArgument
from ._hulls import Content, Hull, Planarity, planarity_of, points_of
from ._pb import hulls_pb2

#: Of vertices in one message: far below the server's message limit, large
#: enough that the call costs nothing beside the hulls.
_BYTES_PER_MESSAGE = 8 << 20
_HULLS_PER_MESSAGE = 1024


class Registration:
    """One `register` call: the messages to send and the answer they make."""

    def __init__(
        self,
        contents: Sequence[Content],
        dents: Sequence[_convexity.Dents | None] = (),
        labels: Sequence[str] = (),
    ) -> None:
        self._contents = contents
        #: Per hull how its mesh differs from it, or None.
        self._dents = dents
        #: Per hull what warnings call it, or "".
        self._labels = labels

    @classmethod
    def of(
        cls,
        hulls: Iterable[Any],
        contraction_points: Any = None,
        max_vertices: int | None = None,
        max_deviation: float | None = None,
        planarity: Planarity = "default",
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
        shapes = [shape_of(hull) for hull in hulls]
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
            share = planarity_of(planarity)
            if isinstance(shape, Hull):
                share = planarity_of(planarity, shape.content.planarity)
                as_it_is = center is None and max_vertices is max_deviation is None
                if as_it_is and share == shape.content.planarity:
                    contents.append(shape.content)
                    continue
            # A copy of the caller's array, which may change later.
            points = _arrays.frozen(points_of(shape, f"hulls[{i}]"))
            contents.append(Content(points, center, max_vertices, max_deviation, share))
        dents = [
            _mesh.dents(f"hulls[{i}]", content.points, getattr(shape, "faces", None))
            for i, (shape, content) in enumerate(zip(shapes, contents, strict=True))
        ]
        return cls(contents, dents, [_label(shape, i) for i, shape in enumerate(shapes)])

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
            if content.planarity is not None:
                hull.planarity = content.planarity
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
                    results.append(_rejected(place, result.error, self._labels))
        for i, (dents, hull) in enumerate(zip(self._dents, results, strict=False)):
            if dents is not None and isinstance(hull, Hull):
                _mesh.warn(f"hulls[{i}]", self._labels[i], dents)
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


def shape_of(hull: Any) -> Any:
    """What has the points: a mesh file's mesh, else the thing itself."""
    if isinstance(hull, (str, os.PathLike)):
        return _mesh.load(cast("str | os.PathLike[str]", hull))
    return hull


def _label(shape: Any, place: int) -> str:
    """What messages call a shape: a robot's body by its link, a file's mesh by its name."""
    label = shape.label if isinstance(shape, _mesh.Mesh) else ""
    return label if label.startswith("link ") else f"hulls[{place}]" + (label and f" ({label})")


def _rejected(place: int, error: hulls_pb2.HullError, labels: Sequence[str]) -> HullRejected:
    label = labels[place] if place < len(labels) else ""
    return HullRejected(
        error.message if label in ("", f"hulls[{place}]") else f"{label}: {error.message}",
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
        deviation=info.deviation,
        planarity=info.planarity,
        center_of_mass=np.array(info.center_of_mass),
        inertia=np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
        content=content,
    )

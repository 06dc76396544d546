"""The requests of `register`, and the reading of their responses."""

from __future__ import annotations

import numbers
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from . import _arguments, _arrays, _checked, _convexity, _files, _mesh, _packed
from ._arguments import counted, is_masked, is_real, iterable, kind, plain
from ._errors import HullRejected, InvalidArgument
from ._hulls import Content, Hull, Planarity, faces_of, mesh_of, planarity_of, points_of
from ._pb import hulls_pb2
from ._query import Span

if TYPE_CHECKING:
    from ._connection import Home

#: The number of bytes of vertices in one message. It is far below the server's message limit, and
#: large enough that the cost of the call is small beside that of the hulls.
_BYTES_PER_MESSAGE = 8 << 20
_HULLS_PER_MESSAGE = 1024


class Registration:
    """One `register` call: the messages to send, and the result of their responses."""

    def __init__(
        self,
        contents: Sequence[Content],
        dents: Sequence[_convexity.Dents | None] = (),
        labels: Sequence[str] = (),
    ) -> None:
        self._contents = contents
        #: For each hull, how its mesh differs from it, or None.
        self._dents = dents
        #: For each hull, its name in warnings, or "".
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
        """Makes the call from the arguments of `Client.register`."""
        shapes = shapes_of(hulls)
        _arguments.ordered("contraction_points", contraction_points)
        if max_vertices is not None:
            max_vertices = _arguments.integer("max_vertices", max_vertices, 4, 2**32 - 1)
        if max_deviation is not None:
            max_deviation = _arguments.number("max_deviation", max_deviation, 0)
        if contraction_points is None:
            contraction_points = [None] * len(shapes)
        elif isinstance(contraction_points, (str, bytes, Mapping)) or not iterable(
            contraction_points
        ):
            raise InvalidArgument(
                f"expected one point (3,) or None per hull, got {kind(contraction_points)}",
                reason="WRONG_TYPE",
                field="contraction_points",
            )
        centres: list[Any] = list(contraction_points)  # pyright: ignore[reportUnknownArgumentType]
        if len(centres) != len(shapes):
            raise InvalidArgument(
                f"{counted(len(centres), 'entry', 'entries')} for {counted(len(shapes), 'hull')}, "
                "expected one (a point or None) per hull",
                reason="LENGTH_MISMATCH",
                field="contraction_points",
            )
        contents: list[Content] = []
        for i, (shape, centre) in enumerate(zip(shapes, centres, strict=True)):
            if centre is not None:
                centre = _arrays.frozen(_arrays.floats(f"contraction_points[{i}]", centre, 3))
            share = planarity_of(planarity)
            if isinstance(shape, Hull):
                share = planarity_of(planarity, shape.content.planarity)
                as_it_is = centre is None and max_vertices is max_deviation is None
                if as_it_is and share == shape.content.planarity:
                    contents.append(shape.content)
                    continue
            # Copy the caller's array, which may change later.
            points = _arrays.frozen(points_of(shape, f"hulls[{i}]"))
            contents.append(Content(points, centre, max_vertices, max_deviation, share))
        dents = [
            _mesh.dents(f"hulls[{i}]", content.points, _faces(shape, f"hulls[{i}]"))
            for i, (shape, content) in enumerate(zip(shapes, contents, strict=True))
        ]
        return cls(contents, dents, [_label(shape, i) for i, shape in enumerate(shapes)])

    def spans(self) -> list[Span]:
        """Splits the hulls into spans, one per message. A message is only large if a hull is."""
        spans: list[Span] = []
        start = size = 0
        for i, content in enumerate(self._contents):
            too_large = size + content.points.nbytes > _BYTES_PER_MESSAGE
            if i > start and (too_large or i - start == _HULLS_PER_MESSAGE):
                spans.append(Span(start, i))
                start, size = i, 0
            size += content.points.nbytes
        if self._contents:
            spans.append(Span(start, len(self._contents)))
        return spans

    def request(self, span: Span) -> bytes:
        """The message that registers the hulls of a span."""
        request = _packed.RegisterHullsRequest()
        for content in self._contents[span.start : span.stop]:
            hull = request.hulls.add(vertices=content.points.tobytes())
            if content.centre is not None:
                hull.contraction_point = content.centre.tobytes()
            if content.max_vertices is not None:
                hull.simplification.max_vertices = content.max_vertices
            if content.max_deviation is not None:
                hull.simplification.max_deviation = content.max_deviation
            if content.planarity is not None:
                hull.planarity = content.planarity
        return request.SerializeToString()

    def named(self, error: InvalidArgument, span: Span) -> InvalidArgument:
        """Adds the hull's name to a MESSAGE_TOO_LARGE error; returns other errors as is."""
        if error.reason != "MESSAGE_TOO_LARGE":
            return error
        place = span.start
        points = len(self._contents[place].points)
        label = self._labels[place] if place < len(self._labels) else f"hulls[{place}]"
        return InvalidArgument(
            f"{label} has {counted(points, 'point')}: {error.message}; register fewer points, "
            "such as those of its convex hull",
            reason=error.reason,
            field="hulls",
            index=place,
        )

    def read(self, answers: Mapping[Span, bytes], home: Home | None = None) -> list[Hull]:
        """Reads the hulls from the responses, in the order of the call.

        Args:
            answers: the response to each message.
            home: how to reach the server of the client that registers the hulls.

        Raises:
            HullRejected: the server refused some hulls; the error has the others.
            ServerError: MALFORMED_ANSWER.
        """
        results: list[Any] = []
        for span in sorted(answers, key=lambda span: span.start):
            read = hulls_pb2.RegisterHullsResponse.FromString
            message = _checked.parsed(read, answers[span])
            _checked.length("results", len(message.results), span.stop - span.start)
            for result in message.results:
                place = len(results)
                known = result.WhichOneof("result")
                _checked.result_kind(place, known)
                if known == "hull":
                    content = self._contents[place]
                    _checked.hull(place, result.hull, content)
                    results.append(_hull(result.hull, content, home))
                else:
                    results.append(_rejected(place, result.error, self._labels))
        for i, (dents, hull) in enumerate(zip(self._dents, results, strict=False)):
            if dents is not None and isinstance(hull, Hull):
                _mesh.warn_of_dents(f"hulls[{i}]", self._labels[i], dents)
        refused = [result for result in results if isinstance(result, HullRejected)]
        if not refused:
            return results
        first = refused[0]
        error = HullRejected(
            f"{first.message} ({len(refused)} of {counted(len(results), 'hull')} refused)",
            reason=first.reason,
            field=first.field,
            index=first.index,
            point=first.point,
        )
        error.results = results
        raise error


def shapes_of(hulls: Any) -> list[Any]:
    """The shapes of one hull or of an iterable of hulls. A `trimesh.Scene` stands for its parts."""
    _arguments.ordered("hulls", hulls)
    if isinstance(hulls, Mapping):
        raise InvalidArgument(
            "expected a hull or a list of hulls, got a dict: give list(hulls.values())",
            reason="NOT_A_LIST",
            field="hulls",
        )
    if hulls is None or isinstance(hulls, (bytes, numbers.Number)):
        raise InvalidArgument(
            f"expected a hull or a list of hulls, got {kind(hulls)}",
            reason="NOT_A_LIST",
            field="hulls",
        )
    if _files.is_open_file(hulls):
        _files.path_of("hulls", hulls, "the path of a mesh file")
    if isinstance(hulls, Iterator):
        hulls = list(cast("Iterator[Any]", hulls))
    if _is_single(hulls):
        given = [hulls]
    elif iterable(hulls):
        given = list(hulls)
    else:
        raise InvalidArgument(
            "expected points (n, 3), an object with vertices, a file, or a list of these, got "
            f"{kind(hulls)}",
            reason="NOT_A_LIST",
            field="hulls",
        )
    shapes: list[Any] = []
    for i, hull in enumerate(given):
        if _files.is_open_file(hull):
            _files.path_of(f"hulls[{i}]", hull, "the path of a mesh file")
        shapes += _parts(hull) if _is_scene(hull) else [shape_of(hull, f"hulls[{i}]")]
    return shapes


def _is_single(hulls: Any) -> bool:
    """Whether the argument is one hull rather than several."""
    if isinstance(hulls, (Hull, str, os.PathLike)) or _is_scene(hulls):
        return True
    if hasattr(hulls, "vertices") or getattr(hulls, "ndim", 0) == 2:
        return True
    if getattr(hulls, "ndim", 2) < 2 and getattr(hulls, "dtype", None) != np.dtype(object):
        return True  # an array of numbers, which has the wrong shape for the points of a hull
    if not hasattr(hulls, "ndim") and hasattr(hulls, "__array__"):
        return True  # a data frame of polars or a table of pyarrow
    if isinstance(hulls, (list, tuple)) and hulls:
        # A list of rows of three numbers is the points of one hull. A list of numbers has the wrong
        # shape for one.
        entries = cast("Sequence[Any]", hulls)
        return all(map(_is_number, entries)) or _is_row(entries[0])
    return False


def _is_number(value: Any) -> bool:
    return is_masked(value) or is_real(plain(value))


def _is_row(value: Any) -> bool:
    """Whether a value is three numbers, the coordinates of one point."""
    is_list = hasattr(value, "__getitem__") and hasattr(value, "__len__")
    if not is_list or isinstance(value, (str, bytes, Mapping)) or hasattr(value, "vertices"):
        return False
    return getattr(value, "ndim", 1) == 1 and len(value) == 3 and all(map(_is_number, value))


def _is_scene(shape: Any) -> bool:
    """Whether the shape is a `trimesh.Scene`; trimesh need not be installed."""
    return hasattr(shape, "geometry") and callable(getattr(shape, "dump", None))


def _parts(scene: Any) -> list[Any]:
    """The meshes of a `trimesh.Scene`, each at its place in the scene."""
    parts = [part for part in scene.dump() if hasattr(part, "vertices")]
    if not parts:
        raise InvalidArgument(
            "the trimesh.Scene has no meshes", reason="NO_TRIANGLES", field="hulls"
        )
    return parts


def shape_of(hull: Any, field: str) -> Any:
    """The object that has the points: `hull` itself, or the mesh that is read from its path.

    `field` is the argument that names the hull, for messages.
    """
    if isinstance(hull, (str, os.PathLike)):
        return _mesh.load(cast("str | os.PathLike[str]", hull), field)
    return hull


def _faces(shape: Any, name: str) -> Any:
    """The faces of a mesh, as indices of the registered points.

    A `Hull` has none here, because it needs no check for convexity. An object that has
    only vertices has none either, so it cannot be checked.
    """
    is_checked = hasattr(shape, "vertices") and faces_of(shape)[1] is not None
    return mesh_of(shape, name)[1] if is_checked else None


def _label(shape: Any, place: int) -> str:
    """A shape's name in messages: the link for a robot's body, or index and file for a mesh."""
    label = shape.label if isinstance(shape, (_mesh.Mesh, _mesh.Points)) else ""
    return label if label.startswith("link ") else f"hulls[{place}]" + (label and f" ({label})")


def _rejected(place: int, error: hulls_pb2.HullError, labels: Sequence[str]) -> HullRejected:
    label = labels[place] if place < len(labels) else ""
    # The place of the error already has the hull's number.
    number = f"hulls[{place}]"
    name = label.removeprefix(number).strip(" ()") if label.startswith(number) else label
    return HullRejected(
        f"{name}: {error.message}" if name else error.message,
        reason=error.reason,
        field=error.field,
        index=place,
        point=error.index if error.HasField("index") else None,
    )


def _hull(info: hulls_pb2.HullInfo, content: Content, home: Home | None) -> Hull:
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
        home=home,
    )

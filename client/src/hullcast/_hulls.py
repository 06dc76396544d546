"""Registered hulls and their ids."""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from . import _arguments, _arrays
from ._arrays import Floats
from ._errors import Error, InvalidArgument
from ._settled import freeze

if TYPE_CHECKING:
    from ._connection import Home


#: The planarity that `register` sends by default, as a fraction of the circumradius. It was
#: measured on shapes whose coordinates are rounded as mesh files round them (docs/tradeoff.md).
DEFAULT_PLANARITY = 1e-3

#: The largest planarity that a server accepts.
LARGEST_PLANARITY = 0.01

#: A fraction of the circumradius; or None to send none, so that the server uses 1e-6.
Planarity = float | Literal["default"] | None


@dataclass(frozen=True, eq=False)
class Content:
    """Everything that determines a hull's id, and so everything needed to register it again."""

    #: (n, 3), read-only.
    points: Floats
    #: (3,), or None for the centre of mass.
    centre: Floats | None = None
    max_vertices: int | None = None
    max_deviation: float | None = None
    planarity: float | None = None

    @cached_property
    def identity(self) -> bytes:
        """The id that every server gives to a hull with this content."""
        return hull_id(
            self.points,
            self.centre,
            max_vertices=self.max_vertices,
            max_deviation=self.max_deviation,
            planarity=self.planarity,
        )

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        freeze(self)


@dataclass(frozen=True, repr=False)
class Hull:
    """A registered hull. Lengths are in the caller's units, and points in the hull's own frame.

    A `Hull` keeps the points with which it was registered. A client uses them to register the hull
    again if a server has lost it. A `Scene` made from ids has no points to do so.
    """

    #: The SHA-256 of the content, 32 bytes; the same on every server.
    id: bytes
    #: (3,): the point about which the hull grows; the centre of mass unless another was given.
    contraction_point: Floats = field(compare=False, repr=False)
    #: The radius of the largest ball about the contraction point inside the hull, rounded down.
    inradius: float = field(compare=False)
    #: The radius of the smallest ball about the contraction point around the hull, rounded up.
    circumradius: float = field(compare=False)
    volume: float = field(compare=False)
    #: The number of extreme vertices that are kept.
    vertex_count: int = field(compare=False)
    #: The number of faces, after coplanar triangles are merged.
    face_count: int = field(compare=False)
    edge_count: int = field(compare=False)
    #: How far the vertices of merged faces are from their planes, plus the deviation by
    #: simplification; a length.
    geometric_error: float = field(compare=False, repr=False)
    #: (3,): in the hull's frame.
    center_of_mass: Floats = field(compare=False, repr=False)
    #: (3, 3): the inertia tensor about the centre of mass, at unit density.
    inertia: Floats = field(compare=False, repr=False)
    #: A certified upper bound of the Hausdorff distance to the hull of all points; 0 unless
    #: simplified.
    deviation: float = field(compare=False, repr=False)
    #: How far the vertices of one face may lie from one plane, as a fraction of the circumradius.
    #: `geometric_error` has the actual distance.
    planarity: float = field(compare=False, repr=False)
    #: The points and options with which the hull was registered.
    content: Content = field(compare=False, repr=False)
    #: How to reach the server of the client that registered the hull. It is not pickled, because it
    #: contains the token.
    home: Home | None = field(default=None, compare=False, repr=False)

    @cached_property
    def faces(self) -> tuple[npt.NDArray[np.uint32], ...]:
        """The corners of each face, anticlockwise seen from outside, as indices of `vertices`.

        `Manifolds.feature_indices` refers to faces by their index in this tuple. The first access
        reads the faces from the server, over a separate connection.

        Raises:
            Error: NO_SERVER, the hull was unpickled and knows no server; register it again.
        """
        if self.home is None:
            raise Error(
                "an unpickled hull has no connection: register it again to read its faces",
                reason="NO_SERVER",
                field="faces",
            )
        from ._client import Client

        with Client._of_home(self.home) as client:
            return client._run(client._facing(self))

    def __post_init__(self) -> None:
        freeze(self)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "home": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        freeze(self)

    @property
    def vertices(self) -> Floats:
        """(n, 3): the registered points. Bases, features and point ids refer to them by index."""
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
    planarity: Planarity = "default",
) -> bytes:
    """The id, 32 bytes, by which every server knows the hull of these points and options.

    The id is the SHA-256 of a byte string that docs/identity.md defines.

    Args:
        vertices: (n, 3), in the order in which they are registered; or an object with such an array
            as `.vertices`, for example a trimesh mesh.
        contraction_point: (3,), or None for the centre of mass.
        max_vertices, max_deviation: the simplification, as in `Client.register`.
        planarity: as in `Client.register`.

    Raises:
        InvalidArgument: an argument is not usable; the error names it.
    """
    if max_vertices is not None:
        max_vertices = _arguments.integer("max_vertices", max_vertices, 4, 2**32 - 1)
    if max_deviation is not None:
        max_deviation = _arguments.number("max_deviation", max_deviation, 0)
    # Adding 0.0 turns -0.0 into 0.0 and changes no other number.
    points = _finite("vertices", points_of(vertices)) + 0.0
    share = planarity_of(planarity)
    if share is not None:  # no server checks the range of this call
        share = _arguments.number("planarity", share, 0, LARGEST_PLANARITY)
    parts = [b"hullcast", struct.pack("<I", 1 if share is None else 2)]
    if contraction_point is None:
        parts.append(b"\0")
    else:
        centre = _arrays.floats("contraction_point", contraction_point, 3)
        centre = _finite("contraction_point", centre) + 0.0
        parts += [b"\1", centre.tobytes()]
    if max_vertices is None and max_deviation is None:
        parts.append(b"\0")
    else:
        parts.append(b"\1")
        parts.append(b"\0" if max_vertices is None else b"\1" + struct.pack("<I", max_vertices))
        deviation = None if max_deviation is None else struct.pack("<d", max_deviation + 0.0)
        parts.append(b"\0" if deviation is None else b"\1" + deviation)
    if share is not None:
        parts.append(struct.pack("<d", share + 0.0))
    parts += [struct.pack("<I", len(points)), points.tobytes()]
    return hashlib.sha256(b"".join(parts)).digest()


def _finite(field: str, values: Floats) -> Floats:
    """Checks that all numbers of an array are finite, and returns the array."""
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        entry = tuple(int(i) for i in wrong[0])
        error = InvalidArgument(
            f"got {values[entry]:g}, expected finite numbers", reason="NOT_FINITE", field=field
        )
        error.entry = entry
        raise error
    return values


def planarity_of(planarity: Planarity, default: float | None = DEFAULT_PLANARITY) -> float | None:
    """The planarity to send, or None. The server checks its range."""
    if planarity is None:
        return None
    if isinstance(planarity, str) and planarity == "default":
        return default
    expected = f'expected a number, 0 to {LARGEST_PLANARITY:g}, or None or "default"'
    return _arguments.real("planarity", planarity, expected)


def points_of(hull: Any, name: str = "vertices") -> Floats:
    """The points (n, 3) of an array, of an object with `.vertices`, or of a scipy `ConvexHull`.

    Vertices that no face of a mesh uses are left out.
    """
    if hasattr(hull, "simplices") and hasattr(hull, "points"):
        return _arrays.floats(f"{name}.points", hull.points, None, 3)
    points = getattr(hull, "vertices", hull)
    if getattr(points, "ndim", 2) == 1 and points.shape[0] % 3 == 0 and points.shape[0]:
        raise InvalidArgument(
            f"expected shape (n, 3), got {tuple(points.shape)}: array.reshape(-1, 3) gives "
            f"{points.shape[0] // 3} points",
            reason="WRONG_SHAPE",
            field=name,
        )
    return mesh_of(hull, name)[0]


def mesh_of(hull: Any, name: str = "vertices") -> tuple[Floats, Any]:
    """The vertices (n, 3) that the faces of a mesh use, in order, and its faces (m, 3) or None.

    A vertex that no face uses is no part of the mesh. Without faces every vertex counts.
    """
    points = _arrays.floats(name, getattr(hull, "vertices", hull), None, 3)
    attribute, faces = faces_of(hull)
    if faces is None or np.size(faces) == 0 or len(points) == 0:
        return points, None
    corners = _arrays.indices(f"{name}.{attribute}", faces, None, 3, below=len(points))
    used = np.zeros(len(points), dtype=bool)
    used[corners] = True
    if used.all():
        return points, corners
    rank = np.cumsum(used) - 1
    return points[used], rank[corners].astype("<u4")


def faces_of(mesh: Any) -> tuple[str, Any]:
    """The name and the value of the attribute that has a mesh's triangles; None without one.

    It is `faces` in trimesh's meshes, `triangles` in open3d's, and `indices` in coacd's.
    """
    # A `Hull` would ask the server for its faces, and uses all its points.
    for name in () if isinstance(mesh, Hull) else ("faces", "triangles", "indices"):
        value = getattr(mesh, name, None)
        if value is not None and not callable(value):
            return name, value
    return "faces", None

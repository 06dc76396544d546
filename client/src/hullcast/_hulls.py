"""Hulls and their identity."""

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
from ._errors import Error

if TYPE_CHECKING:
    from ._channel import Settings


#: What `register` sends as `planarity` unless told otherwise, a share of the circumradius. Measured
#: on shapes whose coordinates are rounded as mesh files round them: docs/tradeoff.md.
DEFAULT_PLANARITY = 1e-3

#: A share of the circumradius; None: none is sent, and the server takes 1e-6.
Planarity = float | Literal["default"] | None


@dataclass(frozen=True, eq=False)
class Content:
    """All that a hull's identity is made of: what it can be registered by again."""

    #: (n, 3), not to be written to.
    points: Floats
    #: (3,), or None: the centre of mass.
    center: Floats | None = None
    max_vertices: int | None = None
    max_deviation: float | None = None
    planarity: float | None = None

    @cached_property
    def identity(self) -> bytes:
        """The id that every server gives to this content."""
        return hull_id(
            self.points,
            self.center,
            max_vertices=self.max_vertices,
            max_deviation=self.max_deviation,
            planarity=self.planarity,
        )


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
    #: Certified upper bound of the Hausdorff distance to the hull of all points; 0 unless
    #: simplified.
    deviation: float = field(compare=False, repr=False)
    #: How far the vertices of one face were allowed to lie from one plane, as a share of the
    #: circumradius. `geometric_error` has how far they do lie.
    planarity: float = field(compare=False, repr=False)
    #: The points and options that it was registered with.
    content: Content = field(compare=False, repr=False)
    #: The server that it was registered with; not kept when it is pickled, since a token is in it.
    home: Settings | None = field(default=None, compare=False, repr=False)

    @cached_property
    def faces(self) -> tuple[npt.NDArray[np.uint32], ...]:
        """Per face its corners, anticlockwise seen from outside, as indices of `vertices`.

        `Manifolds.feature_indices` numbers these faces. They are read from the server at the
        first use, by a connection of their own.

        Raises:
            Error: NO_SERVER, the hull was unpickled: register it again.
        """
        if self.home is None:
            raise Error(
                "a hull that was unpickled knows no server: register it again to read its faces",
                reason="NO_SERVER",
                field="faces",
            )
        from ._client import Client

        with Client(self.home) as client:
            return client._run(client._facing(self))

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "home": None}

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
    planarity: Planarity = "default",
) -> bytes:
    """The 32 bytes by which every server knows the hull of these points.

    They are the SHA-256 of the byte string that docs/identity.md states.

    Args:
        vertices: (n, 3), in the order in which they are registered; or an
            object with such `.vertices`, as trimesh's.
        contraction_point: (3,), or None for the centre of mass.
        max_vertices, max_deviation: the simplification asked for, if any.
        planarity: as in `Client.register`.
    """
    if max_vertices is not None:
        max_vertices = _arguments.integer("max_vertices", max_vertices, 0, 2**32 - 1)
    if max_deviation is not None:
        max_deviation = _arguments.number("max_deviation", max_deviation, 0)
    # Adding 0.0 turns -0.0 into 0.0 and changes nothing else.
    points = points_of(vertices) + 0.0
    share = planarity_of(planarity)
    parts = [b"hullcast", struct.pack("<I", 1 if share is None else 2)]
    if contraction_point is None:
        parts.append(b"\0")
    else:
        center = _arrays.floats("contraction_point", contraction_point, 3) + 0.0
        parts += [b"\1", center.tobytes()]
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


def planarity_of(planarity: Planarity, default: float | None = DEFAULT_PLANARITY) -> float | None:
    """The planarity to send. The server judges its range, as for every hull that it is sent."""
    if planarity is None:
        return None
    if isinstance(planarity, str) and planarity == "default":
        return default
    expected = 'expected a number, 0 to 0.01, or None or "default"'
    return _arguments.real("planarity", planarity, expected)


def points_of(hull: Any, name: str = "vertices") -> Floats:
    """(n, 3) of an array, of an object with `.vertices`, or of a scipy `ConvexHull`."""
    if hasattr(hull, "simplices") and hasattr(hull, "points"):
        return _arrays.floats(f"{name}.points", hull.points, None, 3)
    return _arrays.floats(name, getattr(hull, "vertices", hull), None, 3)

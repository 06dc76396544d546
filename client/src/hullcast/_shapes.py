"""Common shapes as vertices, for `register`. The hull of a round shape lies inside the shape."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import _arguments, _arrays
from ._arrays import Floats
from ._settled import freeze

#: The range of lengths that a server accepts.
_SMALLEST, _LARGEST = 1e-50, 1e50
_MOST_SIDES = 512
#: The computed error is multiplied by this factor, so that rounding cannot make it too small.
_ROUND_UP = 1 + 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class Shape:
    """A convex shape, centred at the origin, for `Client.register`.

    Lengths are in the caller's units.
    """

    #: (n, 3), in the shape's own frame.
    vertices: Floats
    #: A bound of the distance from any point of the true shape to the hull of the vertices, which
    #: is inside the true shape. It is 0 for a box and a prism.
    error: float

    def __post_init__(self) -> None:
        vertices = _arrays.frozen(_arrays.floats("vertices", self.vertices, None, 3))
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "error", _arguments.number("error", self.error, 0))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        freeze(self)

    def __repr__(self) -> str:
        return f"Shape({len(self.vertices)} vertices, error {self.error:.3g})"


def box(size: Any) -> Shape:
    """A box centred at the origin.

    Args:
        size: (3,), the full edge lengths along x, y and z; or one number for a cube.

    Raises:
        InvalidArgument: a length is not a number from 1e-50 to 1e50.
    """
    size = _arguments.plain(size)
    if not hasattr(size, "__len__") and not hasattr(size, "shape"):
        size = [_length("size", size)] * 3
    lengths = _arrays.floats("size", size, 3)
    for i, length in enumerate(lengths):
        _length(f"size[{i}]", float(length))
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return Shape(signs * lengths / 2, 0.0)


def sphere(radius: float, *, subdivisions: int = 2) -> Shape:
    """A sphere centred at the origin, as a subdivided icosahedron with its vertices on the sphere.

    Args:
        radius: the radius of the sphere.
        subdivisions: 0 to 4, for 12, 42, 162, 642 or 2,562 vertices.

    Raises:
        InvalidArgument: an argument is out of range.
    """
    radius = _length("radius", radius)
    times = _arguments.integer("subdivisions", subdivisions, 0, 4)
    points, faces = _icosahedron()
    for _ in range(times):
        points, faces = _subdivided(points, faces)
    a, b, c = (points[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    inner = float(np.abs(np.einsum("ni,ni->n", normals, a)).min())
    return Shape(radius * points, radius * (1 - inner) * _ROUND_UP)


def cylinder(radius: float, height: float, *, sides: int = 32) -> Shape:
    """A cylinder about the z axis, from z = -height / 2 to height / 2, as an inscribed prism.

    Args:
        radius, height: the dimensions of the cylinder.
        sides: the number of sides of the prism, 3 to 512.

    Raises:
        InvalidArgument: an argument is out of range.
    """
    radius, height = _length("radius", radius), _length("height", height)
    ring = _ring(radius, sides)
    return Shape(_stacked((ring, -height / 2), (ring, height / 2)), _sagitta(radius, sides))


def cone(radius: float, height: float, *, sides: int = 32) -> Shape:
    """A cone about the z axis, from its base at z = -height / 2 to its apex at z = height / 2.

    Args:
        radius, height: the radius of the base and the height of the cone.
        sides: the number of sides of the inscribed pyramid, 3 to 512.

    Raises:
        InvalidArgument: an argument is out of range.
    """
    radius, height = _length("radius", radius), _length("height", height)
    apex = np.zeros((1, 2))
    vertices = _stacked((_ring(radius, sides), -height / 2), (apex, height / 2))
    return Shape(vertices, _sagitta(radius, sides))


def prism(sides: int, radius: float, height: float) -> Shape:
    """A regular prism about the z axis, from z = -height / 2 to height / 2.

    Args:
        sides: the number of sides, 3 to 512.
        radius: the distance from the axis to the corners. The first corner is on the x axis.
        height: the height of the prism.

    Raises:
        InvalidArgument: an argument is out of range.
    """
    radius, height = _length("radius", radius), _length("height", height)
    ring = _ring(radius, sides)
    return Shape(_stacked((ring, -height / 2), (ring, height / 2)), 0.0)


def capsule(radius: float, length: float, *, sides: int = 16) -> Shape:
    """A capsule about the z axis: all points within `radius` of a segment.

    Args:
        radius: the radius of the capsule.
        length: the length of the segment, from z = -length / 2 to length / 2. The whole capsule is
            longer by two radii.
        sides: the number of sides around the axis, 4 to 64. Each half sphere has a quarter as many
            bands.

    Raises:
        InvalidArgument: an argument is out of range.
    """
    radius = _length("radius", radius)
    length = _length("length", length)
    sides = _arguments.integer("sides", sides, 4, 64)
    bands = max(1, round(sides / 4))
    latitudes = [math.pi / 2 * i / bands for i in range(bands)]
    rings = [
        (_ring(radius * math.cos(t), sides), length / 2 + radius * math.sin(t)) for t in latitudes
    ]
    rings.append((np.zeros((1, 2)), length / 2 + radius))
    vertices = _stacked(*((ring, -z) for ring, z in reversed(rings)), *rings)
    # The corners of a band's faces are on the sphere. A plane through the axis and the middle of a
    # face cuts the face in a chord. The distance of this chord from the sphere's centre is the
    # least distance of the face from it.
    inward = math.cos(math.pi / sides)
    ends = [(inward * math.cos(t), math.sin(t)) for t in latitudes] + [(0.0, 1.0)]
    inner = inward
    for (x0, z0), (x1, z1) in itertools.pairwise(ends):
        inner = min(inner, abs(x0 * z1 - x1 * z0) / math.hypot(x1 - x0, z1 - z0))
    return Shape(vertices, radius * (1 - inner) * _ROUND_UP)


def _length(field: str, value: Any) -> float:
    return _arguments.number(field, value, _SMALLEST, _LARGEST)


def _ring(radius: float, sides: int) -> Floats:
    """(sides, 2): the corners of a regular polygon."""
    sides = _arguments.integer("sides", sides, 3, _MOST_SIDES)
    turn = 2 * np.pi * np.arange(sides) / sides
    return radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)


def _stacked(*rings: tuple[Floats, float]) -> Floats:
    return np.concatenate([np.column_stack([ring, np.full(len(ring), z)]) for ring, z in rings])


def _sagitta(radius: float, sides: int) -> float:
    """The largest distance from a circle to the regular polygon inscribed in it."""
    return radius * (1 - math.cos(math.pi / sides)) * _ROUND_UP


def _icosahedron() -> tuple[Floats, np.ndarray]:
    """The corners (12, 3) of an icosahedron on the unit sphere, and its triangles (20, 3)."""
    g = (1 + 5**0.5) / 2
    corners = np.array(
        [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g), (0, -1, -g),
         (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    )  # fmt: skip
    faces = np.array(
        [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4),
         (11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9),
         (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    )  # fmt: skip
    return corners / np.linalg.norm(corners[0]), faces


def _subdivided(points: Floats, faces: np.ndarray) -> tuple[Floats, np.ndarray]:
    """Cuts each triangle into four, with the new corners on the unit sphere."""
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges, place = np.unique(sides, axis=0, return_inverse=True)
    middles = points[edges].mean(axis=1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    ab, bc, ca = len(points) + place.reshape(3, -1)
    a, b, c = faces.T
    split = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return np.concatenate([points, middles]), np.concatenate([np.stack(f, axis=1) for f in split])

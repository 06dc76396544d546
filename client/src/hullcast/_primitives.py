"""The points of the primitive shapes of URDF, in their own frames."""

from __future__ import annotations

import itertools

import numpy as np

from ._arrays import Floats

_CYLINDER_SIDES = 32
_SPHERE_DIVISIONS = 2


def box(size: Floats) -> Floats:
    """(8, 3): the corners of a box with these edge lengths, centred at the origin."""
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    return signs * size


def cylinder(radius: float, length: float) -> Floats:
    """(64, 3): the corners of an inscribed prism with 32 sides about the z axis."""
    angles = np.arange(_CYLINDER_SIDES) * (2 * np.pi / _CYLINDER_SIDES)
    ring = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    ends = [np.full((_CYLINDER_SIDES, 1), z) for z in (-length / 2, length / 2)]
    return np.concatenate([np.hstack([ring, end]) for end in ends])


def sphere(radius: float) -> Floats:
    """(162, 3): points on the sphere: an icosahedron whose triangles are each cut into 16."""
    golden = (1 + 5**0.5) / 2
    signs = list(itertools.product((-1.0, 1.0), (-golden, golden)))
    points = [np.roll([0.0, a, b], k) for k in range(3) for a, b in signs]
    points = [point / np.linalg.norm(point) for point in points]
    for _ in range(_SPHERE_DIVISIONS):
        gaps = np.linalg.norm(np.array(points)[:, None] - np.array(points), axis=2)
        # The shortest distances are edges; the next longer ones are diagonals.
        edges = gaps < 1.3 * gaps[gaps > 0].min()
        for i, j in zip(*np.nonzero(np.triu(edges, 1)), strict=True):
            middle = points[i] + points[j]
            points.append(middle / np.linalg.norm(middle))
    return radius * np.array(points)

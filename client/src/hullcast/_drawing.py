"""What pictures draw, whoever draws them."""

from __future__ import annotations

import numpy as np

from ._arrays import Floats
from ._errors import InvalidArgument
from ._scene import Scene

#: Cosine of the angle within which faces that meet in an edge are drawn as one.
_FLAT = 1 - 1e-6


def points_of(scene: Scene, body: int) -> Floats:
    """The points that a body's hull was registered with.

    Raises:
        InvalidArgument: NO_GEOMETRY, the scene has only their id.
    """
    content = scene.contents[int(scene.body_hulls[body])]
    if content is None:
        raise InvalidArgument(
            "the scene was made with this body's hull id alone, without its points",
            reason="NO_GEOMETRY",
            field="hulls",
            index=int(scene.body_hulls[body]),
        )
    return content.points


def world(points: Floats, position: Floats, rotation: Floats) -> Floats:
    """Points of the hull's frame in the world."""
    x, y, z, w = rotation / np.linalg.norm(rotation)
    axis = np.array([x, y, z])
    turned = points + 2 * np.cross(axis, np.cross(axis, points) + w * points)
    return turned + position


def surface(vertices: Floats) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the hull, and the edges between those that are not in one plane."""
    try:
        from scipy.spatial import ConvexHull
    except ImportError as error:
        raise ImportError("pictures need scipy: pip install scipy") from error
    hull = ConvexHull(vertices)
    triangles, normals = hull.simplices, hull.equations[:, :3]
    edges: list[list[int]] = []
    for i, neighbours in enumerate(hull.neighbors):
        for opposite, j in enumerate(neighbours):
            if i < j and normals[i] @ normals[j] < _FLAT:
                edges.append([int(v) for k, v in enumerate(triangles[i]) if k != opposite])
    return triangles, np.array(edges, dtype=np.int64).reshape(-1, 2)


def around(offsets: Floats, normal: Floats) -> np.ndarray:
    """The order of a convex polygon's corners about its normal."""
    first = np.eye(3)[np.argmin(np.abs(normal))]
    x = np.cross(normal, first)
    return np.argsort(np.arctan2(offsets @ np.cross(normal, x), offsets @ x))

"""Geometry for pictures, shared by the matplotlib and rerun modules."""

from __future__ import annotations

import numpy as np

from ._arrays import Floats
from ._errors import InvalidArgument
from ._scene import Scene

#: Faces that meet at an angle with a cosine above `_FLAT` are drawn as one face. A hull with more
#: than `_MANY` edges is mistaken for a round shape, and `_ROUND` is used instead.
_FLAT = 1 - 1e-6
_ROUND = 0.94
_MANY = 64


def points_of(scene: Scene, body: int) -> Floats:
    """The points with which a body's hull was registered.

    Raises:
        InvalidArgument: NO_GEOMETRY, the scene only has the hull's id.
    """
    content = scene.contents[int(scene.body_hulls[body])]
    if content is None:
        raise InvalidArgument(
            "the scene has only this hull's id, and drawing needs its points: make the scene with "
            "Hull objects",
            reason="NO_GEOMETRY",
            field="hulls",
            index=int(scene.body_hulls[body]),
        )
    return content.points


def world(points: Floats, position: Floats, rotation: Floats) -> Floats:
    """Transforms points from the hull's frame to the world frame."""
    x, y, z, w = rotation / np.linalg.norm(rotation)
    axis = np.array([x, y, z])
    turned = points + 2 * np.cross(axis, np.cross(axis, points) + w * points)
    return turned + position


def surface(vertices: Floats) -> tuple[np.ndarray, np.ndarray]:
    """The hull's triangles, anticlockwise seen from outside, and the edges to draw."""
    try:
        from scipy.spatial import ConvexHull
    except ImportError as error:
        raise ImportError("pictures need scipy: pip install scipy") from error
    hull = ConvexHull(vertices)
    triangles, normals = hull.simplices, hull.equations[:, :3]
    edges: list[list[int]] = []
    cosines: list[float] = []
    for i, neighbours in enumerate(hull.neighbors):
        for opposite, j in enumerate(neighbours):
            if i < j and normals[i] @ normals[j] < _FLAT:
                edges.append([int(v) for k, v in enumerate(triangles[i]) if k != opposite])
                cosines.append(normals[i] @ normals[j])
    shown = np.array(edges, dtype=np.int64).reshape(-1, 2)
    if len(shown) > _MANY:
        shown = shown[np.array(cosines) < _ROUND]
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    inward = np.einsum("ni,ni->n", np.cross(b - a, c - a), normals) < 0
    return np.where(inward[:, None], triangles[:, ::-1], triangles), shown


def around(offsets: Floats, normal: Floats) -> np.ndarray:
    """The order of a convex polygon's corners around its normal."""
    first = np.eye(3)[np.argmin(np.abs(normal))]
    x = np.cross(normal, first)
    return np.argsort(np.arctan2(offsets @ np.cross(normal, x), offsets @ x))

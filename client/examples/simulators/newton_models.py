"""Scenes as models of Newton."""

from __future__ import annotations

from typing import Any

import models
import newton
import numpy as np
import scenes
import warp as wp
from scipy.spatial import ConvexHull


def builder(setup: scenes.Setup, **options: Any) -> Any:
    """A `newton.ModelBuilder` of a scene: boxes as boxes, and all other shapes as convex meshes.

    Args:
        setup: the scene. Its fixed bodies are shapes of the world.
        options: of `newton.ModelBuilder.ShapeConfig`, such as `margin` and `gap`.
    """
    result: Any = newton.ModelBuilder()
    given: dict[str, Any] = {"density": models.DENSITY, "mu": setup.friction, "gap": 1e-3}
    config = newton.ModelBuilder.ShapeConfig(**{**given, **options})
    for i, (shape, place, turn) in enumerate(
        zip(setup.shapes, setup.positions, setup.rotations, strict=True)
    ):
        pose = wp.transform(wp.vec3(*place), wp.quat(*turn))
        body, local = (-1, pose) if i < setup.fixed else (result.add_body(xform=pose), None)
        half = models.half_extents(shape)
        if half is None:
            result.add_shape_convex_hull(body, xform=local, mesh=_mesh(shape), cfg=config)
        else:
            hx, hy, hz = half
            result.add_shape_box(body, xform=local, hx=hx, hy=hy, hz=hz, cfg=config)
    return result


def _mesh(points: models.Floats) -> Any:
    """The hull of some points, its triangles anticlockwise seen from outside."""
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normals * hull.equations[:, :3]).sum(axis=1) < 0
    triangles = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    return newton.Mesh(points.astype(np.float32), triangles.astype(np.int32).reshape(-1))

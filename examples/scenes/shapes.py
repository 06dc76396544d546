"""Convex shapes as vertex arrays, and functions on hulls for the scene scripts.

Lengths are in metres. A vertex array has one row per vertex, in the shape's own frame.
"""

import json

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation


def box(sides):
    """A box with these full side lengths, centred at the origin."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return signs * np.asarray(sides, float) / 2


def prism(sides, radius, height):
    """A regular prism about the z axis, with its corners on a circle of `radius`."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.vstack([np.column_stack([ring, np.full(sides, z)]) for z in (-height / 2, height / 2)])


def wedge(length, width, height):
    """A ramp that rises along x from 0 to `height`, with the origin at the middle of its base."""
    x, y = length / 2, width / 2
    return np.array([[-x, -y, 0], [-x, y, 0], [x, -y, 0], [x, y, 0], [x, -y, height], [x, y, height]], float)


def icosphere(radius, subdivisions=2):
    """A subdivided icosahedron with its 10 * 4**subdivisions + 2 vertices on a sphere."""
    golden = (1 + 5**0.5) / 2
    corners = [[0, a, b * golden] for a in (-1, 1) for b in (-1, 1)]
    points = np.array([np.roll(c, k) for c in corners for k in range(3)], float)
    for _ in range(subdivisions):
        edges = {tuple(sorted(e)) for t in ConvexHull(points).simplices for e in (t[:2], t[1:], t[::2])}
        points = points / np.linalg.norm(points, axis=1)[:, None]
        points = np.vstack([points, [points[i] + points[j] for i, j in sorted(edges)]])
    return radius * points / np.linalg.norm(points, axis=1)[:, None]


def rock(rng, count, half_extents):
    """`count` random points on an ellipsoid, shifted so that the centre of mass is the origin."""
    points = rng.normal(size=(count, 3))
    points = points / np.linalg.norm(points, axis=1)[:, None] * half_extents
    return points - mass_properties(points)[1]


def extreme_vertices(points):
    """The vertices of the convex hull, with unchanged coordinates, in lexicographic order."""
    points = np.unique(np.asarray(points) + 0.0, axis=0)
    return points[np.sort(ConvexHull(points).vertices)]


def outward_triangles(points):
    """(n, 3, 3): the corners of the hull's triangles, anticlockwise seen from outside."""
    hull = ConvexHull(points)
    corners = np.asarray(points)[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flip = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    corners[flip] = corners[flip][:, ::-1]
    return corners


def mass_properties(points):
    """Volume, centre of mass, and inertia (3, 3) about it, at unit density, by tetrahedra."""
    origin = np.asarray(points, float)[0]
    corners = outward_triangles(points) - origin
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    volume = volumes.sum()
    total = corners.sum(axis=1)
    centre = (volumes[:, None] * total).sum(axis=0) / (4 * volume)
    # The integral of x x^T over a tetrahedron with one corner at 0 is V / 20 (sum of x_i x_i^T +
    # (sum x_i)(sum x_i)^T).
    second = np.einsum("t,tki,tkj->ij", volumes, corners, corners) + np.einsum("t,ti,tj->ij", volumes, total, total)
    second = second / 20 - volume * np.outer(centre, centre)
    return volume, origin + centre, np.trace(second) * np.eye(3) - second


def resting_rotation(points, face=0):
    """A rotation that turns the `face`-th largest triangle of the hull flat, facing down."""
    triangles = outward_triangles(points)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal = normals[np.argsort(-np.linalg.norm(normals, axis=1), kind="stable")[face]]
    return Rotation.align_vectors([[0, 0, -1]], [normal / np.linalg.norm(normal)])[0]


def write_scene(path, scene):
    """Writes a hullcast.scene.v1 file, with one hull, body or block of pairs per line."""
    lines = []
    for key, value in scene.items():
        if isinstance(value, list) and value:
            rows = [json.dumps(_plain(row), separators=(",", ":")) for row in value]
            step = 16 if key == "pairs" else 1
            rows = [",".join(rows[i : i + step]) for i in range(0, len(rows), step)]
            lines.append(f"{json.dumps(key)}: [\n" + ",\n".join(rows) + "\n]")
        else:
            lines.append(f"{json.dumps(key)}: {json.dumps(_plain(value))}")
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def _plain(value):
    """Converts numpy values to plain ones. A float is the shortest text that reads back equal."""
    if isinstance(value, np.ndarray) and value.dtype == np.float32:
        # Meshes store single precision, whose shortest text is half as long.
        return [_plain(row) for row in value] if value.ndim > 1 else [float(str(x)) + 0.0 for x in value]
    if isinstance(value, np.ndarray):
        return (value + 0.0 if value.dtype.kind == "f" else value).tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value

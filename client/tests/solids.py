"""Triangle meshes for the tests, as (m, 3, 3) arrays of corners, oriented outward."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np


def mesh(*parts: np.ndarray) -> SimpleNamespace:
    """The parts as one mesh, in which every triangle has its own corners."""
    points = np.concatenate(parts).reshape(-1, 3)
    return SimpleNamespace(vertices=points, faces=np.arange(len(points)).reshape(-1, 3))


def box(low: Sequence[float], high: Sequence[float]) -> np.ndarray:
    """A box between two corners, as twelve triangles."""
    found = []
    for axis in range(3):
        for side in (0, 1):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            corners = np.zeros((4, 3))
            corners[:, axis] = side
            corners[:, u] = [0, 1, 1, 0] if side else [0, 0, 1, 1]
            corners[:, v] = [0, 0, 1, 1] if side else [0, 1, 1, 0]
            found += [corners[[0, 1, 2]], corners[[0, 2, 3]]]
    extent = np.subtract(high, low)
    return np.array(found) * extent + low


def grid(points: np.ndarray) -> np.ndarray:
    """The triangles of a closed surface (n, m, 3) whose rows and columns are rings."""
    right = np.roll(points, -1, axis=1)
    down = np.roll(points, -1, axis=0)
    both = np.roll(right, -1, axis=0)
    return np.concatenate(
        [
            np.stack([points, down, both], axis=2).reshape(-1, 3, 3),
            np.stack([points, both, right], axis=2).reshape(-1, 3, 3),
        ]
    )


def turned(profile: Sequence[tuple[float, float]], sides: int) -> np.ndarray:
    """The solid of revolution of a closed profile of (radius, height) about the z axis."""
    angles = np.arange(sides) * (2 * np.pi / sides)
    radius, height = np.array(profile, dtype=float).T
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = np.concatenate(
        [
            radius[:, None, None] * ring[None],
            np.broadcast_to(height[:, None, None], (len(height), sides, 1)),
        ],
        axis=2,
    )
    return grid(points)[:, ::-1]


def sphere(rings: int, sides: int) -> np.ndarray:
    """The unit sphere, cut along latitudes and longitudes."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, rings)
    profile = [(float(np.cos(a)), float(np.sin(a))) for a in angles]
    return turned([(0.0, -1.0), *profile[1:-1], (0.0, 1.0)], sides)


def cylinder(sides: int, radius: float = 1.0, height: float = 2.0) -> np.ndarray:
    """A cylinder about the z axis, with a triangle fan at each end."""
    return turned(
        [(0, -height / 2), (radius, -height / 2), (radius, height / 2), (0, height / 2)], sides
    )


def halved(triangles: np.ndarray, times: int = 1) -> np.ndarray:
    """Each triangle cut into four triangles in its plane."""
    for _ in range(times):
        a, b, c = triangles.swapaxes(0, 1)
        x, y, z = (b + c) / 2, (c + a) / 2, (a + b) / 2
        parts = [(a, z, y), (z, b, x), (y, x, c), (x, y, z)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return triangles


def inverted(triangles: np.ndarray) -> np.ndarray:
    """The triangles turned inside out."""
    return triangles[:, ::-1]


def rotation(rng: np.random.Generator) -> np.ndarray:
    """A random rotation matrix."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    q[:, 0] *= np.linalg.det(q)
    return q


#: Two bars that overlap in their corner. Together they form an L of volume 3 with a hull of 3.5.
BARS = (box((-0.5, -0.5, -0.5), (1.5, 0.5, 0.5)), box((-0.5, -0.5, -0.5), (0.5, 1.5, 0.5)))


def canonical(triangles: np.ndarray) -> list[tuple[tuple[float, ...], ...]]:
    """The triangles, each from its least corner on, sorted; equal for equal surfaces."""
    found = []
    for triangle in np.asarray(triangles, dtype=float).tolist():
        corners = [tuple(corner) for corner in triangle]
        least = corners.index(min(corners))
        found.append(tuple(corners[least:] + corners[:least]))
    return sorted(found)


def corners_of(low: Sequence[float], high: Sequence[float]) -> list[tuple[float, ...]]:
    """The eight corners of a box, sorted."""
    return sorted(itertools.product(*zip(map(float, low), map(float, high), strict=True)))


def stl(triangles: np.ndarray) -> bytes:
    """The bytes of a binary STL file."""
    rows = (struct.pack("<12fH", 0, 0, 0, *np.ravel(t), 0) for t in triangles)
    return b" " * 80 + struct.pack("<I", len(triangles)) + b"".join(rows)

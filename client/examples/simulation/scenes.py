"""The simulated scenes: shapes about their centres of mass, poses, number of fixed bodies."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

Floats = npt.NDArray[np.float64]

SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
FLOOR = SIGNS * [20, 20, 0.5]


@dataclass
class Setup:
    """A scene at rest, or before a fall."""

    name: str
    shapes: list[Floats]
    positions: Floats
    rotations: Floats
    steps: int
    fixed: int = 1
    friction: float = 0.6
    #: Whether the scene moves at first, so that only the last second is measured.
    settles: bool = False


def _on_floor(
    name: str,
    shapes: list[Floats],
    positions: list[Floats],
    steps: int,
    *,
    friction: float = 0.6,
    settles: bool = False,
) -> Setup:
    places = np.array([[0, 0, -0.5], *positions], float)
    rotations = np.tile([0.0, 0, 0, 1], (len(places), 1))
    return Setup(
        name, [FLOOR, *shapes], places, rotations, steps, friction=friction, settles=settles
    )


def tower() -> Setup:
    """Ten cubes, stacked on each other."""
    return _on_floor(
        "tower", [SIGNS * 0.25] * 10, [np.array([0, 0, 0.25 + 0.5 * i]) for i in range(10)], 400
    )


def wall() -> Setup:
    """Six rows of bricks; every other row is shifted by a quarter of a brick."""
    half = np.array([0.3, 0.15, 0.15])
    places = [
        np.array([0.61 * (i + 0.25 * (row % 2)), 0, 0.15 + 0.3 * row])
        for row in range(6)
        for i in range(5)
    ]
    return _on_floor("wall", [SIGNS * half] * len(places), places, 400)


def arch() -> Setup:
    """Eleven wedges in a half circle, held together by friction."""
    shapes: list[Floats] = []
    places: list[Floats] = []
    inner, outer, half_width = 1.0, 1.35, 0.2
    ends = np.linspace(0, np.pi, 12)
    for low, high in itertools.pairwise(ends):
        corners = np.array(
            [
                [r * np.cos(angle), y, r * np.sin(angle)]
                for r in (inner, outer)
                for angle in (low, high)
                for y in (-half_width, half_width)
            ]
        )
        centre = center_of_mass(corners)
        shapes.append(corners - centre)
        places.append(centre)
    return _on_floor("arch", shapes, places, 400, friction=0.8)


def pile(count: int = 200) -> Setup:
    """Boxes, prisms and polyhedra that fall from a loose lattice."""
    rng = np.random.default_rng(11)
    kinds = [SIGNS * rng.uniform(0.12, 0.25, 3) for _ in range(6)]
    for sides in (3, 5, 6, 8):
        angles = 2 * np.pi * np.arange(sides) / sides
        ring = 0.2 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        kinds.append(np.array([[x, y, z] for x, y in ring for z in (-0.15, 0.15)]))
    for points in (12, 24, 48, 64):
        cloud = rng.normal(size=(points, 3))
        kinds.append(cloud / np.linalg.norm(cloud, axis=1, keepdims=True) * 0.22)
    kinds = [kind - center_of_mass(kind) for kind in kinds]
    chosen = rng.integers(len(kinds), size=count)
    side = 6
    places = [
        np.array([i % side - 2.5, i // side % side - 2.5, 1 + i // side**2]) * [0.5, 0.5, 0.55]
        + rng.uniform(-0.03, 0.03, 3)
        for i in range(count)
    ]
    setup = _on_floor("pile", [kinds[i] for i in chosen], places, 600, settles=True)
    turn = rng.normal(size=(count, 4))
    setup.rotations[1:] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    return setup


def rocking() -> Setup:
    """A tall box that is released on an edge, tilted by 0.12 rad."""
    half, tilt = np.array([0.2, 0.2, 0.5]), 0.12
    turn = np.array([0, np.sin(tilt / 2), 0, np.cos(tilt / 2)])
    # The box is rotated about y, so its lowest corner is at +x.
    height = half[0] * np.sin(tilt) + half[2] * np.cos(tilt)
    setup = _on_floor("rocking", [SIGNS * half], [np.array([0, 0, height])], 400, settles=True)
    setup.rotations[1] = turn
    return setup


SCENES = {scene.__name__: scene for scene in (tower, wall, arch, pile, rocking)}


def center_of_mass(points: Floats) -> Floats:
    """The centre of mass of the hull of some points.

    It is the sum over tetrahedra that join the mean of the points to the hull's triangles.
    """
    middle = points.mean(axis=0)
    corners = points[ConvexHull(points).simplices] - middle
    volumes = np.abs(np.linalg.det(corners))
    return middle + (volumes[:, None] * corners.sum(axis=1) / 4).sum(axis=0) / volumes.sum()

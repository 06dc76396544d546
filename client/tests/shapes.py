"""Convex shapes for the tests. Their faces are found by brute force."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class Shape:
    """Points that are all corners of their hull, in the hull's own frame."""

    family: str
    #: (n, 3)
    vertices: np.ndarray

    @cached_property
    def faces(self) -> list[list[int]]:
        """The corners of each face in order, anticlockwise seen from outside.

        A plane through three vertices contains a face if all other vertices are below it. This only
        works for shapes whose neighbouring faces are far from parallel.
        """
        v = self.vertices
        size = np.ptp(v, axis=0).max()
        triples = np.array(list(itertools.combinations(range(len(v)), 3)))
        a, b, c = (v[triples[:, i]] for i in range(3))
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
        wide = lengths > 1e-12 * size * size
        normals = normals[wide] / lengths[wide, None]
        heights = normals @ v.T - np.sum(normals * a[wide], axis=1)[:, None]
        found: dict[tuple[int, ...], list[int]] = {}
        for sign in (1.0, -1.0):
            for i in np.flatnonzero((sign * heights).max(axis=1) < 1e-10 * size):
                on = np.flatnonzero(np.abs(heights[i]) < 1e-10 * size)
                found.setdefault(tuple(on), _ordered(v, on, sign * normals[i]))
        return list(found.values())

    def plane(self, face: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """A face's outward unit normal, and the mean of its corners."""
        p = self.vertices[face]
        normal = np.cross(p[1] - p[0], p[2] - p[0])
        return normal / np.linalg.norm(normal), p.mean(axis=0)


def _ordered(v: np.ndarray, on: np.ndarray, normal: np.ndarray) -> list[int]:
    middle = v[on].mean(axis=0)
    x = v[on[0]] - middle
    y = np.cross(normal, x)
    angles = np.arctan2((v[on] - middle) @ y, (v[on] - middle) @ x)
    return [int(i) for i in on[np.argsort(angles)]]


def box(half_extents) -> Shape:
    """A box centred at the origin."""
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    return Shape("box", signs * np.asarray(half_extents, dtype=float))


def prism(sides: int, radius: float, half_height: float) -> Shape:
    """A regular prism about the z axis."""
    turn = np.arange(sides) * (2 * np.pi / sides)
    ring = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    layers = [np.column_stack([ring, np.full(sides, z)]) for z in (-half_height, half_height)]
    return Shape("prism", np.concatenate(layers))


def tetra(rng: np.random.Generator) -> Shape:
    """A random tetrahedron that is not flat."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.5
    return Shape("tetra", corners + rng.uniform(-0.2, 0.2, (4, 3)))


def poly(count: int, rng: np.random.Generator) -> Shape:
    """Random points on an ellipsoid, which are all corners."""
    points = rng.normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return Shape(f"poly{count}", points * rng.uniform(0.4, 1.0, 3))


def family(name: str, count: int, rng: np.random.Generator) -> list[Shape]:
    """Some random shapes of a family, with sizes of about 1."""
    make = {
        "box": lambda: box(rng.uniform(0.3, 1.0, 3)),
        "prism": lambda: prism(int(rng.integers(3, 13)), *rng.uniform(0.3, 1.0, 2)),
        "tetra": lambda: tetra(rng),
        "poly16": lambda: poly(16, rng),
        "poly64": lambda: poly(64, rng),
    }[name]
    return [make() for _ in range(count)]


FAMILIES = ("box", "prism", "tetra", "poly16", "poly64")

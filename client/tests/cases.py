"""Pairs of shapes at poses, generated for regimes; the exact growth scale sets the distance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from oracle import ExactBody, ExactPair
from shapes import Shape

import hullcast


@dataclass(frozen=True, eq=False)
class Case:
    """A pair, with the exact numbers that are sent to the server."""

    shapes: tuple[Shape, Shape]
    hulls: tuple[hullcast.Hull, hullcast.Hull]
    #: (2, 3): the positions of A and B.
    positions: np.ndarray
    #: (2, 4): the quaternions x, y, z, w of A and B.
    rotations: np.ndarray
    margin: float = 0.0
    #: The faces that were laid on each other, in the resting regime.
    faces: tuple[list[int], list[int]] | None = None

    @cached_property
    def exact(self) -> ExactPair:
        """The exact oracle for this pair."""
        bodies = [
            ExactBody.make(shape.vertices, hull.contraction_point, position, rotation)
            for shape, hull, position, rotation in zip(
                self.shapes, self.hulls, self.positions, self.rotations, strict=True
            )
        ]
        return ExactPair(*bodies)

    def moved(self, offset: np.ndarray) -> Case:
        """The case with B at `offset` from A."""
        positions = np.stack([self.positions[0], self.positions[0] + offset])
        return Case(self.shapes, self.hulls, positions, self.rotations, self.margin, self.faces)

    def at_alpha(self, alpha: float) -> Case:
        """The case with B moved along the centre line to a growth scale of `alpha`, to rounding."""
        turned = [
            matrix(q) @ h.contraction_point for q, h in zip(self.rotations, self.hulls, strict=True)
        ]
        d = self.positions[1] + turned[1] - self.positions[0] - turned[0]
        scale = alpha / float(self.exact.growth[0])
        return self.moved(d * scale - turned[1] + turned[0])


def ask(client: hullcast.Client, cases: list[Case], **options) -> hullcast.Manifolds:
    """Queries the cases as one scene, in which each case has two bodies of its own."""
    hulls = [hull for case in cases for hull in case.hulls]
    positions = np.concatenate([case.positions for case in cases])
    rotations = np.concatenate([case.rotations for case in cases])
    scene = hullcast.Scene(hulls, positions, rotations)
    return client.query(scene, np.arange(2 * len(cases)).reshape(-1, 2), **options)


def matrix(q: np.ndarray) -> np.ndarray:
    """The rotation matrix of a quaternion x, y, z, w."""
    x, y, z, w = q
    turn = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 / (q @ q) * (w * turn + turn @ turn)


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """A random quaternion, uniform over rotations."""
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def rotation_between(u: np.ndarray, v: np.ndarray, spin: float) -> np.ndarray:
    """A quaternion that takes unit u to unit v, then rotates by `spin` about v."""
    half = np.cross(u, v)
    w = 1 + u @ v
    if w < 1e-6:  # u and v are opposite: half a turn about any axis perpendicular to u
        half, w = np.cross(u, np.eye(3)[np.argmin(np.abs(u))]), 0.0
    first = np.array([*half, w])
    first /= np.linalg.norm(first)
    second = np.array([*(v * np.sin(spin / 2)), np.cos(spin / 2)])
    return _times(second, first)


def _times(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    vector = p[3] * q[:3] + q[3] * p[:3] + np.cross(p[:3], q[:3])
    return np.array([*vector, p[3] * q[3] - p[:3] @ q[:3]])


def random_case(rng, shapes, hulls) -> Case:
    """Random orientations, with B in a random direction from A."""
    i, j = rng.integers(len(shapes), size=2)
    direction = rng.normal(size=3)
    position = rng.uniform(-5, 5, 3)
    return Case(
        (shapes[i], shapes[j]),
        (hulls[i], hulls[j]),
        np.stack([position, position + direction / np.linalg.norm(direction)]),
        np.stack([random_rotation(rng), random_rotation(rng)]),
    )


def resting_case(rng, shapes, hulls, tilt: float = 0.0) -> Case:
    """A face of A against a face of B, at a random spin and a gap in [-.01, .002]."""
    i, j = rng.integers(len(shapes), size=2)
    face_a = shapes[i].faces[rng.integers(len(shapes[i].faces))]
    face_b = shapes[j].faces[rng.integers(len(shapes[j].faces))]
    rotation_a = random_rotation(rng)
    turn_a = matrix(rotation_a)
    normal_a, middle_a = shapes[i].plane(face_a)
    normal_b, middle_b = shapes[j].plane(face_b)
    up = turn_a @ normal_a
    toward = -up
    if tilt:
        side = np.cross(up, rng.normal(size=3))
        toward = np.cos(tilt) * toward + np.sin(tilt) * side / np.linalg.norm(side)
    rotation_b = rotation_between(normal_b, toward, rng.uniform(0, 2 * np.pi))
    position = rng.uniform(-5, 5, 3)
    aside = np.cross(up, rng.normal(size=3)) * 0.1
    touch = turn_a @ middle_a + up * rng.uniform(-0.01, 0.002) + aside
    offset = touch - matrix(rotation_b) @ middle_b
    return Case(
        (shapes[i], shapes[j]),
        (hulls[i], hulls[j]),
        np.stack([position, position + offset]),
        np.stack([rotation_a, rotation_b]),
        margin=0.02,
        faces=(face_a, face_b),
    )


def regime_cases(regime: str, rng, shapes, hulls, count: int) -> list[Case]:
    """Cases of a regime. Each must be queried with its own `margin`."""
    if regime == "resting":
        return [resting_case(rng, shapes, hulls) for _ in range(count)]
    low, high, margin = {
        "deep": (1e-3, 0.9, 0.0),
        "shallow": (0.95, 0.995, 0.0),
        "touching": (1.0, 1.0, 0.0),
        "near": (1.0, 1.1, 0.05),
        "separated": (1.02, 1.5, np.inf),
    }[regime]
    made = []
    for _ in range(count):
        case = random_case(rng, shapes, hulls).at_alpha(rng.uniform(low, high))
        made.append(
            Case(case.shapes, case.hulls, case.positions, case.rotations, margin, case.faces)
        )
    return made


REGIMES = ("deep", "shallow", "touching", "resting", "near", "separated")

"""The package's shapes are inside the true shapes, by at most the stated error."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hullcast

Spatial = pytest.importorskip("scipy.spatial")

#: How far each point is outside the true shape.
Outside = Callable[[np.ndarray], np.ndarray]


def _about_axis(points: np.ndarray) -> np.ndarray:
    return np.hypot(points[:, 0], points[:, 1])


def _capsule(points: np.ndarray, radius: float, length: float) -> np.ndarray:
    z = np.clip(points[:, 2], -length / 2, length / 2)
    return np.linalg.norm(points - np.stack([0 * z, 0 * z, z], axis=1), axis=1) - radius


ROUND: dict[str, tuple[Any, float, Outside]] = {
    "sphere 0": (hullcast.sphere(2, subdivisions=0), 4 / 3 * np.pi * 8, lambda p: np.linalg.norm(p, axis=1) - 2),
    "sphere": (hullcast.sphere(2), 4 / 3 * np.pi * 8, lambda p: np.linalg.norm(p, axis=1) - 2),
    "sphere 3": (hullcast.sphere(2, subdivisions=3), 4 / 3 * np.pi * 8, lambda p: np.linalg.norm(p, axis=1) - 2),
    "cylinder": (hullcast.cylinder(2, 3), np.pi * 4 * 3, lambda p: np.maximum(_about_axis(p) - 2, np.abs(p[:, 2]) - 1.5)),
    "cylinder 3": (hullcast.cylinder(2, 3, sides=3), np.pi * 4 * 3, lambda p: np.maximum(_about_axis(p) - 2, np.abs(p[:, 2]) - 1.5)),
    "cone": (hullcast.cone(2, 3), np.pi * 4, lambda p: np.maximum(_about_axis(p) - 2 * (1.5 - p[:, 2]) / 3, -1.5 - p[:, 2])),
    "capsule": (hullcast.capsule(2, 3), np.pi * 4 * 3 + 4 / 3 * np.pi * 8, lambda p: _capsule(p, 2, 3)),
    "capsule 7": (hullcast.capsule(2, 3, sides=7), np.pi * 4 * 3 + 4 / 3 * np.pi * 8, lambda p: _capsule(p, 2, 3)),
    "capsule 64": (hullcast.capsule(2, 3, sides=64), np.pi * 4 * 3 + 4 / 3 * np.pi * 8, lambda p: _capsule(p, 2, 3)),
}  # fmt: skip


@pytest.mark.parametrize("name", ROUND)
def test_round_shapes_are_inside_by_the_stated_error(client, name):
    """Catches a vertex outside the true shape, and an error that is too small or far too large."""
    shape, volume, outside = ROUND[name]
    assert outside(shape.vertices).max() < 1e-14 * 10
    hull = Spatial.ConvexHull(shape.vertices)
    # The true surface lies between the hull and the hull grown by the error. So the support in any
    # direction differs by at most the error, and in some direction by nearly the error.
    rng = np.random.default_rng(1)
    directions = np.concatenate([rng.normal(size=(20000, 3)), hull.equations[:, :3]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    support = (directions @ shape.vertices.T).max(axis=1)
    true = {
        "s": lambda d: np.full(len(d), 2.0),
        "cy": lambda d: 2 * _about_axis(d) + 1.5 * np.abs(d[:, 2]),
        "co": lambda d: np.maximum(2 * _about_axis(d) - 1.5 * d[:, 2], 1.5 * d[:, 2]),
        "ca": lambda d: 2 + 1.5 * np.abs(d[:, 2]),
    }[name[: 1 if name[0] == "s" else 2]](directions)
    gap = true - support
    assert gap.min() > -1e-13
    assert 0.9 * shape.error < gap.max() <= shape.error
    (registered,) = client.register(shape)
    assert registered.volume == pytest.approx(hull.volume)
    assert registered.volume < volume
    assert registered.vertex_count == len(shape.vertices)  # each vertex is a corner


def test_flat_shapes_are_exact(client):
    """Catches half lengths that are mistaken for full ones, and a prism that is rotated."""
    box, cube, prism = client.register(
        [hullcast.box((1, 2, 3)), hullcast.box(2), hullcast.prism(6, 1, 2)]
    )
    assert (box.volume, cube.volume) == (6, 8)
    assert prism.volume == pytest.approx(2 * 1.5 * 3**0.5)
    assert hullcast.prism(5, 1, 2).vertices[0].tolist() == [1, 0, -1]
    assert all(s.error == 0 for s in (hullcast.box(1), hullcast.prism(3, 1, 1)))


@pytest.mark.parametrize("bad", [0, -1, float("nan"), float("inf"), "1", None, True, 1e51, [1], 1j])
def test_sizes_are_checked(bad):
    """Catches a shape of no size; the message has the argument and the range."""
    calls = {
        "radius": [
            lambda: hullcast.sphere(bad),
            lambda: hullcast.cylinder(bad, 1),
            lambda: hullcast.cone(bad, 1),
            lambda: hullcast.prism(3, bad, 1),
            lambda: hullcast.capsule(bad, 1),
        ],
        "height": [
            lambda: hullcast.cylinder(1, bad),
            lambda: hullcast.cone(1, bad),
            lambda: hullcast.prism(3, 1, bad),
        ],
        "length": [lambda: hullcast.capsule(1, bad)],
        # In an array of numbers, numpy takes True for 1.
        "size": [
            lambda: hullcast.box(bad),
            lambda: hullcast.box((1, 0 if bad is True else bad, 1)),
        ],
        "sides": [
            lambda: hullcast.cylinder(1, 1, sides=bad),
            lambda: hullcast.prism(bad, 1, 1),
            lambda: hullcast.capsule(1, 1, sides=bad),
        ],
    }
    for field, group in calls.items():
        for call in group:
            with pytest.raises(hullcast.InvalidArgument, match="expected") as caught:
                call()
            assert caught.value.field.startswith(field)
    if bad != 0:
        with pytest.raises(hullcast.InvalidArgument, match="subdivisions"):
            hullcast.sphere(1, subdivisions=bad)

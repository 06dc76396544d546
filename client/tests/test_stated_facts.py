"""Facts about answers that the documentation states."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from crowds import CUBE

import hullcast


def turned(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    """The points, turned at random."""
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return points @ turn


@pytest.mark.parametrize("most", [0, 4])
def test_points_run_anticlockwise_about_the_normal(client, most):
    """Catches a patch whose points are in another order than docs/python/first-contacts.md says."""
    rng = np.random.default_rng(5)
    shapes = [hullcast.cylinder(1, 1), hullcast.box(1.4), hullcast.prism(7, 1, 1)]
    hulls = client.register(shapes)
    count = 60
    z = np.where(np.arange(count) % 2, -1.0, 1.0) * 0.999
    positions = np.zeros((2 * count, 3))
    positions[1::2] = np.c_[rng.uniform(-0.4, 0.4, (count, 2)), z]
    half = rng.uniform(0, np.pi, 2 * count)
    rotations = np.c_[np.zeros((2 * count, 2)), np.sin(half), np.cos(half)]
    of = rng.choice([0, 2], 2 * count)
    scene = hullcast.Scene(hulls, positions, rotations, body_hulls=of)
    pairs = np.arange(2 * count).reshape(-1, 2)
    accuracy = hullcast.Accuracy(max_points=most)
    m = client.query(scene, pairs, margin=0.01, accuracy=accuracy)
    assert (m.point_counts >= 3).all()
    assert {round(z) for z in m.normal[:, 2]} == {-1, 1}
    for pair in m:
        sides = np.roll(pair.witness_a, -1, axis=0) - pair.witness_a
        turns = np.cross(sides, np.roll(sides, -1, axis=0)) @ pair.normal
        assert (turns >= -1e-12).all()


def test_a_body_meets_itself(client):
    """Catches another answer for a pair of one body than the documentation states."""
    scene = hullcast.Scene(client.register(CUBE), [[1, 2, 3]], [[0, 0, 0, 1]])
    m = client.query(scene, [[0, 0]])
    assert (m[0].outcome, m[0].alpha, m[0].flags) == ("CONTACT", 0, "COINCIDENT")
    assert len(client.find(scene, margin=1)) == 0


@pytest.mark.parametrize(
    ("decimals", "thickness", "whole"),
    [(5, 0.005, True), (5, 0.001, False), (6, 0.001, True), (4, 0.01, False), (4, 0.05, False)],
)
def test_thin_plates_need_more_decimals(client, decimals, thickness, whole):
    """Catches another rule for thin plates than docs/tradeoff.md states: 500 units are enough."""
    rng = np.random.default_rng(6)
    plate = CUBE * [0.4, 0.3, thickness]
    shapes = [np.round(turned(rng, plate), decimals) for _ in range(100)]
    six = sum(hull.face_count == 6 for hull in client.register(shapes))
    assert (six == len(shapes)) == whole


def test_a_body_of_every_world_meets_no_other_such_body(client):
    """Catches another rule for world 2^32 - 1 than the documentation states."""
    (hull,) = client.register(CUBE)
    worlds = [2**32 - 1, 2**32 - 1, 7, 8]
    scene = hullcast.Scene([hull] * 4, np.zeros((4, 3)), [[0, 0, 0, 1]] * 4, worlds=worlds)
    assert client.find(scene).pairs.tolist() == [[0, 2], [0, 3], [1, 2], [1, 3]]


def test_a_closed_cavity_does_not_count(client):
    """Catches a warning for a cavity inside a convex mesh, which client/README.md excludes."""
    from solids import box

    inner = box((0.1, 0.1, 0.1), (0.9, 0.9, 0.9))[:, ::-1]
    corners = np.concatenate([box((0, 0, 0), (1, 1, 1)), inner]).reshape(-1, 3)

    class Mesh:
        vertices, faces = corners, np.arange(len(corners)).reshape(-1, 3)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (hull,) = client.register(Mesh())
    assert hull.volume == pytest.approx(1)

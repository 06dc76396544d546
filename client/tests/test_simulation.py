"""The simulation example: its contacts by least translation, and a box that comes to rest."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import hullcast

pytest.importorskip("scipy")
pytest.importorskip("PIL")
EXAMPLE = Path(__file__).resolve().parents[1] / "examples/simulation"


@pytest.fixture(scope="module", autouse=True)
def example():
    """Makes the example's modules importable, as when the example runs."""
    sys.path.insert(0, str(EXAMPLE))
    yield
    sys.path.remove(str(EXAMPLE))


def turns(rng, count):
    """Random unit quaternions."""
    turn = rng.normal(size=(count, 4))
    return turn / np.linalg.norm(turn, axis=1, keepdims=True)


def test_no_direction_is_shorter():
    """Catches an axis that is left out, or that is not a normal of the Minkowski difference.

    The separation is that of the support planes. No other direction, near or far, has a larger one.
    In some cases a face's normal is the best, in others that of an edge pair.
    """
    import least
    from world import matrices

    rng = np.random.default_rng(5)
    by_edges = overlapping = 0
    for trial in range(120):
        points = [rng.normal(size=(12 + trial % 20, 3)) * rng.uniform(0.3, 1, 3) for _ in range(2)]
        corners = [p[np.unique(least.ConvexHull(p).simplices)] for p in points]
        turned = matrices(turns(rng, 2))
        a, b = (least.placed(least.shape_of(c), t) for c, t in zip(corners, turned, strict=True))
        offset = rng.normal(size=3) * 0.7
        n, most = least.axis(a, b, offset)

        def separation(m, a=a, b=b, offset=offset):
            return ((b.vertices + offset) @ m.T).min(axis=0) - (a.vertices @ m.T).max(axis=0)

        assert abs(separation(n[None])[0] - most) < 1e-12
        if most >= 0:
            continue
        overlapping += 1
        others = rng.normal(size=(4000, 3))
        others[2000:] = n + 0.02 * others[2000:]
        others /= np.linalg.norm(others, axis=1, keepdims=True)
        assert separation(others).max() <= most + 1e-12
        faces = np.concatenate([a.normals, -b.normals])
        by_edges += np.abs(faces - n).max(axis=1).min() > 1e-6
    assert overlapping > 60
    assert by_edges > 10


def test_the_steps_after_the_normal_are_the_servers(client):
    """Catches a wrong feature, a clip that loses a corner, and a lift to the wrong hull.

    If both methods have the same normal, they must have the same points and distances.
    """
    import contacts
    import least
    from world import matrices

    rng = np.random.default_rng(7)
    half = np.array([0.2, 0.3, 0.15])
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    sides = 2 * np.pi * np.arange(5) / 5
    prism = np.array([[np.cos(t) / 4, np.sin(t) / 4, z] for t in sides for z in (-0.2, 0.2)])
    shapes = [signs * half, prism]
    hulls = client.register(shapes)
    solids = [least.shape_of(shape) for shape in shapes]
    compared = polygons = 0
    for _ in range(150):
        kinds = rng.integers(2, size=2)
        rotations = turns(rng, 2) if rng.random() < 0.5 else np.tile([0.0, 0, 0, 1], (2, 1))
        rotations += rng.normal(size=(2, 4)) * 1e-3
        rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
        positions = np.array([[0, 0, 0], rng.normal(size=3) * 0.25])
        scene = hullcast.Scene([hulls[k] for k in kinds], positions, rotations)
        outputs = ["NORMAL", "POINTS", "FEATURES"]
        answer = client.query(scene, [[0, 1]], margin=0.01, outputs=outputs)
        ours = contacts.by_growth_distance(answer)
        if len(ours.point) == 0:
            continue
        least_ones = least.by_least_translation(
            [solids[k] for k in kinds], ours.pairs, positions, matrices(rotations), 0.01
        )
        if np.abs(least_ones.normal - ours.normal).max() > 1e-9:
            continue
        compared += 1
        polygons += len(ours.point) > 2
        assert len(ours.point) == len(least_ones.point)
        far = np.linalg.norm(ours.point[:, None] - least_ones.point, axis=2)
        assert far.min(axis=1).max() < 1e-9
        nearest = far.argmin(axis=1)
        assert len(set(nearest)) == len(nearest)
        assert np.abs(least_ones.distance[nearest] - ours.distance).max() < 1e-9
        assert len({tuple(i) for i in least_ones.ids.tolist()}) == len(least_ones.ids)
    assert compared > 40
    assert polygons > 20


@pytest.mark.parametrize("by_least", [False, True])
def test_a_box_comes_to_rest(client, by_least):
    """Catches impulses with a wrong sign or point, and friction that pushes.

    A box that is released on an edge ends at rest on its face, no deeper than the slop plus the
    fall of one step.
    """
    import scenes
    from world import World

    setup = scenes.rocking()
    world = World(
        client, setup.shapes, setup.positions, setup.rotations, 1, iterations=20, by_least=by_least
    )
    for _ in range(300):
        last = world.step()
    world.close()
    assert world.kinetic_energy() < 1e-12
    assert last.contacts == 4
    assert last.depth < 2e-3
    assert abs(world.positions[1, 2] - 0.5) < 2e-3

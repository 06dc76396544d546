"""Results by body, in body frames, and with tangents."""

from __future__ import annotations

import numpy as np
import pytest
from crowds import CUBE, EVERYTHING, crowd

import hullcast
from hullcast import Manifolds, _views


@pytest.fixture(scope="module")
def some(client):
    """The pairs of a small crowd and of cubes on it, some of them within a margin."""
    scene = crowd(client, 60)
    cubes = hullcast.Scene(
        client.register(CUBE), [[20 + i, 0, 0.9 * i] for i in range(9)], [[0, 0, 0, 1]] * 9,
        body_hulls=[0] * 9,
    )  # fmt: skip
    scene = hullcast.Scene(
        [*scene.hull_ids, *cubes.hull_ids],
        [*scene.positions, *cubes.positions],
        [*scene.rotations, *cubes.rotations],
        body_hulls=[*scene.body_hulls, *(cubes.body_hulls + len(scene.hull_ids))],
    )
    pairs = [[i, j] for i in range(69) for j in range(69) if (i + j) % 2 and i != j]
    m = client.query(scene, pairs, margin=0.05, outputs=EVERYTHING)
    assert np.count_nonzero(m.point_counts > 2) > 8
    assert np.count_nonzero(m.point_counts) > 100
    assert np.count_nonzero(m.point_counts == 0) > 100
    return m


def test_per_body_is_what_a_loop_over_the_points_gives(some):
    """Catches points that are counted for one body only, and normals that are not turned for B."""
    count = np.zeros(69, int)
    deepest: list[tuple[float, np.ndarray]] = [(np.inf, np.zeros(3))] * 69
    total = np.zeros((69, 3))
    for pair in some:
        sides = zip(pair.bodies, (pair.witness_a, pair.witness_b), (1, -1), strict=True)
        for body, points, sign in sides:
            for point, distance in zip(points, pair.distance, strict=True):
                count[body] += 1
                total[body] += sign * pair.normal
                if distance < deepest[body][0]:
                    deepest[body] = (distance, point)
    found = some.per_body()
    assert found.count.tolist() == count.tolist()
    assert found.distance.tolist() == [distance for distance, _ in deepest]
    assert np.abs(found.normal * np.maximum(count, 1)[:, None] - total).max() < 1e-12
    touched = count > 0
    assert 40 < np.count_nonzero(touched) < 69
    assert (found.point[touched] == np.array([p for _, p in deepest])[touched]).all()
    assert (found.normal[~touched] == 0).all()
    assert (found.point[~touched] == 0).all()
    assert repr(found) == f"PerBody(69 bodies, {np.count_nonzero(touched)} of them in contact)"


def test_per_body_of_results_without_a_scene_or_without_pairs(client, some, tmp_path):
    """Catches a failure where there is nothing to add up, and an unnamed missing output."""
    some.save(tmp_path / "m.npz")
    loaded = Manifolds.load(tmp_path / "m.npz")
    assert len(loaded.per_body().count) == int(some.pairs.max()) + 1
    assert loaded.per_body().count.sum() == 2 * some.point_counts.sum()
    assert some[:0].per_body().count.tolist() == [0] * 69
    assert loaded[:0].per_body().count.tolist() == []
    with pytest.raises(hullcast.OutputNotAsked, match="POINTS"):
        client.query(some.scene, [[0, 1]], outputs=["NORMAL"]).per_body()
    with pytest.raises(hullcast.OutputNotAsked, match="NORMAL"):
        client.query(some.scene, [[0, 1]], outputs=["POINTS"]).per_body()


def test_a_body_between_two_has_opposite_normals(client):
    """The mean normal of a cube between two others is zero, and that of the outer ones is 1 long."""
    scene = hullcast.Scene(
        client.register(CUBE),
        [[0, 0, 0], [0, 0, 0.875], [0, 0, 1.75]],
        [[0, 0, 0, 1]] * 3,
        body_hulls=[0] * 3,
    )
    found = client.find(scene).per_body()
    assert found.count.tolist() == [4, 8, 4]
    assert found.normal.tolist() == [[0, 0, 1], [0, 0, 0], [0, 0, -1]]
    assert found.distance == pytest.approx([-0.125] * 3, abs=1e-15)
    assert found.point[:, 2] == pytest.approx([0.5, 0.375, 1.25], abs=1e-15)


def directions() -> np.ndarray:
    """Unit vectors: random ones, the axes and diagonals, and ones ever nearer to the jump."""
    rng = np.random.default_rng(5)
    grid = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], float)
    jump = np.array([-2.0, -3.0, -6.0]) / 7
    near = jump + rng.normal(size=(400, 3)) * np.logspace(-17, -1, 400)[:, None]
    every = np.concatenate([rng.normal(size=(2000, 3)), np.delete(grid, 13, axis=0), near, [jump]])
    return every / np.linalg.norm(every, axis=1, keepdims=True)


def test_frames_are_orthonormal_for_every_normal():
    """Catches a frame that is not orthonormal near the direction at which the tangents jump."""
    normals = directions()
    frames = _views.frames(normals)
    assert (frames[:, 0] == normals).all()
    products = np.einsum("nij,nkj->nik", frames, frames)
    assert np.abs(products - np.eye(3)).max() < 1e-15
    assert np.abs(np.linalg.det(frames) - 1).max() < 1e-15
    assert np.isnan(_views.frames(np.full((1, 3), np.nan))).all()
    assert _views.frames(np.zeros((0, 3))).shape == (0, 3, 3)


def test_frames_are_continuous():
    """Catches a branch at which tangents jump, as at z = 0 in the usual construction.

    A step of the normal turns the tangents at most 4 / |r + n| times as far, where r + n is zero
    only at the one direction that is excepted.
    """
    rng = np.random.default_rng(6)
    normals = directions()
    step = rng.normal(size=normals.shape) * 1e-9
    moved = normals + step
    moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    far = np.linalg.norm(normals + np.array([2.0, 3.0, 6.0]) / 7, axis=1)
    kept = far > 1e-6
    assert np.count_nonzero(kept) > 2100
    assert np.count_nonzero(kept & (far < 1e-3)) > 30
    change = np.abs(_views.frames(moved) - _views.frames(normals)).max(axis=(1, 2))
    bound = 4 / far * np.linalg.norm(moved - normals, axis=1) + 1e-15
    assert (change <= bound)[kept].all()


def test_frames_of_answers(some):
    assert some.frame.shape == (len(some), 3, 3)
    assert (some.frame[:, 0] == some.normal).all()
    assert (some[7].frame == some.frame[7]).all()


def test_points_in_body_frames_are_on_the_hulls(client, some):
    """Catches an inverse rotation that is taken twice or not at all, and A and B exchanged."""
    scene = some.scene
    for side, points in enumerate((some.local_a, some.local_b)):
        witness = (some.witness_a, some.witness_b)[side]
        body = np.repeat(some.pairs[:, side], some.point_counts)
        x, y, z, w = (
            scene.rotations[body] / np.linalg.norm(scene.rotations[body], axis=1)[:, None]
        ).T
        matrices = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
        back = np.einsum("ijn,nj->ni", matrices, points) + scene.positions[body]
        assert np.abs(back - witness).max() < 1e-14 * max(1, np.abs(witness).max())
    pair = next(pair for pair in some if len(pair.distance) > 2)
    rows = slice(*some.point_offsets[pair.index : pair.index + 2])
    assert (pair.local_a == some.local_a[rows]).all()
    assert (pair.local_b == some.local_b[rows]).all()


def test_points_in_body_frames_follow_a_session(client):
    """Catches poses of the session's first scene where the step's poses are needed."""
    scene = hullcast.Scene(
        client.register(CUBE), [[0, 0, 0]] * 2, [[0, 0, 0, 1]] * 2, body_hulls=[0, 0]
    )
    with client.session(scene, [[0, 1]]) as session:
        m = session.step([[5, 0, 0], [5, 0, 0.75]], [[0, 0, 0, 1], [0, 0, 2, 0]])
    assert m.local_a[:, 2] == pytest.approx([0.5] * 4)
    assert m.local_b[:, 2] == pytest.approx([-0.5] * 4)
    assert m.local_b[:, :2] == pytest.approx(-m.local_a[:, :2])


def test_points_in_body_frames_need_a_scene(some, tmp_path):
    some.save(tmp_path / "m.npz")
    loaded = Manifolds.load(tmp_path / "m.npz")
    for name in ("local_a", "local_b"):
        with pytest.raises(hullcast.InvalidArgument, match=r"scene: .*assign its scene"):
            getattr(loaded, name)
    loaded.scene = some.scene
    assert (loaded.local_b == some.local_b).all()

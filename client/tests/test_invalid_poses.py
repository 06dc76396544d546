"""Unusable poses raise an error by default in every kind of call, with the whole result."""

from __future__ import annotations

import asyncio
import pickle

import numpy as np
import pytest
from crowds import CUBE, EVERYTHING, NO_PROXY, expect_same

import hullcast
from hullcast import Outcome

PAIRS = [[0, 1], [1, 2], [2, 3]]
SPOILED = {
    "nan": ("positions", [np.nan, 0, 0], "is not finite"),
    "infinite": ("positions", [0, np.inf, 0], "is not finite"),
    "far": ("positions", [0, 0, -2e100], "is beyond 1e+100"),
    "zero": ("rotations", [0, 0, 0, 0], "has norm 0, 0.25 to 4 is allowed"),
    "small": ("rotations", [0, 0, 0, 0.2499], "has norm 0.2499"),
    "large": ("rotations", [0, 0, 4.001, 0], "has norm 4.001"),
    "huge": ("rotations", [1e200, 0, 0, 1], "has norm"),
    "no rotation": ("rotations", [0, np.nan, 0, 1], "is not finite"),
}


@pytest.fixture
def row(client):
    """Four cubes in a row, each touching the next."""
    positions = np.zeros((4, 3))
    positions[:, 0] = 0.9 * np.arange(4)
    return hullcast.Scene(client.register([CUBE]) * 4, positions, [[0, 0, 0, 1]] * 4)


def spoiled(scene: hullcast.Scene, name: str, body: int) -> hullcast.Scene:
    """The scene with an unusable pose of one body."""
    argument, value, _ = SPOILED[name]
    poses = {"positions": scene.positions.copy(), "rotations": scene.rotations.copy()}
    poses[argument][body] = value
    return scene.moved(**poses)


@pytest.mark.parametrize("name", SPOILED)
def test_every_call_raises_and_names_body_and_reason(client, row, name):
    """Catches a diverged simulation that looks like one without contacts."""
    argument, _, reason = SPOILED[name]
    bad = spoiled(row, name, 2)
    with pytest.raises(hullcast.InvalidPoses) as caught:
        client.query(bad, PAIRS, outputs=EVERYTHING)
    error = caught.value
    assert error.bodies.tolist() == [2]
    assert (error.field, error.index, error.reason) == (argument, 2, "INVALID_POSES")
    assert "1 of 4 bodies has an unusable pose (body 2: its " in str(error)
    assert reason in str(error)
    assert error.reasons[0] in str(error)
    assert error.manifolds.outcome.tolist() == [Outcome.CONTACT, Outcome.INVALID, Outcome.INVALID]
    expect_same(client.query(bad, PAIRS, outputs=EVERYTHING, on_invalid="flag"), error.manifolds)
    with pytest.raises(hullcast.InvalidPoses) as caught:
        client.find(bad)
    assert caught.value.manifolds.pairs.tolist() == [[0, 1]]
    assert client.find(bad, on_invalid="flag").invalid_bodies.tolist() == [2]


def test_a_session_goes_on_after_it(client, row):
    """Catches a session that is unusable, or gives an older result, after the exception."""
    expected = client.query(row, PAIRS, outputs=EVERYTHING)
    with client.session(row, PAIRS, outputs=EVERYTHING) as session:
        for name in SPOILED:
            bad = spoiled(row, name, 0)
            with pytest.raises(hullcast.InvalidPoses, match="body 0"):
                session.step(bad.positions, bad.rotations)
            found = session.step(row.positions, row.rotations)
            assert found.outcome.tolist() == expected.outcome.tolist()
            assert found.alpha == pytest.approx(expected.alpha, rel=1e-12)
    with client.session(row, PAIRS, on_invalid="flag") as session:
        assert "INVALID" in repr(session.step(bad.positions, bad.rotations))


def test_with_await(client, row):
    """Catches an asyncio client that does not raise."""
    bad = spoiled(row, "nan", 1)

    async def run() -> None:
        async with hullcast.aio.connect(client.target, options=NO_PROXY) as other:
            with pytest.raises(hullcast.InvalidPoses):
                await other.query(bad, PAIRS)
            with pytest.raises(hullcast.InvalidPoses):
                await other.find(bad)
            async with other.session(row, PAIRS) as session:
                with pytest.raises(hullcast.InvalidPoses):
                    await session.step(bad.positions, bad.rotations)

    asyncio.run(run())


@pytest.mark.parametrize("count", [4, 400])
def test_a_body_in_no_pair_counts_too(client, row, count):
    """Catches a result that depends on whether only a part of a large scene was sent."""
    scene = hullcast.Scene(
        row.hull_ids[:1], np.zeros((count, 3)), [[0, 0, 0, 1]] * count, body_hulls=[0] * count
    )
    with pytest.raises(hullcast.InvalidPoses) as caught:
        client.query(spoiled(scene, "nan", 3), [[0, 1]])
    assert caught.value.bodies.tolist() == [3]
    assert caught.value.manifolds.outcome.tolist() == [Outcome.CONTACT]


def test_many_bodies_are_counted_and_some_are_named(client, row):
    """Catches a message of a million lines. The exception has all bodies and can be pickled."""
    with pytest.raises(hullcast.InvalidPoses) as caught:
        client.query(
            hullcast.Scene(row.hull_ids, np.full((50, 3), np.nan), [[0, 0, 0, 1]] * 50, body_hulls=[0] * 50),
            [[0, 1]],
        )  # fmt: skip
    text = str(caught.value)
    assert "50 of 50 bodies" in text
    assert "and 45 more" in text
    assert len(text) < 700
    copy = pickle.loads(pickle.dumps(caught.value))
    assert copy.bodies.tolist() == list(range(50))
    assert str(copy) == text
    assert copy.manifolds.outcome.tolist() == [Outcome.INVALID]


def test_quaternions_are_normalised(client, row):
    """Catches a norm of 0.25 to 4 that is refused or changes the result (2^k: no bit)."""
    turns = np.random.default_rng(5).normal(size=(4, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    expected = client.query(row.moved(row.positions, turns), PAIRS, outputs=EVERYTHING)
    for by in (0.5, 2.0):
        found = client.query(row.moved(row.positions, turns * by), PAIRS, outputs=EVERYTHING)
        expect_same(found, expected)
    for by in (0.2501, 1.01, 1 - 1e-3, 3.999):
        found = client.query(row.moved(row.positions, turns * by), PAIRS)
        assert found.outcome.tolist() == expected.outcome.tolist()
        assert found.alpha == pytest.approx(expected.alpha, rel=1e-12)


@pytest.mark.parametrize("place", [(0, 0), (1, 3), (3, 3), (3, 0), ...])
@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_matrix_that_is_not_finite_is_an_unusable_pose(client, row, place, number):
    """Matrices of NaN were refused as no pose or no rotation, and ended a session's step."""
    whole = np.tile(np.eye(4), (4, 1, 1))
    whole[:, :3, 3] = row.positions
    whole[1][place] = number
    with pytest.raises(hullcast.InvalidPoses):
        client.query(row.moved(whole), PAIRS)
    m = client.query(row.moved(whole), PAIRS, on_invalid="flag")
    assert m.invalid_bodies.tolist() == [1]
    assert [outcome == "INVALID" for outcome in m.outcome] == [True, True, False]
    turns = np.tile(np.eye(3), (4, 1, 1))
    turns[1][(0, 0)] = number
    m = client.query(row.moved(row.positions, turns), PAIRS, on_invalid="flag")
    assert m.invalid_bodies.tolist() == [1]
    with client.session(row, PAIRS, on_invalid="flag") as session:
        assert session.step(whole).invalid_bodies.tolist() == [1]
        assert session.step(row.positions, turns).invalid_bodies.tolist() == [1]

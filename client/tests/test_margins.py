"""Margins of bodies, and speculative margins from their motions."""

from __future__ import annotations

import asyncio
import pickle
from collections import Counter
from typing import Any

import numpy as np
import pytest
from crowds import CUBE, EVERYTHING, NO_PROXY, crowd, expect_same
from hostile import mock_server

import hullcast
from hullcast import Outcome
from hullcast._pb import contacts_pb2, server_pb2

NAN, INF = float("nan"), float("inf")
UPRIGHT = [0, 0, 0, 1]


def two(client: hullcast.Client, distance: float, **options: Any) -> hullcast.Scene:
    """Two unit cubes side by side along x, with this distance between them."""
    hull = client.register([CUBE])[0]
    assert CUBE.min() == -0.5
    positions = [[0, 0, 0], [1 + distance, 0, 0]]
    return hullcast.Scene([hull] * 2, positions, [UPRIGHT] * 2, **options)


def moving(bodies: int, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    return {
        "linear_velocities": rng.normal(size=(bodies, 3)) * 0.5,
        "angular_velocities": rng.normal(size=(bodies, 3)) * 2,
        "turning_points": rng.normal(size=(bodies, 3)) * 0.2,
        "time_step": 0.1,
    }


def margins_of(scene: hullcast.Scene, pairs: Any, margin: float, motion: dict[str, Any]) -> Any:
    """The margins of pairs of cubes about their centres, by the formula of the contract."""
    a, b = np.transpose(pairs)
    h, v = motion["time_step"], motion["linear_velocities"]
    reach = np.sqrt(0.75) + np.linalg.norm(motion["turning_points"], axis=1)
    turn = np.minimum(h * np.linalg.norm(motion["angular_velocities"], axis=1), 2) * reach
    bound = h * np.linalg.norm(v[b] - v[a], axis=1) + turn[a] + turn[b]
    assert scene.margins is not None
    return margin + (scene.margins[a] + scene.margins[b]) + bound


def test_the_margins_of_both_bodies_count(client):
    """Catches a margin that is taken from one body, twice, or not at all, in both calls."""
    for margins in ([0.1, 0.2], [0.0, 0.3], [0.3, 0.0]):
        scene = two(client, 0.299, margins=margins)
        assert client.query(scene, [[0, 1]]).in_contact.tolist() == [True]
        assert client.find(scene).pairs.tolist() == [[0, 1]]
        apart = two(client, 0.301, margins=margins)
        assert client.query(apart, [[0, 1]]).outcome.tolist() == [Outcome.SEPARATED]
        assert len(client.find(apart)) == 0
        assert len(client.find(apart, margin=0.01)) == 1
    scene = two(client, 0.299, margins=[0.1, 0.2])
    assert scene.moved(scene.positions, scene.rotations).margins.tolist() == [0.1, 0.2]
    assert pickle.loads(pickle.dumps(scene)).margins.tolist() == [0.1, 0.2]


@pytest.mark.parametrize("per_message", [4096, 60])
def test_each_pair_has_its_own_margin(client, per_message):
    """Every pair is queried again by itself with the margin of the formula.

    Catches columns that are not sent with each message, or not reduced to a message's bodies, in
    the blocking and in the asyncio client.
    """
    base = crowd_of_cubes(client, 60)
    motion = moving(60, 1)
    pairs = np.random.default_rng(2).integers(60, size=(240, 2))
    margins = margins_of(base, pairs, 0.01, motion)
    expected = [
        client.query(without(base), pair[None], margin=margin, outputs=EVERYTHING)
        for pair, margin in zip(pairs, margins, strict=True)
    ]
    plain = client.query(without(base), pairs, margin=0.01)
    with hullcast.connect(client.target, options=NO_PROXY) as other:
        other.pairs_per_message = per_message
        found = other.query(base, pairs, margin=0.01, outputs=EVERYTHING, **motion)
    expect_same(found, hullcast.Manifolds.concat(expected))
    assert (found.outcome != plain.outcome).sum() > 20
    # A message with few pairs has only their bodies.
    few = client.query(base, pairs[7:8], margin=0.01, outputs=EVERYTHING, **motion)
    expect_same(few, expected[7])

    async def run() -> None:
        async with hullcast.aio.connect(client.target, options=NO_PROXY) as other:
            other.pairs_per_message = per_message
            same = await other.query(base, pairs, margin=0.01, outputs=EVERYTHING, **motion)
            expect_same(same, found)
            motion["outputs"] = EVERYTHING
            expect_same(await other.find(base, **motion), client.find(base, **motion))

    asyncio.run(run())


def crowd_of_cubes(client: hullcast.Client, bodies: int) -> hullcast.Scene:
    rng = np.random.default_rng(3)
    return hullcast.Scene(
        client.register([CUBE]),
        rng.uniform(-2, 2, size=(bodies, 3)),
        rng.normal(size=(bodies, 4)) / 2 + [0, 0, 0, 1],
        body_hulls=[0] * bodies,
        margins=rng.uniform(0, 0.1, size=bodies),
    )


def without(scene: hullcast.Scene) -> hullcast.Scene:
    """The same bodies without margins."""
    hulls = list(scene.hull_ids)
    return hullcast.Scene(hulls, scene.positions, scene.rotations, body_hulls=scene.body_hulls)


def test_sessions_have_the_margins_of_the_scene(client):
    """Catches margins that a step or an update of a session loses, and a row of other margins."""
    scene = two(client, 0.25, margins=[0.1, 0.2])
    more = two(client, 0.25, margins=[0.1, 0.1])
    farther = scene.positions.copy()
    farther[1, 0] += 0.06
    with client.session(scene, find=True) as session:
        for _ in range(2):
            assert len(session.step(scene.positions, scene.rotations)) == 1
        assert len(session.update(more, previous=[0, 1])) == 0
        assert len(session.update(scene, previous=[0, 1])) == 1
        assert len(session.step(farther, scene.rotations)) == 0
    with client.session(scene, [[0, 1]]) as session:
        for positions, near in ((scene.positions, True), (scene.positions, True), (farther, False)):
            assert session.step(positions, scene.rotations).in_contact.tolist() == [near]


@pytest.mark.parametrize("find", [True, False])
def test_steps_with_motions_are_fresh_calls(client, find):
    """Random steps, in which some bodies have other velocities, move, come or go, or nothing moves.

    Catches a velocity that is not sent, goes to another body, outlives its update or is lost with
    the server's state, and a time step that holds for more than its step.
    """
    rng = np.random.default_rng(3)
    scene = without(crowd_of_cubes(client, 40))
    pairs = None if find else rng.integers(40, size=(120, 2))
    session = client.session(scene, pairs, find=find, margin=0.01)
    motion = dict.fromkeys(("linear_velocities", "angular_velocities", "turning_points"))
    seen: Counter[str] = Counter()
    for _ in range(60):
        kind = str(rng.choice(["whole", "named", "kept", "still", "lost", "update"]))
        given = {
            k: v for k, v in moving(len(scene), int(rng.integers(99))).items() if rng.random() < 0.6
        }
        h = 0.0 if kind == "still" else given.pop("time_step", 0.05)
        given.pop("time_step", None)
        if kind == "lost":
            for lane in session._lanes:
                lane.drop()
        if kind in ("kept", "still"):
            m = session.step(scene.positions, scene.rotations, time_step=h)
        elif kind == "named":
            bodies = rng.choice(len(scene), 5, replace=False)
            positions = scene.positions.copy()
            positions[bodies] += rng.normal(size=(5, 3)) * 0.05
            some = {k: v[bodies] for k, v in given.items()}
            m = session.step(
                positions[bodies], scene.rotations[bodies], moved=bodies, time_step=h, **some
            )
            for name, values in some.items():
                whole = np.zeros((len(scene), 3)) if motion[name] is None else motion[name].copy()
                whole[bodies] = values
                motion[name] = whole
            scene = scene.moved(positions, scene.rotations)
        elif kind == "update" and find:
            keep = np.flatnonzero(rng.random(len(scene)) < 0.9)
            new = np.concatenate([keep, keep[:2]])
            positions = scene.positions[new] + np.r_[np.zeros((len(keep), 3)), np.ones((2, 3))]
            scene = hullcast.Scene(
                scene.hull_ids, positions, scene.rotations[new], body_hulls=scene.body_hulls[new]
            )
            stayed = {k: None if v is None else v[new] for k, v in motion.items()}
            for column in filter(lambda v: v is not None, stayed.values()):
                column[-2:] = 0
            given = {k: v[new] for k, v in given.items()}
            m = session.update(scene, previous=[*keep, -1, -1], time_step=h, **given)
            motion = stayed | given
        else:
            motion |= given
            m = session.step(scene.positions, scene.rotations, time_step=h, **given)
        sent = motion | {"time_step": h}
        if find:
            expected = client.find(scene, margin=0.01, **sent)
            assert m.pairs.tolist() == expected.pairs.tolist()
        else:
            expected = client.query(scene, pairs, margin=0.01, **sent)
        assert m.outcome.tolist() == expected.outcome.tolist()
        assert m.alpha == pytest.approx(expected.alpha, rel=1e-9, nan_ok=True)
        still = client.find(scene, margin=0.01) if find else client.query(scene, pairs, margin=0.01)
        widened = (
            len(expected) - len(still) if find else sum(expected.in_contact) - sum(still.in_contact)
        )
        seen[kind] += 1
        seen["widened"] += int(widened > 0)
    session.close()
    assert min(seen.values()) >= 4, seen
    assert seen["widened"] >= 20, seen


def test_wrong_motions_of_a_step_are_refused(client):
    """Catches a wrong motion that is sent, or that costs the session."""
    scene = two(client, 0.25)
    with client.session(scene, find=True) as session:
        whole: Any = (scene.positions, scene.rotations)
        for options, field in (
            ({"linear_velocities": np.zeros((3, 3))}, "linear_velocities"),
            ({"angular_velocities": "fast"}, "angular_velocities"),
            ({"turning_points": np.zeros((2, 2))}, "turning_points"),
            ({"time_step": -1}, "time_step"),
            ({"time_step": NAN}, "time_step"),
            ({"time_step": INF}, "time_step"),
        ):
            with pytest.raises(hullcast.InvalidArgument) as caught:
                session.step(*whole, **options)
            assert caught.value.field == field
            with pytest.raises(hullcast.InvalidArgument) as caught:
                session.update(scene, **options)
            assert caught.value.field == field
        with pytest.raises(hullcast.InvalidArgument, match="expected shape"):
            session.step([[0, 0, 0]], [UPRIGHT], moved=[0], linear_velocities=np.zeros((2, 3)))
        fast = [[0, 0, 0], [-10, 0, 0]]
        assert len(session.step(*whole, linear_velocities=fast, time_step=0.1)) == 1
        assert len(session.step(*whole)) == 0
        assert len(session.step(*whole, time_step=0.1)) == 1
        wrong = [[0, 0, 0], [NAN, 0, 0]]
        with pytest.raises(hullcast.InvalidPoses, match="linear velocity") as unusable:
            session.step(*whole, linear_velocities=wrong, time_step=0.1)
        assert (unusable.value.field, unusable.value.index) == ("linear_velocities", 1)
        assert len(session.step(*whole, linear_velocities=fast, time_step=0.1)) == 1

        # A step that fails keeps its velocities for the step and for the update after it.
        still = np.zeros((2, 3))
        with pytest.raises(hullcast.DeadlineExceeded):
            session.step(*whole, linear_velocities=still, time_step=0.1, timeout=1e-9)
        assert len(session.update(scene, previous=[0, 1], time_step=0.1)) == 0
        assert (
            len(session.update(scene, previous=[0, 1], linear_velocities=fast, time_step=0.1)) == 1
        )
        assert len(session.update(scene, previous=[0, 1], time_step=0.1)) == 1

    async def steps(target: str) -> list[int]:
        async with (
            hullcast.aio.connect(target, options=NO_PROXY) as other,
            other.session(scene, find=True) as session,
        ):
            first = await session.step(*whole, linear_velocities=fast, time_step=0.1)
            return [len(first), len(await session.step(*whole))]

    assert asyncio.run(steps(client.target)) == [1, 0]


def test_find_is_the_query_of_every_pair(client):
    """Catches a pair that the broad phase loses, and a scene in worlds that loses its motions."""
    bodies = 80
    scene = crowd(client, bodies)
    rng = np.random.default_rng(5)
    scene = hullcast.Scene(
        list(scene.hull_ids),
        scene.positions * 2,
        scene.rotations,
        body_hulls=scene.body_hulls,
        margins=rng.uniform(0, 0.2, size=bodies),
    )
    motion = moving(bodies, 6)
    pairs = np.transpose(np.triu_indices(bodies, 1))
    every = client.query(scene, pairs, outputs=EVERYTHING, **motion)
    found = client.find(scene, outputs=EVERYTHING, **motion)
    expect_same(found, every[every.outcome != Outcome.SEPARATED])
    assert len(found) > len(client.find(scene)) > 0


def test_a_fast_body_is_found_before_it_passes(client):
    """Catches a speculative margin that has no effect. A bullet is 2 m away and flies 3 m."""
    scene = two(client, 2.0)
    flight = {"linear_velocities": [[0, 0, 0], [-300, 0, 0]], "time_step": 0.01}
    assert len(client.find(scene)) == 0
    m = client.find(scene, **flight)
    assert m.pairs.tolist() == [[0, 1]]
    assert m.separation[0] == pytest.approx(2.0)
    assert len(client.find(scene, **{**flight, "time_step": 0.006})) == 0
    assert len(client.find(scene, **{**flight, "time_step": 0})) == 0
    # A wheel turns about a point 3 m away: in a step, the cube on its rim moves by 2 m and more.
    turn = {"angular_velocities": [[0, 0, 0], [0, 0, 6]], "time_step": 0.1}
    assert len(client.find(scene, **turn)) == 0
    assert len(client.find(scene, turning_points=[[0, 0, 0], [0, 3, 0]], **turn)) == 1


def test_an_unusable_motion_is_an_unusable_body(client):
    """Catches a number that is not finite and stops the call, or is not named by the error."""
    scene = crowd_of_cubes(client, 5)
    pairs = [[0, 1], [2, 3]]
    for field, word in (
        ("linear_velocities", "linear velocity"),
        ("angular_velocities", "angular velocity"),
        ("turning_points", "turning point"),
    ):
        for wrong in (NAN, INF, -INF, 1.01e100):
            column = np.zeros((5, 3))
            column[2, 1] = wrong
            with pytest.raises(hullcast.InvalidPoses, match=word) as caught:
                client.query(scene, pairs, **{field: column})
            assert (caught.value.field, caught.value.index) == (field, 2)
            assert caught.value.manifolds.outcome[1] == Outcome.INVALID
            flagged = client.query(scene, pairs, on_invalid="flag", **{field: column})
            assert flagged.invalid_bodies.tolist() == [2]
            # No pair of this message names the body, so the server does not see it.
            few = client.query(scene, pairs[:1], on_invalid="flag", **{field: column})
            assert few.invalid_bodies.tolist() == [2]
            found = client.find(scene, on_invalid="flag", **{field: column})
            assert found.invalid_bodies.tolist() == [2]


def test_scene_files_have_margins(client, tmp_path):
    """Catches margins that are lost in a file, and a file with wrong margins that is accepted."""
    scene = hullcast.Scene(client.register([CUBE]), [[0, 0, 0]], [UPRIGHT], margins=[0.1 + 0.2])
    path = tmp_path / "scene.json"
    scene.save(path)
    assert hullcast.Scene.load(path).margins.tolist() == [0.1 + 0.2]
    text = path.read_text()
    path.write_text(text.replace("[0.30000000000000004]", "[]"))
    assert hullcast.Scene.load(path).margins is None
    for wrong in ("[-1]", "[1, 2]", "[NaN]", "[1e101]", '["a"]', "7"):
        path.write_text(text.replace("[0.30000000000000004]", wrong))
        with pytest.raises(hullcast.InvalidArgument) as caught:
            hullcast.Scene.load(path)
        assert caught.value.reason == "NOT_A_SCENE"


def test_a_server_that_is_too_old_is_refused():
    """An old server ignores the fields. Catches its answer to another question that is returned."""
    answer = contacts_pb2.QueryContactsResponse(
        outcomes=b"\2",
        flags=b"\0",
        alphas=[2.0],
        alpha_lowers=[2.0],
        alpha_uppers=[INF],
        separations=[1],
        normals=[1, 0, 0],
        point_counts=[0],
    )

    def old(request: bytes) -> list[bytes]:
        asked = contacts_pb2.QueryContactsRequest.FromString(request)
        answer.request_id = asked.request_id
        return [answer.SerializeToString()]

    info = server_pb2.GetServerInfoResponse(version="0.0.9")
    info.limits.max_message_bytes = 1 << 20
    with mock_server() as (mock, target), hullcast.connect(target, options=NO_PROXY) as client:
        mock.answers = {"QueryContacts": old, "FindContacts": old, "StreamContacts": old}
        mock.answers["GetServerInfo"] = lambda _: [info.SerializeToString()]
        plain = hullcast.Scene([b"\1" * 32] * 2, np.zeros((2, 3)), [UPRIGHT] * 2)
        with_margins = hullcast.Scene(
            [b"\1" * 32] * 2, np.zeros((2, 3)), [UPRIGHT] * 2, margins=[0, 1]
        )
        assert client.query(plain, [[0, 1]]).outcome[0] == Outcome.SEPARATED
        for call in (
            lambda: client.query(with_margins, [[0, 1]]),
            lambda: client.find(with_margins),
            lambda: client.session(with_margins, [[0, 1]]).step(np.zeros((2, 3)), [UPRIGHT] * 2),
            lambda: client.query(plain, [[0, 1]], linear_velocities=np.zeros((2, 3))),
            lambda: client.query(plain, [[0, 1]], time_step=0.1),
        ):
            with pytest.raises(hullcast.Unimplemented, match=r"version 0\.0\.9") as caught:
                call()
            assert caught.value.reason == "SERVER_TOO_OLD"
        # The same call to a server that knows the fields.
        answer.contract = 1
        assert client.query(with_margins, [[0, 1]]).outcome[0] == Outcome.SEPARATED

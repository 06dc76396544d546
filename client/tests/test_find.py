"""The pairs that the server finds equal those of querying every pair, bit for bit."""

from __future__ import annotations

import asyncio
import itertools

import numpy as np
import pytest
from crowds import CUBE, EVERYTHING, NO_PROXY, Server, crowd, expect_same

import hullcast
from hullcast import Outcome

EVERY_WORLD = 2**32 - 1


def may_meet(scene: hullcast.Scene, a: int, b: int) -> bool:
    """Whether two bodies may meet, by the documentation of `Scene`."""
    if scene.worlds is not None:
        v, w = (int(scene.worlds[body]) for body in (a, b))
        everywhere = (v == EVERY_WORLD) + (w == EVERY_WORLD)
        if everywhere == 2 or (not everywhere and v != w):
            return False
    if scene.groups is None:
        return True
    g, h = (int(scene.groups[body]) for body in (a, b))
    ignored = [] if scene.ignored_groups is None else scene.ignored_groups.tolist()
    return 0 in (g, h) or (g != h and [g, h] not in ignored and [h, g] not in ignored)


def exhaustive(client: hullcast.Client, scene: hullcast.Scene, margin: float) -> hullcast.Manifolds:
    """The pairs that are not SEPARATED, out of all pairs that may meet."""
    pairs = [ab for ab in itertools.combinations(range(len(scene)), 2) if may_meet(scene, *ab)]
    found = client.query(scene, np.reshape(pairs, (-1, 2)), margin=margin, outputs=EVERYTHING)
    return found[found.outcome != Outcome.SEPARATED]


def scenes(client: hullcast.Client) -> list[hullcast.Scene]:
    """A crowd without options, in worlds, in groups, and in both."""
    plain = crowd(client, 150)
    rng = np.random.default_rng(71)
    worlds = rng.choice([0, 1, 5, EVERY_WORLD], size=150)
    groups = rng.integers(5, size=150)
    ignored = [[1, 2], [4, 3], [4, 4]]
    made = [plain]
    for options in (
        {"worlds": worlds},
        {"groups": groups},
        {"worlds": worlds, "groups": groups, "ignored_groups": ignored},
    ):
        scene = hullcast.Scene(
            plain.hull_ids, plain.positions, plain.rotations, body_hulls=plain.body_hulls, **options
        )
        made.append(scene)
    return made


def test_what_is_found_is_what_asking_for_all_has(client):
    """Catches columns that are mixed up, and worlds or groups that are not sent."""
    counts = []
    for scene in scenes(client):
        for margin in (0.0, 0.1):
            found = client.find(scene, margin=margin, outputs=EVERYTHING)
            expect_same(found, exhaustive(client, scene, margin))
            assert (found.pairs[:, 0] < found.pairs[:, 1]).all()
            counts.append(len(found))
    assert min(counts) > 20
    assert len(set(counts)) == 8, counts


def test_many_messages_are_one_answer(client):
    """There are more pairs than one message has, with default outputs and with outcomes only."""
    hull = client.register([CUBE])[0]
    scene = hullcast.Scene([hull], np.zeros((150, 3)), [[0, 0, 0, 1]] * 150, body_hulls=[0] * 150)
    found = client.find(scene)
    assert found.pairs.tolist() == [list(ab) for ab in itertools.combinations(range(150), 2)]
    assert len(found) == 11_175
    assert (found.point_counts == 4).all()
    alone = client.find(scene, outputs=["OUTCOME"])
    assert (alone.outcome == Outcome.CONTACT).all()
    with pytest.raises(hullcast.OutputNotAsked):
        _ = alone.alpha


def test_nothing_to_find(client):
    """No bodies, one body, or two that are apart give empty columns of the right shapes."""
    hull = client.register([CUBE])[0]
    for count in range(3):
        positions = np.arange(3 * count).reshape(-1, 3) * 5.0
        scene = hullcast.Scene([hull], positions, [[0, 0, 0, 1]] * count, body_hulls=[0] * count)
        found = client.find(scene, outputs=EVERYTHING)
        assert len(found) == 0
        assert found.pairs.shape == (0, 2)
        assert found.normal.shape == found.witness_a.shape == (0, 3)


def test_bodies_that_are_in_no_pair_are_named(client):
    """Bodies with an unusable pose or an unknown hull are listed, and are in no pair."""
    hull = client.register([CUBE])[0]
    positions = np.zeros((4, 3))
    positions[1] = np.nan
    scene = hullcast.Scene(
        [hull, b"\7" * 32], positions, [[0, 0, 0, 1]] * 4, body_hulls=[0, 0, 1, 0]
    )
    with pytest.warns(hullcast.MissingHullsWarning, match="1 of 2 hulls"):
        found = client.find(scene, on_invalid="flag")
    assert found.pairs.tolist() == [[0, 3]]
    assert found.invalid_bodies.tolist() == [1]
    assert found.missing_hulls.tolist() == [1]


def test_a_server_that_lost_the_hulls_gets_them_back():
    """A restarted server without any hulls gives the same result again."""
    with Server() as server, hullcast.connect(server.address, options=NO_PROXY) as client:
        poses = crowd(client, 40)
        hulls = client.register([CUBE])
        scene = hullcast.Scene(hulls, poses.positions, poses.rotations, body_hulls=[0] * 40)
        before = client.find(scene, margin=0.1, outputs=EVERYTHING)
        assert len(before) > 5
        server.kill()
        server.start()
        expect_same(client.find(scene, margin=0.1, outputs=EVERYTHING), before)


@pytest.mark.parametrize(
    ("options", "reason", "field"),
    [
        ({"margin": np.inf}, "VALUE_OUT_OF_RANGE", "margin"),
        ({"margin": -1}, "VALUE_OUT_OF_RANGE", "margin"),
        ({"outputs": ["ALPHAS"]}, "UNKNOWN_VALUE", "outputs"),
    ],
)
def test_what_is_refused_is_named(client, options, reason, field):
    """The server or the client refuses a bad option, with reason and field."""
    with pytest.raises(hullcast.InvalidArgument) as caught:
        client.find(crowd(client, 4), **options)
    assert (caught.value.reason, caught.value.field) == (reason, field)


def test_a_timeout_ends_the_call(client):
    """A timeout ends a call with a stream of responses, too. The client stays usable."""
    scene = crowd(client, 2000)
    with pytest.raises(hullcast.DeadlineExceeded):
        client.find(scene, margin=5.0, timeout=1e-4)
    assert len(client.find(scene, margin=0.01, timeout=60)) > 100


def test_the_same_with_await(client):
    """The asyncio client gives the same results, several at a time, after a cancelled call too."""
    some = scenes(client)

    async def run() -> list[hullcast.Manifolds]:
        async with hullcast.aio.connect(client.target, options=NO_PROXY) as other:
            finds = (other.find(scene, margin=0.1, outputs=EVERYTHING) for scene in some)
            found = await asyncio.gather(*finds)
            task = asyncio.create_task(other.find(crowd(client, 2000), margin=5.0))
            await asyncio.sleep(0.01)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            again = await other.find(some[0], margin=0.1, outputs=EVERYTHING)
            expect_same(again, found[0])
            return found

    for scene, found in zip(some, asyncio.run(run()), strict=True):
        expect_same(found, client.find(scene, margin=0.1, outputs=EVERYTHING))

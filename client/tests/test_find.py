"""The pairs that the server finds equal those of querying every pair, bit for bit."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

import numpy as np
import pytest
from crowds import CUBE, EVERYTHING, NO_PROXY, Server, crowd, crowd_of, expect_same
from shapes import family

import hullcast
from hullcast import Outcome, _query, _worlds

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


def in_worlds(client: hullcast.Client, by_hull: bool = False) -> hullcast.Scene:
    """A crowd in worlds of different sizes, with groups; or in worlds with different hulls."""
    rng = np.random.default_rng(72)
    shapes = family("box", 3, rng) + family("poly16", 3, rng)
    hulls = [client.register([shape.vertices])[0] for shape in shapes]
    plain = crowd_of(hulls, 150, rng)
    worlds = rng.choice([EVERY_WORLD, 0, 3, 9, 2**31, EVERY_WORLD - 1], size=150)
    groups = rng.integers(5, size=150)
    groups[worlds == 9] += 4
    return hullcast.Scene(
        hulls, plain.positions, plain.rotations, body_hulls=plain.body_hulls,
        worlds=plain.body_hulls // 2 if by_hull else worlds,
        groups=groups, ignored_groups=[[1, 2], [3, 3], [5, 6], [4, 1]],
    )  # fmt: skip


@pytest.fixture
def messages(monkeypatch) -> list[int]:
    """The number of bodies of each message of `find` that the test sends."""
    sent: list[int] = []
    original = _query.Query.find_message

    def find_message(query: _query.Query, bodies: Any = None) -> Any:
        sent.append(len(query.scene) if bodies is None else len(bodies))
        return original(query, bodies)

    monkeypatch.setattr(_query.Query, "find_message", find_message)
    return sent


@pytest.mark.parametrize(
    ("limit", "most"),
    [("bodies-per-request", 60), ("hulls-per-request", 5), ("message-bytes", 4096)],
)
def test_a_scene_over_a_limit_is_found_in_parts(client, messages, limit, most):
    """The worlds are searched in several messages, and the answer is that of one message.

    Catches pairs with a body of world 2^32 - 1 that are lost or found twice, bodies and hulls that
    are numbered as in the part, and pairs that are sorted only within a part.
    """
    scene = in_worlds(client, by_hull=limit == "hulls-per-request")
    whole = client.find(scene, margin=0.3, outputs=EVERYTHING)
    assert messages == [150]
    shared = (scene.worlds[whole.pairs] == EVERY_WORLD).any(axis=1)
    assert np.count_nonzero(~shared) > 20
    assert np.count_nonzero(shared) > 20 or limit == "hulls-per-request"

    async def awaited(address: str) -> hullcast.Manifolds:
        async with hullcast.aio.connect(address, options=NO_PROXY) as other:
            return await other.find(scene, margin=0.3, outputs=EVERYTHING)

    with Server("memory://", f"--max-{limit}", str(most)) as server:
        # The server has no hulls: each part registers those that it needs.
        with hullcast.connect(server.address, options=NO_PROXY) as other:
            expect_same(other.find(scene, margin=0.3, outputs=EVERYTHING), whole)
        expect_same(asyncio.run(awaited(server.address)), whole)
    assert len(messages) > 4


def test_parts_name_the_bodies_of_the_scene(client, messages):
    """Unusable poses and unknown hulls of every part are numbered as in the scene.

    Catches lists of one part only, and lists that are numbered as in the part.
    """
    plain = in_worlds(client)
    positions = plain.positions.copy()
    bad = [0, 1, 80, 149]
    positions[bad] = np.nan
    hulls = [*plain.hull_ids[:5], b"\7" * 32]
    scene = hullcast.Scene(
        hulls, positions, plain.rotations, body_hulls=plain.body_hulls, worlds=plain.worlds
    )
    with Server("memory://", "--max-bodies-per-request", "60") as server, hullcast.connect(
        server.address, options=NO_PROXY
    ) as other:  # fmt: skip
        contents = plain.contents[:5]
        other.register([content.points for content in contents if content is not None])
        with pytest.warns(hullcast.MissingHullsWarning, match="1 of 6 hulls"):
            found = other.find(scene, margin=0.3, on_invalid="flag")
    assert len(messages) > 3
    assert len(found) > 20
    assert found.invalid_bodies.tolist() == bad
    assert found.missing_hulls.tolist() == [5]
    assert not np.isin(found.pairs, bad).any()
    assert not (scene.body_hulls[found.pairs] == 5).any()


def test_bodies_that_never_meet_are_split_anywhere():
    """Bodies of world 2^32 - 1 never meet each other. Catches a split that does not end."""
    scene = hullcast.Scene(
        [b"\7" * 32], np.zeros((7, 3)), [[0, 0, 0, 1]] * 7, body_hulls=[0] * 7,
        worlds=[EVERY_WORLD] * 7,
    )  # fmt: skip
    refused = hullcast.InvalidArgument("got too many", reason="TOO_MANY_BODIES")
    parts = [part.tolist() for part in _worlds.halves(scene, None, refused)]
    assert parts == [[0, 1, 2], [3, 4, 5, 6]]
    with pytest.raises(hullcast.InvalidArgument) as caught:
        _worlds.halves(scene, np.array([5], dtype="<u4"), refused)
    assert caught.value is refused


@pytest.mark.parametrize(
    ("worlds", "says"),
    [
        (None, "the scene's 61 bodies have no worlds"),
        ([4] * 61, "61 bodies are in world 4:"),
        (
            [EVERY_WORLD] + [4] * 59 + [5],
            "59 bodies are in world 4, and 1 in world 2^32 - 1, which",
        ),
    ],
)
def test_a_world_over_the_limit_is_refused(client, worlds, says):
    """The error has the number, the limit, the world and the remedies.

    Catches pairs that are dropped to fit the limit, and a split that never ends.
    """
    with Server("memory://", "--max-bodies-per-request", "59") as server, hullcast.connect(
        server.address, options=NO_PROXY
    ) as other:  # fmt: skip
        scene = hullcast.Scene(
            other.register(CUBE), np.zeros((61, 3)), [[0, 0, 0, 1]] * 61,
            body_hulls=[0] * 61, worlds=worlds,
        )  # fmt: skip
        with pytest.raises(hullcast.InvalidArgument) as caught:
            other.find(scene)
        assert (caught.value.reason, caught.value.field) == ("TOO_MANY_BODIES", "body_hulls")
        sent = 60 if worlds and EVERY_WORLD in worlds else 61
        for part in (f"got {sent}, at most 59 are allowed", says, "give the pairs to query"):
            assert part in caught.value.message
        # The remedy works: a query has only the bodies of its pairs in each message.
        other.pairs_per_message = 8
        every = np.array(list(itertools.combinations(range(61), 2)))
        assert other.query(scene, every).in_contact.all()


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

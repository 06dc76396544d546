"""Find sessions: each step equals `find` of the same scene, whatever came and went before it."""

from __future__ import annotations

import asyncio
import inspect
from collections import Counter
from typing import Any

import matching
import numpy as np
import programs
import pytest
from crowds import CUBE, EVERYTHING, NO_PROXY, Server
from loops import (
    MARGIN,
    OUTPUTS,
    SAME,
    SAME_POINTS,
    Difference,
    Loop,
    difference,
    expect_few,
    expect_matches,
    expect_seen,
    shaken,
    shapes,
    some,
)

import hullcast


def test_each_step_is_find_of_its_scene(client):
    """Random steps with bodies that move, stay, jump, come, go, or have no usable pose.

    Catches a pair that the session loses or keeps, a row from the state that is not the row of a
    fresh computation, a body that gets the pose or the hull of another, and wrong matches.
    """
    seen: Counter[str] = Counter()
    for seed in range(4):
        loop = Loop(client, seed)
        for _ in range(100):
            loop.step(client)
        seen += loop.seen
    expect_seen(seen, 400)


def test_moved_bodies_give_the_bits_of_whole_messages(client):
    """Two sessions with the same steps: one sends the bodies that moved, the other all of them."""
    rng = np.random.default_rng(5)
    hulls = client.register(shapes())
    bodies = some(rng, 30, len(hulls))
    scene = bodies.scene(hulls)
    options: Any = {"find": True, "margin": MARGIN, "outputs": OUTPUTS}
    with client.session(scene, **options) as some_of, client.session(scene, **options) as whole:
        pairs = 0
        for _ in range(60):
            rows = np.flatnonzero(rng.random(30) < rng.choice([0.0, 0.1, 0.5]))
            bodies = shaken(rng, bodies, rows, 1e-3)
            a = some_of.step(bodies.positions, bodies.rotations)
            b = whole.step(bodies.positions, bodies.rotations, moved=np.arange(30))
            pairs += len(a)
            for name in ("pairs", *SAME, *SAME_POINTS, "bases", "previous_pairs",
                         "previous_points", "ended_pairs"):  # fmt: skip
                assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
    assert pairs > 600


def test_a_step_without_motion_has_the_arrays_of_the_step_before(client):
    """Catches a copy of the arrays, and arrays that a caller could change for a later step."""
    hulls = client.register(shapes())
    scene = some(np.random.default_rng(6), 20, len(hulls)).scene(hulls)
    with client.session(scene, find=True, margin=MARGIN, outputs=OUTPUTS) as session:
        first, second, *still = (session.step(scene.positions, scene.rotations) for _ in range(5))
        assert len(first) > 5
        # The matches of the second answer are other ones than those of the first.
        assert second.witness_a.tobytes() == first.witness_a.tobytes()
        for m in still:
            assert m.witness_a is second.witness_a
            assert m.previous_pairs.tolist() == list(range(len(first)))
            assert m.previous_points.tolist() == list(range(len(first.distance)))
            assert not m.restarted
        with pytest.raises(ValueError, match="read-only"):
            still[0].normal[:] = 0


@pytest.mark.parametrize("kind", ["restarted", "another"])
def test_a_find_session_outlives_its_server(client, kind):
    """The server is killed; it starts again without the hulls, or another server goes on.

    Catches a step that fails, hulls that are missing, and matches with an answer of another server.
    """
    with Server() as a, Server() as b:
        targets = [a.address] if kind == "restarted" else [a.address, b.address]
        with hullcast.connect(targets, options=NO_PROXY) as lost:
            loop = Loop(lost, 7)
            restarts = False
            losses = 0
            for i in range(24):
                if i % 6 == 5 and kind == "restarted":
                    a.kill()
                    a.start()
                    restarts = True
                elif i == 12 and kind == "another":
                    # The session is on one of the two, which is not known from outside.
                    a.kill()
                    found = loop.session.step(loop.bodies.positions, loop.bodies.rotations)
                    losses += found.restarted
                    loop.before = found
                    a.start()
                    b.kill()
                    restarts = True
                loop.step(client, restarts=restarts)
                losses += restarts
                restarts = False
            assert losses == 4 if kind == "restarted" else losses in (1, 2)


@pytest.mark.filterwarnings("ignore::hullcast.MissingHullsWarning")
def test_steps_while_servers_are_killed_and_hulls_come_and_go(client):
    """Ten thousand random steps. The session's server is killed and starts again without any hull.

    Every other loop has bodies whose hull is deleted and registered again by somebody else.

    Catches what the other sweeps catch, but in a state that was lost and built again many times:
    rows, bounds or matches of the server that ended, and a hull that a kept row still answers for.
    """
    seen: Counter[str] = Counter()
    points = np.random.default_rng(77).normal(size=(14, 3)) * 0.35
    guest = client.register([points])[0]
    with Server() as killed, hullcast.connect(killed.address, options=NO_PROXY) as lost:
        for seed in range(100, 125):
            loop = Loop(lost, seed, guest=guest if seed % 2 else None)
            is_there = False
            if seed % 2:
                client.delete(guest)
                lost.delete(guest)
            for i in range(400):
                restarts = i % 133 == 132
                if restarts:
                    killed.kill()
                    killed.start()
                    seen["kills"] += 1
                if seed % 2 and (loop.rng.random() < 0.05 or (restarts and is_there)):
                    is_there = not is_there
                    for server in (client, lost):
                        server.register([points]) if is_there else server.delete(guest)
                    seen["hulls that came" if is_there else "hulls that went"] += 1
                loop.step(client, restarts=restarts)
            loop.session.close()
            seen += loop.seen
    expect_seen(seen, 10_000)
    assert seen["kills"] == 75
    assert min(seen["hulls that came"], seen["hulls that went"]) > 50, seen
    assert seen["steps without a hull"] > 1000, seen


def test_a_server_that_keeps_nothing(client):
    """Without room for its state each step is a full message, and has no matches."""
    with (
        Server("memory://", "--max-stream-state-bytes", "0") as server,
        hullcast.connect(server.address, options=NO_PROXY) as other,
    ):
        loop = Loop(other, 8)
        for _ in range(10):
            loop.step(client, restarts=True)
        assert loop.seen["pairs"] > 30


def test_answers_that_span_messages(client):
    """Catches pairs or matches that are lost or shifted where one message ends."""
    with (
        Server("memory://", "--max-message-bytes", "16384") as server,
        hullcast.connect(server.address, options=NO_PROXY) as other,
    ):
        loop = Loop(other, 9, bodies=60)
        most = 0
        for _ in range(30):
            most = max(most, len(loop.step(client)))
        assert most > 60


def test_a_scene_that_is_too_large_is_split_by_worlds(client):
    """Catches pairs of a part that are numbered by the part, and matches across parts."""
    with (
        Server("memory://", "--max-bodies-per-request", "70") as server,
        hullcast.connect(server.address, options=NO_PROXY) as other,
    ):
        rng = np.random.default_rng(10)
        hulls = other.register(shapes())
        bodies = some(rng, 90, len(hulls))._replace(worlds=rng.permutation(np.arange(90) % 9))
        bodies.worlds[:3] = 2**32 - 1
        bodies = bodies._replace(positions=bodies.positions * 0.6)
        session = other.session(
            bodies.scene(hulls), find=True, margin=MARGIN, outputs=OUTPUTS, on_invalid="flag"
        )
        before: hullcast.Manifolds | None = None
        seen: Counter[str] = Counter()
        bits = ties = pairs = 0
        for i in range(30):
            previous: list[int] | None = None
            if i % 5 == 4:
                kept = rng.permutation(np.flatnonzero(rng.random(len(bodies.hulls)) < 0.9))
                new = some(rng, 90 - len(kept), len(hulls))
                bodies = bodies.taken(kept).joined(new._replace(worlds=new.worlds % 9))
                previous = [*kept.tolist(), *[-1] * (90 - len(kept))]
                found = session.update(bodies.scene(hulls), previous=previous)
            else:
                rows = np.flatnonzero(rng.random(90) < (0.1, 0.0, 1.0)[i % 3])
                bodies = shaken(rng, bodies, rows, 1e-3)
                found = session.step(bodies.positions, bodies.rotations)
            expected = client.find(bodies.scene(hulls), margin=MARGIN, outputs=EVERYTHING)
            more = difference(found, expected)
            bits, ties, pairs = bits + more.bits, ties + more.ties, pairs + len(found)
            assert found.restarted == (i == 0)
            if before is not None:
                seen += expect_matches(before, found, previous)
            before = found
        assert len(session._lanes) == 2
        assert pairs > 300
        expect_few(Difference(bits, ties), pairs)
        assert seen["pairs that stayed"] > 200
        assert seen["pairs that ended"] > 10
        one = hullcast.Scene(hulls[:1], np.zeros((80, 3)), [[0, 0, 0, 1]] * 80, body_hulls=[0] * 80)
        with pytest.raises(hullcast.InvalidArgument, match=r"TOO_MANY_BODIES.*no worlds"):
            other.session(one, find=True).step(one.positions, one.rotations)


def test_hulls_that_are_missing(client):
    """A hull that the server lacks is registered again; without its points its bodies are left out.

    Catches a session that goes on without the hull, and matches with the answer that lacked it.
    """
    hulls = client.register([CUBE, CUBE * 0.9])
    positions = np.array([[0, 0, 0], [0, 0, 0.9], [0, 0, 1.8]])
    scene = hullcast.Scene(hulls, positions, [[0, 0, 0, 1]] * 3, body_hulls=[0, 1, 0])
    with client.session(scene, find=True, outputs=OUTPUTS) as session:
        assert len(session.step(positions, scene.rotations)) == 2
        client.delete(hulls[1])
        found = session.step(positions, scene.rotations)
        assert len(found) == 2
        assert found.restarted
        assert not session.step(positions, scene.rotations).restarted
        by_id = hullcast.Scene(
            [hulls[0], hullcast.hull_id(CUBE * 0.85)],
            positions,
            scene.rotations,
            body_hulls=[0, 1, 0],
        )
        with pytest.warns(hullcast.MissingHullsWarning, match="1 of 3 bodies is in no pair"):
            found = session.update(by_id, previous=[0, 1, 2])
        assert len(found) == 0
        assert sorted(found.ended_pairs.tolist()) == [[0, 1], [1, 2]]
        client.register(CUBE * 0.85)
        assert len(session.step(positions, scene.rotations)) == 2


def test_pairs_end_when_the_last_bodies_go(client):
    """Catches pairs that end unseen, because the message after them has no bodies.

    A server that permits few bodies makes a session of several streams, each with some worlds.
    """
    with Server("memory://", "--max-bodies-per-request", "4") as small:
        for target in (client.target, small.address):
            with hullcast.connect(target, options=NO_PROXY) as other:
                hull = other.register([CUBE])[0]

                def scene(worlds: int, hull: hullcast.Hull = hull) -> hullcast.Scene:
                    positions = np.array([[0, 0, 0], [0.5, 0, 0]] * worlds).reshape(-1, 3)
                    turns = np.tile([0, 0, 0, 1], (2 * worlds, 1))
                    of_hulls = [0] * (2 * worlds)
                    world = np.repeat(np.arange(worlds), 2)
                    return hullcast.Scene(
                        [hull], positions, turns, body_hulls=of_hulls, worlds=world
                    )

                whole = scene(3)
                with other.session(whole, find=True, outputs=OUTPUTS) as session:
                    session.step(whole.positions, whole.rotations)
                    found = session.update(scene(2), previous=[0, 1, 2, 3])
                    assert found.previous_pairs.tolist() == [0, 1]
                    assert found.ended_pairs.tolist() == [[4, 5]]
                    found = session.update(scene(0), previous=[])
                    assert found.ended_pairs.tolist() == [[0, 1], [2, 3]]
                    found = session.update(whole, previous=[-1] * 6)
                    assert (found.previous_pairs == -1).all()
                    assert len(found.ended_pairs) == 0


def test_an_unusable_pose_stays_until_it_is_sent_again(client):
    """Catches a body that becomes usable by itself, or whose pose is not sent again."""
    hulls = client.register([CUBE] * 2)
    scene = hullcast.Scene(hulls, [[0, 0, 0], [0, 0, 0.9]], [[0, 0, 0, 1]] * 2)
    with client.session(scene, find=True, outputs=OUTPUTS) as session:
        session.step(scene.positions, scene.rotations)
        bad = scene.positions.copy()
        bad[1, 0] = np.inf
        for _ in range(2):
            with pytest.raises(hullcast.InvalidPoses) as caught:
                session.step(bad, scene.rotations)
            assert caught.value.bodies.tolist() == [1]
            assert len(caught.value.manifolds) == 0
        found = session.step(scene.positions, scene.rotations)
        assert len(found) == 1
        assert found.previous_pairs.tolist() == [-1]
        assert not found.restarted


def test_a_step_that_takes_too_long_is_forgotten(client):
    """A step ends at its timeout; the next one is full, right, and without matches."""
    rng = np.random.default_rng(11)
    hulls = client.register(shapes())
    bodies = some(rng, 3000, len(hulls), side=14.0)
    scene = bodies.scene(hulls)
    with client.session(scene, find=True, margin=MARGIN, outputs=OUTPUTS) as session:
        for _ in range(2):
            with pytest.raises(hullcast.DeadlineExceeded):
                session.step(scene.positions, scene.rotations, timeout=1e-3)
            found = session.step(scene.positions, scene.rotations)
            assert found.restarted
        expected = client.find(scene, margin=MARGIN, outputs=EVERYTHING)
        assert difference(found, expected) == (0, 0)  # a full message on a new stream starts cold


def test_find_sessions_with_await(client):
    """The asyncio client has the same arguments and results, in several sessions at once."""
    hulls = client.register(shapes())
    rng = np.random.default_rng(12)
    first = some(rng, 12, len(hulls))
    poses = [first]
    for _ in range(4):
        poses.append(shaken(rng, poses[-1], np.arange(6), 1e-3))
    expected = [client.find(p.scene(hulls), margin=MARGIN) for p in poses]

    async def loop(other: hullcast.aio.Client) -> None:
        scene = first.scene(hulls)
        async with other.session(scene, find=True, margin=MARGIN) as session:
            for p, m in zip(poses, expected, strict=True):
                found = await session.step(p.positions, p.rotations)
                assert found.pairs.tolist() == m.pairs.tolist()
            found = await session.update(scene, previous=range(12))
            assert not found.restarted

    async def run() -> None:
        async with hullcast.aio.connect(client.target, options=NO_PROXY) as other:
            await asyncio.gather(*(loop(other) for _ in range(3)))

    asyncio.run(run())
    ours, theirs = (inspect.signature(m.Session.update) for m in (hullcast.aio, hullcast))
    assert list(ours.parameters) == list(theirs.parameters)


def test_a_forked_child_finds_on_its_own():
    """A find session from before the fork continues in both processes."""
    program = """
        import os
        import numpy as np
        from loops import shapes, some, MARGIN, OUTPUTS
        import hullcast
        with hullcast.serve() as client:
            hulls = client.register(shapes())
            scene = some(np.random.default_rng(1), 20, len(hulls)).scene(hulls)
            session = client.session(scene, find=True, margin=MARGIN, outputs=OUTPUTS)
            session.step(scene.positions, scene.rotations)
            expected = session.step(scene.positions, scene.rotations)
            assert len(expected) > 5 and not expected.restarted
            child = os.fork()
            for i in range(5):
                m = session.step(scene.positions, scene.rotations)
                assert m.pairs.tolist() == expected.pairs.tolist()
                assert m.restarted == (i == 0)
            if child == 0:
                session.close()
                client.close()
                os._exit(7)
            print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
            assert not session.step(scene.positions, scene.rotations).restarted
            session.close()
    """
    done = programs.run(program)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "7", done.stderr


def test_matches_of_a_pair_session_over_several_streams(client):
    """Catches rows that are counted from the first pair of their stream."""
    rng = np.random.default_rng(13)
    hulls = client.register(shapes())
    bodies = some(rng, 30, len(hulls))
    pairs = rng.integers(30, size=(200, 2))
    with hullcast.connect(client.target, options=NO_PROXY) as other:
        other.pairs_per_message = 25
        with other.session(bodies.scene(hulls), pairs, margin=MARGIN, outputs=OUTPUTS) as session:
            before: hullcast.Manifolds | None = None
            seen: Counter[str] = Counter()
            for i in range(12):
                rows = np.flatnonzero(rng.random(30) < (1.0, 0.2, 0.0)[i % 3])
                bodies = shaken(rng, bodies, rows, 3e-2)
                found = session.step(bodies.positions, bodies.rotations)
                if before is not None:
                    # Each stream compares its own pairs, so equal pairs match within a stream.
                    parts = [lane.rows for lane in session._lanes]
                    assert sum(map(len, parts)) == 200
                    for part in parts:
                        seen += expect_matches_of(before, found, part)
                before = found
            assert len(session._lanes) == 8
    assert seen["pairs that stayed"] > 300
    assert seen["pairs that ended"] > 5


def expect_matches_of(
    before: hullcast.Manifolds, found: hullcast.Manifolds, rows: np.ndarray
) -> Counter[str]:
    """Compares the matches of some rows with those by plain loops."""
    assert found.scene is not None
    radii = [found.scene.radii[hull] for hull in found.scene.body_hulls]
    expected = matching.matches(before[rows], found[rows], radii)
    placed = [-1 if row < 0 else int(rows[row]) for row in expected.pairs]
    assert found[rows].previous_pairs.tolist() == placed
    shift = before.point_offsets[rows[0]]
    points = [-1 if point < 0 else int(point + shift) for point in expected.points]
    assert found[rows].previous_points.tolist() == points
    return Counter(
        {
            "pairs that stayed": int(np.count_nonzero(found[rows].previous_pairs >= 0)),
            "pairs that ended": len(expected.ended),
        }
    )


def test_wrong_sessions_and_steps(client):
    """Catches arguments that contradict each other, and an update that loses the session."""
    scene = hullcast.Scene(client.register([CUBE] * 2), np.zeros((2, 3)), [[0, 0, 0, 1]] * 2)
    for call, reason, field in (
        (lambda: client.session(scene), "MISSING_ARGUMENT", "pairs"),
        (lambda: client.session(scene, [[0, 1]], find=True), "CONTRADICTION", "pairs"),
        (lambda: client.session(scene, find=True, margin=np.inf), "VALUE_OUT_OF_RANGE", "margin"),
        (lambda: client.query(scene, [[0, 1]], outputs=["MATCHES"]), "SESSION_ONLY", "outputs"),
        (lambda: client.find(scene, outputs=["matches"]), "SESSION_ONLY", "outputs"),
        (lambda: client.session(scene, [[0, 1]]).update(scene), "FIND_ONLY", "scene"),
    ):
        with pytest.raises(hullcast.InvalidArgument) as caught:
            call()
        assert (caught.value.reason, caught.value.field) == (reason, field)
    warm = client.query(scene, [[0, 1]], outputs=["BASES"])
    with pytest.raises(hullcast.InvalidArgument, match="CONTRADICTION: warm"):
        client.session(scene, find=True, warm=warm)
    with client.session(scene, find=True) as session:
        session.step(scene.positions, scene.rotations)
        for wrong, reason in (([0, 0], "REPEATED_INDEX"), ([0, 2], "INDEX_OUT_OF_RANGE")):
            with pytest.raises(hullcast.InvalidArgument) as caught:
                session.update(scene, previous=wrong)
            assert (caught.value.reason, caught.value.field) == (reason, "previous")
            with pytest.raises(hullcast.InvalidArgument) as caught:
                session.step(scene.positions, scene.rotations, moved=wrong)
            assert (caught.value.reason, caught.value.field) == (reason, "moved")
        with pytest.raises(hullcast.InvalidArgument, match=r"positions: expected shape \(1, 3\)"):
            session.step(scene.positions, scene.rotations, moved=[1])
        assert not session.step(scene.positions, scene.rotations).restarted
        with pytest.raises(hullcast.OutputNotAsked, match="add 'MATCHES'"):
            _ = session.step(scene.positions, scene.rotations).previous_pairs

"""Step loops give the results of queries that start from the previous bases, in all conditions."""

from __future__ import annotations

import asyncio
import gc
import inspect
import pickle
import threading

import numpy as np
import programs
import pytest
from crowds import CUBE, EVERYTHING, NO_PROXY, Server, crowd, expect_same

import hullcast
from hullcast import Flag, Outcome, _manage, _session


def walk(scene: hullcast.Scene, steps: int) -> list[hullcast.Scene]:
    """The scene at several steps, in which each body drifts and rotates a little."""
    rng = np.random.default_rng(111)
    drift = rng.normal(0, 2e-3, scene.positions.shape)
    spin = rng.normal(0, 2e-3, scene.rotations.shape)
    poses = []
    for i in range(steps):
        rotations = scene.rotations + i * spin
        rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
        poses.append(scene.moved(scene.positions + i * drift, rotations))
    return poses


def replay(
    client: hullcast.Client, poses: list[hullcast.Scene], pairs: np.ndarray
) -> list[hullcast.Manifolds]:
    """The results of plain queries, each of which starts from the previous bases."""
    answers: list[hullcast.Manifolds] = []
    for scene in poses:
        warm = answers[-1] if answers else None
        answers.append(client.query(scene, pairs, margin=0.1, outputs=EVERYTHING, warm=warm))
    return answers


@pytest.mark.parametrize("per_message", [4096, 40])
def test_steps_are_warm_queries(client, per_message):
    """Steps equal warm queries bit for bit, over one stream and over eight."""
    poses = walk(crowd(client, 400), 5)
    pairs = np.random.default_rng(112).integers(400, size=(500, 2))
    expected = replay(client, poses, pairs)
    with hullcast.connect(client.target, options=NO_PROXY) as other:
        other.pairs_per_message = per_message
        with other.session(poses[0], pairs, margin=0.1, outputs=EVERYTHING) as session:
            assert len(session._lanes) == (1 if per_message == 4096 else 8)
            for scene, warm in zip(poses, expected, strict=True):
                found = session.step(scene.positions, scene.rotations)
                expect_same(found, warm)
                assert (found.scene.positions == scene.positions).all()
            assert repr(session) == f"Session(500 pairs, {client.target!r})"
        with pytest.raises(hullcast.Error, match="CLOSED"):
            session.step(scene.positions, scene.rotations)
        assert len(other.query(scene, pairs[:3])) == 3  # the client stays open
    work = [m.iterations.sum() for m in expected]
    assert max(work[1:]) < work[0]  # so the warm steps really start warm


def test_steps_with_await(client):
    """The asyncio client has the same results and arguments, in several sessions at once."""
    poses = walk(crowd(client, 100), 4)
    pairs = np.random.default_rng(113).integers(100, size=(300, 2))
    expected = replay(client, poses, pairs)

    async def loop(other: hullcast.aio.Client) -> None:
        async with other.session(poses[0], pairs, margin=0.1, outputs=EVERYTHING) as session:
            for scene, warm in zip(poses, expected, strict=True):
                expect_same(await session.step(scene.positions, scene.rotations), warm)

    async def run() -> None:
        async with hullcast.aio.connect(client.target, options=NO_PROXY) as other:
            await asyncio.gather(*(loop(other) for _ in range(3)))

    asyncio.run(run())
    for kind in ("Client.session", "Session.step"):
        owner, name = kind.split(".")
        ours, theirs = (getattr(getattr(m, owner), name) for m in (hullcast.aio, hullcast))
        assert list(inspect.signature(ours).parameters) == list(
            inspect.signature(theirs).parameters
        )


def test_a_warm_session_starts_warm(client):
    """The first step starts from the bases of an earlier result."""
    poses = walk(crowd(client, 50), 2)
    pairs = np.random.default_rng(114).integers(50, size=(100, 2))
    before, after = replay(client, poses, pairs)
    with client.session(poses[0], pairs, margin=0.1, outputs=EVERYTHING, warm=before) as session:
        expect_same(session.step(poses[1].positions, poses[1].rotations), after)


@pytest.mark.parametrize("kind", ["killed", "stopped"])
def test_a_session_outlives_its_server(kind):
    """The server is killed or stopped, and restarted without its hulls; the results stay equal."""
    with Server() as server, hullcast.connect(server.address, options=NO_PROXY) as client:
        poses = walk(crowd(client, 60), 6)
        pairs = np.random.default_rng(115).integers(60, size=(200, 2))
        expected = replay(client, poses, pairs)
        with client.session(poses[0], pairs, margin=0.1, outputs=EVERYTHING) as session:
            for i, (scene, warm) in enumerate(zip(poses, expected, strict=True)):
                if i % 2:
                    if kind == "killed":
                        server.kill()
                    else:
                        server.process.terminate()
                        server.process.wait(30)
                    server.start()
                expect_same(session.step(scene.positions, scene.rotations), warm)


def test_a_session_moves_to_another_replica():
    """One of two servers is killed, and the other has neither the hulls nor the session."""
    with (
        Server() as a,
        Server() as b,
        hullcast.connect([a.address, b.address], options=NO_PROXY) as client,
    ):
        poses = walk(crowd(client, 60), 4)
        pairs = np.random.default_rng(116).integers(60, size=(200, 2))
        sessions = [client.session(poses[0], pairs, margin=0.1) for _ in range(4)]
        for session in sessions:
            assert (session.step(poses[0].positions, poses[0].rotations).outcome < 3).all()
        a.kill()
        for scene in poses[1:]:
            for session in sessions:
                found = session.step(scene.positions, scene.rotations)
                assert (found.outcome != Outcome.INVALID).all()
        for session in sessions:
            session.close()


def test_no_room_for_what_streams_keep():
    """A server that keeps no state between messages gets a full message for each step."""
    with (
        Server("memory://", "--max-stream-state-bytes", "0") as server,
        hullcast.connect(server.address, options=NO_PROXY) as client,
    ):
        poses = walk(crowd(client, 50), 3)
        pairs = np.random.default_rng(117).integers(50, size=(100, 2))
        expected = replay(client, poses, pairs)
        with client.session(poses[0], pairs, margin=0.1, outputs=EVERYTHING) as session:
            for scene, warm in zip(poses, expected, strict=True):
                expect_same(session.step(scene.positions, scene.rotations), warm)


def test_answers_too_large_are_halved():
    """A stream whose response would be too large is split in two, with the same results."""
    with (
        Server("memory://", "--max-message-bytes", "65536") as server,
        hullcast.connect(server.address, options=NO_PROXY) as client,
    ):
        client.pairs_per_message = 100
        poses = walk(crowd(client, 60), 3)
        pairs = np.random.default_rng(118).integers(60, size=(1500, 2))
        expected = replay(client, poses, pairs)
        client.pairs_per_message = 10_000
        with client.session(poses[0], pairs, margin=0.1, outputs=EVERYTHING) as session:
            for scene, warm in zip(poses, expected, strict=True):
                expect_same(session.step(scene.positions, scene.rotations), warm)
            assert len(session._lanes) > 1


def test_a_step_that_takes_too_long(client):
    """A step ends at its timeout, or by cancellation, and the next step works."""
    poses = walk(crowd(client, 300), 2)
    pairs = np.random.default_rng(119).integers(300, size=(60_000, 2))
    with client.session(poses[0], pairs, margin=1.0) as session:
        for _ in range(3):
            with pytest.raises(hullcast.DeadlineExceeded):
                session.step(poses[0].positions, poses[0].rotations, timeout=1e-3)
            found = session.step(poses[1].positions, poses[1].rotations)
            assert len(found) == 60_000

    async def run() -> None:
        async with hullcast.aio.connect(client.target, options=NO_PROXY) as other:
            session = other.session(poses[0], pairs, margin=1.0)
            with pytest.raises(hullcast.DeadlineExceeded):
                await session.step(poses[0].positions, poses[0].rotations, timeout=1e-3)
            task = asyncio.create_task(session.step(poses[0].positions, poses[0].rotations))
            while session._lanes[0]._sent is None:
                await asyncio.sleep(0)  # until the step has begun to send
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            again = await session.step(poses[1].positions, poses[1].rotations)
            assert again.alpha.tobytes() == found.alpha.tobytes()
            session.close()

    asyncio.run(run())


def test_what_a_step_refuses(client):
    """Wrong shapes raise an error, and the session continues. A wrong query fails at once."""
    scene = crowd(client, 10)
    with client.session(scene, [[0, 1]], margin=0.1) as session:
        with pytest.raises(hullcast.InvalidArgument, match="positions"):
            session.step(scene.positions[:5], scene.rotations)
        positions = scene.positions.copy()
        positions[1] = np.nan
        with pytest.raises(hullcast.InvalidPoses) as caught:
            session.step(positions, scene.rotations)
        m = caught.value.manifolds
        assert m.flags.tolist() == [Flag.INVALID_BODY]
        assert m.invalid_bodies.tolist() == [1]
        assert session.step(scene.positions, scene.rotations).flags.tolist() != [Flag.INVALID_BODY]
    with pytest.raises(hullcast.InvalidArgument, match="INDEX_OUT_OF_RANGE"):
        client.session(scene, [[0, 10]])
    with pytest.raises(hullcast.InvalidArgument, match="margin"):
        client.session(scene, [[0, 1]], margin=-1)
    with pytest.raises(TypeError):
        pickle.dumps(session)


def test_results_keep_the_poses_of_their_step(client):
    """Catches a result or a scene that changes when the caller moves the same array on."""
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    positions, turns = np.array([[0, 0, 0], [0, 0, 0.9]]), np.array([[0.0, 0, 0, 1]] * 2)
    scene = hullcast.Scene(client.register([cube, cube]), positions, turns)
    session = client.session(scene, [[0, 1]])
    results = []
    for height in (0.8, 0.7):
        positions[1, 2] = height
        results.append(session.step(positions, turns))
    moved = scene.moved(positions, turns)
    positions[1, 2], turns[1] = 5, (1, 0, 0, 0)
    assert [m.scene.positions[1, 2] for m in results] == [0.8, 0.7]
    assert (scene.positions[1, 2], moved.positions[1, 2]) == (0.9, 0.7)
    assert moved.rotations[1].tolist() == [0, 0, 0, 1]


def test_a_session_makes_one_step_at_a_time(client):
    """Catches steps of several threads or tasks that read each other's answers, or that hang."""
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    turns = [[0, 0, 0, 1]] * 2
    scene = hullcast.Scene(client.register([cube, cube]), [[0, 0, 0], [0, 0, 0.9]], turns)
    session = client.session(scene, [[0, 1]])
    session.step(scene.positions, turns)
    under_way = session._stepping(scene.positions, turns, None, {}, None)
    next(under_way)
    with pytest.raises(hullcast.Error, match="STEP_UNDER_WAY"):
        session.step(scene.positions, turns)
    under_way.close()
    wrong, right = [], []

    def steps(height: float) -> None:
        for _ in range(50):
            try:
                m = session.step([[0, 0, 0], [0, 0, height]], turns)
            except hullcast.Error as error:
                if error.reason != "STEP_UNDER_WAY":
                    wrong.append(error)
            else:
                (right if abs(m.separation[0] - (height - 1)) < 1e-9 else wrong).append(height)

    threads = [threading.Thread(target=steps, args=(0.9 + i / 100,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not any(thread.is_alive() for thread in threads)
    assert right
    assert wrong == []


def test_sessions_leave_no_thread_behind(client):
    """The threads of closed or garbage collected sessions end: gRPC's and the one for timeouts."""
    scene = crowd(client, 10)
    before = threading.active_count()
    for i in range(200):
        session = client.session(scene, [[0, 1]], margin=0.1)
        session.step(scene.positions, scene.rotations)
        if i % 2:
            session.close()
        del session
    gc.collect()
    for _ in range(100):
        if threading.active_count() <= before + 2:
            break
        threading.Event().wait(0.05)
    assert threading.active_count() <= before + 2
    assert not list(_session._sessions)


def test_a_forked_child_steps_on_its_own():
    """A session from before the fork continues in both processes."""
    program = """
        import os
        from crowds import crowd, expect_same, EVERYTHING
        import hullcast
        with hullcast.serve() as client:
            scene = crowd(client, 50)
            pairs = [[i, (i * 7) % 50] for i in range(50)]
            session = client.session(scene, pairs, outputs=EVERYTHING)
            session.step(scene.positions, scene.rotations)
            expected = session.step(scene.positions, scene.rotations)
            # A row that is answered from the stream's state has taken no work.
            work = ("iterations", "support_calls")
            child = os.fork()
            for _ in range(20):
                expect_same(session.step(scene.positions, scene.rotations), expected, work)
            if child == 0:
                session.close()
                client.close()
                os._exit(7)
            print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
            expect_same(session.step(scene.positions, scene.rotations), expected, work)
            session.close()
    """
    done = programs.run(program)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "7", done.stderr


#: A server that permits four calls at once on one connection; one is kept for other calls.
FEW = ("--max-streams-per-connection", "4")


def test_a_session_too_many_is_refused_and_other_calls_go_on():
    """Catches sessions that use every call of a connection, so that all other calls starve.

    The error names the server's limit. The place of a closed session is free again.
    """
    with hullcast.serve(arguments=FEW, timeout=20) as client:
        scene = crowd(client, 2)
        sessions = [client.session(scene, [[0, 1]]) for _ in range(6)]
        for session in sessions[:3]:
            session.step(scene.positions, scene.rotations)
        for session in sessions[3:]:
            with pytest.raises(hullcast.ResourceExhausted) as caught:
                session.step(scene.positions, scene.rotations)
            assert caught.value.reason == "TOO_MANY_SESSIONS"
            for text in (
                "max_streams_per_connection",
                "permits 4 calls",
                "3 streams",
                "one session",
            ):
                assert text in str(caught.value)
        assert len(client.query(scene, [[0, 1]])) == 1
        sessions[0].close()
        assert len(sessions[5].step(scene.positions, scene.rotations)) == 1
        assert len(sessions[1].step(scene.positions, scene.rotations)) == 1


def test_a_session_too_many_of_asyncio_is_refused():
    """Catches the same for asyncio, whose fifth step waited for ever."""

    async def run() -> None:
        async with hullcast.aio.serve(arguments=FEW, timeout=20) as client:
            scene = hullcast.Scene(await client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]])
            sessions = [client.session(scene, [[0, 0]]) for _ in range(6)]
            for session in sessions[:3]:
                await session.step(scene.positions, scene.rotations)
            with pytest.raises(hullcast.ResourceExhausted, match="TOO_MANY_SESSIONS"):
                await sessions[3].step(scene.positions, scene.rotations)
            assert len(await client.query(scene, [[0, 0]])) == 1

    asyncio.run(run())


@pytest.mark.parametrize("is_async", [False, True])
def test_a_step_that_finds_no_free_stream_is_late(monkeypatch, is_async):
    """Catches a step of asyncio that ignores its timeout while it waits for a free stream.

    The client does not know the server's limit here, as with a server of another version.
    """
    monkeypatch.setattr(_manage, "max_calls", lambda data: 0)

    async def run() -> None:
        async with hullcast.aio.serve(arguments=FEW, timeout=20) as client:
            scene = hullcast.Scene(await client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]])
            sessions = [client.session(scene, [[0, 0]]) for _ in range(5)]
            for session in sessions[:4]:
                await session.step(scene.positions, scene.rotations)
            with pytest.raises(hullcast.DeadlineExceeded):
                await sessions[4].step(scene.positions, scene.rotations, timeout=1)
            sessions[0].close()
            assert len(await sessions[4].step(scene.positions, scene.rotations)) == 1

    if is_async:
        asyncio.run(asyncio.wait_for(run(), 60))
        return
    with hullcast.serve(arguments=FEW, timeout=20) as client:
        scene = crowd(client, 2)
        sessions = [client.session(scene, [[0, 1]]) for _ in range(5)]
        for session in sessions[:4]:
            session.step(scene.positions, scene.rotations)
        with pytest.raises(hullcast.DeadlineExceeded):
            sessions[4].step(scene.positions, scene.rotations, timeout=1)
        sessions[0].close()
        assert len(sessions[4].step(scene.positions, scene.rotations)) == 1

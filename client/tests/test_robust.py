"""Servers that stop, come back, lose hulls or are too busy; and processes that fork."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import pickle
import threading
from concurrent.futures import ThreadPoolExecutor

import grpc
import numpy as np
import programs
import pytest
from crowds import CUBE, EVERYTHING, NO_PROXY, Server, crowd, expect_same
from shapes import family

import hullcast
from hullcast import Flag, Outcome, _connection
from hullcast._channel import address, channel_options
from hullcast._pb import hulls_pb2

RESTING = [[0.0, 0, 0, 1]]


def stored(server: Server) -> set[bytes]:
    """The ids of the hulls that one server has."""
    with grpc.insecure_channel(server.address, options=NO_PROXY) as channel:
        call = channel.unary_unary("/hullcast.v1.HullService/ListHulls")
        answer = call(hulls_pb2.ListHullsRequest().SerializeToString(), timeout=10)
        return {hull.id for hull in hulls_pb2.ListHullsResponse.FromString(answer).hulls}


def connect(server: Server, **options: object) -> hullcast.Client:
    return hullcast.connect(server.address, options=[*NO_PROXY, *options.items()])


@pytest.mark.parametrize("per_message", [4096, 100])
def test_hulls_that_a_server_lost_are_registered_again(per_message):
    """After a restart with an empty store, a query registers the hulls again."""
    with Server() as server, connect(server) as client:
        client.pairs_per_message = per_message
        scene = crowd(client, 100)
        pairs = np.random.default_rng(61).integers(100, size=(1000, 2))
        expected = client.query(scene, pairs, outputs=EVERYTHING)
        server.kill()
        server.start()
        assert not stored(server)
        expect_same(client.query(scene, pairs, outputs=EVERYTHING), expected)
        assert stored(server) == set(scene.hull_ids)


def test_lost_hulls_come_back_with_all_they_were_made_of():
    """A lost hull is restored with its contraction point, unless only its id is known."""
    with Server() as server, connect(server) as client:
        shift = [0.25, 0, 0]
        hulls = client.register([CUBE, CUBE * 2], contraction_points=[shift, None])
        again = client.register(hulls)
        assert [hull.id for hull in again] == [hull.id for hull in hulls]
        client.register([CUBE * 3])
        server.kill()
        server.start()
        ids = [hulls[0], hulls[1].id, b"\7" * 32]
        scene = hullcast.Scene(ids, np.zeros((3, 3)), RESTING * 3)
        m = client.query(pickle.loads(pickle.dumps(scene)), [[0, 0], [1, 1], [2, 2], [0, 1]])
        assert m.outcome.tolist() == [Outcome.CONTACT] + [Outcome.INVALID] * 3
        assert (m.flags[1:] == Flag.UNKNOWN_HULL).all()
        assert m.missing_hulls.tolist() == [1, 2]
        assert stored(server) == {hulls[0].id}


def test_what_a_caller_does_to_its_array_later_changes_no_hull(client):
    """The hull's vertices are a copy."""
    points = CUBE.copy()
    (hull,) = client.register([points])
    points *= 5
    assert (hull.vertices == CUBE).all()
    assert hullcast.hull_id(hull.vertices) == hull.id
    with pytest.raises(ValueError, match="read-only"):
        hull.vertices[0] = 0


def test_a_server_killed_and_started_again_is_waited_for(tmp_path):
    """A query waits for a restarted server, even beyond gRPC's default retry buffer (256 KiB)."""
    with Server(tmp_path) as server, connect(server) as client:
        client.pairs_per_message = 100_000
        scene = crowd(client, 20_000)
        pairs = np.random.default_rng(62).integers(20_000, size=(60_000, 2))
        assert scene.positions.nbytes > 256 << 10
        expected = client.query(scene, pairs)
        server.kill()
        later = threading.Timer(0.5, server.start)
        later.start()
        m = client.query(scene, pairs)
        later.join()
        assert m.alpha.tobytes() == expected.alpha.tobytes()


def test_a_server_killed_in_the_middle_of_calls(tmp_path):
    """Calls in flight are repeated, even if part of a response had arrived."""
    with Server(tmp_path) as server, connect(server) as client, ThreadPoolExecutor(1) as pool:
        client.pairs_per_message = 500
        scene = crowd(client, 1000)
        pairs = np.random.default_rng(63).integers(1000, size=(40_000, 2))
        expected = client.query(scene, pairs)
        for milliseconds in range(0, 30, 4):
            answer = pool.submit(client.query, scene, pairs)
            threading.Event().wait(milliseconds * 1e-3)
            server.kill()
            server.start()
            assert answer.result(60).alpha.tobytes() == expected.alpha.tobytes()


def test_no_server_is_given_up_at_the_deadline():
    """Retries end with the call's timeout, with Unavailable or DeadlineExceeded."""
    with Server() as server:
        server.kill()
        with (
            connect(server) as client,
            pytest.raises((hullcast.Unavailable, hullcast.DeadlineExceeded)),
        ):
            client.register([CUBE], timeout=0.5)


def test_a_busy_server_is_tried_again_when_it_says(monkeypatch):
    """A query that is too large for a busy server fails without retries, and works with them."""
    with Server(
        "memory://", "--max-pairs-in-flight", "3000", "--max-pairs-per-request", "3000"
    ) as server:
        with connect(server) as client:
            client.pairs_per_message = 2000
            scene = crowd(client, 500)
            pairs = np.random.default_rng(64).integers(500, size=(40_000, 2))
            assert (client.query(scene, pairs, margin=np.inf).outcome == Outcome.CONTACT).all()
            asked = [asyncio.to_thread(client.query, scene, pairs, margin=np.inf) for _ in "ab"]

            async def both() -> None:
                async with hullcast.aio.connect(server.address, options=NO_PROXY) as other:
                    other.pairs_per_message = 2000
                    asked.append(other.query(scene, pairs, margin=np.inf))
                    for m in await asyncio.gather(*asked):
                        assert (m.outcome == Outcome.CONTACT).all()

            asyncio.run(both())
        plain = connect(server, **{"grpc.enable_retries": 0})
        plain.pairs_per_message = 2000
        monkeypatch.setattr(_connection, "_BUSY", 0)
        with plain, pytest.raises(hullcast.Unavailable) as caught:
            plain.query(scene, pairs, margin=np.inf)
        assert caught.value.reason == "TOO_BUSY"
        assert caught.value.retry_after is not None


def test_calls_are_spread_over_a_list_of_servers():
    """Calls are spread over both servers, and go to the other one when one is killed."""
    rng = np.random.default_rng(65)
    shapes = [shape.vertices for shape in family("poly16", 12, rng)]
    with (
        Server() as a,
        Server() as b,
        hullcast.connect([a.address, b.address], options=NO_PROXY) as client,
    ):
        hulls = [client.register([points])[0] for points in shapes[:10]]
        at_a, at_b = stored(a), stored(b)
        assert at_a | at_b == {hull.id for hull in hulls}
        assert at_a
        assert at_b
        # Either server may get a query, and hulls that it lacks are registered.
        scene = hullcast.Scene(hulls, np.zeros((10, 3)), RESTING * 10)
        for _ in range(4):
            m = client.query(scene, [[i, i] for i in range(10)])
            assert (m.outcome == Outcome.CONTACT).all()
        a.kill()
        for points in shapes:
            client.register([points])
        assert len(stored(b)) == 12


def test_a_dns_name_is_a_target():
    """A `dns:///` name, which is resolved again when its addresses change, works as a target."""
    with Server() as server:
        port = server.address.rpartition(":")[2]
        with hullcast.connect(f"dns:///localhost:{port}", options=NO_PROXY) as client:
            assert len(client.register([CUBE])) == 1


def test_lists_of_addresses():
    """Lists are converted to gRPC's form, or refused with a reason."""
    assert address("host:1") == "host:1"
    assert address(["host:1"]) == "host:1"
    assert address(["127.0.0.1:1", "127.0.0.2:22"]) == "ipv4:127.0.0.1:1,127.0.0.2:22"
    assert address(["[::1]:1", "[::2]:2"]) == "ipv6:[::1]:1,[::2]:2"
    for wrong, reason, index in (
        ([], "NO_ADDRESS", None),
        (["127.0.0.1:1", "[::1]:1"], "MIXED_ADDRESSES", None),
        (["127.0.0.1:1", "127.0.0.1"], "NOT_AN_ADDRESS", 1),
        (["127.0.0.1:1", "dns:///host:1"], "NOT_AN_ADDRESS", 1),
    ):
        with pytest.raises(hullcast.InvalidArgument) as caught:
            address(wrong)
        assert (caught.value.reason, caught.value.index) == (reason, index)


def test_options_are_merged():
    """An option of the caller replaces only that option. A Unix socket gets an authority."""
    ours = dict(channel_options("host:1", ()))
    theirs = dict(channel_options("unix:x", [("grpc.keepalive_time_ms", 5), ("own", 1)]))
    added = {"grpc.keepalive_time_ms": 5, "own": 1, "grpc.default_authority": "localhost"}
    assert theirs == {**ours, **added}
    several = dict(channel_options(["host:1", "host:2"], ()))
    assert several == {**ours, "grpc.default_authority": "host:1"}
    assert ours["grpc.per_rpc_retry_buffer_size"] >= 64 << 20
    assert "own" not in ours


def test_a_client_is_pickled_as_its_settings(client):
    """An unpickled client connects by itself. The token is kept but not shown."""
    configured = hullcast.connect(
        client.target, token="secret", timeout=30, options=[*NO_PROXY, ("own", 1)]
    )
    configured.pairs_per_message = 77
    copy = pickle.loads(pickle.dumps(configured))
    assert copy._settings == configured._settings
    assert (copy.timeout, copy.pairs_per_message) == (30, 77)
    assert "secret" not in repr(copy._settings)
    assert len(copy.register([CUBE])) == 1
    pickle.loads(pickle.dumps(client)).close()  # the copy does not own the server
    assert len(client.register([CUBE])) == 1
    copy.close()
    with pytest.raises(hullcast.Error, match="CLOSED"):
        copy.register([CUBE])


def _ask(client: hullcast.Client, scene: hullcast.Scene) -> bytes:
    return client.query(scene, [[0, 1], [1, 2]], outputs=EVERYTHING).alpha.tobytes()


def test_workers_of_a_pool(client):
    """Spawned workers get client and scene with their task."""
    scene = crowd(client, 3)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(_ask, (client, scene)) == _ask(client, scene)


def test_a_forked_child_has_a_connection_of_its_own():
    """Parent and children query at the same time, and a child's end stops no server."""
    program = """
        import os, sys, threading
        from crowds import crowd, expect_same, EVERYTHING
        import hullcast
        with hullcast.serve() as client:
            scene = crowd(client, 50)
            pairs = [[i, (i * 7) % 50] for i in range(50)]
            expected = client.query(scene, pairs, outputs=EVERYTHING)
            children = []
            for _ in range(4):
                child = os.fork()
                if child == 0:
                    for _ in range(20):
                        expect_same(client.query(scene, pairs, outputs=EVERYTHING), expected)
                    client.close()
                    os._exit(7)
                children.append(child)
                expect_same(client.query(scene, pairs, outputs=EVERYTHING), expected)
            print([os.waitstatus_to_exitcode(os.waitpid(c, 0)[1]) for c in children])
            expect_same(client.query(scene, pairs, outputs=EVERYTHING), expected)
    """
    done = programs.run(program)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[7, 7, 7, 7]", done.stderr


def test_ten_thousand_connects_leave_nothing_behind(client):
    """Memory and open files after the last connection are as after the first few hundred."""

    def connects(count: int) -> tuple[int, int]:
        for i in range(count):
            with hullcast.connect(client.target, options=NO_PROXY) as other:
                if i % 10 == 0:
                    other.register([CUBE])
        with open("/proc/self/statm") as file:
            pages = int(file.read().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE"), len(os.listdir("/proc/self/fd"))

    memory, files = connects(500)
    more_memory, more_files = connects(9_500)
    assert more_memory - memory < 16 << 20
    assert more_files <= files + 8

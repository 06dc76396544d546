"""A client uses a subset of its servers, and others only if the whole subset is down."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import pickle
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from crowds import CUBE, NO_PROXY, Server

import hullcast
from hullcast import _connection, _subset

GOLDEN = Path(__file__).resolve().parents[2] / "tests" / "golden" / "subset.json"
REPLICAS = [f"10.0.0.{number}:50051" for number in range(1, 31)]
IDENTITIES = [f"client-{number}" for number in range(10_000)]


def subset(identity: str, addresses: list[str], size: int) -> set[str]:
    return set(_subset.groups(identity, addresses, size)[0])


def test_weights_are_those_of_the_table() -> None:
    """Catches a change of the hash, after which all clients would move to other replicas."""
    clients = json.loads(GOLDEN.read_text())["clients"]
    assert len(clients) == 4
    for client in clients:
        identity, weights = client["identity"], client["weights"]
        assert {a: f"{_subset.weight(identity, a):016x}" for a in weights} == weights
        assert _subset.ranked(identity, weights) == client["ranked"]
        assert _subset.ranked(identity, reversed(weights)) == client["ranked"]


@pytest.mark.parametrize("size", [1, 3, _subset.DEFAULT])
def test_ten_thousand_clients_are_spread_evenly_over_thirty_replicas(size: int) -> None:
    """Catches a hash whose values for similar addresses are related, such as CRC-32."""
    counts = Counter(a for identity in IDENTITIES for a in subset(identity, REPLICAS, size))
    assert counts.total() == size * len(IDENTITIES)
    mean = counts.total() / len(REPLICAS)
    assert all(abs(counts[a] - mean) <= 0.2 * mean for a in REPLICAS), counts


@pytest.mark.parametrize("size", [1, 3, _subset.DEFAULT])
def test_a_replica_that_comes_or_goes_moves_only_its_share(size: int) -> None:
    """Catches a choice by position in the list, such as a hash modulo the number of replicas."""
    changed = 0
    for identity in IDENTITIES[:2_000]:
        fewer, more = (subset(identity, REPLICAS[first:], size) for first in (1, 0))
        if REPLICAS[0] in more:
            changed += 1
            assert len(fewer - more) == 1
            assert more - fewer == {REPLICAS[0]}
        else:
            assert fewer == more
    share = 2_000 * size / len(REPLICAS)
    assert abs(changed - share) < 4 * share**0.5, changed


def test_the_groups_of_a_client_have_every_replica_once() -> None:
    """Catches a replica that no group has, so that a client fails although this replica is up."""
    for size in (None, 1, 7, 29):
        groups = _subset.groups("a", [*REPLICAS, REPLICAS[3]], size)
        assert sorted(a for group in groups for a in group) == sorted(REPLICAS)
        assert {len(group) for group in groups[:-1]} == {size or _subset.DEFAULT}
    # A list that is not larger than the subset is used as it is given.
    assert _subset.groups("a", REPLICAS, 30) == [tuple(REPLICAS)]
    assert _subset.groups("a", REPLICAS[:8], None) == [tuple(REPLICAS[:8])]


def test_only_a_given_identity_is_pickled_and_inherited() -> None:
    """Catches workers that all use one subset because they were made from one client."""

    def groups_in_child(client: hullcast.Client) -> str:
        reader, writer = os.pipe()
        if (child := os.fork()) == 0:
            os.write(writer, repr(client._groups).encode())
            os._exit(0)
        os.waitpid(child, 0)
        os.close(writer)
        with open(reader) as file:
            return file.read()

    with hullcast.connect(REPLICAS, subset=3) as client:
        copies = [pickle.loads(pickle.dumps(client)) for _ in range(20)]
        assert len({repr(copy._groups) for copy in [client, *copies]}) == 21
        assert groups_in_child(client) != repr(client._groups)
    with hullcast.connect(REPLICAS, subset=3, identity="worker-7") as client:
        assert client._groups == _subset.groups("worker-7", REPLICAS, 3)
        assert pickle.loads(pickle.dumps(client))._groups == client._groups
        assert groups_in_child(client) == repr(client._groups)


def test_a_subset_needs_a_list() -> None:
    """Catches a subset that is silently ignored because gRPC looks the name up itself."""
    for target in ("localhost", "dns:///hullcast:50051"):
        with pytest.raises(hullcast.InvalidArgument, match="a list of addresses") as caught:
            hullcast.connect(target, subset=2)
        assert (caught.value.reason, caught.value.field) == ("CONTRADICTION", "subset")


@pytest.fixture
def servers(tmp_path: Path) -> Iterator[dict[str, Server]]:
    """Four servers with one store, by address."""
    with contextlib.ExitStack() as stack:
        made = [stack.enter_context(Server(tmp_path)) for _ in range(4)]
        yield {server.address: server for server in made}


def connections(server: Server) -> int:
    """The TCP connections that a server's process has accepted."""
    port = int(server.address.rpartition(":")[2])
    lines = Path("/proc/net/tcp").read_text().splitlines()[1:]
    fields = [line.split() for line in lines]
    return sum(int(f[1].rpartition(":")[2], 16) == port and f[3] == "01" for f in fields)


def pair(client: hullcast.Client) -> hullcast.Scene:
    hulls = client.register([CUBE])
    return hullcast.Scene(hulls, [[0, 0, 0], [0.5, 0, 0]], [[0, 0, 0, 1]] * 2, body_hulls=[0, 0])


def test_only_the_subset_has_connections(servers: dict[str, Server]) -> None:
    """Catches a client that still connects to every server; counted in the kernel's table."""
    expected: Counter[str] = Counter()
    with contextlib.ExitStack() as stack:
        for number in range(12):
            client = stack.enter_context(
                hullcast.connect(
                    list(servers), subset=2, identity=f"client-{number}", options=NO_PROXY
                )
            )
            for _ in range(4):
                client.ping()  # round robin reaches both
            expected.update(subset(f"client-{number}", list(servers), 2))
        deadline = time.monotonic() + 20
        while Counter({a: connections(s) for a, s in servers.items()}) != expected:
            assert time.monotonic() < deadline, expected
            time.sleep(0.1)
    assert len(expected) == 4


def test_a_killed_subset_is_replaced_and_used_again(
    servers: dict[str, Server], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a call, a session's step or a registration that fails while other servers are up."""
    monkeypatch.setattr(_connection, "_RETURN_SECONDS", 1.0)
    home, *others = _subset.ranked("me", servers)
    with hullcast.connect(
        list(servers), subset=1, identity="me", timeout=60, options=NO_PROXY
    ) as client:
        scene = pair(client)
        session = client.session(scene, [[0, 1]])
        before = client.query(scene, [[0, 1]])
        session.step(scene.positions, scene.rotations)
        assert [connections(servers[a]) > 0 for a in (home, *others)] == [True, False, False, False]

        servers[home].kill()
        for answer in (
            session.step(scene.positions, scene.rotations),
            client.query(scene, [[0, 1]]),
            client.find(scene),
        ):
            assert answer.alpha == before.alpha
        client.register([2 * np.asarray(CUBE)])
        assert connections(servers[others[0]]) > 0
        assert not any(connections(servers[a]) for a in others[1:])

        servers[home].start()  # on its old port
        deadline = time.monotonic() + 20
        while not connections(servers[home]):
            assert time.monotonic() < deadline
            client.query(scene, [[0, 1]])
            time.sleep(0.1)
        assert session.step(scene.positions, scene.rotations).alpha == before.alpha
        session.close()


def test_short_timeouts_leave_a_dead_subset_too(servers: dict[str, Server]) -> None:
    """Catches a client all of whose calls are late, because gRPC retries longer than they last."""
    home, *_ = _subset.ranked("me", servers)
    with hullcast.connect(
        list(servers), subset=1, identity="me", timeout=2, options=NO_PROXY
    ) as client:
        scene = pair(client)
        servers[home].kill()
        with contextlib.suppress(hullcast.DeadlineExceeded):
            client.query(scene, [[0, 1]])
        for _ in range(3):
            client.query(scene, [[0, 1]])


def test_the_first_call_skips_a_dead_subset(servers: dict[str, Server]) -> None:
    """Catches a new client that fails, or waits for gRPC's retries, although servers are up."""
    home, second, *rest = _subset.ranked("me", servers)
    servers[home].kill()
    servers[second].kill()

    async def asynchronous() -> None:
        async with hullcast.aio.connect(
            list(servers), subset=1, identity="me", timeout=5, options=NO_PROXY
        ) as client:
            await client.ping()
            assert len(await client.register([CUBE])) == 1

    with hullcast.connect(
        list(servers), subset=1, identity="me", timeout=5, options=NO_PROXY
    ) as client:
        assert len(client.register([CUBE])) == 1
    asyncio.run(asynchronous())
    for address in rest:
        servers[address].kill()
    with (
        hullcast.connect(list(servers), subset=1, options=NO_PROXY) as client,
        pytest.raises(hullcast.Unavailable, match="none of 4 servers is there"),
    ):
        client.ping()


def test_asyncio_leaves_a_killed_subset(servers: dict[str, Server]) -> None:
    """Catches a retry of the asyncio client that stays on the dead channel."""

    async def run() -> None:
        async with hullcast.aio.connect(
            list(servers), subset=1, identity="me", options=NO_PROXY
        ) as client:
            await client.ping()
            servers[_subset.ranked("me", servers)[0]].kill()
            answers = await asyncio.gather(*(client.register([CUBE]) for _ in range(5)))
            assert len({answer[0].id for answer in answers}) == 1

    asyncio.run(run())

"""`info`, `ping`, `hulls` and `delete`, blocking and with `await`."""

from __future__ import annotations

import asyncio
import pickle
import time

import numpy as np
from crowds import CUBE, NO_PROXY, Server

import hullcast


def test_info_is_the_servers(client):
    """Catches a limit that is missing or has another name."""
    info = client.info()
    assert info.version
    assert info.instruction_set in ("scalar", "avx2", "avx512")
    assert info.compute_threads >= 1
    assert info.limits["max_pairs_per_request"] > 0
    assert len(info.limits) >= 15
    assert pickle.loads(pickle.dumps(info)) == info
    assert 0 < client.ping() < 30


def test_stored_hulls_are_listed_and_deleted():
    """Catches a page of the list that is skipped, and a deletion assigned to another hull."""
    rng = np.random.default_rng(2)
    with Server() as server, hullcast.connect(server.address, options=NO_PROXY) as client:
        assert client.hulls() == []
        before = time.time() - 60
        made = client.register(list(rng.normal(size=(1300, 6, 3))))
        stored = client.hulls()
        assert [hull.id for hull in stored] == sorted(hull.id for hull in made)
        assert all(before < hull.created.timestamp() < time.time() + 60 for hull in stored)
        assert all(hull.size > 0 for hull in stored)
        assert "bytes" in repr(stored[0])
        assert client.delete(made[0]) == [True]
        assert client.delete([made[0], stored[-1], made[1].id]).count(True) >= 1
        assert client.delete(stored).count(True) >= 1290
        assert client.hulls() == []
        assert client.delete([]) == []


def test_with_await(client):
    """Catches a call that only the blocking client has."""
    (hull,) = client.register(CUBE * 7)

    async def run() -> None:
        async with hullcast.aio.connect(client.target, options=NO_PROXY) as other:
            assert await other.info() == client.info()
            assert await other.ping() > 0
            assert hull.id in [stored.id for stored in await other.hulls()]
            assert await other.delete([hull]) == [True]

    asyncio.run(run())


def test_faces_of_a_hull_that_was_deleted(client):
    """Catches faces that cannot be read although the hull object has everything to register it."""
    (hull,) = client.register(CUBE * 9)
    client.delete(hull)
    assert len(hull.faces) == 6

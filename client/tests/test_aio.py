"""The asyncio client has the same arguments, results and errors as the blocking client."""

from __future__ import annotations

import asyncio
import inspect
import pickle

import numpy as np
import pytest
from crowds import CUBE, EVERYTHING, NO_PROXY, crowd, expect_same

import hullcast


def test_the_same_signatures():
    """Catches a parameter or a docstring that only one of the two clients has."""
    for name in ("register", "query", "find", "connect"):
        ours, theirs = getattr(hullcast.aio.Client, name), getattr(hullcast.Client, name)
        assert inspect.signature(ours) == inspect.signature(theirs)
        assert ours.__doc__ == theirs.__doc__
    assert hullcast.aio.serve.__doc__ == hullcast.serve.__doc__


@pytest.mark.parametrize("per_message", [4096, 60])
def test_answers_are_the_blocking_clients(client, per_message):
    """Every column is equal bit for bit, in one message and in many, from several tasks at once."""
    scene = crowd(client, 200)
    pairs = np.random.default_rng(51).integers(200, size=(500, 2))
    expected = client.query(scene, pairs, margin=0.1, outputs=EVERYTHING)

    async def run() -> None:
        async with hullcast.aio.connect(client.target, options=NO_PROXY) as other:
            other.pairs_per_message = per_message
            assert (await other.register([CUBE]))[0].id == hullcast.hull_id(CUBE)
            asked = [other.query(scene, pairs, margin=0.1, outputs=EVERYTHING) for _ in range(4)]
            for found in await asyncio.gather(*asked):
                expect_same(found, expected)

    asyncio.run(run())


def test_errors_are_the_blocking_clients(client):
    """Errors are equal: refused by the server or the client, timed out, or closed."""
    scene = crowd(client, 300)
    pairs = np.random.default_rng(52).integers(300, size=(20000, 2))

    async def run() -> None:
        other = hullcast.aio.connect(client.target, options=NO_PROXY)
        with pytest.raises(hullcast.HullRejected) as rejected:
            await other.register([CUBE, CUBE[:3]])
        assert (rejected.value.reason, rejected.value.index) == ("TOO_FEW_POINTS", 1)
        with pytest.raises(hullcast.InvalidArgument) as refused:
            await other.query(scene, pairs[:1], margin=-1)
        assert (refused.value.reason, refused.value.field) == ("VALUE_OUT_OF_RANGE", "margin")
        with pytest.raises(hullcast.InvalidArgument):
            await other.query(scene, [[0, 300]])
        with pytest.raises(hullcast.InvalidArgument):
            await other.find(scene, margin=float("inf"))
        with pytest.raises(hullcast.DeadlineExceeded):
            await other.query(scene, pairs, timeout=1e-4)
        assert len(await other.query(scene, pairs[:10])) == 10
        await other.close()
        with pytest.raises(hullcast.Error, match="CLOSED"):
            await other.query(scene, pairs[:10])

    asyncio.run(run())


def test_a_cancelled_task_leaves_the_client_usable(client):
    """Catches calls that stay in flight after their task was cancelled."""
    scene = crowd(client, 300)
    pairs = np.random.default_rng(53).integers(300, size=(100_000, 2))

    async def run() -> None:
        async with hullcast.aio.connect(client.target, options=NO_PROXY) as other:
            task = asyncio.create_task(other.query(scene, pairs, margin=1.0))
            await asyncio.sleep(0.01)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            assert len(await other.query(scene, pairs[:10])) == 10

    asyncio.run(run())


def test_one_client_in_one_event_loop_after_another(client):
    """Calling `asyncio.run` twice, as in a notebook, gives the second loop a channel of its own."""
    scene = crowd(client, 10)
    other = hullcast.aio.connect(client.target, options=NO_PROXY)
    copy = pickle.loads(pickle.dumps(other))
    for each in (other, other, copy):
        assert len(asyncio.run(each.query(scene, [[0, 1]]))) == 1
    asyncio.run(other.close())
    asyncio.run(copy.close())


def test_serving_over_a_unix_socket(tmp_path):
    """The server is started and stopped without blocking the loop, by `await` or `async with`."""

    async def run() -> None:
        async with hullcast.aio.serve(listen=f"unix:{tmp_path}/socket") as client:
            assert client.target.startswith("unix:")
            assert len(await client.register([CUBE])) == 1
        other = await hullcast.aio.serve()
        assert len(await other.register([CUBE])) == 1
        await other.close()
        with pytest.raises(hullcast.ServerDidNotStart):
            await hullcast.aio.serve(arguments=["--no-such-flag"])

    asyncio.run(run())

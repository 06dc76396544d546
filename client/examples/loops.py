"""Measures a step of a simulation: by query, by find, and by a session with few or many moves.

    python client/examples/loops.py [--seconds 2] [--worlds 10000]

The scenes are a settled pile of 1,000 hulls, the loose heap of docs/find.md, and many worlds of 20
bodies. In each step some bodies move by a tenth of a millimetre. "query" names the pairs: those
near each other in the pile, and those within the margin in the other scenes. The other calls let
the server find the pairs. The session's steps get the poses of all bodies, of which all, a tenth or
none have changed; in the last row they get no poses, because `moved` says that none has changed.
For comparison, the first row is a session's step of a single pair.

Calls take turns, and times are medians from numpy arrays to numpy arrays. "Server" is the processor
time of the server's threads per step, and the bytes are those of the messages. Server and client
share this machine. The output is a Markdown table for each scene.
"""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import find
import numpy as np
import numpy.typing as npt
from throughput import row

import hullcast
from hullcast import _answers, _packed

Floats = npt.NDArray[np.float64]
PILE = Path(__file__).resolve().parents[2] / "examples/scenes/pile.json"
BODIES_PER_WORLD = 20
#: How far a body moves in a step, in metres.
MOVE = 1e-4
HEAD = ("ms per step", "server, ms", "server, share of find", "kB sent", "kB received")


@dataclass
class Loop:
    """A call that is repeated, with the poses of one step after another."""

    name: str
    #: Makes the step before the one that is measured.
    prepare: Callable[[Floats], hullcast.Manifolds]
    step: Callable[[Floats], hullcast.Manifolds]
    #: (bodies, 1): by how much each body moves to and fro, in metres.
    moves: Floats
    seconds: list[float] = field(default_factory=lambda: [])
    #: The processor time of the server, and the bytes sent and received, of all steps.
    server: float = 0.0
    sent: int = 0
    received: int = 0


def server_seconds(client: hullcast.Client) -> float:
    """The processor time that all threads of the client's server have used, in seconds."""
    assert client._server is not None
    tasks = Path(f"/proc/{client._server._process.pid}/task").glob("*/schedstat")
    return sum(int(task.read_text().split()[0]) for task in tasks) * 1e-9


@contextlib.contextmanager
def counted() -> Generator[list[int]]:
    """Counts the bytes of the messages that the client sends and receives meanwhile."""
    total = [0, 0]
    request, answer = _packed.request, _answers.Answer

    def sent(*args: Any) -> bytes:
        data = request(*args)
        total[0] += len(data)
        return data

    def received(data: bytes, number: int) -> _answers.Answer:
        total[1] += len(data)
        return answer(data, number)

    _packed.request, _answers.Answer = sent, received
    try:
        yield total
    finally:
        _packed.request, _answers.Answer = request, answer


def loops(client: hullcast.Client, scene: hullcast.Scene, pairs: Any, margin: float) -> list[Loop]:
    """The calls that are compared; `pairs` are those of the query."""
    count, turns = len(scene), scene.rotations
    a, b = pairs[0]
    hulls = [scene.hull_ids[scene.body_hulls[body]] for body in (a, b)]
    one = hullcast.Scene(hulls, scene.positions[[a, b]], turns[[a, b]])
    single = client.session(one, [[0, 1]], margin=margin)
    # All loops share one session, because the server's memory may not have room for several.
    session = client.session(scene, find=True, margin=margin)
    everyone = np.full((count, 1), MOVE)
    tenth = everyone * (np.random.default_rng(8).random((count, 1)) < 0.1)

    def of_pair(positions: Floats) -> hullcast.Manifolds:
        return single.step(positions[[a, b]], one.rotations)

    def query(positions: Floats) -> hullcast.Manifolds:
        return client.query(scene.moved(positions, turns), pairs, margin=margin)

    def search(positions: Floats) -> hullcast.Manifolds:
        return client.find(scene.moved(positions, turns), margin=margin)

    def step(positions: Floats) -> hullcast.Manifolds:
        return session.step(positions, turns)

    def nothing(_: Floats) -> hullcast.Manifolds:
        return session.step(np.zeros((0, 3)), np.zeros((0, 4)), moved=[])

    return [
        Loop("session, one pair", of_pair, of_pair, everyone),
        Loop("query", query, query, everyone),
        Loop("find", search, search, everyone),
        Loop("session with find, all moved", step, step, everyone),
        Loop("session with find, a tenth moved", step, step, tenth),
        Loop("session with find, none moved", step, step, 0 * everyone),
        Loop("session with find, none moved, by name", step, nothing, 0 * everyone),
    ]


def measure(
    client: hullcast.Client, scene: hullcast.Scene, some: list[Loop], seconds: float
) -> None:
    """Lets the calls take turns; adds up what each of them takes."""
    end, i = time.perf_counter() + seconds * len(some), 0
    while time.perf_counter() < end or i < 3:
        i += 1
        for loop in some:
            # The step before fills the caches and the session's state for this loop.
            sign = (-1) ** i
            loop.prepare(scene.positions - sign * loop.moves)
            positions = scene.positions + sign * loop.moves
            used = server_seconds(client)
            with counted() as total:
                start = time.perf_counter()
                loop.step(positions)
                loop.seconds.append(time.perf_counter() - start)
            loop.sent, loop.received = loop.sent + total[0], loop.received + total[1]
            loop.server += server_seconds(client) - used


def show(title: str, some: list[Loop]) -> None:
    """Prints the table of a scene."""
    print(row(title, *HEAD))
    print(f"|---|{len(HEAD) * '--:|'}")
    (search,) = (loop for loop in some if loop.name == "find")
    for loop in some:
        steps = len(loop.seconds)
        figures = (
            f"{1e3 * np.median(loop.seconds):,.2f}",
            f"{1e3 * loop.server / steps:,.2f}",
            f"{loop.server / search.server:.0%}" if search.server else "",
            f"{loop.sent / steps / 1e3:,.1f}",
            f"{loop.received / steps / 1e3:,.1f}",
        )
        print(row(loop.name, *figures), flush=True)
    print()


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description="The cost of a step of a simulation")
    parser.add_argument("--seconds", type=float, default=2.0, help="of each measurement")
    parser.add_argument("--worlds", type=int, default=10_000, help="the number of worlds")
    arguments = parser.parse_args()
    with hullcast.serve() as client:
        pile = hullcast.Scene.load(PILE)
        client.register([content.points for content in pile.contents if content is not None])
        hulls = find.register(client)
        heap = find.heap(hulls, 1000, None)
        worlds = find.heap(hulls, BODIES_PER_WORLD * arguments.worlds, arguments.worlds)
        for name, scene in (
            ("settled pile", pile),
            ("loose heap", heap),
            (f"{arguments.worlds:,} worlds", worlds),
        ):
            margin = find.MARGIN if scene.margin is None else scene.margin
            pairs = client.find(scene, margin=margin).pairs if scene.pairs is None else scene.pairs
            some = loops(client, scene, pairs, margin)
            measure(client, scene, some, arguments.seconds)
            show(f"{name}: {len(scene):,} bodies, {len(pairs):,} pairs", some)


if __name__ == "__main__":
    main()

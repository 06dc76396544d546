"""Measures the cost of the Python client itself, and the saving of a step loop.

    python client/examples/overhead.py [--seconds 2] [--sizes 1 64]

For batches of several sizes, the table has the time of a `query` from numpy arrays to numpy arrays;
the part of it that the client itself takes (to make the messages and read the responses, measured
without a server on messages of a real call); a warm query, whose bases are requested and given
back; and a step of a session. The pairs are polytopes of 16 vertices at random positions, some of
them in contact. The output is a Markdown table.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from throughput import row

import hullcast
from hullcast import _answers, _calls
from hullcast._query import Query, Span

SIZES = (1, 64, 4096, 1_000_000)
VERTICES = 16
SHAPES = 64
MARGIN = 0.01


def scene_of(
    client: hullcast.Client, pairs: int
) -> tuple[hullcast.Scene, np.ndarray[tuple[int, int], np.dtype[np.uint32]]]:
    """A scene with each body in one pair, and the two bodies of a pair near each other."""
    rng = np.random.default_rng(7)
    points = rng.normal(size=(SHAPES, VERTICES, 3))
    hulls = client.register(points / np.linalg.norm(points, axis=2, keepdims=True))
    rotations = rng.normal(size=(2 * pairs, 4))
    rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
    positions = np.repeat(rng.uniform(-5, 5, (pairs, 3)), 2, axis=0)
    away = rng.normal(size=(pairs, 3))
    positions[1::2] += away / np.linalg.norm(away, axis=1, keepdims=True) * 1.7
    kinds = rng.integers(SHAPES, size=2 * pairs)
    scene = hullcast.Scene(hulls, positions, rotations, body_hulls=kinds)
    return scene, np.arange(2 * pairs, dtype=np.uint32).reshape(-1, 2)


def median_seconds(call: Callable[[], object], seconds: float) -> float:
    """The median duration of a call, over as many calls as fit into the given seconds."""
    call()
    times: list[float] = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(times) < 3:
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def own_work(
    client: hullcast.Client,
    scene: hullcast.Scene,
    pairs: np.ndarray[tuple[int, int], np.dtype[np.uint32]],
) -> Callable[[], object]:
    """All the work of `query` except the calls, on the responses of a real query."""

    def make() -> Query:
        return Query(scene, pairs, margin=MARGIN)

    query = make()
    link = client._link()
    answers: dict[Span, tuple[int, bytes]] = {}
    for span in query.spans(client.pairs_per_message):
        message = query.message(span)
        answer = link.call(_calls.QUERY, message.data, None).result()
        answers[span] = message.request_id, answer

    def work() -> hullcast.Manifolds:
        query = make()
        parts: list[_answers.Columns] = []
        for span in query.spans(client.pairs_per_message):
            number, answer = answers[span]
            # The response belongs to another message with the same content.
            message = replace(query.message(span), request_id=number)
            parts.append(query.read(span, message, _answers.Answer(answer, number)))
        return query.delivered(_answers.merge(parts))

    return work


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description="The Python client's own cost")
    parser.add_argument("--seconds", type=float, default=2.0, help="of each measurement")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="pairs a call")
    arguments = parser.parse_args()
    seconds: float = arguments.seconds
    own_names = "client's own work, us", "own work, ns per pair"
    step_names = "session step, us", "session, pairs/s"
    print(row("pairs", "query, us", *own_names, "warm query, us", *step_names))
    print(f"|{7 * '--:|'}")
    outputs = ("ALPHA", "NORMAL", "POINTS", "BASES")
    with hullcast.serve() as client:
        for size in arguments.sizes:
            scene, pairs = scene_of(client, size)
            m = client.query(scene, pairs, margin=MARGIN, outputs=outputs)
            cold = median_seconds(lambda: client.query(scene, pairs, margin=MARGIN), seconds)  # noqa: B023
            own = median_seconds(own_work(client, scene, pairs), seconds)
            warm = median_seconds(
                lambda: client.query(scene, pairs, margin=MARGIN, outputs=outputs, warm=m),  # noqa: B023
                seconds,
            )
            with client.session(scene, pairs, margin=MARGIN) as session:
                step = median_seconds(
                    lambda: session.step(scene.positions, scene.rotations),  # noqa: B023
                    seconds,
                )
            figures = [f"{t * 1e6:,.0f}" for t in (cold, own)]
            figures += [f"{own / size * 1e9:,.0f}", *(f"{t * 1e6:,.0f}" for t in (warm, step))]
            print(row(f"{size:,}", *figures, f"{size / step:,.0f}"), flush=True)


if __name__ == "__main__":
    main()

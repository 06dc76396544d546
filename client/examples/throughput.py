"""Measures contact manifolds per second from numpy arrays to numpy arrays, through the server.

    python client/examples/throughput.py [--seconds 5] [--connect HOST:PORT]

The pairs are boxes, whole manifolds are computed from a cold start, and a message has 4,096 pairs.
In "shallow" pairs the boxes have random orientations and a growth scale of .95 to .995 (mostly one
contact point). In "resting" pairs a face lies on a face at a random spin (four to eight points).
Server and client share this machine's cores, unless --connect names a server on another machine.
The rates are for several messages in flight, and for one message at a time, which is the rate of a
single blocking caller. The output is a Markdown table.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import hullcast

PAIRS_PER_MESSAGE = 4096
MESSAGES = 16
SHAPES = 64


#: (8, 3): the corners of a cube of half extent 1.
SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def half_extents() -> np.ndarray:
    """(SHAPES, 3): the half extents of the boxes."""
    return np.random.default_rng(0).uniform(0.3, 1.0, (SHAPES, 3))


def shallow(
    client: hullcast.Client, hulls: list[hullcast.Hull], pairs: np.ndarray
) -> hullcast.Scene:
    """Random poses, moved into shallow overlap."""
    rng = np.random.default_rng(1)
    rotations = random_rotations(rng, pairs.size)
    positions = rng.uniform(-5, 5, (len(pairs), 2, 3))
    kinds = rng.integers(SHAPES, size=pairs.size)
    scene = hullcast.Scene(hulls, positions.reshape(-1, 3), rotations, body_hulls=kinds)
    # The growth scale is linear in the offset of B, so one query is enough to find the offset.
    m = client.query(scene, pairs, margin=np.inf, outputs=["ALPHA"])
    target = rng.uniform(0.95, 0.995, len(pairs))
    offset = positions[:, 1] - positions[:, 0]
    positions[:, 1] = positions[:, 0] + offset * (target / m.alpha)[:, None]
    return scene.moved(positions.reshape(-1, 3), rotations)


def resting(
    client: hullcast.Client, hulls: list[hullcast.Hull], pairs: np.ndarray
) -> hullcast.Scene:
    """B's bottom face on A's top face, rotated about their normal, 1e-3 deep."""
    rng, half = np.random.default_rng(2), half_extents()
    count = len(pairs)
    kinds = rng.integers(SHAPES, size=(count, 2))
    turn = random_rotations(rng, count)
    spin = rng.uniform(0, np.pi, count)
    about_z = np.stack([0 * spin, 0 * spin, np.sin(spin), np.cos(spin)], axis=1)
    rotations = np.stack([turn, times(turn, about_z)], axis=1)
    offset = rng.uniform(-0.2, 0.2, (count, 3))
    offset[:, 2] = half[kinds[:, 0], 2] + half[kinds[:, 1], 2] - 1e-3
    positions = np.repeat(rng.uniform(-5, 5, (count, 1, 3)), 2, axis=1)
    positions[:, 1] += turned(turn, offset)
    return hullcast.Scene(
        hulls, positions.reshape(-1, 3), rotations.reshape(-1, 4), body_hulls=kinds.reshape(-1)
    )


def random_rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 4): random unit quaternions x, y, z, w."""
    q = rng.normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def times(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The products of quaternions x, y, z, w: the rotation q, then the rotation p."""
    vector = p[:, 3:] * q[:, :3] + q[:, 3:] * p[:, :3] + np.cross(p[:, :3], q[:, :3])
    scalar = p[:, 3] * q[:, 3] - np.sum(p[:, :3] * q[:, :3], axis=1)
    return np.column_stack([vector, scalar])


def turned(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors rotated by quaternions."""
    twice = 2 * np.cross(q[:, :3], v)
    return v + q[:, 3:] * twice + np.cross(q[:, :3], twice)


def rate(client: hullcast.Client, scene: hullcast.Scene, pairs: np.ndarray, seconds: float):
    """Manifolds per second, points per manifold, and the number of cores that the client used."""
    client.query(scene, pairs)  # lets the server load the hulls
    done = points = 0
    start, used = time.perf_counter(), time.process_time()
    while (wall := time.perf_counter() - start) < seconds:
        m = client.query(scene, pairs)
        assert (m.outcome == hullcast.Outcome.CONTACT).all()
        done += len(m)
        points += len(m.distance)
    return done / wall, points / done, (time.process_time() - used) / wall


def row(*cells: str) -> str:
    """A row of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description="Manifolds a second through a server")
    parser.add_argument("--seconds", type=float, default=3.0, help="of each of four measurements")
    parser.add_argument("--connect", metavar="TARGET", help="instead of a server of its own")
    arguments = parser.parse_args()
    pairs = np.arange(2 * MESSAGES * PAIRS_PER_MESSAGE, dtype=np.uint32).reshape(-1, 2)
    names = "messages under way", "manifolds/s", "points per manifold", "client's cores"
    print(row("boxes", *names))
    print("|---|---|--:|--:|--:|")
    ratios: list[str] = []
    with hullcast.connect(arguments.connect) if arguments.connect else hullcast.serve() as client:
        client.pairs_per_message = PAIRS_PER_MESSAGE
        hulls = client.register(SIGNS * half_extents()[:, None, :])
        for make in (shallow, resting):
            scene = make(client, hulls, pairs)
            rates: dict[str, float] = {}
            for name, asked in (("several", pairs), ("one at a time", pairs[:PAIRS_PER_MESSAGE])):
                rates[name], points, cores = rate(client, scene, asked, arguments.seconds)
                figures = f"{rates[name]:,.0f}", f"{points:.2f}", f"{cores:.2f}"
                print(row(make.__name__, name, *figures), flush=True)
            ratio = rates["several"] / rates["one at a time"]
            ratios.append(f"{ratio:.2f} times ({make.__name__})")
    print(f"\nSeveral messages under way are {' and '.join(ratios)} as fast as one at a time.")


if __name__ == "__main__":
    main()

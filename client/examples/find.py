"""Measures the cost of finding pairs against the number of bodies, and of worlds.

    python client/examples/find.py [--docs FOLDER]

The scenes have boxes and polyhedra of 16 vertices at random orientations, as dense as a loose heap
(about two contacts per body). There are scenes of one world with 1,000 to 100,000 bodies, and
scenes of 100 to 10,000 worlds with ten bodies each, which all occupy the same space. "find" lets
the server find the pairs and compute their contacts. "query" requests the pairs that "find"
returned. The difference between the two is the cost of the broad phase and of its candidate pairs
that are not in contact. Server and client share this machine. --docs writes the table and the
picture of docs/find.md.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# matplotlib is only partly typed.

from __future__ import annotations

import argparse
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import hullcast

BODIES = (1_000, 3_000, 10_000, 30_000, 100_000)
WORLDS = (100, 1_000, 3_000, 10_000)
BODIES_PER_WORLD = 10
#: The edge of the cube of space per body; the hulls are about 0.9 across.
ROOM = 0.85
MARGIN = 0.01
OPEN, CLOSE = "<!-- cost -->", "<!-- /cost -->"


def register(client: hullcast.Client) -> list[hullcast.Hull]:
    """Registers random boxes and polyhedra."""
    rng = np.random.default_rng(5)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    boxes = [corners * rng.uniform(0.2, 0.5, 3) for _ in range(8)]
    directions = rng.normal(size=(8, 16, 3))
    rounds = list(directions / np.linalg.norm(directions, axis=2, keepdims=True) * 0.45)
    return client.register(boxes + rounds)


def heap(hulls: list[hullcast.Hull], bodies: int, worlds: int | None) -> hullcast.Scene:
    """Bodies at random poses, all in one world, or divided evenly among several worlds."""
    rng = np.random.default_rng(bodies)
    together = bodies if worlds is None else bodies // worlds
    rotations = rng.normal(size=(bodies, 4))
    return hullcast.Scene(
        hulls,
        rng.uniform(0, ROOM * together ** (1 / 3), (bodies, 3)),
        rotations / np.linalg.norm(rotations, axis=1, keepdims=True),
        body_hulls=rng.integers(len(hulls), size=bodies),
        worlds=None if worlds is None else np.arange(bodies) // together,
    )


def median(work: Callable[[], hullcast.Manifolds], seconds: float) -> float:
    """The median duration of at least three runs, in seconds."""
    times: list[float] = []
    begin = time.perf_counter()
    while len(times) < 3 or time.perf_counter() - begin < seconds:
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def measure(
    client: hullcast.Client, scene: hullcast.Scene, seconds: float
) -> tuple[int, list[float]]:
    """The number of pairs found; the seconds of find, of find with outcomes only, and of query."""
    found = client.find(scene, margin=MARGIN)
    again = client.query(scene, found.pairs, margin=MARGIN)
    assert again.alpha.tobytes() == found.alpha.tobytes()
    return len(found), [
        median(lambda: client.find(scene, margin=MARGIN), seconds),
        median(lambda: client.find(scene, margin=MARGIN, outputs=["OUTCOME"]), seconds),
        median(lambda: client.query(scene, found.pairs, margin=MARGIN), seconds),
    ]


Row = tuple[str, int, int, list[float]]


def draw(rows: dict[str, list[Row]], path: Path) -> None:
    """Plots the time per body against the number of bodies."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), sharey=True)
    names = ("find", "find, outcomes alone", "query of the pairs found")
    for axis, (title, some) in zip(axes, rows.items(), strict=True):
        bodies = [row[1] for row in some]
        for i, name in enumerate(names):
            axis.plot(bodies, [row[3][i] / row[1] * 1e6 for row in some], "o-", label=name)
        axis.set(xscale="log", xlabel="bodies", title=title, ylim=(0, None))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("microseconds a body")
    axes[0].legend()
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description="The cost of finding pairs")
    parser.add_argument("--seconds", type=float, default=1.0, help="of each measurement")
    parser.add_argument("--docs", type=Path, help="writes find.md's table and find.svg there")
    arguments = parser.parse_args()
    rows: dict[str, list[Row]] = {"one world": [], f"worlds of {BODIES_PER_WORLD}": []}
    lines = [
        "| | bodies | pairs found | find | outcomes only | query of the pairs | find, per body |",
        "|---|---|---|---|---|---|---|",
    ]
    with hullcast.serve() as client:
        hulls = register(client)
        for title, sizes in zip(rows, (BODIES, WORLDS), strict=True):
            for size in sizes:
                worlds = None if sizes is BODIES else size
                bodies = size if worlds is None else size * BODIES_PER_WORLD
                pairs, times = measure(client, heap(hulls, bodies, worlds), arguments.seconds)
                name = "one world" if worlds is None else f"{worlds:,} worlds"
                rows[title].append((name, bodies, pairs, times))
                shown = " | ".join(f"{1e3 * seconds:.1f} ms" for seconds in times)
                each = f"{1e6 * times[0] / bodies:.2f} us"
                lines.append(f"| {name} | {bodies:,} | {pairs:,} | {shown} | {each} |")
                print(lines[-1], flush=True)
    if arguments.docs:
        root = Path(__file__).resolve().parents[2]
        where = subprocess.run(
            [root / "scripts/provenance"], capture_output=True, text=True, check=True
        )
        page = arguments.docs / "find.md"
        head, rest = page.read_text().split(OPEN)
        table = "\n".join([where.stdout.strip(), "", *lines])
        page.write_text(f"{head}{OPEN}\n{table}\n{CLOSE}{rest.split(CLOSE)[1]}")
        draw(rows, arguments.docs / "find.svg")


if __name__ == "__main__":
    main()

"""Loads a server for a long time and checks its memory.

    python client/examples/soak.py --registrations 1000000 --hulls 100000 --rounds 2000

In the first part, hulls are registered again and again, and queried. In the second part, several
threads run rounds that register, query, find, step and delete, with small and large hulls. The
store is on a file system in memory (/dev/shm), so that no time is spent on a disk. The program
writes soak.csv and soak.svg. It fails if a result is wrong, or if the server's memory exceeds the
cache's budget plus a constant.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# matplotlib is only partly typed.

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import grpc
import numpy as np

import hullcast
from hullcast._pb import hulls_pb2
from hullcast._serve import find_binary

#: The memory of the server outside its cache, in bytes: buffers of calls, threads, the program, and
#: memory that the allocator retains.
BESIDE = 192 << 20
#: The number of hulls that one call of the first part registers.
BATCH = 1000
#: The number of hulls of a round of the second part, and the number of threads that run rounds.
ROUND = 200
THREADS = 4
_OPTIONS = [("grpc.enable_http_proxy", 0)]
_REST = [0.0, 0.0, 0.0, 1.0]


@dataclass
class Server:
    """A server and the measurements of it."""

    target: str
    admin: str
    rows: list[tuple[float, int, int, int]] = field(default_factory=list)
    began: float = field(default_factory=time.monotonic)

    def metrics(self) -> dict[str, float]:
        """The value of every sample in /metrics."""
        with urllib.request.urlopen(f"http://{self.admin}/metrics", timeout=60) as response:
            lines = response.read().decode().splitlines()
        samples = (line.rsplit(" ", 1) for line in lines if not line.startswith("#"))
        return {name: float(value) for name, value in samples}

    def look(self) -> None:
        """Adds one row of measurements."""
        metrics = self.metrics()
        names = ("hullcast_resident_bytes", "hullcast_cache_bytes")
        resident, cached = (int(metrics[name]) for name in names)
        calls = sum(v for k, v in metrics.items() if k.startswith("hullcast_requests_total{"))
        self.rows.append((time.monotonic() - self.began, int(calls), resident, cached))


@contextlib.contextmanager
def serving(cache: int) -> Generator[Server]:
    """Starts a server with a cache of `cache` bytes."""
    memory = "/dev/shm" if os.path.isdir("/dev/shm") else None
    with tempfile.TemporaryDirectory(dir=memory) as store:
        command = [find_binary(), "serve", "--listen", "127.0.0.1:0", "--store", store]
        command += ["--admin-listen", "127.0.0.1:0", "--cache-bytes", str(cache)]
        process = subprocess.Popen(
            [*command, "--until-stdin-closes"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        with process:
            assert process.stdout is not None
            target = process.stdout.readline().removeprefix("listening on ").strip()
            admin = process.stdout.readline().removeprefix("admin on ").strip()
            yield Server(target, admin)


def register(server: Server, registrations: int, count: int) -> None:
    """Registers `registrations` times, of `count` distinct hulls; a query follows each call."""
    rng = np.random.default_rng(1)
    batch = min(BATCH, count)
    with hullcast.connect(server.target, options=_OPTIONS) as client:
        for done in range(0, registrations, batch):
            first = done % count
            clouds = [_cloud(seed, 16) for seed in range(first, min(first + batch, count))]
            hulls = client.register(clouds)
            scene = hullcast.Scene(hulls, rng.uniform(0, 20, (len(hulls), 3)), [_REST] * len(hulls))
            answer = client.query(scene, rng.integers(len(hulls), size=(4096, 2)), margin=0.1)
            assert _answered(answer) == 4096
            server.look()


def mix(server: Server, rounds: int) -> dict[str, int]:
    """Runs rounds of all operations from several threads at once; returns the counts of results."""
    totals: dict[str, int] = {}
    with (
        hullcast.connect(server.target, options=_OPTIONS) as client,
        ThreadPoolExecutor(THREADS) as pool,
    ):
        for counts in pool.map(partial(_round, client, server.target), range(rounds)):
            for name, count in counts.items():
                totals[name] = totals.get(name, 0) + count
            server.look()
    return totals


def _round(client: hullcast.Client, target: str, number: int) -> dict[str, int]:
    rng = np.random.default_rng(number)
    # Overlapping rounds share hulls, and one hull in fifty is large.
    seeds = rng.integers(0, 20 * ROUND, size=ROUND)
    hulls = client.register([_cloud(seed, 600 if seed % 50 == 0 else 24) for seed in seeds])
    scene = hullcast.Scene(hulls, rng.uniform(0, 15, (ROUND, 3)), [_REST] * ROUND)
    pairs = rng.integers(ROUND, size=(3000, 2))
    counts = {"registered": len(hulls)}
    counts["queried"] = _answered(client.query(scene, pairs, margin=0.5))
    counts["found"] = _answered(client.find(scene, margin=0.5))
    # Other rounds may delete hulls that this round uses; the client registers them again.
    ids = [hull.id for hull in hulls[: ROUND // 10]]
    with grpc.insecure_channel(target, options=_OPTIONS) as channel:
        delete: Any = channel.unary_unary(
            "/hullcast.v1.HullService/DeleteHulls",
            hulls_pb2.DeleteHullsRequest.SerializeToString,
            hulls_pb2.DeleteHullsResponse.FromString,
        )
        answer = delete(hulls_pb2.DeleteHullsRequest(ids=dict.fromkeys(ids)), timeout=60)
        counts["deleted"] = sum(answer.deleted)
    counts["stepped"] = 0
    with client.session(scene, pairs[:500], margin=0.5) as session:
        for _ in range(5):
            positions = scene.positions + rng.normal(scale=0.1, size=(ROUND, 3))
            counts["stepped"] += len(session.step(positions, [_REST] * ROUND).outcome)
    return counts


def _cloud(seed: int, points: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(int(seed)).normal(size=(points, 3))


def _answered(answer: hullcast.Manifolds) -> int:
    """The number of pairs that were answered.

    A pair may be unanswered if another round kept deleting one of its hulls.
    """
    unsaid = answer.outcome == hullcast.Outcome.INVALID
    assert bool(np.all(answer.flags[unsaid] == hullcast.Flag.UNKNOWN_HULL))
    return len(answer.outcome) - int(unsaid.sum())


def _write(server: Server, parted: float, cache: int, out: Path) -> None:
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    # Reduce the rows to about a thousand for the plot: the highest of each stretch.
    step = -(-len(server.rows) // 1000)
    rows = [
        max(server.rows[i : i + step], key=lambda row: row[2])
        for i in range(0, len(server.rows), step)
    ]
    text = ["seconds,calls,resident bytes,cache bytes"]
    text += [f"{s:.1f},{calls},{resident},{cached}" for s, calls, resident, cached in rows]
    (out / "soak.csv").write_text("\n".join(text) + "\n")
    table = np.array(rows)
    figure, axes = plt.subplots(figsize=(7, 4))
    axes.plot(table[:, 0], table[:, 2] / 2**20, label="resident")
    axes.plot(table[:, 0], table[:, 3] / 2**20, label="hulls in the cache")
    axes.axhline(cache / 2**20, color="grey", linestyle=":", label="cache_bytes")
    axes.axvline(parted, color="grey", linewidth=0.5)
    axes.set(xlabel="seconds (registering, then everything)", ylabel="MiB", ylim=(0, None))
    axes.legend()
    figure.savefig(out / "soak.svg")


def main() -> None:
    """Runs both parts and checks the memory."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--registrations", type=int, default=100_000)
    parser.add_argument("--hulls", type=int, default=20_000)
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--cache-bytes", type=int, default=64 << 20)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    with serving(args.cache_bytes) as server:
        register(server, args.registrations, args.hulls)
        parted, first = time.monotonic() - server.began, len(server.rows)
        totals = mix(server, args.rounds)
    most = [max((row[2] for row in rows), default=0) for rows in (server.rows[:first], server.rows)]
    print(
        f"SOAK {args.registrations} registrations of {args.hulls} hulls in {parted:.0f} s: at most"
        f" {most[0] >> 20} MiB resident; {args.rounds} rounds of everything in"
        f" {server.rows[-1][0] - parted:.0f} s ({totals}): at most {most[1] >> 20} MiB; budget"
        f" {args.cache_bytes >> 20} + {BESIDE >> 20} MiB"
    )
    if args.out is not None:
        _write(server, parted, args.cache_bytes, args.out)
    assert max(row[3] for row in server.rows) <= args.cache_bytes
    assert most[1] <= args.cache_bytes + BESIDE


if __name__ == "__main__":
    main()

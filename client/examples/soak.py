"""Registers and queries for a long time and watches the server's memory.

    python client/examples/soak.py --registrations 1000000 --hulls 100000

The store is put on a file system in memory (/dev/shm), so that no disk is
waited for. Writes docs/soak.csv and docs/soak.svg; fails where the server's
memory passes the cache's budget plus a constant.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path

import numpy as np

import hullcast
from hullcast._serve import find_binary

CACHE = 64 << 20
#: What the server has beside its cache: buffers of calls, threads, the program, and what
#: the allocator holds back.
BESIDE = 256 << 20
BATCH = 1000


def main() -> None:
    """Runs it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--registrations", type=int, default=100_000)
    parser.add_argument("--hulls", type=int, default=20_000)
    parser.add_argument("--out", type=Path, default=Path("docs"))
    args = parser.parse_args()
    memory = "/dev/shm" if os.path.isdir("/dev/shm") else None
    with tempfile.TemporaryDirectory(dir=memory) as store:
        rows = _soak(args.registrations, args.hulls, store)
    _write(rows, args.out)
    most = max(row[2] for row in rows)
    print(
        f"SOAK {args.registrations} registrations of {args.hulls} hulls in {rows[-1][0]:.0f} s: "
        f"at most {most >> 20} MiB resident, budget {CACHE >> 20} + {BESIDE >> 20} MiB"
    )
    assert most <= CACHE + BESIDE


def _soak(registrations: int, count: int, store: str) -> list[tuple[float, int, int, int]]:
    command = [find_binary(), "serve", "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0"]
    command += ["--store", store, "--cache-bytes", str(CACHE), "--until-stdin-closes"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as server:
        assert server.stdout is not None
        address = server.stdout.readline().removeprefix("listening on ").strip()
        admin = server.stdout.readline().removeprefix("admin on ").strip()
        options = [("grpc.enable_http_proxy", 0)]
        rng = np.random.default_rng(1)
        rows = []
        began = time.monotonic()
        with hullcast.connect(address, options=options) as client:
            for done in range(0, registrations, BATCH):
                first = done % count
                clouds = [
                    np.random.default_rng(seed).normal(size=(16, 3))
                    for seed in range(first, min(first + BATCH, count))
                ]
                hulls = client.register(clouds)
                scene = hullcast.Scene(
                    hulls, rng.uniform(0, 20, (len(hulls), 3)), [[0, 0, 0, 1]] * len(hulls)
                )
                pairs = rng.integers(len(hulls), size=(4096, 2))
                client.query(scene, pairs, margin=0.1)
                metrics = _metrics(admin)
                rows.append(
                    (
                        time.monotonic() - began,
                        done + len(hulls),
                        int(metrics["hullcast_resident_bytes"]),
                        int(metrics["hullcast_cache_bytes"]),
                    )
                )
        return rows


def _metrics(admin: str) -> dict[str, float]:
    with urllib.request.urlopen(f"http://{admin}/metrics", timeout=10) as response:
        lines = response.read().decode().splitlines()
    samples = (line.rsplit(" ", 1) for line in lines if not line.startswith("#"))
    return {name: float(value) for name, value in samples}


def _write(rows: list[tuple[float, int, int, int]], out: Path) -> None:
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    text = ["seconds,registrations,resident bytes,cache bytes"]
    text += [f"{s:.1f},{n},{resident},{cache}" for s, n, resident, cache in rows]
    (out / "soak.csv").write_text("\n".join(text) + "\n")
    table = np.array(rows)
    figure, axes = plt.subplots(figsize=(7, 4))
    axes.plot(table[:, 1], table[:, 2] / 2**20, label="resident")
    axes.plot(table[:, 1], table[:, 3] / 2**20, label="cached hulls")
    axes.axhline(CACHE / 2**20, color="grey", linestyle=":", label="cache_bytes")
    axes.set(xlabel="registrations", ylabel="MiB", ylim=(0, None))
    axes.legend()
    figure.savefig(out / "soak.svg")


if __name__ == "__main__":
    main()

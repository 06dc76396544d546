"""A batch job on ray beside the same job in one process.

    python client/examples/ray_scenes.py [--scenes 2000] [--tasks 2]

Scenes of 64 bodies, polytopes of 16 vertices in a box, and 512 pairs each. In one
process scene by scene, then many scenes in one query; then `hullcast.ray.query`, the
rows put into ray's store and the answers read back from it. Ray's start is not counted,
its servers' is: the first time is with it, the second with servers that run.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import ray as library

import hullcast
import hullcast.ray

BODIES, PAIRS, MARGIN = 64, 512, 0.01
#: Scenes in one query, where there are several.
TOGETHER = 32


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description="Scenes by ray and by one process")
    parser.add_argument("--scenes", type=int, default=2000)
    parser.add_argument("--tasks", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    count: int = arguments.scenes
    rng = np.random.default_rng(3)
    points = rng.normal(size=(16, 16, 3))
    pairs = rng.integers(BODIES, size=(PAIRS, 2))
    positions = rng.uniform(0, 5, (count, BODIES, 3))
    rotations = rng.normal(size=(count, BODIES, 4))
    rotations /= np.linalg.norm(rotations, axis=2, keepdims=True)
    print(f"{count:,} scenes of {PAIRS} pairs    seconds   M pairs/s   contacts")

    def report(name: str, run: Callable[[], int]) -> None:
        start = time.perf_counter()
        contacts = run()
        seconds = time.perf_counter() - start
        rate = count * PAIRS / seconds / 1e6
        print(f"{name:<32}{seconds:>8.2f}{rate:>12.3f}{contacts:>11,}", flush=True)

    with hullcast.serve() as client:
        hulls = client.register(points / np.linalg.norm(points, axis=2, keepdims=True))
        kinds = np.arange(BODIES) % len(hulls)
        scene = hullcast.Scene(hulls, positions[0], rotations[0], body_hulls=kinds)

        def one_by_one() -> int:
            return sum(
                touching(client.query(scene.moved(*poses), pairs, margin=MARGIN).outcome)
                for poses in zip(positions, rotations, strict=True)
            )

        def together() -> int:
            contacts = 0
            for start in range(0, count, TOGETHER):
                chosen = slice(start, start + TOGETHER)
                rows = len(positions[chosen])
                many = hullcast.Scene(
                    hulls,
                    positions[chosen].reshape(-1, 3),
                    rotations[chosen].reshape(-1, 4),
                    body_hulls=np.tile(kinds, rows),
                )
                ours = np.concatenate([pairs + BODIES * row for row in range(rows)])
                contacts += touching(client.query(many, ours, margin=MARGIN).outcome)
            return contacts

        report("one process, scene by scene", one_by_one)
        report(f"one process, {TOGETHER} in a query", together)

    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    os.environ["RAY_AUTH_MODE"] = "disabled"  # else it writes into the home folder
    ray: Any = library
    ray.init(num_cpus=arguments.tasks, include_dashboard=False, log_to_driver=False)
    ray.data.DataContext.get_current().enable_progress_bars = False

    def read(dataset: Any) -> int:
        batches = dataset.iter_batches(batch_size=None, batch_format="numpy")
        return sum(touching(batch["outcome"]) for batch in batches)

    table = ray.data.from_numpy(np.concatenate([positions, rotations], axis=2))
    rows = table.repartition(max(1, count // 128)).map_batches(in_columns).materialize()
    answered = hullcast.ray.query(rows, scene, pairs, margin=MARGIN, batch_size=TOGETHER)
    report("ray, its servers starting", lambda: read(answered))
    report("ray, its servers running", lambda: read(answered))
    ray.shutdown()


def in_columns(batch: dict[str, np.ndarray[Any, Any]]) -> dict[str, np.ndarray[Any, Any]]:
    """Positions and rotations apart."""
    return {"positions": batch["data"][..., :3], "rotations": batch["data"][..., 3:]}


def touching(outcomes: np.ndarray[Any, Any]) -> int:
    """Pairs in contact."""
    return int(np.count_nonzero(outcomes == hullcast.Outcome.CONTACT))


if __name__ == "__main__":
    main()

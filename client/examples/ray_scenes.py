"""Compares a batch job on ray with the same job in one process.

    python client/examples/ray_scenes.py [--scenes 2000] [--tasks 2]

Each scene has 64 bodies, polytopes of 16 vertices in a box, and 512 pairs. The job runs in one
process, first with one query per scene, then with many scenes per query. Then it runs with
`hullcast.ray.query`, including the time to read the results from ray's store. The time to start ray
is not counted. The time to start ray's servers is counted in the first of two runs; the second run
uses running servers.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import ray as library

import hullcast
import hullcast.ray

Floats = np.ndarray[Any, Any]

BODIES, PAIRS, MARGIN = 64, 512, 0.01
#: The number of scenes in one query, if there are several.
TOGETHER = 32


@dataclass(frozen=True)
class Job:
    """The job: hulls in many scenes, with the same pairs in each scene."""

    points: Floats
    positions: Floats
    rotations: Floats
    pairs: np.ndarray[Any, Any]

    @classmethod
    def random(cls, count: int) -> Job:
        rng = np.random.default_rng(3)
        points = rng.normal(size=(16, 16, 3))
        pairs = rng.integers(BODIES, size=(PAIRS, 2))
        positions = rng.uniform(0, 5, (count, BODIES, 3))
        rotations = rng.normal(size=(count, BODIES, 4))
        rotations /= np.linalg.norm(rotations, axis=2, keepdims=True)
        points /= np.linalg.norm(points, axis=2, keepdims=True)
        return cls(points, positions, rotations, pairs)

    def report(self, name: str, run: Callable[[], int]) -> None:
        """Runs a function that returns the number of contacts, and prints its duration."""
        start = time.perf_counter()
        contacts = run()
        seconds = time.perf_counter() - start
        rate = len(self.positions) * PAIRS / seconds / 1e6
        print(f"{name:<32}{seconds:>8.2f}{rate:>12.3f}{contacts:>11,}", flush=True)


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description="Scenes by ray and by one process")
    parser.add_argument("--scenes", type=int, default=2000)
    parser.add_argument("--tasks", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    job = Job.random(arguments.scenes)
    print(f"{arguments.scenes:,} scenes of {PAIRS} pairs    seconds   M pairs/s   contacts")
    scene = in_one_process(job)
    on_ray(job, scene, arguments.tasks)


def in_one_process(job: Job) -> hullcast.Scene:
    """Runs the job with one query per scene, then with many scenes per query; returns a scene."""
    with hullcast.serve() as client:
        hulls = client.register(job.points)
        kinds = np.arange(BODIES) % len(hulls)
        scene = hullcast.Scene(hulls, job.positions[0], job.rotations[0], body_hulls=kinds)

        def one_by_one() -> int:
            return sum(
                touching(client.query(scene.moved(*poses), job.pairs, margin=MARGIN).outcome)
                for poses in zip(job.positions, job.rotations, strict=True)
            )

        def together() -> int:
            contacts = 0
            for start in range(0, len(job.positions), TOGETHER):
                chosen = slice(start, start + TOGETHER)
                rows = len(job.positions[chosen])
                many = hullcast.Scene(
                    hulls,
                    job.positions[chosen].reshape(-1, 3),
                    job.rotations[chosen].reshape(-1, 4),
                    body_hulls=np.tile(kinds, rows),
                )
                pairs = np.concatenate([job.pairs + BODIES * row for row in range(rows)])
                contacts += touching(client.query(many, pairs, margin=MARGIN).outcome)
            return contacts

        job.report("one process, scene by scene", one_by_one)
        job.report(f"one process, {TOGETHER} in a query", together)
    return scene


def on_ray(job: Job, scene: hullcast.Scene, tasks: int) -> None:
    """Runs the job on a dataset of ray, twice."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    os.environ["RAY_AUTH_MODE"] = "disabled"  # otherwise ray writes to the home folder
    ray: Any = library
    ray.init(num_cpus=tasks, include_dashboard=False, log_to_driver=False)
    ray.data.DataContext.get_current().enable_progress_bars = False

    def read(dataset: Any) -> int:
        batches = dataset.iter_batches(batch_size=None, batch_format="numpy")
        return sum(touching(batch["outcome"]) for batch in batches)

    table = ray.data.from_numpy(np.concatenate([job.positions, job.rotations], axis=2))
    parts = max(1, len(job.positions) // 128)
    rows = table.repartition(parts).map_batches(in_columns).materialize()
    answered = hullcast.ray.query(rows, scene, job.pairs, margin=MARGIN, batch_size=TOGETHER)
    job.report("ray, its servers starting", lambda: read(answered))
    job.report("ray, its servers running", lambda: read(answered))
    ray.shutdown()


def in_columns(batch: dict[str, np.ndarray[Any, Any]]) -> dict[str, np.ndarray[Any, Any]]:
    """Splits the data into positions and rotations."""
    return {"positions": batch["data"][..., :3], "rotations": batch["data"][..., 3:]}


def touching(outcomes: np.ndarray[Any, Any]) -> int:
    """The number of pairs in contact."""
    return int(np.count_nonzero(outcomes == hullcast.Outcome.CONTACT))


if __name__ == "__main__":
    main()

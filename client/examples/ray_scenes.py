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
from dataclasses import dataclass
from typing import Any

import numpy as np
import ray as library

import hullcast
import hullcast.ray

Floats = np.ndarray[Any, Any]

BODIES, PAIRS, MARGIN = 64, 512, 0.01
#: Scenes in one query, where there are several.
TOGETHER = 32


@dataclass(frozen=True)
class Job:
    """What is asked: hulls in many scenes, the same pairs in each."""

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
        """Runs it, which gives the contacts found, and prints how long it took."""
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
    """Scene by scene, then many in a query; the first scene is given back."""
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
    """The same as a data set of ray's, twice."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    os.environ["RAY_AUTH_MODE"] = "disabled"  # else it writes into the home folder
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
    """Positions and rotations apart."""
    return {"positions": batch["data"][..., :3], "rotations": batch["data"][..., 3:]}


def touching(outcomes: np.ndarray[Any, Any]) -> int:
    """Pairs in contact."""
    return int(np.count_nonzero(outcomes == hullcast.Outcome.CONTACT))


if __name__ == "__main__":
    main()

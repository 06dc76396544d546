"""Ray: batch jobs over datasets of scenes, and clients that are passed to tasks and actors."""

from __future__ import annotations

import gc
import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import random_rotation
from crowds import EVERYTHING, RAY_SETTINGS, crowd

import hullcast
from hullcast._wire import OUTPUT_COLUMNS

pytest.importorskip("ray")

import ray
import ray.data
from ray.cluster_utils import Cluster

import hullcast.ray

NODE = {"num_cpus": 1, "object_store_memory": 80 << 20}
ROWS, BODIES = 96, 8
PAIRS = np.array([[i, j] for i in range(BODIES) for j in range(i)])
MARGIN = 0.1


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    """A cluster of one node with one processor, on which this process runs."""
    with pytest.MonkeyPatch.context() as settings:
        for name, value in RAY_SETTINGS.items():
            settings.setenv(name, value)
        cluster = Cluster(initialize_head=True, head_node_args={**NODE, "include_dashboard": False})
        try:
            ray.init(address=cluster.address, log_to_driver=False)
            ray.data.DataContext.get_current().enable_progress_bars = False
            yield cluster
        finally:
            ray.shutdown()
            cluster.shutdown()


@pytest.fixture
def second(cluster: Cluster) -> Iterator[Any]:
    """Another node, which a test may kill."""
    node = cluster.add_node(**NODE)
    yield node
    if node in cluster.worker_nodes:
        cluster.remove_node(node)


def rows_of(client: hullcast.Client) -> tuple[hullcast.Scene, list[dict]]:
    """A scene, and many rows with other poses of its bodies."""
    scene = crowd(client, BODIES)
    rng = np.random.default_rng(5)
    rows = []
    for row in range(ROWS):
        positions = rng.uniform(0, 1.6, (BODIES, 3))
        rotations = np.array([random_rotation(rng) for _ in range(BODIES)])
        rows.append({"row": row, "positions": positions, "rotations": rotations})
    return scene, rows


def expect_as_here(
    client: hullcast.Client, scene: hullcast.Scene, rows: list[dict], answered: list[dict], outputs
) -> None:
    """Asserts that each row is answered once, with the same bits as a query of that row here."""
    assert Counter(row["row"] for row in answered) == Counter(range(len(rows)))
    names = hullcast.ray.columns_of(outputs)
    points = 0
    for answer in answered:
        asked = rows[answer["row"]]
        expected = client.query(
            scene.moved(asked["positions"], asked["rotations"]),
            asked.get("pairs", PAIRS),
            margin=MARGIN,
            outputs=outputs,
        )
        points += int(expected.point_counts.sum())
        for name in names:
            ours, theirs = np.asarray(answer[name]), getattr(expected, name)
            assert ours.shape == theirs.shape, name
            assert ours.dtype == theirs.dtype, name
            assert ours.tobytes() == theirs.tobytes(), name
    assert points > 10 * len(rows)


def servers_on(store: Path) -> list[int]:
    """The processes that serve a store."""
    found = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = file.read_bytes().split(b"\0")
        except OSError:
            continue  # it has just ended
        if b"serve" in words and os.fsencode(store) in words:
            found.append(int(file.parent.name))
    return found


def alive(process: int) -> bool:
    return Path(f"/proc/{process}").exists()


def wait_until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_what_makes_no_query_is_refused_before_the_job(client):
    """Unknown names, bad pairs and a missing `ray.init` are refused before the job starts."""
    scene, _ = rows_of(client)
    with pytest.raises(hullcast.InvalidArgument, match="NOPE"):
        hullcast.ray.query(None, scene, PAIRS, outputs=["NOPE"])
    with pytest.raises(hullcast.InvalidArgument, match=f"{BODIES} is out of range"):
        hullcast.ray.query(None, scene, [[0, BODIES]])
    with pytest.raises(hullcast.InvalidArgument, match=r"ray\.init"):
        hullcast.ray.query(None, scene, PAIRS)


def test_every_output_has_its_columns():
    """Every output has columns with names of `Manifolds`; a new column must be added to them."""
    wire = {name for names in OUTPUT_COLUMNS.values() for name in names}
    columns = hullcast.ray.columns_of(OUTPUT_COLUMNS)
    assert len(columns) == len(set(columns)) == len(wire) + 2
    assert all(hasattr(hullcast.Manifolds, name) for name in columns[2:])


def test_a_node_is_killed_and_every_row_is_answered_once(cluster, second, client, tmp_path):
    """A node is killed during a job, and every row is still answered exactly once.

    Half of the rows are answered by a server, but held back until the second node is gone together
    with its rows. Catches lost or repeated rows, results that depend on the node, one server per
    task instead of one per node, and servers that outlive their job.
    """
    scene, rows = rows_of(client)
    store, gone = tmp_path / "hulls", tmp_path / "gone"
    seen: Counter[str] = Counter()
    problems: list[BaseException] = []

    def hold(batch):
        node = ray.get_runtime_context().get_node_id()
        if batch["row"].max() >= ROWS // 2:
            (tmp_path / f"held-{node}-{os.getpid()}").touch()
            while not gone.exists():
                time.sleep(0.02)
        return {**batch, "node": np.array([node] * len(batch["row"]))}

    def kill_the_second() -> None:
        try:
            held = f"held-{second.node_id}-*"
            wait_until(lambda: list(tmp_path.glob(held)))
            seen["servers"] = len(servers_on(store))
            cluster.remove_node(second, allow_graceful=False)
            # When a machine dies, its tasks die too. Here they outlive their ray for a moment.
            for file in tmp_path.glob(held):
                wait_until(lambda: not alive(int(file.name.rpartition("-")[2])))  # noqa: B023
        except BaseException as problem:
            problems.append(problem)
        finally:
            gone.touch()

    outputs = ("ALPHA", "NORMAL", "POINTS")
    dataset = ray.data.from_items(rows, override_num_blocks=ROWS // 2)
    half = {"num_cpus": 0.5}  # so that two tasks share a node
    answered = hullcast.ray.query(
        dataset, scene, PAIRS, margin=MARGIN, outputs=outputs, store=store, **half
    ).map_batches(hold, batch_format="numpy", **half)
    killer = threading.Thread(target=kill_the_second)
    killer.start()
    found = list(answered.iter_rows())
    killer.join()
    assert problems == []
    assert seen["servers"] == 2
    expect_as_here(client, scene, rows, found, outputs)
    late = {row["node"] for row in found if row["row"] >= ROWS // 2}
    assert late == {cluster.head_node.node_id}
    del answered

    def ended() -> bool:
        gc.collect()  # the dataset is part of a reference cycle
        return not servers_on(store)

    wait_until(ended)


def test_a_server_is_killed_and_started_again(second, client, tmp_path):
    """Each node's server is killed once. All columns are correct, with pairs that differ by row."""
    scene, rows = rows_of(client)
    store = tmp_path / "hulls"
    for row in rows:
        row["pairs"] = PAIRS[row["row"] % 3 :: 1 + row["row"] % 2].astype(np.uint32)
    dataset = ray.data.from_items(rows, override_num_blocks=ROWS // 4)
    answered = hullcast.ray.query(dataset, scene, margin=MARGIN, outputs=EVERYTHING, store=store)
    found, killed = [], []
    for row in answered.iter_rows():
        if not found:
            killed = servers_on(store)
            for process in killed:
                os.kill(process, signal.SIGKILL)
        found.append(row)
    assert killed
    expect_as_here(client, scene, rows, found, EVERYTHING)


def test_tasks_and_actors(cluster, client):
    """Each worker connects by itself, and gets the same results as this process."""
    scene, pairs = crowd(client, 50), [[i, (i * 7) % 50] for i in range(50)]

    def ask(client: hullcast.Client, scene: hullcast.Scene) -> bytes:
        return client.query(scene, pairs, margin=0.1).alpha.tobytes()

    class Worker:
        def __init__(self, client: hullcast.Client) -> None:
            self.client = client

        def ask(self, scene: hullcast.Scene) -> bytes:
            return ask(self.client, scene)

    worker = ray.remote(Worker).options(num_cpus=0).remote(client)
    asked = [ray.remote(ask).remote(client, scene), worker.ask.remote(scene)]
    assert ray.get(asked, timeout=300) == [ask(client, scene)] * 2

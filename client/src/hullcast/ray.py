"""Batch jobs on ray: one scene per row of a dataset, one server per node (extra `ray`).

    import hullcast.ray
    answered = hullcast.ray.query(dataset, scene, pairs, margin=0.01)  # a ray.data.Dataset

`import hullcast` does not load this module, because ray takes a second to load.
"""

from __future__ import annotations

import importlib
import itertools
import os
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from . import _arrays, _serve
from ._arguments import counted, one_of, seconds
from ._arrays import Indices
from ._client import Client
from ._errors import InvalidArgument, InvalidPosesWarning, Unavailable, warn
from ._manifolds import Manifolds
from ._outputs import output_names
from ._query import Accuracy, Query, own_pairs
from ._scene import Scene
from ._wire import OUTPUT_COLUMNS, POINT_COLUMNS

Batch = dict[str, npt.NDArray[Any]]

#: How often a task queries its node's server, which is restarted if it has ended. Each attempt is a
#: query with all of the client's own retries.
_SERVERS = 3


def query(
    dataset: Any,
    scene: Scene,
    pairs: Any = None,
    *,
    margin: float = 0.0,
    accuracy: Accuracy | None = None,
    outputs: Iterable[str] | None = None,
    on_invalid: Literal["raise", "flag"] = "flag",
    timeout: float | None = 60,
    store: str | os.PathLike[str] | None = None,
    arguments: Sequence[str] = (),
    **options: Any,
) -> Any:
    """Computes the contact manifolds of each row of a dataset, and adds them as columns.

    Each row is one scene: the bodies of `scene` at the poses of the row. The rows of one batch are
    sent as one query, to a server on the node that has the batch. Each node has one such server, on
    a Unix socket. It is started when it is first needed, and ends when the dataset is garbage
    collected or when the driver ends. A task that loses its server restarts it. If a node is lost,
    ray runs its tasks again on another node.

    Args:
        dataset: a `ray.data.Dataset`. Each row has `positions` (n, 3) and `rotations` (n, 4), the
            poses of the scene's n bodies, and `pairs` (m, 2) unless the argument `pairs` is given.
        scene: the hulls and bodies. Its poses, worlds and groups are not used.
        pairs: (m, 2), the pairs of every row.
        margin, accuracy, outputs, timeout: as in `Client.query`.
        on_invalid: "flag" gives the pairs of bodies with an unusable pose the outcome INVALID, and
            warns once per batch with their number. "raise" fails the batch with `InvalidPoses`.
        store: the store of each server; by default a temporary directory per server, which the
            server removes.
        arguments: further arguments of `hullcast serve`, such as `--compute-threads`.
        options: options of `map_batches`, such as `batch_size`, `num_cpus` and `concurrency`.

    Returns:
        The dataset with further columns, named like the attributes of `Manifolds` that the outputs
            bring: `outcome`, `flags`, `alpha` and so on. In a row, a per-point column such as
            `witness_a` or `distance` has the points of all pairs one after another,
            `point_counts[i]` of them for pair i.

    Raises:
        ImportError: ray is not installed.
        InvalidArgument: an argument is not usable; or NO_CLUSTER, `ray.init` was not called.
    """
    if pairs is not None:
        pairs = own_pairs(pairs, len(scene))
    names = output_names(outputs)
    ray = _library()
    one_of("on_invalid", on_invalid, ("raise", "flag"))
    asked: dict[str, Any] = {"margin": margin, "accuracy": accuracy, "outputs": names}
    # Check the arguments here, so that errors are not raised in a task.
    Query(scene, [] if pairs is None else pairs, **asked)
    asked |= {"on_invalid": on_invalid, "timeout": seconds("timeout", timeout) or np.inf}
    here = ray.get_runtime_context().get_node_id()
    servers = ray.remote(_Servers).options(**_placed(here)).remote(store, tuple(arguments))
    job = _Job(scene, pairs, asked, columns_of(names), servers)
    return dataset.map_batches(_answered, batch_format="numpy", fn_kwargs={"job": job}, **options)


@dataclass(frozen=True)
class _Job:
    """The data that every task gets."""

    scene: Scene
    pairs: Indices | None
    #: The arguments of `Client.query`.
    asked: dict[str, Any]
    columns: tuple[str, ...]
    servers: Any


def _answered(batch: Batch, job: _Job) -> Batch:
    """A batch with its results as further columns; runs in ray's tasks."""
    rows = len(batch["positions"])
    if rows == 0:
        return batch
    bodies = len(job.scene)
    own = (
        [job.pairs] * rows
        if job.pairs is not None
        else [own_pairs(p, bodies) for p in batch["pairs"]]
    )
    pairs = np.concatenate([pairs + row * bodies for row, pairs in enumerate(own)])
    scene = job.scene._many(
        _poses("positions", batch, bodies, 3), _poses("rotations", batch, bodies, 4)
    )
    found = _ask(job, scene, pairs)
    if len(found.invalid_bodies):
        warn(
            InvalidPosesWarning(
                f"{len(found.invalid_bodies)} of {counted(len(scene), 'body', 'bodies')} in "
                f"{len(np.unique(found.invalid_bodies // bodies))} of {counted(rows, 'row')} have "
                f"an unusable pose: {np.count_nonzero(found.outcome == 'INVALID')} of "
                f"{counted(len(found), 'pair')} are INVALID"
            )
        )
    ends = np.cumsum([len(pairs) for pairs in own])
    return {**batch, **_split(found, job, ends)}


def _poses(field: str, batch: Batch, bodies: int, width: int) -> npt.NDArray[np.float64]:
    """The poses of all rows, one row's bodies after another's."""
    rows = [_arrays.floats(field, row, bodies, width) for row in batch[field]]
    return np.concatenate(rows)


def _split(found: Manifolds, job: _Job, ends: npt.NDArray[np.int64]) -> Batch:
    """Splits each column of the result into the rows of the batch."""
    columns: Batch = {}
    for name in job.columns:
        of_points = name in _POINT_ATTRIBUTES
        cuts = found.point_offsets[ends] if of_points else ends
        column = getattr(found, name)
        if of_points or job.pairs is None:
            columns[name] = _ragged(column, cuts)
        else:
            columns[name] = column.reshape(len(ends), len(job.pairs), *column.shape[1:])
    return columns


def _ragged(column: npt.NDArray[Any], ends: npt.NDArray[np.int64]) -> npt.NDArray[Any]:
    rows = np.empty(len(ends), dtype=object)
    for row, (start, stop) in enumerate(itertools.pairwise([0, *ends])):
        rows[row] = column[start:stop]
    return rows


def columns_of(outputs: Iterable[str]) -> tuple[str, ...]:
    """The attributes of `Manifolds` that the outputs bring."""
    wire = dict.fromkeys(name for output in outputs for name in OUTPUT_COLUMNS[output])
    return ("outcome", "flags", *(_attribute(name) for name in wire))


def _attribute(wire: str) -> str:
    """The attribute for a column of the wire format: `alpha` for `alphas`; some keep the plural."""
    single = wire.removesuffix("s")
    return single if hasattr(Manifolds, single) else wire


_POINT_ATTRIBUTES = frozenset(_attribute(name) for name in POINT_COLUMNS)


def _ask(job: _Job, scene: Scene, pairs: Indices) -> Manifolds:
    """Queries this node's server, which is started (again) if it does not run."""
    ray = _library()
    server = ray.get(job.servers.on.remote(ray.get_runtime_context().get_node_id()))
    for attempt in itertools.count(1):
        target = ray.get(server.target.remote())
        try:
            return _client(target).query(scene, pairs, **job.asked)
        except Unavailable:
            if attempt == _SERVERS:
                raise
    raise AssertionError  # unreachable: `count` does not end


_clients: dict[str, Client] = {}


def _client(target: str) -> Client:
    """The client of this process, which is kept from task to task."""
    if target not in _clients:
        _clients.clear()  # a client of a server that has ended
        _clients[target] = Client.connect(target)
    return _clients[target]


class _Servers:
    """An actor on the driver's node. It owns the servers of all nodes, which end with it."""

    def __init__(self, *settings: Any) -> None:
        self._settings = settings
        self._nodes: dict[str, Any] = {}

    def on(self, node: str) -> Any:
        """The actor that runs a node's server."""
        if node not in self._nodes:
            actor = _library().remote(_Server).options(**_placed(node))
            self._nodes[node] = actor.remote(*self._settings)
        return self._nodes[node]


class _Server:
    """An actor on each node. It runs the node's server, which ends with it."""

    def __init__(self, store: str | os.PathLike[str] | None, arguments: Sequence[str]) -> None:
        self._store = store
        self._arguments = arguments
        self._folder = tempfile.TemporaryDirectory(prefix="hullcast-")
        self._running: _serve.Server | None = None

    def target(self) -> str:
        """The server's address. The server is started if it does not run."""
        if self._running is None or self._running.ended:
            listen = f"unix:{self._folder.name}/socket"
            self._running = _serve.start(self._store, listen=listen, arguments=self._arguments)
        return self._running.target


def _placed(node: str) -> dict[str, Any]:
    """Options of an actor that stays on one node, reserves no CPU, and is restarted if it fails."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    return {
        "num_cpus": 0,
        "max_restarts": -1,
        "max_task_retries": -1,
        "scheduling_strategy": NodeAffinitySchedulingStrategy(node, soft=False),
    }


def _library() -> Any:
    try:
        library: Any = importlib.import_module("ray")
        importlib.import_module("ray.data")
    except ImportError as error:
        raise ImportError(
            "batch jobs need ray: pip install './client[ray]' in the clone"
        ) from error
    if not library.is_initialized():
        raise InvalidArgument("call ray.init first", reason="NO_CLUSTER", field="dataset")
    return library

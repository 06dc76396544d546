"""Scenes and servers that several test files use."""

from __future__ import annotations

import contextlib
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from cases import random_rotation
from shapes import box, family, prism

import hullcast
from hullcast._serve import find_binary

CUBE = box((0.5, 0.5, 0.5)).vertices
#: The servers of the tests are on this machine, so no proxy is used.
NO_PROXY = [("grpc.enable_http_proxy", 0)]
EVERYTHING = (
    "ALPHA", "NORMAL", "POINTS", "WITNESS_B", "FEATURES", "BASES", "DIAGNOSTICS",
    "ALPHA_GRADIENT", "SEPARATION_GRADIENT", "NORMAL_JACOBIAN",
)  # fmt: skip
#: Settings of every ray process: it does not report usage or write into the home folder, and has
#: enough time to start on a busy machine.
RAY_SETTINGS = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_AUTH_MODE": "disabled",
    "RAY_gcs_server_port_wait_time_s": "300",
}
COLUMNS = (
    "outcome", "flags", "alpha", "alpha_lower", "alpha_upper", "normal", "separation", "point_counts",
    "point_offsets", "witness_a", "witness_b", "distance", "point_ids", "feature_kinds",
    "feature_indices", "bases", "iterations", "support_calls", "kept_area",
    "alpha_gradient", "separation_gradient", "normal_jacobian", "gradient_error",
    "pairs",
)  # fmt: skip


#: Pairs of `four_polyhedra`. Body 1 is in three of them, and one pair has its bodies in the other order.
FOUR_PAIRS = np.array([[0, 1], [1, 2], [3, 0], [2, 3], [1, 3]])


def crowd_of(hulls: list[hullcast.Hull], bodies: int, rng: np.random.Generator) -> hullcast.Scene:
    """Many bodies with a few different hulls, some of them touching."""
    side = 1.1 * bodies ** (1 / 3)
    return hullcast.Scene(
        hulls,
        rng.uniform(0, side, (bodies, 3)),
        [random_rotation(rng) for _ in range(bodies)],
        body_hulls=rng.integers(len(hulls), size=bodies),
    )


def crowd(client: hullcast.Client, bodies: int, seed: int = 31) -> hullcast.Scene:
    """A crowd of boxes and polyhedra."""
    rng = np.random.default_rng(seed)
    shapes = family("box", 3, rng) + family("poly16", 3, rng)
    return crowd_of(client.register([shape.vertices for shape in shapes]), bodies, rng)


def four_polyhedra(client: hullcast.Client) -> hullcast.Scene:
    """Four different polyhedra near each other, with quaternions of several lengths."""
    rng = np.random.default_rng(7)
    points = rng.normal(size=(4, 20, 3))
    hulls = client.register(points / np.linalg.norm(points, axis=2, keepdims=True))
    rotations = np.array([random_rotation(rng) for _ in range(4)]) * [[1], [0.7], [1.5], [2]]
    positions = [[0, 0, 0], [1.1, 0.9, 0.2], [0.3, 1.6, 1.2], [-0.8, 0.7, 1.4]]
    return hullcast.Scene(hulls, positions, rotations)


def make_pile(client: hullcast.Client) -> hullcast.Scene:
    """A prism and a rotated box on a slab, and a box that touches nothing."""
    shapes = [box((1.5, 1.5, 0.2)), prism(6, 0.5, 0.4), box((0.4, 0.3, 0.3)), box((0.2, 0.2, 0.2))]
    hulls = client.register([shape.vertices for shape in shapes])
    turn = [0, 0, np.sin(0.3), np.cos(0.3)]
    return hullcast.Scene(
        hulls,
        [[0, 0, 0], [-0.6, 0, 0.595], [0.6, 0.1, 0.51], [0, 0, 2]],
        [[0, 0, 0, 1], [0, 0, 0, 1], turn, turn],
    )


def expect_same(a: hullcast.Manifolds, b: hullcast.Manifolds, without: Sequence[str] = ()) -> None:
    """Asserts that all columns but some are equal bit for bit, NaN included."""
    for name in COLUMNS:
        if name in without:
            continue
        ours, theirs = getattr(a, name), getattr(b, name)
        assert ours.dtype == theirs.dtype
        assert ours.tobytes() == theirs.tobytes(), name


class Server:
    """A real server that can be killed and started again on the same port."""

    def __init__(self, store: Path | str = "memory://", *arguments: str) -> None:
        self._store = os.fspath(store)
        self._arguments = arguments
        self.address = "127.0.0.1:0"
        self.start()

    def start(self) -> None:
        """Starts the server on the previous port."""
        self.process = subprocess.Popen(
            [
                *(find_binary(), "serve", "--listen", self.address, "--store", self._store),
                *("--until-stdin-closes", *self._arguments),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline().decode()
        assert line.startswith("listening on "), line
        self.address = line.removeprefix("listening on ").strip()

    def kill(self) -> None:
        """Kills the server, as a crash would."""
        self.process.kill()
        self.process.wait(10)
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError):
                pipe.close()  # type: ignore[union-attr]

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()

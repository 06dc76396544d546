"""Runs coal and MuJoCo on the pairs of `lab tradeoff --ask`, which then judges their results.

    lab tradeoff --ask pairs.json
    python client/examples/tradeoff_peers.py pairs.json --out peers
    lab tradeoff --peer peers/coal.json --peer peers/mujoco.json

Each peer runs in this process on one thread, with hulls and poses prepared. coal uses `collide` and
`computeContactPatch`. MuJoCo uses `mj_collision` on a model that has only the two hulls; its meshes
are in single precision. The time of a pair is that of the fastest of three calls. It includes the
overhead of a call from Python; the duration of a call that does nothing is printed for comparison.
A peer that is not installed is left out.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from peers import coal_shapes
from scipy.spatial.transform import Rotation

#: The number of calls per pair, as in `lab tradeoff`.
ROUNDS = 3

Floats = npt.NDArray[np.float64]


@dataclass
class Contact:
    """A contact in the world frame.

    The normal points from A to B; points are midway between the hulls.
    """

    normal: list[float]
    separation: float
    points: list[list[float]]


#: Three functions for two hulls: one that places them by a position and quaternion each, one that
#: is timed, and one that returns what the timed one found.
Contender = tuple[
    Callable[[Sequence[float], Sequence[float]], None],
    Callable[[], object],
    Callable[[], "Contact | None"],
]
#: From a margin and all hulls to a function that makes the contender for a pair of hulls.
Maker = Callable[[float, list[Floats]], Callable[[int, int], Contender]]


def coal_peer() -> tuple[str, Maker, Callable[[], object]]:
    """coal's name, a maker of its contenders, and a call that does nothing."""
    import coal as library  # pyright: ignore[reportMissingImports]

    coal: Any = library

    def make(margin: float, hulls: list[Floats]) -> Callable[[int, int], Contender]:
        shapes = coal_shapes(coal, hulls)
        request = coal.CollisionRequest(coal.CollisionRequestFlag.CONTACT, 1)
        request.security_margin = margin
        patch_request = coal.ContactPatchRequest()

        def contender(i: int, j: int) -> Contender:
            poses = [coal.Transform3s(), coal.Transform3s()]
            result, patches = coal.CollisionResult(), coal.ContactPatchResult()

            def place(*places: Sequence[float]) -> None:
                for pose, at in zip(poses, places, strict=True):
                    pose.setRotation(Rotation.from_quat(at[3:]).as_matrix())
                    pose.setTranslation(np.array(at[:3]))

            def call() -> None:
                result.clear()
                patches.clear()
                if coal.collide(shapes[i], poses[0], shapes[j], poses[1], request, result):
                    coal.computeContactPatch(
                        shapes[i], poses[0], shapes[j], poses[1], result, patch_request, patches
                    )

            def found() -> Contact | None:
                if not result.isCollision():
                    return None
                contact = result.getContact(0)
                points = [contact.pos.tolist()]
                if patches.numContactPatches():
                    patch = patches.getContactPatch(0)
                    points = [patch.getPoint(k).tolist() for k in range(patch.size())] or points
                return Contact(contact.normal.tolist(), contact.penetration_depth, points)

            return place, call, found

        return contender

    idle = coal.CollisionResult()
    return f"coal {version('coal')}", make, idle.numContacts


MODEL = """<mujoco><asset>{meshes}</asset><worldbody>{bodies}</worldbody>
<contact><pair geom1="0" geom2="1" margin="{margin}"/></contact></mujoco>"""
MESH = '<mesh name="{i}" inertia="convex" vertex="{vertices}"/>'
GEOM = '<geom name="{i}" type="mesh" mesh="{i}" contype="0" conaffinity="0"/>'


def mujoco_peer() -> tuple[str, Maker, Callable[[], object]]:
    """MuJoCo's name, a maker of its contenders, and a call that does nothing."""
    import mujoco as library  # pyright: ignore[reportMissingImports]

    mujoco: Any = library

    def make(margin: float, hulls: list[Floats]) -> Callable[[int, int], Contender]:
        def contender(*pair: int) -> Contender:
            words = [" ".join(map(repr, hulls[hull].ravel().tolist())) for hull in pair]
            meshes = "".join(MESH.format(i=i, vertices=words[i]) for i in (0, 1))
            bodies = "".join(f'<body mocap="true">{GEOM.format(i=i)}</body>' for i in (0, 1))
            text = MODEL.format(meshes=meshes, bodies=bodies, margin=margin)
            model = mujoco.MjModel.from_xml_string(text)
            data = mujoco.MjData(model)

            def place(*places: Sequence[float]) -> None:
                for i, at in enumerate(places):
                    data.mocap_pos[i] = at[:3]
                    data.mocap_quat[i] = np.roll(at[3:], 1)
                mujoco.mj_kinematics(model, data)

            def found() -> Contact | None:
                contacts = sorted(data.contact, key=lambda contact: contact.dist)
                if not contacts:
                    return None
                deepest = contacts[0]
                sign = 1.0 if deepest.geom1 == 0 else -1.0
                points = [contact.pos.tolist() for contact in contacts]
                return Contact((sign * deepest.frame[:3]).tolist(), float(deepest.dist), points)

            return place, lambda: mujoco.mj_collision(model, data), found

        return contender

    empty = mujoco.MjModel.from_xml_string("<mujoco/>")
    nothing = mujoco.MjData(empty)
    return (
        f"MuJoCo {version('mujoco')}",
        make,
        lambda: mujoco.mj_collision(empty, nothing),
    )


def fastest(call: Callable[[], object], rounds: int = ROUNDS) -> int:
    """The duration of the fastest of `rounds` calls, in nanoseconds."""
    times: list[int] = []
    for _ in range(rounds):
        begin = time.perf_counter_ns()
        call()
        times.append(time.perf_counter_ns() - begin)
    return min(times)


def answers(make: Maker, cell: dict[str, Any]) -> list[dict[str, Any]]:
    """The results for every pair of a cell."""
    contender_of = make(cell["margin"], [np.array(hull) for hull in cell["hulls"]])
    answered: list[dict[str, Any]] = []
    for pair in cell["pairs"]:
        place, call, found = contender_of(*pair["hulls"])
        place(pair["a"], pair["b"])
        nanoseconds, contact = fastest(call), found()
        place(pair["a"], pair["nudged"])
        call()
        both = {
            name: one and asdict(one) for name, one in (("contact", contact), ("nudged", found()))
        }
        answered.append({"nanoseconds": nanoseconds, **both})
    return answered


def main() -> None:
    """Runs the peers and writes their results."""
    parser = argparse.ArgumentParser(description="coal and MuJoCo on the pairs of a tradeoff")
    parser.add_argument("pairs", type=Path, help="what `lab tradeoff --ask` wrote")
    parser.add_argument("--out", type=Path, default=Path("."), help="folder of the answers")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    asked = json.loads(arguments.pairs.read_text())
    for file, peer in (("coal", coal_peer), ("mujoco", mujoco_peer)):
        try:
            name, make, nothing = peer()
        except ImportError as error:
            print(f"{file}: left out: {error}")
            continue
        cells = [{"name": cell["name"], "pairs": answers(make, cell)} for cell in asked["cells"]]
        (arguments.out / f"{file}.json").write_text(json.dumps({"name": name, "cells": cells}))
        pairs = sum(len(cell["pairs"]) for cell in cells)
        print(f"{name}: {pairs} pairs; a call that does nothing {fastest(nothing, 1000)} ns")


if __name__ == "__main__":
    main()

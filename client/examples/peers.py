"""Compares hullcast's server with coal and python-fcl, which run in this process.

    python client/examples/peers.py [--seconds 3] [--scene examples/scenes/pile.json]

The scenes are a settled pile of 1,000 hulls with the pairs that are near each other; and pairs of
boxes, and of polytopes of 16 vertices, in shallow overlap. For every pair, each contender tells
whether the hulls are within the margin, and gives the normal and the contact points if they are.
The time runs from numpy arrays of poses to results in Python. coal uses `collide` and
`computeContactPatch` (the whole patch, with one depth), python-fcl `collide` (one point), and
hullcast `query` (the whole patch, with a certified depth per point) and the steps of a session.
Geometry and registration are not timed. hullcast's server is another process on the same cores;
"CPU" is the time of both processes together. A contender that is not installed is left out.
The output is a Markdown table for each scene.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import psutil
import throughput
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import hullcast

PILE = Path(__file__).resolve().parents[2] / "examples/scenes/pile.json"

#: The number of generated pairs, which are several messages.
FAMILY_PAIRS = 16 * throughput.PAIRS_PER_MESSAGE


@dataclass
class Scene:
    """The content of a scene file."""

    hulls: list[npt.NDArray[np.float64]]
    body_hulls: npt.NDArray[np.int64]
    positions: npt.NDArray[np.float64]
    rotations: npt.NDArray[np.float64]
    pairs: npt.NDArray[np.int64]
    margin: float

    def only(self, pair: int) -> Scene:
        """A scene of the two bodies of one pair."""
        bodies = self.pairs[pair]
        return Scene(
            self.hulls,
            self.body_hulls[bodies],
            self.positions[bodies],
            self.rotations[bodies],
            np.array([[0, 1]]),
            self.margin,
        )


#: Computes all pairs at their poses; returns the number of pairs in contact and of contact points.
Step = Callable[[], tuple[int, int]]


def load(path: Path) -> Scene:
    """Loads a scene file of the examples, in its first frame."""
    file = json.loads(path.read_text())
    bodies: Any = file["bodies"]
    frame = file["frames"][0] if "frames" in file else None
    positions = frame["positions"] if frame else [body["position"] for body in bodies]
    rotations = frame["rotations"] if frame else [body["rotation"] for body in bodies]
    return Scene(
        hulls=[np.array(hull["vertices"], dtype=float) for hull in file["hulls"]],
        body_hulls=np.array([body["hull"] for body in bodies]),
        positions=np.array(positions, dtype=float),
        rotations=np.array(rotations, dtype=float),
        pairs=np.array(file["pairs"]),
        margin=file["margin"],
    )


def family(client: hullcast.Client, hulls: list[npt.NDArray[np.float64]]) -> Scene:
    """Pairs of these hulls at random orientations, in shallow overlap."""
    pairs = np.arange(2 * FAMILY_PAIRS).reshape(-1, 2)
    made = throughput.shallow(client, client.register(hulls), pairs)
    kinds = made.body_hulls.astype(np.int64)
    return Scene(hulls, kinds, made.positions, made.rotations, pairs, 0.0)


def boxes() -> list[npt.NDArray[np.float64]]:
    """Boxes with half extents from 0.3 to 1."""
    return list(throughput.SIGNS * throughput.half_extents()[:, None, :])


def polytopes() -> list[npt.NDArray[np.float64]]:
    """8 points on a sphere and their opposites, scaled along the axes; centred like the boxes."""
    points = np.random.default_rng(3).normal(size=(throughput.SHAPES, 8, 3))
    points /= np.linalg.norm(points, axis=2, keepdims=True)
    return list(np.hstack([points, -points]) * throughput.half_extents()[:, None, :])


def bodies_of(client: hullcast.Client, scene: Scene) -> hullcast.Scene:
    """The scene in hullcast's form."""
    hulls = client.register(scene.hulls)
    return hullcast.Scene(hulls, scene.positions, scene.rotations, body_hulls=scene.body_hulls)


def count(m: hullcast.Manifolds) -> tuple[int, int]:
    """The number of pairs with contact points, and the number of points."""
    return int(np.count_nonzero(m.point_counts)), len(m.witness_b)


def by_query(client: hullcast.Client, scene: Scene) -> Step:
    """hullcast, with one query per step."""
    bodies = bodies_of(client, scene)

    def step() -> tuple[int, int]:
        moved = bodies.moved(scene.positions, scene.rotations)
        return count(client.query(moved, scene.pairs, margin=scene.margin))

    return step


def by_session(client: hullcast.Client, scene: Scene) -> Step:
    """hullcast, with a step loop."""
    session = client.session(bodies_of(client, scene), scene.pairs, margin=scene.margin)
    return lambda: count(session.step(scene.positions, scene.rotations))


def coal_shapes(coal: Any, hulls: Sequence[npt.NDArray[np.float64]]) -> list[Any]:
    """Makes coal's convex hulls of the points."""
    shapes: list[Any] = []
    for vertices in hulls:
        points = coal.StdVec_Vec3s()
        for vertex in vertices:
            points.append(vertex)
        shapes.append(coal.Convex.convexHull(points, True, "Qt"))
    return shapes


def by_coal(scene: Scene) -> Step:
    """coal: `collide`, then the contact patch."""
    import coal as library  # pyright: ignore[reportMissingImports]

    coal: Any = library
    shapes = coal_shapes(coal, scene.hulls)
    turns = [Rotation.from_quat(rotation).as_matrix() for rotation in scene.rotations]
    request = coal.CollisionRequest(coal.CollisionRequestFlag.CONTACT, 1)
    request.security_margin = scene.margin
    patch_request = coal.ContactPatchRequest()

    def step() -> tuple[int, int]:
        touching, found = 0, 0
        poses = [coal.Transform3s(*pose) for pose in zip(turns, scene.positions, strict=True)]
        for a, b in scene.pairs.tolist():
            first, second = shapes[scene.body_hulls[a]], shapes[scene.body_hulls[b]]
            result = coal.CollisionResult()
            if coal.collide(first, poses[a], second, poses[b], request, result):
                patches = coal.ContactPatchResult()
                coal.computeContactPatch(
                    first, poses[a], second, poses[b], result, patch_request, patches
                )
                touching += 1
                for i in range(patches.numContactPatches()):
                    patch = patches.getContactPatch(i)
                    points = [patch.getPoint(k) for k in range(patch.size())]
                    found += len(points)
        return touching, found

    return step


def by_fcl(scene: Scene) -> Step:
    """python-fcl: one contact point per pair, and no margin."""
    import fcl as library  # pyright: ignore[reportMissingImports]

    fcl: Any = library
    shapes: list[Any] = []
    for vertices in scene.hulls:
        hull: Any = ConvexHull(vertices)
        corners = vertices[hull.simplices]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        inward = np.einsum("ni,ni->n", normals, hull.equations[:, :3]) < 0
        simplices: npt.NDArray[np.int64] = hull.simplices
        triangles = np.where(inward[:, None], simplices[:, ::-1], simplices)
        faces = np.column_stack([np.full(len(triangles), 3), triangles]).reshape(-1)
        shapes.append(fcl.Convex(vertices, len(triangles), faces))
    quaternions = np.roll(scene.rotations, 1, axis=1)
    objects = [fcl.CollisionObject(shapes[kind]) for kind in scene.body_hulls]
    request = fcl.CollisionRequest(num_max_contacts=8, enable_contact=True)

    def step() -> tuple[int, int]:
        touching, found = 0, 0
        for body, moved in enumerate(objects):
            moved.setTransform(fcl.Transform(quaternions[body], scene.positions[body]))
        for a, b in scene.pairs.tolist():
            result = fcl.CollisionResult()
            if fcl.collide(objects[a], objects[b], request, result):
                touching += 1
                found += len([(c.pos, c.normal, c.penetration_depth) for c in result.contacts])
        return touching, found

    return step


def median_seconds(steps: Sequence[Step], seconds: float) -> list[float]:
    """The median duration of each step.

    Steps take turns, so that a busy moment affects all of them.
    """
    times: list[list[float]] = [[] for _ in steps]
    end = time.perf_counter() + seconds * len(steps)
    while time.perf_counter() < end or len(times[0]) < 3:
        for step, taken in zip(steps, times, strict=True):
            step()  # warms the caches for this contender
            start = time.perf_counter()
            step()
            taken.append(time.perf_counter() - start)
    return [float(np.median(taken)) for taken in times]


def cpu_seconds(step: Step, seconds: float) -> float:
    """The CPU seconds of a step, on all cores, in this process and its child processes."""
    processes = (psutil.Process(), *psutil.Process().children())

    def used() -> float:
        return sum(sum(process.cpu_times()[:2]) for process in processes)

    before, end, calls = used(), time.perf_counter() + seconds, 0
    # The system counts CPU time in ticks, of which a short measurement may see none.
    while used() == before or time.perf_counter() < end:
        step()
        calls += 1
    return (used() - before) / calls


def compare(client: hullcast.Client, name: str, scene: Scene, seconds: float) -> None:
    """Prints the cost of a step of the whole scene, and of one pair, for each contender."""
    pairs = len(scene.pairs)
    title = f"{name}: {len(scene.positions):,} bodies, {pairs:,} pairs"
    names = "us, 1 pair", "us per step", "pairs/s", "pairs per CPU-s", "pairs touching", "points"
    print(throughput.row(title, *names))
    print(f"|---|{len(names) * '--:|'}")
    m = client.query(bodies_of(client, scene), scene.pairs, margin=scene.margin)
    one = scene.only(int(np.argmax(m.point_counts)))
    makers: list[tuple[str, Callable[[Scene], Step]]] = [
        ("hullcast query", partial(by_query, client)),
        ("hullcast session", partial(by_session, client)),
        ("coal", by_coal),
        ("python-fcl", by_fcl),
    ]
    contenders: list[str] = []
    singles: list[Step] = []
    wholes: list[Step] = []
    for name, make in makers:
        try:
            wholes.append(make(scene))
        except ImportError as error:
            print(throughput.row(name, f"left out: {error}"))
            continue
        singles.append(make(one))
        contenders.append(name)
    single, whole = median_seconds(singles, seconds / 3), median_seconds(wholes, seconds)
    for i, name in enumerate(contenders):
        cpu = cpu_seconds(wholes[i], seconds)
        figures = (single[i] * 1e6, whole[i] * 1e6, pairs / whole[i], pairs / cpu, *wholes[i]())
        print(throughput.row(name, *(f"{x:,.0f}" for x in figures)), flush=True)


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description="The same scenes by hullcast, coal and python-fcl")
    parser.add_argument("--seconds", type=float, default=3.0, help="of each measurement")
    parser.add_argument("--scene", type=Path, default=PILE)
    arguments = parser.parse_args()
    with hullcast.serve() as client:
        compare(client, arguments.scene.name, load(arguments.scene), arguments.seconds)
        for name, hulls in (("boxes", boxes()), ("polytopes of 16 vertices", polytopes())):
            print()
            compare(client, name, family(client, hulls), arguments.seconds)


if __name__ == "__main__":
    main()

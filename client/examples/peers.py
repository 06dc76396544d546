"""Scenes through hullcast's server, and in process through coal and python-fcl.

    python client/examples/peers.py [--seconds 3] [--scene examples/scenes/pile.json]

The scenes are a settled pile of 1,000 hulls with the pairs near each other, and
pairs of boxes and of polytopes of 16 vertices in shallow overlap. Each contender
answers for every pair whether it touches within the margin, with normal and
points where it does, from numpy arrays of poses to Python: coal by `collide` and
`computeContactPatch` (the whole patch, one depth), python-fcl by `collide` (one
point), hullcast by `query` (the whole patch, each point's depth, certified) and
by a session's steps. Geometry and registration are not timed. hullcast's server
is another process on the same cores; "CPU" is what both use of them together.
A contender that is not installed is left out.
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

#: Generated pairs, some messages of them.
FAMILY_PAIRS = 16 * throughput.PAIRS_PER_MESSAGE


@dataclass
class Scene:
    """What a scene file says."""

    hulls: list[npt.NDArray[np.float64]]
    body_hulls: npt.NDArray[np.int64]
    positions: npt.NDArray[np.float64]
    rotations: npt.NDArray[np.float64]
    pairs: npt.NDArray[np.int64]
    margin: float

    def only(self, pair: int) -> Scene:
        """The two bodies of one pair."""
        bodies = self.pairs[pair]
        return Scene(
            self.hulls,
            self.body_hulls[bodies],
            self.positions[bodies],
            self.rotations[bodies],
            np.array([[0, 1]]),
            self.margin,
        )


#: Answers for all pairs at their poses: how many touch, with how many points.
Step = Callable[[], tuple[int, int]]


def load(path: Path) -> Scene:
    """A scene of the examples, in its first frame."""
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
    """Pairs of these hulls, turned at random, in shallow overlap."""
    pairs = np.arange(2 * FAMILY_PAIRS).reshape(-1, 2)
    made = throughput.shallow(client, client.register(hulls), pairs)
    kinds = made.body_hulls.astype(np.int64)
    return Scene(hulls, kinds, made.positions, made.rotations, pairs, 0.0)


def boxes() -> list[npt.NDArray[np.float64]]:
    """Of half sizes from 0.3 to 1."""
    return list(throughput.SIGNS * throughput.half_extents()[:, None, :])


def polytopes() -> list[npt.NDArray[np.float64]]:
    """8 points on a sphere and those opposite, scaled along its axes: centred as boxes are."""
    points = np.random.default_rng(3).normal(size=(throughput.SHAPES, 8, 3))
    points /= np.linalg.norm(points, axis=2, keepdims=True)
    return list(np.hstack([points, -points]) * throughput.half_extents()[:, None, :])


def bodies_of(client: hullcast.Client, scene: Scene) -> hullcast.Scene:
    """The scene as hullcast takes it."""
    hulls = client.register(scene.hulls)
    return hullcast.Scene(hulls, scene.positions, scene.rotations, body_hulls=scene.body_hulls)


def count(m: hullcast.Manifolds) -> tuple[int, int]:
    """Pairs with points, and points."""
    return int(np.count_nonzero(m.point_counts)), len(m.witness_b)


def by_query(client: hullcast.Client, scene: Scene) -> Step:
    """hullcast, a plain query a step."""
    bodies = bodies_of(client, scene)

    def step() -> tuple[int, int]:
        moved = bodies.moved(scene.positions, scene.rotations)
        return count(client.query(moved, scene.pairs, margin=scene.margin))

    return step


def by_session(client: hullcast.Client, scene: Scene) -> Step:
    """hullcast, a step loop."""
    session = client.session(bodies_of(client, scene), scene.pairs, margin=scene.margin)
    return lambda: count(session.step(scene.positions, scene.rotations))


def coal_shapes(coal: Any, hulls: Sequence[npt.NDArray[np.float64]]) -> list[Any]:
    """coal's hulls of the points."""
    shapes: list[Any] = []
    for vertices in hulls:
        points = coal.StdVec_Vec3s()
        for vertex in vertices:
            points.append(vertex)
        shapes.append(coal.Convex.convexHull(points, True, "Qt"))
    return shapes


def by_coal(scene: Scene) -> Step:
    """coal: collide, then the patch."""
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
    """python-fcl: one contact point a pair, and no margin."""
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
    """Of a call of each, the medians; in turns, so that a busy moment meets them all."""
    times: list[list[float]] = [[] for _ in steps]
    end = time.perf_counter() + seconds * len(steps)
    while time.perf_counter() < end or len(times[0]) < 3:
        for step, taken in zip(steps, times, strict=True):
            step()  # the caches are its own again
            start = time.perf_counter()
            step()
            taken.append(time.perf_counter() - start)
    return [float(np.median(taken)) for taken in times]


def cpu_seconds(step: Step, seconds: float) -> float:
    """Of a call, on all cores, in this process and those that it started."""
    processes = (psutil.Process(), *psutil.Process().children())

    def used() -> float:
        return sum(sum(process.cpu_times()[:2]) for process in processes)

    before, end, calls = used(), time.perf_counter() + seconds, 0
    while calls == 0 or time.perf_counter() < end:
        step()
        calls += 1
    return (used() - before) / calls


def compare(client: hullcast.Client, name: str, scene: Scene, seconds: float) -> None:
    """Prints what a step of the scene costs each contender, and one pair alone."""
    pairs = len(scene.pairs)
    print(f"{name}: {len(scene.positions):,} bodies, {pairs:,} pairs")
    form = "{:<18}{:>12}{:>12}{:>12}{:>16}{:>10}{:>10}"
    print(form.format("", "us, 1 pair", "us/step", "pairs/s", "pairs/CPU-s", "touching", "points"))
    m = client.query(bodies_of(client, scene), scene.pairs, margin=scene.margin)
    one = scene.only(int(np.argmax(m.point_counts)))
    makers: list[tuple[str, Callable[[Scene], Step]]] = [
        ("hullcast query", partial(by_query, client)),
        ("hullcast session", partial(by_session, client)),
        ("coal", by_coal),
        ("python-fcl", by_fcl),
    ]
    names: list[str] = []
    singles: list[Step] = []
    wholes: list[Step] = []
    for name, make in makers:
        try:
            wholes.append(make(scene))
        except ImportError as error:
            print(f"{name:<18}left out: {error}")
            continue
        singles.append(make(one))
        names.append(name)
    single, whole = median_seconds(singles, seconds / 3), median_seconds(wholes, seconds)
    for i, name in enumerate(names):
        cpu = cpu_seconds(wholes[i], seconds)
        row = (single[i] * 1e6, whole[i] * 1e6, pairs / whole[i], pairs / cpu, *wholes[i]())
        print(form.format(name, *(f"{x:,.0f}" for x in row)), flush=True)


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

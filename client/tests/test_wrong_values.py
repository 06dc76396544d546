"""Every public argument with the same forty wrong values: never an exception of another package.

`test_arguments.py` has the values that each argument must refuse, and what the message says. Here a
value may be right for some arguments, but a plain ValueError, TypeError or IndexError is right for
none.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from crowds import CUBE
from test_arguments import PARAMETERS, Opaque, idle  # noqa: F401

import hullcast

ONE = [[0, 0, 0, 1]]
BALL = hullcast.sphere(1)


class OwnFailure(Exception):
    """An exception of the caller's own object, which may pass through."""


class Hostile:
    """An object whose every use fails."""

    def _fail(self, *_: Any) -> Any:
        raise OwnFailure

    __array__ = __len__ = __iter__ = __bool__ = __eq__ = __getitem__ = __float__ = __index__ = _fail
    __hash__ = None  # type: ignore[assignment]


class Mesh:
    """A mesh with faces that are not indices."""

    vertices, faces = CUBE, [[0, 1, "a"]]


#: Makes the values, because an iterator can be read only once.
def values() -> list[Any]:
    return [
        None, True, 0, -1, 2, 1.5, float("nan"), float("inf"), 10**400, 1j, "", "x", "a\0b", "\ud800",
        b"x", bytearray(b"x"), memoryview(b"x"), [], [[]], [[[]]], (), [1, [2]], [[1, [2]]],
        [[[1, [2]]]], [None], [["a"]], ["x", 1], {}, {"a": 1}, {1: "a"}, {1, 2}, object(), Opaque(),
        Hostile(), [Hostile()], Mesh(), [Mesh()], np.zeros((3, 3)), np.zeros(0), np.zeros((0, 3)),
        np.zeros((2, 3, 4, 5)), np.array(["a"]), np.array([1, "a", None], dtype=object),
        np.array([[1, 2], [3, None]], dtype=object), np.datetime64("2020-01-01"),
        np.array("2020-01-01", dtype="M8[D]"), np.zeros(2, dtype=[("a", "f8")]), np.array(None),
        np.ma.masked_array([1, 2], [True, False]), np.ma.masked, np.timedelta64(1), lambda: 0,
        [np.ma.masked_array([1, 2, 3], [True, False, False])] * 2, hullcast, hullcast.Scene, iter([]),
        (x for x in [[1], [2, 3]]), range(3), slice(None), slice("a", "b"), Ellipsis, Exception("x"),
        2**64, -(2**63), np.uint64(2**64 - 1), np.float32("nan"), Path("/nonexistent/x"),
    ]  # fmt: skip


#: For each parameter of a result, a scene, a shape or a robot: a call with a value for it.
CALLS: dict[str, Callable[[Any, Any], Any]] = {
    "Manifolds[]": lambda m, v: m[v],
    "contacts_of.body": lambda m, v: m.contacts_of(v),
    "padded.k": lambda m, v: m.padded(v if not isinstance(v, int) or v < 99 else -1),
    "to_dataframe.rows": lambda m, v: m.to_dataframe(v),
    "plot.pairs": lambda m, v: v is None or m.plot(pairs=v),
    "plot.path": lambda m, v: v is None or m[:0].plot(path=v),
    "plot.ax": lambda m, v: v is None or m[:0].plot(ax=v),
    "log.path": lambda m, v: m.log(v),
    "log.pairs": lambda m, v: m.log(pairs=v),
    "log.hulls": lambda m, v: m.log(hulls=v),
    "log.recording": lambda m, v: m.log(recording=v),
    "Manifolds.save.path": lambda m, v: m.save(v),
    "Manifolds.load.path": lambda m, v: hullcast.Manifolds.load(v),
    "Manifolds.concat.manifolds": lambda m, v: hullcast.Manifolds.concat(v),
    "Manifolds.concat.manifolds[1]": lambda m, v: hullcast.Manifolds.concat([m, v]),
    "Manifolds.scene": lambda m, v: setattr(m[:], "scene", v),
    "match.before": lambda m, v: hullcast.match(v, m),
    "match.after": lambda m, v: hullcast.match(m, v),
    "match.previous": lambda m, v: v is None or hullcast.match(m, m, previous=v),
    "Scene.moved.positions": lambda m, v: m.scene.moved(v, m.scene.rotations),
    "Scene.moved.matrices": lambda m, v: m.scene.moved(v),
    "Scene.moved.rotations": lambda m, v: m.scene.moved(m.scene.positions, v),
    "Scene.save.path": lambda m, v: m.scene.save(v),
    "Scene.save.pairs": lambda m, v: m.scene.save("a.json", v),
    "Scene.save.margin": lambda m, v: m.scene.save("a.json", margin=v),
    "Scene.save.name": lambda m, v: m.scene.save("a.json", name=v),
    "Scene.load.path": lambda m, v: hullcast.Scene.load(v),
    "Scene.load.frame": lambda m, v: (m.scene.save("b.json"), hullcast.Scene.load("b.json", frame=v)),
    "Scene.plot.path": lambda m, v: v is None or m.scene.plot(path=v),
    "Scene.plot.ax": lambda m, v: v is None or m.scene.plot(ax=v),
    "box.size": lambda m, v: hullcast.box(v),
    "sphere.radius": lambda m, v: hullcast.sphere(v),
    "sphere.subdivisions": lambda m, v: hullcast.sphere(1, subdivisions=v),
    "cylinder.radius": lambda m, v: hullcast.cylinder(v, 1),
    "cylinder.height": lambda m, v: hullcast.cylinder(1, v),
    "capsule.radius": lambda m, v: hullcast.capsule(v, 1),
    "capsule.height": lambda m, v: hullcast.capsule(1, v),
    "cone.radius": lambda m, v: hullcast.cone(v, 1),
    "cone.height": lambda m, v: hullcast.cone(1, v),
    "prism.sides": lambda m, v: hullcast.prism(v, 1, 1),
    "prism.radius": lambda m, v: hullcast.prism(3, v, 1),
    "prism.height": lambda m, v: hullcast.prism(3, 1, v),
    "Shape.vertices": lambda m, v: hullcast.Shape(v, 0),
    "Shape.error": lambda m, v: hullcast.Shape(CUBE, v),
    "decompose.mesh": lambda m, v: hullcast.decompose(v),
    "decompose.threshold": lambda m, v: hullcast.decompose(None, threshold=v),
    "decompose.cache": lambda m, v: hullcast.decompose(None, cache=v),
    "decompose.progress": lambda m, v: hullcast.decompose(None, progress=v),
    "Robot.urdf": lambda m, v: hullcast.Robot(v),
    "Robot.packages": lambda m, v: hullcast.Robot("r.urdf", packages=v),
    "Robot.srdf": lambda m, v: hullcast.Robot("r.urdf", srdf=v),
    "Robot.ignored": lambda m, v: hullcast.Robot("r.urdf", ignored=v),
    "Robot.decompose": lambda m, v: hullcast.Robot("r.urdf", decompose=v),
    "Robot.threshold": lambda m, v: hullcast.Robot("r.urdf", threshold=v),
    "Robot.cache": lambda m, v: hullcast.Robot("r.urdf", cache=v),
    "Robot.progress": lambda m, v: hullcast.Robot("r.urdf", progress=v),
    "Robot.poses.joints": lambda m, v: hullcast.Robot("r.urdf").poses(v),
    "Robot.poses.base": lambda m, v: hullcast.Robot("r.urdf").poses(base=v),
    "Robot.scene.hulls": lambda m, v: hullcast.Robot("r.urdf").scene(v),
    "Robot.scene.joints": lambda m, v: hullcast.Robot("r.urdf").scene([b"\1" * 32] * 2, v),
}  # fmt: skip
ROBOT = """<robot name="r">
<link name="a"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
<link name="b"><collision><geometry><sphere radius="1"/></geometry></collision></link>
<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>"""


def sweep(call: Callable[[Any], Any]) -> list[str]:
    """Calls a function with every value; returns the values with exceptions of another package."""
    wrong: list[str] = []
    for value in values():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                call(value)
        except (hullcast.Error, ImportError, OwnFailure):
            pass
        except Exception as error:
            shown = type(value).__name__ if isinstance(value, (Opaque, Hostile)) else repr(value)
            wrong.append(f"{shown:.60}: {type(error).__name__}: {error!s:.150}")
    return wrong


@pytest.fixture
def m(client, tmp_path, monkeypatch) -> hullcast.Manifolds:
    """Three pairs, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    (tmp_path / "r.urdf").write_text(ROBOT)
    scene = hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), ONE)
    return client.query(scene, [[0, 0]] * 3)


@pytest.mark.parametrize("parameter", CALLS)
def test_no_exception_of_another_package(m, parameter):
    """Catches numpy's or Python's own exception, which names no argument."""
    assert sweep(lambda value: CALLS[parameter](m, value)) == []


#: Arguments of a server that would be started, and of settings that need no call.
NOT_SWEPT = ("serve.store", "serve.listen", "serve.timeout", "serve.start_timeout")


@pytest.mark.parametrize("parameter", [name for name in PARAMETERS if name not in NOT_SWEPT])
def test_no_exception_of_another_package_before_a_call(idle, parameter, monkeypatch, tmp_path):  # noqa: F811
    """Catches the same for the arguments of calls."""
    monkeypatch.chdir(tmp_path)
    call, _ = PARAMETERS[parameter]
    assert sweep(lambda value: call(value)(idle)) == []

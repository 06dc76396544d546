"""No assignment and no change in place makes an object answer for something else in silence."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from crowds import CUBE, NO_PROXY

import hullcast

RESTING = [[0, 0, 0, 1]] * 2


@pytest.fixture
def scene(client) -> hullcast.Scene:
    """Two cubes, of which one rests on the other."""
    return hullcast.Scene(
        client.register(CUBE),
        [[0, 0, 0], [0, 0, 0.99]],
        RESTING,
        body_hulls=[0, 0],
        worlds=[0, 0],
        groups=[1, 2],
        ignored_groups=[[3, 4]],
    )


@pytest.fixture
def robot(tmp_path) -> hullcast.Robot:
    """A robot with one body."""
    (tmp_path / "r.urdf").write_text(
        '<robot name="r"><link name="a"><collision><geometry><box size="1 1 1"/></geometry>'
        "</collision></link></robot>"
    )
    return hullcast.Robot(tmp_path / "r.urdf")


def test_attributes_of_every_public_object_are_settled(client, scene, robot):
    """Catches `scene.positions = integers`, whose bytes were read as doubles, and its siblings.

    Also catches a misspelt attribute, such as `scene.position`, that is accepted and ignored.
    """
    m = client.query(scene, [[0, 1]])
    hull = client.register(CUBE)[0]
    with client.session(scene, [[0, 1]]) as session:
        things = [scene, robot, m, m[0], hull, hull.content, hullcast.box(1), client, session,
                  hullcast.Accuracy.EXACT, client.info(), m.padded(2), client.hulls()[0]]  # fmt: skip
        assigned = 0
        for thing in things:
            names = [name for name in dir(thing) if not name.startswith("_")]
            for name in [*names, "misspelt"]:
                found = getattr(type(thing), name, None)
                if callable(found) or (isinstance(found, property) and found.fset):
                    continue
                with pytest.raises(AttributeError):
                    setattr(thing, name, np.zeros((2, 3), dtype=int))
                assigned += 1
        assert assigned > 80
    with pytest.raises(AttributeError, match=r"Scene\.positions is read-only: use scene\.moved"):
        scene.positions = np.zeros((2, 3), dtype=int)
    with pytest.raises(AttributeError, match="Scene has no attribute 'position'"):
        scene.position = 1
    with pytest.raises(AttributeError, match=r"Client\.timeout is read-only: give it to"):
        client.timeout = 5
    with pytest.raises(AttributeError, match=r"Scene\.worlds is read-only"):
        del scene.worlds


def copies(thing: Any) -> list[Any]:
    return [thing, pickle.loads(pickle.dumps(thing)), copy.copy(thing), copy.deepcopy(thing)]


def test_arrays_of_scenes_hulls_shapes_and_robots_are_read_only(client, scene, robot):
    """Catches a change in place that alters a scene behind its answers, also after pickling."""
    hull = client.register(CUBE)[0]
    changed = 0
    for thing in (scene, hull, hull.content, hullcast.sphere(1), robot):
        for one in copies(thing):
            for array in vars(one).values():
                if isinstance(array, np.ndarray) and array.size:
                    with pytest.raises(ValueError, match="read-only"):
                        array.reshape(-1)[0] = 1
                    changed += 1
    assert changed == 4 * 13


def test_what_a_caller_does_to_arrays_later_changes_nothing(client):
    """Catches a scene, a query or a session that keeps the caller's own array."""
    hulls = client.register(CUBE)
    positions, rotations = np.array([[0, 0, 0], [0, 0, 0.99]]), np.array(RESTING, dtype=float)
    whole = {name: np.array([0, 0], dtype="<u4") for name in ("body_hulls", "worlds", "groups")}
    ignored, vertices = np.array([[1, 2]], dtype="<u4"), CUBE.copy()
    scene = hullcast.Scene(hulls, positions, rotations, **whole, ignored_groups=ignored)
    shape = hullcast.Shape(vertices, 0)
    pairs = np.array([[0, 1]], dtype="<u4")
    with client.session(scene, pairs) as session:
        first = session.step(positions, rotations)
        before = first.pairs.copy()
        for array in (positions, rotations, ignored, vertices, pairs, *whole.values()):
            array[:] = 7
        first.pairs[:] = 0  # the result belongs to the caller, and the session keeps its own pairs
        for lane in session._lanes:
            lane.drop()  # the next step sends everything again
        again = session.step(scene.positions, scene.rotations)
    assert (again.pairs == before).all()
    assert again.separation == pytest.approx([-0.01])
    assert scene.positions[1].tolist() == [0, 0, 0.99]
    for name in whole:
        assert getattr(scene, name).tolist() == [0, 0]
    assert scene.ignored_groups.tolist() == [[1, 2]]
    assert (shape.vertices == CUBE).all()


def test_a_loaded_answer_takes_its_scene(client, scene, tmp_path):
    """Catches a scene of too few bodies, or another object, that is accepted as an answer's scene."""
    client.query(scene, [[0, 1]]).save(tmp_path / "m.npz")
    m = hullcast.Manifolds.load(tmp_path / "m.npz")
    for wrong in (1, "scene", [], hullcast.Scene(scene.hull_ids, np.zeros((1, 3)), [[0, 0, 0, 1]])):
        with pytest.raises(hullcast.InvalidArgument) as caught:
            m.scene = wrong
        assert caught.value.field == "scene"
    m.scene = scene
    assert m.scene is scene


def test_names_that_complete():
    """Catches a module whose completion lists imports, and a server that is used before it runs."""
    assert dir(hullcast.aio) == ["Client", "Session", "connect", "serve"]
    client = hullcast.aio.connect("localhost", options=NO_PROXY)
    assert {"register", "query", "find", "session", "info", "ping", "close"} <= set(dir(client))
    with pytest.raises(AttributeError, match=r"await hullcast\.aio\.serve"):
        _ = hullcast.aio.serve().query

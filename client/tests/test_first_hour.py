"""Slips of a first hour: each is named, and none gives an empty or a wrong answer in silence."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from crowds import CUBE, NO_PROXY, Server

import hullcast

RESTING = [[0, 0, 0, 1]] * 2
VISUAL = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
BOX = '<collision><geometry><box size="1 1 1"/></geometry></collision>'


def robot(folder: Path, *joints: str, body: str = BOX, **options: object) -> hullcast.Robot:
    """A robot with one link more than it has joints, each given by its type and inner elements."""
    links = "".join(f'<link name="l{i}">{body}</link>' for i in range(len(joints) + 1))
    text = "".join(
        f'<joint name="j{i}" type="{joint.partition(" ")[0]}">{joint.partition(" ")[2]}'
        f'<parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        for i, joint in enumerate(joints)
    )
    (folder / "robot.urdf").write_text(f'<robot name="r">{links}{text}</robot>')
    return hullcast.Robot(folder / "robot.urdf", **options)


TURNING = 'revolute <limit lower="-1" upper="2"/>'


def test_a_robot_without_bodies_warns(tmp_path, client):
    """Catches a file with visuals only, which gave a robot of 0 bodies and no contacts in silence."""
    with pytest.warns(hullcast.NoBodiesWarning, match="none of its 2 links has a <collision>") as w:
        empty = robot(tmp_path, TURNING, body=VISUAL)
    assert "2 links have only <visual> elements" in str(w.list[0].message)
    assert "copy each <visual> as a <collision>" in str(w.list[0].message)
    assert w.list[0].filename == __file__
    with pytest.warns(hullcast.NoBodiesWarning) as w:
        robot(tmp_path, body="")
    assert "visual" not in str(w.list[0].message)
    assert repr(empty) == "Robot(r: 0 bodies of 0 links, 1 joint)"
    scene = empty.scene(client.register(empty.shapes), [0.5])
    assert len(client.query(scene, empty.pairs)) == len(client.find(scene)) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(robot(tmp_path, body=BOX + VISUAL)) == 1


@pytest.mark.parametrize("wrong", ["no", "yes", 0, 1, 0.0, None, [], np.array([True])])
def test_decompose_is_true_or_false(tmp_path, wrong):
    """Catches `decompose="no"`, which is true."""
    with pytest.raises(hullcast.InvalidArgument, match="expected True or False") as caught:
        robot(tmp_path, decompose=wrong)
    assert caught.value.field == "decompose"
    assert len(robot(tmp_path, decompose=np.bool_(False))) == 1


def test_values_beyond_the_limits_warn(tmp_path):
    """Catches a joint in degrees, or of another order, whose poses the robot cannot take."""
    arm = robot(tmp_path, TURNING, "continuous")
    for values, text in (
        ([90, 0], "1 joint beyond the limits: joint 'j0' is 90, its limits are -1 to 2"),
        ({"j0": -1.5}, "joint 'j0' is -1.5, its limits are -1 to 2"),
        ([[0, 0], [3, 1], [5, 1]], "in 2 of 3 configurations: joint 'j0' is 3"),
    ):
        with pytest.warns(hullcast.JointLimitsWarning, match=text) as caught:
            arm.poses(values)
        assert caught.list[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        arm.poses([-1, 1e6])
        arm.poses([2 + 1e-9, 0])
        arm.poses([[2, 0], [-1, 0]])
    for wrong in ([np.nan, 0], [0, np.inf], {"j1": np.nan}, [[0, 0], [0, -np.inf]]):
        with pytest.raises(hullcast.InvalidArgument, match="expected a finite number") as caught:
            arm.poses(wrong)
        assert (caught.value.reason, caught.value.field) == ("NOT_FINITE", "joints")


def test_no_values_and_no_configurations(tmp_path, client):
    """Catches an IndexError for an empty list, and configurations that are lost."""
    arm = robot(tmp_path, TURNING)
    hulls = client.register(arm.shapes)
    for call in (arm.poses, lambda values: arm.scene(hulls, values)):
        for wrong in ([], [0, 0], [[0, 0]], np.zeros((1, 1, 1)), 0.5, [[]]):
            with pytest.raises(hullcast.InvalidArgument) as caught:
                call(wrong)
            assert caught.value.field == "joints"
            assert "(1,) or (k, 1)" in str(caught.value)
    assert arm.poses(np.zeros((0, 1))).shape == (0, 2, 4, 4)
    assert len(arm.scene(hulls, np.zeros((0, 1)))) == 0
    assert arm.poses(iter([0.5])).shape == (2, 4, 4)
    still = robot(tmp_path, "fixed ")
    assert still.poses([]).shape == (2, 4, 4)
    assert still.poses(np.zeros((3, 0))).shape == (3, 2, 4, 4)
    with pytest.raises(hullcast.InvalidArgument, match="the robot has no joint that moves"):
        still.poses({"j": 0})
    for wrong in (None, 5, "hulls", {}, [], hulls[:1]):
        with pytest.raises(hullcast.InvalidArgument) as caught:
            arm.scene(wrong)
        assert caught.value.field == "hulls"


@pytest.mark.parametrize(
    ("base", "reason"),
    [
        (np.full((4, 4), np.nan), "NOT_FINITE"),
        (np.ones((4, 4)), "NOT_A_POSE"),
        (np.diag([2.0, 1, 1, 1]), "NOT_A_ROTATION"),
        (np.diag([-1.0, 1, 1, 1]), "NOT_A_ROTATION"),
        ("up", "NOT_AN_ARRAY"),
        (np.eye(3), "WRONG_SHAPE"),
    ],
)
def test_a_base_is_a_pose(tmp_path, base, reason):
    """Catches a base that is no rigid motion, with which `poses` gave distorted poses."""
    with pytest.raises(hullcast.InvalidArgument) as caught:
        robot(tmp_path).poses(base=base)
    assert (caught.value.reason, caught.value.field) == (reason, "base")


def test_an_srdf_of_another_robot_is_refused(tmp_path):
    """Catches a file none of whose pairs exists, so that no pair is disabled in silence."""
    (tmp_path / "r.srdf").write_text(
        '<robot name="x"><disable_collisions link1="hand" link2="arm"/></robot>'
    )
    with pytest.raises(hullcast.InvalidArgument, match=r"the first is \('hand', 'arm'\)") as caught:
        robot(tmp_path, srdf=tmp_path / "r.srdf")
    assert caught.value.field == "srdf"


def test_the_ranges_of_joints_without_limits():
    """Catches the recipes of the page about robots: they gave NaN for continuous joints."""
    limits = np.array([[-1.0, 2.0], [-np.inf, np.inf]])
    page = Path(__file__).resolve().parents[2] / "docs/python/robots.md"
    (line,) = [line for line in page.read_text().splitlines() if line.startswith("ranges = ")]
    names = {"np": np, "robot": type("Robot", (), {"limits": limits})}
    ranges = eval(line.partition(" = ")[2], names)
    assert np.isfinite(ranges).all()
    assert (ranges[0] == limits[0]).all()
    np.random.default_rng(0).uniform(*ranges.T, (10, 2))


# Scenes and shapes.


def test_the_argument_at_fault_is_named(client):
    """Catches positions that are blamed although `body_hulls` is missing, and a shape of ()."""
    hulls = client.register(CUBE)
    for positions in (np.zeros((3, 3)), [[0, 0, 0]] * 3, (row for row in np.zeros((3, 3)))):
        with pytest.raises(hullcast.InvalidArgument, match=r"such as \[0, 0, 0\]") as caught:
            hullcast.Scene(hulls, positions, [[0, 0, 0, 1]] * 3)
        assert (caught.value.reason, caught.value.field) == ("MISSING_ARGUMENT", "body_hulls")
        assert "got 1 hull and 3 poses" in str(caught.value)
    with pytest.raises(hullcast.InvalidArgument, match="body_hulls"):
        hullcast.Scene(hulls, np.tile(np.eye(4), (3, 1, 1)))
    with pytest.raises(hullcast.InvalidArgument) as caught:
        hullcast.Scene(hulls * 2, np.zeros((3, 3)), RESTING)
    assert caught.value.field == "positions"
    for flat in (np.arange(24.0), np.arange(24.0).tolist(), tuple(range(24))):
        with pytest.raises(hullcast.InvalidArgument, match=r"got \(24,\)"):
            client.register(flat)
    with pytest.raises(hullcast.InvalidArgument, match=r"array\.reshape\(-1, 3\) gives 8 points"):
        client.register(np.arange(24.0))
    for wrong, shape in (
        (np.float64(3), "()"),
        (np.zeros(5), "(5,)"),
        (np.zeros((2, 2)), "(2, 2)"),
    ):
        with pytest.raises(hullcast.InvalidArgument) as caught:
            client.register(wrong)
        assert shape in str(caught.value) or "float64" in str(caught.value)


def test_a_scene_is_no_positions(client):
    """Catches numpy's view of a scene in the message."""
    scene = hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]])
    with client.session(scene, [[0, 0]]) as session:
        for call in (session.step, scene.moved):
            with pytest.raises(hullcast.InvalidArgument, match="got Scene: give its attributes"):
                call(scene)


def test_numbers_in_arrays_of_no_dimensions(client):
    """Catches `np.array(0.01)`, as a reduction or a file gives it, that is refused as no number."""
    one = np.array
    (hull,) = client.register(hullcast.box(one(1.0)), max_vertices=one(8), planarity=one(1e-3))
    scene = hullcast.Scene([hull] * 2, [[0, 0, 0], [0, 0, 0.99]], RESTING)
    accuracy = hullcast.Accuracy(max_points=one(4), relative_tolerance=one(0.0))
    m = client.query(scene, [[0, 1]], margin=one(0.01), accuracy=accuracy, timeout=one(5))
    assert m.in_contact.all()
    assert m[one(0)].index == 0
    assert len(m.contacts_of(one(1))) == 1
    assert m.padded(one(2)).mask.shape == (1, 2)
    for wrong in (one("1"), one(True), one([0.01]), one(1j), one(np.nan)):
        with pytest.raises(hullcast.InvalidArgument) as caught:
            client.query(scene, [[0, 1]], margin=wrong)
        assert caught.value.field == "margin"


def test_poses_of_scipy(client, tmp_path):
    """Catches a `RigidTransform`, or a list of rotations, that is refused as no array."""
    transform = pytest.importorskip("scipy.spatial.transform")
    if not hasattr(transform, "RigidTransform"):
        pytest.skip("scipy is older than 1.16")
    turns = transform.Rotation.from_rotvec([[0, 0, 0.3], [0.2, 0, 0]])
    at = np.array([[0, 0, 0], [0, 0, 0.9]])
    poses = transform.RigidTransform.from_components(at, turns)
    hulls = client.register(CUBE) * 2
    expected = hullcast.Scene(hulls, at, turns)
    for given in (
        (poses,),
        ([poses[0], poses[1]],),
        (at, [turns[0], turns[1]]),
        (poses.as_matrix(),),
    ):
        scene = hullcast.Scene(hulls, *given)
        assert scene.positions == pytest.approx(at)
        assert scene.rotations == pytest.approx(expected.rotations)
        assert scene.moved(*given).rotations == pytest.approx(expected.rotations)
    assert hullcast.Scene(hulls[:1], poses[1]).positions == pytest.approx(at[1:])
    arm = robot(tmp_path)
    assert arm.poses(base=poses[1])[0] == pytest.approx(poses[1].as_matrix())
    assert arm.poses(base=poses).shape == (2, 1, 4, 4)
    with client.session(expected, [[0, 1]]) as session:
        assert session.step(poses).alpha == pytest.approx(client.query(expected, [[0, 1]]).alpha)


def test_texts_are_short_and_count_right(client):
    """Catches "1 pairs", and a text with every vertex of a shape."""
    ball = hullcast.sphere(1, subdivisions=4)
    assert repr(ball) == f"Shape(2562 vertices, error {ball.error:.3g})"
    scene = hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]])
    m = client.query(scene, [[0, 0]])
    with client.session(scene, [[0, 0]]) as session:
        assert repr(session).startswith("Session(1 pair, ")
    assert repr(m.padded(3)).startswith("Padded(1 pair of 3 slots; ")
    with pytest.raises(hullcast.HullRejected, match="1 of 1 hull refused"):
        client.register(CUBE, contraction_points=[[2, 2, 2]])


def test_indices_of_pairs(client):
    """Catches Python's "range object index out of range", and a mask or a list of a wrong kind."""
    scene = hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]])
    m = client.query(scene, [[0, 0]] * 3)
    for wrong, text in (
        (5, "index: 5 is out of range: there are 3 pairs, so that -3 to 2 is allowed"),
        (-4, "index: -4 is out of range"),
        ([0, 7], "index[1]: 7 is out of range"),
        ([True, False], "got a mask of 2 entries, expected one entry for each of the 3 pairs"),
        ("a", "got 'a', expected an integer, a slice"),
        (1.5, "got 1.5, expected an integer"),
        ([1.5], "expected an integer"),
        (None, "got None"),
        ([[0]], "got shape (1, 1)"),
    ):
        with pytest.raises(IndexError) as caught:
            m[wrong]
        assert isinstance(caught.value, hullcast.PairOutOfRange)
        assert text in str(caught.value)
    assert m[-1].index == 2
    assert [len(m[part]) for part in ([], [0, -1], slice(1, None), m.in_contact, range(2))] == [
        0, 2, 2, 3, 2,
    ]  # fmt: skip
    assert len(list(m)) == 3


# Servers.


@pytest.mark.parametrize("target", ["50051", "http://50051", ["localhost", "50051"], "1"])
def test_a_port_is_no_host(target):
    """Catches a port without a host, which is dialled as the host 0.0.195.131."""
    with pytest.raises(
        hullcast.InvalidArgument, match="is a port without a host: expected localhost"
    ):
        hullcast.connect(target)


def test_a_list_of_servers_that_are_not_there():
    """Catches gRPC's own text, after 12 seconds, for a list of servers none of which is there."""
    with (
        hullcast.connect(["127.0.0.1:1", "127.0.0.1:2"], options=NO_PROXY) as client,
        pytest.raises(hullcast.Unavailable) as caught,
    ):
        client.info()
    assert "no hullcast server at 127.0.0.1:1 (connection refused)" in str(caught.value)
    assert "127.0.0.1:2" in str(caught.value)


def test_one_server_of_a_list_is_enough(client):
    """Catches a list of servers that is given up although one of them is there."""
    with hullcast.connect(["127.0.0.1:1", client.target], options=NO_PROXY) as other:
        assert other.ping() > 0


def test_find_counts_the_bodies_of_missing_hulls(client):
    """Catches "0 of 0 pairs are INVALID", which says nothing about the bodies that are left out."""
    (hull,) = client.register(CUBE)
    scene = hullcast.Scene([b"\1" * 32, hull.id, hull.id], np.zeros((3, 3)), [[0, 0, 0, 1]] * 3)
    with pytest.warns(hullcast.MissingHullsWarning, match="1 of 3 bodies is in no pair"):
        assert len(client.find(scene)) == 1
    with pytest.warns(hullcast.MissingHullsWarning, match="2 of 3 pairs are INVALID"):
        client.query(scene, [[0, 1], [1, 2], [0, 2]])


def test_many_hulls_are_deleted_within_the_servers_limit():
    """Catches TOO_MANY_HULLS from `delete`, where `register` and `query` split their messages."""
    points = np.random.default_rng(3).normal(size=(50, 6, 3))
    with (
        Server("memory://", "--max-hulls-per-request", "7") as server,
        hullcast.connect(server.address, options=NO_PROXY) as client,
    ):
        assert client.info().limits["max_hulls_per_request"] == 7
        made = client.register(list(points))
        given = [*made[:25], b"\7" * 32, *made[25:]]
        assert client.delete(iter(given)) == [True] * 25 + [False] + [True] * 25
        assert client.hulls() == []


# Pictures and progress.


def test_the_colour_bar_leaves_the_axis_free(client):
    """Catches a colour bar that covers the label of the z axis."""
    pytest.importorskip("matplotlib")
    pytest.importorskip("scipy")
    hulls = client.register([CUBE * [1, 1, 0.2], CUBE * 0.3])
    scene = hullcast.Scene(hulls, [[0, 0, 0], [0, 0, 0.249]], RESTING)
    figure = client.query(scene, [[0, 1]], margin=0.01).plot()
    figure.canvas.draw()
    axes, bar = figure.axes
    label = axes.zaxis.label.get_window_extent()
    ticks = [t.get_window_extent() for t in axes.get_zticklabels() if t.get_text()]
    covered = bar.get_tightbbox()
    assert not any(covered.overlaps(box) for box in (label, *ticks))


NOTEBOOK = """
import sys, types
# IPython's kernel has a standard error that is no terminal; here it is a pipe.
module = types.ModuleType("IPython")
module.get_ipython = lambda: {shell}
sys.modules["IPython"] = module
import hullcast, numpy as np
box = hullcast.box(1)
faces = [[0,1,3],[0,3,2],[4,6,7],[4,7,5],[0,4,5],[0,5,1],[2,3,7],[2,7,6],[0,2,6],[0,6,4],[1,5,7],[1,7,3]]
class Mesh: vertices, faces, label = box.vertices, np.array(faces), "the box"
hullcast.decompose(Mesh)
"""


@pytest.mark.parametrize("shell", ["object()", "None"])
def test_progress_is_shown_in_a_notebook(shell):
    """Catches minutes of silence in a notebook, whose standard error is no terminal."""
    done = subprocess.run(
        [sys.executable, "-c", NOTEBOOK.format(shell=shell)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, "PYTHONPATH": str(Path(hullcast.__file__).parents[1])},
    )
    assert done.returncode == 0, done.stderr
    shown = "convex pieces of the box, 1 of 1: computed" in done.stderr
    assert shown == (shell != "None"), done.stderr

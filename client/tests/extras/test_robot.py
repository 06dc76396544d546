"""Tests a small robot against closed forms, and real ones against yourdfpy's kinematics."""

from __future__ import annotations

import itertools
import sysconfig
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import hullcast
from hullcast import Outcome

yourdfpy = pytest.importorskip("yourdfpy")
trimesh = pytest.importorskip("trimesh")

DATA = Path(sysconfig.get_path("purelib")) / "cmeel.prefix/share/example-robot-data/robots"
PANDA = DATA / "panda_description/urdf/panda.urdf"
UR5 = DATA / "ur_description/urdf/ur5_robot.urdf"
real = pytest.mark.skipif(not PANDA.exists(), reason="example-robot-data is not installed")

BOX = '<collision><origin xyz="{0}"/><geometry><box size="{1}"/></geometry></collision>'
SMALL = f"""
<robot name="small">
  <link name="base">{BOX.format("0 0 0", "1 1 0.2")}</link>
  <link name="plate">{BOX.format("0 0 0.15", "0.4 0.4 0.1")}</link>
  <link name="hinge"/>
  <link name="arm">{BOX.format("0.5 0 0", "1 0.2 0.2")}
    <collision><geometry><cylinder radius="0.1" length="0.5"/></geometry></collision></link>
  <link name="slider">{BOX.format("0 0 0", "0.1 0.1 0.1")}</link>
  <link name="left">
    <collision><geometry><mesh filename="package://small/ell.obj" scale="2 2 2"/></geometry>
    </collision></link>
  <link name="right"><collision><geometry><sphere radius="0.3"/></geometry></collision></link>
  <joint name="bolt" type="fixed"><parent link="base"/><child link="plate"/></joint>
  <joint name="turn" type="continuous"><parent link="plate"/><child link="hinge"/>
    <origin xyz="0 0 1"/><axis xyz="0 0 2"/></joint>
  <joint name="lift" type="revolute"><parent link="hinge"/><child link="arm"/>
    <origin rpy="0 0 0.5"/><axis xyz="0 1 0"/><limit lower="0.1" upper="2"/></joint>
  <joint name="slide" type="prismatic"><parent link="arm"/><child link="slider"/>
    <origin xyz="1 0 0"/><axis xyz="1 0 0"/><limit lower="-1" upper="1"/></joint>
  <joint name="follow" type="prismatic"><parent link="base"/><child link="left"/>
    <origin xyz="5 0 0"/><axis xyz="0 1 0"/><mimic joint="slide" multiplier="-2" offset="0.5"/>
    <limit lower="-9" upper="9"/></joint>
  <joint name="weld" type="fixed"><parent link="base"/><child link="right"/>
    <origin xyz="-5 0 0"/></joint>
</robot>
"""


def ell() -> trimesh.Trimesh:
    """An L of three unit cubes: its volume is 3, its hull's 3.5, and it has two convex pieces."""
    parts = [
        trimesh.creation.box((2, 1, 1), trimesh.transformations.translation_matrix((0.5, 0, 0))),
        trimesh.creation.box((1, 1, 1), trimesh.transformations.translation_matrix((0, 1, 0))),
    ]
    return trimesh.boolean.union(parts, engine="manifold")


@pytest.fixture
def small(tmp_path) -> Path:
    """The URDF file, with its mesh in the package that it names."""
    (tmp_path / "small/urdf").mkdir(parents=True)
    ell().export(tmp_path / "small/ell.obj")
    path = tmp_path / "small/urdf/small.urdf"
    path.write_text(SMALL)
    return path


def names(robot: hullcast.Robot, pairs: np.ndarray) -> set[tuple[str, str]]:
    """The pairs as link names, each pair sorted."""
    return {tuple(sorted(robot.links[robot.body_links[i]] for i in pair)) for pair in pairs}


def test_what_a_small_robot_is(small):
    """Joints, limits, bodies of each link and pairs that may meet are as in the file."""
    robot = hullcast.Robot(small, decompose=False)
    assert (robot.name, robot.joints) == ("small", ("turn", "lift", "slide"))
    assert robot.limits.tolist() == [[-np.inf, np.inf], [0.1, 2], [-1, 1]]
    of = [robot.links[i] for i in robot.body_links]
    assert of == ["base", "plate", "arm", "arm", "slider", "left", "right"]
    # base, plate and right are one rigid part; arm follows plate, because the hinge has no body.
    assert names(robot, robot.pairs) == {
        ("base", "slider"),
        ("plate", "slider"),
        ("right", "slider"),
        ("arm", "left"),
        ("left", "slider"),
    }
    assert repr(robot) == "Robot(small: 7 bodies of 6 links, 3 joints)"
    # The groups for `find` describe the same pairs.
    ignored = {tuple(pair) for pair in robot.ignored_groups.tolist()}
    for i, j in itertools.combinations(range(len(robot)), 2):
        a, b = robot.groups[[i, j]].tolist()
        assert (a != b and (a, b) not in ignored) == ([i, j] in robot.pairs.tolist())


def test_ignored_by_name(small, tmp_path):
    """Links are ignored by argument and SRDF. An unknown link is refused, except in the SRDF."""
    (tmp_path / "small.srdf").write_text(
        '<robot name="small"><disable_collisions link1="slider" link2="left" reason="Never"/>'
        '<disable_collisions link1="gripper" link2="left"/></robot>'
    )
    robot = hullcast.Robot(
        small, decompose=False, srdf=tmp_path / "small.srdf", ignored=[("arm", "left")]
    )
    assert names(robot, robot.pairs) == {
        ("base", "slider"),
        ("plate", "slider"),
        ("right", "slider"),
    }
    with pytest.raises(hullcast.InvalidArgument, match="UNKNOWN_LINK"):
        hullcast.Robot(small, decompose=False, ignored=[("arm", "lefty")])


def test_where_joints_put_a_small_robot(small):
    """Poses agree with closed forms: several configurations, names, a base, a mimic joint."""
    robot = hullcast.Robot(small, decompose=False)
    poses = robot.poses({"turn": 0.3, "lift": 0.7, "slide": -0.2})
    expected = Rotation.from_rotvec([0, 0, 0.8]) * Rotation.from_rotvec([0, 0.7, 0])
    assert poses[2, :3, :3] == pytest.approx(expected.as_matrix(), abs=1e-15)
    assert poses[4, :3, 3] == pytest.approx(expected.apply([0.8, 0, 0]) + np.array([0, 0, 1]))
    assert poses[5, :3, 3] == pytest.approx([5, 0.9, 0])
    several = robot.poses([[0.3, 0.7, -0.2], [0, 0.1, 0]])
    assert several.shape == (2, 7, 4, 4)
    assert (several[0] == poses).all()
    assert (several[1] == robot.poses()).all()  # 0 is below the second joint's limit
    assert (robot.poses({"turn": [0.3, 0.4], "lift": 0.7, "slide": -0.2})[0] == poses).all()
    base = np.eye(4)
    base[:3, 3] = [1, 2, 3]
    moved = robot.poses([0.3, 0.7, -0.2], base=base)
    assert moved == pytest.approx(base @ poses)
    assert robot.poses(base=[base, np.eye(4)]).shape == (2, 7, 4, 4)


@pytest.mark.parametrize(
    ("joints", "options", "reason", "field"),
    [
        ([1, 2], {}, "WRONG_SHAPE", "joints"),
        ({"elbow": 1.0}, {}, "UNKNOWN_JOINT", "joints"),
        ({"turn": [1, 2], "lift": [1, 2, 3]}, {}, "WRONG_SHAPE", "joints"),
        (np.zeros((3, 3)), {"base": np.tile(np.eye(4), (2, 1, 1))}, "LENGTH_MISMATCH", "base"),
        (None, {"base": np.eye(3)}, "WRONG_SHAPE", "base"),
    ],
)
def test_joint_values_that_do_not_fit(small, joints, options, reason, field):
    """Joint values or a base of wrong shape or name are refused with their argument."""
    robot = hullcast.Robot(small, decompose=False)
    with pytest.raises(hullcast.InvalidArgument) as caught:
        robot.poses(joints, **options)
    assert (caught.value.reason, caught.value.field) == (reason, field)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('type="continuous"', 'type="floating"', "UNSUPPORTED_JOINT"),
        ('<child link="hinge"/>', '<child link="nothing"/>', "NOT_A_ROBOT"),
        ('<child link="plate"/>', '<child link="hinge"/>', "NOT_A_ROBOT"),
        ('<mimic joint="slide"', '<mimic joint="bolt"', "NOT_A_ROBOT"),
        ('<parent link="plate"/>', '<parent link="slider"/>', "NOT_A_ROBOT"),
        ('axis xyz="0 1 0"/><limit', 'axis xyz="0 0 0"/><limit', "NOT_A_ROBOT"),
    ],
)
def test_files_that_are_no_robots(small, old, new, reason):
    """Loops, two roots, and unknown links or joints are refused rather than followed."""
    assert SMALL.count(old) == 1
    small.write_text(SMALL.replace(old, new))
    with pytest.raises(hullcast.InvalidArgument) as caught:
        hullcast.Robot(small)
    assert (caught.value.reason, caught.value.field) == (reason, "urdf")


def test_where_meshes_are_looked_for(small, tmp_path, monkeypatch):
    """Meshes are looked up near the file, in `packages` and in ROS_PACKAGE_PATH.

    If a mesh is not found, the error has its name.
    """
    (tmp_path / "elsewhere/small").mkdir(parents=True)
    (tmp_path / "small/ell.obj").rename(tmp_path / "elsewhere/small/ell.obj")
    with pytest.raises(FileNotFoundError, match=r"package://small/ell\.obj"):
        hullcast.Robot(small, decompose=False)
    assert len(hullcast.Robot(small, decompose=False, packages=tmp_path / "elsewhere")) == 7
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "elsewhere"))
    assert len(hullcast.Robot(small, decompose=False)) == 7
    with pytest.raises(FileNotFoundError, match=r"none\.urdf"):
        hullcast.Robot(tmp_path / "none.urdf")


def test_a_link_that_is_not_convex(client, small, tmp_path, monkeypatch):
    """The pieces of a link are bodies of one group, and are cached.

    Without pieces there is a warning.
    """
    coacd = pytest.importorskip("coacd")
    robot = hullcast.Robot(small, cache=tmp_path / "kept")
    assert [robot.links[i] for i in robot.body_links].count("left") == 2
    volumes = sorted(ConvexHull(s).volume for s in robot.shapes[5:7])
    assert volumes == pytest.approx([8, 16], rel=0.1)
    assert robot.groups[5] == robot.groups[6]
    assert [5, 6] not in robot.pairs.tolist()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hulls = client.register(robot.shapes)
    # A cube in the dent of the L, which the L's hull would touch.
    cube = np.array(list(itertools.product((1.3, 2.1), (1.3, 2.1), (-0.4, 0.4))))
    scene = hullcast.Scene(
        [*client.register([cube]), *hulls[5:7]], np.zeros((3, 3)), [[0, 0, 0, 1]] * 3
    )
    assert (client.query(scene, [[0, 1], [0, 2]]).outcome == Outcome.SEPARATED).all()
    monkeypatch.setattr(coacd, "run_coacd", None)
    again = hullcast.Robot(small, cache=tmp_path / "kept")
    for ours, theirs in zip(robot.shapes, again.shapes, strict=True):
        assert np.array_equal(getattr(ours, "vertices", ours), getattr(theirs, "vertices", theirs))
    with pytest.warns(
        hullcast.NotConvexWarning,
        match=r"link 'left', collision 0 \(ell\.obj\) is not convex.*0\.857",
    ):
        client.register(hullcast.Robot(small, decompose=False).shapes)


@real
@pytest.mark.parametrize("urdf", [PANDA, UR5], ids=["panda", "ur5"])
def test_real_robots_are_where_yourdfpy_puts_them(urdf):
    """All links' frames agree at random configurations, inside and outside the joints' limits."""
    other = yourdfpy.URDF.load(str(urdf), load_meshes=False)
    robot = hullcast.Robot(urdf, decompose=False)
    assert list(robot.joints) == other.actuated_joint_names
    values = np.random.default_rng(101).uniform(-3, 3, (20, len(robot.joints)))
    for row, poses in zip(values, robot.poses(values), strict=True):
        other.update_cfg(row)
        for body, link in enumerate(robot.body_links):
            assert poses[body] == pytest.approx(other.get_transform(robot.links[link]), abs=1e-14)


@real
def test_found_among_its_pairs(client, small):
    """`find` on a robot's scene considers only bodies that may meet, and keeps copies apart."""
    robot = hullcast.Robot(small, decompose=False)
    with pytest.warns(hullcast.NotConvexWarning):
        hulls = client.register(robot.shapes)
    values = np.random.default_rng(81).uniform(-1, 1, (40, 3))
    scene = robot.scene(hulls, values)
    pairs = np.concatenate([robot.pairs + i * len(robot) for i in range(40)])
    asked = client.query(scene, pairs, margin=3.5)
    near = np.sort(asked.pairs[asked.outcome != Outcome.SEPARATED], axis=1)
    found = client.find(scene, margin=3.5)
    assert found.pairs.tolist() == sorted(near.tolist())
    assert 10 < len(found) < len(pairs)


def test_five_lines_to_a_pandas_contacts(client):
    """The Panda: its fingers touch at 0, and copies in separate worlds give the same numbers."""
    robot = hullcast.Robot(PANDA)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hulls = client.register(robot.shapes)
    assert len(robot) == 17
    scene = robot.scene(hulls, {"panda_joint4": -2.0, "panda_joint6": 1.8})
    m = client.query(scene, robot.pairs, margin=0.005)
    touching = names(robot, m.pairs[m.outcome == Outcome.CONTACT])
    assert touching == {("panda_leftfinger", "panda_rightfinger")}
    values = np.tile(robot.limits.mean(axis=1), (3, 1))
    values[:, robot.joints.index("panda_finger_joint1")] = [0, 0.001, 0.04]
    copies = robot.scene(hulls, values)
    assert (len(copies), len(np.unique(copies.worlds))) == (51, 3)
    for i in range(3):
        alone = client.query(robot.scene(hulls, values[i]), robot.pairs, margin=0.005)
        among = client.query(copies, robot.pairs + i * len(robot), margin=0.005)
        assert alone.separation.tobytes() == among.separation.tobytes()
    # The gap between the fingers is twice the joint's value.
    fingers = [i for i, pair in enumerate(robot.pairs) if names(robot, [pair]) == touching.copy()]
    gaps = [
        client.query(
            copies, (robot.pairs + i * len(robot))[fingers], margin=np.inf
        ).separation.min()
        for i in range(3)
    ]
    assert np.diff(gaps) == pytest.approx([0.002, 0.078])


@real
def test_a_ur5_in_pieces(client):
    """The pieces of each UR5 link together cover the link, to within the threshold."""
    pytest.importorskip("coacd")
    robot = hullcast.Robot(UR5, threshold=0.1)
    whole = hullcast.Robot(UR5, decompose=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hulls = client.register(robot.shapes)
    assert len(robot) > len(whole) + 6
    rng = np.random.default_rng(102)
    for link in range(7):
        mesh = whole.shapes[link]
        assert robot.links[whole.body_links[link]] != "ee_link"
        pieces = [
            robot.shapes[i] for i in np.flatnonzero(robot.body_links == whole.body_links[link])
        ]
        assert len(pieces) > 1
        surface = trimesh.Trimesh(mesh.vertices, mesh.faces)
        size = np.ptp(mesh.vertices, axis=0).max()
        points, _ = trimesh.sample.sample_surface(surface, 500, seed=rng)
        outside = np.min([_depth(ConvexHull(piece), points) for piece in pieces], axis=0)
        assert outside.max() < 0.03 * size
    scene = robot.scene(hulls, {"shoulder_lift_joint": -1.2, "elbow_joint": 1.5})
    m = client.query(scene, robot.pairs, margin=0.001)
    assert len(m) > 400
    assert (m.outcome == Outcome.SEPARATED).all()
    # If the arm is folded upon itself, the wrist is inside the upper arm.
    folded = client.query(robot.scene(hulls, {"elbow_joint": 3.1}), robot.pairs)
    assert (folded.outcome == Outcome.CONTACT).any()


def _depth(hull: ConvexHull, points: np.ndarray) -> np.ndarray:
    """How far each point is outside a hull, by its worst plane; negative inside."""
    return (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)

"""URDF files: the parts that are read, and the message for each fault."""

from __future__ import annotations

import itertools
import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest
from solids import BARS, box, stl

import hullcast

BOX = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
LINKS = "".join(f'<link name="{name}">{BOX}</link>' for name in "abcd")


def with_collision(inside: str) -> str:
    """A robot with one link, which has this content in its second collision element."""
    return f'<robot name="r"><link name="arm">{BOX}<collision>{inside}</collision></link></robot>'


def with_joint(inside: str, attributes: str = 'name="j" type="revolute"') -> str:
    """A robot with two links and one joint, which has this content."""
    return (
        f'<robot name="r"><link name="a">{BOX}</link><link name="b">{BOX}</link>'
        f'<joint {attributes}>{inside}<parent link="a"/><child link="b"/></joint></robot>'
    )


FAULTS = {
    "an empty file": ("", ["empty"]),
    "text": ("hello", ["not XML"]),
    "a cut file": ('<robot name="r"><link', ["not XML"]),
    "a part of MJCF": ("<mujocoinclude/>", ["an MJCF file"]),
    "SDF": ('<sdf version="1.7"><model name="m"/></sdf>', ["an SDF file"]),
    "COLLADA": ("<COLLADA/>", ["a COLLADA file"]),
    "other XML": ("<html/>", ["<html>"]),
    "no name": (f'<robot xmlns:xacro="x">{LINKS}</robot>', ["<robot>", "'name'"]),
    "no links": ('<robot name="r"/>', ["no links"]),
    "xacro": (
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>',
        ["<xacro:arm>"],
    ),
    "an expression": (
        with_collision('<geometry><box size="${w} 1 1"/></geometry>'),
        ["link 'arm', collision 1", "<box size='${w} 1 1'>", "xacro"],
    ),
    "an expression in an origin": (
        with_collision('<origin xyz="0 0 ${h/2}"/><geometry><box size="1 1 1"/></geometry>'),
        ["link 'arm', collision 1", "<origin xyz='0 0 ${h/2}'>", "xacro"],
    ),
    "a link without a name": (
        '<robot name="r"><link name="a"/><link/></robot>',
        ["link 1", "<link> has no 'name'"],
    ),
    "two links of one name": (
        '<robot name="r"><link name="a"/><link name="a"/></robot>',
        ["link 1", "'a'", "link 0"],
    ),
    "no geometry": (with_collision(""), ["link 'arm', collision 1", "no <geometry>"]),
    "an empty geometry": (
        with_collision("<geometry/>"),
        ["link 'arm', collision 1", "<geometry> has 0 shapes"],
    ),
    "two shapes": (
        with_collision('<geometry><sphere radius="1"/><sphere radius="1"/></geometry>'),
        ["link 'arm', collision 1", "2 shapes"],
    ),
    "a cone": (
        with_collision('<geometry><cone radius="1" length="1"/></geometry>'),
        ["link 'arm', collision 1", "<cone>", "<capsule>"],
    ),
    "a capsule without length": (
        with_collision('<geometry><capsule radius="1"/></geometry>'),
        ["link 'arm', collision 1", "<capsule> has no 'length'"],
    ),
    "a cylinder without length": (
        with_collision('<geometry><cylinder radius="1"/></geometry>'),
        ["link 'arm', collision 1", "<cylinder> has no 'length'"],
    ),
    "a box of two numbers": (
        with_collision('<geometry><box size="1 1"/></geometry>'),
        ["<box size='1 1'>", "3 finite numbers"],
    ),
    "a sphere without size": (
        with_collision('<geometry><sphere radius="0"/></geometry>'),
        ["<sphere radius='0'>", "positive"],
    ),
    "a sphere of words": (
        with_collision('<geometry><sphere radius="1 m"/></geometry>'),
        ["<sphere radius='1 m'>", "a finite number"],
    ),
    "a box of nan": (
        with_collision('<geometry><box size="1 nan 1"/></geometry>'),
        ["<box size='1 nan 1'>"],
    ),
    "a mesh without file": (
        with_collision('<geometry><mesh scale="1 1 1"/></geometry>'),
        ["link 'arm', collision 1", "<mesh> has no 'filename'"],
    ),
    "a scale of two numbers": (
        with_collision('<geometry><mesh filename="cube.stl" scale="0.1 0.1"/></geometry>'),
        ["link 'arm', collision 1", "<mesh scale='0.1 0.1'>"],
    ),
    "a scale of zero": (
        with_collision('<geometry><mesh filename="cube.stl" scale="1 1 0"/></geometry>'),
        ["link 'arm', collision 1", "<mesh scale='1 1 0'>"],
    ),
    "a quaternion of three numbers": (
        with_collision('<origin quat_xyzw="0 0 1"/><geometry><box size="1 1 1"/></geometry>'),
        ["link 'arm', collision 1", "<origin quat_xyzw='0 0 1'>", "4 finite numbers"],
    ),
    "a quaternion of zero": (
        with_collision('<origin quat_xyzw="0 0 0 0"/><geometry><box size="1 1 1"/></geometry>'),
        ["link 'arm', collision 1", "norm 0", "expected 0.25 to 4"],
    ),
    "two rotations": (
        with_collision(
            '<origin rpy="0 0 1" quat_xyzw="0 0 0 1"/><geometry><box size="1 1 1"/></geometry>'
        ),
        ["link 'arm', collision 1", "rpy and quat_xyzw"],
    ),
    "an unknown attribute of an origin": (
        with_collision('<origin quat_wxyz="1 0 0 0"/><geometry><box size="1 1 1"/></geometry>'),
        ["link 'arm', collision 1", "'quat_wxyz'", "expected xyz, rpy, quat_xyzw"],
    ),
    "two origins": (
        with_collision("<origin/><origin/><geometry><box size='1 1 1'/></geometry>"),
        ["link 'arm', collision 1", "2 <origin> elements"],
    ),
    "two geometries": (
        with_collision("<geometry><box size='1 1 1'/></geometry>" * 2),
        ["link 'arm', collision 1", "2 <geometry> elements"],
    ),
    "two axes": (
        with_joint('<axis xyz="0 0 1"/><axis xyz="0 1 0"/>'),
        ["joint 'j'", "2 <axis> elements"],
    ),
    "an origin of two numbers": (
        with_collision('<origin xyz="0 1"/><geometry><box size="1 1 1"/></geometry>'),
        ["link 'arm', collision 1", "<origin xyz='0 1'>"],
    ),
    "a named element": (
        '<robot name="r"><link name="arm"><collision name="hull"/></link></robot>',
        ["link 'arm', collision 0 'hull'", "no <geometry>"],
    ),
    "a joint without a name": (with_joint("", 'type="fixed"'), ["joint 0", "'name'"]),
    "a joint without a type": (with_joint("", 'name="j"'), ["joint 'j'", "'type'"]),
    "a joint of another type": (
        with_joint("", 'name="j" type="revolve"'),
        ["joint 'j'", "'revolve'", "revolute, continuous, prismatic, fixed"],
    ),
    "an axis of two numbers": (with_joint('<axis xyz="0 1"/>'), ["joint 'j'", "<axis xyz='0 1'>"]),
    "an axis of zero": (with_joint('<axis xyz="0 0 0"/>'), ["joint 'j'", "axis is zero"]),
    "a limit of words": (
        with_joint('<limit lower="low" upper="1"/>'),
        ["joint 'j'", "<limit lower='low'>"],
    ),
    "limits in reverse": (with_joint('<limit lower="1" upper="0"/>'), ["joint 'j'", "1 to 0"]),
    "an absent upper limit, which is 0": (
        with_joint('<limit lower="1"/>'),
        ["joint 'j'", "1 to 0", "'upper' is not given, and then it is 0"],
    ),
    "a misspelt collision": (
        f'<robot name="r"><link name="arm">{BOX.replace("collision", "colision")}</link></robot>',
        ["link 'arm'", "<colision>", "expected <collision>"],
    ),
    "a misspelt geometry": (
        with_collision('<geometri><box size="1 1 1"/></geometri>'),
        ["link 'arm', collision 1", "<geometri>", "expected <geometry>"],
    ),
    "a misspelt origin": (
        with_collision('<orgin xyz="0 0 1"/><geometry><box size="1 1 1"/></geometry>'),
        ["link 'arm', collision 1", "<orgin>", "expected <origin>"],
    ),
    "an upper case link": (
        f'<robot name="r">{LINKS}<Link name="z"/></robot>',
        ["<Link>", "<link>"],
    ),
    "a misspelt joint": (f'<robot name="r">{LINKS}<joints/></robot>', ["<joints>", "<joint>"]),
    "a misspelt limit": (with_joint('<limits lower="0" upper="1"/>'), ["joint 'j'", "<limits>"]),
    "a misspelt mimic": (with_joint('<mimick joint="k"/>'), ["joint 'j'", "<mimick>"]),
    "a joint without a parent": (
        '<robot name="r"><link name="a"/><joint name="j" type="fixed"><child link="a"/></joint>'
        "</robot>",
        ["joint 'j'", "no <parent>"],
    ),
    "a child that is no link": (
        '<robot name="r"><link name="a"/><joint name="j" type="fixed"><parent link="a"/>'
        '<child link="z"/></joint></robot>',
        ["joint 'j'", "'z'"],
    ),
    "two roots": (f'<robot name="r">{LINKS}</robot>', ["one tree", "'a', 'b', 'c', 'd'"]),
    "a mimic without joint": (with_joint('<mimic multiplier="2"/>'), ["joint 'j'", "'joint'"]),
    "a mimic of nothing": (with_joint('<mimic joint="k"/>'), ["joint 'j'", "'k'", "not a joint"]),
    "a mimic of itself": (with_joint('<mimic joint="j"/>'), ["j -> j"]),
    "a multiplier of words": (
        with_joint('<mimic joint="j" multiplier="x"/>'),
        ["joint 'j'", "<mimic multiplier='x'>"],
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named(tmp_path, name):
    """Catches KeyError, TypeError and the like: the error is ours, and names file and element."""
    text, named = FAULTS[name]
    (tmp_path / "robot.urdf").write_text(text)
    (tmp_path / "cube.stl").write_bytes(stl(box((0, 0, 0), (1, 1, 1))))
    with pytest.raises(hullcast.InvalidArgument) as caught:
        hullcast.Robot(tmp_path / "robot.urdf")
    assert (caught.value.reason, caught.value.field) == ("NOT_A_ROBOT", "urdf")
    for part in ["robot.urdf", *named]:
        assert part in caught.value.message


def mesh_robot(folder: Path, name: str, data: bytes | None, attributes: str = "") -> Path:
    """A robot whose only body is a mesh."""
    if data is not None:
        (folder / name).write_bytes(data)
    path = folder / "robot.urdf"
    path.write_text(
        f'<robot name="r"><link name="arm"><collision><geometry><mesh filename="{name}" {attributes}/>'
        "</geometry></collision></link></robot>"
    )
    return path


FLAT = "v -5 -5 0\nv 5 -5 0\nv -5 5 0\nv 5 5 0\nf 1 2 3\nf 2 4 3\n"


@pytest.mark.parametrize(
    ("name", "data", "reason", "named"),
    [
        ("quad.obj", FLAT.encode(), "COPLANAR", "quad.obj) is flat"),
        ("line.obj", FLAT.replace("5 0", "0 0").encode(), "COPLANAR", "line.obj) is flat"),
        ("cube.stl", stl(box((0, 0, 0), (1, 1, 1)))[:-9], "MALFORMED_MESH", "lost its last 9"),
        ("cube.step", b"ISO-10303-21;", "UNSUPPORTED_MESH", "OBJ, STL, DAE or PLY"),
        ("none.obj", b"v 0 0 0\n", "NO_TRIANGLES", "no triangles"),
        ("empty.stl", b"", "MALFORMED_MESH", "empty"),
        ("none.stl", None, "FILE_NOT_FOUND", "'none.stl' is not found"),
        ("http://a/b.stl", None, "FILE_NOT_FOUND", "package://"),
    ],
)
def test_a_fault_of_a_mesh_is_named(tmp_path, name, data, reason, named):
    """Catches errors of a mesh that do not say which link of which file has it."""
    path = mesh_robot(tmp_path, name, data)
    for decompose in (False, True):
        with pytest.raises(hullcast.InvalidArgument) as caught:
            hullcast.Robot(path, decompose=decompose)
        assert (caught.value.reason, caught.value.field) == (reason, "urdf")
        for part in ("robot.urdf", "link 'arm', collision 0", named):
            assert part in caught.value.message
        assert isinstance(caught.value, FileNotFoundError) == (reason == "FILE_NOT_FOUND")


def test_visuals_are_not_read(tmp_path):
    """Catches a robot that is refused because of visuals without files, names or valid numbers."""
    visual = '<visual><origin xyz="x"/><geometry><mesh filename="none.xyz"/></geometry></visual>'
    text = f'<robot name="r"><material/><link name="a">{visual}<visual/>{BOX}</link></robot>'
    (tmp_path / "robot.urdf").write_text(text)
    assert len(hullcast.Robot(tmp_path / "robot.urdf")) == 1


CUBE = stl(box((0, 0, 0), (1, 1, 1)))


@pytest.mark.parametrize(
    "uri",
    [
        "package://my_pkg/meshes/cube.stl",
        "package:///my_pkg/meshes/cube.stl",
        "Package://my_pkg/meshes/cube.stl",
        "model://my_pkg/meshes/cube.stl",
        "../my_pkg/meshes/cube.stl",
        "file://{0}/my_pkg/meshes/cube.stl",
        "{0}/my_pkg/meshes/cube.stl",
    ],
)
def test_where_meshes_are_looked_for(tmp_path, monkeypatch, uri):
    """Catches forms of a package's address that robots use and that are not found.

    The package is found through `packages` (one or several), its own folder, or either ROS
    variable.
    """
    (tmp_path / "my_pkg/meshes").mkdir(parents=True)
    (tmp_path / "my_pkg/meshes/cube.stl").write_bytes(CUBE)
    (tmp_path / "robots").mkdir()
    path = mesh_robot(tmp_path / "robots", uri.format(tmp_path), None)
    assert len(hullcast.Robot(path)) == 1  # a folder above the file contains the package
    if "pkg" not in uri.partition("://")[2] or "{0}" in uri:
        return
    other = tmp_path / "elsewhere/deep"
    other.mkdir(parents=True)
    (tmp_path / "my_pkg").rename(other / "my_pkg")
    with pytest.raises(hullcast.FileNotFound, match="the package 'my_pkg' as `packages`"):
        hullcast.Robot(path)
    for packages in (other, str(other), [tmp_path, other], (other / "my_pkg",)):
        assert len(hullcast.Robot(path, packages=packages)) == 1
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path}:{other}")
    assert len(hullcast.Robot(path)) == 1
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    other.rename(tmp_path / "elsewhere/share")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "elsewhere"))
    assert len(hullcast.Robot(path)) == 1


def test_names_with_escapes(tmp_path):
    """Catches a space written as %20 that is not decoded, and a literal %20 that is."""
    for name, uri in (("a b.stl", "package://my_pkg/a%20b.stl"), ("a%20b.stl", "a%20b.stl")):
        folder = tmp_path / "my_pkg"
        folder.mkdir(exist_ok=True)
        (folder / name).write_bytes(CUBE)
        assert len(hullcast.Robot(mesh_robot(folder, uri, None))) == 1
        (folder / name).unlink()


def chain(*joints: str) -> str:
    """A robot with links l0, l1, ... in which joint ji slides link l(i+1) along x from l0."""
    links = "".join(f'<link name="l{i}">{BOX}</link>' for i in range(len(joints) + 1))
    text = "".join(
        f'<joint name="j{i}" type="prismatic"><parent link="l0"/><child link="l{i + 1}"/>'
        f'<axis xyz="1 0 0"/><limit lower="-9" upper="9"/>{mimic}</joint>'
        for i, mimic in enumerate(joints)
    )
    return f'<robot name="r">{links}{text}</robot>'


@pytest.mark.parametrize(
    ("mimics", "free", "expected"),
    [
        (["", '<mimic joint="j0"/>'], ["j0"], [2, 2]),
        (["", '<mimic joint="j0" multiplier="-3"/>'], ["j0"], [2, -6]),
        (["", '<mimic joint="j0" offset="0.5"/>'], ["j0"], [2, 2.5]),
        (["", '<mimic joint="j0" multiplier="0" offset="1"/>'], ["j0"], [2, 1]),
        (['<mimic joint="j1" multiplier="2"/>', ""], ["j1"], [4, 2]),
        (
            [
                '<mimic joint="j1" multiplier="2" offset="1"/>',
                '<mimic joint="j2" multiplier="3" offset="10"/>',
                '<mimic joint="j3" offset="100"/>',
                "",
            ],
            ["j3"],
            [2 * (3 * 102 + 10) + 1, 3 * 102 + 10, 102, 2],
        ),
        (["", '<mimic joint="j0"/>', '<mimic joint="j1" multiplier="-1"/>'], ["j0"], [2, 2, -2]),
    ],
)
def test_joints_that_mimic_others(tmp_path, mimics, free, expected):
    """Catches chains that are refused, and an order of declaration that matters.

    Also catches factors or offsets that are not combined along a chain.
    """
    (tmp_path / "robot.urdf").write_text(chain(*mimics))
    robot = hullcast.Robot(tmp_path / "robot.urdf")
    assert robot.joints == tuple(free)
    assert robot.poses([2.0])[1:, 0, 3] == pytest.approx(expected)


def test_circles_of_mimics_are_named(tmp_path):
    """Catches a hang: joints that mimic each other in a cycle, or a joint in the cycle."""
    mimics = [f'<mimic joint="j{i}"/>' for i in (1, 2, 1)]
    (tmp_path / "robot.urdf").write_text(chain(*mimics))
    with pytest.raises(hullcast.InvalidArgument, match="j1 -> j2 -> j1"):
        hullcast.Robot(tmp_path / "robot.urdf")
    fixed = chain("", '<mimic joint="j0"/>').replace('"j0" type="prismatic"', '"j0" type="fixed"')
    (tmp_path / "robot.urdf").write_text(fixed)
    with pytest.raises(hullcast.InvalidArgument, match="'j1' mimics 'j0', which is fixed"):
        hullcast.Robot(tmp_path / "robot.urdf")


def test_shapes_and_their_origins(client, tmp_path):
    """Catches angles in a wrong order: rpy is roll, then pitch, then yaw about fixed axes.

    Sizes and volumes have closed forms.
    """
    origin = '<origin xyz="1 2 3" rpy="0.3 -0.4 0.5"/>'
    shapes = [
        '<box size="2 4 6"/>',
        '<cylinder radius="0.5" length="3"/>',
        '<sphere radius="2"/>',
        '<capsule radius="0.5" length="3"/>',
        '<mesh filename="cube.stl" scale="1 -2 3"/>',
    ]
    bodies = "".join(f"<collision>{origin}<geometry>{s}</geometry></collision>" for s in shapes)
    (tmp_path / "cube.stl").write_bytes(CUBE)
    (tmp_path / "robot.urdf").write_text(f'<robot name="r"><link name="a">{bodies}</link></robot>')
    robot = hullcast.Robot(tmp_path / "robot.urdf")
    c, s = np.cos([0.3, -0.4, 0.5]), np.sin([0.3, -0.4, 0.5])
    roll = np.array([[1, 0, 0], [0, c[0], -s[0]], [0, s[0], c[0]]])
    pitch = np.array([[c[1], 0, s[1]], [0, 1, 0], [-s[1], 0, c[1]]])
    yaw = np.array([[c[2], -s[2], 0], [s[2], c[2], 0], [0, 0, 1]])
    turn = yaw @ pitch @ roll
    own = [(np.asarray(getattr(x, "vertices", x)) - [1, 2, 3]) @ turn for x in robot.shapes]
    corners = np.array(list(itertools.product((-1, 1), (-2, 2), (-3, 3))))
    assert np.sort(own[0], axis=0) == pytest.approx(np.sort(corners, axis=0))
    assert np.hypot(*own[1][:, :2].T) == pytest.approx(np.full(64, 0.5))
    assert np.abs(own[1][:, 2]) == pytest.approx(np.full(64, 1.5))
    assert np.linalg.norm(own[2], axis=1) == pytest.approx(np.full(162, 2.0))
    # A capsule's length is that of its cylinder, so the whole capsule is longer by two radii.
    ends = own[3] - np.outer(np.clip(own[3][:, 2], -1.5, 1.5), [0, 0, 1])
    assert np.linalg.norm(ends, axis=1) == pytest.approx(np.full(len(ends), 0.5))
    assert np.ptp(own[3], axis=0) == pytest.approx([1, 1, 4])
    assert np.ptp(own[4], axis=0) == pytest.approx([1, 2, 3])
    assert own[4].min(axis=0) == pytest.approx([0, -2, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a mirrored mesh is still convex
        hulls = client.register(robot.shapes)
    area = 32 * 0.5 * 0.25 * np.sin(2 * np.pi / 32)
    volumes = [hull.volume for hull in hulls]
    assert volumes[:2] == pytest.approx([48, area * 3])
    assert volumes[4] == pytest.approx(6)
    assert 0.9 < volumes[3] / (np.pi * 0.25 * (3 + 4 / 3 * 0.5)) < 1
    assert 0.96 < volumes[2] / (4 / 3 * np.pi * 8) < 1


def test_warnings_name_the_link(client, tmp_path):
    """Catches a warning with only `hulls[1]`, which does not identify a robot's mesh."""
    (tmp_path / "bars.stl").write_bytes(stl(np.concatenate(BARS)))
    (tmp_path / "robot.urdf").write_text(
        f'<robot name="r"><link name="base">{BOX}<collision name="bars"><geometry>'
        '<mesh filename="bars.stl"/></geometry></collision></link></robot>'
    )
    robot = hullcast.Robot(tmp_path / "robot.urdf", decompose=False)
    expected = r"^link 'base', collision 1 'bars' \(bars\.stl\) is not convex: it fills 0\.8[56]"
    with pytest.warns(hullcast.NotConvexWarning, match=expected) as caught:
        client.register(robot.shapes)
    assert caught.list[0].message.field == "hulls[1]"
    with pytest.warns(hullcast.NotConvexWarning, match=r"^hulls\[0\] \(bars\.stl\) is not convex"):
        client.register([tmp_path / "bars.stl"])


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"urdf": None}, "urdf"),
        ({"urdf": 7}, "urdf"),
        ({"packages": 7}, "packages"),
        ({"packages": [None]}, "packages"),
        ({"srdf": 7}, "srdf"),
        ({"srdf": "none.srdf"}, "srdf"),
        ({"ignored": [("a",)]}, "ignored"),
        ({"ignored": ["ab"]}, "ignored"),
        ({"ignored": 7}, "ignored"),
        ({"ignored": [("a", "z")]}, "ignored"),
        ({"threshold": 0}, "threshold"),
        ({"threshold": True}, "threshold"),
        ({"progress": 5}, "progress"),
        ({"cache": 5}, "cache"),
        ({"threshold": 2}, "threshold"),
        ({"threshold": "fine"}, "threshold"),
        ({"threshold": np.nan}, "threshold"),
    ],
)
def test_arguments_that_are_refused(tmp_path, arguments, field):
    """Catches errors that do not name the argument."""
    (tmp_path / "robot.urdf").write_text(with_joint(""))
    with pytest.raises(hullcast.InvalidArgument) as caught:
        hullcast.Robot(**{"urdf": tmp_path / "robot.urdf", **arguments})
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("joints", "base", "field"),
    [
        ("half", None, "joints"),
        ({"j": "half"}, None, "joints"),
        ([[0.0], [1.0, 2.0]], None, "joints"),
        (None, "up", "base"),
        (None, np.eye(3), "base"),
    ],
)
def test_values_of_joints_that_are_refused(tmp_path, joints, base, field):
    """Catches numpy's own errors."""
    (tmp_path / "robot.urdf").write_text(with_joint(""))
    with pytest.raises(hullcast.InvalidArgument) as caught:
        hullcast.Robot(tmp_path / "robot.urdf").poses(joints, base=base)
    assert caught.value.field.partition("[")[0] == field


@pytest.mark.parametrize("norm", [1.0, 0.5, 3.9])
def test_an_origin_with_a_quaternion(tmp_path, norm):
    """Catches `quat_xyzw` of URDF 1.2 that is ignored, so that bodies and joints are not turned."""
    spatial = pytest.importorskip("scipy.spatial.transform")
    turn = spatial.Rotation.from_euler("xyz", [0.3, -0.4, 0.5])
    quat = " ".join(repr(float(c)) for c in turn.as_quat() * norm)
    robots = []
    for text in (f'quat_xyzw="{quat}"', 'rpy="0.3 -0.4 0.5"'):
        origin = f'<origin xyz="1 2 3" {text}/>'
        link = f'<link name="a">{BOX}</link><link name="b"><collision>{origin}<geometry>'
        joint = f'<joint name="j" type="fixed"><parent link="a"/><child link="b"/>{origin}</joint>'
        (tmp_path / "robot.urdf").write_text(
            f'<robot name="r" version="1.2">{link}<box size="1 2 3"/></geometry></collision></link>'
            f"{joint}</robot>"
        )
        robots.append(hullcast.Robot(tmp_path / "robot.urdf"))
    one, other = robots
    assert one.shapes[1] == pytest.approx(np.asarray(other.shapes[1]))
    assert one.poses() == pytest.approx(other.poses())
    assert one.poses()[1, :3, :3] == pytest.approx(turn.as_matrix())


def with_srdf(folder: Path, text: str) -> hullcast.Robot:
    """The robot of the links a to d in a star around a, with an SRDF file."""
    joints = "".join(
        f'<joint name="{x}" type="continuous"><parent link="a"/><child link="{x}"/></joint>'
        for x in "bcd"
    )
    (folder / "robot.urdf").write_text(f'<robot name="r">{LINKS}{joints}</robot>')
    (folder / "robot.srdf").write_text(text)
    return hullcast.Robot(folder / "robot.urdf", srdf=folder / "robot.srdf")


def test_other_elements_of_an_srdf(tmp_path):
    """Catches `disable_default_collisions` and `enable_collisions` that are ignored."""
    assert with_srdf(tmp_path, '<robot name="r"/>').pairs.tolist() == [[1, 2], [1, 3], [2, 3]]
    default = '<disable_default_collisions link="b"/>'
    assert with_srdf(tmp_path, f'<robot name="r">{default}</robot>').pairs.tolist() == [[2, 3]]
    again = '<enable_collisions link1="d" link2="b"/>'
    robot = with_srdf(tmp_path, f'<robot name="r">{default}{again}</robot>')
    assert robot.pairs.tolist() == [[1, 3], [2, 3]]
    with pytest.raises(hullcast.InvalidArgument, match="<disable_collisions> has no 'link2'"):
        with_srdf(tmp_path, '<robot name="r"><disable_collisions link1="b"/></robot>')


def test_urdf_and_srdf_are_not_confused(tmp_path):
    """Catches a URDF file as `srdf`, which disabled nothing in silence."""
    path = tmp_path / "robot.urdf"
    path.write_text(with_joint(""))
    with pytest.raises(
        hullcast.InvalidArgument, match=r"robot\.urdf: this is a URDF file"
    ) as caught:
        hullcast.Robot(path, srdf=path)
    assert (caught.value.reason, caught.value.field) == ("NOT_AN_SRDF", "srdf")
    path.write_text('<robot name="r"><disable_collisions link1="a" link2="b"/></robot>')
    with pytest.raises(hullcast.InvalidArgument, match="this is an SRDF file") as caught:
        hullcast.Robot(path)
    assert (caught.value.reason, caught.value.field) == ("NOT_A_ROBOT", "urdf")


REFUSED_BY_THE_SERVER = {
    "thin": ('<box size="1 1 1e-20"/>', "robot.urdf", "NOT_REPRESENTABLE"),
    "large": ('<box size="1 1 1e200"/>', "robot.urdf", "SIZE_OUT_OF_RANGE"),
    "small": ('<sphere radius="1e-300"/>', "robot.urdf", "SIZE_OUT_OF_RANGE"),
    "many vertices": ('<mesh filename="ball.obj"/>', "ball.obj", "TOO_MANY_VERTICES"),
    "a small mesh": ('<mesh filename="ball.obj" scale="1e-90 1e-90 1e-90"/>', "ball.obj", "SIZE_OUT_OF_RANGE"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED_BY_THE_SERVER)
def test_refused_hulls_name_file_and_link(tmp_path, name):
    """Catches `hulls[1]` as the only name of a robot's body that the server refuses."""
    spatial = pytest.importorskip("scipy.spatial")
    shape, file, reason = REFUSED_BY_THE_SERVER[name]
    points = hullcast.sphere(1, subdivisions=2).vertices
    text = "".join("v {} {} {}\n".format(*row) for row in points.tolist())
    faces = spatial.ConvexHull(points).simplices + 1
    (tmp_path / "ball.obj").write_text(text + "".join("f {} {} {}\n".format(*f) for f in faces))
    (tmp_path / "robot.urdf").write_text(
        f'<robot name="r"><link name="arm">{BOX}<collision><geometry>{shape}</geometry></collision>'
        "</link></robot>"
    )
    limit = ["--max-vertices-per-hull", "150"]
    with hullcast.serve(arguments=limit) as client:
        for robot in (
            hullcast.Robot(tmp_path / "robot.urdf"),
            pickle.loads(pickle.dumps(hullcast.Robot(tmp_path / "robot.urdf", decompose=False))),
        ):
            with pytest.raises(hullcast.HullRejected) as caught:
                client.register(robot.shapes)
            assert f"link 'arm', collision 1 ({file})" in str(caught.value)
            assert (caught.value.reason, caught.value.index) == (reason, 1)


def test_an_srdf_that_is_none(tmp_path):
    """Catches a parser's own error: the message must name the file."""
    (tmp_path / "robot.urdf").write_text(with_joint(""))
    for text in ("", "hello", "<sdf/>"):
        (tmp_path / "robot.srdf").write_text(text)
        with pytest.raises(hullcast.InvalidArgument, match=r"robot\.srdf") as caught:
            hullcast.Robot(tmp_path / "robot.urdf", srdf=tmp_path / "robot.srdf")
        assert (caught.value.reason, caught.value.field) == ("NOT_AN_SRDF", "srdf")
    with pytest.raises(hullcast.InvalidArgument, match="is a directory"):
        hullcast.Robot(tmp_path)


@pytest.mark.parametrize(
    ("limit", "expected"),
    [
        ('<limit upper="1"/>', (0, 1)),
        ('<limit lower="-1"/>', (-1, 0)),
        ('<limit effort="1" velocity="1"/>', (0, 0)),
        ("", (-np.inf, np.inf)),
    ],
)
def test_an_absent_end_of_a_limit_is_0(tmp_path, limit, expected):
    """Catches an unlimited end: by the specification of URDF, `lower` and `upper` default to 0."""
    (tmp_path / "robot.urdf").write_text(with_joint(limit))
    assert hullcast.Robot(tmp_path / "robot.urdf").limits.tolist() == [list(expected)]


def test_elements_of_other_programs_are_ignored(tmp_path):
    """Catches a robot that is refused because of an element that only another program reads."""
    others = "<gazebo/><transmission/><material/><ros2_control/><loop_joint/><sensor/><mujoco/>"
    inside = "<inertial/><visual/><sensor/><contact/><collision_checking/><verbose/>"
    text = f'<robot name="r">{others}<link name="a">{inside}{BOX}</link></robot>'
    (tmp_path / "robot.urdf").write_text(text)
    assert len(hullcast.Robot(tmp_path / "robot.urdf")) == 1
    (tmp_path / "robot.urdf").write_text(
        with_joint("<dynamics/><calibration/><safety_controller/>")
    )
    assert len(hullcast.Robot(tmp_path / "robot.urdf")) == 2

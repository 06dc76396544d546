"""All robots of the package example-robot-data load, and their bodies are counted independently."""

from __future__ import annotations

import sysconfig
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import hullcast
from hullcast import _convexity, _mesh

ROOT = Path(sysconfig.get_path("purelib")) / "cmeel.prefix/share"
ROBOTS = ROOT / "example-robot-data/robots"
FILES = sorted(ROBOTS.rglob("*.urdf"))

#: The files that are refused, with a part of the message.
REFUSED = {
    "ur_description/urdf/ur3.urdf": "<robot> has no 'name'",
    "alex_description/urdf/alex_psyonic_hands.urdf": "'Left_index_q2' mimics 'index_q1'",
}


def counted(path: Path) -> tuple[list[str], list[str]]:
    """The link of each collision element and the tag of its shape, by a plain walk of the XML."""
    links: list[str] = []
    shapes: list[str] = []
    for link in ElementTree.parse(path).getroot():
        for element in link if link.tag == "link" else ():
            if element.tag == "collision":
                links.append(link.attrib["name"])
                shapes += [
                    shape.tag for part in element if part.tag == "geometry" for shape in part
                ]
    return links, shapes


def test_all_files_are_there():
    """Catches a version of the package with other files, for which the counts here do not hold."""
    assert len(FILES) == 69
    assert sum(len(counted(path)[0]) for path in FILES) == 1606


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_robot_loads_with_its_bodies(client, path):
    """Catches collision elements that are lost, duplicated or assigned to another link.

    The robot is compared with a walk of the XML. The bodies' hulls are registered and have a
    volume. Each mesh that is not convex gives a warning that names its link.
    """
    name = str(path.relative_to(ROBOTS))
    if name in REFUSED:
        with pytest.raises(hullcast.InvalidArgument) as caught:
            hullcast.Robot(path, decompose=False)
        assert REFUSED[name] in caught.value.message
        return
    robot = hullcast.Robot(path, packages=ROOT, decompose=False)
    links, shapes = counted(path)
    assert len(robot) == len(links) == len(shapes)
    assert [robot.links[i] for i in robot.body_links] == links
    assert [isinstance(s, _mesh.Mesh) for s in robot.shapes] == [tag == "mesh" for tag in shapes]
    assert robot.poses().shape == (len(links), 4, 4)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        hulls = client.register(robot.shapes)
    told = [w.message for w in caught if isinstance(w.message, hullcast.NotConvexWarning)]
    dented = [i for i, s in enumerate(robot.shapes) if isinstance(s, _mesh.Mesh) and not convex(s)]
    assert [w.field for w in told] == [f"hulls[{i}]" for i in dented]
    for warning, i in zip(told, dented, strict=True):
        assert str(warning).startswith(f"link {links[i]!r}, collision ")
        assert 0 <= warning.ratio <= 1
    assert all(hull.volume > 0 for hull in hulls)
    assert len(hulls) == len(links)


def convex(mesh: _mesh.Mesh) -> bool:
    """The test of convexity that `Robot` uses, so that the warnings can be compared with it."""
    return _convexity.is_convex(mesh.vertices, mesh.faces)


@pytest.mark.parametrize(
    ("name", "bodies"),
    [
        ("panda_description/urdf/panda.urdf", 17),
        ("go2_description/urdf/go2.urdf", 19),
        ("a1_description/urdf/a1.urdf", 22),
    ],
)
def test_robots_of_convex_meshes_stay_whole(name, bodies):
    """Catches false alarms: these robots' meshes were made convex, so none is decomposed."""
    assert len(hullcast.Robot(ROBOTS / name, packages=ROOT)) == bodies


@pytest.mark.parametrize(
    "mesh",
    [
        "romeo_description/meshes/V1/collision/Torso.dae",
        "alex_description/meshes/ALX02_02_A06_TorsoLink.obj",
        "tiago_description/meshes/torso/torso_lift_collision_core.dae",
        "tiago_description/meshes/torso/torso_lift_collision_neck.dae",
        "icub_description/meshes/upmc/collision/icub_simple_collision_l_arm.dae",
        "romeo_description/meshes/V1/collision/LWristPitch.dae",
    ],
)
def test_meshes_of_overlapping_parts(mesh):
    """Catches volumes that count overlapping parts twice.

    For each of these real meshes, the signed volume differs by more than a tenth of the hull's
    volume from the volume of the union, or exceeds the hull's volume.
    """
    trimesh = pytest.importorskip("trimesh")
    path = next(ROBOTS.glob(f"**/{mesh.partition('/')[2]}"))
    ours = _mesh.load(path)
    whole = trimesh.Trimesh(ours.vertices, ours.faces, process=True)
    hull = whole.convex_hull.volume
    found = _convexity.dents(ours.vertices, ours.faces)
    assert found is not None
    signed = abs(whole.volume) / hull
    assert signed > 1 or abs(signed - found.ratio) > 0.1
    assert found.ratio < 0.95


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".dae"])
def test_meshes_are_read_as_trimesh_reads_them(suffix):
    """Catches a reader that loses or moves triangles of real files.

    The area and the bounding box of each collision mesh are compared with trimesh's, after
    conversion of the file's unit.
    """
    trimesh = pytest.importorskip("trimesh")
    named: set[Path] = set()
    for path in FILES:
        for mesh in ElementTree.parse(path).getroot().iterfind("link/collision/geometry/mesh"):
            place = mesh.attrib["filename"].partition("://")[2].strip("/")
            named.add(ROOT / place)
    files = sorted(path for path in named if path.suffix.lower() == suffix and path.is_file())
    assert len(files) > 30
    for path in files:
        ours = _mesh.load(path)
        theirs = trimesh.load_mesh(path, process=False)
        scale = 1.0
        if suffix == ".dae":
            unit = ElementTree.parse(path).getroot().find("{*}asset/{*}unit")
            scale = 1.0 if unit is None else float(unit.get("meter", 1))
        a, b, c = ours.vertices[ours.faces].swapaxes(0, 1)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
        assert area == pytest.approx(theirs.area * scale * scale, rel=1e-6), path
        size = np.ptp(ours.vertices, axis=0).max()
        bounds = np.array([ours.vertices.min(axis=0), ours.vertices.max(axis=0)])
        assert np.abs(bounds - theirs.bounds * scale).max() < 1e-6 * size, path

"""A small URDF reader: collision geometry as convex hulls, forward kinematics, ignored pairs."""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import shapes

CYLINDER_SIDES = 32


@dataclass
class Piece:
    """One collision geometry of a link."""

    name: str
    link: str
    origin: np.ndarray  # (4, 4), link frame
    vertices: np.ndarray
    source: str
    volume_ratio: float  # the mesh's volume over its hull's; 1 for a primitive


@dataclass
class Joint:
    name: str
    kind: str
    parent: str
    child: str
    origin: np.ndarray  # (4, 4), parent link frame
    axis: np.ndarray
    limits: tuple
    mimic: str


@dataclass
class Robot:
    root: str
    pieces: list
    joints: list
    ignored: set = field(default_factory=set)  # sorted pairs of link names

    def link_poses(self, angles, base=None):
        """The world pose (4, 4) of every link, from joint values by name (0 if missing)."""
        poses = {self.root: np.eye(4) if base is None else base}
        waiting = list(self.joints)
        while waiting:
            ready = [j for j in waiting if j.parent in poses]
            for joint in ready:
                value = angles.get(joint.mimic or joint.name, 0.0)
                poses[joint.child] = poses[joint.parent] @ joint.origin @ _motion(joint, value)
            waiting = [j for j in waiting if j.child not in poses]
        return poses

    def piece_poses(self, angles, base=None):
        """The world pose (4, 4) of every piece, in the order of `pieces`."""
        links = self.link_poses(angles, base)
        return [links[piece.link] @ piece.origin for piece in self.pieces]

    def rigid_group(self, link):
        """The topmost link to which `link` is connected through fixed joints only."""
        parents = {j.child: j.parent for j in self.joints if j.kind == "fixed"}
        while link in parents:
            link = parents[link]
        return link

    def ignores(self, a, b):
        """Whether two links are one rigid body, joined, or disabled by the SRDF."""
        group_a, group_b = self.rigid_group(a), self.rigid_group(b)
        joined = {
            (self.rigid_group(j.parent), self.rigid_group(j.child)) for j in self.joints if j.kind != "fixed"
        }
        return (
            group_a == group_b
            or (group_a, group_b) in joined
            or (group_b, group_a) in joined
            or tuple(sorted((a, b))) in self.ignored
        )


def pose(xyz=(0, 0, 0), rotation=None):
    """A pose (4, 4) from a position and a scipy rotation."""
    matrix = np.eye(4)
    matrix[:3, 3] = xyz
    if rotation is not None:
        matrix[:3, :3] = rotation.as_matrix()
    return matrix


def load(urdf, srdf, packages):
    """Reads a robot. Paths with package:// are relative to the folder `packages`."""
    root = ElementTree.parse(urdf).getroot()
    joints = [_joint(element) for element in root.findall("joint")]
    children = {j.child for j in joints}
    links = root.findall("link")
    pieces = [
        _piece(link.get("name"), index, element, Path(packages))
        for link in links
        for index, element in enumerate(link.findall("collision"))
    ]
    # The reason "Never" only means that a sampler never saw the links touch, so such pairs are
    # kept.
    ignored = {
        tuple(sorted((e.get("link1"), e.get("link2"))))
        for e in ElementTree.parse(srdf).getroot().findall("disable_collisions")
        if e.get("reason") in ("Adjacent", "Default")
    }
    base = next(link.get("name") for link in links if link.get("name") not in children)
    return Robot(base, pieces, joints, ignored)


def read_stl(path):
    """(n, 3, 3): the triangles of a binary STL file, float32."""
    data = Path(path).read_bytes()
    count = int(np.frombuffer(data, "<u4", 1, 80)[0])
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(data, record, count, 84)["corners"]


def _motion(joint, value):
    if joint.kind == "prismatic":
        return pose(joint.axis * value)
    if joint.kind in ("revolute", "continuous"):
        return pose(rotation=Rotation.from_rotvec(joint.axis * value))
    return np.eye(4)


def _numbers(text):
    return np.array([float(x) for x in text.split()])


def _origin(element):
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    turn = Rotation.from_euler("xyz", _numbers(origin.get("rpy", "0 0 0")))
    return pose(_numbers(origin.get("xyz", "0 0 0")), turn)


def _joint(element):
    axis = element.find("axis")
    axis = np.array([1.0, 0, 0]) if axis is None else _numbers(axis.get("xyz"))
    limit, mimic = element.find("limit"), element.find("mimic")
    limits = (-np.inf, np.inf)
    if limit is not None:
        limits = (float(limit.get("lower", "-inf")), float(limit.get("upper", "inf")))
    return Joint(
        element.get("name"),
        element.get("type"),
        element.find("parent").get("link"),
        element.find("child").get("link"),
        _origin(element),
        axis,
        limits,
        mimic.get("joint") if mimic is not None else None,
    )


def _piece(link, index, element, packages):
    shape = element.find("geometry")[0]
    ratio = 1.0
    if shape.tag == "box":
        vertices, source = shapes.box(_numbers(shape.get("size"))), f"box {shape.get('size')}"
    elif shape.tag == "cylinder":
        radius, length = float(shape.get("radius")), float(shape.get("length"))
        vertices = shapes.prism(CYLINDER_SIDES, radius, length)
        source = f"cylinder radius {radius} length {length}, as a prism of {CYLINDER_SIDES} sides inside it"
    elif shape.tag == "sphere":
        radius = float(shape.get("radius"))
        vertices = shapes.icosphere(radius)
        source = f"sphere radius {radius}, as a polyhedron of {len(vertices)} vertices inside it"
    elif shape.tag == "mesh":
        source = shape.get("filename").removeprefix("package://")
        triangles = read_stl(packages / source) * np.float32(1)
        vertices = shapes.extreme_vertices(triangles.reshape(-1, 3))
        t = triangles.astype(float)
        mesh_volume = np.einsum("ij,ij->", t[:, 0], np.cross(t[:, 1], t[:, 2])) / 6
        ratio = mesh_volume / ConvexHull(vertices).volume
    else:
        raise ValueError(f"{link}: collision geometry {shape.tag!r} is not handled")
    return Piece(f"{link}/{index}", link, _origin(element), vertices, source, float(ratio))

"""URDF and SRDF files, read by yourdfpy: links, joints, collision shapes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from . import _mesh
from ._arrays import Floats
from ._errors import InvalidArgument

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

_MOVING = ("revolute", "continuous", "prismatic")
_CYLINDER_SIDES = 32
_SPHERE_DIVISIONS = 2


@dataclass(frozen=True, eq=False)
class Joint:
    """What a joint does to its child: `origin`, then a motion along or about `axis`."""

    name: str
    kind: str
    #: Links, by their place in `Model.links`.
    parent: int
    child: int
    #: (4, 4): in the parent's frame.
    origin: Floats
    #: (3,): unit.
    axis: Floats
    limits: tuple[float, float]
    #: The joint whose value it takes, times the factor, plus the offset; "" for its own.
    mimics: str
    factor: float
    offset: float

    @property
    def is_fixed(self) -> bool:
        """Whether parent and child are one rigid part."""
        return self.kind == "fixed"

    @property
    def is_free(self) -> bool:
        """Whether it has a value of its own."""
        return not self.is_fixed and not self.mimics


@dataclass(frozen=True, eq=False)
class Model:
    """A robot: a tree of links."""

    name: str
    links: tuple[str, ...]
    #: As in the file.
    joints: tuple[Joint, ...]
    #: From the root outward, so that each one's parent is placed before it.
    ordered: tuple[Joint, ...]
    root: int
    #: Per collision element its link and its points or mesh, in the link's frame.
    shapes: tuple[tuple[int, Any], ...]


def read(urdf: str | os.PathLike[str], packages: Paths) -> Model:
    """The model of a URDF file, its collision meshes loaded.

    Raises:
        InvalidArgument, FileNotFoundError, ImportError: as `Robot`.
    """
    try:
        import yourdfpy as library
    except ImportError as error:
        raise ImportError("URDF needs yourdfpy: pip install 'hullcast[robot]'") from error
    path = Path(urdf)
    if not path.is_file():
        raise FileNotFoundError(os.fspath(urdf))
    folders = [packages] if isinstance(packages, (str, os.PathLike)) else list(packages)
    files = _Files(path.resolve().parent, [Path(folder) for folder in folders])
    yourdfpy: Any = library
    robot = yourdfpy.URDF.load(os.fspath(path), build_scene_graph=False, load_meshes=False).robot
    links = tuple(link.name for link in robot.links)
    place = {name: i for i, name in enumerate(links)}
    joints = tuple(_joint(joint, place) for joint in robot.joints)
    root, ordered = _tree(links, joints)
    shapes = tuple(
        (i, _shape(collision, files, link.name))
        for i, link in enumerate(robot.links)
        for collision in link.collisions
    )
    return Model(robot.name, links, joints, ordered, root, shapes)


def disabled(srdf: str | os.PathLike[str]) -> Iterator[tuple[str, str]]:
    """The pairs of link names of an SRDF file's `disable_collisions`."""
    for element in ElementTree.parse(srdf).getroot().iter("disable_collisions"):
        yield element.get("link1", ""), element.get("link2", "")


def _joint(joint: Any, place: dict[str, int]) -> Joint:
    if joint.type != "fixed" and joint.type not in _MOVING:
        raise InvalidArgument(
            f"{joint.name} is {joint.type}: give its link's pose as `base` instead",
            reason="UNSUPPORTED_JOINT",
            field="urdf",
        )
    for link in (joint.parent, joint.child):
        if link not in place:
            raise _not_a_robot(f"{joint.name} names a link {link!r} that is not there")
    axis = np.array([1.0, 0, 0] if joint.axis is None else joint.axis, dtype="<f8")
    length = float(np.linalg.norm(axis))
    if joint.type in _MOVING and not length > 0:
        raise _not_a_robot(f"{joint.name} has no axis")
    limits = (-np.inf, np.inf)
    if joint.limit is not None and joint.type != "continuous":
        low, high = joint.limit.lower, joint.limit.upper
        limits = (-np.inf if low is None else low, np.inf if high is None else high)
    mimic = joint.mimic
    return Joint(
        name=joint.name,
        kind=joint.type,
        parent=place[joint.parent],
        child=place[joint.child],
        origin=np.eye(4) if joint.origin is None else np.asarray(joint.origin, dtype="<f8"),
        axis=axis / (length or 1.0),
        limits=limits,
        mimics="" if mimic is None else mimic.joint,
        factor=1.0 if mimic is None or mimic.multiplier is None else mimic.multiplier,
        offset=0.0 if mimic is None or mimic.offset is None else mimic.offset,
    )


def _tree(links: Sequence[str], joints: Sequence[Joint]) -> tuple[int, tuple[Joint, ...]]:
    """The root, and the joints from it outward."""
    children = {joint.child for joint in joints}
    roots = [i for i in range(len(links)) if i not in children]
    if len(roots) != 1 or len(children) != len(joints):
        raise _not_a_robot("links and joints are not one tree")
    free = {joint.name for joint in joints if joint.is_free}
    for joint in joints:
        if joint.mimics and joint.mimics not in free:
            raise _not_a_robot(f"{joint.name} mimics {joint.mimics!r}, which has no value")
    placed, ordered, waiting = {roots[0]}, list[Joint](), list(joints)
    while waiting:
        ready = [joint for joint in waiting if joint.parent in placed]
        if not ready:
            raise _not_a_robot("links and joints are not one tree")
        ordered += ready
        placed |= {joint.child for joint in ready}
        waiting = [joint for joint in waiting if joint.child not in placed]
    return roots[0], tuple(ordered)


def _not_a_robot(message: str) -> InvalidArgument:
    return InvalidArgument(message, reason="NOT_A_ROBOT", field="urdf")


def _shape(collision: Any, files: _Files, link: str) -> Any:
    """Points or a mesh, in the link's frame."""
    geometry = collision.geometry
    pose = np.eye(4) if collision.origin is None else np.asarray(collision.origin, dtype="<f8")
    if geometry.mesh is not None:
        mesh = _mesh.load(files.find(geometry.mesh.filename))
        scale = 1.0 if geometry.mesh.scale is None else np.asarray(geometry.mesh.scale)
        # A mirrored mesh is inside out, which counts for nothing here.
        return _mesh.Mesh(_placed(mesh.vertices * scale, pose), mesh.faces)
    if geometry.box is not None:
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return _placed(corners * np.asarray(geometry.box.size) / 2, pose)
    if geometry.cylinder is not None:
        return _placed(_cylinder(geometry.cylinder.radius, geometry.cylinder.length), pose)
    if geometry.sphere is not None:
        return _placed(_sphere(geometry.sphere.radius), pose)
    raise _not_a_robot(f"{link} has a collision geometry other than mesh, box, cylinder, sphere")


def _placed(points: Floats, pose: Floats) -> Floats:
    return np.ascontiguousarray(points @ pose[:3, :3].T + pose[:3, 3])


def _cylinder(radius: float, length: float) -> Floats:
    angles = np.arange(_CYLINDER_SIDES) * (2 * np.pi / _CYLINDER_SIDES)
    ring = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    ends = [np.full((_CYLINDER_SIDES, 1), z) for z in (-length / 2, length / 2)]
    return np.concatenate([np.hstack([ring, end]) for end in ends])


def _sphere(radius: float) -> Floats:
    import trimesh as library

    trimesh: Any = library
    mesh = trimesh.creation.icosphere(subdivisions=_SPHERE_DIVISIONS, radius=radius)
    return np.asarray(mesh.vertices, dtype="<f8")


class _Files:
    """Where the files are that a URDF names."""

    def __init__(self, own: Path, packages: Sequence[Path]) -> None:
        self._own = own
        ros = os.environ.get("ROS_PACKAGE_PATH", "")
        self._packages = [*packages, *(Path(entry) for entry in ros.split(os.pathsep) if entry)]

    def find(self, name: str) -> Path:
        """The file that a mesh's `filename` means."""
        scheme, separator, rest = name.rpartition("://")
        if not separator or scheme == "file":
            places = [self._own / rest]  # an absolute path stays what it is
        else:
            # package://name/...: in the folder `name`, which the file may be in itself.
            places = [folder / rest for folder in self._packages]
            for above in (self._own, *self._own.parents):
                places.append(above / rest)
                if above.name == rest.partition("/")[0]:
                    places.append(above.parent / rest)
        for place in places:
            if place.is_file():
                return place
        raise FileNotFoundError(f"{name}: give the folder of its package as `packages`")

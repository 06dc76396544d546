"""Reads URDF and SRDF files: links, joints and collision shapes. Visuals are ignored."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from . import _convexity, _files, _mesh, _primitives, _shapes
from ._arguments import counted
from ._arrays import Floats
from ._errors import FileNotFound, InvalidArgument, NoBodiesWarning, warn
from ._packages import Packages

Element = ElementTree.Element

_MOVING = ("revolute", "continuous", "prismatic")
_FREE = ("floating", "planar")


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint places its child link by `origin`, then moves it along or about `axis`."""

    name: str
    kind: str
    #: The connected links, as indices into `Model.links`.
    parent: int
    child: int
    #: (4, 4): the joint's frame in the parent's frame, at value 0.
    origin: Floats
    #: (3,): a unit vector in the joint's frame.
    axis: Floats
    limits: tuple[float, float]
    #: The joint whose value this joint follows (times `factor`, plus `offset`); "" for none. In a
    #: `Model` that joint has a value of its own, even if the file chains several mimic joints.
    mimics: str
    factor: float
    offset: float

    @property
    def is_fixed(self) -> bool:
        """Whether parent and child are one rigid part."""
        return self.kind == "fixed"

    @property
    def is_free(self) -> bool:
        """Whether the joint has a value of its own."""
        return not self.is_fixed and not self.mimics


@dataclass(frozen=True, eq=False)
class Model:
    """A robot: a tree of links."""

    name: str
    links: tuple[str, ...]
    #: In the order of the file.
    joints: tuple[Joint, ...]
    #: From the root outward, so that each joint's parent is placed before its child.
    ordered: tuple[Joint, ...]
    root: int
    #: For each collision element: its link, its name in messages, and its points or mesh in the
    #: link's frame.
    shapes: tuple[tuple[int, str, Any], ...]


class _Invalid(Exception):
    """A fault in a file. The message does not name the file yet."""

    def __init__(self, message: str, reason: str = "NOT_A_ROBOT") -> None:
        super().__init__(message)
        self.reason = reason


def read(urdf: Any, packages: Any) -> Model:
    """Reads the model of a URDF file and loads its collision meshes.

    Raises:
        InvalidArgument, FileNotFound: as `Robot`.
    """
    path = Path(_files.path_of("urdf", urdf, "the path of a URDF file")).resolve()
    data = _files.read("urdf", path)
    folders = Packages(path.parent, packages)
    try:
        model, hidden = _model(_root(data, "robot"), folders)
    except _Invalid as error:
        raise InvalidArgument(f"{path.name}: {error}", reason=error.reason, field="urdf") from None
    except FileNotFound as error:
        raise FileNotFound(
            f"{path.name}: {error.message}", reason=error.reason, field="urdf"
        ) from None
    if not model.shapes:
        links = counted(len(model.links), "link")
        text = f"{path.name}: the robot has no bodies: none of its {links} has a <collision>"
        if hidden:
            verb = "has" if hidden == 1 else "have"
            text += (
                f"; {counted(hidden, 'link')} {verb} only <visual> elements, which are not read: "
                "give a URDF file with collision geometry, or copy each <visual> as a <collision>"
            )
        warn(NoBodiesWarning(text))
    return model


def disabled(srdf: Any) -> Iterator[tuple[str, str]]:
    """Yields the pairs of link names in an SRDF file's `disable_collisions` elements."""
    path = Path(_files.path_of("srdf", srdf))
    data = _files.read("srdf", path)
    try:
        root = _root(data, "robot")
    except _Invalid as error:
        raise InvalidArgument(f"{path.name}: {error}", reason="NOT_AN_SRDF", field="srdf") from None
    for element in root.iter("disable_collisions"):
        yield element.get("link1", ""), element.get("link2", "")


def _root(data: bytes, tag: str) -> Element:
    if not data.strip():
        raise _Invalid("the file is empty")
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise _Invalid(f"the file is not XML: {error}") from None
    others = {
        "mujoco": "an MJCF file, of MuJoCo",
        "mujocoinclude": "an MJCF file, of MuJoCo",
        "sdf": "an SDF file, of Gazebo",
        "COLLADA": "a COLLADA file, a mesh",
    }
    if root.tag != tag:
        what = others.get(root.tag, f"XML whose root is <{root.tag}>")
        raise _Invalid(f"this is {what}, expected a file whose root is <{tag}>: convert it")
    for element in root.iter():
        if "xacro" in element.tag.partition("}")[0]:
            name = element.tag.rpartition("}")[2]
            raise _Invalid(
                f"<xacro:{name}> has to be expanded first: xacro robot.urdf.xacro > robot.urdf"
            )
    return root


def _model(root: Element, packages: Packages) -> tuple[Model, int]:
    """The robot, and the number of links that have visuals and no collision geometry."""
    name = _attribute(root, "name", "<robot>")
    elements = root.findall("link")
    if not elements:
        raise _Invalid("<robot> has no links")
    links = _names(elements, "link")
    place = {link: i for i, link in enumerate(links)}
    found = root.findall("joint")
    _names(found, "joint")
    joints = _resolved([_joint(element, place) for element in found])
    first, ordered = _tree(links, joints)
    meshes: dict[Path, _mesh.Mesh] = {}
    shapes: list[tuple[int, str, Any]] = []
    for i, element in enumerate(elements):
        for k, collision in enumerate(element.findall("collision")):
            where = f"link {links[i]!r}, collision {k}"
            label, shape = _shape(collision, where, packages, meshes)
            shapes.append((i, label, shape))
    hidden = [e for e in elements if e.find("visual") is not None and e.find("collision") is None]
    return Model(name, links, joints, ordered, first, tuple(shapes)), len(hidden)


def _names(elements: Sequence[Element], kind: str) -> tuple[str, ...]:
    """The names of all links or joints; raises if a name is missing or not unique."""
    names: dict[str, int] = {}
    for i, element in enumerate(elements):
        name = _attribute(element, "name", f"{kind} {i}")
        if name in names:
            raise _Invalid(f"{kind} {i} has the name {name!r}, which {kind} {names[name]} has too")
        names[name] = i
    return tuple(names)


# Attributes.


def _attribute(element: Element, attribute: str, where: str) -> str:
    value = element.get(attribute)
    if not value:
        tag = f"<{element.tag}>"
        raise _Invalid(f"{where if where == tag else f'{where}: {tag}'} has no {attribute!r}")
    return value


def _numbers(element: Element, attribute: str, count: int, where: str) -> Floats:
    """The finite numbers of an attribute, which must be present."""
    text = _attribute(element, attribute, where)
    what = f"{where}: <{element.tag} {attribute}={text!r}>"
    if "${" in text or "$(" in text:
        raise _Invalid(f"{what} has to be expanded by xacro first")
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all() or len(values) != count:
        numbers = "a finite number" if count == 1 else f"{count} finite numbers"
        raise _Invalid(f"{what} is not {numbers}")
    return values


def _number(element: Element, attribute: str, default: float, where: str) -> float:
    if element.get(attribute) is None:
        return default
    return float(_numbers(element, attribute, 1, where)[0])


def _positive(element: Element, attribute: str, count: int, where: str) -> Floats:
    values = _numbers(element, attribute, count, where)
    if not (values > 0).all():
        text = element.get(attribute)
        raise _Invalid(f"{where}: <{element.tag} {attribute}={text!r}> is not positive")
    return values


def _origin(parent: Element, where: str) -> Floats:
    """(4, 4): the pose of an `<origin>` element; the identity without one."""
    pose = np.eye(4)
    origin = parent.find("origin")
    if origin is None:
        return pose
    if origin.get("xyz") is not None:
        pose[:3, 3] = _numbers(origin, "xyz", 3, where)
    if origin.get("rpy") is not None:
        roll, pitch, yaw = _numbers(origin, "rpy", 3, where)
        pose[:3, :3] = _about(2, yaw) @ _about(1, pitch) @ _about(0, roll)
    return pose


def _about(axis: int, angle: float) -> Floats:
    """A rotation about a coordinate axis, as a (3, 3) matrix."""
    turn = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[j, i] = np.sin(angle)
    turn[i, j] = -np.sin(angle)
    return turn


# Joints.


def _joint(element: Element, place: dict[str, int]) -> Joint:
    name = element.get("name", "")
    where = f"joint {name!r}"
    kind = _attribute(element, "type", where)
    if kind in _FREE:
        raise _Invalid(
            f"{where} is {kind}, which is not read: give its link's pose as `base` instead",
            "UNSUPPORTED_JOINT",
        )
    if kind != "fixed" and kind not in _MOVING:
        kinds = ", ".join((*_MOVING, "fixed"))
        raise _Invalid(f"{where} has the type {kind!r}, expected one of {kinds}")
    ends: list[int] = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None:
            raise _Invalid(f"{where} has no <{tag}>")
        link = _attribute(end, "link", where)
        if link not in place:
            raise _Invalid(f"{where}: its {tag} {link!r} is not a link of the file")
        ends.append(place[link])
    axis = np.array([1.0, 0.0, 0.0])
    limits = (-np.inf, np.inf)
    mimics, factor, offset = "", 1.0, 0.0
    if kind in _MOVING:
        given = element.find("axis")
        axis = axis if given is None else _numbers(given, "xyz", 3, where)
        length = float(np.linalg.norm(axis))
        if not length > 0:
            raise _Invalid(f"{where}: its axis is zero")
        axis = axis / length
        limit = element.find("limit")
        if limit is not None and kind != "continuous":
            limits = (
                _number(limit, "lower", -np.inf, where),
                _number(limit, "upper", np.inf, where),
            )
            if limits[0] > limits[1]:
                raise _Invalid(
                    f"{where}: its limits are {limits[0]:g} to {limits[1]:g}, in the wrong order"
                )
        mimic = element.find("mimic")
        if mimic is not None:
            mimics = _attribute(mimic, "joint", where)
            factor = _number(mimic, "multiplier", 1.0, where)
            offset = _number(mimic, "offset", 0.0, where)
    origin = _origin(element, where)
    return Joint(name, kind, ends[0], ends[1], origin, axis, limits, mimics, factor, offset)


def _resolved(joints: Sequence[Joint]) -> tuple[Joint, ...]:
    """Resolves chains of mimic joints, so that each mimics a joint with a value of its own."""
    by_name = {joint.name: joint for joint in joints}
    resolved: list[Joint] = []
    for joint in joints:
        chain, factor, offset = [joint.name], joint.factor, joint.offset
        last = joint
        while last.mimics:
            followed = by_name.get(last.mimics)
            if followed is None:
                raise _Invalid(
                    f"joint {last.name!r} mimics {last.mimics!r}, which is not a joint of the file"
                )
            if followed.is_fixed:
                raise _Invalid(f"joint {last.name!r} mimics {last.mimics!r}, which is fixed")
            if followed.name in chain:
                cycle = " -> ".join([*chain, followed.name])
                raise _Invalid(f"joints mimic each other in a circle: {cycle}")
            chain.append(followed.name)
            if followed.mimics:
                offset += factor * followed.offset
                factor *= followed.factor
            last = followed
        mimics = last.name if joint.mimics else ""
        resolved.append(replace(joint, mimics=mimics, factor=factor, offset=offset))
    return tuple(resolved)


def _tree(links: Sequence[str], joints: Sequence[Joint]) -> tuple[int, tuple[Joint, ...]]:
    """The root link, and the joints in an order from the root outward."""
    above: dict[int, Joint] = {}
    for joint in joints:
        other = above.setdefault(joint.child, joint)
        if other is not joint:
            raise _Invalid(
                f"links and joints are not one tree: link {links[joint.child]!r} is the child of "
                f"the joints {other.name!r} and {joint.name!r}"
            )
    roots = [i for i in range(len(links)) if i not in above]
    if len(roots) > 1:
        names = ", ".join(repr(links[i]) for i in roots[:5])
        raise _Invalid(
            f"links and joints are not one tree: {len(roots)} links have no parent ({names})"
        )
    children: dict[int, list[Joint]] = {}
    for joint in joints:
        children.setdefault(joint.parent, []).append(joint)
    ordered: list[Joint] = []
    waiting = list(roots)
    while waiting:
        below = children.get(waiting.pop(0), [])
        ordered += below
        waiting += [joint.child for joint in below]
    if len(ordered) < len(joints):
        lost = next(joint for joint in joints if joint not in ordered)
        raise _Invalid(
            f"links and joints are not one tree: joint {lost.name!r} is part of a circle"
        )
    return roots[0], tuple(ordered)


# Collision shapes.


def _shape(
    collision: Element, where: str, packages: Packages, meshes: dict[Path, _mesh.Mesh]
) -> tuple[str, Any]:
    """A collision element's name in messages, and its points or mesh in the link's frame."""
    if collision.get("name"):
        where = f"{where} {collision.get('name')!r}"
    geometry = collision.find("geometry")
    if geometry is None:
        raise _Invalid(f"{where} has no <geometry>")
    elements = list(geometry)
    if len(elements) != 1:
        raise _Invalid(f"{where}: <geometry> has {len(elements)} shapes instead of one")
    element = elements[0]
    pose = _origin(collision, where)
    if element.tag == "mesh":
        return _placed_mesh(element, pose, where, packages, meshes)
    if element.tag not in _SHAPES:
        kinds = ", ".join(f"<{kind}>" for kind in ("mesh", *_SHAPES))
        raise _Invalid(f"{where}: got the shape <{element.tag}>, expected one of {kinds}")
    return where, _placed(_SHAPES[element.tag](element, where), pose)


def _placed_mesh(
    element: Element, pose: Floats, where: str, packages: Packages, meshes: dict[Path, _mesh.Mesh]
) -> tuple[str, _mesh.Mesh]:
    name = _attribute(element, "filename", where)
    scale = np.ones(3)
    if element.get("scale") is not None:
        scale = _numbers(element, "scale", 3, where)
        if not scale.all():
            raise _Invalid(
                f"{where}: <mesh scale={element.get('scale')!r}> has a zero, expected other numbers"
            )
    file = packages.find(name, where)
    try:
        if file not in meshes:
            meshes[file] = _mesh.load(file)
    except InvalidArgument as error:
        raise _Invalid(f"{where}: {error.message}", error.reason) from None
    # A negative scale mirrors the mesh and turns it inside out, which does not matter here.
    points = _placed(meshes[file].vertices * scale, pose)
    label = f"{where} ({file.name})"
    if not np.isfinite(points).all():
        raise _Invalid(f"{label}: its scaled coordinates are too large for double precision")
    if _convexity.is_flat(points):
        raise _Invalid(
            f"{label} is flat: all points are in one plane, and a body needs a volume", "COPLANAR"
        )
    return label, _mesh.Mesh(points, meshes[file].faces, label)


def _placed(points: Floats, pose: Floats) -> Floats:
    return np.ascontiguousarray(points @ pose[:3, :3].T + pose[:3, 3])


def _cylinder(element: Element, where: str) -> Floats:
    radius = _positive(element, "radius", 1, where)[0]
    return _primitives.cylinder(radius, _positive(element, "length", 1, where)[0])


def _capsule(element: Element, where: str) -> Floats:
    """The length is that of the cylinder between the two half spheres, as in SDF and Drake."""
    radius = _positive(element, "radius", 1, where)[0]
    return _shapes.capsule(radius, _positive(element, "length", 1, where)[0]).vertices


_SHAPES: dict[str, Callable[[Element, str], Floats]] = {
    "box": lambda element, where: _primitives.box(_positive(element, "size", 3, where)),
    "cylinder": _cylinder,
    "capsule": _capsule,
    "sphere": lambda element, where: _primitives.sphere(_positive(element, "radius", 1, where)[0]),
}

"""Reads URDF files: links, joints and collision shapes. Visuals are ignored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from . import _convexity, _elements, _files, _mesh, _primitives, _shapes
from ._arguments import counted
from ._arrays import Floats
from ._elements import Element, Invalid
from ._errors import FileNotFound, InvalidArgument, NoBodiesWarning, warn
from ._packages import Packages

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


def read(urdf: Any, packages: Any) -> Model:
    """Reads the model of a URDF file and loads its collision meshes.

    Raises:
        InvalidArgument, FileNotFound: as `Robot`.
    """
    path = Path(_files.path_of("urdf", urdf, "the path of a URDF file")).resolve()
    data = _files.read("urdf", path)
    folders = Packages(path.parent, packages)
    try:
        model, hidden = _model(_elements.root_of(data, "robot"), folders, path.name)
    except Invalid as error:
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


def _model(root: Element, packages: Packages, file: str) -> tuple[Model, int]:
    """The robot, and the number of links that have visuals and no collision geometry."""
    name = _elements.text_of(root, "name", "<robot>")
    _elements.check_spelling(root, ("link", "joint"), "<robot>")
    elements = root.findall("link")
    if not elements:
        if root.find("disable_collisions") is not None or root.find("group") is not None:
            raise Invalid("this is an SRDF file, expected a URDF file: give it as srdf=")
        raise Invalid("<robot> has no links")
    links = _names(elements, "link")
    place = {link: i for i, link in enumerate(links)}
    found = root.findall("joint")
    _names(found, "joint")
    joints = _resolved([_joint(element, place) for element in found])
    first, ordered = _tree(links, joints)
    meshes: dict[Path, _mesh.Mesh] = {}
    shapes: list[tuple[int, str, Any]] = []
    for i, element in enumerate(elements):
        _elements.check_spelling(element, ("collision", "visual"), f"link {links[i]!r}")
        for k, collision in enumerate(element.findall("collision")):
            where = f"link {links[i]!r}, collision {k}"
            _elements.check_spelling(collision, ("geometry", "origin"), where)
            label, shape = _shape(collision, where, packages, meshes)
            is_mesh = isinstance(shape, _mesh.Mesh)  # its label has the name of its own file
            shapes.append((i, label if is_mesh else f"{label} ({file})", shape))
    hidden = [e for e in elements if e.find("visual") is not None and e.find("collision") is None]
    return Model(name, links, joints, ordered, first, tuple(shapes)), len(hidden)


def _names(elements: Sequence[Element], kind: str) -> tuple[str, ...]:
    """The names of all links or joints; raises if a name is missing or not unique."""
    names: dict[str, int] = {}
    for i, element in enumerate(elements):
        name = _elements.text_of(element, "name", f"{kind} {i}")
        if name in names:
            raise Invalid(f"{kind} {i} has the name {name!r}, which {kind} {names[name]} has too")
        names[name] = i
    return tuple(names)


# Joints.


def _joint(element: Element, place: dict[str, int]) -> Joint:
    name = element.get("name", "")
    where = f"joint {name!r}"
    known = ("parent", "child", "origin", "axis", "limit", "mimic", "dynamics", "calibration")
    _elements.check_spelling(element, known, where)
    kind = _elements.text_of(element, "type", where)
    if kind in _FREE:
        raise Invalid(
            f"{where} is {kind}, which is not read: give its link's pose as `base` instead",
            "UNSUPPORTED_JOINT",
        )
    if kind != "fixed" and kind not in _MOVING:
        kinds = ", ".join((*_MOVING, "fixed"))
        raise Invalid(f"{where} has the type {kind!r}, expected one of {kinds}")
    ends: list[int] = []
    for tag in ("parent", "child"):
        end = _elements.only_child(element, tag, where)
        if end is None:
            raise Invalid(f"{where} has no <{tag}>")
        link = _elements.text_of(end, "link", where)
        if link not in place:
            raise Invalid(f"{where}: its {tag} {link!r} is not a link of the file")
        ends.append(place[link])
    axis = np.array([1.0, 0.0, 0.0])
    limits = (-np.inf, np.inf)
    mimics, factor, offset = "", 1.0, 0.0
    if kind in _MOVING:
        given = _elements.only_child(element, "axis", where)
        axis = axis if given is None else _elements.numbers_of(given, "xyz", 3, where)
        length = float(np.linalg.norm(axis))
        if not length > 0:
            raise Invalid(f"{where}: its axis is zero")
        axis = axis / length
        limit = _elements.only_child(element, "limit", where)
        if limit is not None and kind != "continuous":
            limits = (
                _elements.number_of(limit, "lower", 0.0, where),
                _elements.number_of(limit, "upper", 0.0, where),
            )
            if limits[0] > limits[1]:
                absent = [name for name in ("lower", "upper") if limit.get(name) is None]
                raise Invalid(
                    f"{where}: its limits are {limits[0]:g} to {limits[1]:g}, in the wrong order"
                    f"{f' ({absent[0]!r} is not given, and then it is 0)' if absent else ''}"
                )
        mimic = _elements.only_child(element, "mimic", where)
        if mimic is not None:
            mimics = _elements.text_of(mimic, "joint", where)
            factor = _elements.number_of(mimic, "multiplier", 1.0, where)
            offset = _elements.number_of(mimic, "offset", 0.0, where)
    origin = _elements.origin_of(element, where)
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
                raise Invalid(
                    f"joint {last.name!r} mimics {last.mimics!r}, which is not a joint of the file"
                )
            if followed.is_fixed:
                raise Invalid(f"joint {last.name!r} mimics {last.mimics!r}, which is fixed")
            if followed.name in chain:
                cycle = " -> ".join([*chain, followed.name])
                raise Invalid(f"joints mimic each other in a circle: {cycle}")
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
            raise Invalid(
                f"links and joints are not one tree: link {links[joint.child]!r} is the child of "
                f"the joints {other.name!r} and {joint.name!r}"
            )
    roots = [i for i in range(len(links)) if i not in above]
    if len(roots) > 1:
        names = ", ".join(repr(links[i]) for i in roots[:5])
        raise Invalid(
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
        raise Invalid(f"links and joints are not one tree: joint {lost.name!r} is part of a circle")
    return roots[0], tuple(ordered)


# Collision shapes.


def _shape(
    collision: Element, where: str, packages: Packages, meshes: dict[Path, _mesh.Mesh]
) -> tuple[str, Any]:
    """A collision element's name in messages, and its points or mesh in the link's frame."""
    if collision.get("name"):
        where = f"{where} {collision.get('name')!r}"
    geometry = _elements.only_child(collision, "geometry", where)
    if geometry is None:
        raise Invalid(f"{where} has no <geometry>")
    elements = list(geometry)
    if len(elements) != 1:
        raise Invalid(f"{where}: <geometry> has {len(elements)} shapes instead of one")
    element = elements[0]
    pose = _elements.origin_of(collision, where)
    if element.tag == "mesh":
        return _placed_mesh(element, pose, where, packages, meshes)
    if element.tag not in _SHAPES:
        kinds = ", ".join(f"<{kind}>" for kind in ("mesh", *_SHAPES))
        raise Invalid(f"{where}: got the shape <{element.tag}>, expected one of {kinds}")
    return where, _placed(_SHAPES[element.tag](element, where), pose)


def _placed_mesh(
    element: Element, pose: Floats, where: str, packages: Packages, meshes: dict[Path, _mesh.Mesh]
) -> tuple[str, _mesh.Mesh]:
    name = _elements.text_of(element, "filename", where)
    scale = np.ones(3)
    if element.get("scale") is not None:
        scale = _elements.numbers_of(element, "scale", 3, where)
        if not scale.all():
            raise Invalid(
                f"{where}: <mesh scale={element.get('scale')!r}> has a zero, expected other numbers"
            )
    file = packages.find(name, where)
    try:
        if file not in meshes:
            meshes[file] = _mesh.load(file)
    except InvalidArgument as error:
        raise Invalid(f"{where}: {error.message}", error.reason) from None
    # A negative scale mirrors the mesh and turns it inside out, which does not matter here.
    points = _placed(meshes[file].vertices * scale, pose)
    label = f"{where} ({file.name})"
    if not np.isfinite(points).all():
        raise Invalid(f"{label}: its scaled coordinates are too large for double precision")
    if _convexity.is_flat(points):
        raise Invalid(
            f"{label} is flat: all points are in one plane, and a body needs a volume", "COPLANAR"
        )
    return label, _mesh.Mesh(points, meshes[file].faces, label)


def _placed(points: Floats, pose: Floats) -> Floats:
    return np.ascontiguousarray(points @ pose[:3, :3].T + pose[:3, 3])


def _cylinder(element: Element, where: str) -> Floats:
    radius = _elements.positive_of(element, "radius", 1, where)[0]
    return _primitives.cylinder(radius, _elements.positive_of(element, "length", 1, where)[0])


def _capsule(element: Element, where: str) -> Floats:
    """The length is that of the cylinder between the two half spheres, as in SDF and Drake."""
    radius = _elements.positive_of(element, "radius", 1, where)[0]
    return _shapes.capsule(radius, _elements.positive_of(element, "length", 1, where)[0]).vertices


def _sphere(element: Element, where: str) -> Floats:
    return _primitives.sphere(_elements.positive_of(element, "radius", 1, where)[0])


_SHAPES: dict[str, Callable[[Element, str], Floats]] = {
    "box": lambda element, where: _primitives.box(_elements.positive_of(element, "size", 3, where)),
    "cylinder": _cylinder,
    "capsule": _capsule,
    "sphere": _sphere,
}

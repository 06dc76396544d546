"""Reads the elements of URDF and SRDF files; an error names the element and the attribute."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from xml.etree import ElementTree

import numpy as np

from . import _arrays
from ._arrays import Floats

Element = ElementTree.Element

#: Two tags count as similar if at least this fraction of their letters is in both, in order.
_SIMILARITY = 0.8


class Invalid(Exception):
    """A fault in a file. The message does not name the file yet."""

    def __init__(self, message: str, reason: str = "NOT_A_ROBOT") -> None:
        super().__init__(message)
        self.reason = reason


def root_of(data: bytes, tag: str) -> Element:
    """The root element of an XML file, which must have the given tag."""
    if not data.strip():
        raise Invalid("the file is empty")
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise Invalid(f"the file is not XML: {error}") from None
    others = {
        "mujoco": "an MJCF file, of MuJoCo",
        "mujocoinclude": "an MJCF file, of MuJoCo",
        "sdf": "an SDF file, of Gazebo",
        "COLLADA": "a COLLADA file, a mesh",
    }
    if root.tag != tag:
        what = others.get(root.tag, f"XML whose root is <{root.tag}>")
        raise Invalid(f"this is {what}, expected a file whose root is <{tag}>: convert it")
    for element in root.iter():
        if "xacro" in element.tag.partition("}")[0]:
            name = element.tag.rpartition("}")[2]
            raise Invalid(
                f"<xacro:{name}> has to be expanded first: xacro robot.urdf.xacro > robot.urdf"
            )
    return root


def text_of(element: Element, attribute: str, where: str) -> str:
    """The text of an attribute, which must be present."""
    value = element.get(attribute)
    if not value:
        tag = f"<{element.tag}>"
        raise Invalid(f"{where if where == tag else f'{where}: {tag}'} has no {attribute!r}")
    return value


def numbers_of(element: Element, attribute: str, count: int, where: str) -> Floats:
    """The finite numbers of an attribute, which must be present."""
    text = text_of(element, attribute, where)
    what = f"{where}: <{element.tag} {attribute}={text!r}>"
    if "${" in text or "$(" in text:
        raise Invalid(f"{what} has to be expanded by xacro first")
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all() or len(values) != count:
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        raise Invalid(f"{what} is not {wanted}")
    return values


def number_of(element: Element, attribute: str, default: float, where: str) -> float:
    """The finite number of an attribute, or the default if the attribute is not there."""
    if element.get(attribute) is None:
        return default
    return float(numbers_of(element, attribute, 1, where)[0])


def positive_of(element: Element, attribute: str, count: int, where: str) -> Floats:
    """The positive numbers of an attribute, which must be present."""
    values = numbers_of(element, attribute, count, where)
    if not (values > 0).all():
        text = element.get(attribute)
        raise Invalid(f"{where}: <{element.tag} {attribute}={text!r}> is not positive")
    return values


def only_child(parent: Element, tag: str, where: str) -> Element | None:
    """The child element with a tag, or None; raises if there are several."""
    found = parent.findall(tag)
    if len(found) > 1:
        raise Invalid(f"{where} has {len(found)} <{tag}> elements instead of one")
    return found[0] if found else None


def check_spelling(parent: Element, known: Sequence[str], where: str) -> None:
    """Raises if the tag of a child element is a misspelt tag out of `known`.

    Files have elements for other programs too, with tags that are not similar.
    """
    for child in parent:
        if not isinstance(child.tag, str) or child.tag in known or "}" in child.tag:
            continue
        similar = difflib.get_close_matches(child.tag.lower(), known, n=1, cutoff=_SIMILARITY)
        if similar:
            raise Invalid(f"{where} has the element <{child.tag}>, expected <{similar[0]}>")


def origin_of(parent: Element, where: str) -> Floats:
    """(4, 4): the pose of an `<origin>` element; the identity without one.

    The rotation is `rpy` or, in files of URDF 1.2, `quat_xyzw`. Other attributes are refused,
    because they may be a rotation in another form.
    """
    pose = np.eye(4)
    origin = only_child(parent, "origin", where)
    if origin is None:
        return pose
    known = ("xyz", "rpy", "quat_xyzw")
    for attribute in origin.attrib:
        if attribute not in known and "}" not in attribute:
            raise Invalid(
                f"{where}: <origin> has the attribute {attribute!r}, expected {', '.join(known)}"
            )
    if origin.get("xyz") is not None:
        pose[:3, 3] = numbers_of(origin, "xyz", 3, where)
    if origin.get("rpy") is not None:
        roll, pitch, yaw = numbers_of(origin, "rpy", 3, where)
        pose[:3, :3] = _about(2, yaw) @ _about(1, pitch) @ _about(0, roll)
    if origin.get("quat_xyzw") is not None:
        if origin.get("rpy") is not None:
            raise Invalid(f"{where}: <origin> has rpy and quat_xyzw, expected one of them")
        pose[:3, :3] = _turned(numbers_of(origin, "quat_xyzw", 4, where), where)
    return pose


def _turned(quaternion: Floats, where: str) -> Floats:
    """The rotation (3, 3) of a quaternion x, y, z, w, which is normalised."""
    norm = float(np.linalg.norm(quaternion))
    if not _arrays.MIN_NORM <= norm <= _arrays.MAX_NORM:
        raise Invalid(
            f"{where}: <origin quat_xyzw> has the norm {norm:g}, expected "
            f"{_arrays.MIN_NORM:g} to {_arrays.MAX_NORM:g}; a unit quaternion has 1"
        )
    x, y, z, w = quaternion / norm
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * (cross @ cross)


def _about(axis: int, angle: float) -> Floats:
    """A rotation about a coordinate axis, as a (3, 3) matrix."""
    turn = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[j, i] = np.sin(angle)
    turn[i, j] = -np.sin(angle)
    return turn

"""Reads MJCF files, which MuJoCo compiles: bodies, joints, geoms, and which of them may meet."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from . import _arguments, _files, _mesh, _mjmodel
from ._arrays import Floats
from ._errors import InvalidArgument, NoBodiesWarning, warn
from ._urdf import Joint, Model

#: MuJoCo's numbers of the types of joints (`mjtJoint`), as URDF names them.
_KINDS = {2: "prismatic", 3: "revolute"}
_OTHERS = {0: "free", 1: "ball"}


@dataclass(frozen=True, eq=False)
class Mjcf:
    """A robot of an MJCF file. Its links are MuJoCo's bodies, and its bodies are MuJoCo's geoms."""

    model: Model
    #: (bodies,): the group of each body, from 0.
    group: npt.NDArray[np.intp]
    #: (groups, groups): whether the bodies of two groups may meet.
    meets: npt.NDArray[np.bool_]


def read(file: Any) -> Mjcf | None:
    """Compiles an MJCF file by MuJoCo, and reads the robot in it; None if it is no MJCF file.

    Raises:
        ImportError: mujoco is not installed, or has a version that is not supported.
        InvalidArgument: NOT_A_ROBOT, UNSUPPORTED_JOINT or UNSUPPORTED_SHAPE.
    """
    try:
        path = Path(_files.path_of("urdf", file)).resolve()
        data = _files.read("urdf", path)
    except InvalidArgument:
        return None  # the reader of URDF says what is wrong
    if not _is_mjcf(data):
        return None
    mujoco = _mjmodel.library("hullcast.Robot of an MJCF file")
    try:
        compiled = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        text = " ".join(str(error).split())
        raise _refusal(path, f"MuJoCo does not compile it: {text}") from None
    geoms = _mjmodel.colliding(compiled)
    try:
        model = _model(compiled, path, geoms)
    except InvalidArgument as error:
        raise _refusal(path, error.message, error.reason) from None
    if not len(geoms):
        links = _arguments.counted(compiled.nbody, "body", "bodies")
        text = f"{path.name}: the robot has no bodies: no geom of its {links} can collide"
        warn(NoBodiesWarning(text))
    rule = _mjmodel.Filter(mujoco, compiled, geoms)
    return Mjcf(model, rule.group, rule.meets)


def _is_mjcf(data: bytes) -> bool:
    """Whether the content of a file is XML whose root is `<mujoco>`."""
    try:
        _, root = next(iter(ElementTree.iterparse(io.BytesIO(data), events=("start",))))
    except (ElementTree.ParseError, ValueError, LookupError, StopIteration):
        return False
    return root.tag == "mujoco"


def _refusal(path: Path, text: str, reason: str = "NOT_A_ROBOT") -> InvalidArgument:
    return InvalidArgument(f"{path.name}: {text}", reason=reason, field="urdf")


def _model(compiled: Any, path: Path, geoms: npt.NDArray[np.intp]) -> Model:
    """The tree of bodies. A body with several joints has a further link between each two."""
    links = [str(compiled.body(i).name or f"body {i}") for i in range(compiled.nbody)]
    joints: list[Joint] = []

    def add(name: str, parent: int, child: int, origin: Floats, **moving: Any) -> None:
        options: dict[str, Any] = {
            "kind": "fixed",
            "axis": np.array([1.0, 0.0, 0.0]),
            "limits": (-np.inf, np.inf),
            "offset": 0.0,
            **moving,
        }
        joints.append(
            Joint(name, parent=parent, child=child, origin=origin, mimics="", factor=1.0, **options)
        )

    for body in range(1, compiled.nbody):
        parent = int(compiled.body_parentid[body])
        origin = _pose(compiled.body_pos[body], compiled.body_quat[body])
        anchor = np.zeros(3)
        first = int(compiled.body_jntadr[body])
        own = range(first, first + int(compiled.body_jntnum[body]))
        for place, joint in enumerate(own):
            name = str(compiled.joint(joint).name or f"joint {joint}")
            at = np.array(compiled.jnt_pos[joint])
            last = place == len(own) - 1 and not at.any()
            if last:
                child = body
            else:
                child = len(links)
                links.append(f"{links[body]} after {name}")
            moving = _motion(compiled, joint, name)
            add(name, parent, child, origin @ _pose(at - anchor), **moving)
            parent, origin, anchor = child, np.eye(4), at
        if parent != body:
            add(f"{links[body]}, fixed", parent, body, origin @ _pose(-anchor))
    shapes = tuple(_shape(compiled, path, links, geom) for geom in geoms.tolist())
    name = bytes(compiled.names).partition(b"\0")[0].decode() or path.stem
    ordered = tuple(joints)  # MuJoCo numbers each body after its parent
    return Model(name, tuple(links), ordered, ordered, 0, shapes)


def _motion(compiled: Any, joint: int, name: str) -> dict[str, Any]:
    """The type, axis, limits and zero of a joint."""
    number = int(compiled.jnt_type[joint])
    if number not in _KINDS:
        instead = ""
        if number == 0:
            instead = ": leave it out, and give the pose of the first body as `base`"
        raise InvalidArgument(
            f"joint {name!r} is a {_OTHERS[number]} joint, which is not read{instead}",
            reason="UNSUPPORTED_JOINT",
        )
    low, high = (float(limit) for limit in compiled.jnt_range[joint])
    return {
        "kind": _KINDS[number],
        "axis": np.array(compiled.jnt_axis[joint]),
        "limits": (low, high) if compiled.jnt_limited[joint] else (-np.inf, np.inf),
        # MuJoCo's values count from the pose in the file, at which a value may be other than 0.
        "offset": -float(compiled.qpos0[compiled.jnt_qposadr[joint]]),
    }


def _shape(compiled: Any, path: Path, links: list[str], geom: int) -> tuple[int, str, Any]:
    """The link of a geom, its name in messages, and its points in the link's frame."""
    link = int(compiled.geom_bodyid[geom])
    where = f"body {links[link]!r}, {_mjmodel.name_of(compiled, geom)} ({path.name})"
    pose = _pose(compiled.geom_pos[geom], compiled.geom_quat[geom])
    points = _mjmodel.points_of(compiled, geom) @ pose[:3, :3].T + pose[:3, 3]
    return link, where, _mesh.Points.of(np.ascontiguousarray(points), where)


def _pose(position: Any, quaternion: Any = (1.0, 0, 0, 0)) -> Floats:
    """A homogeneous matrix of a position and a quaternion in the order w, x, y, z."""
    w, x, y, z = np.asarray(quaternion) / np.linalg.norm(quaternion)
    result = np.eye(4)
    result[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    result[:3, 3] = position
    return result

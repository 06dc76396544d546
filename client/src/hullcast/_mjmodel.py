"""The collision geometry of a MuJoCo model: its shapes, and which of them MuJoCo lets meet."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _arguments, _primitives, _shapes
from ._arrays import Floats, Indices
from ._errors import InvalidArgument

#: The versions of MuJoCo with which this package is tested.
_VERSION = "4.0."

#: MuJoCo's numbers of the types of geoms that have a hull here (`mjtGeom`).
PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = 0, 2, 3, 4, 5, 6, 7
_NAMES = {1: "a height field", 8: "a signed distance field"}

#: A plane is infinite in MuJoCo. Here it is the upper face of a box that reaches this many times
#: the model's extent to each side, and as far down.
_PLANE = 100.0


def library(purpose: str) -> Any:
    """The module `mujoco`.

    Raises:
        ImportError: it is not installed, or has a version whose data this package cannot read.
    """
    try:
        mujoco: Any = importlib.import_module("mujoco")
    except ImportError as error:
        raise ImportError(
            f"{purpose} needs mujoco: pip install './client[mujoco]' in the clone"
        ) from error
    version = str(mujoco.__version__)
    if not version.startswith(_VERSION):
        raise ImportError(
            f"{purpose} needs mujoco {_VERSION}*, and {version} is installed: "
            "pip install './client[mujoco]' in the clone"
        )
    return mujoco


def colliding(model: Any) -> npt.NDArray[np.intp]:
    """The indices of the geoms that can be in a contact, ascending."""
    named = np.zeros(model.ngeom, dtype=bool)
    named[model.pair_geom1] = True
    named[model.pair_geom2] = True
    return np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0) | named)


def name_of(model: Any, geom: int) -> str:
    """A geom as messages name it."""
    name = model.geom(geom).name
    return f"geom {name!r}" if name else f"geom {geom}"


def points_of(model: Any, geom: int) -> Floats:
    """The points of a geom's hull, in the geom's frame.

    Raises:
        InvalidArgument: UNSUPPORTED_SHAPE.
    """
    kind = int(model.geom_type[geom])
    size = [float(length) for length in model.geom_size[geom]]
    if kind == BOX:
        return _primitives.box(2 * np.array(size))
    if kind == MESH:
        return _mesh_points(model, int(model.geom_dataid[geom]))
    if kind == SPHERE:
        return _primitives.sphere(size[0])
    if kind == ELLIPSOID:
        return _primitives.sphere(1.0) * size
    if kind == CYLINDER:
        return _primitives.cylinder(size[0], 2 * size[1])
    if kind == CAPSULE:
        return _shapes.capsule(size[0], 2 * size[1]).vertices
    if kind == PLANE:
        reach = _PLANE * float(model.stat.extent)
        return _primitives.box(np.full(3, 2 * reach)) - [0, 0, reach]
    raise InvalidArgument(
        f"{name_of(model, geom)} is {_NAMES.get(kind, f'of type {kind}')}, expected planes, "
        "spheres, capsules, ellipsoids, cylinders, boxes and meshes: give the other geoms as geoms",
        reason="UNSUPPORTED_SHAPE",
        field="model",
    )


def _mesh_points(model: Any, mesh: int) -> Floats:
    """The vertices of the convex hull with which MuJoCo collides a mesh."""
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    points = np.array(model.mesh_vert[first : first + count], dtype=np.float64)
    graph = int(model.mesh_graphadr[mesh])
    if graph < 0:  # the model was compiled without its hull
        return points
    hull = int(model.mesh_graph[graph])
    return points[model.mesh_graph[graph + 2 + hull : graph + 2 + 2 * hull]]


def shapes(model: Any, geoms: Sequence[int]) -> tuple[list[Floats], Indices]:
    """The distinct shapes of some geoms, and for each geom its shape, as an index into them.

    Raises:
        InvalidArgument: UNSUPPORTED_SHAPE.
    """
    place: dict[Any, int] = {}
    found: list[Floats] = []
    of_geoms: list[int] = []
    for geom in geoms:
        kind = int(model.geom_type[geom])
        size = tuple(model.geom_size[geom]) if kind != MESH else (int(model.geom_dataid[geom]),)
        key = (kind, size)
        if key not in place:
            place[key] = len(found)
            found.append(points_of(model, geom))
        of_geoms.append(place[key])
    return found, np.array(of_geoms, dtype="<u4")


class Filter:
    """MuJoCo's own rule for which geoms may meet, as groups for `Scene`.

    Two geoms meet if their bits of `contype` and `conaffinity` match, unless their bodies are
    welded to each other, are parent and child, or are excluded. Bodies that are welded to the world
    meet their children. Geoms of an explicit pair meet in any case.

    A group has the geoms of one body that have the same bits. A geom of an explicit pair is a group
    by itself, so that its pair can be told from those of its neighbours.
    """

    def __init__(self, mujoco: Any, model: Any, geoms: npt.NDArray[np.intp]) -> None:
        body = model.geom_bodyid[geoms]
        explicit = np.stack([model.pair_geom1, model.pair_geom2], axis=1).reshape(-1, 2)
        own = np.where(np.isin(geoms, explicit), geoms, -1)
        keys = np.stack([body, model.geom_contype[geoms], model.geom_conaffinity[geoms], own])
        rows, group = np.unique(keys.T, axis=0, return_inverse=True)
        #: (geoms,): the group of each geom, from 0.
        self.group: npt.NDArray[np.intp] = group.reshape(-1)
        #: (groups, groups): whether the geoms of two groups may meet.
        self.meets: npt.NDArray[np.bool_] = _meet(mujoco, model, rows)
        of_geom = dict(zip(geoms.tolist(), self.group.tolist(), strict=True))
        for a, b in explicit.tolist():
            if a in of_geom and b in of_geom:
                self.meets[of_geom[a], of_geom[b]] = self.meets[of_geom[b], of_geom[a]] = True
        np.fill_diagonal(self.meets, False)

    @property
    def groups(self) -> Indices:
        """(geoms,): the group of each geom, as `Scene` takes them."""
        return (self.group + 1).astype("<u4")

    @property
    def ignored_groups(self) -> Indices:
        """(k, 2): the pairs of groups whose geoms never meet, as `Scene` takes them."""
        return np.argwhere(np.triu(~self.meets, 1)).astype("<u4") + np.uint32(1)


def _meet(mujoco: Any, model: Any, rows: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Whether two groups may meet, by the rule for pairs that the model does not name."""
    body, types, affinities = rows[:, 0], rows[:, 1], rows[:, 2]
    bits = (types[:, None] & affinities) != 0
    meets = bits | bits.T
    weld = model.body_weldid[body]
    meets &= weld[:, None] != weld
    if not int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
        above = model.body_weldid[model.body_parentid[weld]]
        movable = weld != 0
        child = (weld[:, None] == above) & movable[:, None] & movable
        meets &= ~(child | child.T)
    low, high = np.minimum(body[:, None], body), np.maximum(body[:, None], body)
    meets &= ~np.isin(low.astype(np.int64) << 16 | high, model.exclude_signature)
    return meets


def check_model(mujoco: Any, field: str, model: Any) -> None:
    """Raises InvalidArgument if `model` is not a compiled model of MuJoCo."""
    _arguments.instance(field, model, mujoco.MjModel, "a mujoco.MjModel")


def check_data(mujoco: Any, model: Any, data: Any) -> None:
    """Raises InvalidArgument if `data` is not the state of `model`."""
    _arguments.instance("data", data, mujoco.MjData, "a mujoco.MjData")
    if len(data.geom_xpos) != model.ngeom or len(data.qpos) != model.nq:
        raise InvalidArgument(
            f"got data of {_arguments.counted(len(data.geom_xpos), 'geom')} and "
            f"{_arguments.counted(len(data.qpos), 'coordinate')}, expected the data of this model, "
            f"with {model.ngeom} and {model.nq}: mujoco.MjData(model)",
            reason="LENGTH_MISMATCH",
            field="data",
        )

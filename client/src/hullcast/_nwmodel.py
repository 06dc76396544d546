"""The collision geometry of a Newton model: its shapes, their poses, and which of them may meet."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _mesh, _primitives, _shapes
from ._arrays import Floats
from ._errors import InvalidArgument

#: The versions of Newton with which this package is tested.
_VERSION = "1.8."

#: Newton's numbers of the types of shapes that have a hull here (`newton.GeoType`).
_PLANE, _SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX, _MESH, _CONE, _CONVEX = (
    1, 3, 4, 5, 6, 7, 8, 9, 10,
)  # fmt: skip
_NAMES = {0: "empty", 2: "a height field", 11: "a Gaussian splat"}


def library() -> Any:
    """The module `newton`.

    Raises:
        ImportError: it is not installed, or has a version whose data this package cannot write.
    """
    try:
        newton: Any = importlib.import_module("newton")
    except ImportError as error:
        raise ImportError(
            "hullcast.newton needs newton: pip install './client[newton]' in the clone"
        ) from error
    version = str(newton.__version__)
    if not version.startswith(_VERSION):
        raise ImportError(
            f"hullcast.newton needs newton {_VERSION}*, and {version} is installed: "
            "pip install './client[newton]' in the clone"
        )
    return newton


def shape_of(model: Any, shape: int, reach: float) -> Any:
    """The points of a shape in its own frame, or a mesh; a plane is a box of this half size.

    Raises:
        InvalidArgument: UNSUPPORTED_SHAPE.
    """
    kind = int(model.shape_type.numpy()[shape])
    scale = model.shape_scale.numpy()[shape].astype(np.float64)
    first, second = float(scale[0]), float(scale[1])
    if kind == _BOX:
        return _primitives.box(2 * scale)
    if kind in (_MESH, _CONVEX):
        source = model.shape_source[shape]
        points = np.asarray(source.vertices, dtype=np.float64).reshape(-1, 3) * scale
        faces = np.asarray(source.indices).reshape(-1, 3).astype("<u4")
        return points if kind == _CONVEX else _mesh.Mesh(points, faces, name_of(model, shape))
    if kind == _SPHERE:
        return _primitives.sphere(first)
    if kind == _ELLIPSOID:
        return _primitives.sphere(1.0) * scale
    if kind == _CAPSULE:
        return _shapes.capsule(first, 2 * second).vertices
    if kind == _CYLINDER and scale[2] == 0:
        return _primitives.cylinder(first, 2 * second)
    if kind == _CONE:
        disc = _primitives.cylinder(first, 2 * second)
        return np.concatenate([disc[disc[:, 2] < 0], [[0.0, 0.0, second]]])
    if kind == _PLANE:
        half = np.array([first if first > 0 else reach, second if second > 0 else reach, reach])
        return _primitives.box(2 * half) - [0, 0, reach]
    what = "a barrel" if kind == _CYLINDER else _NAMES.get(kind, f"of type {kind}")
    raise InvalidArgument(
        f"{name_of(model, shape)} is {what}, expected planes, spheres, capsules, ellipsoids, "
        "cylinders, cones, boxes and meshes: let it collide with no shape",
        reason="UNSUPPORTED_SHAPE",
        field="model",
    )


def name_of(model: Any, shape: int) -> str:
    """A shape as messages name it."""
    labels = getattr(model, "shape_label", None)
    return f"shape {shape} ({labels[shape]})" if labels else f"shape {shape}"


def distinct(model: Any, chosen: Sequence[int], reach: float) -> tuple[list[Any], list[int]]:
    """The distinct shapes among some, and for each its place among them.

    Raises:
        InvalidArgument: UNSUPPORTED_SHAPE.
    """
    kinds, scales = model.shape_type.numpy(), model.shape_scale.numpy()
    place: dict[Any, int] = {}
    found: list[Any] = []
    of_shapes: list[int] = []
    for shape in chosen:
        source = model.shape_source[shape]
        key = (int(kinds[shape]), tuple(scales[shape].tolist()), id(source) if source else 0)
        if key not in place:
            place[key] = len(found)
            found.append(shape_of(model, shape, reach))
        of_shapes.append(place[key])
    return found, of_shapes


def candidates(model: Any) -> npt.NDArray[np.int64]:
    """(k, 2): the pairs of shapes that may meet, each with the lower shape first."""
    pairs = model.shape_contact_pairs
    if pairs is None:
        return np.zeros((0, 2), dtype=np.int64)
    return np.sort(pairs.numpy().astype(np.int64).reshape(-1, 2), axis=1)


def poses(
    bodies: npt.NDArray[Any], of_shapes: npt.NDArray[np.intp], local: Floats
) -> tuple[Floats, Floats]:
    """The world positions and quaternions of shapes, from those of their bodies.

    Args:
        bodies: (bodies, 7), positions and quaternions x, y, z, w of any precision.
        of_shapes: (shapes,), each shape's body; -1 is the world.
        local: (shapes, 7), the pose of each shape in its body, with a unit quaternion.
    """
    still = np.array([[0, 0, 0, 0, 0, 0, 1.0]])
    world = np.concatenate([np.asarray(bodies, dtype=np.float64).reshape(-1, 7), still])[of_shapes]
    turn = world[:, 3:] / np.linalg.norm(world[:, 3:], axis=1, keepdims=True)
    vector, scalar = turn[:, :3], turn[:, 3:]
    at, inner, last = local[:, :3], local[:, 3:6], local[:, 6:]
    crossed: Any = 2.0 * np.cross(vector, at)
    positions = world[:, :3] + at + scalar * crossed + np.cross(vector, crossed)
    both: Any = np.cross(vector, inner)
    dot = (vector * inner).sum(axis=1, keepdims=True)
    return positions, np.hstack([scalar * inner + last * vector + both, scalar * last - dot])

"""Reads meshes from files, and checks whether meshes are convex."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import _arrays, _convexity, _files
from ._arrays import Floats, Indices
from ._errors import InvalidArgument, NotConvexWarning, warn
from ._formats import _common, dae, obj, ply, stl

_READERS = {".dae": dae.read, ".obj": obj.read, ".ply": ply.read, ".stl": stl.read}


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh, with the two attributes of trimesh's meshes that this package uses."""

    #: (n, 3)
    vertices: Floats
    #: (m, 3): indices of vertices.
    faces: Indices
    #: The mesh's name in messages, such as "link 'hand', collision 0 (hand.stl)"; may be empty.
    label: str = ""


class Points(np.ndarray[Any, np.dtype[np.float64]]):
    """Points (n, 3) with a name in messages, such as "link 'hand', collision 0 (robot.urdf)"."""

    label: str = ""

    @classmethod
    def of(cls, points: Floats, label: str) -> Points:
        """A view of an array, with a name."""
        named = points.view(cls)
        named.label = label
        return named

    def __array_finalize__(self, source: Any) -> None:
        self.label = getattr(source, "label", "")

    def __reduce__(self) -> Any:
        return Points.of, (self.view(np.ndarray), self.label)


def load(path: str | os.PathLike[str], field: str = "") -> Mesh:
    """Reads the triangles of an OBJ, STL, DAE or PLY file, with all its parts as one mesh.

    Equal vertices are merged. Vertices that no triangle uses are left out. `field` is the argument
    that names the file, for messages.

    Raises:
        FileNotFound: the file does not exist.
        InvalidArgument: UNSUPPORTED_MESH, an unknown format or a feature that is not read;
            MALFORMED_MESH; NO_TRIANGLES; NOT_A_PATH; UNREADABLE_FILE, a directory, a pipe, a device
            or a file without permission.
    """
    name = _files.path_of(field, path, "the path of a mesh file")
    file = Path(name)
    data = _files.read(field, name)
    reader = _READERS.get(file.suffix.lower())
    if reader is None:
        raise InvalidArgument(
            f"{name}: mesh files are OBJ, STL, DAE or PLY, by their suffix; convert the file, or "
            "load it with another library and pass its vertices and faces",
            reason="UNSUPPORTED_MESH",
            field=field,
        )
    if not data:
        raise InvalidArgument(f"{name} is empty", reason="MALFORMED_MESH", field=field)
    other = _common.other_kind(data, file.suffix.lower())
    try:
        points, faces = reader(data)
    except _common.Unreadable as error:
        text = f"{name} {other}" if other else f"{name}: {error}"
        raise InvalidArgument(text, reason=error.reason, field=field) from None
    if faces.size == 0:
        text = f"{name} {other or 'has no triangles'}"
        raise InvalidArgument(text, reason="NO_TRIANGLES", field=field)
    kept, first, place = np.unique(
        points[faces.reshape(-1)], axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)  # keep the vertices in the order of their first use
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return Mesh(kept[order], rank[place.reshape(-1)].reshape(-1, 3).astype("<u4"), file.name)


def dents(name: str, points: Floats, faces: Any) -> _convexity.Dents | None:
    """How a mesh differs from its convex hull; None if it is convex or has no faces."""
    if faces is None or np.size(faces) == 0 or len(points) == 0 or not np.isfinite(points).all():
        return None
    corners = _arrays.indices(f"{name}.faces", faces, None, 3, below=len(points))
    return _convexity.dents(points, corners)


def warn_of_dents(field: str, label: str, found: _convexity.Dents) -> None:
    """Warns that a hull is not the shape of the mesh from which it was made."""
    what = "is not convex"
    if found.open_edges:
        what = f"is not watertight ({found.open_edges} open edges), or not convex"
    warning = NotConvexWarning(
        f"{label or field} {what}: it fills {found.ratio:.3f} of its convex hull, "
        "which is registered in its place",
        field,
        found.ratio,
        found.open_edges,
    )
    warn(warning)

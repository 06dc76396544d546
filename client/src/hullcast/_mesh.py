"""Meshes: read from files, and judged for being convex."""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _arrays
from ._arrays import Floats, Indices
from ._errors import InvalidArgument, NotConvexWarning, warn

#: A mesh that fills less of its hull than this is not convex. Modelling and
#: single precision cost real convex meshes some 1e-3; a visible dent is more.
CONVEX_RATIO = 0.99

#: Vertices closer than this, relative to the mesh's size, are one: files have
#: single precision, or a few digits.
_WELD = 1e-6


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles, as trimesh's to the two attributes used."""

    #: (n, 3)
    vertices: Floats
    #: (m, 3): indices of vertices.
    faces: Indices


@dataclass(frozen=True)
class Volume:
    """What a mesh encloses."""

    #: Meaningless up to a point where edges are open.
    volume: float
    #: Edges that do not join two faces of one orientation.
    open_edges: int


def load(path: str | os.PathLike[str]) -> Mesh:
    """A mesh file's triangles, all its parts as one; equal vertices are one.

    OBJ, STL, and whatever else the installed trimesh reads.

    Raises:
        InvalidArgument: NO_TRIANGLES.
        ImportError: the extra `mesh` is not installed.
        OSError: the file cannot be read.
    """
    try:
        import trimesh as library
    except ImportError as error:
        raise ImportError("mesh files need trimesh: pip install 'hullcast[mesh]'") from error
    if not Path(path).exists():
        raise FileNotFoundError(os.fspath(path))
    trimesh: Any = library
    loaded = trimesh.load_mesh(os.fspath(path), process=False)
    faces: npt.NDArray[Any] = np.asarray(getattr(loaded, "faces", ()))
    if faces.size == 0:
        raise InvalidArgument(f"no triangles in {os.fspath(path)}", reason="NO_TRIANGLES")
    # trimesh's own merging has an absolute tolerance.
    points, first, place = np.unique(
        np.asarray(loaded.vertices, dtype="<f8"), axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)  # the file's
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return Mesh(points[order], rank[place.reshape(-1)][faces].astype("<u4"))


def closed(name: str, points: Floats, faces: Any) -> Volume | None:
    """What the mesh of these faces encloses; None where there are none."""
    if faces is None or np.size(faces) == 0 or len(points) == 0 or not np.isfinite(points).all():
        return None
    corners = _arrays.indices(f"{name}.faces", faces, None, 3, below=len(points)).astype(np.int64)
    origin = points.mean(axis=0)
    a, b, c = (points[corners[:, i]] - origin for i in range(3))
    volume = float(np.einsum("ni,ni->", a, np.cross(b, c))) / 6
    _, welded = np.unique(points, axis=0, return_inverse=True)
    open_edges = _open_edges(welded.reshape(-1)[corners])
    if open_edges:
        open_edges = _open_edges(_welded(points - origin)[corners])
    return Volume(volume, open_edges)


def _open_edges(corners: npt.NDArray[np.int64]) -> int:
    """Sides that are not walked as often one way as the other."""
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    low, high = sides.min(axis=1), sides.max(axis=1)
    _, edge = np.unique(low * (corners.max() + 1) + high, return_inverse=True)
    # A side from a vertex to itself counts for nothing.
    balance = np.bincount(edge.reshape(-1), weights=np.sign(sides[:, 1] - sides[:, 0]))
    return int(np.abs(balance).sum())


def _welded(points: Floats) -> npt.NDArray[np.int64]:
    """Per point a number, the same for points within the tolerance of each other.

    Such points share a cell in at least one of eight grids that are half a cell
    apart; whatever shares a cell gets the cell's lowest number, until all agree.
    """
    cell = 2 * _WELD * (float(np.ptp(points, axis=0).max()) or 1.0)
    shifts = itertools.product((0.0, 0.5), repeat=3)
    grids = [
        np.unique(np.floor(points / cell + shift), axis=0, return_inverse=True)[1].reshape(-1)
        for shift in shifts
    ]
    number = np.arange(len(points))
    while True:
        before = number
        for cells in grids:
            lowest = np.full(len(points), len(points))
            np.minimum.at(lowest, cells, number)
            number = lowest[cells]
        if (number == before).all():
            return number


def fills(mesh: Volume, hull_volume: float) -> bool:
    """Whether a mesh is as good as its convex hull: closed, and of its volume."""
    # A mesh turned inside out is no less convex.
    return mesh.open_edges == 0 and abs(mesh.volume) >= CONVEX_RATIO * hull_volume


def warn_unless_convex(name: str, mesh: Volume, hull_volume: float) -> None:
    """Says so where a hull is not what the mesh is."""
    if fills(mesh, hull_volume):
        return
    ratio = abs(mesh.volume) / hull_volume
    if mesh.open_edges:
        what = f"is not watertight ({mesh.open_edges} open edges)"
    else:
        what = "is not convex"
    warning = NotConvexWarning(
        f"{name} {what}: it fills {ratio:.3f} of its convex hull, which is registered in its place",
        name,
        ratio,
        mesh.open_edges,
    )
    warn(warning)

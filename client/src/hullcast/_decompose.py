"""Convex pieces of meshes that are not convex, by coacd, kept once made."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import io
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from . import _arrays, _mesh
from ._arrays import Floats
from ._register import shape_of

#: Of coacd's search: the same mesh gives the same pieces.
_SEED = 0


def decompose(
    mesh: Any, *, threshold: float = 0.05, cache: str | os.PathLike[str] | None = None
) -> list[Floats]:
    """Convex pieces that together approximate a mesh, by coacd (extra `decompose`).

    They are to be registered one by one, and given one group in a `Scene`, since
    they overlap a little. Finding them takes seconds to minutes; what was found
    is kept in files named by the mesh's content, and read again.

    Args:
        mesh: an object with `.vertices` (n, 3) and `.faces` (m, 3), as trimesh's,
            or the path of a mesh file (extra `mesh`).
        threshold: how concave a piece may remain, 0.01 to 1, coacd's measure:
            smaller means more pieces.
        cache: the folder kept in; by default what the environment variable
            HULLCAST_CACHE names, else `hullcast` in the user's cache folder.

    Returns:
        Per piece its vertices (k, 3), in the mesh's frame.

    Raises:
        InvalidArgument: faces that fit no vertex.
        ImportError: the extra `decompose` is not installed.
    """
    try:
        import coacd as library
    except ImportError as error:
        raise ImportError("decompose needs coacd: pip install 'hullcast[decompose]'") from error
    shape = shape_of(mesh)
    vertices = _arrays.floats("mesh.vertices", shape.vertices, None, 3)
    faces = _arrays.indices("mesh.faces", shape.faces, None, 3, below=len(vertices))
    parameters = f"coacd {importlib.metadata.version('coacd')} {threshold!r} {_SEED}"
    name = hashlib.sha256(b"\0".join([parameters.encode(), vertices.tobytes(), faces.tobytes()]))
    file = _folder(cache) / f"{name.hexdigest()}.npz"
    try:
        with np.load(file, allow_pickle=False) as kept:
            return [np.asarray(kept[f"piece{i}"], dtype="<f8") for i in range(len(kept.files))]
    except FileNotFoundError:
        pass
    coacd: Any = library
    coacd.set_log_level("error")
    found = coacd.run_coacd(coacd.Mesh(vertices, faces), threshold=threshold, seed=_SEED)
    pieces = [np.ascontiguousarray(piece, dtype="<f8") for piece, _ in found]
    with contextlib.suppress(OSError):  # a folder that cannot be written costs only time
        _write(file, pieces)
    return pieces


def is_convex(vertices: Floats, faces: Any) -> bool:
    """By the volume ratio, as `register` judges; a mesh with open edges is not."""
    from scipy.spatial import ConvexHull

    enclosed = _mesh.closed("mesh", vertices, faces)
    return enclosed is None or _mesh.fills(enclosed, float(ConvexHull(vertices).volume))


def _folder(cache: str | os.PathLike[str] | None) -> Path:
    named = cache or os.environ.get("HULLCAST_CACHE")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "hullcast")


def _write(file: Path, pieces: list[Floats]) -> None:
    """Whole or not at all: other processes may read and write the same."""
    data = io.BytesIO()
    columns: dict[str, Any] = {f"piece{i}": piece for i, piece in enumerate(pieces)}
    np.savez(data, **columns)
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=file.parent, delete=False) as scratch:
        scratch.write(data.getvalue())
    os.replace(scratch.name, file)

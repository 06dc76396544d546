"""Decomposes meshes that are not convex into convex pieces, by coacd, and caches the result."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import io
import os
import sys
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from . import _arrays, _convexity, _files
from ._arguments import is_real, kind, plain, shown
from ._arrays import Floats, Indices
from ._errors import InvalidArgument, NotCachedWarning, warn
from ._hulls import faces_of
from ._register import shape_of

#: The seed of coacd's search. It is fixed, so that a mesh always gives the same pieces.
_SEED = 0


#: A mesh of at most this many separate convex parts is split into these parts exactly.
_MOST_PARTS = 64
#: The smallest and the largest threshold that coacd accepts.
_THRESHOLDS = (0.01, 1.0)


@dataclass(frozen=True)
class Progress:
    """The state of a decomposition, for a progress report."""

    #: The mesh's file, or its link and file.
    mesh: str
    #: The number of this mesh, from 1 to `total`.
    number: int
    total: int
    #: "computing" before the search for pieces and "computed" after it; or "cached".
    state: str

    def __str__(self) -> str:
        return f"convex pieces of {self.mesh}, {self.number} of {self.total}: {self.state}"


#: A function that is called with each `Progress`. None prints each as a line on standard error, if
#: that is a terminal or the output of a notebook's cell.
Report = Callable[[Progress], object] | None


def decompose(
    mesh: Any,
    *,
    threshold: float = 0.05,
    cache: str | os.PathLike[str] | None = None,
    progress: Report = None,
) -> list[Floats]:
    """Decomposes a mesh into convex pieces that approximate it, by coacd (extra `decompose`).

    A mesh that consists of separate convex parts, which may overlap, is split into exactly these
    parts. This does not need coacd.

    Register each piece as a hull, and give all pieces one group in a `Scene`, because the pieces
    overlap a little. The search takes seconds to minutes. Its result is cached in a file, named by
    a hash of the mesh, and read from there the next time.

    Args:
        mesh: an object with `.vertices` (n, 3) and `.faces`, `.triangles` or `.indices` (m, 3), for
            example a mesh of trimesh or open3d; or the path of an OBJ, STL, DAE or PLY file.
        threshold: how concave a piece may remain, 0.01 to 1, in coacd's measure. A smaller
            threshold gives more pieces.
        cache: the folder of the cached results. By default the environment variable HULLCAST_CACHE
            names it; otherwise it is `hullcast` in the user's cache folder.
        progress: a function that is called with a record of each step. The record has the
            attributes `mesh`, `number`, `total` and `state`, and `str(record)` is a line to print.
            By default these lines are printed on standard error, if that is a terminal or the
            output of a notebook's cell.

    Returns:
        The vertices (k, 3) of each piece, in the mesh's frame.

    Raises:
        InvalidArgument: NOT_A_MESH, NO_TRIANGLES, COPLANAR, NOT_FINITE, NO_PIECES, or OUT_OF_RANGE
            for the threshold; for a file, as `Client.register`.
        FileNotFound: the file does not exist.
        ImportError: the extra `decompose` is not installed.
    """
    check_threshold(threshold)
    if _files.is_open_file(mesh):
        _files.path_of("mesh", mesh, "the path of a mesh file")
    (pieces,) = decompose_all(
        [shape_of(mesh, "mesh")], threshold=threshold, cache=cache, progress=progress
    )
    return pieces


def decompose_all(
    meshes: Sequence[Any],
    *,
    threshold: float,
    cache: str | os.PathLike[str] | None,
    progress: Report,
) -> list[list[Floats]]:
    """The pieces of each mesh; arguments and errors are those of `decompose`."""
    if progress is not None and not callable(progress):
        raise InvalidArgument(
            f"expected a function or None, got {kind(progress)}",
            reason="WRONG_TYPE",
            field="progress",
        )
    if cache is not None:
        cache = _files.path_of("cache", cache, "the path of a folder")
    report = progress or _print
    found: list[list[Floats]] = []
    for number, mesh in enumerate(meshes, start=1):
        label = getattr(mesh, "label", "") or "the mesh"
        if not hasattr(mesh, "vertices"):
            raise InvalidArgument(
                "expected an object with vertices and faces, or the path of a mesh file, got "
                f"{type(mesh).__name__}",
                reason="NOT_A_MESH",
                field="mesh",
            )
        vertices = _arrays.floats("mesh.vertices", mesh.vertices, None, 3)
        attribute, corners = faces_of(mesh)
        corners = () if corners is None else corners
        faces = _arrays.indices(f"mesh.{attribute}", corners, None, 3, below=len(vertices))
        if len(faces) == 0:
            raise InvalidArgument(f"{label} has no triangles", reason="NO_TRIANGLES", field="mesh")
        if not np.isfinite(vertices).all():
            raise InvalidArgument(
                f"{label} has a coordinate that is not finite", reason="NOT_FINITE", field="mesh"
            )
        if _convexity.is_flat(vertices):
            raise InvalidArgument(
                f"{label} is flat: all its points are in one plane", reason="COPLANAR", field="mesh"
            )
        report_state = partial(_report, report, label, number, len(meshes))
        found.append(_pieces(label, vertices, faces, threshold, cache, report_state))
    return found


def check_threshold(threshold: Any) -> None:
    """Raises InvalidArgument if coacd does not accept the threshold."""
    low, high = _THRESHOLDS
    threshold = plain(threshold)
    if not is_real(threshold) or not low <= threshold <= high:
        raise InvalidArgument(
            f"got {shown(threshold)}, expected a number, {low:g} to {high:g}",
            reason="VALUE_OUT_OF_RANGE",
            field="threshold",
        )


def _report(report: Callable[[Progress], object], mesh: str, n: int, of: int, state: str) -> None:
    report(Progress(mesh, n, of, state))


def _print(progress: Progress) -> None:
    if sys.stderr is not None and (sys.stderr.isatty() or _in_notebook()):
        print(progress, file=sys.stderr, flush=True)


def _in_notebook() -> bool:
    """Whether IPython runs this code, which shows standard error although it is no terminal."""
    ipython: Any = sys.modules.get("IPython")
    return ipython is not None and ipython.get_ipython() is not None


def _pieces(
    label: str,
    vertices: Floats,
    faces: Indices,
    threshold: float,
    cache: str | os.PathLike[str] | None,
    report: Callable[[str], None],
) -> list[Floats]:
    """The pieces of one mesh: its parts if they are convex; otherwise those of coacd, cached."""
    parts = _convexity.convex_parts(vertices, faces, _MOST_PARTS)
    if parts is not None:
        report("computed")
        return parts
    try:
        import coacd as library
    except ImportError as error:
        raise ImportError(
            "decomposing meshes needs coacd: install the extra `decompose` "
            "(pip install './client[decompose]' in the clone), or pass decompose=False to Robot"
        ) from error
    parameters = f"coacd {importlib.metadata.version('coacd')} {float(threshold)!r} {_SEED}"
    name = hashlib.sha256(b"\0".join([parameters.encode(), vertices.tobytes(), faces.tobytes()]))
    file = _folder(cache) / f"{name.hexdigest()}.npz"
    # A cache file that is truncated or malformed is computed again.
    with contextlib.suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        if not file.is_file():  # reading a pipe could wait for ever
            raise FileNotFoundError
        with np.load(file, allow_pickle=False) as kept:
            pieces = [
                _arrays.floats("piece", kept[f"piece{i}"], None, 3) for i in range(len(kept.files))
            ]
        if pieces:
            report("cached")
            return pieces
    report("computing")
    coacd: Any = library
    coacd.set_log_level("error")
    found = coacd.run_coacd(coacd.Mesh(vertices, faces), threshold=float(threshold), seed=_SEED)
    pieces = [np.ascontiguousarray(piece, dtype="<f8") for piece, _ in found]
    pieces = [piece for piece in pieces if not _convexity.is_flat(piece)]
    if not pieces:
        raise InvalidArgument(
            f"coacd found no convex pieces of {label}", reason="NO_PIECES", field="mesh"
        )
    try:
        _write(file, pieces)
    except OSError as error:
        warn(
            NotCachedWarning(
                f"the convex pieces cannot be kept in {file.parent} ({error.strerror}), and will "
                "be computed again: give cache= or HULLCAST_CACHE a folder that can be written to"
            )
        )
    report("computed")
    return pieces


def _folder(cache: str | os.PathLike[str] | None) -> Path:
    named = cache or os.environ.get("HULLCAST_CACHE")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "hullcast")


def _write(file: Path, pieces: list[Floats]) -> None:
    """Writes a cache file atomically, because other processes may read or write the same file."""
    data = io.BytesIO()
    columns: dict[str, Any] = {f"piece{i}": piece for i, piece in enumerate(pieces)}
    np.savez(data, **columns)
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=file.parent, delete=False) as scratch:
        scratch.write(data.getvalue())
    os.replace(scratch.name, file)

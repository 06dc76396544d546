"""Shared by all readers: their error, numbers, and the triangulation of polygons."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence

import numpy as np

from .._arrays import Floats, Indices

#: The largest number of corners of a polygon that is not convex, because the time to triangulate it
#: grows with the square.
_MOST_CORNERS = 2000


class Unreadable(Exception):
    """The reason why no mesh can be read from a file.

    Attributes:
        reason: MALFORMED_MESH, or UNSUPPORTED_MESH for a feature that is not read.
    """

    def __init__(self, message: str, reason: str = "MALFORMED_MESH") -> None:
        super().__init__(message)
        self.reason = reason


def unsupported(message: str) -> Unreadable:
    """The error for a well-formed file with a feature that is not read."""
    return Unreadable(message, "UNSUPPORTED_MESH")


def text_of(data: bytes, kind: str) -> str:
    """The text of a file; raises Unreadable if the data is binary."""
    if b"\0" in data:
        raise Unreadable(f"the file is binary, but {kind} is text")
    return data.decode("utf-8-sig", errors="replace")


#: The beginnings of files of known content, and what to call the content.
_BEGINNINGS = (
    (b"version https://git-lfs", "a pointer of Git LFS, not the file itself: run `git lfs pull`"),
    (b"ply", ".ply"),
    (b"glTF", "a glTF file"),
    (b"ISO-10303", "a STEP file"),
    (b"PK\x03\x04", "a zip archive: unpack it"),
    (b"\x1f\x8b", "a gzip archive: unpack it"),
    (b"<!DOCTYPE html", "a page of HTML: a download may have failed"),
    (b"<html", "a page of HTML: a download may have failed"),
    (b"<robot", "a URDF file: give it to hullcast.Robot"),
    (b"<mujoco", "an MJCF file"),
    (b"<sdf", "an SDF file"),
)


def other_kind(data: bytes, suffix: str) -> str:
    """The kind of a file that cannot be read, if its content does not fit its suffix; or ""."""
    start = data[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
    found = next((what for first, what in _BEGINNINGS if start.startswith(first)), "")
    if not found and b"<COLLADA" in start:
        found = ".dae"
    if not found and start[:5].lower() == b"solid" and b"\0" not in start:
        found = ".stl"
    if not found and b"\0" not in start:
        lines = [line.split() for line in start.splitlines()]
        words = [line[0] for line in lines if line and not line[0].startswith(b"#")]
        # The last word may be cut.
        if b"v" in words and set(words[:-1]) <= _OBJ_WORDS:
            found = ".obj"
    if found in ("", suffix):
        return ""
    if found.startswith("."):
        return f"has the suffix {suffix}, but its content is {_NAMES[found]}: rename it to {found}"
    return f"is {found}"


_NAMES = {".obj": "OBJ", ".ply": "PLY", ".dae": "COLLADA", ".stl": "STL as text"}
_OBJ_WORDS = {
    b"v", b"vn", b"vt", b"vp", b"f", b"l", b"p", b"o", b"g", b"s", b"mtllib", b"usemtl",
}  # fmt: skip


def number(word: str, where: str) -> float:
    """Parses a finite number, as the formats write it."""
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in word:
        raise Unreadable(f"{where}: {word!r} is not a finite number")
    return value


def arrays(
    vertices: Sequence[Sequence[float]], faces: Sequence[Sequence[int]]
) -> tuple[Floats, Indices]:
    """Converts a reader's lists to arrays: vertices (n, 3) float64, faces (m, 3) uint32."""
    return (
        np.array(vertices, dtype="<f8").reshape(-1, 3),
        np.array(faces, dtype="<u4").reshape(-1, 3),
    )


def triangles(
    polygon: Sequence[int], vertices: Sequence[Sequence[float]]
) -> Iterable[tuple[int, int, int]]:
    """Cuts a simple polygon, convex or not, into triangles, by cutting off ears.

    Args:
        polygon: indices of vertices, in order around the polygon.
        vertices: the points; there may be more than the polygon uses.
    """
    corners = list(polygon)
    if len(corners) == 3:
        return [(corners[0], corners[1], corners[2])]
    points = np.array([vertices[i] for i in corners], dtype=np.float64)
    # Newell's normal. The polygon is projected along the axis of its largest component.
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    x, y = ((1, 2), (2, 0), (0, 1))[axis]
    flat = points[:, [x, y]] if normal[axis] >= 0 else points[:, [y, x]]
    before, after = np.roll(flat, 1, axis=0), np.roll(flat, -1, axis=0)
    if (_turns(before, flat, after) >= 0).all():
        return [(corners[0], b, c) for b, c in itertools.pairwise(corners[1:])]
    if len(corners) > _MOST_CORNERS:
        raise unsupported(
            f"a polygon that is not convex has {len(corners)} corners; at most "
            f"{_MOST_CORNERS} are read"
        )
    left = list(range(len(corners)))
    found: list[tuple[int, int, int]] = []
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(flat[left], i)), 0)
        a, b, c = (left[(ear + k) % len(left)] for k in (-1, 0, 1))
        found.append((corners[a], corners[b], corners[c]))
        del left[ear]
    a, b, c = left
    found.append((corners[a], corners[b], corners[c]))
    return found


def _is_ear(outline: Floats, i: int) -> bool:
    """Whether a corner is convex and no other corner lies in its triangle."""
    a, b, c = (outline[(i + k) % len(outline)] for k in (-1, 0, 1))
    if not _turns(a, b, c) > 0:
        return False
    same = [(outline == corner).all(axis=1) for corner in (a, b, c)]
    others = outline[~np.any(same, axis=0)]
    sides = [_turns(a, b, others), _turns(b, c, others), _turns(c, a, others)]
    return not (np.min(sides, axis=0) >= 0).any()


def _turns(a: Floats, b: Floats, c: Floats) -> Floats:
    """Positive where a, b, c turn left. The arguments are single points or arrays of points."""
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (
        c[..., 0] - a[..., 0]
    )

"""OBJ: vertices and polygons as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from .._arrays import Floats, Indices
from ._common import Unreadable, arrays, number, text_of, triangles, unsupported

#: Statements that do not change the surface: names, attributes, materials, points and lines.
_IGNORED = frozenset(
    [
        "vt",
        "vn",
        "g",
        "o",
        "s",
        "mg",
        "l",
        "p",
        "mtllib",
        "usemtl",
        "usemap",
        "maplib",
        "bevel",
        "c_interp",
        "d_interp",
        "lod",
        "shadow_obj",
        "trace_obj",
    ]
)
#: Statements that are refused: free-form curves and surfaces, and includes of other files.
_REFUSED = frozenset(
    [
        "vp",
        "cstype",
        "deg",
        "bmat",
        "step",
        "curv",
        "curv2",
        "surf",
        "parm",
        "trim",
        "hole",
        "scrv",
        "sp",
        "end",
        "con",
        "ctech",
        "stech",
        "bzp",
        "bsp",
        "cdc",
        "cdp",
        "res",
        "call",
        "csh",
    ]
)


def read(data: bytes) -> tuple[Floats, Indices]:
    """The polygons of all groups and objects, cut into triangles.

    The numbers of a vertex after the third (a weight or a colour) are ignored.
    """
    vertices: list[list[float]] = []
    polygons: list[tuple[str, list[int]]] = []
    for where, words in _statements(text_of(data, "OBJ")):
        word = words[0]
        if word == "v":
            if len(words) < 4:
                raise Unreadable(f"{where}: a vertex has at least three numbers")
            vertices.append([number(value, where) for value in words[1:4]])
        elif word in ("f", "fo"):
            polygons.append((where, [_index(corner, len(vertices), where) for corner in words[1:]]))
        elif word in _REFUSED:
            raise unsupported(
                f"{where}: {word!r}: free-form geometry and included files are not read; "
                "export the mesh as polygons"
            )
        elif word not in _IGNORED:
            raise Unreadable(f"{where}: {word[:40]!r} is not a statement of OBJ")
    faces: list[tuple[int, int, int]] = []
    for where, polygon in polygons:
        _check(polygon, len(vertices), where)
        faces += triangles(polygon, vertices)
    return arrays(vertices, faces)


def _statements(text: str) -> Iterator[tuple[str, Sequence[str]]]:
    """Yields the line and the words of each statement. A backslash at a line's end continues it."""
    start, held = 1, ""
    for i, line in enumerate(text.splitlines(), start=1):
        if line.rstrip().endswith("\\") and "#" not in line:
            held += line.rstrip()[:-1] + " "
            continue
        words = (held + line).partition("#")[0].split()
        if words:
            yield f"line {start}", words
        start, held = i + 1, ""
    if held.split():
        raise Unreadable(f"line {start}: the last line ends with a backslash")


def _index(corner: str, count: int, where: str) -> int:
    """The vertex index, from 0, of a corner `v`, `v/vt`, `v//vn` or `v/vt/vn`.

    Negative indices in the file count from the last vertex so far.
    """
    try:
        given = int(corner.split("/")[0])
    except ValueError:
        raise Unreadable(f"{where}: {corner!r} is not the corner of a face") from None
    index = given - 1 if given > 0 else count + given
    if given == 0 or index < 0:
        raise Unreadable(f"{where}: vertex {given} does not exist; the first is 1")
    return index


def _check(polygon: Sequence[int], count: int, where: str) -> None:
    if len(polygon) < 3:
        raise Unreadable(f"{where}: a face has at least three corners, not {len(polygon)}")
    if max(polygon) >= count:
        raise Unreadable(f"{where}: vertex {max(polygon) + 1} does not exist; the file has {count}")

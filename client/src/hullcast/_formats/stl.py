"""STL: triangles that each have their own corners, binary or as text."""

from __future__ import annotations

import numpy as np

from .._arrays import Floats, Indices
from ._common import Unreadable, number, text_of, unsupported

_HEADER = 84
_TRIANGLE = 50


def read(data: bytes) -> tuple[Floats, Indices]:
    """The triangles of all solids. The normals are ignored.

    A file is binary if its length is the one that its header announces. The first word cannot
    decide this, because many binary files also begin with the word `solid`.
    """
    count = int.from_bytes(data[80:_HEADER], "little") if len(data) >= _HEADER else -1
    if len(data) != _HEADER + _TRIANGLE * count and _is_text(data):
        return _text(text_of(data, "such an STL file"))
    if count < 0:
        raise Unreadable(
            f"the file has {len(data)} bytes: a binary STL file has at least {_HEADER}, "
            "and a text one begins with 'solid'"
        )
    announced = _HEADER + _TRIANGLE * count
    if len(data) != announced and b"\0" not in data:
        raise Unreadable("the file is text, but an STL file as text begins with 'solid'")
    if len(data) != announced:
        more = len(data) - announced
        what = f"{more} bytes after its end" if more > 0 else f"lost its last {-more} bytes"
        raise Unreadable(
            f"the binary STL file has {what}: its header announces {count} triangles, "
            f"which are {announced} bytes, and it has {len(data)}"
        )
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = np.frombuffer(data, record, count, _HEADER)["corners"].reshape(-1, 3)
    wrong = np.flatnonzero(~np.isfinite(corners).all(axis=1))
    if wrong.size:
        raise Unreadable(f"triangle {wrong[0] // 3} has a coordinate that is not finite")
    return corners.astype("<f8"), np.arange(3 * count, dtype="<u4").reshape(-1, 3)


def _is_text(data: bytes) -> bool:
    start = data.lstrip(b"\xef\xbb\xbf \t\r\n")
    return start[:5].lower() == b"solid" and b"\0" not in data


def _text(text: str) -> tuple[Floats, Indices]:
    corners: list[list[float]] = []
    inside: list[str] = []
    of_facet = 0
    for i, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        word, where = words[0].lower(), f"line {i}"
        if word in ("solid", "facet", "outer"):
            inside.append(word)
            of_facet = 0 if word == "facet" else of_facet
            if inside != ["solid", "facet", "outer"][: len(inside)]:
                raise Unreadable(f"{where}: {word!r} is out of place")
        elif word in ("endsolid", "endfacet", "endloop"):
            begun = {"endsolid": "solid", "endfacet": "facet", "endloop": "outer"}[word]
            if not inside or inside.pop() != begun:
                raise Unreadable(f"{where}: {word!r} is out of place")
            if word == "endfacet" and of_facet != 3:
                raise unsupported(
                    f"{where}: a facet has {of_facet} corners: only triangles are read"
                )
        elif word == "vertex":
            if inside != ["solid", "facet", "outer"] or len(words) != 4:
                raise Unreadable(f"{where}: a vertex is three numbers within 'outer loop'")
            corners.append([number(value, where) for value in words[1:]])
            of_facet += 1
        else:
            raise Unreadable(f"{where}: {words[0]!r} is not STL")
    if inside:
        raise Unreadable(f"the text STL file ends within a {inside[-1].replace('outer', 'loop')!r}")
    return (
        np.array(corners, dtype="<f8").reshape(-1, 3),
        np.arange(len(corners), dtype="<u4").reshape(-1, 3),
    )

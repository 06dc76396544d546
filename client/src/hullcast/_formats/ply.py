"""PLY: vertices and polygons with any further properties, binary or as text."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any

from .._arrays import Floats, Indices
from ._common import Unreadable, arrays, number, triangles, unsupported

_TYPES = {
    **dict.fromkeys(("char", "int8"), "b"),
    **dict.fromkeys(("uchar", "uint8"), "B"),
    **dict.fromkeys(("short", "int16"), "h"),
    **dict.fromkeys(("ushort", "uint16"), "H"),
    **dict.fromkeys(("int", "int32"), "i"),
    **dict.fromkeys(("uint", "uint32"), "I"),
    **dict.fromkeys(("float", "float32"), "f"),
    **dict.fromkeys(("double", "float64"), "d"),
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass
class _Property:
    name: str
    kind: str
    #: The type of a list's length; "" for a property with a single value.
    length: str = ""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list["_Property"])


def read(data: bytes) -> tuple[Floats, Indices]:
    """The faces, cut into triangles. Elements other than `vertex` and `face` are skipped."""
    order, elements, start = _header(data)
    rows = _Text(data[start:]) if order == "" else _Binary(data, start, order)
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for element in elements:
        names = [p.name for p in element.properties]
        lists = {p.name for p in element.properties if p.length}
        if element.name == "tristrips" and element.count:
            raise unsupported("triangle strips are not read; export the mesh as faces")
        if element.name == "vertex" and (
            not {"x", "y", "z"} <= set(names) or lists & {"x", "y", "z"}
        ):
            raise Unreadable("the element vertex has no properties x, y and z")
        indices = {p.name for p in element.properties if p.length and p.kind in "bBhHiI"}
        corners = next((n for n in ("vertex_indices", "vertex_index") if n in indices), None)
        if element.name == "face" and element.count and corners is None:
            raise Unreadable(
                "the element face has no list of integers vertex_indices or vertex_index"
            )
        for i in range(element.count if names else 0):
            where = f"{element.name} {i}"
            values = [rows.value(p, where) for p in element.properties]
            if element.name == "vertex":
                point = [float(values[names.index(axis)]) for axis in "xyz"]
                vertices.append([number(repr(value), where) for value in point])
            elif element.name == "face" and corners is not None:
                polygons.append([_whole(value, where) for value in values[names.index(corners)]])
    if rows.has_more():
        raise Unreadable("the PLY file goes on after the elements that its header announces")
    faces: list[tuple[int, int, int]] = []
    for i, polygon in enumerate(polygons):
        if len(polygon) < 3:
            raise Unreadable(f"face {i} has {len(polygon)} corners, at least 3 are needed")
        if min(polygon) < 0 or max(polygon) >= len(vertices):
            raise Unreadable(
                f"face {i} refers to a vertex that does not exist; the file has {len(vertices)}"
            )
        faces += triangles(polygon, vertices)
    return arrays(vertices, faces)


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """The byte order, the elements, and the offset at which the data begins."""
    end = data.find(b"end_header")
    newline = data.find(b"\n", end)
    if data[:3] != b"ply" or end < 0 or newline < 0:
        raise Unreadable("the file does not begin with a header from 'ply' to 'end_header'")
    order: str | None = None
    elements: list[_Element] = []
    for i, line in enumerate(data[:end].decode("utf-8", errors="replace").splitlines()[1:], 2):
        words = line.split()
        try:
            match words:
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case ["format", name, "1.0"]:
                    order = _ORDERS[name]
                case ["element", name, count]:
                    if not count.isdecimal():
                        raise ValueError
                    elements.append(_Element(name, int(count)))
                case ["property", "list", length, kind, name]:
                    elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[length]))
                case ["property", kind, name]:
                    elements[-1].properties.append(_Property(name, _TYPES[kind]))
                case _:
                    raise ValueError
        except (KeyError, ValueError, IndexError):
            raise Unreadable(f"line {i} of the header is not PLY: {line[:60]!r}") from None
    if order is None:
        raise Unreadable("the header has no line 'format'")
    return order, elements, newline + 1


def _whole(value: float, where: str) -> int:
    if value < 0 or value != int(value):
        raise Unreadable(f"{where}: {value} is not an index or the length of a list")
    return int(value)


class _Text:
    """Reads values from text."""

    def __init__(self, data: bytes) -> None:
        self._words = iter(data.decode("utf-8", errors="replace").split())

    def value(self, wanted: _Property, where: str) -> Any:
        """The next value, or the next list of values."""
        if not wanted.length:
            return number(self._word(where), where)
        length = _whole(number(self._word(where), where), where)
        return [number(self._word(where), where) for _ in range(length)]

    def has_more(self) -> bool:
        """Whether words are left."""
        return next(self._words, None) is not None

    def _word(self, where: str) -> str:
        word = next(self._words, None)
        if word is None:
            raise Unreadable(f"the PLY file ends within {where}")
        return word


class _Binary:
    """Reads values from binary data."""

    def __init__(self, data: bytes, start: int, order: str) -> None:
        self._data, self._at, self._order = data, start, order

    def value(self, wanted: _Property, where: str) -> Any:
        """The next value, or the next list of values."""
        if not wanted.length:
            return self._unpack(wanted.kind, 1, where)[0]
        length = self._unpack(wanted.length, 1, where)[0]
        if not isinstance(length, int) or length < 0:
            raise Unreadable(f"{where}: {length} is not the length of a list")
        return self._unpack(wanted.kind, length, where)

    def has_more(self) -> bool:
        """Whether bytes are left."""
        return self._at < len(self._data)

    def _unpack(self, kind: str, count: int, where: str) -> tuple[Any, ...]:
        form = f"{self._order}{count}{kind}"
        size = struct.calcsize(form)
        if self._at + size > len(self._data):
            raise Unreadable(f"the PLY file ends within {where}")
        self._at += size
        return struct.unpack_from(form, self._data, self._at - size)

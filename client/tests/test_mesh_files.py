"""Mesh files: each format's features are read as it defines them, or refused by name.

The expected triangles are given here, or read by a second method.
"""

from __future__ import annotations

import itertools
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from solids import box, canonical

import hullcast
from hullcast import _mesh

TETRA = np.array([[0, 0, 0], [0, 2, 0], [1, 0, 0], [0, 0, 3]], dtype=float)
#: The tetrahedron's triangles, as indices of vertices from 0.
SIDES = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]
TRIANGLES = TETRA[SIDES]


def load(folder: Path, name: str, data: str | bytes) -> _mesh.Mesh:
    """Writes a file with this content and reads its mesh."""
    path = folder / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return _mesh.load(path)


def triangles(mesh: _mesh.Mesh) -> list:
    """The triangles, in an order that does not depend on the reader."""
    return canonical(mesh.vertices[mesh.faces])


def area(mesh: _mesh.Mesh) -> np.ndarray:
    """(3,): the vector sum of the triangles' areas, which equals that of the polygons' areas."""
    a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)
    return np.cross(b - a, c - a).sum(axis=0) / 2


def refused(folder: Path, name: str, data: str | bytes, reason: str) -> str:
    """The message of the refusal, which must name the file."""
    with pytest.raises(hullcast.InvalidArgument) as caught:
        load(folder, name, data)
    assert caught.value.reason == reason
    assert name in caught.value.message
    return caught.value.message


# OBJ

VERTICES = "v 0 0 0\nv 0 2 0\nv 1 0 0\nv 0 0 3\n"
FACES = "f 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n"


@pytest.mark.parametrize(
    "text",
    [
        VERTICES + FACES,
        "# a comment\r\n" + VERTICES.replace("\n", "\r\n") + FACES.replace("\n", " # side\r\n"),
        "\ufeff" + VERTICES + FACES,
        "mtllib a.mtl\no one\n" + VERTICES + "g a b\nusemtl red\nf 1 2 3\ng\ns 1\no two\n"
        "f 1 3 4\nf 1 4 2\nf 2 4 3\nl 1 2\np 3\n",
        VERTICES + "vt 0 0\nvt 1 1\nvn 0 0 1\nf 1/1 2/2 3/1\nf 1//1 3//1 4//1\n"
        "f 1/1/1 4/2/1 2/1/1\nf 2/2 4/1 3/1\n",
        VERTICES + "f -4 -3 -2\nf -4 -2 -1\nf 1 -1 2\nf 2 -1 -2\n",
        "v 0 0 0\nv 0 2 0\nv 1 0 0\nf -3 -2 -1\nv 0 0 3\nf 1 3 -1\nf 1 -1 2\nf 2 -1 3\n",
        FACES + VERTICES,
        VERTICES + "f 1 \\\n  2 3\nf 1 3 \\\r\n4\nf 1 4 2\nf 2 \\\n 4 \\\n 3\n",
        "v 0 0 0 1.0\nv 0 2 0 0.5\nv 1 0 0 255 0 0\nv 0 0 3 0.1 0.2 0.3 1\n" + FACES,
        "v 9 9 9\n" + VERTICES + "f 2 3 4\nf 2 4 5\nf 2 5 3\nf 3 5 4\n",
        "v 0e0 0 .0\nv +0 2. 0\nv 1E0 0 0\nv 0 -0 30e-1\n" + FACES,
    ],
    ids=[
        "plain",
        "line ends and comments",
        "byte order mark",
        "groups and objects",
        "texture and normal",
        "negative indices",
        "negative indices between vertices",
        "faces first",
        "line continuation",
        "weights and colours",
        "vertex without face",
        "numbers",
    ],
)
def test_an_obj_file(tmp_path, text):
    """Catches a feature of OBJ that is not read as the format defines it."""
    assert triangles(load(tmp_path, "a.obj", text)) == canonical(TRIANGLES)


@pytest.mark.parametrize(
    ("text", "reason", "named"),
    [
        (VERTICES + "f 1 2 0\n", "MALFORMED_MESH", "line 5: vertex 0"),
        (
            VERTICES + "f 1 2 5\n",
            "MALFORMED_MESH",
            "line 5: vertex 5 does not exist; the file has 4",
        ),
        (VERTICES + "f -5 1 2\n", "MALFORMED_MESH", "line 5: vertex -5"),
        (VERTICES + "f 1 2\n", "MALFORMED_MESH", "line 5: a face has at least three corners"),
        (VERTICES + "f 1 2 x\n", "MALFORMED_MESH", "line 5: 'x'"),
        (VERTICES + "f 1 2 3 \\", "MALFORMED_MESH", "line 5: the last line ends with a backslash"),
        ("v 0 0\n", "MALFORMED_MESH", "line 1: a vertex has at least three numbers"),
        ("v 0 0 nan\n", "MALFORMED_MESH", "line 1: 'nan' is not a finite number"),
        ("v 0 0 1_0\n", "MALFORMED_MESH", "line 1: '1_0' is not a finite number"),
        ("# Hullcast\n\nIt is\n", "MALFORMED_MESH", "line 3: 'It' is not a statement of OBJ"),
        ("v 0 0 0\0\n", "MALFORMED_MESH", "binary"),
        (VERTICES + "cstype bezier\ndeg 3 3\n", "UNSUPPORTED_MESH", "line 5: 'cstype': free-form"),
        (VERTICES + "call other.obj\n", "UNSUPPORTED_MESH", "line 5: 'call'"),
        (VERTICES, "NO_TRIANGLES", "no triangles"),
        (VERTICES + "l 1 2\n", "NO_TRIANGLES", "no triangles"),
    ],
)
def test_obj_files_that_are_refused(tmp_path, text, reason, named):
    """Catches a line that is silently skipped; the message names each."""
    assert named in refused(tmp_path, "a.obj", text, reason)


def test_polygons_are_cut_within_their_outline(tmp_path):
    """Catches a triangulation that leaves the polygon's outline.

    An arrowhead, a comb and a square with points on its sides keep their area from every first
    corner, and each triangle is oriented as the polygon.
    """
    arrow = [(0, 0), (2, 1), (0, 2), (1, 1)]
    teeth = [(x, y) for i in range(6) for x, y in ((2 * i, 3), (2 * i + 1, 0.5))]
    comb = [(0, 0), *teeth[::-1][:-1]][::-1]
    square = [(0, 0), (1, 0), (2, 0), (2, 2), (1, 2), (0, 2), (0, 1)]
    for outline in (arrow, comb, square):
        x, y = np.array(outline, dtype=float).T
        expected = float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
        for first in range(len(outline)):
            turned = outline[first:] + outline[:first]
            text = "".join(f"v {x} {y} {x + y}\n" for x, y in turned)
            text += "f " + " ".join(str(i + 1) for i in range(len(turned))) + "\n"
            mesh = load(tmp_path, "a.obj", text)
            a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)
            turns = np.cross(b - a, c - a)[:, 2] / 2
            assert turns.sum() == pytest.approx(expected)
            assert np.abs(turns).sum() == pytest.approx(abs(expected))


def test_a_polygon_of_many_corners(tmp_path):
    """Catches a hang: a convex polygon of 20,000 corners is read, a dented one is refused."""
    angles = np.arange(20_000) * (2 * np.pi / 20_000)
    for dent, reason in ((1.0, None), (0.5, "UNSUPPORTED_MESH")):
        radius = np.where(np.arange(20_000) == 7, dent, 1.0)
        points = np.column_stack([radius * np.cos(angles), radius * np.sin(angles)])
        text = "".join(f"v {x!r} {y!r} 0\n" for x, y in points.tolist())
        text += "f " + " ".join(map(str, range(1, 20_001))) + "\n"
        if reason is None:
            assert len(load(tmp_path, "a.obj", text).faces) == 19_998
        else:
            assert "20000 corners" in refused(tmp_path, "a.obj", text, reason)


# STL


def binary(solid: np.ndarray, header: bytes = b"", attribute: int = 0) -> bytes:
    """A binary STL file, written by the format's definition."""
    data = header.ljust(80, b" ") + struct.pack("<I", len(solid))
    for triangle in solid:
        data += struct.pack("<12fH", 0, 0, 1, *np.ravel(triangle), attribute)
    return data


def text_of(solid: np.ndarray, name: str = "a") -> str:
    """A text STL file, written by the format's definition."""
    facets = "".join(
        " facet normal 0 0 1\n  outer loop\n"
        + "".join(f"   vertex {x} {y} {z}\n" for x, y, z in triangle.tolist())
        + "  endloop\n endfacet\n"
        for triangle in solid
    )
    return f"solid {name}\n{facets}endsolid {name}\n"


SECOND = TRIANGLES + np.array([5, 0, 0])


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (binary(TRIANGLES), TRIANGLES),
        (binary(TRIANGLES, b"solid of a program that writes so"), TRIANGLES),
        (binary(TRIANGLES, b"solid a\nfacet normal"), TRIANGLES),
        (binary(TRIANGLES, b"\0" * 80, 0xFFFF), TRIANGLES),
        (text_of(TRIANGLES), TRIANGLES),
        (text_of(TRIANGLES).upper().replace("SOLID A", "SOLID "), TRIANGLES),
        (text_of(TRIANGLES, "facet vertex 1 2 3"), TRIANGLES),
        (text_of(TRIANGLES).replace("\n", "\r\n") + "\r\n\r\n", TRIANGLES),
        (text_of(TRIANGLES) + text_of(SECOND, "b"), np.concatenate([TRIANGLES, SECOND])),
        (text_of(TRIANGLES[:0]) + text_of(SECOND, "b"), SECOND),
    ],
    ids=[
        "binary",
        "binary that begins with solid",
        "binary that begins like text",
        "attributes",
        "text",
        "upper case",
        "a name of keywords",
        "line ends",
        "two solids",
        "an empty solid",
    ],
)
def test_an_stl_file(tmp_path, data, expected):
    """Catches a binary file that is mistaken for text, and solids after the first that are lost."""
    assert triangles(load(tmp_path, "a.stl", data)) == canonical(expected)


@pytest.mark.parametrize(
    ("data", "reason", "named"),
    [
        (binary(TRIANGLES) + b"\n", "MALFORMED_MESH", "1 bytes after its end"),
        (binary(TRIANGLES) + binary(SECOND), "MALFORMED_MESH", "284 bytes after its end"),
        (binary(TRIANGLES)[:-1], "MALFORMED_MESH", "lost its last 1 bytes"),
        (binary(TRIANGLES)[:90], "MALFORMED_MESH", "announces 4 triangles, which are 284 bytes"),
        (binary(TRIANGLES)[:40], "MALFORMED_MESH", "the file has 40 bytes"),
        (binary(TRIANGLES, b"solid a\0")[:-3], "MALFORMED_MESH", "lost its last 3 bytes"),
        (b"hello", "MALFORMED_MESH", "the file has 5 bytes"),
        (binary(np.full_like(TRIANGLES, np.inf)), "MALFORMED_MESH", "triangle 0"),
        (binary(TRIANGLES[:0]), "NO_TRIANGLES", "no triangles"),
        (text_of(TRIANGLES[:0]), "NO_TRIANGLES", "no triangles"),
        (text_of(TRIANGLES)[:75], "MALFORMED_MESH", "line 5: a vertex is three numbers"),
        (text_of(TRIANGLES).rpartition("endsolid")[0], "MALFORMED_MESH", "ends within a 'solid'"),
        (text_of(TRIANGLES).replace("  endloop\n", "", 1), "MALFORMED_MESH", "line 7: 'endfacet'"),
        (text_of(TRIANGLES).replace("1.0", "one", 1), "MALFORMED_MESH", "'one'"),
        (text_of(TRIANGLES).replace("vertex", "point", 1), "MALFORMED_MESH", "line 4: 'point'"),
        (
            text_of(TRIANGLES).replace("   vertex 0.0 0.0 0.0\n", "", 1),
            "UNSUPPORTED_MESH",
            "line 7: a facet has 2 corners",
        ),
    ],
)
def test_stl_files_that_are_refused(tmp_path, data, reason, named):
    """Catches a truncated or extended file that is read in part."""
    assert named in refused(tmp_path, "a.stl", data, reason)


# PLY

HEADER = """ply
format {0} 1.0
comment written by a test
obj_info nothing
element vertex 4
property uchar red
property {1} y
property {1} x
property list uchar short rings
property {1} z
element edge 1
property int32 vertex1
property int32 vertex2
element face 3
property list {2} {3} {4}
property float quality
end_header
"""
#: A quad with the tetrahedron's first two corners, and two triangles.
POLYGONS = [[0, 1, 2], [0, 2, 3], [0, 3, 1]]


def ply(form: str, real: str, length: str, index: str, name: str) -> bytes:
    """A PLY file with properties in an unusual order, and with further elements in between."""
    codes = {"float": "f", "double": "d", "uchar": "B", "uint8": "B", "int": "i", "uint32": "I"}
    codes |= {"ushort": "H", "int16": "h", "float64": "d", "char": "b"}
    head = HEADER.format(form, real, length, index, name).encode()
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    rows: list[tuple[str, list]] = []
    for x, y, z in TETRA.tolist():
        rows.append(("B" + 2 * codes[real] + "B2h" + codes[real], [7, y, x, 2, 5, 6, z]))
    rows.append(("2i", [0, 1]))
    for polygon in POLYGONS:
        form_of_row = codes[length] + f"{len(polygon)}{codes[index]}f"
        rows.append((form_of_row, [len(polygon), *polygon, 0.5]))
    if order == "":
        return head + b"".join(" ".join(map(str, row)).encode() + b"\n" for _, row in rows)
    return head + b"".join(struct.pack(order + kind, *row) for kind, row in rows)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(
    "types",
    [
        ("float", "uchar", "int", "vertex_indices"),
        ("double", "uint8", "uint32", "vertex_index"),
        ("float64", "ushort", "int16", "vertex_indices"),
        ("float", "char", "char", "vertex_index"),
    ],
)
def test_a_ply_file(tmp_path, form, types):
    """Catches a byte order, a type, an order of properties or an element that is read wrongly."""
    mesh = load(tmp_path, "a.ply", ply(form, *types))
    assert triangles(mesh) == canonical(TETRA[POLYGONS])


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        (b"ply\n", b"PLY\n", "header"),
        (b"end_header", b"end", "header"),
        (b"ascii 1.0", b"ascii 2.0", "line 2 of the header"),
        (b"ascii", b"utf8", "line 2 of the header"),
        (b"element vertex 4", b"element vertex four", "line 5 of the header"),
        (b"element vertex 4", b"element vertex 99", "ends within vertex"),
        (b"element face 3", b"element face 2", "goes on after the elements"),
        (b"property float y", b"property float v", "no properties x, y and z"),
        (b"vertex_indices", b"corners", "no list of integers vertex_indices"),
        (b"uchar int vertex", b"uchar float vertex", "no list of integers vertex_indices"),
        (
            b"3 0 3 1 0.5",
            b"3 0 4 1 0.5",
            "face 2 refers to a vertex that does not exist; the file has 4",
        ),
        (b"3 0 3 1 0.5", b"2 0 3 0.5", "face 2 has 2 corners"),
        (b"3 0 3 1 0.5", b"3 0 -3 1 0.5", "-3.0 is not an index"),
        (b"3 0 3 1 0.5", b"3 0 3 1 nan", "face 2: 'nan'"),
        (b"3 0 3 1 0.5", b"3 0 3", "ends within face 2"),
    ],
)
def test_ply_files_that_are_refused(tmp_path, old, new, named):
    """Catches a header or an element that is silently misread."""
    data = ply("ascii", "float", "uchar", "int", "vertex_indices")
    assert data.count(old) == 1
    assert named in refused(tmp_path, "a.ply", data.replace(old, new), "MALFORMED_MESH")


def test_ply_strips_and_cut_ends(tmp_path):
    """Catches strips that are left out, and binary data that ends too early or too late."""
    data = ply("ascii", "float", "uchar", "int", "vertex_indices")
    strips = data.replace(b"element face 3", b"element tristrips 3")
    assert "triangle strips" in refused(tmp_path, "a.ply", strips, "UNSUPPORTED_MESH")
    data = ply("binary_big_endian", "float", "uchar", "int", "vertex_indices")
    assert "ends within face 2" in refused(tmp_path, "a.ply", data[:-1], "MALFORMED_MESH")
    assert "goes on after" in refused(tmp_path, "a.ply", data + b"\n", "MALFORMED_MESH")


# All formats


@pytest.mark.parametrize("name", ["a.step", "a.STP", "a.glb", "a.xml", "a.obj.txt", "a"])
def test_other_formats_name_those_that_are_read(tmp_path, client, name):
    """Catches an error of another package, such as a missing module."""
    (tmp_path / name).write_text("ISO-10303-21;\n")
    with pytest.raises(hullcast.InvalidArgument, match="OBJ, STL, DAE or PLY") as caught:
        client.register([tmp_path / name])
    assert caught.value.reason == "UNSUPPORTED_MESH"


@pytest.mark.parametrize("suffix", ["obj", "stl", "dae", "ply", "STL"])
def test_files_that_are_no_meshes(tmp_path, client, suffix):
    """Catches foreign errors for empty files, text, random bytes, folders and missing files."""
    assert "empty" in refused(tmp_path, f"a.{suffix}", b"", "MALFORMED_MESH")
    refused(tmp_path, f"b.{suffix}", b"hello\n", "MALFORMED_MESH")
    for seed in range(20):
        data = np.random.default_rng(seed).bytes(200)
        refused(tmp_path, f"c.{suffix}", data, "MALFORMED_MESH")
    (tmp_path / f"d.{suffix}").mkdir()
    with pytest.raises(hullcast.InvalidArgument, match="is a directory"):
        client.register([tmp_path / f"d.{suffix}"])
    with pytest.raises(hullcast.FileNotFound, match=rf"none\.{suffix}: there is no such file"):
        client.register([tmp_path / f"none.{suffix}"])
    with pytest.raises(FileNotFoundError):
        client.register([os.fspath(tmp_path / f"none.{suffix}")])


def test_files_that_were_cut_or_changed(tmp_path):
    """Catches foreign errors and crashes for damaged files.

    Valid files are truncated at many places, or get random bytes. The result must be a mesh or this
    package's own error.
    """
    samples = {
        "a.obj": (VERTICES + FACES).encode(),
        "a.stl": text_of(TRIANGLES).encode(),
        "b.stl": binary(TRIANGLES),
        "a.ply": ply("ascii", "float", "uchar", "int", "vertex_indices"),
        "b.ply": ply("binary_little_endian", "float", "uchar", "int", "vertex_indices"),
    }
    rng = np.random.default_rng(186)
    read = 0
    for name, data in samples.items():
        assert len(load(tmp_path, name, data).faces) >= 3
        changed = [data[:n] for n in range(0, len(data), 3)]
        for _ in range(150):
            other = bytearray(data)
            for place in rng.integers(0, len(data), 2):
                other[place] = rng.integers(0, 256)
            changed.append(bytes(other))
        for content in changed:
            try:
                mesh = load(tmp_path, name, content)
            except hullcast.InvalidArgument:
                continue
            read += 1
            assert np.isfinite(mesh.vertices).all()
            assert mesh.faces.max() < len(mesh.vertices)
    assert read > 50


def test_equal_vertices_are_one_and_unused_ones_are_none(tmp_path):
    """Catches vertices without triangles, which would make the hull larger."""
    soup = box((0, 0, 0), (1, 2, 3))
    mesh = load(tmp_path, "a.stl", binary(soup))
    assert sorted(map(tuple, mesh.vertices.tolist())) == list(
        itertools.product((0.0, 1.0), (0.0, 2.0), (0.0, 3.0))
    )
    assert triangles(mesh) == canonical(soup)
    mesh = load(tmp_path, "a.obj", "v 100 100 100\n" + VERTICES + "f -4 -3 -2\n")
    assert len(mesh.vertices) == 3

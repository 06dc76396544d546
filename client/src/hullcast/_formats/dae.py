"""COLLADA (DAE): an XML file with a scene of nodes, which place geometries.

Lengths are converted to metres by the file's unit, as robot software does. The axes are kept as
written, whatever `up_axis` says. Robot software does not turn them either, and robot descriptions
rely on that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from xml.etree import ElementTree

import numpy as np

from .._arrays import Floats, Indices
from ._common import Unreadable, arrays, number, triangles, unsupported

Element = ElementTree.Element

#: Limits of the number of nodes and their nesting, because instances of nodes can multiply the
#: nodes without bound.
_MOST_NODES = 100_000
_DEEPEST = 100
#: Primitives without area, and elements of a mesh that are not primitives.
_IGNORED = frozenset(("source", "vertices", "lines", "linestrips", "extra"))


def read(data: bytes) -> tuple[Floats, Indices]:
    """The triangles of all geometries, where the scene's nodes place them, in metres."""
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise Unreadable(f"the file is not XML: {error}") from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    if root.tag != "COLLADA":
        raise Unreadable(f"the root element is <{root.tag}>, not <COLLADA>")
    scene = _Scene(root)
    vertices, faces = scene.read()
    unit = root.find("asset/unit")
    meter = 1.0 if unit is None else number(unit.get("meter", "1"), "<unit meter>")
    if not meter > 0:
        raise Unreadable(f"<unit meter>: {meter} is not a positive number of metres")
    return vertices * meter, faces


class _Scene:
    """The geometries by identifier, and the nodes that place them."""

    def __init__(self, root: Element) -> None:
        self._root = root
        self._by_id = {e.get("id"): e for e in root.iter() if e.get("id")}
        self._visited = 0
        self._meshes: dict[str, tuple[Floats, Indices]] = {}

    def read(self) -> tuple[Floats, Indices]:
        instance = self._root.find("scene/instance_visual_scene")
        if instance is None:
            raise unsupported(
                "the file has no <scene> with a visual scene, which places geometries"
            )
        parts = list(self._nodes(self._target(instance, "visual_scene"), np.eye(4), ()))
        offsets = np.cumsum([0, *(len(points) for points, _ in parts)])
        return (
            np.concatenate([np.zeros((0, 3)), *(points for points, _ in parts)]),
            np.concatenate(
                [
                    np.zeros((0, 3), dtype="<u4"),
                    *(faces + np.uint32(k) for (_, faces), k in zip(parts, offsets, strict=False)),
                ]
            ),
        )

    def _nodes(
        self, parent: Element, pose: Floats, above: Sequence[Element]
    ) -> Iterator[tuple[Floats, Indices]]:
        """Yields the geometries of an element's nodes; `above` are the nodes that contain it."""
        for child in parent:
            if child.tag == "node":
                yield from self._node(child, pose, above)
            elif child.tag == "instance_node":
                yield from self._node(self._target(child, "node"), pose, above)

    def _node(
        self, node: Element, pose: Floats, above: Sequence[Element]
    ) -> Iterator[tuple[Floats, Indices]]:
        if node in above:
            raise Unreadable(f"the node {_name(node)} contains itself")
        self._visited += 1
        if len(above) > _DEEPEST or self._visited > _MOST_NODES:
            raise unsupported(
                f"it has more than {_MOST_NODES} nodes, or nodes more than {_DEEPEST} levels deep"
            )
        for child in node:
            if child.tag in _TRANSFORMS:
                pose = pose @ _TRANSFORMS[child.tag](child)
            elif child.tag == "skew":
                raise unsupported(
                    f"<skew> of the node {_name(node)} is not read; export the mesh without it"
                )
            elif child.tag == "instance_controller":
                raise unsupported(
                    f"the node {_name(node)} has a skin or a morph (<instance_controller>), "
                    "which is not read; export the mesh in its pose"
                )
            elif child.tag == "instance_geometry":
                geometry = self._target(child, "geometry")
                points, faces = self._geometry(geometry)
                yield points @ pose[:3, :3].T + pose[:3, 3], faces
        yield from self._nodes(node, pose, (*above, node))

    def _target(self, instance: Element, tag: str) -> Element:
        url = instance.get("url", "")
        if not url.startswith("#"):
            raise unsupported(
                f"<{instance.tag}> refers to another file, {url!r}, which is not read"
            )
        return self._named(url, tag)

    def _named(self, reference: str | None, tag: str) -> Element:
        found = self._by_id.get((reference or "").lstrip("#"))
        if found is None or found.tag != tag:
            raise Unreadable(f"no <{tag}> has the id {reference!r} that the file refers to")
        return found

    def _geometry(self, geometry: Element) -> tuple[Floats, Indices]:
        name = geometry.get("id", "")
        if name not in self._meshes:
            mesh = geometry.find("mesh")
            if mesh is None:
                kinds = [child.tag for child in geometry if child.tag not in ("asset", "extra")]
                raise unsupported(
                    f"the geometry {_name(geometry)} is a <{'/'.join(kinds)}>: only <mesh> is read"
                )
            self._meshes[name] = self._mesh(mesh, _name(geometry))
        return self._meshes[name]

    def _mesh(self, mesh: Element, name: str) -> tuple[Floats, Indices]:
        vertices: list[list[float]] = []
        faces: list[tuple[int, int, int]] = []
        places: dict[str, int] = {}
        for primitive in mesh:
            if primitive.tag in _IGNORED:
                continue
            if primitive.tag not in _PRIMITIVES:
                raise unsupported(f"<{primitive.tag}> of the geometry {name} is not read")
            inputs = primitive.findall("input")
            corner = next((i for i in inputs if i.get("semantic") == "VERTEX"), None)
            if corner is None:
                raise Unreadable(f"<{primitive.tag}> of the geometry {name} has no input VERTEX")
            of = self._named(corner.get("source"), "vertices")
            position = next((i for i in of if i.get("semantic") == "POSITION"), None)
            source = "" if position is None else position.get("source", "")
            if source not in places:
                places[source] = len(vertices)
                vertices += self._points(self._named(source, "source"), name)
            stride = 1 + max(_whole(i.get("offset", "0"), name) for i in inputs)
            offset = _whole(corner.get("offset", "0"), name)
            count = len(vertices) - places[source]
            for polygon in _PRIMITIVES[primitive.tag](primitive, stride, name):
                indices = polygon[offset::stride]
                if len(indices) < 3:
                    raise Unreadable(f"a polygon of the geometry {name} has fewer than 3 corners")
                if max(indices) >= count:
                    raise Unreadable(
                        f"the geometry {name} refers to vertex {max(indices)}, "
                        f"but its {count} vertices are numbered from 0"
                    )
                faces += triangles([places[source] + i for i in indices], vertices)
        return arrays(vertices, faces)

    def _points(self, source: Element, name: str) -> list[list[float]]:
        accessor = source.find("technique_common/accessor")
        if accessor is None:
            raise Unreadable(f"the positions of the geometry {name} have no <accessor>")
        array = self._named(accessor.get("source"), "float_array")
        values = [number(word, f"the positions of {name}") for word in (array.text or "").split()]
        stride = _whole(accessor.get("stride", "1"), name)
        start = _whole(accessor.get("offset", "0"), name)
        count = _whole(accessor.get("count", ""), name)
        # A parameter without a name is a coordinate to skip.
        columns = [i for i, p in enumerate(accessor.findall("param")) if p.get("name")]
        if len(columns) != 3:
            raise unsupported(
                f"the positions of the geometry {name} have {len(columns)} coordinates, expected 3"
            )
        if stride <= max(columns) or start + stride * (count - 1) + max(columns) >= len(values):
            raise Unreadable(f"the positions of the geometry {name} end before their accessor does")
        return [[values[start + stride * i + k] for k in columns] for i in range(count)]


def _name(element: Element) -> str:
    return repr(element.get("id") or element.get("name") or "(without a name)")


def _whole(word: str, name: str) -> int:
    try:
        value = int(word)
    except ValueError:
        value = -1
    if value < 0:
        raise Unreadable(f"{word!r} of the geometry {name} is not a whole number from 0")
    return value


def _indices(element: Element | None, name: str) -> list[int]:
    words = [] if element is None else (element.text or "").split()
    return [_whole(word, name) for word in words]


# Primitives as polygons. Each polygon is a list of indices, `stride` of them per corner.


def _polylist(primitive: Element, stride: int, name: str) -> Iterator[list[int]]:
    indices, at = _indices(primitive.find("p"), name), 0
    for count in _indices(primitive.find("vcount"), name):
        yield indices[at : at + count * stride]
        at += count * stride
    if at != len(indices):
        raise Unreadable(f"<p> of the geometry {name} has {len(indices)} indices, not {at}")


def _triangles(primitive: Element, stride: int, name: str) -> Iterator[list[int]]:
    for element in primitive.findall("p"):
        indices = _indices(element, name)
        if len(indices) % (3 * stride):
            raise Unreadable(f"<p> of the geometry {name} ends within a triangle")
        yield from (indices[i : i + 3 * stride] for i in range(0, len(indices), 3 * stride))


def _polygons(primitive: Element, stride: int, name: str) -> Iterator[list[int]]:
    if primitive.find("ph") is not None:
        raise unsupported(f"a polygon with a hole (<ph>) of the geometry {name} is not read")
    yield from (_indices(element, name) for element in primitive.findall("p"))


def _strips(primitive: Element, stride: int, name: str) -> Iterator[list[int]]:
    for element in primitive.findall("p"):
        corners = _corners(_indices(element, name), stride)
        for i in range(len(corners) - 2):
            a, b, c = corners[i : i + 3]
            yield [*a, *b, *c] if i % 2 == 0 else [*b, *a, *c]


def _fans(primitive: Element, stride: int, name: str) -> Iterator[list[int]]:
    for element in primitive.findall("p"):
        corners = _corners(_indices(element, name), stride)
        for i in range(1, len(corners) - 1):
            yield [*corners[0], *corners[i], *corners[i + 1]]


def _corners(indices: list[int], stride: int) -> list[list[int]]:
    return [indices[i : i + stride] for i in range(0, len(indices), stride)]


_PRIMITIVES: dict[str, Callable[[Element, int, str], Iterator[list[int]]]] = {
    "triangles": _triangles,
    "polylist": _polylist,
    "polygons": _polygons,
    "tristrips": _strips,
    "trifans": _fans,
}


# The transforms of a node, as (4, 4) matrices that act on column vectors.


def _numbers(element: Element, count: int) -> Floats:
    values = [number(word, f"<{element.tag}>") for word in (element.text or "").split()]
    if len(values) != count:
        raise Unreadable(f"<{element.tag}> has {len(values)} numbers, not {count}")
    return np.array(values)


def _matrix(element: Element) -> Floats:
    pose = _numbers(element, 16).reshape(4, 4)
    if (pose[3] != (0.0, 0.0, 0.0, 1.0)).any():
        last = " ".join(f"{value:g}" for value in pose[3])
        raise unsupported(
            f"<matrix> has the last row {last}, expected 0 0 0 1: a matrix is written row by row, "
            "and a projection is not read"
        )
    return pose


def _translate(element: Element) -> Floats:
    pose = np.eye(4)
    pose[:3, 3] = _numbers(element, 3)
    return pose


def _scale(element: Element) -> Floats:
    return np.diag([*_numbers(element, 3), 1.0])


def _rotate(element: Element) -> Floats:
    """A rotation about an axis by an angle in degrees."""
    *axis, degrees = _numbers(element, 4)
    length = float(np.linalg.norm(axis))
    if not length > 0:
        raise Unreadable("<rotate> has no axis")
    x, y, z = np.array(axis) / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    pose = np.eye(4)
    pose[:3, :3] += np.sin(angle) * cross + 2 * np.sin(angle / 2) ** 2 * (cross @ cross)
    return pose


def _lookat(element: Element) -> Floats:
    """The pose of a viewer at the first point whose -z axis points at the second point."""
    eye, target, up = _numbers(element, 9).reshape(3, 3)
    back = eye - target
    right = np.cross(up, back)
    if not (np.linalg.norm(back) > 0 and np.linalg.norm(right) > 0):
        raise Unreadable("<lookat> has no direction")
    back, right = back / np.linalg.norm(back), right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.column_stack([right, np.cross(back, right), back, eye])
    return pose


_TRANSFORMS: dict[str, Callable[[Element], Floats]] = {
    "matrix": _matrix,
    "translate": _translate,
    "rotate": _rotate,
    "scale": _scale,
    "lookat": _lookat,
}

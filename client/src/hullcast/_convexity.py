"""Decides whether a mesh is convex, by distances from the surface of its convex hull.

A mesh counts as convex if two conditions hold:

1. Each point of the convex hull's surface is within `TOLERANCE` of some triangle of the mesh. So no
   dent, hole, slot or gap between parts is deeper or wider than that.
2. These distances, integrated over the hull's surface, enclose at most the fraction
   `1 - CONVEX_RATIO` of the hull's volume. So a thin plate or profile has no dent as deep as the
   plate itself.

Only the distance from the hull to the nearest triangle counts. Therefore the result does not depend
on triangles that overlap, appear twice, are turned inside out, lie inside the mesh, or meet without
sharing corners, nor on an edge that is open by less than the tolerance.

`_is_shell` quickly proves both conditions for most convex meshes. It keeps the triangles whose
planes have the whole mesh on one side, and orients them outward. If each of their sides is matched
by an opposite side, these triangles together surround the middle of the mesh.

All other meshes go to `_missing`, which cuts the hull's surface into triangular cells:

- A cell is done if one triangle of the mesh is within the tolerance of all three corners of the
  cell. (The distance to a convex set is a convex function, so its maximum over the cell is at a
  corner.) It is also done if the distance at its centre plus its radius is within the tolerance.
- A cell whose centre is too far from the mesh shows that the mesh is not convex.
- Any other cell is cut in two, down to a sixteenth of the tolerance.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _nearest, _quickhull
from ._arrays import Floats

#: The largest distance between the hull's surface and a convex mesh, as a fraction of the diagonal
#: of the mesh's bounding box. Modelling leaves dents of 1e-3 in real convex meshes.
TOLERANCE = 0.01

#: A convex mesh fills at least this fraction of its hull.
CONVEX_RATIO = 0.99

#: Vertices closer than this fraction of the diagonal count as one, because files store coordinates
#: in single precision or with a few digits.
_WELD = 1e-6
#: The computed hull may miss points by these fractions of the tolerance and of the mesh's smallest
#: extent. A fine mesh then needs far fewer vertices.
_HULL_ERROR = 1 / 8
_HULL_ERROR_OF_HEIGHT = 1 / 64
#: A cell is cut at least down to this radius, unless the mesh has no gap at the cell's corners.
_SAMPLED_RADIUS = 0.1
_SMALLEST_RADIUS = TOLERANCE / 16
#: The number of lines along each axis, in each of the other two directions.
_LINES = 48
#: If triangles times vertices are at most this many, all vertices are tested, without a hull.
_FEW = 1 << 24
#: The largest number of triangles times vertices in one array operation.
_AT_ONCE = 1 << 20
#: (26, 3): the directions from a cube's centre to its corners, edges and faces.
_DIRECTIONS = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
#: The volume by signed tetrahedra is exact unless parts overlap. If the estimate by lines agrees
#: with it to this much, the parts do not overlap.
_AGREEMENT = 0.1

_Ids = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Dents:
    """How a mesh that is not convex differs from its convex hull."""

    #: The fraction of its convex hull that the mesh fills, at most 1. It is an estimate, good to
    #: about 1 %, if parts of the mesh overlap or edges are open.
    ratio: float
    #: Sides of triangles without a neighbour that has the same side in the opposite direction.
    open_edges: int


def is_flat(points: Floats) -> bool:
    """Whether all points lie in one plane, to a billionth of their extent."""
    return _quickhull.simplex(_normalised(points)) is None


def is_convex(points: Floats, faces: Any) -> bool:
    """Whether a mesh is convex or flat.

    Args:
        points: (n, 3), finite.
        faces: (m, 3) with m >= 1, indices of points.
    """
    return _dented(points, faces) is None


def dents(points: Floats, faces: Any) -> Dents | None:
    """How a mesh differs from its convex hull; None if the mesh is convex or flat."""
    found = _dented(points, faces)
    if found is None:
        return None
    hull, mesh, open_edges = found
    # Turned to the shape's principal axes, so that thin shapes are crossed by lines in all
    # directions.
    axes = np.linalg.svd(hull.reshape(-1, 3) - hull.mean(axis=(0, 1)), full_matrices=False)[2]
    ratio = _filled(hull @ axes.T, mesh @ axes.T)
    signed = abs(_volume(mesh)) / abs(_volume(hull))
    if open_edges == 0 and abs(signed - ratio) <= _AGREEMENT:
        ratio = signed
    return Dents(min(ratio, 1.0), open_edges)


def convex_parts(points: Floats, faces: Any, most: int) -> list[Floats] | None:
    """The points of each connected part of a mesh, if all parts are closed and convex.

    Args:
        points, faces: as for `is_convex`.
        most: the largest accepted number of parts.

    Returns:
        One array (k, 3) per part; parts with equal points are returned once. None if some part is
        open, flat or not convex, or if there are more than `most` parts.
    """
    corners = np.asarray(faces, dtype=np.int64)
    distinct, place = np.unique(points[corners.reshape(-1)], axis=0, return_inverse=True)
    corners = place.reshape(-1, 3)
    same = _welded(_normalised(distinct))[corners]
    # A repeated triangle, in either winding, adds nothing.
    _, first = np.unique(np.sort(same, axis=1), axis=0, return_index=True)
    corners, same = corners[first], same[first]
    parts = _connected(same)
    kinds = np.unique(parts)
    if len(kinds) > most:
        return None
    found: dict[bytes, Floats] = {}
    for kind in kinds:
        mine = parts == kind
        part = np.ascontiguousarray(distinct[np.unique(corners[mine])])
        closed = (_edges(same[mine])[1] == 2).all()
        if not closed or is_flat(part) or not is_convex(distinct, corners[mine]):
            return None
        found[part.tobytes()] = part
    return list(found.values())


def _edges(corners: _Ids) -> tuple[_Ids, _Ids]:
    """The edge number of each triangle's side, (3 m,), and the number of triangles at each edge."""
    low, high = corners, np.roll(corners, -1, axis=1)
    low, high = np.minimum(low, high).reshape(-1), np.maximum(low, high).reshape(-1)
    _, edge, counts = np.unique(
        low * (corners.max() + 1) + high, return_inverse=True, return_counts=True
    )
    return edge.reshape(-1), counts


def _connected(corners: _Ids) -> _Ids:
    """The part number of each triangle.

    Triangles join over edges that exactly two of them share.
    """
    edge, counts = _edges(corners)
    order = np.argsort(edge, kind="stable")
    starts = np.cumsum(counts) - counts
    pairs = starts[counts == 2]
    one, other = order[pairs] // 3, order[pairs + 1] // 3
    number = np.arange(len(corners))
    while True:
        before = number.copy()
        lowest = np.minimum(number[one], number[other])
        np.minimum.at(number, one, lowest)
        np.minimum.at(number, other, lowest)
        number = number[number]
        if (number == before).all():
            return number


def _dented(points: Floats, faces: Any) -> tuple[Floats, Floats, int] | None:
    """The hull's triangles, the mesh's triangles and the number of the mesh's open edges.

    None if the mesh is convex or flat.
    """
    corners = np.asarray(faces, dtype=np.int64)
    distinct, place = np.unique(points[corners.reshape(-1)], axis=0, return_inverse=True)
    scaled, corners = _normalised(distinct), place.reshape(-1, 3)
    start = _quickhull.simplex(scaled)
    if start is None:
        return None
    numbers = [np.arange(len(scaled)), _welded(scaled)]
    few = len(scaled) * len(corners) <= _FEW
    if few and _is_shell(scaled, scaled, corners, numbers):
        return None
    error = min(_HULL_ERROR * TOLERANCE, _HULL_ERROR_OF_HEIGHT * start[1])
    facets = _quickhull.hull(scaled, start[0], max(error, 2 * _quickhull.FLAT))
    outer = scaled[np.unique(facets)]
    if not few and _is_shell(outer, scaled, corners, numbers):
        return None
    hull, mesh = scaled[facets], scaled[corners]
    limit = (1 - CONVEX_RATIO) * abs(_volume(hull))
    if _missing(hull, _nearest.Tree(mesh), limit, error) <= limit:
        return None
    return hull, mesh, min(_open_edges(same[corners]) for same in numbers)


def _normalised(points: Floats) -> Floats:
    """Moves the points to the middle of their bounding box and divides them by its diagonal."""
    low, high = points.min(axis=0), points.max(axis=0)
    # Divide by the largest extent first, because the square of an extent may overflow or underflow.
    extent = float((high - low).max()) or 1.0
    scaled = (points - (low + (high - low) / 2)) / extent
    return scaled / (float(np.linalg.norm((high - low) / extent)) or 1.0)


def _volume(triangles: Floats) -> float:
    """The signed volume: positive if the triangles are oriented outward."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    return float(np.einsum("ni,ni->", a, np.cross(b, c))) / 6


def _is_shell(outer: Floats, points: Floats, corners: _Ids, numbers: Sequence[_Ids]) -> bool:
    """Whether the triangles that have all outer points below their planes surround the middle.

    Args:
        outer: (k, 3): the corners of the hull.
        points, corners: the mesh.
        numbers: one or more numberings of the points; points with the same number count as one.
    """
    middle = outer.mean(axis=0)
    a, b, c = points[corners].swapaxes(0, 1) - middle
    normals = np.cross(b - a, c - a)
    areas = np.linalg.norm(normals, axis=1) / 2
    normals /= np.where(areas > 0, 2 * areas, np.inf)[:, None]
    offsets = np.einsum("ni,ni->n", normals, a)
    # A triangle is oriented outward if the middle is below its plane.
    outward = np.where(offsets[:, None] < 0, corners[:, ::-1], corners)
    normals = np.where(offsets[:, None] < 0, -normals, normals)
    offsets = np.abs(offsets)
    kept = np.flatnonzero(areas > 0)
    heights = np.zeros(0)
    # Test a few extreme points first. They already rule out most triangles of a mesh that is not
    # convex.
    extreme = np.unique(np.argmax(outer @ _DIRECTIONS.T, axis=0))
    for some in (outer[extreme] - middle, outer - middle):
        heights = np.empty(len(kept))
        for part in np.array_split(np.arange(len(kept)), 1 + len(kept) * len(some) // _AT_ONCE):
            heights[part] = (some @ normals[kept[part]].T).max(axis=0)
        heights = (heights - offsets[kept]).clip(min=0.0)
        # Along any ray from the middle, the hull is beyond the triangle by at most the fraction
        # height / offset of the distance to it.
        below = heights <= TOLERANCE * offsets[kept]
        kept, heights = kept[below], heights[below]
        if not len(kept) or all(_open_edges(same[outward[kept]]) for same in numbers):
            return False
    solid = float((areas * offsets)[kept].sum()) / 3
    return float((areas[kept] * heights).sum()) <= (1 - CONVEX_RATIO) * solid


def _open_edges(corners: _Ids) -> int:
    """The number of sides that are not matched by a side in the opposite direction."""
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    low, high = sides.min(axis=1), sides.max(axis=1)
    _, edge = np.unique(low * (corners.max() + 1) + high, return_inverse=True)
    # A side from a vertex to itself counts as 0.
    balance = np.bincount(edge.reshape(-1), weights=np.sign(sides[:, 1] - sides[:, 0]))
    return int(np.abs(balance).sum())


def _welded(points: Floats) -> _Ids:
    """Numbers the points, so that points within the tolerance of each other share a number.

    Two such points share a cell in at least one of eight grids, which are shifted by half a cell.
    All points of a cell get the lowest number in that cell; this is repeated until no number
    changes.
    """
    shifts = itertools.product((0.0, 0.5), repeat=3)
    grids = [
        np.unique(np.floor(points / (2 * _WELD) + shift), axis=0, return_inverse=True)[1]
        for shift in shifts
    ]
    number = np.arange(len(points))
    while True:
        before = number
        for cells in grids:
            lowest = np.full(len(points), len(points))
            np.minimum.at(lowest, cells.reshape(-1), number)
            number = lowest[cells.reshape(-1)]
        if (number == before).all():
            return number


def _missing(hull: Floats, mesh: _nearest.Tree, limit: float, error: float) -> float:
    """The volume between the hull and the mesh; infinity if some point of the hull is too far.

    Args:
        hull: the hull's triangles.
        mesh: the tree of the mesh's triangles.
        limit: the sum stops once the volume exceeds this.
        error: how far the mesh may be outside the computed hull.
    """
    cells, volume = hull, 0.0
    while len(cells) and volume <= limit:
        middles = cells.mean(axis=1)
        radii = np.linalg.norm(cells - middles[:, None], axis=2).max(axis=1)
        gaps, which = mesh.nearest(middles, TOLERANCE)
        if gaps.max() > TOLERANCE:
            return np.inf
        one = np.repeat(mesh.triangles[which], 3, axis=0)
        at_corners = _nearest.distances(cells.reshape(-1, 3), one).reshape(-1, 3).max(axis=1)
        bound = np.minimum(at_corners, gaps + radii)
        fine = (radii <= _SAMPLED_RADIUS) | (at_corners <= _SMALLEST_RADIUS)
        done = ((bound <= TOLERANCE) & fine) | (radii <= _SMALLEST_RADIUS)
        volume += float(np.sum(_areas(cells[done]) * (gaps[done] - error).clip(min=0.0)))
        cells = _halved(cells[~done])
    return volume


def _halved(cells: Floats) -> Floats:
    """Cuts each cell in two at its longest side, so that slivers become compact."""
    ends = np.roll(cells, -1, axis=1)
    longest = np.argmax(np.linalg.norm(ends - cells, axis=2), axis=1)
    turned = (longest[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(cells, turned[:, :, None], axis=1).swapaxes(0, 1)
    middle = (a + b) / 2
    return np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])


def _areas(triangles: Floats) -> Floats:
    a, b, c = triangles.swapaxes(0, 1)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def _filled(hull: Floats, mesh: Floats) -> float:
    """The fraction of the hull that the mesh fills, by lines along the three coordinate axes.

    A point of the hull counts as empty if one of the lines through it meets the mesh on one side of
    the point only, or nowhere. Such a point can see the outside.
    """
    low, high = hull.min(axis=(0, 1)), hull.max(axis=(0, 1))
    step = (high - low) / _LINES
    middles = low + (np.arange(_LINES)[:, None] + 0.5) * step
    points = np.stack(np.meshgrid(*middles.T, indexing="ij"), axis=-1)
    inside, filled = (np.ones((_LINES,) * 3, dtype=bool) for _ in range(2))
    for axis in range(3):
        for surface, kept in ((hull, inside), (mesh, filled)):
            first, last = _ends(surface, axis, low, step)
            at = points[..., axis]
            kept &= (np.expand_dims(first, axis) <= at) & (at <= np.expand_dims(last, axis))
    return float((filled & inside).sum() / max(1, inside.sum()))


def _ends(triangles: Floats, axis: int, low: Floats, step: Floats) -> tuple[Floats, Floats]:
    """Where each line along an axis first and last meets a triangle; two arrays (lines, lines)."""
    first = np.full(_LINES * _LINES, np.inf)
    last = np.full(_LINES * _LINES, -np.inf)
    x, y = (i for i in range(3) if i != axis)
    flat = triangles[:, :, (x, y)]
    # The range of lines that cross each triangle's bounding box.
    begin = np.ceil((flat.min(axis=1) - low[[x, y]]) / step[[x, y]] - 0.5).astype(np.int64)
    end = np.floor((flat.max(axis=1) - low[[x, y]]) / step[[x, y]] - 0.5).astype(np.int64)
    begin, end = begin.clip(min=0), end.clip(max=_LINES - 1)
    counts = (end - begin + 1).clip(min=0)
    sizes = counts.prod(axis=1)
    for part in np.array_split(np.arange(len(triangles)), 1 + int(sizes.sum()) // _nearest.PAIRS):
        which = np.repeat(part, sizes[part])
        place = np.arange(len(which)) - np.repeat(np.cumsum(sizes[part]) - sizes[part], sizes[part])
        cell = begin[which] + np.stack(np.divmod(place, counts[which, 1]), axis=1)
        point = low[[x, y]] + (cell + 0.5) * step[[x, y]]
        a, b, c = flat[which].swapaxes(0, 1)
        weights = np.stack([_turn(b, c, point), _turn(c, a, point), _turn(a, b, point)])
        area = weights.sum(axis=0)
        met = ((weights >= 0).all(axis=0) | (weights <= 0).all(axis=0)) & (area != 0)
        weights = weights[:, met] / area[met]
        at = np.einsum("in,ni->n", weights, triangles[which[met], :, axis])
        line = cell[met, 0] * _LINES + cell[met, 1]
        np.minimum.at(first, line, at)
        np.maximum.at(last, line, at)
    return first.reshape(_LINES, _LINES), last.reshape(_LINES, _LINES)


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Twice the signed area of each triangle (a, b, c) in the plane."""
    u, v = b - a, c - a
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

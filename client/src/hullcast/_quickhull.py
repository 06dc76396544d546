"""The surface of a convex hull to a given error, by quickhull.

The algorithm adds the point that is farthest above some facet, until no point is above a facet by
more than the error. A fine mesh needs far fewer facets than it has vertices, so the time hardly
depends on how fine the mesh is.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ._arrays import Floats

#: Points count as flat, without a hull, if their distance from one plane is at most this fraction
#: of their extent.
FLAT = 1e-9

_Ids = npt.NDArray[np.int64]


def simplex(points: Floats) -> tuple[list[int], float] | None:
    """Four points far from one plane, and the height of the last one; None if the points are flat.

    The extent of the points must be about 1.
    """
    if len(points) < 4:
        return None
    a = int(np.argmin(points[:, np.argmax(np.ptp(points, axis=0))]))
    b = int(np.argmax(np.linalg.norm(points - points[a], axis=1)))
    along = points[b] - points[a]
    off = np.linalg.norm(np.cross(points - points[a], along), axis=1)
    c = int(np.argmax(off))
    if not off[c] > FLAT * float(np.linalg.norm(along)):
        return None
    normal = np.cross(along, points[c] - points[a])
    heights = (points - points[a]) @ (normal / np.linalg.norm(normal))
    d = int(np.argmax(np.abs(heights)))
    if not abs(heights[d]) > FLAT:
        return None
    corners = [a, c, b, d] if heights[d] > 0 else [a, b, c, d]
    return corners, float(abs(heights[d]))


class _Facets:
    """The numbered facets of a growing hull. Each facet has the list of the points above it."""

    def __init__(self, points: Floats) -> None:
        self.points = points
        self.corners: dict[int, tuple[int, int, int]] = {}
        self.planes: dict[int, tuple[Floats, float]] = {}
        self.above: dict[int, _Ids] = {}
        #: The facet to the left of each directed side.
        self.of_side: dict[tuple[int, int], int] = {}
        #: A heap of (-height, facet, point): the farthest point above each facet. Removed facets
        #: remain in it.
        self.queue: list[tuple[float, int, int]] = []
        self._next = 0

    def add(self, corners: list[tuple[int, int, int]], candidates: _Ids) -> None:
        """Adds facets; each candidate point is assigned to the facet that it is highest above."""
        a, b, c = self.points[np.array(corners)].swapaxes(0, 1)
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
        # A facet without area gets a zero normal, so that no point is above it.
        normals = normals / np.where(lengths > 0, lengths, np.inf)[:, None]
        offsets = np.einsum("ni,ni->n", normals, a)
        heights = self.points[candidates] @ normals.T - offsets
        highest = np.argmax(heights, axis=1)
        top = heights[np.arange(len(candidates)), highest]
        for i, facet in enumerate(corners):
            number = self._next
            self._next += 1
            self.corners[number] = facet
            self.planes[number] = (normals[i], float(offsets[i]))
            for side in _sides(facet):
                self.of_side[side] = number
            mine = np.flatnonzero((highest == i) & (top > FLAT))
            self.above[number] = candidates[mine]
            if mine.size:
                best = mine[np.argmax(top[mine])]
                heapq.heappush(self.queue, (-float(top[best]), number, int(candidates[best])))

    def remove(self, number: int) -> _Ids:
        """Removes a facet, and returns the points that were above it."""
        for side in _sides(self.corners.pop(number)):
            if self.of_side.get(side) == number:
                del self.of_side[side]
        del self.planes[number]
        return self.above.pop(number)

    def visible(self, first: int, point: int) -> tuple[set[int], list[tuple[int, int]]]:
        """The facets that are visible from a point above `first`, and the sides around them."""
        seen, waiting, around = {first}, [first], list[tuple[int, int]]()
        while waiting:
            for side in _sides(self.corners[waiting.pop()]):
                other = self.of_side.get((side[1], side[0]))
                if other is None or other in seen:
                    continue
                normal, offset = self.planes[other]
                if float(normal @ self.points[point]) - offset > 0:
                    seen.add(other)
                    waiting.append(other)
        for number in seen:
            for side in _sides(self.corners[number]):
                if self.of_side.get((side[1], side[0])) not in seen:
                    around.append(side)
        return seen, around


def _sides(facet: tuple[int, int, int]) -> Iterator[tuple[int, int]]:
    a, b, c = facet
    yield a, b
    yield b, c
    yield c, a


def hull(points: Floats, start: list[int], error: float) -> _Ids:
    """(k, 3): outward triangles such that no point is above any by more than the error.

    Args:
        points: (n, 3).
        start: the four points of `simplex`.
        error: greater than `FLAT`.
    """
    a, b, c, d = start
    facets = _Facets(points)
    facets.add([(a, b, c), (a, d, b), (b, d, c), (c, d, a)], np.arange(len(points)))
    while facets.queue:
        height, number, point = heapq.heappop(facets.queue)
        if -height <= error:
            break
        if number not in facets.corners:
            continue
        seen, around = facets.visible(number, point)
        above = np.concatenate([facets.remove(facet) for facet in sorted(seen)])
        facets.add([(*side, point) for side in sorted(around)], above[above != point])
    return np.array(list(facets.corners.values()), dtype=np.int64)

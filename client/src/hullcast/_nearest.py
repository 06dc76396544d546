"""Distances from points to the nearest of many triangles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ._arrays import Floats

#: The largest number of pairs of a point and a triangle in one array operation.
PAIRS = 1 << 18
#: The number of triangles in a leaf of the tree.
_LEAF = 4

_Ids = npt.NDArray[np.int64]


class Tree:
    """A binary tree of boxes over triangles that are sorted along a space-filling curve."""

    def __init__(self, triangles: Floats) -> None:
        middles = triangles.mean(axis=1)
        grid = np.clip((middles + 0.5) * 1024, 0, 1023).astype(np.int64)
        code = np.zeros(len(grid), dtype=np.int64)
        for bit in range(10):
            for axis in range(3):
                code |= ((grid[:, axis] >> bit) & 1) << (3 * bit + axis)
        self.triangles = triangles[np.argsort(code, kind="stable")]
        leaves = 1 << max(0, (-(-len(triangles) // _LEAF) - 1).bit_length())
        low = np.full((leaves * _LEAF, 3), np.inf)
        high = np.full((leaves * _LEAF, 3), -np.inf)
        low[: len(triangles)] = self.triangles.min(axis=1)
        high[: len(triangles)] = self.triangles.max(axis=1)
        own = (low, high)
        low = low.reshape(leaves, _LEAF, 3).min(axis=1)
        high = high.reshape(leaves, _LEAF, 3).max(axis=1)
        #: From the root down: the low and high corners of the boxes of each level; last, those of
        #: the triangles.
        self._levels = [(low, high)]
        while len(low) > 1:
            low, high = low.reshape(-1, 2, 3).min(axis=1), high.reshape(-1, 2, 3).max(axis=1)
            self._levels.insert(0, (low, high))
        self._levels.append(own)

    def near(self, points: Floats, reach: float) -> Iterator[tuple[_Ids, _Ids]]:
        """Yields, in parts, the pairs of a point and a triangle whose boxes are within `reach`."""
        waiting = [(0, np.arange(len(points)), np.zeros(len(points), dtype=np.int64))]
        while waiting:
            level, point, node = waiting.pop()
            if len(point) > PAIRS:
                half = len(point) // 2
                waiting += [(level, point[half:], node[half:]), (level, point[:half], node[:half])]
                continue
            low, high = self._levels[level]
            p = points[point]
            close = ((low[node] - reach <= p) & (p <= high[node] + reach)).all(axis=1)
            point, node = point[close], node[close]
            left = len(self._levels) - level - 1
            if left == 0:
                yield point, node
                continue
            width = _LEAF if left == 1 else 2
            node = (node[:, None] * width + np.arange(width)).reshape(-1)
            waiting.append((level + 1, np.repeat(point, width), node))

    def nearest(self, points: Floats, reach: float) -> tuple[Floats, _Ids]:
        """The distance from each point to the nearest triangle within `reach`, and that triangle.

        A point without such a triangle gets infinity and -1. A first search with a small reach
        settles most points at the cost of few comparisons.
        """
        best = np.full(len(points), np.inf)
        which = np.full(len(points), -1)
        for radius in (reach / 8, reach):
            open_ = np.flatnonzero(best > radius)
            for place, triangle in self.near(points[open_], radius):
                point = open_[place]
                found = distances(points[point], self.triangles[triangle])
                order = np.lexsort((found, point))
                owners, first = np.unique(point[order], return_index=True)
                least = order[first]
                nearer = found[least] < best[owners]
                best[owners[nearer]] = found[least][nearer]
                which[owners[nearer]] = triangle[least][nearer]
        return best, which


def distances(points: Floats, triangles: Floats) -> Floats:
    """(n,): the distance from each point to the triangle in the same row."""
    p = points.T
    a, b, c = (triangles[:, i].T for i in range(3))
    normal = cross(b - a, c - a)
    square = dot(normal, normal)
    inside = square > 0
    result = np.full(len(points), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        along, to = end - start, p - start
        inside &= dot(cross(along, to), normal) >= 0
        length = dot(along, along)
        share = dot(along, to) / np.where(length > 0, length, 1.0)
        off = to - np.clip(share, 0.0, 1.0) * along
        result = np.minimum(result, dot(off, off))
    height = dot(p - a, normal)
    plane = height * height / np.where(square > 0, square, 1.0)
    return np.sqrt(np.where(inside, np.minimum(plane, result), result))


def cross(a: Floats, b: Floats) -> Floats:
    """The cross products of the columns of two (3, n) arrays."""
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def dot(a: Floats, b: Floats) -> Floats:
    """The dot products of the columns of two (3, n) arrays."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]

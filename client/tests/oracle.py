"""Exact solutions for pairs of convex hulls, in rational arithmetic.

The tests compare the server with these solutions, which are exact for the given floats. This module
shares no code with the server, rounds nothing before the end, and uses no tolerances. It is simple
but slow: some milliseconds per pair.

A quaternion q gives the rotation I + (2 / |q|^2)(...), which is rational and needs no square root.
Vertices are kept as integers over one common denominator, so that the simplex method needs no
greatest common divisors.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

Vector = tuple[Fraction, Fraction, Fraction]
Integers = tuple[int, int, int]


def exact(values: Sequence[float]) -> Vector:
    """Converts three floats to the rationals with the same values."""
    x, y, z = (Fraction(float(v)) for v in values)
    return x, y, z


def dot(a, b):
    """The dot product of vectors of any numbers."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    """The cross product of vectors of any numbers."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def add(a, b):
    """The sum of vectors of any numbers."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def sub(a, b):
    """The difference of vectors of any numbers."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scaled(k, a):
    """A vector of any numbers, multiplied by k."""
    return k * a[0], k * a[1], k * a[2]


def rotation(quaternion: Sequence[float]) -> tuple[Vector, Vector, Vector]:
    """The rows of the exact rotation matrix of a quaternion x, y, z, w of any norm."""
    x, y, z, w = (Fraction(float(v)) for v in quaternion)
    s = 2 / (x * x + y * y + z * z + w * w)
    return (
        (1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)),
        (s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)),
        (s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)),
    )


@dataclass(frozen=True)
class ExactBody:
    """A hull at a pose, with exact world points."""

    #: World axes, relative to `position`.
    vertices: tuple[Vector, ...]
    #: The contraction point, relative to `position` too.
    centre: Vector
    position: Vector

    @staticmethod
    def make(vertices, contraction_point, position, quaternion) -> ExactBody:
        """Makes a body from the server's floats: (n, 3), (3,), (3,), and (4,) as x, y, z, w."""
        rows = rotation(quaternion)

        def turn(point) -> Vector:
            p = exact(point)
            return dot(rows[0], p), dot(rows[1], p), dot(rows[2], p)

        return ExactBody(tuple(turn(v) for v in vertices), turn(contraction_point), exact(position))


def _integers(vectors: Sequence[Vector]) -> tuple[list[Integers], int]:
    """Numerators of vectors over one common denominator, and the denominator.

    The denominator has 80 bits to spare, so that small lengths are integers too.
    """
    unit = math.lcm(*(c.denominator for v in vectors for c in v)) << 80
    over = [tuple(c.numerator * (unit // c.denominator) for c in v) for v in vectors]
    return [(x, y, z) for x, y, z in over], unit


class ExactPair:
    """Two bodies, with their growth scale, support values and distance."""

    def __init__(self, a: ExactBody, b: ExactBody) -> None:
        self.a, self.b = a, b
        #: The centre offset pB - pA.
        self.d: Vector = sub(add(b.position, b.centre), add(a.position, a.centre))
        rim_a = [sub(v, a.centre) for v in a.vertices]
        rim_b = [sub(v, b.centre) for v in b.vertices]
        everything, self._unit = _integers([*rim_a, *rim_b, self.d])
        self._a = everything[: len(rim_a)]
        self._b = everything[len(rim_a) : -1]
        self._d = everything[-1]

    def _extreme(self, n) -> Integers:
        """The vertex of the centred Minkowski difference K that is farthest along n."""
        far_a = max(self._a, key=lambda v: dot(n, v))
        return sub(far_a, min(self._b, key=lambda v: dot(n, v)))

    def support(self, n: Sequence[float | Fraction]) -> Fraction:
        """The support value h_K(n) for a direction n of any length."""
        direction = [Fraction(c) for c in n]
        return dot(direction, self._extreme(direction)) / self._unit

    def separation(self, n: Sequence[float | Fraction]) -> Fraction:
        """The separation s(n) = n.d - h_K(n) for n as it is, without normalisation."""
        return dot([Fraction(c) for c in n], self.d) - self.support(n)

    @functools.cached_property
    def growth(self) -> tuple[Fraction, Vector]:
        """The growth scale alpha, and an optimal normal n with h_K(n) = 1 (n = 0 if d = 0)."""
        if self._d == (0, 0, 0):
            return Fraction(0), self.d
        # The simplex method starts from three points on the axes, too near the centre to matter. If
        # K is flatter than that, they are moved nearer.
        size = max(abs(c) for v in (*self._a, *self._b) for c in v)
        for bits in itertools.count(10, 20):
            found = self._simplex(max(1, size >> bits))
            if found is not None:
                return found
        raise AssertionError

    def _simplex(self, start: int) -> tuple[Fraction, Vector] | None:
        """Solves min sum l_i subject to sum l_i c_i = d, l >= 0, by the primal simplex method.

        The columns c_i are the vertices of K, priced hull by hull, and `start` times the axes. The
        right-hand side is d + (e, e^2, e^3) for an infinitesimal e; that is, rows are compared in
        lexicographic order. So the method also ends at ties. If the last basis has only vertices of
        K, then l and n are feasible and complementary, whatever the start was. Otherwise the result
        is None.
        """
        axes = [[start if row == i else 0 for row in range(3)] for i in range(3)]
        basis = [scaled(1 if self._d[i] >= 0 else -1, axes[i]) for i in range(3)]
        artificial = set(basis)
        while True:
            c0, c1, c2 = basis
            rows = [cross(c1, c2), cross(c2, c0), cross(c0, c1)]
            det = dot(c0, rows[0])
            if det < 0:
                det, rows = -det, [scaled(-1, row) for row in rows]
            # n / det is 1 on the basis. It is optimal if it exceeds 1 at no vertex.
            n = add(add(rows[0], rows[1]), rows[2])
            entering = self._extreme(n)
            if dot(n, entering) <= det:
                if artificial & set(basis):
                    return None
                return Fraction(dot(n, self._d), det), scaled(Fraction(self._unit, det), n)
            leaving = [
                (*(Fraction(v, step) for v in (dot(row, self._d), *row)), i)
                for i, row in enumerate(rows)
                if (step := dot(row, entering)) > 0
            ]
            basis[min(leaving)[-1]] = entering

    @functools.cached_property
    def distance_squared(self) -> Fraction:
        """The squared distance between the hulls; 0 if they touch or overlap.

        Wolfe's algorithm (Finding the nearest point in a polytope, 1976) is finite, and exact in
        rational arithmetic. It ends when x.p >= x.x for every vertex p of B - A.
        """

        def nearest_vertex(x):
            return sub(self._d, self._extreme(x))  # minimises x.p, because p = d - (a - b)

        corral = [nearest_vertex(self._d)]
        weights = [Fraction(1)]
        while True:
            x = _combine(weights, corral)
            entering = nearest_vertex(x)
            if dot(x, entering) >= dot(x, x):
                return dot(x, x) / self._unit**2
            corral.append(entering)
            weights.append(Fraction(0))
            while True:
                affine = _affine_minimum(corral)
                if min(affine) >= 0:
                    weights = affine
                else:
                    step = min(w / (w - m) for w, m in zip(weights, affine, strict=True) if m < 0)
                    weights = [w + step * (m - w) for w, m in zip(weights, affine, strict=True)]
                kept = [i for i, weight in enumerate(weights) if weight > 0]
                corral, weights = [corral[i] for i in kept], [weights[i] for i in kept]
                if min(affine) >= 0:
                    break


def _combine(weights, points):
    total = (Fraction(0),) * 3
    for weight, point in zip(weights, points, strict=True):
        total = add(total, scaled(weight, point))
    return total


def _affine_minimum(points) -> list[Fraction]:
    """The weights, with sum 1, of the point nearest to 0 in the affine hull of up to 4 points."""
    origin, *others = points
    if not others:
        return [Fraction(1)]
    edges = [sub(p, origin) for p in others]
    gram = [[Fraction(dot(e, f)) for f in edges] + [-Fraction(dot(e, origin))] for e in edges]
    rest = _solve(gram)
    return [1 - sum(rest), *rest]


def _solve(rows: list[list[Fraction]]) -> list[Fraction]:
    """Gauss-Jordan elimination of a regular system, with the right-hand side in the last column."""
    size = len(rows)
    for column in range(size):
        pivot = next(i for i in range(column, size) if rows[i][column])
        rows[column], rows[pivot] = rows[pivot], rows[column]
        head = [v / rows[column][column] for v in rows[column]]
        rows[column] = head
        for i in range(size):
            if i != column and rows[i][column]:
                factor = rows[i][column]
                rows[i] = [v - factor * h for v, h in zip(rows[i], head, strict=True)]
    return [row[-1] for row in rows]


def patch(face_a: Sequence[Vector], face_b: Sequence[Vector], n: Vector) -> list[Vector]:
    """The corners of the faces' intersection as seen along n, lifted onto A's face.

    A face is given by its corners, a convex polygon of any orientation that is not in a plane along
    n. The polygons are clipped by half-planes (Sutherland and Hodgman 1974) in two coordinates; the
    coordinate in which n is largest is dropped.
    """
    k = max(range(3), key=lambda i: abs(n[i]))
    i, j = (k + 1) % 3, (k + 2) % 3

    def flat(p):
        t = p[k] / n[k]
        return p[i] - t * n[i], p[j] - t * n[j]

    def anticlockwise(polygon):
        twice = sum(_turn((0, 0), p, q) for p, q in _sides(polygon))
        return polygon if twice > 0 else polygon[::-1]

    region = anticlockwise([flat(p) for p in face_a])
    for p, q in _sides(anticlockwise([flat(p) for p in face_b])):
        clipped = []
        for s, e in _sides(region):
            at_s, at_e = _turn(p, q, s), _turn(p, q, e)
            if at_s >= 0:
                clipped.append(s)
            if (at_s > 0 > at_e) or (at_s < 0 < at_e):
                t = at_s / (at_s - at_e)
                clipped.append((s[0] + t * (e[0] - s[0]), s[1] + t * (e[1] - s[1])))
        region = clipped
    region = [p for p, q in _sides(region) if p != q]
    plane = cross(sub(face_a[1], face_a[0]), sub(face_a[2], face_a[0]))

    def lifted(u) -> Vector:
        point = [Fraction(0)] * 3
        point[i], point[j] = u
        t = dot(plane, sub(face_a[0], point)) / dot(plane, n)
        return add(point, scaled(t, n))

    return [lifted(u) for u in region]


def _sides(polygon):
    return itertools.pairwise([*polygon, *polygon[:1]])


def _turn(p, q, r):
    return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

"""Properties that every result must have, checked against the exact solution.

The budgets are those of the documentation; u is the unit roundoff of double precision.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from cases import Case, matrix
from oracle import dot

import hullcast
from hullcast import FeatureKind, Flag, Outcome

U = 2.0**-53
NONE = 2**32 - 1


@dataclass
class Coverage:
    """Counts the kinds of results in a sweep, so that a test can assert that it was not vacuous."""

    counts: Counter[str] = field(default_factory=Counter)

    def note(self, pair: hullcast.Manifold) -> None:
        """Counts a result's outcome, flags, features and number of points."""
        self.counts[pair.outcome.name] += 1
        for flag in Flag:
            self.counts[str(flag.name)] += bool(pair.flags & flag)
        if pair.outcome == Outcome.CONTACT:
            kinds = sorted(kind.name.lower() for kind in pair.feature_kinds)
            self.counts["-".join(kinds)] += 1
            self.counts["many points"] += len(pair.distance) >= 3


class Budget:
    """The lengths of a pair, and the error budgets that follow from them."""

    def __init__(self, case: Case, tolerance: float = 0.0) -> None:
        a, b = case.hulls
        self.r = a.inradius + b.inradius
        self.R = a.circumradius + b.circumradius
        self.planarity = a.geometric_error + b.geometric_error
        t = case.positions
        self.M = np.linalg.norm(t[1] - t[0]) + sum(
            np.linalg.norm(h.contraction_point) for h in case.hulls
        )
        self.d = float(np.sqrt(float(dot(case.exact.d, case.exact.d))))
        self.L = float(np.abs(t).max())
        self.tolerance = tolerance

    def alpha(self, alpha: float) -> float:
        """The budget of alpha, and of the normal's optimality."""
        return alpha * (self.tolerance + 16 * U * self.R / self.r) + 16 * U * self.M / self.r

    def width(self, upper: float) -> float:
        """The largest allowed width of the bracket."""
        return upper * (self.tolerance + 64 * U * self.R / self.r) + 32 * U * self.M / self.r

    @property
    def separation(self) -> float:
        """The budget of lengths along the normal, and of the margin's rounding band."""
        return 64 * U * (self.R + self.d) + 16 * U * self.M

    @property
    def world(self) -> float:
        """The budget of world points against their features."""
        return 64 * U * (self.R + self.M) + 4 * U * self.L


def check(case: Case, pair: hullcast.Manifold, hulls: Hulls, tolerance: float = 0.0) -> None:
    """Checks all properties of one pair's result, which must have all outputs."""
    budget = Budget(case, tolerance)
    check_outcome(case, pair, budget)
    check_growth(case, pair, budget)
    if pair.outcome == Outcome.SEPARATED:
        check_rejection(case, pair, budget)
    else:
        check_normal(case, pair, budget)
        check_points(case, pair, budget)
        if not pair.flags & Flag.ESTIMATED:
            check_witnesses(case, pair, budget, hulls)
    allowed = Flag.ESTIMATED | Flag.COINCIDENT
    assert not pair.flags & ~allowed, pair


def check_outcome(case: Case, pair: hullcast.Manifold, budget: Budget) -> None:
    """The outcome agrees with the exact distance, except within the rounding band."""
    if np.isinf(case.margin):
        assert pair.outcome == Outcome.CONTACT
        return
    # Compare squares, which stay rational.
    distance, margin = case.exact.distance_squared, Fraction(case.margin)
    if distance <= margin**2:
        assert pair.outcome == Outcome.CONTACT, pair
    elif distance > (margin + Fraction(budget.separation)) ** 2:
        assert pair.outcome == Outcome.SEPARATED, pair
    else:
        assert pair.outcome in (Outcome.CONTACT, Outcome.SEPARATED), pair


def check_growth(case: Case, pair: hullcast.Manifold, budget: Budget) -> None:
    """Exact alpha is in the bracket, the bracket is as tight as requested, and alpha is near it."""
    alpha = case.exact.growth[0]
    assert Fraction(pair.alpha_lower) <= alpha, pair
    if pair.outcome == Outcome.SEPARATED:
        return
    assert alpha <= Fraction(pair.alpha_upper), pair
    assert pair.alpha_lower <= pair.alpha <= pair.alpha_upper
    assert pair.alpha_upper - pair.alpha_lower <= budget.width(pair.alpha_upper), pair
    assert abs(float(Fraction(pair.alpha) - alpha)) <= budget.alpha(float(alpha)), pair


def check_rejection(case: Case, pair: hullcast.Manifold, budget: Budget) -> None:
    """For SEPARATED, the bounds hold, the direction separates, and there are no points."""
    exact = case.exact
    assert Fraction(pair.alpha) <= exact.growth[0]
    assert pair.alpha_upper == np.inf
    assert pair.separation > 0
    assert Fraction(pair.separation) ** 2 <= exact.distance_squared
    assert float(exact.separation(pair.normal)) >= case.margin - budget.separation
    assert len(pair.distance) == 0
    assert pair.feature_kinds == (FeatureKind.NONE, FeatureKind.NONE)
    assert (pair.feature_indices == NONE).all()


def check_normal(case: Case, pair: hullcast.Manifold, budget: Budget) -> None:
    """The normal is optimal (it need not be a particular one), and the separation is its s(n)."""
    exact, n = case.exact, pair.normal
    alpha = exact.growth[0]
    assert abs(n @ n - 1) <= 16 * U
    reached = dot([Fraction(c) for c in n], exact.d) / exact.support(n)
    assert float(alpha - reached) <= budget.alpha(float(alpha)), pair
    s = exact.separation(n)
    assert abs(float(Fraction(pair.separation) - s)) <= budget.separation, pair
    # The paper's relation (1), for a normal that is optimal within the budget.
    apart, gap = abs(1 - float(alpha)), budget.alpha(float(alpha))
    assert budget.r * (apart - gap) - budget.separation <= abs(pair.separation)
    if not pair.flags & Flag.COINCIDENT:
        assert abs(pair.separation) <= budget.R * (apart + gap) + budget.separation


def check_points(case: Case, pair: hullcast.Manifold, budget: Budget) -> None:
    """There are points, no deeper than s(n), and witnesses differ only along the normal."""
    assert len(pair.distance) >= 1, pair
    assert len(np.unique(pair.point_ids, axis=0)) == len(pair.distance), pair
    apart = pair.witness_b - pair.witness_a - pair.distance[:, None] * pair.normal
    assert np.abs(apart).max() <= budget.world
    least = float(case.exact.separation(pair.normal)) - budget.separation - budget.planarity
    assert pair.distance.min() >= least, pair


def check_witnesses(case: Case, pair: hullcast.Manifold, budget: Budget, hulls: Hulls) -> None:
    """Each witness lies on the feature that the result names."""
    kinds, indices = pair.feature_kinds, pair.feature_indices.reshape(2, 2)
    for side, witnesses in enumerate((pair.witness_a, pair.witness_b)):
        turn = matrix(case.rotations[side])
        local = (witnesses - case.positions[side]) @ turn
        corners = hulls.corners(case, side, kinds[side], indices[side])
        slack = case.hulls[side].geometric_error + 4 * budget.world
        for point in local:
            assert distance_to_polygon(point, corners) <= slack, (pair, side)


def distance_to_polygon(point: np.ndarray, corners: np.ndarray) -> float:
    """The distance from a point to a vertex (1 corner), a segment (2) or a convex polygon."""
    if len(corners) > 2:
        sides = np.roll(corners, -1, axis=0) - corners
        normal = np.sum(np.cross(sides, np.roll(sides, -1, axis=0)), axis=0)
        normal /= np.linalg.norm(normal)
        inward = np.cross(normal, sides)
        if (np.sum((point - corners) * inward, axis=1) >= 0).all():
            return float(abs((point - corners[0]) @ normal))
    ends = np.roll(corners, -1, axis=0)
    along = ends - corners
    length = np.maximum(np.sum(along * along, axis=1), np.finfo(float).tiny)
    t = np.clip(np.sum((point - corners) * along, axis=1) / length, 0, 1)
    return float(np.linalg.norm(point - corners - t[:, None] * along, axis=1).min())


class Hulls:
    """The faces of each hull, as the server numbers them."""

    def __init__(self, faces: dict[bytes, list[list[int]]]) -> None:
        self._faces = faces

    def corners(self, case: Case, side: int, kind: FeatureKind, index: np.ndarray) -> np.ndarray:
        """The corners of a feature, in the hull's own frame."""
        vertices = case.shapes[side].vertices
        if kind == FeatureKind.FACE:
            assert index[1] == NONE
            return vertices[self._faces[case.hulls[side].id][index[0]]]
        if kind == FeatureKind.EDGE:
            assert index[0] < index[1]
            return vertices[index]
        assert kind == FeatureKind.VERTEX
        assert index[1] == NONE
        return vertices[index[:1]]

    def face(self, hull: hullcast.Hull, index: int) -> list[int]:
        """A face's corners, as indices of the registered points."""
        return self._faces[hull.id][index]

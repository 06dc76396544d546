"""Tests the oracle against closed forms, since it must be right to judge the server."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import shapely
from oracle import ExactBody, ExactPair, dot, patch
from shapes import box, poly, prism, tetra

UPRIGHT = (0, 0, 0, 1)


def pair(a, b, d, rotation_b=UPRIGHT) -> ExactPair:
    """Two shapes about the origins of their frames, the second at d."""
    return ExactPair(
        ExactBody.make(a.vertices, (0, 0, 0), (0, 0, 0), UPRIGHT),
        ExactBody.make(b.vertices, (0, 0, 0), d, rotation_b),
    )


def test_aligned_boxes_have_their_closed_forms():
    """For aligned boxes, K is a box: alpha is the largest |d_i| / h_i, and the distance is a norm.

    A simplex method without a rule for ties (several largest ratios) would not end.
    """
    ties = 0
    for d in np.ndindex(5, 5, 5):
        offset = np.array(d) - 2
        a, b = box((1, 1, 3)), box((1, 1, 0.5))
        half = np.array([2, 2, 3.5])
        exact = pair(a, b, offset)
        assert exact.growth[0] == max(
            Fraction(abs(o)) / Fraction(h) for o, h in zip(offset, half, strict=True)
        )
        far = pair(a, b, 4 * offset)
        gap = np.maximum(np.abs(4 * offset) - half, 0)
        assert far.distance_squared == sum(Fraction(g) ** 2 for g in gap)
        ties += np.sum(np.abs(offset) / half == (np.abs(offset) / half).max()) > 1
    assert ties >= 30


def test_growth_is_optimal_and_homogeneous():
    """Primal and dual agree, no direction is better than n, and alpha(k d) = k alpha(d)."""
    rng = np.random.default_rng(1)
    for a, b in [(tetra(rng), prism(5, 0.5, 0.5)), (poly(16, rng), box((1, 0.5, 1e-6)))]:
        d = rng.normal(size=3)
        turned = rng.normal(size=4)
        exact = pair(a, b, d, turned)
        alpha, n = exact.growth
        assert exact.support(n) == 1
        assert dot(n, exact.d) == alpha
        for m in rng.normal(size=(50, 3)):
            assert dot([Fraction(c) for c in m], exact.d) <= alpha * exact.support(m)
        assert pair(a, b, 4 * d, turned).growth[0] == 4 * alpha


def test_distance_agrees_with_growth_and_separation():
    """The hulls overlap exactly if alpha <= 1, and s(n) is a lower bound of their distance."""
    rng = np.random.default_rng(2)
    apart = 0
    for _ in range(30):
        exact = pair(poly(16, rng), tetra(rng), rng.normal(size=3), rng.normal(size=4))
        distance = float(exact.distance_squared) ** 0.5
        assert (distance > 0) == (exact.growth[0] > 1)
        for n in rng.normal(size=(50, 3)):
            assert float(exact.separation(n / np.linalg.norm(n))) <= distance + 1e-12
        apart += distance > 0
    assert 5 <= apart <= 25


def test_patch_agrees_with_another_clipper():
    """The exact clipping agrees with shapely's, for faces in z = 0 and z = 1 seen along z."""
    rng = np.random.default_rng(3)
    met = 0
    for _ in range(50):
        flat = [
            np.array(
                shapely.convex_hull(shapely.MultiPoint(rng.normal(size=(6, 2)))).exterior.coords
            )[:-1]
            for _ in range(2)
        ]
        faces = [
            [tuple(Fraction(c) for c in (*p, float(z))) for p in polygon]
            for z, polygon in enumerate(flat)
        ]
        found = patch(*faces, (Fraction(0), Fraction(0), Fraction(2)))
        expected = shapely.intersection(*(shapely.Polygon(p) for p in flat))
        assert bool(found) == (not expected.is_empty)
        if found:
            corners = [(float(x), float(y)) for x, y, z in found]
            assert all(z == 0 for *_, z in found)
            assert shapely.hausdorff_distance(shapely.Polygon(corners), expected) < 1e-12
            met += 1
    assert met >= 20

"""The golden cases through the server. `tests/golden.rs` reads the same file."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from checks import distance_to_polygon
from oracle import ExactBody, ExactPair, dot

import hullcast
from hullcast import Flag, Outcome

FILE = Path(__file__).resolve().parents[2] / "tests/golden/contacts.json"
CASES = json.loads(FILE.read_text())["cases"]


@pytest.mark.parametrize("solver", ["PORTAL", "GJK_RAY_CAST"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_answers_are_the_exact_ones(client: hullcast.Client, case: dict, solver: str):
    """The outcome, the bracket, the normal's optimality, the separation and the patch are right."""
    sides = [case["a"], case["b"]]
    hulls = client.register(
        [side["vertices"] for side in sides],
        contraction_points=[side["contraction_point"] for side in sides],
    )
    scene = hullcast.Scene(
        hulls, [side["position"] for side in sides], [side["rotation"] for side in sides]
    )
    margin = np.inf if case["margin"] is None else case["margin"]
    accuracy = hullcast.Accuracy(solver=solver)
    (pair,) = client.query(scene, [[0, 1]], margin=margin, accuracy=accuracy)
    assert pair.outcome.name == case["outcome"]
    assert pair.alpha_lower <= case["alpha_below"]
    assert pair.alpha_upper >= case["alpha_above"]
    if pair.outcome == Outcome.SEPARATED:
        return
    exact = ExactPair(*(ExactBody.make(*side.values()) for side in sides))
    n, budget = pair.normal, case["alpha_budget"]
    assert abs(pair.alpha - case["alpha_below"]) <= budget * 1.01  # the file's numbers are rounded
    reached = dot([Fraction(c) for c in n], exact.d) / exact.support(n)
    assert case["alpha_below"] - float(reached) <= budget * 1.01
    assert abs(pair.separation - float(exact.separation(n))) <= case["length_budget"]
    assert len(pair.distance) >= 1
    if case["patch"] is not None:
        assert not pair.flags & Flag.ESTIMATED
        found, corners = pair.witness_a, np.array(case["patch"])
        far = [distance_to_polygon(p, corners) for p in found]
        far += [distance_to_polygon(p, found) for p in corners]
        assert max(far) <= case["patch_budget"]


def test_the_file_is_what_the_script_writes():
    """The answers in the file are the oracle's, so the file was not edited by hand."""
    for case in CASES:
        exact = ExactPair(*(ExactBody.make(*case[side].values()) for side in "ab"))
        alpha = exact.growth[0]
        assert Fraction(case["alpha_below"]) <= alpha <= Fraction(case["alpha_above"])
        assert case["alpha_above"] <= np.nextafter(case["alpha_below"], np.inf)
        assert float(exact.distance_squared) ** 0.5 == pytest.approx(case["distance"], rel=1e-14)
    assert len(CASES) >= 39

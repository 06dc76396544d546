"""Values of pairs as functions of poses: their gradients, without torch or jax."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest
from crowds import FOUR_PAIRS as PAIRS
from crowds import four_polyhedra

from hullcast import Flag
from hullcast._gradients import PairFunction


@pytest.fixture
def scene(client):
    return four_polyhedra(client)


@pytest.mark.parametrize("name", ["alpha", "separation", "normal"])
def test_the_chain_from_motions_to_poses(client, scene, name):
    """Catches a sign, a body or a component of a quaternion that is taken for another.

    Central differences of a random weighted sum, by every number of the poses.
    """
    function = PairFunction(name, client, scene, PAIRS)
    poses = [scene.positions, scene.rotations]
    values, derivatives = function.with_derivatives(*poses)
    asked = client.query(scene, PAIRS, margin=np.inf, outputs=["ALPHA_GRADIENT"])
    assert not (asked.flags & int(Flag.KINK)).any()
    assert np.array_equal(function.values(*poses), values)
    weights = np.random.default_rng(8).normal(size=values.shape)
    gradients = function.pulled_back(derivatives, scene.rotations, weights)
    step, compared = 1e-6, 0
    for which, gradient in enumerate(gradients):
        for place in np.ndindex(gradient.shape):
            sums = []
            for sign in (1, -1):
                moved = [pose.copy() for pose in poses]
                moved[which][place] += sign * step
                sums.append((function.values(*moved) * weights).sum())
            slope = (sums[0] - sums[1]) / (2 * step)
            assert gradient[place] == pytest.approx(slope, abs=2e-8), (which, place)
            compared += abs(slope) > 1e-3
    # The normal does not depend on positions.
    assert compared >= (12 if name == "normal" else 22)


def test_a_weight_of_zero_adds_nothing(client, scene):
    """Catches NaN of a pair without a gradient that spreads to the bodies of others."""
    function = PairFunction("alpha", client, scene, PAIRS)
    _, derivatives = function.with_derivatives(scene.positions, scene.rotations)
    expected = function.pulled_back(derivatives, scene.rotations, [1, 0, 1, 1, 1])
    derivatives = derivatives.copy()
    derivatives[1] = np.nan
    found = function.pulled_back(derivatives, scene.rotations, [1, 0, 1, 1, 1])
    for one, other in zip(found, expected, strict=True):
        assert np.array_equal(one, other)
    assert np.isnan(function.pulled_back(derivatives, scene.rotations, np.ones(5))[0]).any()


@pytest.mark.parametrize("library", ["torch", "jax"])
def test_a_missing_library_is_named(library, monkeypatch):
    """Catches an error about a module of another package, with no way to get it."""
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delitem(sys.modules, f"hullcast.{library}", raising=False)
    advice = (
        rf"hullcast.{library} needs {library}: pip install './client\[{library}\]' in the clone"
    )
    with pytest.raises(ImportError, match=advice):
        importlib.import_module(f"hullcast.{library}")

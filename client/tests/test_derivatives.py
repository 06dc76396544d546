"""Derivatives as a Python program gets them. crates/contact/tests/stability compares them with exact ones."""

from __future__ import annotations

import numpy as np
import pytest
from crowds import CUBE, crowd

import hullcast
from hullcast import Flag, Outcome

DERIVATIVES = ("ALPHA_GRADIENT", "SEPARATION_GRADIENT", "NORMAL_JACOBIAN")
COLUMNS = ("alpha_gradient", "separation_gradient", "normal_jacobian")


def test_contacts_of_a_body_are_turned_with_their_derivatives(client):
    """Catches an exchange of A and B that leaves a sign or a place of a gradient as it was."""
    scene = crowd(client, 60)
    pairs = [[i, j] for i in range(60) for j in range(i)]
    outputs = ("NORMAL", "POINTS", *DERIVATIVES)
    m = client.query(scene, pairs, margin=0.05, outputs=outputs)
    compared = 0
    for body in range(60):
        turned = m.contacts_of(body)
        asked = client.query(scene, turned.pairs, margin=0.05, outputs=outputs)
        same = ((turned.flags | asked.flags) & int(Flag.KINK)) == 0
        for name in COLUMNS:
            ours, theirs = getattr(turned, name)[same], getattr(asked, name)[same]
            assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-9), name
        compared += np.count_nonzero(same)
    assert compared > 200


def test_derivatives_only_come_if_asked_for(client):
    """Catches a kink that is flagged for a query without derivatives, and numbers where there are none."""
    (hull,) = client.register([CUBE])
    places = [[0, 0, 0], [0.2, 0.1, 0.95], [0, 0, 9], [np.nan, 0, 0]]
    scene = hullcast.Scene([hull], places, [[0, 0, 0, 1]] * 4, body_hulls=[0] * 4)
    pairs = [[0, 1], [0, 2], [0, 3]]
    m = client.query(scene, pairs, on_invalid="flag")
    assert (m.flags & int(Flag.KINK) == 0).all()
    m = client.query(scene, pairs, on_invalid="flag", outputs=["NORMAL", *DERIVATIVES])
    assert m.outcome.tolist() == [Outcome.CONTACT, Outcome.SEPARATED, Outcome.INVALID]
    assert (m.flags & int(Flag.KINK) != 0).tolist() == [True, False, False]
    for name in COLUMNS:
        column = getattr(m, name).reshape(3, -1)
        assert np.isfinite(column[0]).all(), name
        assert np.isnan(column[1:]).all(), name
    assert 0 < m.gradient_error[0] < 1e-12
    assert np.isnan(m.gradient_error[1:]).all()
    assert m.separation_gradient[0, :3].tolist() == m.normal[0].tolist() == [0, 0, 1]

"""Outcomes, flags and features compare equal to names and print names."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from crowds import CUBE

import hullcast
from hullcast import FeatureKind, Flag, Outcome


@pytest.fixture
def m(client):
    """Three pairs: a contact of faces, a separated pair, and a pair that is not answered."""
    scene = hullcast.Scene(
        client.register(CUBE), [[0, 0, 0], [0, 0, 0.99], [0, 0, 5], [np.nan, 0, 0]],
        [[0, 0, 0, 1]] * 4, body_hulls=[0] * 4,
    )  # fmt: skip
    outputs = ["POINTS", "FEATURES"]
    return client.query(scene, [[0, 1], [0, 2], [0, 3]], outputs=outputs, on_invalid="flag")


def test_columns_compare_with_names(m):
    """Catches a comparison with a name that is silently false everywhere."""
    assert (m.outcome == "CONTACT").tolist() == [True, False, False]
    assert ("contact" == m.outcome).tolist() == [True, False, False]  # noqa: SIM300
    assert (m.outcome != "CONTACT").tolist() == [False, True, True]
    assert (m.outcome == ["CONTACT", "CONTACT", "INVALID"]).tolist() == [True, False, True]
    assert (m.outcome == Outcome.SEPARATED).tolist() == [False, True, False]
    assert (m.outcome == 4).tolist() == [False, False, True]
    assert m.in_contact.tolist() == [True, False, False]
    assert (m.feature_kinds == "FACE").tolist() == [[True, True], [False, False], [False, False]]
    assert (m.flags == "INVALID_BODY").tolist() == [False, False, True]
    assert ((m.flags & "INVALID_BODY") != 0).tolist() == [False, False, True]
    assert m[m.outcome == "CONTACT"].pairs.tolist() == [[0, 1]]


def test_single_values_compare_with_names(m):
    """Catches an entry that compares differently from its column."""
    assert m.outcome[0] == "CONTACT"
    assert m.outcome[1] != "CONTACT"
    assert [outcome == "separated" for outcome in m.outcome] == [False, True, False]
    assert m[0].outcome == "CONTACT" == Outcome.CONTACT == 1
    # Printed alone or within a text it is its name; it printed its number.
    assert str(m[0].outcome) == f"{m[0].outcome}" == "CONTACT"
    assert f"{m[0].outcome:d}" == "1"
    assert m[0].feature_kinds == ("FACE", "FACE")
    assert m.outcome[0] is Outcome.CONTACT
    assert m.feature_kinds[0, 1] is FeatureKind.FACE
    assert m.flags[2] is Flag.INVALID_BODY
    assert {Outcome.CONTACT: 5}[1] == 5


@pytest.mark.parametrize("name", ["TOUCHING", "", "CONTACT "])
def test_a_name_that_is_none_is_refused(m, name):
    """Catches a misspelt name that is silently false everywhere."""
    with pytest.raises(hullcast.InvalidArgument, match="expected one of CONTACT, SEPARATED"):
        _ = m.outcome == name
    with pytest.raises(hullcast.InvalidArgument, match="expected one of ESTIMATED"):
        _ = m.flags & name


def test_names_are_printed(m):
    """Catches numbers without meaning in printed results, and values that do not print at all."""
    assert str(m.outcome) == "[CONTACT SEPARATED INVALID]"
    assert repr(m.outcome) == "OutcomeArray([CONTACT, SEPARATED, INVALID])"
    assert str(m.flags) == "[- - INVALID_BODY]"
    assert str(m.feature_kinds[0]) == "[FACE FACE]"
    assert str(m.outcome + 10) == "[11 12 14]"
    assert "1 CONTACT, 1 SEPARATED, 1 INVALID" in repr(m)


def test_they_are_arrays(m):
    """Catches a column that numpy cannot use, or that changes when it is pickled."""
    assert m.outcome.dtype == np.uint8
    assert m.outcome.tolist() == [1, 2, 4]
    assert np.count_nonzero(m.outcome == Outcome.CONTACT) == 1
    assert np.isin(m.outcome, [1, 4]).tolist() == [True, False, True]
    assert np.concatenate([m.outcome, m.outcome]).tolist() == [1, 2, 4, 1, 2, 4]
    assert type(m.outcome == 1) is np.ndarray
    copy = pickle.loads(pickle.dumps(m.outcome))
    assert (copy == "CONTACT").tolist() == [True, False, False]
    assert m.outcome.max() == 4
    assert np.bincount(m.outcome).tolist() == [0, 1, 1, 0, 1]

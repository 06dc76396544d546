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


def test_names_in_other_forms(m):
    """Catches names in bytes, in an array of objects or of strings, that equal nothing."""
    for name in (b"CONTACT", b"contact", np.str_("CONTACT"), np.bytes_(b"CONTACT")):
        assert (m.outcome == name).tolist() == [True, False, False]
        assert m.outcome[0] == name
    for dtype in (object, "U", "S", getattr(np.dtypes, "StringDType", lambda: "U")()):
        names = np.array(["CONTACT", "INVALID", "INVALID"], dtype=dtype)
        assert (m.outcome == names).tolist() == [True, False, True]
        assert (names == m.outcome).tolist() == [True, False, True]
    mixed = np.array(["CONTACT", None, 4], dtype=object)
    assert (m.outcome == mixed).tolist() == [True, False, True]
    assert "CONTACT" in m.outcome
    assert "UNDECIDED" not in m.outcome


def test_functions_of_numpy_take_names(m):
    """Catches `np.isin(m.outcome, ["CONTACT"])`, which was silently false everywhere."""
    for names in (["CONTACT"], "contact", [b"CONTACT"], {"CONTACT"}, iter(["CONTACT"])):
        assert np.isin(m.outcome, names).tolist() == [True, False, False]
    assert np.isin(m.outcome, test_elements=["CONTACT"], invert=True).tolist() == [0, 1, 1]
    assert np.isin(["CONTACT", "UNDECIDED"], m.outcome, kind="sort").tolist() == [True, False]
    assert np.isin(m.feature_kinds, ["FACE"]).tolist() == [[True, True], [False] * 2, [False] * 2]
    assert np.isin(m.flags, ["INVALID_BODY"]).tolist() == [False, False, True]
    assert np.setdiff1d(m.outcome, ["CONTACT"]).tolist() == [2, 4]
    assert np.intersect1d(["CONTACT"], m.outcome).tolist() == [1]
    assert np.union1d(m.outcome, {"UNDECIDED"}).tolist() == [1, 2, 3, 4]
    assert np.array_equal(m.outcome, ["CONTACT", "SEPARATED", "INVALID"])
    assert not np.array_equal(m.outcome, ["CONTACT", "SEPARATED", "CONTACT"])
    assert np.where([True, False, True], m.outcome, "UNDECIDED").tolist() == [1, 3, 4]
    for call in (np.isin, np.setdiff1d, np.array_equal):
        with pytest.raises(hullcast.InvalidArgument, match="expected one of CONTACT"):
            call(m.outcome, ["TOUCHING"] * 3)


def test_a_column_is_not_compared_with_a_set(m):
    """Catches `m.outcome == {"CONTACT"}`, which was silently false everywhere."""
    for compared in ({"CONTACT"}, frozenset({"CONTACT", "INVALID"})):
        with pytest.raises(hullcast.InvalidArgument, match=r"np\.isin"):
            _ = m.outcome == compared


def test_columns_convert_to_names(m):
    """Catches `astype(str)`, which gave digits, and lists of numbers that equal no name."""
    assert m.outcome.astype(str).tolist() == ["CONTACT", "SEPARATED", "INVALID"]
    assert m.outcome.astype("S").tolist() == [b"CONTACT", b"SEPARATED", b"INVALID"]
    assert m.flags.astype(str).tolist() == ["-", "-", "INVALID_BODY"]
    assert m.feature_kinds.astype(str)[0].tolist() == ["FACE", "FACE"]
    assert m.outcome.astype(int).tolist() == [1, 2, 4]
    for column in (m.outcome.tolist(), list(m.outcome), m.outcome.astype(object).tolist()):
        assert [str(outcome) for outcome in column] == ["CONTACT", "SEPARATED", "INVALID"]
        assert column.count("CONTACT") == 1
    assert m.outcome.item(0) == m.outcome[:1].item() == "CONTACT"
    assert m.feature_kinds.tolist()[0] == ["FACE", "FACE"]
    assert m.outcome[:0].astype(str).shape == (0,)


def test_members_are_found_by_number_in_sets():
    """Catches another rule for `outcome in {"CONTACT"}` than the documentation states."""
    assert Outcome.CONTACT not in {"CONTACT"}
    assert Outcome.CONTACT.name in {"CONTACT"}
    assert Outcome.CONTACT in {Outcome.CONTACT}
    assert Outcome.CONTACT in {1}
    assert Outcome.CONTACT in ["CONTACT"]
    assert "CONTACT" in (Outcome.SEPARATED, Outcome.CONTACT)


def test_single_flags_compare_with_names():
    """Catches a flag that equals no name, and is printed as a number."""
    assert Flag.REDUCED == "REDUCED" == Flag.REDUCED
    assert Flag.REDUCED != "ESTIMATED"
    assert str(Flag.REDUCED | Flag.ESTIMATED) == f"{Flag(9)}" == "ESTIMATED|REDUCED"
    assert (str(Flag(0)), str(Flag(128 + 1)), f"{Flag(9):d}") == ("-", "ESTIMATED|KINK", "9")
    assert {Flag.REDUCED: 5}[8] == 5
    assert Flag(9) & Flag.REDUCED == Flag.REDUCED == 8


@pytest.mark.parametrize("name", ["TOUCHING", "", "CONTACT ", b"\xff"])
def test_a_single_value_refuses_a_name_that_is_none(name):
    """Catches a misspelt name that a single value is silently not equal to."""
    for value in (Outcome.CONTACT, Flag.REDUCED, FeatureKind.FACE):
        with pytest.raises(hullcast.InvalidArgument, match="expected one of"):
            _ = value == name
        with pytest.raises(hullcast.InvalidArgument, match="expected one of"):
            _ = value != name


def test_frames_have_names(m):
    """Catches a kind of feature that is a number in a data frame, and equals no name there."""
    pytest.importorskip("pandas")
    frame = m.to_dataframe("pairs")
    assert (frame.outcome == "CONTACT").tolist() == [True, False, False]
    assert frame.outcome.isin(["CONTACT", "INVALID"]).tolist() == [True, False, True]
    assert (frame.feature_kind_a == "FACE").tolist() == [True, False, False]
    assert (frame["flags"] & int(Flag.INVALID_BODY) != 0).tolist() == [False, False, True]


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

"""Reading responses, in which a column may have any form that protobuf allows."""

from __future__ import annotations

import numpy as np
import pytest

import hullcast
from hullcast import _answers, _packed
from hullcast._pb import contacts_pb2

PAIRS = np.array([[0, 1], [1, 2]], dtype="<u4")
OUTPUTS = ("ALPHA", "NORMAL", "POINTS", "FEATURES", "BASES")
DOUBLES = {"alphas", "alpha_lowers", "alpha_uppers", "separations", "normals", "distances"}


def answer() -> contacts_pb2.QueryContactsResponse:
    """Two pairs with one and two points, in which all numbers are different."""
    numbers = iter(range(1, 1000))

    def some(count: int) -> list[int]:
        return [next(numbers) for _ in range(count)]

    return contacts_pb2.QueryContactsResponse(
        outcomes=b"\1\1",
        flags=b"\0\1",
        alphas=some(2),
        alpha_lowers=some(2),
        alpha_uppers=some(2),
        separations=some(2),
        normals=some(6),
        point_counts=[1, 2],
        witness_as=some(9),
        distances=some(3),
        feature_kinds=b"\3\2\1\1",
        feature_indices=some(8),
        point_ids=some(12),
        bases=some(12),
        missing_hulls=[3, 4],
        invalid_bodies=[7],
    )


def varint(value: int) -> bytes:
    """A number as a protobuf varint."""
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def column_field(name: str):
    """A column's field number and its numpy type."""
    return (
        contacts_pb2.QueryContactsResponse.DESCRIPTOR.fields_by_name[name].number,
        _packed.COLUMN_TYPES[name],
    )


def packed(name: str, values) -> bytes:
    """One packed record of a column, encoded by hand."""
    number, kind = column_field(name)
    data = np.asarray(values, dtype=kind).tobytes()
    return varint(number << 3 | 2) + varint(len(data)) + data


def unpacked(name: str, values) -> bytes:
    """A column with one record per element, encoded by hand."""
    number, kind = column_field(name)
    wire_type = 1 if kind == "<f8" else 5
    return b"".join(
        varint(number << 3 | wire_type) + np.asarray(v, dtype=kind).tobytes() for v in values
    )


def expect_equal(found: _answers.Columns, message: contacts_pb2.QueryContactsResponse) -> None:
    """Asserts that every column has the message's numbers."""
    checked = 0
    for name, values in found.items():
        if name in _packed.COLUMN_TYPES and name != "pairs":
            assert values.dtype == np.dtype(_packed.COLUMN_TYPES[name])
            assert values.reshape(-1).tolist() == list(getattr(message, name)), name
            checked += 1
    assert checked == 11
    assert found["missing_hulls"].tolist() == [3, 4]
    assert found["invalid_bodies"].tolist() == [7]
    assert found["feature_kinds"].tolist() == [[3, 2], [1, 1]]


def test_columns_are_read_as_bytes():
    """The fast path gives the right numbers, and arrays that are writable."""
    message = answer()
    found = _answers.read(message.SerializeToString(), OUTPUTS, PAIRS)
    expect_equal(found, message)
    assert all(column.flags.writeable for column in found.values())


@pytest.mark.parametrize(
    "name", ["alphas", "normals", "point_counts", "witness_as", "point_ids", "bases"]
)
@pytest.mark.parametrize("form", ["split", "unpacked", "mixed"])
def test_a_sender_may_split_a_column(name: str, form: str):
    """A column may be several records, one per element, or both.

    Catches that only the last is read.
    """
    message = answer()
    values = list(getattr(message, name))
    rest = answer()
    rest.ClearField(name)
    by_hand = {
        "split": packed(name, values[:1]) + packed(name, values[1:]),
        "unpacked": unpacked(name, values),
        "mixed": unpacked(name, values[:1]) + packed(name, values[1:]),
    }[form]
    data = rest.SerializeToString() + by_hand
    assert list(getattr(contacts_pb2.QueryContactsResponse.FromString(data), name)) == values
    expect_equal(_answers.read(data, OUTPUTS, PAIRS), message)


def test_a_record_between_others_is_found():
    """Reads a column in three records, of which one is empty and one follows other fields."""
    message = answer()
    rest = answer()
    rest.ClearField("distances")
    distances = list(message.distances)
    data = packed("distances", []) + packed("distances", distances[:2])
    data += rest.SerializeToString() + packed("distances", distances[2:])
    expect_equal(_answers.read(data, OUTPUTS, PAIRS), message)


@pytest.mark.parametrize("name", ["outcomes", "flags", "alphas", "point_ids", "feature_kinds"])
def test_a_column_of_wrong_length_is_refused(name: str):
    """Catches a short column whose numbers would be assigned to the wrong pairs."""
    message = answer()
    setattr(message, name, b"") if name in ("outcomes", "flags", "feature_kinds") else getattr(
        message, name
    ).pop()
    with pytest.raises(hullcast.ServerError, match=name) as caught:
        _answers.read(message.SerializeToString(), OUTPUTS, PAIRS)
    assert caught.value.reason == "MALFORMED_ANSWER"


def test_fields_of_a_newer_server_are_ignored():
    """Unknown fields are ignored."""
    message = answer()
    data = message.SerializeToString() + varint(999 << 3 | 2) + b"\3abc"
    expect_equal(_answers.read(data, OUTPUTS, PAIRS), message)


def test_found_pairs_come_with_the_answer():
    """For `find`, the number of pairs is taken from the response."""
    message = answer()
    message.pairs.extend([0, 1, 1, 2])
    found = _answers.read(message.SerializeToString(), OUTPUTS, None)
    assert found["pairs"].tolist() == [[0, 1], [1, 2]]


def test_parts_merge_in_order():
    """Columns are joined in the order of the parts.

    Each hull and body is listed once, ascending.
    """
    one, two = answer(), answer()
    two.alphas[0] = 50.0
    two.missing_hulls[0] = 1
    parts = [_answers.read(m.SerializeToString(), OUTPUTS, PAIRS) for m in (one, two)]
    merged = _answers.merge(parts)
    assert merged["alphas"].tolist() == [*one.alphas, *two.alphas]
    assert merged["witness_as"].shape == (6, 3)
    assert merged["missing_hulls"].tolist() == [1, 3, 4]
    assert merged["invalid_bodies"].tolist() == [7]


def test_manifolds_give_columns_and_records():
    """`m[i]` has only the entries of pair i, and witness points on B are computed."""
    message = answer()
    m = hullcast.Manifolds(_answers.read(message.SerializeToString(), OUTPUTS, PAIRS))
    assert len(m) == 2
    assert m.point_offsets.tolist() == [0, 1, 3]
    assert m.normal.shape == (2, 3)
    expected = m.witness_a + m.distance[:, None] * m.normal[[0, 1, 1]]
    assert (m.witness_b == expected).all()
    second = m[-1]
    assert second.index == 1
    assert second.bodies == (1, 2)
    assert second.flags == hullcast.Flag.ESTIMATED
    assert second.alpha == m.alpha[1]
    assert (second.witness_a == m.witness_a[1:]).all()
    assert (second.witness_b == m.witness_b[1:]).all()
    assert second.feature_kinds == (hullcast.FeatureKind.VERTEX, hullcast.FeatureKind.VERTEX)
    assert [pair.index for pair in m] == [0, 1]
    assert "CONTACT" in repr(m)
    assert "CONTACT" in repr(second)
    with pytest.raises(IndexError):
        m[2]


@pytest.mark.parametrize(
    ("column", "output"),
    [
        ("alpha", "ALPHA"),
        ("alpha_lower", "ALPHA"),
        ("normal", "NORMAL"),
        ("separation", "NORMAL"),
        ("point_offsets", "POINTS"),
        ("witness_a", "POINTS"),
        ("witness_b", "POINTS"),
        ("distance", "POINTS"),
        ("point_ids", "FEATURES"),
        ("feature_kinds", "FEATURES"),
        ("bases", "BASES"),
        ("iterations", "DIAGNOSTICS"),
        ("alpha_gradient", "ALPHA_GRADIENT"),
        ("separation_gradient", "SEPARATION_GRADIENT"),
        ("normal_jacobian", "NORMAL_JACOBIAN"),
    ],
)
def test_a_column_not_asked_for_names_its_output(column: str, output: str):
    """The error names the output, for a batch and for one pair; `hasattr` works as well."""
    m = hullcast.Manifolds(_answers.read(answer().SerializeToString(), ("OUTCOME",), PAIRS))
    with pytest.raises(hullcast.OutputNotAsked, match=output) as caught:
        getattr(m, column)
    assert caught.value.output == output
    assert caught.value.field == column
    assert not hasattr(m, column)
    assert "CONTACT" in repr(m[0])


def test_a_server_of_the_first_contract_is_read():
    """Catches that a response is refused because an older server lacks a newer column."""
    older = answer()
    older.iterations.extend([3, 4])
    older.support_calls.extend([5, 6])
    columns = _answers.read(older.SerializeToString(), ("DIAGNOSTICS",), PAIRS)
    assert columns["iterations"].tolist() == [3, 4]
    assert np.isnan(columns["kept_areas"]).tolist() == [True, True]
    assert np.isnan(
        _answers.read(answer().SerializeToString(), ("ALPHA_GRADIENT",), PAIRS)["alpha_gradients"]
    ).all()
    older.kept_areas.extend([0.5])
    with pytest.raises(hullcast.ServerError, match="kept_areas has 1 entries, expected 2"):
        _answers.read(older.SerializeToString(), ("DIAGNOSTICS",), PAIRS)

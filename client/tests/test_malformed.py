"""Malformed responses from a mock server raise MALFORMED_ANSWER in every kind of call."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from crowds import CUBE, EVERYTHING, NO_PROXY
from hostile import Mock, mock_server

import hullcast
from hullcast._pb import contacts_pb2, hulls_pb2, server_pb2

NAN, INF = float("nan"), float("inf")
IDS = [bytes([i]) * 32 for i in range(2)]
PAIRS = [[0, 2], [0, 1]]
POSITIONS, TURNS = np.zeros((3, 3)), [[0, 0, 0, 1]] * 3
Contacts = contacts_pb2.QueryContactsResponse


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[Mock, hullcast.Client]]:
    with mock_server() as (mock, target), hullcast.connect(target, options=NO_PROXY) as client:
        yield mock, client


def scene() -> hullcast.Scene:
    return hullcast.Scene(IDS, POSITIONS, TURNS, body_hulls=[0, 1, 0])


def answer(find: bool = False) -> Contacts:
    """A contact with one point; for `query` also a pair with a missing hull and a bad body."""
    n = 1 if find else 2
    good = Contacts(
        outcomes=b"\1\4"[:n],
        flags=bytes([0, 16 | 64])[:n],
        alphas=[0.5, NAN][:n],
        alpha_lowers=[0.5, NAN][:n],
        alpha_uppers=[0.6, NAN][:n],
        separations=[-1, NAN][:n],
        normals=[0, 0, 1, NAN, NAN, NAN][: 3 * n],
        point_counts=[1, 0][:n],
        witness_as=[1, 2, 3],
        distances=[-1],
        witness_bs=[1, 2, 2],
        feature_kinds=b"\3\1\0\0"[: 2 * n],
        feature_indices=[0] * 4 * n,
        point_ids=[0] * 4,
        bases=[0] * 6 * n,
        missing_hulls=[1],
        invalid_bodies=[1],
        iterations=[1] * n,
        support_calls=[1] * n,
        kept_areas=[1] * n,
        alpha_gradients=[1] * 9 * n,
        separation_gradients=[1] * 9 * n,
        normal_jacobians=[1] * 27 * n,
        gradient_errors=[1e-12, NAN][:n],
    )
    if find:
        good.pairs.extend([0, 2])
    return good


def put(name: str, index: int, value: Any) -> Callable[[Any], None]:
    """Returns a function that changes one entry of a column."""

    def spoil(message: Any) -> None:
        column = getattr(message, name)
        if isinstance(column, bytes):
            changed = bytearray(column)
            changed[index] = value
            setattr(message, name, bytes(changed))
        else:
            column[index] = value

    return spoil


def cut(name: str) -> Callable[[Any], None]:
    """Returns a function that removes the last entry of a column."""

    def spoil(message: Any) -> None:
        kept = list(getattr(message, name))[:-1]
        message.ClearField(name)
        if isinstance(getattr(message, name), bytes):
            setattr(message, name, bytes(kept))
        else:
            getattr(message, name).extend(kept)

    return spoil


def more(name: str, *values: Any) -> Callable[[Any], None]:
    """Returns a function that adds entries to a column."""

    def spoil(message: Any) -> None:
        if isinstance(getattr(message, name), bytes):
            setattr(message, name, getattr(message, name) + bytes(values))
        else:
            getattr(message, name).extend(values)

    return spoil


def another_request(message: Any) -> None:
    message.request_id += 1


LENGTHS = [
    "outcomes", "flags", "alphas", "alpha_lowers", "alpha_uppers", "separations", "normals",
    "point_counts", "witness_as", "distances", "witness_bs", "feature_kinds", "feature_indices",
    "point_ids", "bases", "iterations", "support_calls", "kept_areas", "alpha_gradients",
    "separation_gradients", "normal_jacobians", "gradient_errors",
]  # fmt: skip

#: For each defect, a part of the error's text and a function that makes the defect.
DEFECTS: list[tuple[str, Callable[[Any], None]]] = [
    ("request_id", another_request),
    # For one pair, cutting these leaves them empty, which an older server may send.
    *[(name, cut(name)) for name in LENGTHS if name not in ("kept_areas", "gradient_errors")],
    *[(name, more(name, *([0] * 7))) for name in LENGTHS],
    ("witness_as", put("point_counts", 0, 2**32 - 1)),
    ("outcomes[0] is 0", put("outcomes", 0, 0)),
    ("outcomes[0] is 5", put("outcomes", 0, 5)),
    ("flags[0]", put("flags", 0, 64)),
    ("flags[0]", put("flags", 0, 16)),
    ("alphas[0]", put("alphas", 0, NAN)),
    ("alphas[0]", put("alphas", 0, 0.7)),
    ("alphas[0]", put("alpha_lowers", 0, 0.55)),
    ("alphas[0]", put("alpha_lowers", 0, -1.0)),
    ("alphas[0]", put("alpha_uppers", 0, NAN)),
    ("separations[0]", put("separations", 0, NAN)),
    ("separations[0]", put("separations", 0, INF)),
    ("normals[0]", put("normals", 1, NAN)),
    ("normals[0]", put("normals", 2, 0.9)),
    ("normals[0]", put("normals", 2, 1e200)),
    ("witness_as[0]", put("witness_as", 0, NAN)),
    ("distances[0]", put("distances", 0, -INF)),
    ("witness_bs[2]", put("witness_bs", 2, NAN)),
    ("feature_kinds[0]", put("feature_kinds", 0, 4)),
    ("kept_areas[0]", put("kept_areas", 0, 1.1)),
    ("gradient_errors[0]", put("gradient_errors", 0, -1e-12)),
    ("missing_hulls", put("missing_hulls", 0, 2)),
    ("missing_hulls", put("missing_hulls", 0, 2**32 - 1)),
    ("missing_hulls", more("missing_hulls", 0)),
    ("missing_hulls", more("missing_hulls", 1)),
    ("invalid_bodies", put("invalid_bodies", 0, 3)),
    ("invalid_bodies", more("invalid_bodies", 1)),
]
OF_QUERY: list[tuple[str, Callable[[Any], None]]] = [
    ("kept_areas", cut("kept_areas")),
    ("gradient_errors", cut("gradient_errors")),
    ("flags[0]", put("outcomes", 0, 4)),
    ("flags[1]", put("flags", 1, 0)),
    ("flags[1]", put("flags", 1, 16)),
    ("flags[1]", put("outcomes", 1, 1)),
    ("flags[1]", cut("invalid_bodies")),
    ("flags[1]", cut("missing_hulls")),
    ("flags[0]", put("invalid_bodies", 0, 0)),
    ("point_counts[0]", put("outcomes", 0, 2)),
]
OF_FIND: list[tuple[str, Callable[[Any], None]]] = [
    ("body 3", put("pairs", 1, 3)),
    ("first body", put("pairs", 0, 2)),
    ("pairs", more("pairs", 0, 2)),
    ("outcomes[0]", lambda m: (put("outcomes", 0, 2)(m), cut("point_counts")(m), m.point_counts.append(0), m.ClearField("witness_as"), m.ClearField("distances"), m.ClearField("witness_bs"), m.ClearField("point_ids"))),
    ("pairs has 1", cut("pairs")),
]  # fmt: skip


def spoiled(request: bytes, spoil: Callable[[Any], None], *, find: bool = False) -> bytes:
    message = answer(find)
    message.request_id = contacts_pb2.QueryContactsRequest.FromString(request).request_id
    spoil(message)
    return message.SerializeToString()


def expect_malformed(call: Callable[[], Any], text: str) -> None:
    with pytest.raises(hullcast.ServerError) as caught:
        call()
    assert caught.value.reason == "MALFORMED_ANSWER"
    assert text in str(caught.value)


def good(message: Any) -> None:
    """Makes no defect."""


def test_the_mock_can_answer_well(served):
    """Catches a table in which every case fails for another reason."""
    mock, client = served
    mock.answers = {
        "QueryContacts": lambda r: [spoiled(r, good)],
        "FindContacts": lambda r: [spoiled(r, good, find=True)],
    }
    with pytest.warns(hullcast.MissingHullsWarning):
        m = client.query(scene(), PAIRS, outputs=EVERYTHING, on_invalid="flag")
    assert m.in_contact.tolist() == [True, False]
    with pytest.warns(hullcast.MissingHullsWarning):
        m = client.find(scene(), outputs=EVERYTHING, on_invalid="flag")
    assert m.pairs.tolist() == [[0, 2]]


@pytest.mark.parametrize("number", range(len(DEFECTS + OF_QUERY)))
def test_a_query_refuses_every_defect(served, number):
    """Catches a defect that becomes numbers, an IndexError or a DecodeError."""
    mock, client = served
    text, spoil = (DEFECTS + OF_QUERY)[number]
    mock.answers = {"QueryContacts": lambda r: [spoiled(r, spoil)]}
    expect_malformed(lambda: client.query(scene(), PAIRS, outputs=EVERYTHING), text)


@pytest.mark.parametrize("number", range(len(DEFECTS + OF_FIND)))
def test_find_refuses_every_defect(served, number):
    """The columns are checked as in `query`. The pairs, which come from the server, are too."""
    mock, client = served
    text, spoil = (DEFECTS + OF_FIND)[number]
    mock.answers = {"FindContacts": lambda r: [spoiled(r, spoil, find=True)]}
    # A column of the wrong length may be noticed through the length of another column.
    text = "malformed" if text in LENGTHS else text
    expect_malformed(lambda: client.find(scene(), outputs=EVERYTHING), text)


def test_find_refuses_messages_that_do_not_follow(served):
    """Catches an empty stream that is mistaken for no pairs, and a message that is repeated."""
    mock, client = served
    mock.answers = {"FindContacts": lambda r: []}
    expect_malformed(lambda: client.find(scene()), "without a message")
    mock.answers = {"FindContacts": lambda r: [spoiled(r, good, find=True)] * 2}
    expect_malformed(lambda: client.find(scene(), outputs=EVERYTHING), "has a pair twice")


def test_a_stream_with_an_extra_answer_is_not_read_on(served):
    """Catches a session that from then on gives the responses of earlier steps."""
    mock, client = served
    mock.answers = {"StreamContacts": lambda r: [spoiled(r, good)] * 2}
    with client.session(scene(), PAIRS, outputs=EVERYTHING, on_invalid="flag") as session:
        with pytest.warns(hullcast.MissingHullsWarning):
            session.step(POSITIONS, TURNS)
        expect_malformed(lambda: session.step(POSITIONS, TURNS), "answers another request")
        with pytest.warns(hullcast.MissingHullsWarning):
            session.step(POSITIONS, TURNS)  # on a new stream


@pytest.mark.parametrize("data", [b"\xff", b"\x0a\xff", b"\x08"])
@pytest.mark.parametrize(
    "method", ["RegisterHulls", "QueryContacts", "FindContacts", "GetServerInfo", "ListHulls", "DeleteHulls", "StreamContacts"]
)  # fmt: skip
def test_bytes_that_are_no_message(served, method, data):
    """Catches protobuf's own exception."""
    mock, client = served
    mock.answers = {method: lambda r: [data]}
    calls: dict[str, Callable[[], Any]] = {
        "RegisterHulls": lambda: client.register(CUBE),
        "QueryContacts": lambda: client.query(scene(), PAIRS),
        "FindContacts": lambda: client.find(scene()),
        "GetServerInfo": client.info,
        "ListHulls": client.hulls,
        "DeleteHulls": lambda: client.delete(IDS),
        "StreamContacts": lambda: client.session(scene(), PAIRS).step(POSITIONS, TURNS),
    }
    expect_malformed(calls[method], "not a protobuf message")


def record() -> hulls_pb2.HullInfo:
    return hulls_pb2.HullInfo(
        id=hullcast.hull_id(CUBE),
        contraction_point=[0] * 3,
        vertex_count=8,
        face_count=6,
        edge_count=12,
        volume=1,
        center_of_mass=[0] * 3,
        inertia=[1, 1, 1, 0, 0, 0],
        inradius=0.5,
        circumradius=0.87,
        registered_count=8,
    )


HULL_DEFECTS: dict[str, dict[str, Any]] = {
    "hash": {"id": b"\1" * 32},
    "hash of": {"id": b""},
    "contraction_point": {"contraction_point": [0] * 2},
    "center_of_mass": {"center_of_mass": [NAN] * 3},
    "inertia": {"inertia": [1] * 9},
    "volume": {"volume": -1.0},
    "inradius": {"inradius": 0.0},
    "inradius is nan": {"inradius": NAN},
    "circumradius": {"circumradius": 0.4},
    "geometric_error": {"geometric_error": NAN},
    "deviation": {"deviation": -1.0},
    "planarity": {"planarity": NAN},
    "9 vertices": {"vertex_count": 9},
    "20 edges": {"edge_count": 20},
    "3 faces": {"face_count": 3},
}


@pytest.mark.parametrize("text", HULL_DEFECTS)
def test_register_refuses_every_defect(served, text):
    """Catches a hull under another hull's id, and numbers that no hull can have."""
    mock, client = served
    info = record()
    for name, value in HULL_DEFECTS[text].items():
        if isinstance(value, list):
            info.ClearField(name)
            getattr(info, name).extend(value)
        else:
            setattr(info, name, value)
    result = hulls_pb2.RegisterHullsResponse(results=[hulls_pb2.RegisterHullResult(hull=info)])
    mock.answers = {"RegisterHulls": lambda r: [result.SerializeToString()]}
    expect_malformed(lambda: client.register(CUBE), text)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_register_refuses_another_number_of_results(served, count):
    """Catches a call that returns another number of hulls than given, and an empty result."""
    mock, client = served
    results = [hulls_pb2.RegisterHullResult(hull=record())] * count
    message = hulls_pb2.RegisterHullsResponse(results=results)
    mock.answers = {"RegisterHulls": lambda r: [message.SerializeToString()]}
    expect_malformed(lambda: client.register([CUBE, CUBE]), f"results has {count} entries")
    empty = hulls_pb2.RegisterHullsResponse(results=[hulls_pb2.RegisterHullResult()])
    mock.answers = {"RegisterHulls": lambda r: [empty.SerializeToString()]}
    expect_malformed(lambda: client.register(CUBE), "neither a hull nor an error")


def test_the_other_calls_refuse_their_defects(served):
    """Catches a list of hulls that never ends, and deletions that are assigned to other hulls."""
    mock, client = served
    page = hulls_pb2.ListHullsResponse(
        hulls=[hulls_pb2.StoredHull(id=IDS[1])], next_page_token="again"
    )
    mock.answers = {"ListHulls": lambda r: [page.SerializeToString()]}
    expect_malformed(client.hulls, "not sorted")
    page.hulls[0].id = b"short"
    expect_malformed(client.hulls, "32 bytes")
    page.hulls[0].id = IDS[1]
    page.hulls[0].created_unix_ms = -(2**62)
    expect_malformed(client.hulls, "created_unix_ms")
    page.ClearField("hulls")
    expect_malformed(client.hulls, "without hulls")
    deleted = hulls_pb2.DeleteHullsResponse(deleted=[True])
    mock.answers = {"DeleteHulls": lambda r: [deleted.SerializeToString()]}
    expect_malformed(lambda: client.delete(IDS), "deleted has 1 entries, expected 2")
    info = server_pb2.GetServerInfoResponse(version="9")
    mock.answers = {"GetServerInfo": lambda r: [info.SerializeToString()]}
    assert client.info().version == "9"


def test_with_await(served):
    """Catches checks that only the blocking client makes."""
    mock, client = served

    async def run() -> None:
        async with hullcast.aio.connect(client.target, options=NO_PROXY) as other:
            for text, spoil in DEFECTS[::7]:
                mock.answers = {"QueryContacts": lambda r, s=spoil: [spoiled(r, s)]}
                with pytest.raises(hullcast.ServerError, match="MALFORMED_ANSWER") as caught:
                    await other.query(scene(), PAIRS, outputs=EVERYTHING)
                assert text in str(caught.value)

    asyncio.run(run())

"""The messages of step loops: what a client sends, and which answers it refuses.

A mock server answers, so that an answer can be of any form.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from crowds import CUBE, NO_PROXY
from hostile import Mock, mock_server
from relay import Request, Response, relayed

import hullcast

NONE = 2**32 - 1
IDS = [bytes([i + 1]) * 32 for i in range(2)]
OUTPUTS = ["NORMAL", "POINTS", "MATCHES"]
TURN = [0.0, 0, 0, 1]


class Script:
    """The requests that arrived, and the answers to give: one list of messages per request."""

    def __init__(self) -> None:
        self.requests: list[Any] = []
        self.answers: list[list[Any]] = []

    def __call__(self, data: bytes) -> list[bytes]:
        request = Request.FromString(data)
        self.requests.append(request)
        given = self.answers.pop(0) if self.answers else [rows([])]
        for message in given:
            message.request_id = request.request_id
        return [message.SerializeToString() for message in given]


@pytest.fixture
def script() -> Script:
    """A script for the stream of `session`."""
    return Script()


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[Mock, hullcast.Client]]:
    with mock_server() as (mock, target), hullcast.connect(target, options=NO_PROXY) as client:
        yield mock, client


@pytest.fixture
def session(served, script) -> Iterator[hullcast.Session]:
    """A find session with four bodies, whose server follows the script."""
    mock, client = served
    mock.answers = {"StreamContacts": script}
    with client.session(bodies(4), find=True, outputs=OUTPUTS) as session:
        yield session


def bodies(count: int, **more: Any) -> hullcast.Scene:
    positions = np.arange(3.0 * count).reshape(count, 3)
    return hullcast.Scene(IDS, positions, [TURN] * count, body_hulls=[0] * count, **more)


def rows(pairs: list[list[int]], **fields: Any) -> Any:
    """A message with a contact of two points for each pair, none of which is matched."""
    n = len(pairs)
    message = Response(
        contract=1,
        outcomes=b"\1" * n,
        flags=b"\0" * n,
        separations=range(n),
        normals=[0, 0, 1] * n,
        point_counts=[2] * n,
        witness_as=range(6 * n),
        distances=range(2 * n),
        pairs=[body for pair in pairs for body in pair],
        previous_pairs=[NONE] * n,
        previous_points=[NONE] * 2 * n,
    )
    for name, value in fields.items():
        if isinstance(value, list):
            message.ClearField(name)
            getattr(message, name).extend(value)
        else:
            setattr(message, name, value)
    return message


def step(session: hullcast.Session, *changed: int, by: float = 0.5) -> hullcast.Manifolds:
    """A step in which some bodies have moved."""
    scene = session._query.scene
    positions = scene.positions.copy()
    positions[list(changed)] += by
    return session.step(positions, scene.rotations)


def test_only_the_bodies_that_moved_are_sent(served, script):
    """Catches a body that is sent without need, or that moved and is not sent.

    Poses are compared by their bits: -0.0 is another pose than 0.0, and NaN is the same one.
    """
    mock, client = served
    mock.answers = {"StreamContacts": script}
    scene = bodies(40)
    session = client.session(scene, find=True, on_invalid="flag")
    session.step(scene.positions, scene.rotations)
    first = script.requests[-1]
    assert first.find
    assert (first.inherit, len(first.positions), list(first.previous_bodies)) == (False, 120, [])

    def sent(positions: Any, rotations: Any = scene.rotations) -> tuple[list[int], int, int]:
        session.step(positions, rotations)
        last = script.requests[-1]
        assert last.inherit
        for field in ("find", "hull_ids", "body_hulls", "outputs", "margin", "accuracy"):
            assert not last.HasField(field) if field == "accuracy" else not getattr(last, field)
        return list(last.moved), len(last.positions), len(last.rotations)

    assert sent(scene.positions) == ([], 0, 0)
    positions = scene.positions.copy()
    positions[0, 0] = -0.0
    assert sent(positions) == ([0], 3, 4)
    assert sent(positions) == ([], 0, 0)
    positions[[7, 3], 1] = np.nan
    assert sent(positions) == ([3, 7], 6, 8)
    assert script.requests[-1].positions[4] != script.requests[-1].positions[4]
    assert sent(positions) == ([], 0, 0)
    rotations = np.array(scene.rotations)
    rotations[39] = np.nextafter(rotations[39], 1)
    assert sent(positions, rotations) == ([39], 3, 4)
    assert script.requests[-1].rotations[0] == np.nextafter(0, 1)
    # Naming 38 bodies of 40 takes more bytes than all poses.
    positions[:37] += 1
    assert sent(positions, rotations) == (list(range(37)), 111, 148)
    positions[:38] += 1
    assert sent(positions, rotations) == ([], 120, 160)


def test_bodies_that_are_named_are_sent(session, script):
    """Catches poses that go to other bodies when `moved` is not in order, and lost poses."""
    scene = bodies(4)
    session.step(scene.positions, scene.rotations)
    m = session.step([[9, 9, 9], [8, 8, 8]], [TURN] * 2, moved=[3, 1])
    last = script.requests[-1]
    assert list(last.moved) == [1, 3]
    assert list(last.positions) == [8, 8, 8, 9, 9, 9]
    assert m.scene.positions.tolist() == [[0, 1, 2], [8, 8, 8], [6, 7, 8], [9, 9, 9]]
    m = session.step(np.zeros((0, 3)), np.zeros((0, 4)), moved=[])
    assert (list(script.requests[-1].moved), list(script.requests[-1].positions)) == ([], [])
    assert m.scene.positions[3].tolist() == [9, 9, 9]
    # Whole poses are compared with those that the last step left.
    session.step(scene.positions, scene.rotations)
    assert list(script.requests[-1].moved) == [1, 3]


def test_only_the_motions_that_changed_are_sent(session, script):
    """Catches velocities that are sent without need, or not sent with the pose of their body."""
    scene = bodies(4)
    whole: Any = (scene.positions, scene.rotations)
    fast = np.arange(12.0).reshape(4, 3)
    session.step(*whole, linear_velocities=fast, time_step=0.5)
    first = script.requests[-1]
    assert (list(first.linear_velocities), first.time_step) == (list(range(12)), 0.5)
    assert list(first.angular_velocities) == []

    def sent(**motion: Any) -> tuple[list[int], list[float], list[float], float]:
        session.step(*whole, **motion)
        last = script.requests[-1]
        assert last.inherit
        assert len(last.positions) == (3 * len(last.moved) if len(last.moved) else 0)
        columns = last.linear_velocities, last.angular_velocities
        return (list(last.moved), *map(list, columns), last.time_step)

    assert sent(linear_velocities=fast, time_step=0.5) == ([], [], [], 0.5)
    assert sent() == ([], [], [], 0.0)
    fast[2] = 9
    assert sent(linear_velocities=fast, time_step=1) == ([2], [9, 9, 9], [], 1.0)
    assert sent(angular_velocities=np.zeros((4, 3))) == ([], [], [], 0.0)
    turn = np.zeros((4, 3))
    turn[1] = 1
    assert sent(angular_velocities=turn) == ([1], [3, 4, 5], [1, 1, 1], 0.0)


def test_pair_sessions_send_only_the_bodies_that_moved(served, script):
    """Catches `moved` by the scene's numbers in a message that has only the bodies of its pairs.

    A server of the first contract does not know `moved`, and gets all poses.
    """
    mock, client = served
    mock.answers = {"StreamContacts": script}
    scene = bodies(60)
    for contract in (1, 0):
        session = client.session(scene, [[50, 7], [7, 20]], outputs=["OUTCOME"])
        sent: list[Any] = []
        positions = scene.positions.copy()
        for body in (None, None, 20):
            if body is not None:
                positions[body] += 1
            script.answers = [[Response(outcomes=b"\2\2", flags=b"\0\0", contract=contract)]]
            session.step(positions, scene.rotations)
            sent.append(script.requests[-1])
        numbers = [round(x / 3) for x in sent[0].positions[::3]]
        assert sorted(numbers) == [7, 20, 50]
        assert [len(request.positions) for request in sent] == [9, 0, 3] if contract else [9] * 3
        assert list(sent[1].moved) == []
        assert list(sent[2].moved) == ([numbers.index(20)] if contract else [])


def test_messages_of_one_answer_are_joined(session, script):
    """Catches a part that is lost, and the next step's answer that is taken for a part."""
    script.answers = [
        [rows([[0, 1]], more=True), rows([], more=True), rows([[0, 2], [1, 3]])],
        [rows([[2, 3]])],
    ]
    assert step(session).pairs.tolist() == [[0, 1], [0, 2], [1, 3]]
    assert step(session, 1).pairs.tolist() == [[2, 3]]


def test_an_answer_that_did_not_change_has_the_same_arrays(session, script):
    """Catches arrays that are copied, that a caller can change, and matches of the step before."""
    script.answers = [
        [rows([[0, 1], [0, 2]])],
        [rows([[0, 1]], previous_pairs=[1], previous_points=[1, 0], ended_pairs=[0, 1])],
        [Response(contract=1, unchanged=True)],
        [Response(contract=1, unchanged=True)],
        [rows([[0, 1]], previous_pairs=[0], previous_points=[NONE, 0])],
    ]
    first, second, third, fourth = step(session), step(session, 1), step(session), step(session)
    assert first.restarted
    assert (first.previous_pairs.tolist(), first.previous_points.tolist()) == ([-1] * 2, [-1] * 4)
    assert second.previous_pairs.tolist() == [1]
    assert second.previous_points.tolist() == [3, 2]
    assert second.ended_pairs.tolist() == [[0, 1]]
    for still in (third, fourth):
        assert still.normal is second.normal
        assert still.previous_pairs.tolist() == [0]
        assert still.previous_points.tolist() == [0, 1]
        assert len(still.ended_pairs) == 0
    assert not second.restarted
    assert not fourth.restarted
    for column in second._columns.values():
        with pytest.raises(ValueError, match="read-only"):
            column[...] = 0
    fifth = step(session, 1)
    assert fifth.previous_points.tolist() == [-1, 0]
    impulses = np.array([[1.0, 1, 1], [2, 2, 2]])
    carried = np.concatenate([impulses, np.zeros((1, 3))])[fifth.previous_points]
    assert carried.tolist() == [[0, 0, 0], [1, 1, 1]]


def test_matches_are_columns_like_others(session, script, tmp_path):
    """Catches matches that are lost where pairs are chosen, and in files and data frames."""
    script.answers = [
        [rows([[0, 1], [0, 2]])],
        [rows([[0, 1], [0, 2]], previous_pairs=[NONE, 0], previous_points=[NONE] * 3 + [1])],
    ]
    assert step(session)[[0]].restarted
    m = step(session, 1)
    chosen = m[m.previous_pairs >= 0]
    assert not chosen.restarted
    assert (chosen.previous_pairs.tolist(), chosen.previous_points.tolist()) == ([0], [-1, 1])
    assert hullcast.Manifolds.concat([m, chosen]).previous_pairs.tolist() == [-1, 0, 0]
    m.save(tmp_path / "m.npz")
    again = hullcast.Manifolds.load(tmp_path / "m.npz")
    assert again.previous_points.tolist() == m.previous_points.tolist() == [-1, -1, -1, 1]
    assert again.ended_pairs.shape == (0, 2)
    with np.load(tmp_path / "m.npz") as file:
        columns = dict(file)
    np.savez(tmp_path / "bad.npz", **{**columns, "previous_pairs": np.array([0, -2])})
    with pytest.raises(hullcast.InvalidArgument, match=r"NOT_MANIFOLDS.*previous_pairs"):
        hullcast.Manifolds.load(tmp_path / "bad.npz")
    pytest.importorskip("pandas")
    frame = m.to_dataframe("pairs")
    assert frame["previous_pair"].tolist() == [-1, 0]


def test_results_of_pair_sessions_stay_apart(served, script):
    """Catches an unchanged answer that has what a caller wrote into the arrays before."""
    mock, client = served
    mock.answers = {"StreamContacts": script}
    message = rows([[0, 1]])
    message.ClearField("pairs")
    script.answers = [[message], *([Response(contract=1, unchanged=True)] for _ in range(2))]
    session = client.session(bodies(2), [[0, 1]], outputs=OUTPUTS)
    first, second = step(session), step(session)
    first.distance[:], second.distance[:] = 7, 8
    second.point_counts[:] = 9
    third = step(session)
    assert third.distance.tolist() == [0, 1]
    assert third.previous_points.tolist() == [0, 1]


def test_a_server_without_room_gets_the_next_message_in_full(session, script):
    """Catches a message that inherits what the server did not keep, and a new stream."""
    script.answers = [[rows([[0, 1]])], [rows([[0, 1]], state_dropped=True)], [rows([[0, 1]])]]
    assert step(session).restarted
    stream = session._lanes[0].stream
    assert not step(session, 1).restarted
    assert step(session, 1).restarted
    last = script.requests[-1]
    assert (last.inherit, last.find, len(last.positions)) == (False, True, 12)
    assert session._lanes[0].stream is stream
    step(session, 2)
    assert list(script.requests[-1].moved) == [2]


def test_bodies_that_come_and_go_are_numbered_anew(session, script):
    """Catches numbers of another scene in `previous_bodies`, and a body that is lost in between."""
    script.answers = [
        [rows([[0, 1], [1, 3]])],
        [rows([[0, 2]], previous_pairs=[1], previous_points=[0, 1], ended_pairs=[0, 1])],
    ]
    step(session)
    m = session.update(bodies(3), previous=[3, -1, 1])
    last = script.requests[-1]
    assert (last.inherit, last.find) == (False, True)
    assert list(last.previous_bodies) == [3, NONE, 1]
    assert (m.previous_pairs.tolist(), m.previous_points.tolist()) == ([1], [2, 3])
    assert m.ended_pairs.tolist() == [[0, 1]]
    assert not m.restarted
    assert repr(session).startswith("Session(find, 3 bodies, ")
    assert len(session) == 1
    step(session, 2)
    assert list(script.requests[-1].moved) == [2]
    assert session.update(bodies(2)).restarted
    assert list(script.requests[-1].previous_bodies) == []
    assert session.update(bodies(0), previous=[]).scene is not None


def test_an_update_that_cannot_be_compared_begins_anew(session, script):
    """Catches `previous_bodies` in the first message of a stream, or after dropped state."""
    assert session.update(bodies(3), previous=[0, 1, 2]).restarted
    assert list(script.requests[-1].previous_bodies) == []
    script.answers = [[rows([], state_dropped=True)]]
    step(session, 1)
    assert session.update(bodies(3), previous=[0, 1, 2]).restarted
    assert list(script.requests[-1].previous_bodies) == []


def test_an_update_that_failed_can_be_repeated(session, script):
    """Catches numbers that are refused, because they are taken for those of the scene that failed."""
    script.answers = [[rows([[0, 1]])], [rows([[0, 1]], previous_pairs=[7])]]
    step(session)
    smaller = bodies(2)
    with pytest.raises(hullcast.ServerError, match="MALFORMED_ANSWER"):
        session.update(smaller, previous=[3, -1])
    assert session.update(smaller, previous=[3, -1]).restarted
    with pytest.raises(hullcast.InvalidArgument, match="the scene of the step before has 2 bodies"):
        session.update(smaller, previous=[3, -1])
    script.answers = [[rows([], previous_pairs=[7])]]
    with pytest.raises(hullcast.ServerError, match="MALFORMED_ANSWER"):
        session.update(bodies(5), previous=[0, 1, -1, -1, -1])
    assert len(step(session).scene) == 5


def old_and_one_row(**fields: Any) -> list[list[Any]]:
    """An answer with two pairs, the first CONTACT and the second UNDECIDED, then one with one."""
    return [[rows([[0, 1], [0, 2]], outcomes=b"\1\3")], [rows([[0, 1]], **fields)]]


#: For each defect, a part of the error's text and the answers of two steps.
DEFECTS: dict[str, tuple[str, Callable[[], list[list[Any]]]]] = {
    "first with pairs": ("first answer", lambda: [[rows([[0, 1]], previous_pairs=[0])]]),
    "first with points": ("first answer", lambda: [[rows([[0, 1]], previous_points=[0, NONE])]]),
    "first with ended": ("first answer", lambda: [[rows([], ended_pairs=[0, 1])]]),
    "first unchanged": ("no answer before", lambda: [[Response(contract=1, unchanged=True)]]),
    "row": ("less than 2", lambda: old_and_one_row(previous_pairs=[2])),
    "row twice": ("a row twice", lambda: [old_and_one_row()[0], [rows([[0, 1], [0, 3]], previous_pairs=[1, 1])]]),
    "point of a new row": ("no predecessor", lambda: old_and_one_row(previous_points=[0, 1])),
    "point": ("does not have", lambda: old_and_one_row(previous_pairs=[0], previous_points=[2, NONE])),
    "point twice": ("a point twice", lambda: old_and_one_row(previous_pairs=[0], previous_points=[1, 1])),
    "ended body": ("has body 4", lambda: old_and_one_row(ended_pairs=[0, 4])),
    "half an ended pair": ("ended_pairs", lambda: old_and_one_row(ended_pairs=[0])),
    "more and unchanged": ("no answer before", lambda: [old_and_one_row()[0], [rows([], more=True), Response(contract=1, unchanged=True)]]),
    "unsorted": ("not sorted", lambda: [[rows([[0, 2]], more=True), rows([[0, 1]])]]),
}  # fmt: skip


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_session_refuses_every_defect(session, script, defect):
    """Catches matches that index something else, and an answer of which a part is missing.

    The session goes on with a full message.
    """
    text, answers = DEFECTS[defect]
    script.answers = answers()
    for _ in script.answers[:-1]:
        step(session)
    with pytest.raises(hullcast.ServerError) as caught:
        step(session, 0)
    assert caught.value.reason == "MALFORMED_ANSWER"
    assert text in str(caught.value)
    script.answers = [[rows([[0, 1]])]]
    assert step(session, 1).restarted


def test_only_rows_in_contact_or_undecided_match(served, script):
    """Catches a match of a SEPARATED row, which the rule does not have, before or after."""
    mock, client = served
    mock.answers = {"StreamContacts": script}

    def answer(outcome: bytes, previous: int) -> list[Any]:
        known = outcome != b"\2"
        message = rows([[0, 1]], outcomes=outcome, previous_pairs=[previous])
        if not known:
            for name in ("witness_as", "distances", "previous_points"):
                message.ClearField(name)
            message.point_counts[0] = 0
        message.ClearField("pairs")
        return [message]

    for before, after in ((b"\2", b"\1"), (b"\1", b"\2")):
        session = client.session(bodies(2), [[0, 1]], outputs=OUTPUTS)
        script.answers = [answer(before, NONE), answer(after, NONE), answer(before, NONE)]
        for _ in range(3):
            assert step(session, 0).previous_pairs.tolist() == [-1]
        script.answers = [answer(after, 0)]
        with pytest.raises(hullcast.ServerError, match="not CONTACT or UNDECIDED"):
            step(session, 0)


@pytest.mark.parametrize("worlds", [None, [0, 0, 1, 1]])
def test_an_old_server_is_refused_by_its_version(client, worlds):
    """Catches the answer to another question: an old server ignores `find` and finds no pairs.

    The relay makes a new server of an old one: it hides the fields and the contract number. With
    worlds the old server refuses the message, because it has no pairs to find.
    """
    scene = hullcast.Scene(client.register([CUBE] * 4), np.zeros((4, 3)), [TURN] * 4, worlds=worlds)
    version = client.info().version
    with (
        relayed(client.target) as (relay, target),
        hullcast.connect(target, options=NO_PROXY) as other,
    ):
        relay.be_old()
        assert other.info().contract == 0
        for session in (
            other.session(scene, find=True),
            other.session(scene, [[0, 1]], outputs=["MATCHES"]),
        ):
            with pytest.raises(hullcast.Unimplemented) as caught:
                session.step(scene.positions, scene.rotations)
            assert caught.value.reason == "SERVER_TOO_OLD"
            assert f"version {version} does not know" in str(caught.value)
            if session._query.matches:
                break
        # A session of given pairs works as before, with all poses in each step.
        session = other.session(scene, [[0, 1]])
        for _ in range(3):
            assert session.step(scene.positions, scene.rotations).in_contact.all()
        assert [len(request.positions) for request in relay.requests[-3:]] == [12] * 3

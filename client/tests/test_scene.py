"""Scenes and requests: every accepted form of input, and refusals before anything is sent."""

from __future__ import annotations

import numpy as np
import pytest
from cases import matrix, random_rotation

import hullcast
from hullcast import _packed
from hullcast._pb import contacts_pb2
from hullcast._query import Query, Span

IDS = [bytes([i]) * 32 for i in range(4)]


def sent(query: Query, span: Span | None = None) -> contacts_pb2.QueryContactsRequest:
    """A request as any other protobuf library reads it."""
    if span is None:
        (span,) = query.spans(4096)
    return contacts_pb2.QueryContactsRequest.FromString(query.message(span).data)


def rotations(count: int, seed: int = 0) -> np.ndarray:
    """(count, 4): random quaternions."""
    rng = np.random.default_rng(seed)
    return np.array([random_rotation(rng) for _ in range(count)])


def test_each_hull_is_sent_once():
    """With one hull per body, a message has each distinct hull once, and an index per body."""
    scene = hullcast.Scene([IDS[1], IDS[0], IDS[1]], np.zeros((3, 3)), rotations(3))
    assert scene.hull_ids == (IDS[1], IDS[0])
    assert scene.body_hulls.tolist() == [0, 1, 0]
    indexed = hullcast.Scene(
        [IDS[0], IDS[1], IDS[1]], np.zeros((4, 3)), rotations(4), body_hulls=[2, 1, 0, 0]
    )
    assert [indexed.hull_ids[i] for i in indexed.body_hulls] == [IDS[1], IDS[1], IDS[0], IDS[0]]


def test_rotations_of_every_form_are_the_same():
    """Matrices, scipy's Rotation, poses and w-first quaternions give the same rotations.

    Quarter turns about the axes, in which components vanish, are included.
    """
    quarter = np.sqrt(0.5)
    q = np.concatenate([rotations(50), np.eye(4), quarter * np.eye(4)[:3] + [0, 0, 0, quarter]])
    n = len(q)
    matrices = np.array([matrix(r) for r in q])
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, :3, :3] = matrices
    poses[:, :3, 3] = np.arange(3 * n).reshape(n, 3)

    class Rotation:
        """Like scipy.spatial.transform.Rotation, with the one method that is used."""

        def as_quat(self) -> np.ndarray:
            return q

    scene = hullcast.Scene(IDS[:1], poses, body_hulls=np.zeros(n, int))
    assert (scene.positions == poses[:, :3, 3]).all()
    found = [
        scene.rotations,
        scene.moved(scene.positions, matrices).rotations,
        scene.moved(scene.positions, Rotation()).rotations,
        scene.moved(scene.positions, hullcast.from_wxyz(np.roll(q, 1, axis=1))).rotations,
        scene.moved(poses).rotations,
    ]
    for other in found:
        signs = np.sign(np.sum(other * q, axis=1, keepdims=True))
        assert np.abs(signs * other - q).max() < 4e-16


def test_moving_keeps_the_rest():
    """A moved scene has new poses and the same bodies. The original scene is unchanged."""
    scene = hullcast.Scene(IDS[:2], np.zeros((2, 3)), rotations(2), groups=[1, 2])
    moved = scene.moved(np.ones((2, 3)), rotations(2, 1))
    assert moved.hull_ids == scene.hull_ids
    assert moved.groups is scene.groups
    assert (scene.positions == 0).all()
    assert (moved.positions == 1).all()


@pytest.mark.parametrize(
    ("make", "reason", "field", "index"),
    [
        (lambda: hullcast.Scene(IDS[:2], np.zeros((3, 3)), rotations(3)), "MISSING_ARGUMENT", "body_hulls", None),
        (lambda: hullcast.Scene(IDS[:2], np.zeros((2, 2)), rotations(2)), "WRONG_SHAPE", "positions", None),
        (lambda: hullcast.Scene(IDS[:2], np.zeros((2, 3)), rotations(3)), "WRONG_SHAPE", "rotations", None),
        (lambda: hullcast.Scene(IDS[:2], np.zeros((2, 3))), "MISSING_ARGUMENT", "rotations", None),
        (lambda: hullcast.Scene([b"short"], np.zeros((1, 3)), rotations(1)), "NOT_A_HULL", "hulls", 0),
        (lambda: hullcast.Scene(IDS[:1], np.zeros((2, 3)), rotations(2), body_hulls=[0, 1]), "INDEX_OUT_OF_RANGE", "body_hulls", 1),
        (lambda: hullcast.Scene(IDS[:1], np.zeros((1, 3)), [2 * np.eye(3)]), "NOT_A_ROTATION", "rotations", 0),
        (lambda: hullcast.Scene(IDS[:1], np.zeros((1, 3)), [-np.eye(3)]), "NOT_A_ROTATION", "rotations", 0),
        (lambda: hullcast.Scene(IDS[:1], np.ones((1, 4, 4))), "NOT_A_POSE", "positions", 0),
        (lambda: hullcast.Scene(IDS[:1], [["x", 0, 0]], rotations(1)), "NOT_AN_ARRAY", "positions", None),
        (lambda: hullcast.Scene(IDS[:1], np.zeros((1, 3)), rotations(1), worlds=[1, 2]), "WRONG_SHAPE", "worlds", None),
    ],
)  # fmt: skip
def test_what_a_scene_refuses(make, reason, field, index):
    """The error has reason, field and index, and nothing is sent."""
    with pytest.raises(hullcast.InvalidArgument) as caught:
        make()
    assert (caught.value.reason, caught.value.field, caught.value.index) == (reason, field, index)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize(
    ("pairs", "options", "reason", "field", "index"),
    [
        ([[0, 2]], {}, "INDEX_OUT_OF_RANGE", "pairs", 1),
        ([[0, -1]], {}, "INDEX_OUT_OF_RANGE", "pairs", 1),
        ([[0.0, 1.0]], {}, "NOT_INTEGERS", "pairs", None),
        ([0, 1], {}, "WRONG_SHAPE", "pairs", None),
        ([[0, 1]], {"outputs": ["ALPHA", "BETA"]}, "UNKNOWN_VALUE", "outputs", 1),
        ([[0, 1]], {"outputs": ["UNSPECIFIED"]}, "UNKNOWN_VALUE", "outputs", 0),
    ],
)  # fmt: skip
def test_what_a_query_refuses(pairs, options, reason, field, index):
    """The error has reason, field and index, and nothing is sent."""
    scene = hullcast.Scene(IDS[:2], np.zeros((2, 3)), rotations(2))
    with pytest.raises(hullcast.InvalidArgument) as caught:
        Query(scene, pairs, **options)
    assert (caught.value.reason, caught.value.field, caught.value.index) == (reason, field, index)


def test_the_request_is_what_protobuf_reads():
    """Columns that are inserted as bytes are read as the real packed fields."""
    scene = hullcast.Scene(IDS[:2], [[1, 2, 3], [4, 5, 6]], rotations(2))
    accuracy = hullcast.Accuracy(
        "GJK_RAY_CAST", relative_tolerance=0.5, feature_angle=0, max_points=4
    )
    request = sent(Query(scene, [[1, 0]], margin=0.25, accuracy=accuracy, outputs=["BASES"]))
    assert list(request.hull_ids) == IDS[:2]
    assert list(request.body_hulls) == [0, 1]
    assert list(request.positions) == [1, 2, 3, 4, 5, 6]
    assert list(request.rotations) == scene.rotations.reshape(-1).tolist()
    assert list(request.pairs) == [1, 0]
    assert request.margin == 0.25
    assert request.outputs == [contacts_pb2.OUTPUT_BASES]
    assert request.accuracy.solver == contacts_pb2.SOLVER_GJK_RAY_CAST
    assert request.accuracy.relative_tolerance == 0.5
    assert request.accuracy.HasField("feature_angle")  # 0 must be sent, since it is not the default
    assert request.accuracy.feature_angle == 0
    assert request.accuracy.max_points == 4
    assert not request.warm_starts


def test_a_message_carries_only_what_its_pairs_name():
    """After a split and renumbering, every pair still has the same hulls and poses."""
    rng = np.random.default_rng(4)
    count = 500
    scene = hullcast.Scene(
        IDS, rng.normal(size=(count, 3)), rotations(count), body_hulls=rng.integers(4, size=count)
    )
    pairs = rng.integers(count, size=(130, 2))
    query = Query(scene, pairs)
    spans = query.spans(50)
    assert [span.stop - span.start for span in spans] == [43, 43, 44]
    renumbered = 0
    for span in spans:
        request = sent(query, span)
        positions = np.reshape(request.positions, (-1, 3))
        turns = np.reshape(request.rotations, (-1, 4))
        asked = pairs[span.start : span.stop].reshape(-1)
        bodies = np.array(request.pairs)
        assert len(positions) == len(np.unique(asked))
        assert (positions[bodies] == scene.positions[asked]).all()
        assert (turns[bodies] == scene.rotations[asked]).all()
        hulls = [request.hull_ids[i] for i in np.array(request.body_hulls)[bodies]]
        assert hulls == [scene.hull_ids[i] for i in scene.body_hulls[asked]]
        renumbered += len(positions) < count
    assert renumbered == 3


def test_answers_are_numbered_as_the_scene():
    """The hulls and bodies in the response to a renumbered message are numbered as in the scene."""
    scene = hullcast.Scene(IDS, np.zeros((100, 3)), rotations(100), body_hulls=np.arange(100) % 4)
    query = Query(scene, [[50, 7]], outputs=["OUTCOME"])
    (span,) = query.spans(4096)
    message = query.message(span)
    request = contacts_pb2.QueryContactsRequest.FromString(message.data)
    place = list(request.hull_ids).index(scene.hull_ids[3])
    body = int(request.pairs[1])
    data = contacts_pb2.QueryContactsResponse(
        request_id=request.request_id,
        outcomes=b"\4",
        flags=b"\x50",
        missing_hulls=[place],
        invalid_bodies=[body],
    )
    columns = query.read(span, message, data.SerializeToString())
    assert columns["missing_hulls"].tolist() == [3]
    assert columns["invalid_bodies"].tolist() == [7]


def test_find_sends_worlds_and_groups():
    """The request has the whole scene, without pairs."""
    scene = hullcast.Scene(
        IDS[:2],
        np.zeros((2, 3)),
        rotations(2),
        worlds=[0, 2**32 - 1],
        groups=[1, 2],
        ignored_groups=[[1, 2]],
    )
    request = contacts_pb2.QueryContactsRequest.FromString(
        Query(scene, None, find=True).find_message().data
    )
    assert list(request.worlds) == [0, 2**32 - 1]
    assert list(request.groups) == [1, 2]
    assert list(request.ignored_groups) == [1, 2]
    assert len(request.positions) == 6
    assert not request.pairs


def test_ignored_groups_need_groups():
    """Catches `ignored_groups` that have no effect, because no body has a group."""
    with pytest.raises(hullcast.InvalidArgument, match="MISSING_ARGUMENT: groups: missing"):
        hullcast.Scene(IDS[:2], np.zeros((2, 3)), rotations(2), ignored_groups=[[1, 2]])
    assert hullcast.Scene(IDS[:2], np.zeros((2, 3)), rotations(2), ignored_groups=[]).groups is None


def test_every_register_column_is_bytes():
    """Catches a column with its real type, which would be filled number by number."""
    for field in _packed.RegisterHullsRequest.DESCRIPTOR.fields:
        assert field.type not in (field.TYPE_DOUBLE, field.TYPE_FIXED32)


@pytest.mark.parametrize("count", [0, 1, 15, 16, 2047, 2048, 262_144])
def test_columns_are_written_as_protobuf_does(count):
    """Empty columns, and columns whose lengths take one to four bytes, are read correctly."""
    rng = np.random.default_rng(count)
    for name, number in _packed._REQUEST_COLUMNS.items():
        field = contacts_pb2.QueryContactsRequest.DESCRIPTOR.fields_by_name[name]
        if field.type == field.TYPE_DOUBLE:
            values = rng.normal(size=count)
        else:
            values = rng.integers(2**32, size=count, dtype="<u4")
        rest = contacts_pb2.QueryContactsRequest(margin=0.5, request_id=7)
        data = _packed.request(rest, [(name, values)])
        read = contacts_pb2.QueryContactsRequest.FromString(data)
        assert np.array_equal(np.array(getattr(read, name), dtype=values.dtype), values)
        assert (read.margin, read.request_id, field.number) == (0.5, 7, number)
        getattr(rest, name).extend(values.tolist())
        assert read == rest
    assert len(_packed._REQUEST_COLUMNS) == 14

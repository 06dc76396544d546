"""The client against a real server: queries, and every kind of refusal."""

from __future__ import annotations

import itertools
import threading

import grpc
import numpy as np
import pytest
from crowds import COLUMNS, CUBE, EVERYTHING, NO_PROXY, crowd, expect_same

import hullcast
from hullcast import Flag, Outcome
from hullcast._channel import Settings


def test_two_cubes_resting(client):
    """The README's example, in which every number has a closed form."""
    hulls = client.register([CUBE])
    scene = hullcast.Scene(
        hulls, [[0, 0, 0], [0.25, 0, 0.999]], [[0, 0, 0, 1]] * 2, body_hulls=[0, 0]
    )
    m = client.query(scene, [[0, 1]])
    assert m.outcome.tolist() == [Outcome.CONTACT]
    assert m.flags.tolist() == [0]
    assert m.alpha[0] == pytest.approx(0.999, rel=1e-15)
    assert m.normal[0] == pytest.approx([0, 0, 1], abs=1e-15)
    assert m.separation[0] == pytest.approx(-0.001, rel=1e-10)
    assert m.distance == pytest.approx([-0.001] * 4, rel=1e-10)
    assert sorted(map(tuple, m[0].witness_a.round(12))) == sorted(
        itertools.product((-0.25, 0.5), (-0.5, 0.5), (0.5,))
    )
    assert m.witness_b[:, 2] == pytest.approx(0.499)


def test_an_empty_query_is_answered(client):
    """A query without pairs gives columns without rows."""
    m = client.query(crowd(client, 4), np.zeros((0, 2), dtype=int), outputs=EVERYTHING)
    assert len(m) == 0
    assert m.alpha.shape == (0,)
    assert m.normal.shape == (0, 3)
    assert m.point_offsets.tolist() == [0]


@pytest.mark.parametrize("per_message", [1000, 999, 37])
def test_splitting_changes_no_bit(client, per_message):
    """A query in many messages, with renumbered bodies, gives the same bits as in one message."""
    scene = crowd(client, 300)
    pairs = np.random.default_rng(33).integers(300, size=(1000, 2))
    whole = client.query(scene, pairs, margin=0.1, outputs=EVERYTHING)
    other = hullcast.connect(client.target, options=NO_PROXY)
    with other:
        other.pairs_per_message = per_message
        expect_same(other.query(scene, pairs, margin=0.1, outputs=EVERYTHING), whole)
    assert np.count_nonzero(whole.outcome == Outcome.CONTACT) >= 20
    assert np.count_nonzero(whole.outcome == Outcome.SEPARATED) >= 20


def test_threads_may_share_a_client(client):
    """Queries from several threads at once each get their own results."""
    scene = crowd(client, 200)
    pairs = [np.random.default_rng(seed).integers(200, size=(500, 2)) for seed in range(6)]
    expected = [client.query(scene, p, outputs=EVERYTHING) for p in pairs]
    found: list[hullcast.Manifolds | None] = [None] * len(pairs)

    def run(i: int) -> None:
        found[i] = client.query(scene, pairs[i], outputs=EVERYTHING)

    threads = [threading.Thread(target=run, args=(i,)) for i in range(len(pairs))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for ours, theirs in zip(found, expected, strict=True):
        assert ours is not None
        expect_same(ours, theirs)


@pytest.mark.parametrize(
    ("outputs", "present"),
    [
        (None, {"alpha", "normal", "witness_a", "witness_b", "distance"}),
        ((), set()),
        ("OUTCOME", set()),
        (("ALPHA",), {"alpha", "alpha_lower", "alpha_upper"}),
        (("NORMAL",), {"normal", "separation"}),
        (("POINTS",), {"witness_a", "distance", "point_offsets"}),
        (("WITNESS_B",), {"witness_b", "point_offsets"}),
        (("FEATURES",), {"point_ids", "feature_kinds", "feature_indices"}),
        (("BASES",), {"bases"}),
        (("DIAGNOSTICS",), {"iterations", "support_calls", "kept_area"}),
        (("ALPHA_GRADIENT",), {"alpha_gradient", "gradient_error"}),
        (("SEPARATION_GRADIENT",), {"separation_gradient", "gradient_error"}),
        (("NORMAL_JACOBIAN",), {"normal_jacobian", "gradient_error"}),
    ],
)
def test_only_what_was_asked_for_comes(client, outputs, present):
    """Each single output gives its columns with the usual values. Other columns raise an error."""
    scene = crowd(client, 60)
    pairs = np.random.default_rng(34).integers(60, size=(100, 2))
    everything = client.query(scene, pairs, margin=0.2, outputs=EVERYTHING)
    m = client.query(scene, pairs, margin=0.2, outputs=outputs)
    assert (m.outcome == everything.outcome).all()
    for name in COLUMNS:
        if name in ("iterations", "support_calls") and name in present:
            assert (getattr(m, name) <= getattr(everything, name)).all()  # it may stop sooner
        elif name in present:
            expected = pytest.approx(getattr(everything, name), abs=1e-12, nan_ok=True)
            assert getattr(m, name) == expected, name
    every = {"alpha", "normal", "witness_a", "point_ids", "bases", "iterations", "alpha_gradient"}
    absent = every - present
    for name in absent:
        with pytest.raises(hullcast.OutputNotAsked):
            getattr(m, name)


def test_a_warm_start_changes_no_number_much_and_saves_work(client):
    """Starting from its own bases saves the solver most work; useless bases do no harm."""
    scene = crowd(client, 200)
    pairs = np.random.default_rng(35).integers(200, size=(400, 2))
    cold = client.query(scene, pairs, margin=np.inf, outputs=EVERYTHING)
    moved = scene.moved(scene.positions + 1e-4, scene.rotations)
    warm = client.query(moved, pairs, margin=np.inf, outputs=EVERYTHING, warm=cold)
    again = client.query(moved, pairs, margin=np.inf, outputs=EVERYTHING)
    assert warm.support_calls.sum() < 0.8 * again.support_calls.sum()
    apart = np.flatnonzero(pairs[:, 0] != pairs[:, 1])
    assert warm.alpha[apart] == pytest.approx(again.alpha[apart], rel=1e-12)
    shuffled = client.query(scene, pairs[::-1], margin=np.inf, outputs=EVERYTHING)
    useless = client.query(scene, pairs, margin=np.inf, outputs=EVERYTHING, warm=shuffled)
    assert useless.alpha[apart] == pytest.approx(cold.alpha[apart], rel=1e-12)


def test_a_warm_start_needs_bases_of_as_many_pairs(client):
    """The client refuses a warm start with another number of pairs, or without bases."""
    scene = crowd(client, 4)
    short = client.query(scene, [[0, 1]], outputs=["BASES"])
    with pytest.raises(hullcast.InvalidArgument, match="warm"):
        client.query(scene, [[0, 1], [1, 2]], warm=short)
    with pytest.raises(hullcast.OutputNotAsked, match="BASES"):
        client.query(scene, [[0, 1]], warm=client.query(scene, [[0, 1]]))


def test_an_unknown_hull_costs_only_its_own_pairs(client):
    """Pairs with an unknown hull are INVALID, flagged and NaN. The others are answered as usual."""
    (hull,) = client.register([CUBE])
    scene = hullcast.Scene(
        [hull, b"\x07" * 32], np.zeros((3, 3)), [[0, 0, 0, 1]] * 3, body_hulls=[0, 0, 1]
    )
    m = client.query(scene, [[0, 1], [0, 2], [2, 2]], outputs=EVERYTHING)
    assert m.outcome.tolist() == [Outcome.CONTACT, Outcome.INVALID, Outcome.INVALID]
    assert [Flag(f) for f in m.flags[1:]] == [Flag.UNKNOWN_HULL] * 2
    assert np.isnan(m.alpha).tolist() == [False, True, True]
    assert np.isnan(m.normal[1:]).all()
    assert m.point_counts[1:].tolist() == [0, 0]
    assert scene.hull_ids[m.missing_hulls[0]] == b"\x07" * 32


def test_an_invalid_body_costs_only_its_own_pairs(client):
    """Only pairs of bodies with an unusable pose are INVALID, in whole scenes and in parts of them.

    A position may be NaN or too far, a norm 0 or 4.1. Catches that a quaternion of norm 0.25 to 4
    is refused, and that a body is not reported because no pair names it.
    """
    (hull,) = client.register([CUBE])
    count = 40
    positions = np.zeros((count, 3))
    positions[:, 0] = 0.9 * np.arange(count)
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    positions[5, 1] = np.nan
    positions[6, 2] = 2e100
    rotations[7] = 0
    rotations[8] *= 4.1
    rotations[9] *= 0.26
    scene = hullcast.Scene([hull], positions, rotations, body_hulls=np.zeros(count, int))
    pairs = np.array([[i, i + 1] for i in range(count - 1)])
    bad = np.isin(pairs, [5, 6, 7, 8]).any(axis=1)
    for subset in (np.arange(len(pairs)), np.arange(4, 9)):
        m = client.query(scene, pairs[subset], on_invalid="flag")
        assert (m.outcome == np.where(bad[subset], Outcome.INVALID, Outcome.CONTACT)).all()
        assert (m.flags == np.where(bad[subset], Flag.INVALID_BODY, 0)).all()
        assert m.invalid_bodies.tolist() == [5, 6, 7, 8]


@pytest.mark.parametrize(
    ("field", "value"),
    [("relative_tolerance", 2.0), ("feature_angle", 0.6), ("feature_angle", -0.1)],
)
def test_what_the_server_refuses_is_named(client, field, value):
    """Catches that a refusal by the server reaches the caller without its reason and field."""
    accuracy = hullcast.Accuracy()
    object.__setattr__(accuracy, field, value)  # bypasses the client's own check
    with pytest.raises(hullcast.InvalidArgument) as caught:
        client.query(crowd(client, 4), [[0, 1]], accuracy=accuracy)
    assert (caught.value.reason, caught.value.field) == ("VALUE_OUT_OF_RANGE", f"accuracy.{field}")
    assert str(caught.value).count("VALUE_OUT_OF_RANGE") == 1


def test_a_timeout_is_an_exception_of_its_own(client):
    """A call with too short a timeout raises DeadlineExceeded, and the client stays usable."""
    scene = crowd(client, 300)
    pairs = np.random.default_rng(36).integers(300, size=(20000, 2))
    with pytest.raises(hullcast.DeadlineExceeded) as caught:
        client.query(scene, pairs, timeout=1e-4)
    assert isinstance(caught.value, TimeoutError)
    assert len(client.query(scene, pairs[:10])) == 10


def test_a_too_large_answer_is_halved(client):
    """After RESPONSE_TOO_LARGE the query is repeated in halves, for one or several messages."""

    class Refusing(grpc.UnaryUnaryClientInterceptor):
        """Makes every query of more than 20 pairs fail."""

        refused = 0

        def intercept_unary_unary(self, continuation, details, request):
            from hullcast._pb import contacts_pb2

            if details.method.endswith("QueryContacts"):
                pairs = contacts_pb2.QueryContactsRequest.FromString(request).pairs
                if len(pairs) > 2 * 20:
                    Refusing.refused += 1
                    request = b"\xff"  # malformed, so the call fails; see `as_too_large`
            return continuation(details, request)

    scene = crowd(client, 50)
    pairs = np.random.default_rng(37).integers(50, size=(90, 2))
    expected = client.query(scene, pairs, outputs=EVERYTHING)
    real_open = Settings.open
    with pytest.MonkeyPatch.context() as patch:
        real = hullcast._status.from_rpc

        def as_too_large(call):
            error = real(call)
            if error.reason == "MALFORMED_MESSAGE":
                error.reason = "RESPONSE_TOO_LARGE"
            return error

        patch.setattr(hullcast._status, "from_rpc", as_too_large)
        patch.setattr(
            Settings, "open", lambda *a: grpc.intercept_channel(real_open(*a), Refusing())
        )
        for per_message in (1000, 30):
            with hullcast.connect(client.target, options=NO_PROXY) as other:
                other.pairs_per_message = per_message
                expect_same(other.query(scene, pairs, outputs=EVERYTHING), expected)
    assert Refusing.refused >= 6


def test_more_hulls_than_the_servers_cache_holds_are_asked_for_in_parts(client):
    """After HULLS_TOO_LARGE the query is repeated in halves, which have fewer hulls."""
    clouds = list(np.random.default_rng(38).normal(size=(200, 30, 3)))
    positions = np.random.default_rng(39).normal(size=(200, 3))
    pairs = np.stack([np.arange(199), np.arange(1, 200)], axis=1)
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (200, 1))
    scene = hullcast.Scene(client.register(clouds), positions, rotations)
    expected = client.query(scene, pairs, margin=1.0, outputs=EVERYTHING)
    with hullcast.serve(arguments=["--cache-bytes", "300000"]) as small:
        small.register(clouds)
        expect_same(small.query(scene, pairs, margin=1.0, outputs=EVERYTHING), expected)
        with pytest.raises(hullcast.InvalidArgument, match="cache_bytes") as caught:
            small.find(scene)
    assert (caught.value.reason, caught.value.field) == ("HULLS_TOO_LARGE", "hull_ids")

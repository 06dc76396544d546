"""`hullcast.match` compares two answers by the rule of matches, which `matching.py` has as loops."""

from __future__ import annotations

import pickle
from collections import Counter
from typing import Any

import matching
import numpy as np
import pytest
from crowds import CUBE
from loops import shapes

import hullcast
from hullcast import _matching

OPTIONS: Any = {"margin": 0.05, "outputs": ["NORMAL", "POINTS", "FEATURES"]}


def heap(
    rng: np.random.Generator, hulls: list[hullcast.Hull], count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, rotations and hulls of bodies, half of which lie on each other's faces."""
    positions, rotations = rng.uniform(0, 1.6, (count, 3)), rng.normal(size=(count, 4))
    if rng.random() < 0.5:
        rotations[:, :2] *= 1e-3
        positions[:, 2] = rng.integers(0, 3, size=count) * 0.5
    return positions, unit(rotations), rng.integers(len(hulls), size=count)


def unit(rotations: np.ndarray) -> np.ndarray:
    return rotations / np.linalg.norm(rotations, axis=1, keepdims=True)


def compare(
    before: hullcast.Manifolds, after: hullcast.Manifolds, previous: list[int] | None
) -> Counter[str]:
    """Compares `match` with the plain loops; counts what the rule did."""
    assert after.scene is not None
    radii = [after.scene.radii[hull] for hull in after.scene.body_hulls]
    expected = matching.matches(before, after, radii, previous)
    found = hullcast.match(before, after, previous=previous)
    assert found.previous_pairs.tolist() == expected.pairs
    assert found.previous_points.tolist() == expected.points
    assert found.ended_pairs.tolist() == expected.ended
    assert found.previous_pairs.dtype == found.previous_points.dtype == np.int64
    both = found.previous_pairs >= 0
    old = before.pairs[found.previous_pairs[both]]
    was = np.arange(len(after.scene)) if previous is None else np.array(previous)
    return Counter(
        {
            "by id": expected.by_id,
            "by distance": expected.by_distance,
            "new": expected.new,
            "ended": len(expected.ended),
            "turned": int(np.count_nonzero((old != was[after.pairs[both]]).any(axis=1))),
        }
    )


def test_matches_are_those_of_the_rule(client):
    """Bodies that come, go, change their order or their hull; pairs that are named twice.

    Catches a pair that is matched with A and B mixed up, ids of the other hull, an old point that
    is taken twice, and a match by distance of a point that has a match by id.
    """
    rng = np.random.default_rng(51)
    hulls = client.register(shapes())
    seen: Counter[str] = Counter()
    for case in range(120):
        positions, rotations, kinds = heap(rng, hulls, 7)
        order = rng.permutation(7)[:6] if case % 3 else np.arange(7)
        by = 10 ** rng.uniform(-4, -1)
        first = hullcast.Scene(hulls, positions, rotations, body_hulls=kinds)
        chosen = kinds[order]
        if case % 5 == 0:
            chosen[0] = (chosen[0] + 1) % len(hulls)
        moved = positions[order] + rng.normal(0, by, (len(order), 3))
        turned = unit(rotations[order] + rng.normal(0, 0.3 * by, (len(order), 4)))
        second = hullcast.Scene(hulls, moved, turned, body_hulls=chosen)
        if case % 2:
            before, after = client.find(first, **OPTIONS), client.find(second, **OPTIONS)
        else:
            before = client.query(first, rng.integers(7, size=(40, 2)), **OPTIONS)
            after = client.query(second, rng.integers(len(order), size=(40, 2)), **OPTIONS)
        seen += compare(before, after, order.tolist() if case % 3 else None)
    for name, least in (("by id", 500), ("new", 500), ("ended", 100), ("turned", 50)):
        assert seen[name] > least, seen


def test_points_whose_features_change_match_by_distance(client):
    """Prisms of 64 sides that turn on each other: the edges that cross change all the time.

    The bodies also move together, by more than the limit. Catches a distance in the world's frame,
    in which all points have moved, a limit by the wrong hull's radius, and an order of the pairs
    that is not by distance.
    """
    rng = np.random.default_rng(52)
    hulls = client.register([hullcast.prism(64, r, 0.4) for r in (0.5, 0.5003)])
    seen: Counter[str] = Counter()
    for _ in range(10):
        angle = rng.uniform(0, 2 * np.pi)
        drift, answers = rng.normal(0, 0.2, 3), []
        for turn in (angle, angle + rng.normal(0, 0.02)):
            rotations = [[0, 0, np.sin(turn / 2), np.cos(turn / 2)], [0, 0, 0, 1]]
            positions = np.array([[0, 0, 0], [*rng.normal(0, 0.003, 2), 0.4]])
            positions += drift * len(answers)
            answers.append(client.find(hullcast.Scene(hulls, positions, rotations), **OPTIONS))
        seen += compare(*answers, None)
    for name in ("by distance", "by id", "new"):
        assert seen[name] > 100, seen


def test_many_points_are_compared_in_parts(client, monkeypatch):
    """Catches a match that is lost where one part of the comparisons ends."""
    hulls = client.register([hullcast.prism(64, 0.5, 0.4)] * 2)
    answers = [
        client.find(
            hullcast.Scene(
                hulls,
                [[0, 0, 0], [0, 0, 0.4]],
                [[0, 0, 0, 1], [0, 0, np.sin(turn), np.cos(turn)]],
            ),
            **OPTIONS,
        )
        for turn in (0.01, 0.035)
    ]
    assert min(int(m.point_counts[0]) for m in answers) >= 64
    whole = hullcast.match(*answers)
    for parts in (1, 100, 1000):
        monkeypatch.setattr(_matching, "_AT_ONCE", parts)
        assert hullcast.match(*answers).previous_points.tolist() == whole.previous_points.tolist()
    compare(*answers, None)


def test_an_answer_matches_itself(client):
    """The identity, and what is shown; and matches of no pairs."""
    hulls = client.register([CUBE] * 2)
    scene = hullcast.Scene(hulls, [[0, 0, 0], [0, 0, 0.9]], [[0, 0, 0, 1]] * 2)
    m = client.find(scene, **OPTIONS)
    found = hullcast.match(m, m)
    assert found.previous_pairs.tolist() == [0]
    assert found.previous_points.tolist() == [0, 1, 2, 3]
    assert repr(found) == "Matches(1 pair of before, 0 new, 0 ended; 4 points of before)"
    none = client.find(scene.moved([[0, 0, 0], [0, 0, 9]], scene.rotations), **OPTIONS)
    assert hullcast.match(m, none).ended_pairs.tolist() == [[0, 1]]
    assert hullcast.match(none, m).previous_points.tolist() == [-1] * 4
    assert len(hullcast.match(none, none).previous_pairs) == 0


def test_what_match_needs(client, tmp_path):
    """Catches an AttributeError for an answer that lacks something, and a scene without radii."""
    hulls = client.register([CUBE] * 2)
    turns = [[0, 0, 0, 1]] * 2
    scene = hullcast.Scene(hulls, [[0, 0, 0], [0, 0, 0.9]], turns)
    m = client.find(scene, **OPTIONS)
    with pytest.raises(hullcast.OutputNotAsked, match="FEATURES"):
        hullcast.match(m, client.find(scene))
    m.save(tmp_path / "m.npz")
    with pytest.raises(hullcast.InvalidArgument, match="NO_SCENE: before"):
        hullcast.match(hullcast.Manifolds.load(tmp_path / "m.npz"), m)
    three = hullcast.Scene(hulls, np.zeros((3, 3)), [turns[0]] * 3, body_hulls=[0, 1, 0])
    more = client.find(three, **OPTIONS)
    with pytest.raises(hullcast.InvalidArgument, match="MISSING_ARGUMENT: previous: missing"):
        hullcast.match(m, more)
    for wrong, reason in (
        ([0], "WRONG_SHAPE"), ([0, 2], "INDEX_OUT_OF_RANGE"), ([-2, 0], "INDEX_OUT_OF_RANGE"),
        ([1, 1], "REPEATED_INDEX"), ([0.0, 1.0], "NOT_INTEGERS"), ("x", "NOT_AN_ARRAY"),
    ):  # fmt: skip
        with pytest.raises(hullcast.InvalidArgument) as caught:
            hullcast.match(m, m, previous=wrong)
        assert (caught.value.reason, caught.value.field) == (reason, "previous")
    # Radii are only needed for points that do not match by their ids.
    by_id = hullcast.Scene([hull.id for hull in hulls], scene.positions, turns)
    other = client.find(by_id, **OPTIONS)
    assert hullcast.match(m, other).previous_pairs.tolist() == [0]
    turned = by_id.moved(by_id.positions, [turns[0], [0, 0, np.sin(0.01), np.cos(0.01)]])
    with pytest.raises(hullcast.InvalidArgument, match="NO_RADIUS"):
        hullcast.match(m, client.find(turned, **OPTIONS))
    # A pickled scene keeps its radii, and one of an older version has none.
    again = pickle.loads(pickle.dumps(scene))
    assert again.radii == scene.radii
    state = dict(scene.__dict__)
    del state["radii"]
    old = hullcast.Scene.__new__(hullcast.Scene)
    old.__setstate__(state)
    assert old.radii == (None,)

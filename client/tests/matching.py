"""The rule of matches, once more as plain loops: the reference for columns and `hullcast.match`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

import hullcast

LIVE = (hullcast.Outcome.CONTACT, hullcast.Outcome.UNDECIDED)
#: The largest distance of two points that match, as a fraction of the smaller circumradius.
NEAR = 0.02


class Expected(NamedTuple):
    """The matches that the rule demands."""

    pairs: list[int]
    points: list[int]
    ended: list[list[int]]
    #: The numbers of points that matched by id and by distance, and of those that did not.
    by_id: int
    by_distance: int
    new: int


def matches(
    before: hullcast.Manifolds,
    after: hullcast.Manifolds,
    radii: Sequence[float],
    previous: Sequence[int] | None = None,
) -> Expected:
    """Compares two answers by the rule, row by row and point by point.

    `radii` are the circumradii of the bodies of `after`. `previous` has for each body of `after`
    its index in the scene of `before`, or -1; by default the bodies are the same.
    """
    assert before.scene is not None
    assert after.scene is not None
    bodies = range(len(after.scene)) if previous is None else previous
    was = [old if old >= 0 and same_hull(before, after, old, new) else -1
           for new, old in enumerate(bodies)]  # fmt: skip
    used: set[int] = set()
    pairs: list[int] = []
    points: list[int] = []
    by_id = by_distance = new = 0
    old_bodies, old_live = before.pairs.tolist(), [o in LIVE for o in before.outcome.tolist()]
    rows_of: dict[frozenset[int], list[int]] = {}
    for row, both in enumerate(old_bodies):
        rows_of.setdefault(frozenset(both), []).append(row)
    for row, (a, b) in enumerate(after.pairs.tolist()):
        found = -1
        if after.outcome[row] in LIVE and was[a] >= 0 and was[b] >= 0:
            for old in rows_of.get(frozenset((was[a], was[b])), []):
                if old_live[old] and old not in used:
                    found = old
                    break
        pairs.append(found)
        used.add(found)
        taken = of_row(before, after, found, row, radii, was) if found >= 0 else ({}, {})
        count = int(after.point_counts[row])
        for k in range(count):
            place = taken[0].get(k, taken[1].get(k))
            points.append(-1 if place is None else int(before.point_offsets[found]) + place)
        by_id, by_distance = by_id + len(taken[0]), by_distance + len(taken[1])
        new += count - len(taken[0]) - len(taken[1])
    ended = [both for row, both in enumerate(old_bodies) if old_live[row] and row not in used]
    return Expected(pairs, points, ended, by_id, by_distance, new)


def same_hull(before: hullcast.Manifolds, after: hullcast.Manifolds, old: int, new: int) -> bool:
    a, b = before.scene, after.scene
    assert a is not None
    assert b is not None
    return a.hull_ids[a.body_hulls[old]] == b.hull_ids[b.body_hulls[new]]


def of_row(
    before: hullcast.Manifolds,
    after: hullcast.Manifolds,
    old: int,
    new: int,
    radii: Sequence[float],
    was: Sequence[int],
) -> tuple[dict[int, int], dict[int, int]]:
    """The matches of one row's points, by id and by distance, counted from the row's first."""
    a, b = after.pairs[new].tolist()
    turned = before.pairs[old].tolist() != [was[a], was[b]]
    theirs, ours = range(int(before.point_counts[old])), range(int(after.point_counts[new]))
    first, second = int(before.point_offsets[old]), int(after.point_offsets[new])
    ids = [before.point_ids[first + j].tolist() for j in theirs]
    ids = [i[2:] + i[:2] for i in ids] if turned else ids
    by_id: dict[int, int] = {}
    for i in ours:
        for j in theirs:
            if j not in by_id.values() and ids[j] == after.point_ids[second + i].tolist():
                by_id[i] = j
                break
    left = [(i, j) for i in ours if i not in by_id for j in theirs if j not in by_id.values()]
    near = []
    for i, j in left:
        moves = []
        for side, body in enumerate((a, b)):
            witness = witness_of(before, old, first + j, side ^ turned)
            here = witness_of(after, new, second + i, side)
            old_place = in_body(before.scene, was[body], witness)
            place = in_body(after.scene, body, here)
            x, y, z = (a - b for a, b in zip(place, old_place, strict=True))
            moves.append(math.sqrt(x * x + y * y + z * z))
        if max(moves) <= NEAR * min(radii[a], radii[b]):
            near.append((max(moves), i, j))
    by_distance: dict[int, int] = {}
    for _, i, j in sorted(near):
        if i not in by_distance and j not in by_distance.values():
            by_distance[i] = j
    return by_id, by_distance


def witness_of(m: hullcast.Manifolds, row: int, point: int, side: int) -> np.ndarray:
    """The witness on A (side 0) or B, in the world frame."""
    return m.witness_a[point] + side * m.distance[point] * m.normal[row]


def in_body(scene: hullcast.Scene | None, body: int, point: np.ndarray) -> list[float]:
    """A world point in the frame of a body's hull."""
    assert scene is not None
    x, y, z, w = scene.rotations[body].tolist()
    twice = 2 / (x * x + y * y + z * z + w * w)
    xs, ys, zs = x * twice, y * twice, z * twice
    matrix = [
        [1 - (y * ys + z * zs), x * ys - w * zs, x * zs + w * ys],
        [x * ys + w * zs, 1 - (x * xs + z * zs), y * zs - w * xs],
        [x * zs - w * ys, y * zs + w * xs, 1 - (x * xs + y * ys)],
    ]
    offset = (point - scene.positions[body]).tolist()
    return [sum(matrix[i][k] * offset[i] for i in range(3)) for k in range(3)]

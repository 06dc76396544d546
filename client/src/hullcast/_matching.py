"""Matches two answers: finds the pairs and points of the second that were there in the first.

The rule is that of the server's output MATCHES (docs/sessions.md):

1. Only CONTACT and UNDECIDED rows match. Rows of the same two bodies match in order, whichever of
   the bodies is A.
2. Within two rows that match, points with the same id match, in order.
3. The points that are left there match by their distance: pairs of a new and an old point are
   taken by ascending distance, then by the new and the old index. The distance is the larger of
   the witnesses' moves on A, in A's frame, and on B, in B's frame. It is at most `NEAR` times the
   smaller circumradius.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _arguments, _arrays
from ._arguments import counted
from ._arrays import Floats, Indices
from ._errors import InvalidArgument
from ._manifolds import Manifolds
from ._matches import Rows, live_rows, within_rows
from ._scene import Scene

#: The largest distance of two points that match by distance, as a fraction of the smaller
#: circumradius of the two hulls.
NEAR = 0.02


@dataclass(frozen=True)
class Matches:
    """The pairs and points of an answer that were there in an earlier one; see `match`."""

    #: (n,): the row that each pair had in the earlier answer; -1 if it had none.
    previous_pairs: npt.NDArray[np.int64]
    #: (p,): the row that each point had among the earlier answer's points; -1 if it had none.
    previous_points: npt.NDArray[np.int64]
    #: (k, 2): the pairs that were in contact or undecided before, and are not now; the body indices
    #: are those of the earlier answer's scene.
    ended_pairs: Indices

    def __repr__(self) -> str:
        stayed = int(np.count_nonzero(self.previous_pairs >= 0))
        points = int(np.count_nonzero(self.previous_points >= 0))
        new = len(self.previous_pairs) - stayed
        return (
            f"Matches({counted(stayed, 'pair')} of before, {new} new, {len(self.ended_pairs)} "
            f"ended; {counted(points, 'point')} of before)"
        )


def match(before: Manifolds, after: Manifolds, *, previous: Any = None) -> Matches:
    """Finds the pairs and points of an answer that were there in an earlier answer.

    The result is that of a session's output MATCHES, for answers of any calls: of `query`, of
    `find`, or of a session that lost its server in between.

        found = hullcast.match(before, after)
        impulses = np.concatenate([impulses, np.zeros((1, 3))])[found.previous_points]

    Args:
        before, after: the answers, with the outputs NORMAL, POINTS and FEATURES, and with their
            scenes, made with `Hull` objects.
        previous: (n,) integers: for each body of `after` its index in the scene of `before`, or -1
            for a new one; as for `Session.update`. By default both scenes have the same bodies. A
            body whose hull has changed is a new one.

    Raises:
        InvalidArgument: an argument is not usable; the error names it. NO_SCENE, an answer that was
            loaded from a file has no scene; NO_RADIUS, a scene has only the id of a hull.
        OutputNotAsked: an answer lacks one of the outputs.
    """
    for name, answer in (("before", before), ("after", after)):
        _arguments.instance(name, answer, Manifolds, "hullcast.Manifolds")
        if answer.scene is None:
            raise InvalidArgument(
                "an answer that was loaded from a file has no scene: assign its scene to the "
                "attribute scene",
                reason="NO_SCENE",
                field=name,
            )
    old, new = before.scene, after.scene
    assert old is not None
    assert new is not None
    was = _bodies_before(old, new, previous)
    pairs, is_turned = _pairs(before, after, was)
    ended = live_rows(before.outcome.view(np.ndarray))
    ended[pairs[pairs >= 0]] = False
    points = _points(before, after, pairs, is_turned, was)
    return Matches(pairs, points, before.pairs[ended])


def _bodies_before(old: Scene, new: Scene, previous: Any) -> Rows:
    """(bodies,): the index of each body in the old scene; -1 if it is new or has another hull."""
    if previous is None:
        if len(old) != len(new):
            raise InvalidArgument(
                f"missing: the scenes have {counted(len(old), 'body', 'bodies')} and "
                f"{counted(len(new), 'body', 'bodies')}; expected the index that each body of the "
                "second had in the first, or -1",
                reason="MISSING_ARGUMENT",
                field="previous",
            )
        was = np.arange(len(new))
    else:
        of = f"the scene of before has {counted(len(old), 'body', 'bodies')}"
        was = _arrays.rows("previous", previous, len(new), len(old), of)
    place = {id: i for i, id in enumerate(old.hull_ids)}
    hulls = np.array([place.get(id, -1) for id in new.hull_ids], dtype=np.int64)
    known = np.flatnonzero(was >= 0)
    other = old.body_hulls[was[known]] != hulls[new.body_hulls[known]]
    was[known[other]] = -1
    return was


def _pairs(before: Manifolds, after: Manifolds, was: Rows) -> tuple[Rows, npt.NDArray[np.bool_]]:
    """The row before of each row, or -1; and whether A and B have changed places since."""
    both = was[after.pairs]
    live = live_rows(after.outcome.view(np.ndarray)) & (both >= 0).all(axis=1)
    theirs = np.flatnonzero(live_rows(before.outcome.view(np.ndarray)))
    ours = np.flatnonzero(live)
    old = before.pairs[theirs].astype(np.int64)
    found = np.full(len(after), -1, dtype=np.int64)
    found[ours] = _first_of_same(np.sort(old, axis=1), np.sort(both[ours], axis=1), theirs)
    matched = found >= 0
    is_turned = np.zeros(len(after), dtype=bool)
    is_turned[matched] = (before.pairs[found[matched]] != both[matched]).any(axis=1)
    return found, is_turned


def _first_of_same(old: npt.NDArray[Any], new: npt.NDArray[Any], rows: Rows) -> Rows:
    """For each of the `new` keys (n, k) the row of the equal `old` key, or -1.

    If a key is there several times, the first matches the first, the second the second, and so on.
    """
    keys = np.concatenate([old, new])
    if len(keys) == 0:
        return np.zeros(0, dtype=np.int64)
    _, number = np.unique(keys, axis=0, return_inverse=True)
    number = number.reshape(-1)
    # With its count among equal keys before it, each key is there at most once on each side.
    keyed = [_with_count(part) for part in (number[: len(old)], number[len(old) :])]
    most = max((int(count.max(initial=0)) for _, count in keyed), default=0) + 1
    theirs, ours = (part * most + count for part, count in keyed)
    order = np.argsort(theirs)
    place = np.searchsorted(theirs, ours, sorter=order)
    place = order[np.minimum(place, len(order) - 1)] if len(order) else place
    found = np.full(len(new), -1, dtype=np.int64)
    if len(order):
        same = theirs[place] == ours
        found[same] = rows[place[same]]
    return found


def _with_count(keys: npt.NDArray[np.intp]) -> tuple[Rows, Rows]:
    """The keys, and how many equal ones are before each."""
    order = np.argsort(keys, kind="stable")
    ascending = keys[order]
    first = np.ones(len(keys), dtype=bool)
    first[1:] = ascending[1:] != ascending[:-1]
    starts = np.maximum.accumulate(np.where(first, np.arange(len(keys)), 0))
    count = np.empty(len(keys), dtype=np.int64)
    count[order] = np.arange(len(keys)) - starts
    return keys.astype(np.int64), count


def _points(
    before: Manifolds,
    after: Manifolds,
    pairs: Rows,
    is_turned: npt.NDArray[np.bool_],
    was: Rows,
) -> Rows:
    """The point before of each point, or -1."""
    row = np.repeat(np.arange(len(after)), after.point_counts)
    found = np.full(len(row), -1, dtype=np.int64)
    # The points of the rows before, in the order of the rows that match them.
    matched = np.flatnonzero(pairs >= 0)
    counts = before.point_counts[pairs[matched]].astype(np.int64)
    theirs = np.repeat(before.point_offsets[pairs[matched]], counts) + within_rows(counts)
    their_row = np.repeat(matched, counts)
    ids = before.point_ids[theirs]
    turn = is_turned[their_row]
    ids[turn] = np.roll(ids[turn], 2, axis=1)
    ours = np.flatnonzero(pairs[row] >= 0)
    found[ours] = _first_of_same(
        np.column_stack([their_row, ids]),
        np.column_stack([row[ours], after.point_ids[ours]]),
        theirs,
    )
    left = ours[found[ours] < 0]
    free = np.ones(int(before.point_offsets[-1]), dtype=bool)
    free[found[ours][found[ours] >= 0]] = False
    still = free[theirs]
    theirs, their_row = theirs[still], their_row[still]
    if len(left) and len(theirs):
        _match_nearest(before, after, found, left, row[left], theirs, their_row, is_turned, was)
    return found


#: The number of pairs of an old and a new point that are compared at once, which bounds the memory.
_AT_ONCE = 1 << 18


def _match_nearest(
    before: Manifolds,
    after: Manifolds,
    found: Rows,
    ours: Rows,
    our_row: Rows,
    theirs: Rows,
    their_row: Rows,
    is_turned: npt.NDArray[np.bool_],
    was: Rows,
) -> None:
    """Matches points by their distance, and enters the matches in `found`.

    Args:
        before, after: the answers.
        found: (p,): the point before of each point of `after`, or -1.
        ours, theirs: the points of `after` and of `before` that are left, ascending by row.
        our_row, their_row: their rows in `after`.
        is_turned: for each row of `after`, whether A and B have changed places since.
        was: for each body of `after` its index in the scene of `before`.
    """
    here = _in_frames(after, ours, after.pairs[our_row], np.zeros(len(ours), dtype=bool))
    there = _in_frames(before, theirs, was[after.pairs[their_row]], is_turned[their_row])
    assert after.scene is not None
    radii = _radii(after.scene)[after.scene.body_hulls]
    reach = NEAR * radii[after.pairs[our_row]].min(axis=1)
    first = np.searchsorted(their_row, our_row, side="left")
    counts = np.searchsorted(their_row, our_row, side="right") - first
    ends = np.cumsum(counts)
    near: list[tuple[Floats, Rows, Rows]] = []
    start = 0
    while start < len(ours):
        done = int(ends[start - 1]) if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + _AT_ONCE, side="right")))
        some = np.arange(start, stop)
        new = np.repeat(some, counts[some])
        old = np.repeat(first[some], counts[some]) + within_rows(counts[some])
        moves = here[new] - there[old]
        x, y, z = np.moveaxis(moves, -1, 0)
        distance = np.sqrt(x * x + y * y + z * z).max(axis=1)
        kept = distance <= reach[new]
        near.append((distance[kept], new[kept], old[kept]))
        start = stop
    distance, new, old = (np.concatenate(parts) for parts in zip(*near, strict=True))
    order = np.lexsort((old, new, distance))
    new, old = new[order], old[order]
    is_used = np.zeros(len(ours), dtype=bool), np.zeros(len(theirs), dtype=bool)
    while len(new):
        # A pair that is the first one of both its points is taken whatever happens before it. So
        # all such pairs are taken at once. The first pair of all is one of them.
        first_new, first_old = (np.unique(p, return_index=True)[1] for p in (new, old))
        taken = np.intersect1d(first_new, first_old)
        found[ours[new[taken]]] = theirs[old[taken]]
        is_used[0][new[taken]] = is_used[1][old[taken]] = True
        free = ~is_used[0][new] & ~is_used[1][old]
        new, old = new[free], old[free]


def _in_frames(
    answer: Manifolds, points: Rows, bodies: npt.NDArray[Any], is_turned: npt.NDArray[np.bool_]
) -> Floats:
    """(points, 2, 3): the witnesses on A and on B, each in its body's frame.

    Args:
        answer: the answer that has the points.
        points: rows of its columns of points.
        bodies: (points, 2): the bodies A and B, by the scene of the answer.
        is_turned: whether A is the body that the answer calls B.
    """
    scene = answer.scene
    assert scene is not None
    # The operations are those of the server, in its order, so that equal distances are equal here.
    of = np.repeat(np.arange(len(answer)), answer.point_counts)[points]
    on_a = answer.witness_a[points]
    on_b = on_a + answer.distance[points, None] * answer.normal[of]
    witnesses = np.stack([on_a, on_b], axis=1)
    witnesses[is_turned] = witnesses[is_turned][:, ::-1]
    x, y, z, w = np.moveaxis(scene.rotations[bodies], -1, 0)
    twice = 2 / (x * x + y * y + z * z + w * w)
    xs, ys, zs = x * twice, y * twice, z * twice
    offset = np.moveaxis(witnesses - scene.positions[bodies], -1, 0)
    columns = (
        (1 - (y * ys + z * zs), x * ys + w * zs, x * zs - w * ys),
        (x * ys - w * zs, 1 - (x * xs + z * zs), y * zs + w * xs),
        (x * zs + w * ys, y * zs - w * xs, 1 - (x * xs + y * ys)),
    )
    parts = [a * offset[0] + b * offset[1] + c * offset[2] for a, b, c in columns]
    return np.stack(parts, axis=-1)


def _radii(scene: Scene) -> Floats:
    """The circumradius of each hull of a scene."""
    if None in scene.radii:
        raise InvalidArgument(
            f"the scene has hull {scene.radii.index(None)} only as an id, so that its radius is "
            "not known: make the scene with the Hull objects of client.register",
            reason="NO_RADIUS",
            field="scene",
        )
    return np.array(scene.radii, dtype=np.float64)

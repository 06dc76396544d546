"""The columns that compare an answer of a stream with the answer before it.

On the wire a row or point without a predecessor has 2^32 - 1, and a point is counted from the first
point of its row. In a result it is -1, and a point is counted from the first point of the whole
answer, so that it indexes the columns of points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ._arrays import Indices
from ._checked import Columns, malformed
from ._wire import NONE, Outcome

#: Indices of rows, points or bodies, with -1 for none.
Rows = npt.NDArray[np.int64]


def live_rows(outcomes: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """(rows,): whether a row may have a predecessor and a successor: CONTACT and UNDECIDED rows."""
    return (outcomes == int(Outcome.CONTACT)) | (outcomes == int(Outcome.UNDECIDED))


def within_rows(counts: npt.NDArray[Any]) -> Rows:
    """(points,): each point's place among the points of its row. `counts` are integers."""
    ends = np.cumsum(counts, dtype=np.int64)
    return np.arange(int(ends[-1]) if len(ends) else 0) - np.repeat(ends - counts, counts)


@dataclass(frozen=True)
class Live:
    """The part of an answer that the check of the next answer's matches needs."""

    #: (rows,): whether a row may have a successor.
    rows: npt.NDArray[np.bool_]
    #: (rows,): the number of points of each row.
    counts: Indices
    #: The number of bodies of the message.
    bodies: int

    @classmethod
    def of(cls, columns: Columns, bodies: int) -> Live:
        """The part of these columns, copied: a caller may change a result."""
        return cls(live_rows(columns["outcomes"]), columns["point_counts"].copy(), bodies)


def check(found: Columns, before: Live | None) -> None:
    """Raises if matches are out of range, repeated, or of rows that cannot match.

    Args:
        found: the columns of one answer, with those of matches as on the wire.
        before: of the answer before it; None if the stream has begun anew.

    Raises:
        ServerError: MALFORMED_ANSWER.
    """
    pairs, points = found["previous_pairs"], found["previous_points"]
    ended = found["ended_pairs"]
    matched, same = pairs != NONE, points != NONE
    if before is None:
        if matched.any() or same.any() or len(ended):
            raise malformed("the first answer of a stream has matches with an answer before it")
        return
    if len(ended) and int(ended.max()) >= before.bodies:
        raise malformed(f"ended_pairs has body {ended.max()}, expected less than {before.bodies}")
    rows = pairs[matched]
    if len(rows) and int(rows.max()) >= len(before.rows):
        raise malformed(f"previous_pairs has {rows.max()}, expected less than {len(before.rows)}")
    if not before.rows[rows].all() or (matched & ~live_rows(found["outcomes"])).any():
        raise malformed("previous_pairs matches a row that is not CONTACT or UNDECIDED")
    if (np.bincount(rows, minlength=1) > 1).any():
        raise malformed("previous_pairs has a row twice")
    own = np.repeat(pairs, found["point_counts"])[same]
    if (own == NONE).any():
        raise malformed("previous_points matches a point of a row that has no predecessor")
    places = points[same]
    if (places >= before.counts[own]).any():
        raise malformed("previous_points has a point that the row before it does not have")
    starts = np.cumsum(before.counts, dtype=np.int64) - before.counts
    if (np.bincount(starts[own] + places, minlength=1) > 1).any():
        raise malformed("previous_points has a point twice")


def identical(columns: Columns) -> Columns:
    """The columns of matches, as on the wire, of an answer that is equal to the one before it."""
    live, counts = live_rows(columns["outcomes"]), columns["point_counts"]
    return {
        "previous_pairs": np.where(live, np.arange(len(live)), NONE).astype("<u4"),
        "previous_points": np.where(np.repeat(live, counts), within_rows(counts), NONE).astype(
            "<u4"
        ),
        "ended_pairs": np.zeros((0, 2), dtype="<u4"),
    }


def placed(columns: Columns, rows: Rows, offsets: Rows) -> Columns:
    """The columns with their matches as rows and points of a whole answer.

    Args:
        columns: the answer of one stream, with matches as on the wire.
        rows: (rows before,): the place of each row of the stream's answer before, in the whole
            answer before.
        offsets: the first point of each row of the whole answer before.
    """
    raw = columns["previous_pairs"]
    matched = raw != NONE
    pairs = np.full(len(raw), -1, dtype=np.int64)
    pairs[matched] = rows[raw[matched]]
    raw = columns["previous_points"]
    same = raw != NONE
    points = np.full(len(raw), -1, dtype=np.int64)
    own = np.repeat(pairs, columns["point_counts"])
    points[same] = offsets[own[same]] + raw[same]
    return {**columns, "previous_pairs": pairs, "previous_points": points}

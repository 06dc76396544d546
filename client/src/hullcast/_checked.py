"""Checks of a server's answers, before anything of an answer is used.

A server of another make, a proxy or a cache may send an answer to another request, or columns that
do not fit together. Each defect is a `ServerError` with the reason MALFORMED_ANSWER. The command
line makes the same checks (`src/cli/checked.rs`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from google.protobuf.message import DecodeError

from ._arrays import Floats, Indices
from ._errors import ServerError
from ._hulls import Content
from ._wire import FeatureKind, Flag, Outcome

T = TypeVar("T")
Columns = dict[str, np.ndarray]

_HULL_REASONS = Flag.UNKNOWN_HULL | Flag.HULL_UNAVAILABLE
#: The flags that explain why a pair is INVALID.
_REASONS = _HULL_REASONS | Flag.INVALID_BODY
#: The bits of the flags that this version does not know.
_UNKNOWN_FLAGS = 0xFF & ~sum(Flag)
#: A normal's squared length may differ from 1 by this much.
_NORMAL_ERROR = 1e-6
#: Columns of which every number is finite.
_FINITE_OF_POINT = ("witness_as", "distances", "witness_bs")


def malformed(text: str) -> ServerError:
    """The error for an answer that no correct server gives."""
    return ServerError(f"the server's answer is malformed: {text}", reason="MALFORMED_ANSWER")


def parsed(read: Callable[[bytes], T], data: Any) -> T:
    """A message of these bytes.

    Raises:
        ServerError: MALFORMED_ANSWER, they are no such message.
    """
    if not isinstance(data, bytes):
        raise malformed(f"it is an object of type {type(data).__name__}")
    try:
        return read(data)
    except DecodeError as error:
        raise malformed(f"it is not a protobuf message of the expected type ({error})") from None


def request_id(found: int, sent: int) -> None:
    """Refuses the answer to another request."""
    if found != sent:
        raise malformed(f"request_id is {found}, expected {sent}: it answers another request")


def length(name: str, found: int, expected: int) -> None:
    """Refuses a column of another length."""
    if found != expected:
        raise malformed(f"{name} has {found} entries, expected {expected}")


def ascending(name: str, column: Indices, count: int) -> None:
    """Refuses indices that are out of range, or not each above the one before."""
    if len(column) == 0:
        return
    if int(column.max()) >= count:
        raise malformed(f"{name} has {column.max()}, but the request has {count}")
    if (np.diff(column.astype(np.int64)) <= 0).any():
        raise malformed(f"{name} is not ascending")


def columns(found: Columns, pairs: Indices, body_hulls: Indices) -> None:
    """Refuses values that no pair has, or that contradict each other.

    Args:
        found: the columns of one message, each of its length.
        pairs: (n, 2), the pairs that it answers.
        body_hulls: of each body, its index among the hulls, in the numbering of the message.
    """
    outcomes, flags = found["outcomes"], found["flags"]
    low, high = int(Outcome.CONTACT), int(Outcome.INVALID)
    _refuse("outcomes", outcomes, (outcomes < low) | (outcomes > high), f"{low} to {high}")
    invalid = outcomes == high
    blamed = (flags & int(_REASONS)) != 0
    some_invalid = bool(invalid.any())
    if some_invalid or blamed.any():
        unexplained = invalid & ~blamed & ((flags & _UNKNOWN_FLAGS) == 0)
        _refuse("flags", flags, (blamed & ~invalid) | unexplained, "flags that fit the outcome")
    if some_invalid or len(found["invalid_bodies"]) or len(found["missing_hulls"]):
        _refuse("flags", flags, _misplaced(found, pairs, body_hulls), "flags that fit the lists")
    _numbers(found, invalid, some_invalid)
    counts = found.get("point_counts")
    if counts is not None:
        answered = (outcomes == int(Outcome.CONTACT)) | (outcomes == int(Outcome.UNDECIDED))
        _refuse("point_counts", counts, (counts > 0) & ~answered, "0 for this outcome")
    for name in _FINITE_OF_POINT:
        if name in found and not np.isfinite(found[name]).all():
            _refuse(name, found[name], ~np.isfinite(found[name]), "a finite number")
    kinds = found.get("feature_kinds")
    if kinds is not None:
        most = int(max(FeatureKind))
        _refuse("feature_kinds", kinds, kinds > most, f"0 to {most}")


def _numbers(found: Columns, invalid: npt.NDArray[np.bool_], some_invalid: bool) -> None:
    """Refuses numbers that are NaN, out of order or of a wrong length."""

    def refuse(name: str, good: npt.NDArray[np.bool_], expected: str) -> None:
        if some_invalid:
            good = good | invalid
        if not good.all():
            _refuse(name, found[name], ~good, expected)

    alpha = found.get("alphas")
    if alpha is not None:
        lower, upper = found["alpha_lowers"], found["alpha_uppers"]
        # Comparisons with NaN are false.
        inside = (lower >= 0) & (lower <= alpha) & (alpha <= upper) & (alpha < np.inf)
        refuse("alphas", inside, "a number inside its bracket")
    if "separations" in found:
        refuse("separations", np.isfinite(found["separations"]), "a finite number")
        normals = found["normals"]
        with np.errstate(over="ignore", invalid="ignore"):
            squared = np.einsum("ni,ni->n", normals, normals)
            refuse("normals", np.abs(squared - 1) <= _NORMAL_ERROR, "a unit vector")
    kept = found.get("kept_areas")
    if kept is not None and not np.isnan(kept).all():  # an older server does not send the column
        refuse("kept_areas", (kept >= 0) & (kept <= 1), "0 to 1")


def _misplaced(found: Columns, pairs: Indices, body_hulls: Indices) -> npt.NDArray[np.bool_]:
    """Pairs whose flags contradict `invalid_bodies` or `missing_hulls`."""
    flags = found["flags"]
    unusable = np.zeros(len(body_hulls), dtype=bool)
    unusable[found["invalid_bodies"]] = True
    lacking = np.isin(body_hulls, found["missing_hulls"])
    wrong = unusable[pairs].any(axis=1) != ((flags & int(Flag.INVALID_BODY)) != 0)
    return wrong | (((flags & int(_HULL_REASONS)) != 0) & ~lacking[pairs].any(axis=1))


def _refuse(name: str, column: np.ndarray, wrong: npt.NDArray[np.bool_], expected: str) -> None:
    if wrong.any():
        at = int(np.flatnonzero(wrong)[0])
        value = column.reshape(len(wrong), -1)[at] if wrong.ndim == 1 else column.flat[at]
        text = value.tolist() if isinstance(value, np.ndarray) else value
        text = text[0] if isinstance(text, list) and len(text) == 1 else text
        raise malformed(f"{name}[{at}] is {text}, expected {expected}")


def found_pairs(
    pairs: Indices, outcomes: npt.NDArray[np.uint8], bodies: int, before: tuple[int, int] | None
) -> tuple[int, int] | None:
    """Refuses pairs of `find` that are out of range, doubled, unsorted or not near.

    Args:
        pairs: (n, 2), of one message.
        outcomes: (n,)
        bodies: how many the scene has.
        before: the last pair of the messages before, if there is one.

    Returns:
        The last pair so far.
    """
    if len(pairs) == 0:
        return before
    if int(pairs.max()) >= bodies:
        raise malformed(f"pairs has body {pairs.max()}, but the scene has {bodies} bodies")
    if (pairs[:, 0] >= pairs[:, 1]).any():
        raise malformed("pairs has a pair whose first body is not the lower one")
    place = pairs[:, 0].astype(np.uint64) << np.uint64(32) | pairs[:, 1]
    first = int(place[0])
    if (place[1:] <= place[:-1]).any() or (
        before is not None and first <= (before[0] << 32 | before[1])
    ):
        raise malformed("pairs is not sorted, or has a pair twice")
    near = (outcomes == int(Outcome.CONTACT)) | (outcomes == int(Outcome.UNDECIDED))
    _refuse("outcomes", outcomes, ~near, "CONTACT or UNDECIDED from FindContacts")
    return int(pairs[-1, 0]), int(pairs[-1, 1])


def result_kind(place: int, kind: str | None) -> None:
    """Refuses a registration's result that is neither a hull nor an error."""
    if kind is None:
        raise malformed(f"results[{place}] is neither a hull nor an error")


def hull(place: int, info: Any, content: Content | None) -> None:
    """Refuses a hull's record whose numbers no hull has.

    Args:
        place: the hull's index in the call.
        info: a `HullInfo`.
        content: the content that was registered; None if it is not known.
    """
    name = f"hulls[{place}]"
    if content is not None and info.id != content.identity:
        raise malformed(f"the id of {name} is not the hash of the hull's content")
    if len(info.id) != 32:
        raise malformed(f"{name}.id has {len(info.id)} bytes, expected 32")
    for field, count in (("contraction_point", 3), ("center_of_mass", 3), ("inertia", 6)):
        values = np.array(getattr(info, field), dtype=float)
        length(f"{name}.{field}", len(values), count)
        if not np.isfinite(values).all():
            raise malformed(f"{name}.{field} is {values.tolist()}, expected finite numbers")
    for field in ("volume", "inradius"):
        value = getattr(info, field)
        if not 0 <= value < np.inf or (field == "inradius" and value == 0):
            raise malformed(f"{name}.{field} is {value}, expected a finite number above 0")
    if not info.inradius <= info.circumradius < np.inf:
        raise malformed(f"{name}.circumradius is {info.circumradius}, below the inradius")
    for field in ("geometric_error", "deviation", "planarity"):
        value = getattr(info, field)
        if not 0 <= value < np.inf:
            raise malformed(f"{name}.{field} is {value}, expected a finite number, 0 or more")
    v, e, f = info.vertex_count, info.edge_count, info.face_count
    points = info.registered_count if content is None else len(content.points)
    # Vertices inside merged faces are kept, so that Euler's formula is a bound.
    if v < 4 or f < 4 or e < 6 or v - e + f < 2 or v > points:
        raise malformed(f"{name} has {v} vertices, {e} edges and {f} faces of {points} points")


def echoed(name: str, found: Sequence[bytes], asked: Sequence[bytes]) -> None:
    """Refuses records of other hulls than those asked for."""
    length(name, len(found), len(asked))
    for place, (ours, theirs) in enumerate(zip(asked, found, strict=True)):
        if ours != theirs:
            raise malformed(f"{name}[{place}] is of another hull")


def mesh(name: str, ids: Indices, offsets: Indices, corners: Indices, normals: Floats) -> None:
    """Refuses faces whose corners are none of the hull's vertices."""
    faces = len(offsets) - 1
    if faces < 4 or int(offsets[0]) != 0 or int(offsets[-1]) != len(corners):
        raise malformed(f"{name}.face_offsets does not fit face_vertices")
    if (np.diff(offsets.astype(np.int64)) < 3).any():
        raise malformed(f"{name}.face_offsets has a face of fewer than 3 corners")
    if not np.isin(corners, ids).all():
        raise malformed(f"{name}.face_vertices has a corner that is not a vertex")
    length(f"{name}.face_normals", normals.size, 3 * faces)
    if not np.isfinite(normals).all():
        raise malformed(f"{name}.face_normals has a number that is not finite")

"""Checks a server's response before the client uses any part of it.

A server of another implementation, a proxy or a cache may send the response to another request, or
columns that contradict each other. Every such defect raises `ServerError` with the reason
MALFORMED_ANSWER. The Rust client makes the same checks (`crates/client/src/checked.rs`).
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
#: The flags that explain why a pair's outcome is INVALID.
_REASONS = _HULL_REASONS | Flag.INVALID_BODY
#: The flag bits that this version of the client does not know.
_UNKNOWN_FLAGS = 0xFF & ~sum(Flag)
#: The largest allowed difference between a normal's squared length and 1.
_NORMAL_ERROR = 1e-6
#: The per-point columns in which every number must be finite.
_FINITE_OF_POINT = ("witness_as", "distances", "witness_bs")


def malformed(text: str) -> ServerError:
    """The error for a response that no correct server sends."""
    return ServerError(f"the server's answer is malformed: {text}", reason="MALFORMED_ANSWER")


def parsed(read: Callable[[bytes], T], data: Any) -> T:
    """Parses bytes into a message.

    Raises:
        ServerError: MALFORMED_ANSWER, the bytes are not such a message.
    """
    if not isinstance(data, bytes):
        raise malformed(f"it is an object of type {type(data).__name__}")
    try:
        return read(data)
    except DecodeError as error:
        raise malformed(f"it is not a protobuf message of the expected type ({error})") from None


def request_id(found: int, sent: int) -> None:
    """Raises if a response belongs to another request."""
    if found != sent:
        raise malformed(f"request_id is {found}, expected {sent}: it answers another request")


def length(name: str, found: int, expected: int) -> None:
    """Raises if a column has another length than expected."""
    if found != expected:
        raise malformed(f"{name} has {found} entries, expected {expected}")


def ascending(name: str, column: Indices, count: int) -> None:
    """Raises if indices are not strictly ascending, or not below `count`."""
    if len(column) == 0:
        return
    if int(column.max()) >= count:
        raise malformed(f"{name} has the index {column.max()}, expected less than {count}")
    if (np.diff(column.astype(np.int64)) <= 0).any():
        raise malformed(f"{name} is not ascending")


def columns(found: Columns, pairs: Indices, body_hulls: Indices) -> None:
    """Raises if a pair has impossible values, or values that contradict each other.

    Args:
        found: the columns of one message, whose lengths are already checked.
        pairs: (n, 2), the pairs that the message answers.
        body_hulls: (bodies,), each body's index among the hulls, as the message numbers them.
    """
    values(found)
    flags = found["flags"]
    invalid = found["outcomes"] == int(Outcome.INVALID)
    if invalid.any() or len(found["invalid_bodies"]) or len(found["missing_hulls"]):
        _refuse(
            malformed,
            "flags",
            flags,
            _misplaced(found, pairs, body_hulls),
            "flags that fit the lists",
        )


def values(found: Columns, error: Callable[[str], Exception] = malformed) -> None:
    """Raises if a pair has impossible values, without regard to the scene.

    Args:
        found: the columns of one message or of a file, whose lengths are already checked.
        error: makes the exception from the text.
    """
    outcomes, flags = found["outcomes"], found["flags"]
    low, high = int(Outcome.CONTACT), int(Outcome.INVALID)
    _refuse(error, "outcomes", outcomes, (outcomes < low) | (outcomes > high), f"{low} to {high}")
    invalid = outcomes == high
    blamed = (flags & int(_REASONS)) != 0
    some_invalid = bool(invalid.any())
    if some_invalid or blamed.any():
        unexplained = invalid & ~blamed & ((flags & _UNKNOWN_FLAGS) == 0)
        _refuse(
            error, "flags", flags, (blamed & ~invalid) | unexplained, "flags that fit the outcome"
        )
    _numbers(found, invalid, some_invalid, error)
    counts = found.get("point_counts")
    if counts is not None:
        answered = (outcomes == int(Outcome.CONTACT)) | (outcomes == int(Outcome.UNDECIDED))
        _refuse(error, "point_counts", counts, (counts > 0) & ~answered, "0 for this outcome")
    for name in _FINITE_OF_POINT:
        if name in found and not np.isfinite(found[name]).all():
            _refuse(error, name, found[name], ~np.isfinite(found[name]), "a finite number")
    kinds = found.get("feature_kinds")
    if kinds is not None:
        most = int(max(FeatureKind))
        _refuse(error, "feature_kinds", kinds, kinds > most, f"0 to {most}")
    for name in ("previous_pairs", "previous_points"):
        column = found.get(name)
        if column is not None and column.dtype.kind == "i":  # of a file; on the wire it is unsigned
            _refuse(error, name, column, column < -1, "-1 or more")


def _numbers(
    found: Columns,
    invalid: npt.NDArray[np.bool_],
    some_invalid: bool,
    error: Callable[[str], Exception],
) -> None:
    """Raises if a number is NaN, outside its bracket, or not a unit vector."""

    def refuse(name: str, good: npt.NDArray[np.bool_], expected: str) -> None:
        if some_invalid:
            good = good | invalid
        if not good.all():
            _refuse(error, name, found[name], ~good, expected)

    alpha = found.get("alphas")
    if alpha is not None:
        lower, upper = found["alpha_lowers"], found["alpha_uppers"]
        # A comparison with NaN is false, so NaN is refused too.
        inside = (lower >= 0) & (lower <= alpha) & (alpha <= upper) & (alpha < np.inf)
        refuse("alphas", inside, "a number inside its bracket")
    if "separations" in found:
        refuse("separations", np.isfinite(found["separations"]), "a finite number")
        normals = found["normals"]
        with np.errstate(over="ignore", invalid="ignore"):
            squared = np.einsum("ni,ni->n", normals, normals)
            refuse("normals", np.abs(squared - 1) <= _NORMAL_ERROR, "a unit vector")
    kept = found.get("kept_areas")
    if kept is not None and not np.isnan(kept).all():  # an older server sends no such column
        refuse("kept_areas", (kept >= 0) & (kept <= 1), "0 to 1")
    errors = found.get("gradient_errors")
    if errors is not None:  # NaN for a pair without derivatives
        refuse("gradient_errors", ~(errors < 0), "at least 0")


def _misplaced(found: Columns, pairs: Indices, body_hulls: Indices) -> npt.NDArray[np.bool_]:
    """The pairs whose flags contradict `invalid_bodies` or `missing_hulls`."""
    flags = found["flags"]
    unusable = np.zeros(len(body_hulls), dtype=bool)
    unusable[found["invalid_bodies"]] = True
    lacking = np.isin(body_hulls, found["missing_hulls"])
    wrong = unusable[pairs].any(axis=1) != ((flags & int(Flag.INVALID_BODY)) != 0)
    return wrong | (((flags & int(_HULL_REASONS)) != 0) & ~lacking[pairs].any(axis=1))


def _refuse(
    error: Callable[[str], Exception],
    name: str,
    column: np.ndarray,
    wrong: npt.NDArray[np.bool_],
    expected: str,
) -> None:
    if wrong.any():
        at = int(np.flatnonzero(wrong)[0])
        value = column.reshape(len(wrong), -1)[at] if wrong.ndim == 1 else column.flat[at]
        text = value.tolist() if isinstance(value, np.ndarray) else value
        if np.ndim(text) == 1 and np.size(text) == 1:
            text = text[0]
        raise error(f"{name}[{at}] is {text}, expected {expected}")


def found_pairs(
    pairs: Indices, outcomes: npt.NDArray[np.uint8], bodies: int, before: tuple[int, int] | None
) -> tuple[int, int] | None:
    """Raises if pairs of `find` are out of range, repeated, not sorted, or not near each other.

    Args:
        pairs: (n, 2), the pairs of one message.
        outcomes: (n,), their outcomes.
        bodies: the number of bodies in the scene.
        before: the last pair of the previous messages, or None.

    Returns:
        The last pair so far, or None if there is none.
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
    _refuse(malformed, "outcomes", outcomes, ~near, "CONTACT or UNDECIDED from FindContacts")
    return int(pairs[-1, 0]), int(pairs[-1, 1])


def result_kind(place: int, kind: str | None) -> None:
    """Raises if a registration's result is neither a hull nor an error."""
    if kind is None:
        raise malformed(f"results[{place}] is neither a hull nor an error")


def hull(place: int, info: Any, content: Content | None) -> None:
    """Raises if a hull's record has numbers that no hull can have.

    Args:
        place: the hull's index in the call.
        info: a `HullInfo`.
        content: the content that was registered, or None if it is unknown.
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
    # Euler's formula only holds as a bound, since vertices inside merged faces are kept.
    if v < 4 or f < 4 or e < 6 or v - e + f < 2 or v > points:
        raise malformed(f"{name} has {v} vertices, {e} edges and {f} faces of {points} points")


def echoed(name: str, found: Sequence[bytes], asked: Sequence[bytes]) -> None:
    """Raises if the records are not those of the requested hulls, in order."""
    length(name, len(found), len(asked))
    for place, (ours, theirs) in enumerate(zip(asked, found, strict=True)):
        if ours != theirs:
            raise malformed(f"{name}[{place}] is of another hull")


def mesh(name: str, ids: Indices, offsets: Indices, corners: Indices, normals: Floats) -> None:
    """Raises if a hull's faces are malformed, or have a corner that is not a vertex of the hull."""
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

"""Checks arrays that callers pass and converts them to one form; an error names the argument."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import numpy.typing as npt

from . import _numbers, _tensors
from ._arguments import counted, kind, shown
from ._errors import InvalidArgument

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.uint32]

#: The largest allowed difference, in any entry, between `R^T R` and the identity matrix.
_ROTATION_ERROR = 1e-3

#: The ranges that the server accepts (`crates/contact/src/body.rs`): the largest absolute value of
#: a coordinate, a margin or a number of a motion, and the norm of a quaternion.
LARGEST = 1e100
MIN_NORM, MAX_NORM = 0.25, 4.0


def floats(field: str, value: Any, *shape: int | None) -> Floats:
    """Converts `value` to a contiguous little-endian float64 array of the given shape.

    None in `shape` stands for any length.

    Raises:
        InvalidArgument: NOT_AN_ARRAY or WRONG_SHAPE.
    """
    expected = f"numbers, shape {_wanted(shape)}"
    array = _numbers.doubles(field, _array(field, value, shape), expected, value)
    array = array.reshape(0, *shape[1:]) if array.size == 0 and None not in shape[1:] else array
    _check_shape(field, array, shape)
    return array


def indices(
    field: str, value: Any, *shape: int | None, below: int | None = None, of: str = ""
) -> Indices:
    """Converts `value` to a contiguous little-endian uint32 array of the given shape.

    Args:
        field: the argument's name, for messages.
        value: integers of any type.
        shape: the shape; None stands for any length.
        below: each entry must be less than this; by default 2^32.
        of: states in a message what `below` counts, such as "the scene has 3 bodies".

    Raises:
        InvalidArgument: NOT_AN_ARRAY, NOT_INTEGERS, WRONG_SHAPE or INDEX_OUT_OF_RANGE.
    """
    array = _array(field, value, shape)
    if array.size == 0:
        array = np.zeros((0, *(length or 0 for length in shape[1:])), dtype="<u4")
    # Integers beyond 64 bits are objects; they are out of range.
    if array.dtype.kind not in "iuO" or array.ndim == 0:
        raise InvalidArgument(
            f"expected integers, shape {_wanted(shape)}, got {_numbers.content(array, value)}",
            reason="NOT_INTEGERS",
            field=field,
        )
    _check_shape(field, array, shape)
    limit = 2**32 if below is None else below
    if array.size and (array.min() < 0 or array.max() >= limit):
        wrong = int(np.flatnonzero((array < 0) | (array >= limit))[0])
        allowed = f"0 to {limit - 1}" if limit else "nothing"
        raise _numbers.misplaced(
            field,
            f"{shown(array.flat[wrong])} is out of range: {of or 'expected'}"
            f"{', so that ' if of else ' '}{allowed}{' is allowed' if of else ''}",
            wrong,
            array.shape,
            "INDEX_OUT_OF_RANGE",
        )
    return np.ascontiguousarray(array, dtype="<u4")


def rows(field: str, value: Any, count: int, below: int, of: str) -> npt.NDArray[np.int64]:
    """Converts `value` to `count` distinct indices, -1 for none, as int64.

    Args:
        field: the argument's name, for messages.
        value: integers of any type, -1 to `below` - 1.
        count: the number of entries.
        below: each entry must be less than this.
        of: states in a message what `below` counts, such as "the scene has 3 bodies".

    Raises:
        InvalidArgument: NOT_AN_ARRAY, NOT_INTEGERS, WRONG_SHAPE, INDEX_OUT_OF_RANGE or
            REPEATED_INDEX.
    """
    array = _array(field, value, (count,))
    if array.size and array.dtype.kind in "iu" and array.ndim == 1:
        none = array == -1
        low = np.flatnonzero(array < -1)
        if low.size:
            raise InvalidArgument(
                f"{array[low[0]]} is out of range: {of}, so that -1 (none) to {below - 1} is "
                "allowed",
                reason="INDEX_OUT_OF_RANGE",
                field=field,
                index=int(low[0]),
            )
        # The entries for none are replaced, so that the others are checked as all indices are.
        known = indices(field, np.where(none, 0, array), count, below=max(below, 1), of=of)
        found = np.where(none, -1, known.astype(np.int64))
    else:
        found = indices(field, value, count, below=below, of=of).astype(np.int64)
    distinct(field, found)
    return found


def distinct(field: str, array: npt.NDArray[Any]) -> None:
    """Checks that no index except -1 is there twice.

    Raises:
        InvalidArgument: REPEATED_INDEX.
    """
    order = np.argsort(array, kind="stable")
    ascending = array[order]
    again = np.flatnonzero((ascending[1:] == ascending[:-1]) & (ascending[1:] >= 0))
    if again.size:
        place = int(order[again + 1].min())
        raise InvalidArgument(
            f"{array[place]} is there twice: expected each index at most once",
            reason="REPEATED_INDEX",
            field=field,
            index=place,
        )


def _array(field: str, value: Any, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
    """Converts `value` to a numpy array of any type and shape; `shape` is only used in messages."""
    return _numbers.array_of(field, value, f"an array of shape {_wanted(shape)}")


def frozen(array: npt.NDArray[Any]) -> Any:
    """A read-only copy of an array."""
    copy = np.array(array, order="C")
    copy.flags.writeable = False
    return copy


def _check_shape(field: str, array: npt.NDArray[Any], shape: tuple[int | None, ...]) -> None:
    expected = len(shape) == array.ndim and all(
        want is None or want == have for want, have in zip(shape, array.shape, strict=True)
    )
    if not expected:
        raise InvalidArgument(
            f"expected shape {_wanted(shape)}, got {array.shape}", reason="WRONG_SHAPE", field=field
        )


def _wanted(shape: tuple[int | None, ...]) -> str:
    lengths = ["n" if want is None else str(want) for want in shape]
    return f"({', '.join(lengths)}{',' if len(lengths) == 1 else ''})"


def from_wxyz(quaternions: Any) -> Floats:
    """Converts quaternions from the order w, x, y, z (MuJoCo, Isaac) to x, y, z, w (this package).

    Args:
        quaternions: (..., 4), numbers.

    Returns:
        (..., 4), float64.

    Raises:
        InvalidArgument: NOT_AN_ARRAY or WRONG_SHAPE.
    """
    expected = "numbers of shape (..., 4)"
    array = _numbers.array_of("quaternions", quaternions, expected)
    array = _numbers.doubles("quaternions", array, expected, quaternions)
    if array.ndim == 0 or array.shape[-1] != 4:
        raise InvalidArgument(
            f"expected {expected}, got shape {array.shape}",
            reason="WRONG_SHAPE",
            field="quaternions",
        )
    return np.ascontiguousarray(np.roll(array, -1, axis=-1))


def poses(
    positions: Any, rotations: Any, count: int, *, of_hulls: bool = False
) -> tuple[Floats, Floats]:
    """Converts poses of any accepted form to positions (n, 3) and quaternions (n, 4).

    Both may be the caller's own arrays.

    Args:
        positions: (n, 3); or (n, 4, 4) homogeneous matrices if `rotations` is None. A
            scipy `RigidTransform`, or a list of these, stands for its matrices.
        rotations: (n, 4) quaternions x, y, z, w; (n, 3, 3) matrices; or a scipy `Rotation` of
            length n, or a list of these.
        count: n, the number of bodies.
        of_hulls: whether `count` is the number of hulls, because there is no `body_hulls`.

    Raises:
        InvalidArgument: NOT_AN_ARRAY, WRONG_SHAPE, MISSING_ARGUMENT, NOT_A_POSE or NOT_A_ROTATION.
    """
    if hasattr(positions, "positions") and hasattr(positions, "rotations"):
        raise InvalidArgument(
            f"expected positions, got {kind(positions)}: give its attributes positions and "
            "rotations",
            reason="NOT_AN_ARRAY",
            field="positions",
        )
    positions = as_matrices(positions)
    # If poses and hulls differ in number, the missing `body_hulls` is the likely fault.
    wanted = None if of_hulls else count
    if rotations is None:
        matrices = _array("positions", positions, (count, 4, 4))
        if matrices.shape[-1:] == (3,) or (matrices.size == 0 and matrices.ndim == 1 and count):
            raise InvalidArgument(
                "missing: with positions of shape (n, 3), give rotations as quaternions (n, 4) in "
                "the order x, y, z, w, as matrices (n, 3, 3) or as a scipy Rotation",
                reason="MISSING_ARGUMENT",
                field="rotations",
            )
        matrices = floats("positions", matrices, wanted, 4, 4)
        _check_count(len(matrices), count)
        check_bottom("positions", matrices)
        turns = quaternions("positions", matrices[:, :3, :3])
        turns[~np.isfinite(matrices[:, 3]).all(axis=1)] = np.nan  # the last row has no other place
        return np.ascontiguousarray(matrices[:, :3, 3]), turns
    position_array = floats("positions", positions, wanted, 3)
    rotation_array = _array("rotations", _as_quaternions(rotations), (count, 4))
    if rotation_array.ndim and len(rotation_array) == count:
        _check_shape("positions", position_array, (count, 3))
    _check_count(len(position_array), count)
    if rotation_array.ndim == 3:
        matrices = floats("rotations", rotation_array, count, 3, 3)
        return position_array, quaternions("rotations", matrices)
    return position_array, floats("rotations", rotation_array, count, 4)


def _check_count(given: int, hulls: int) -> None:
    """Raises if there is another number of poses than of hulls, and no `body_hulls`."""
    if given != hulls:
        raise InvalidArgument(
            f"missing: got {counted(hulls, 'hull')} and {counted(given, 'pose')}; "
            "expected one hull per pose, or body_hulls with the index of each body's hull, such as "
            f"{f'[0] * {given}' if given > 3 else [0] * given}",
            reason="MISSING_ARGUMENT",
            field="body_hulls",
        )


def check_bottom(field: str, matrices: Floats) -> None:
    """Raises InvalidArgument if the last row of a homogeneous matrix is not 0, 0, 0, 1."""
    bottom = matrices[:, 3, :]
    # A matrix with numbers that are not finite is an unusable pose, which the query reports.
    finite = np.isfinite(matrices).all(axis=(1, 2))
    wrong = np.flatnonzero(finite & (bottom != (0.0, 0.0, 0.0, 1.0)).any(axis=1))
    if wrong.size:
        raise InvalidArgument(
            f"the last row is {bottom[wrong[0]].tolist()}, expected 0, 0, 0, 1",
            reason="NOT_A_POSE",
            field=field,
            index=int(wrong[0]),
        )


def as_matrices(value: Any) -> Any:
    """The homogeneous matrices (n, 4, 4) of scipy's `RigidTransform`; other values as they are."""
    if _is_transform(value):
        matrices = as_array(value.as_matrix())
        return matrices[None] if matrices.ndim == 2 else matrices
    several = cast("list[Any]", value) if isinstance(value, (list, tuple)) else []
    if several and all(map(_is_transform, several)):
        return np.concatenate([as_matrices(pose) for pose in several])
    return cast("Any", value)


def _is_transform(value: Any) -> bool:
    """Whether a value is a scipy `RigidTransform`; scipy need not be installed."""
    return callable(getattr(value, "as_matrix", None)) and hasattr(value, "translation")


def _as_quaternions(value: Any) -> Any:
    """The quaternions (n, 4) of scipy's `Rotation`; other values as they are."""
    if hasattr(value, "as_quat"):
        return np.atleast_2d(as_array(value.as_quat()))
    several = cast("list[Any]", value) if isinstance(value, (list, tuple)) else []
    if several and all(hasattr(turn, "as_quat") for turn in several):
        return np.concatenate([_as_quaternions(turn) for turn in several])
    return cast("Any", value)


def as_array(value: Any) -> npt.NDArray[Any]:
    """A numpy array of the content of another library's array, whose type is not checked."""
    array = _tensors.as_numpy(value)
    return np.asarray(value) if array is None else array


def unusable(positions: Floats, rotations: Floats) -> Indices:
    """The indices of the bodies whose poses the server refuses, ascending."""
    with np.errstate(invalid="ignore", over="ignore"):
        near = (np.abs(positions) <= LARGEST).all(axis=1)
        squared = np.einsum("ni,ni->n", rotations, rotations)
        turned = (squared >= MIN_NORM**2) & (squared <= MAX_NORM**2)
    return np.flatnonzero(~(near & turned)).astype("<u4")


def why_unusable(position: Floats, rotation: Floats) -> tuple[str, str]:
    """The argument that makes a body's pose unusable, "positions" or "rotations", and why."""
    text = f"({', '.join(f'{c:g}' for c in position)})"
    if not np.isfinite(position).all():
        return "positions", f"its position {text} is not finite"
    if not (np.abs(position) <= LARGEST).all():
        allowed = f"-{LARGEST:g} to {LARGEST:g} is allowed"
        return "positions", f"its position {text} is beyond {LARGEST:g}, {allowed}"
    text = f"({', '.join(f'{c:g}' for c in rotation)})"
    if not np.isfinite(rotation).all():
        return "rotations", f"its rotation {text} is not finite"
    with np.errstate(over="ignore"):
        norm = float(np.linalg.norm(rotation))
    if MIN_NORM <= norm <= MAX_NORM:
        return "rotations", "the server refuses its pose"  # a server of another version
    allowed = f"{MIN_NORM:g} to {MAX_NORM:g} is allowed"
    return "rotations", f"its rotation {text} has norm {norm:g}, {allowed}"


def quaternions(field: str, matrices: Floats) -> Floats:
    """Converts rotation matrices (n, 3, 3) to unit quaternions (n, 4) in the order x, y, z, w.

    Shepperd's method (1978): the quaternion is computed from its largest component, so that no
    division is by less than 1/2. A matrix with a number that is not finite gives a quaternion of
    NaN; the server then reports the body as unusable.

    Raises:
        InvalidArgument: NOT_A_ROTATION.
    """
    finite = np.isfinite(matrices).all(axis=(1, 2), keepdims=True)
    matrices = np.where(finite, matrices, np.nan)
    with np.errstate(invalid="ignore", over="ignore"):
        products = np.einsum("nki,nkj->nij", matrices, matrices)
        off = np.abs(products - np.eye(3)).max(axis=(1, 2)) if len(matrices) else np.zeros(0)
        wrong = np.flatnonzero((off > _ROTATION_ERROR) | (np.linalg.det(matrices) < 0.0))
    if wrong.size:
        raise InvalidArgument(
            "the matrix is not a rotation: expected orthonormal rows and determinant 1",
            reason="NOT_A_ROTATION",
            field=field,
            index=int(wrong[0]),
        )
    # Row i of `outer` is 4 q_i q, up to rounding. Every row with q_i != 0, normalised, is the
    # quaternion.
    m = matrices
    x, y, z = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    xy, xz, yz = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    xw, yw, zw = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    outer = np.stack(
        [
            np.stack([1 + x - y - z, xy, xz, xw], axis=-1),
            np.stack([xy, 1 - x + y - z, yz, yw], axis=-1),
            np.stack([xz, yz, 1 - x - y + z, zw], axis=-1),
            np.stack([xw, yw, zw, 1 + x + y + z], axis=-1),
        ],
        axis=1,
    )
    largest = np.argmax(np.einsum("nii->ni", outer), axis=1)
    rows = outer[np.arange(len(m)), largest]
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)

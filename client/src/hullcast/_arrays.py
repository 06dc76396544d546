"""What users pass as arrays, brought to one form or refused by name."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ._errors import InvalidArgument

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.uint32]

#: A pose's matrix may be off a rotation by this much, as the server takes
#: quaternions whose norm is within 1e-3 of 1.
_ROTATION_ERROR = 1e-3


def floats(field: str, value: Any, *shape: int | None) -> Floats:
    """`value` as a contiguous little-endian float64 array; None in `shape` is any length."""
    try:
        array = np.ascontiguousarray(value, dtype="<f8")
    except (TypeError, ValueError) as error:
        raise InvalidArgument(str(error), reason="NOT_AN_ARRAY", field=field) from None
    array = array.reshape(0, *shape[1:]) if array.size == 0 and None not in shape[1:] else array
    _check_shape(field, array, shape)
    return array


def indices(field: str, value: Any, *shape: int | None, below: int | None = None) -> Indices:
    """`value` as a contiguous little-endian uint32 array, each entry under `below`."""
    array: npt.NDArray[Any] = np.asarray(value)
    if array.size == 0:
        array = np.zeros((0, *(length or 0 for length in shape[1:])), dtype="<u4")
    if array.dtype.kind not in "iu":
        raise InvalidArgument(
            f"expected integers, got {array.dtype}", reason="NOT_INTEGERS", field=field
        )
    _check_shape(field, array, shape)
    limit = 2**32 if below is None else below
    if array.size and (array.min() < 0 or array.max() >= limit):
        wrong = np.flatnonzero((array < 0) | (array >= limit))[0]
        raise InvalidArgument(
            f"{array.flat[wrong]} is not in 0 .. {limit}",
            reason="INDEX_OUT_OF_RANGE",
            field=field,
            index=int(wrong),
        )
    return np.ascontiguousarray(array, dtype="<u4")


def frozen(array: Floats) -> Floats:
    """A copy that cannot be written to."""
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def _check_shape(field: str, array: npt.NDArray[Any], shape: tuple[int | None, ...]) -> None:
    expected = len(shape) == array.ndim and all(
        want is None or want == have for want, have in zip(shape, array.shape, strict=True)
    )
    if not expected:
        wanted = ", ".join("n" if want is None else str(want) for want in shape)
        raise InvalidArgument(
            f"expected shape ({wanted}), got {array.shape}", reason="WRONG_SHAPE", field=field
        )


def from_wxyz(quaternions: npt.ArrayLike) -> Floats:
    """Quaternions `w, x, y, z` (MuJoCo, Isaac) as the `x, y, z, w` of this package.

    Takes and returns shape (..., 4).
    """
    return np.ascontiguousarray(np.roll(np.asarray(quaternions, dtype="<f8"), -1, axis=-1))


def poses(positions: Any, rotations: Any, count: int | None) -> tuple[Floats, Floats]:
    """Positions (n, 3) and quaternions (n, 4) of whatever form the poses have.

    Args:
        positions: (n, 3), or (n, 4, 4) homogeneous matrices with `rotations` None.
        rotations: (n, 4) xyzw, (n, 3, 3), or a scipy `Rotation` of n.
        count: n, or None for any.
    """
    if rotations is None:
        matrices = floats("poses", positions, count, 4, 4)
        bottom = matrices[:, 3, :]
        wrong = np.flatnonzero((bottom != (0.0, 0.0, 0.0, 1.0)).any(axis=1))
        if wrong.size:
            raise InvalidArgument(
                "the last row of a pose is 0, 0, 0, 1",
                reason="NOT_A_POSE",
                field="poses",
                index=int(wrong[0]),
            )
        return np.ascontiguousarray(matrices[:, :3, 3]), quaternions("poses", matrices[:, :3, :3])
    position_array = floats("positions", positions, count, 3)
    if hasattr(rotations, "as_quat"):
        rotations = np.atleast_2d(rotations.as_quat())
    rotation_array = np.asarray(rotations, dtype="<f8")
    if rotation_array.ndim == 3:
        matrices = floats("rotations", rotation_array, len(position_array), 3, 3)
        return position_array, quaternions("rotations", matrices)
    return position_array, floats("rotations", rotation_array, len(position_array), 4)


def quaternions(field: str, matrices: Floats) -> Floats:
    """Unit quaternions xyzw of rotation matrices (n, 3, 3).

    By the largest of the four components (Shepperd 1978), which never divides
    by less than 1/2. NaN stays NaN: the server answers for such a body.
    """
    products = np.einsum("nki,nkj->nij", matrices, matrices)
    with np.errstate(invalid="ignore"):
        off = np.abs(products - np.eye(3)).max(axis=(1, 2)) if len(matrices) else np.zeros(0)
        wrong = np.flatnonzero((off > _ROTATION_ERROR) | (np.linalg.det(matrices) < 0.0))
    if wrong.size:
        raise InvalidArgument(
            "not a rotation (orthonormal, determinant 1)",
            reason="NOT_A_ROTATION",
            field=field,
            index=int(wrong[0]),
        )
    # Row i of `outer` is 4 q_i q, up to rounding; any row is the quaternion.
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

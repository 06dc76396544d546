"""Converts values of any kind to numpy arrays, and refuses values that numpy would misread.

Without these checks numpy would drop masks, and would convert words, dates and complex numbers
inside an array of objects to floats.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from . import _tensors
from ._arguments import is_masked, is_real, kind, ordered, plain, shown
from ._errors import InvalidArgument

#: numpy's kinds of numbers: floats, and integers with and without a sign.
NUMBERS = "fiu"


def array_of(field: str, value: Any, expected: str) -> npt.NDArray[Any]:
    """Converts `value` to a numpy array of any type and shape.

    An array of objects becomes one of integers, truth values or floats. Only integers beyond 64
    bits remain objects. An iterable that cannot be indexed is read once.

    Args:
        field: the argument's name, for messages.
        value: the value.
        expected: what the argument should be, such as "an array of shape (n, 3)", for messages.

    Raises:
        InvalidArgument: NOT_AN_ARRAY, or NO_ORDER for a set.
    """
    ordered(field, value)
    if value is None or isinstance(value, (str, bytes, Mapping)):
        raise InvalidArgument(
            f"expected {expected}, got {kind(value)}", reason="NOT_AN_ARRAY", field=field
        )
    try:
        array = _tensors.as_numpy(value)
        if array is None:
            value = _tensors.each_as_numpy(value)
            is_array = hasattr(value, "__getitem__") or hasattr(value, "__array__")
            if not is_array and isinstance(value, Iterable):
                value = list(value)  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
        masked = _has_mask(value)
        array = np.asarray(value if array is None else array)
    except InvalidArgument:
        raise
    except Exception as error:  # the conversion of a foreign object may raise anything
        raise InvalidArgument(
            f"expected {expected}: {error}", reason="NOT_AN_ARRAY", field=field
        ) from None
    if masked:
        raise InvalidArgument(
            f"expected {expected}, got an array with masked entries",
            reason="NOT_AN_ARRAY",
            field=field,
        )
    return _of_objects(field, array) if array.dtype.kind == "O" and array.ndim else array


def doubles(field: str, array: npt.NDArray[Any], expected: str, value: Any) -> npt.NDArray[Any]:
    """Converts an array of `array_of` to contiguous little-endian float64 numbers.

    Args:
        field, expected: as for `array_of`.
        array: the array.
        value: the value from which the array was made, for messages.

    Raises:
        InvalidArgument: NOT_AN_ARRAY.
    """
    if array.dtype.kind == "V" and np.can_cast(array.dtype, "<f8"):  # bfloat16 of jax
        array = array.astype("<f8")
    if array.dtype.kind == "O" and array.ndim:  # integers beyond 64 bits
        return _each_as_double(field, array)
    if array.dtype.kind not in NUMBERS and array.size:
        raise InvalidArgument(
            f"expected {expected}, got {content(array, value)}", reason="NOT_AN_ARRAY", field=field
        )
    # `ascontiguousarray` gives an array of no dimensions one dimension.
    return np.ascontiguousarray(array, dtype="<f8").reshape(array.shape)


def any_shape(field: str, value: Any) -> npt.NDArray[Any]:
    """Converts a value to a float64 array of any shape.

    Raises:
        InvalidArgument: NOT_AN_ARRAY, or NO_ORDER for a set.
    """
    value = list(cast("Iterator[Any]", value)) if isinstance(value, Iterator) else value
    return doubles(field, array_of(field, value, "numbers"), "numbers", value)


def content(array: npt.NDArray[Any], value: Any) -> str:
    """Describes an array of a wrong type and the value that it was made from, for a message."""
    return f"{shown(value)} of type {kind(value)}" if array.ndim == 0 else str(array.dtype)


def misplaced(
    field: str, message: str, place: int, shape: tuple[int, ...], reason: str = "NOT_AN_ARRAY"
) -> InvalidArgument:
    """The error for one entry of an array, whose flat index is `place`."""
    error = InvalidArgument(message, reason=reason, field=field, index=place)
    error.entry = tuple(int(i) for i in np.unravel_index(place, shape))
    return error


def _has_mask(value: Any) -> bool:
    """Whether an array, or any array inside lists, has masked entries."""
    if isinstance(value, (list, tuple)):
        entries = cast("list[Any]", value)
        # Few types occur in one list, so this is far faster than a test of every entry.
        types: set[Any] = set(map(type, entries))
        nested: set[Any] = {one for one in types if issubclass(one, (list, tuple, np.ndarray))}
        return bool(nested) and any(_has_mask(entry) for entry in entries if type(entry) in nested)
    return is_masked(value)


def _of_objects(field: str, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The numbers of an array of objects."""
    entries = [plain(entry) for entry in array.flat]
    if entries and all(isinstance(entry, (bool, np.bool_)) for entry in entries):
        return array.astype(bool)
    for place, entry in enumerate(entries):
        ordered(field, entry)
        if not is_real(entry):
            message = f"got {shown(entry)}, expected a number"
            raise misplaced(field, message, place, array.shape)
    if all(isinstance(entry, (int, np.integer)) for entry in entries):
        try:
            return np.array(entries, dtype=np.int64).reshape(array.shape)
        except OverflowError:
            return array
    return _each_as_double(field, array)


def _each_as_double(field: str, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """An array of objects, each of them a real number, as float64."""
    result = np.empty(array.shape, dtype="<f8")
    for place, entry in enumerate(array.flat):
        try:
            result.flat[place] = float(plain(entry))
        except OverflowError:
            message = f"got {shown(entry)}, expected a number of double precision"
            raise misplaced(field, message, place, array.shape) from None
        except ValueError:  # a signalling NaN of `decimal`
            result.flat[place] = np.nan
    return result

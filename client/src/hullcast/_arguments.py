"""Checks single values that callers pass; an error names the argument, its value and the range."""

from __future__ import annotations

import math
import numbers
import sys
from collections.abc import Iterable
from decimal import Decimal
from typing import Any, cast

import numpy as np

from ._errors import InvalidArgument

#: A timeout of at least this many seconds (more than thirty years) counts as no limit.
_NO_LIMIT = 1e9


def shown(value: Any) -> str:
    """A value as an error message shows it, in at most 60 characters.

    If the value cannot be printed, its type is shown.
    """
    try:
        text = repr(cast("Any", value).item() if isinstance(value, np.generic) else value)
    except Exception:  # the caller's own `__repr__` failed
        return f"an object of type {type(cast('Any', value)).__name__}"
    return text if len(text) <= 60 else f"{text[:57]}..."


def kind(value: Any) -> str:
    """The name of a value's type, as error messages show it."""
    return "None" if value is None else type(value).__name__


def counted(number: int, one: str, several: str = "") -> str:
    """A number and its noun, such as "1 hull" or "2 bodies"."""
    return f"{number} {one if number == 1 else several or one + 's'}"


def plain(value: Any) -> Any:
    """The single number in an array of no dimensions (numpy, torch, jax); others as they are.

    A masked number and numpy's dates and times are left as they are: their items would be numbers.
    """
    if is_masked(value) or getattr(getattr(value, "dtype", None), "kind", "") in ("m", "M"):
        return value
    if getattr(value, "ndim", None) == 0 and callable(getattr(value, "item", None)):
        try:
            return value.item()
        except Exception:  # a foreign object; it is refused as what it is
            return value
    return value


def is_masked(value: Any) -> bool:
    """Whether a value is an array of `numpy.ma` with masked entries, or `numpy.ma.masked`."""
    # numpy loads this module when it is first used, which takes a few milliseconds.
    masks: Any = sys.modules.get("numpy.ma")
    return masks is not None and isinstance(value, masks.MaskedArray) and masks.is_masked(value)


def is_real(value: Any) -> bool:
    """Whether a value is one real number of any type; truth values and time spans are not."""
    return isinstance(value, (numbers.Real, Decimal, np.integer, np.floating)) and not isinstance(
        value, (bool, np.bool_, np.timedelta64)
    )


def flag(field: str, value: Any) -> bool:
    """Checks that `value` is True or False, and returns it as a bool.

    Raises:
        InvalidArgument: WRONG_TYPE.
    """
    value = plain(value)
    if isinstance(value, bool):
        return value
    raise InvalidArgument(
        f"got {shown(value)}, expected True or False", reason="WRONG_TYPE", field=field
    )


def number(
    field: str, value: Any, low: float, high: float = math.inf, *, infinite: bool = False
) -> float:
    """Checks that `value` is a real number from `low` to `high`, and returns it as a float.

    Infinity is accepted only if `infinite` is true. NaN is never accepted.

    Raises:
        InvalidArgument: WRONG_TYPE or VALUE_OUT_OF_RANGE.
    """
    if high < math.inf:
        expected = f"expected a number, {low:g} to {high:g}"
    elif infinite:
        expected = f"expected a number, {low:g} or more, or infinity"
    else:
        expected = f"expected a finite number, {low:g} or more"
    result = real(field, value, expected)
    # A comparison with NaN is false, so NaN is refused too.
    if not low <= result <= high or (result == math.inf and not infinite):
        raise InvalidArgument(
            f"got {shown(value)}, {expected}", reason="VALUE_OUT_OF_RANGE", field=field
        )
    return result


def integer(field: str, value: Any, low: int, high: int) -> int:
    """Checks that `value` is an integer from `low` to `high`, and returns it as an int.

    A bool is not accepted.

    Raises:
        InvalidArgument: WRONG_TYPE or VALUE_OUT_OF_RANGE.
    """
    expected = f"expected an integer, {low} to {high}"
    value = plain(value)
    if not is_real(value) or not isinstance(value, (int, np.integer)):
        raise InvalidArgument(f"got {shown(value)}, {expected}", reason="WRONG_TYPE", field=field)
    if not low <= value <= high:
        raise InvalidArgument(
            f"got {shown(value)}, {expected}", reason="VALUE_OUT_OF_RANGE", field=field
        )
    return int(value)  # pyright: ignore[reportUnknownArgumentType]


def seconds(field: str, value: Any) -> float | None:
    """Checks a timeout, a number of seconds above 0; returns None for no limit.

    None and infinity mean no limit.

    Raises:
        InvalidArgument: WRONG_TYPE or VALUE_OUT_OF_RANGE.
    """
    if value is None:
        return None
    expected = "expected a number of seconds above 0, or None or infinity for no limit"
    result = real(field, value, expected)
    if not result > 0:
        raise InvalidArgument(
            f"got {shown(value)}, {expected}", reason="VALUE_OUT_OF_RANGE", field=field
        )
    return None if result >= _NO_LIMIT else result


def one_of(field: str, value: Any, known: Iterable[str]) -> str:
    """Checks that `value` is one of the words in `known`, and returns it.

    Raises:
        InvalidArgument: UNKNOWN_VALUE.
    """
    words = tuple(known)
    if isinstance(value, str) and value in words:
        return value
    raise InvalidArgument(
        f"got {shown(value)}, expected one of {', '.join(words)}",
        reason="UNKNOWN_VALUE",
        field=field,
    )


def iterable(value: Any) -> bool:
    """Whether a loop can run over a value. Arrays of no dimensions only look as if."""
    return isinstance(value, Iterable) and getattr(cast("Any", value), "ndim", 1) != 0


def ordered(field: str, value: Any) -> None:
    """Checks that `value` is not a set: its entries would be taken in an arbitrary order.

    The keys of a dict have an order, and are accepted.

    Raises:
        InvalidArgument: NO_ORDER.
    """
    if isinstance(value, (set, frozenset)):
        raise InvalidArgument(
            f"got a {kind(cast('Any', value))}, and a set has no order: expected a list, such as "
            "sorted(...) of the set",
            reason="NO_ORDER",
            field=field,
        )


def instance(field: str, value: Any, wanted: type, expected: str) -> None:
    """Checks that `value` is an instance of `wanted`; the message calls that type `expected`.

    Raises:
        InvalidArgument: WRONG_TYPE.
    """
    if not isinstance(value, wanted):
        raise InvalidArgument(
            f"expected {expected}, got {kind(value)}", reason="WRONG_TYPE", field=field
        )


def real(field: str, value: Any, expected: str) -> float:
    """Converts a real number of any type to a float; one too large for a float becomes infinity.

    Raises:
        InvalidArgument: WRONG_TYPE. The message ends with `expected`.
    """
    value = plain(value)
    if not is_real(value):
        raise InvalidArgument(f"got {shown(value)}, {expected}", reason="WRONG_TYPE", field=field)
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
    except ValueError:  # a signalling NaN of `decimal`
        return math.nan

"""Single values that users pass: brought to one form, or refused with name, value and range."""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable
from decimal import Decimal
from typing import Any

import numpy as np

from ._errors import InvalidArgument

#: Seconds from which a timeout is no limit: more than thirty years.
_NO_LIMIT = 1e9


def shown(value: Any) -> str:
    """A value as an error message shows it, of bounded length; unprintable values by their type."""
    try:
        text = repr(value.item() if isinstance(value, np.generic) else value)
    except Exception:  # a `__repr__` of the caller's
        return f"an object of type {type(value).__name__}"
    return text if len(text) <= 60 else f"{text[:57]}..."


def kind(value: Any) -> str:
    """A value's type as an error message names it."""
    return "None" if value is None else type(value).__name__


def number(
    field: str, value: Any, low: float, high: float = math.inf, *, infinite: bool = False
) -> float:
    """A real number from `low` to `high`; infinity only if `infinite` says so.

    Raises:
        InvalidArgument: WRONG_TYPE or VALUE_OUT_OF_RANGE.
    """
    top = f"to {high:g}" if high < math.inf else "or more" + (", or infinity" if infinite else "")
    expected = f"expected a number, {low:g} {top}"
    result = real(field, value, expected)
    # NaN is in no range.
    if not low <= result <= high or (result == math.inf and not infinite):
        raise InvalidArgument(
            f"got {shown(value)}, {expected}", reason="VALUE_OUT_OF_RANGE", field=field
        )
    return result


def integer(field: str, value: Any, low: int, high: int) -> int:
    """An integer from `low` to `high`.

    Raises:
        InvalidArgument: WRONG_TYPE or VALUE_OUT_OF_RANGE.
    """
    expected = f"expected an integer, {low} to {high}"
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise InvalidArgument(f"got {shown(value)}, {expected}", reason="WRONG_TYPE", field=field)
    if not low <= value <= high:
        raise InvalidArgument(
            f"got {shown(value)}, {expected}", reason="VALUE_OUT_OF_RANGE", field=field
        )
    return int(value)


def seconds(field: str, value: Any) -> float | None:
    """A timeout: a number of seconds above 0. None and infinity are no limit.

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
    """One of some words.

    Raises:
        InvalidArgument: UNKNOWN_VALUE.
    """
    words = tuple(known)
    if isinstance(value, str) and value in words:
        return value
    raise InvalidArgument(
        f"{shown(value)} is none of {', '.join(words)}", reason="UNKNOWN_VALUE", field=field
    )


def instance(field: str, value: Any, wanted: type, expected: str) -> None:
    """Refuses a value of another type.

    Raises:
        InvalidArgument: WRONG_TYPE.
    """
    if not isinstance(value, wanted):
        raise InvalidArgument(
            f"expected {expected}, got {kind(value)}", reason="WRONG_TYPE", field=field
        )


def real(field: str, value: Any, expected: str) -> float:
    """A real number of any type; one too large for a float is infinity.

    Raises:
        InvalidArgument: WRONG_TYPE, with the text `expected`.
    """
    good = isinstance(value, (numbers.Real, Decimal, np.integer, np.floating))
    if isinstance(value, (bool, np.bool_)) or not good:
        raise InvalidArgument(f"got {shown(value)}, {expected}", reason="WRONG_TYPE", field=field)
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
    except ValueError:  # a signalling NaN of decimal
        return math.nan

"""Arrays of enum values that compare equal to names and print names."""

from __future__ import annotations

import enum
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from ._errors import InvalidArgument
from ._wire import FeatureKind, Flag, Outcome

Bytes = npt.NDArray[np.uint8]

#: The operations in which a name stands for its number.
_TAKE_NAMES = (np.equal, np.not_equal, np.bitwise_and, np.bitwise_or, np.bitwise_xor)


class EnumArray(np.ndarray[Any, np.dtype[np.uint8]]):
    """A uint8 array of an enum's values. `==` accepts names as well as numbers.

    A single entry is a member of the enum. Any other operation gives a plain array.
    """

    kinds: ClassVar[type[enum.IntEnum | enum.IntFlag]]

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        named = ufunc in _TAKE_NAMES
        plain = [self._number(value) if named else _plain(value) for value in inputs]
        if "out" in options:
            options["out"] = tuple(_plain(value) for value in options["out"])
        return getattr(ufunc, method)(*plain, **options)

    @classmethod
    def _number(cls, value: Any) -> Any:
        """Converts a name, or an array of names, to numbers; returns any other value unchanged."""
        value = _plain(value)
        if isinstance(value, str):
            member = cls.kinds.__members__.get(value.upper())
            if member is None:
                raise InvalidArgument(
                    f"got {value!r}, expected one of {', '.join(cls.kinds.__members__)}",
                    reason="UNKNOWN_VALUE",
                    field=cls.__name__,
                )
            return np.uint8(int(member))
        array = np.asarray(value)
        if array.dtype.kind == "U":
            numbers = [cls._number(str(name)) for name in array.flat]
            return np.array(numbers, dtype=np.uint8).reshape(array.shape)
        return value

    def __getitem__(self, index: Any) -> Any:
        found = super().__getitem__(index)
        return self._member(found) if isinstance(found, np.integer) else found

    def _member(self, value: Any) -> Any:
        try:
            return self.kinds(int(value))
        except ValueError:  # a value from a newer server, or the result of arithmetic
            return value

    def _name(self, value: Any) -> str:
        member = self._member(value)
        return str(member.name or int(value)) if isinstance(member, enum.Enum) else str(value)

    def __str__(self) -> str:
        return np.array2string(self.view(np.ndarray), formatter={"int": self._name})

    def __repr__(self) -> str:
        start = f"{type(self).__name__}("
        plain = self.view(np.ndarray)
        text = np.array2string(plain, formatter={"int": self._name}, separator=", ", prefix=start)
        return f"{start}{text})"


class OutcomeArray(EnumArray):
    """The outcomes of pairs, for comparisons such as `m.outcome == "CONTACT"`."""

    kinds = Outcome


class FlagArray(EnumArray):
    """The flags of pairs, for tests such as `(m.flags & "ESTIMATED") != 0`."""

    kinds = Flag

    def _name(self, value: Any) -> str:
        return (Flag(int(value)).name or "-") if int(value) else "-"


class FeatureKindArray(EnumArray):
    """The kinds of touching features, for comparisons such as `m.feature_kinds == "FACE"`."""

    kinds = FeatureKind


def _plain(value: Any) -> Any:
    return value.view(np.ndarray) if isinstance(value, EnumArray) else value

"""Arrays of enum values that compare equal to names and print names."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from typing import Any, ClassVar, cast

import numpy as np
import numpy.typing as npt

from ._errors import InvalidArgument
from ._wire import FeatureKind, Flag, Outcome, member_of

Bytes = npt.NDArray[np.uint8]

#: The operations in which a name stands for its number.
_TAKE_NAMES = (np.equal, np.not_equal, np.bitwise_and, np.bitwise_or, np.bitwise_xor)

#: The functions of numpy in which a name stands for its number, with their parameters for values,
#: which come first. Those on sets take any iterable, whatever its order.
_ON_SETS: dict[Any, tuple[str, ...]] = {
    np.isin: ("element", "test_elements"),
    np.intersect1d: ("ar1", "ar2"),
    np.setdiff1d: ("ar1", "ar2"),
    np.setxor1d: ("ar1", "ar2"),
    np.union1d: ("ar1", "ar2"),
}
if (in1d := getattr(np, "in1d", None)) is not None:  # numpy before 2.4
    _ON_SETS[in1d] = ("ar1", "ar2")
_ON_ARRAYS: dict[Any, tuple[str, ...]] = {
    np.array_equal: ("a1", "a2"),
    np.array_equiv: ("a1", "a2"),
    np.append: ("arr", "values"),
    np.searchsorted: ("a", "v"),
    np.where: ("condition", "x", "y"),
}


class EnumArray(np.ndarray[Any, np.dtype[np.uint8]]):
    """A uint8 array of an enum's values. `==` accepts names as well as numbers.

    A single entry is a member of the enum, and so are the entries of `tolist()` and the entries
    over which a loop runs. `np.isin` and numpy's other functions on sets accept names, and
    `astype(str)` gives them. Any other operation gives a plain array of numbers.

    numpy does not call this class for `np.array(column, dtype=str)`, `column.flat` and `np.nditer`,
    and neither does pandas for `pandas.Series(column)`. These have numbers, which equal no name.
    """

    kinds: ClassVar[type[enum.IntEnum | enum.IntFlag]]

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        named = ufunc in _TAKE_NAMES
        plain = [self._number(value) if named else _plain(value) for value in inputs]
        if "out" in options:
            options["out"] = tuple(_plain(value) for value in options["out"])
        return getattr(ufunc, method)(*plain, **options)

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        values = _ON_SETS.get(func) or _ON_ARRAYS.get(func, ())

        def number(value: Any) -> Any:
            return self._number(_listed(value) if func in _ON_SETS else value)

        count = len(values)
        args = (*map(number, args[:count]), *args[count:])
        kwargs = {k: number(v) if k in values else v for k, v in kwargs.items()}
        if values:
            return func(*args, **kwargs)
        return super().__array_function__(func, types, args, kwargs)

    @classmethod
    def _number(cls, value: Any) -> Any:
        """Converts a name, or an array of names, to numbers; returns any other value unchanged."""
        value = _plain(value)
        if isinstance(value, (str, bytes)):
            return np.uint8(int(member_of(cls.kinds, value)))
        if isinstance(value, (set, frozenset)):
            raise InvalidArgument(
                "got a set, and a set has no order: expected a name, or an array with a name for "
                "each entry; np.isin(column, [...]) tests for several names",
                reason="NO_ORDER",
                field=cls.__name__,
            )
        array = np.asarray(value)
        if array.dtype.kind not in "USTO":
            return value
        entries = array.ravel().tolist()
        if not any(isinstance(entry, (str, bytes)) for entry in entries):
            return value
        # Entries that are no names keep their values, so that None equals nothing.
        numbers = [cls._number(e) if isinstance(e, (str, bytes)) else e for e in entries]
        return np.array(numbers).reshape(array.shape)

    def __getitem__(self, index: Any) -> Any:
        found = super().__getitem__(index)
        return self._member(found) if isinstance(found, np.integer) else found

    def tolist(self) -> Any:
        """The entries as members of the enum, in nested lists."""
        return self.astype(object).tolist()

    def item(self, *place: Any) -> Any:
        """One entry, as a member of the enum."""
        return self._member(super().item(*place))

    def astype(self, dtype: Any, *options: Any, **named: Any) -> Any:
        """A copy of another type: text has the names, and an array of objects has the members."""
        wanted = np.dtype(dtype)
        if wanted.kind not in "USTO":
            return super().astype(dtype, *options, **named)
        convert = self._member if wanted.kind == "O" else self._name
        entries = np.empty(self.shape, dtype=object)
        entries.ravel()[:] = [convert(value) for value in self.view(np.ndarray).ravel()]
        return entries if wanted.kind == "O" else entries.astype(wanted)

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
        return str(Flag(int(value)))


class FeatureKindArray(EnumArray):
    """The kinds of touching features, for comparisons such as `m.feature_kinds == "FACE"`."""

    kinds = FeatureKind


def _plain(value: Any) -> Any:
    return value.view(np.ndarray) if isinstance(value, EnumArray) else value


def _listed(value: Any) -> Any:
    """A list of an iterable that numpy would take for one object, such as a set or a generator."""
    if isinstance(value, (str, bytes, list, tuple)) or hasattr(value, "__array__"):
        return cast("Any", value)
    return list(cast("Iterable[Any]", value)) if isinstance(value, Iterable) else value

"""Objects whose attributes cannot be assigned by mistake."""

from __future__ import annotations

from typing import Any, ClassVar, cast

import numpy as np


class Settled:
    """An object that refuses assignments to its public attributes, with the right way in the text.

    Without this check, an assigned value would be ignored or read with another type. Names that
    begin with an underscore and properties with a setter can be assigned.
    """

    #: What to do in place of an assignment, by the attribute's name; "" is for all others.
    _instead: ClassVar[dict[str, str]] = {}

    def __setattr__(self, name: str, value: Any) -> None:
        if name.startswith("_") or self._has_setter(name):
            object.__setattr__(self, name, value)
            return
        raise self._refusal(name)

    def __delattr__(self, name: str) -> None:
        if not name.startswith("_"):
            raise self._refusal(name)
        object.__delattr__(self, name)

    def _set(self, **attributes: Any) -> None:
        """Sets attributes without a check, for the methods of this package."""
        for name, value in attributes.items():
            object.__setattr__(self, name, value)

    def _has_setter(self, name: str) -> bool:
        found = getattr(type(self), name, None)
        return isinstance(found, property) and found.fset is not None

    def _refusal(self, name: str) -> AttributeError:
        kind = type(self).__name__
        known = name in self.__dict__ or hasattr(type(self), name)
        instead = self._instead.get(name, self._instead.get("", ""))
        what = f"{kind}.{name} is read-only" if known else f"{kind} has no attribute {name!r}"
        return AttributeError(what + (f": {instead}" if instead else ""), name=name, obj=self)


def freeze(value: Any) -> None:
    """Makes the arrays among an object's attributes read-only, which pickling and copying undo."""
    for array in cast("dict[str, Any]", vars(value)).values():
        if isinstance(array, np.ndarray):
            cast("np.ndarray", array).flags.writeable = False

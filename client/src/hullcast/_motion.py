"""The motion of bodies during a step, by which the margins of their pairs grow."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _arguments, _arrays
from ._arrays import LARGEST, Floats, Indices
from ._errors import InvalidArgument

#: For messages: a number of a motion, by the name of its argument.
_CALLED = {
    "linear_velocities": "linear velocity",
    "angular_velocities": "angular velocity",
    "turning_points": "turning point",
}


def margins(value: Any, count: int) -> Floats | None:
    """Checks the margins of `count` bodies, and returns a read-only copy; None for None.

    Raises:
        InvalidArgument: NOT_AN_ARRAY, WRONG_SHAPE or VALUE_OUT_OF_RANGE.
    """
    if value is None:
        return None
    checked = _arrays.floats("margins", value, count)
    # A comparison with NaN is false, so NaN is refused too.
    wrong = np.flatnonzero(~((checked >= 0.0) & (checked <= LARGEST)))
    if wrong.size:
        raise InvalidArgument(
            f"got {checked[wrong[0]]:g}, expected a number, 0 to {LARGEST:g}",
            reason="VALUE_OUT_OF_RANGE",
            field="margins",
            index=int(wrong[0]),
        )
    return _arrays.frozen(checked)


@dataclass(frozen=True)
class Motion:
    """The motion of the bodies of a query, or of some of them."""

    #: (bodies, 3) for each kind of number that was given; a kind without a column is 0.
    columns: dict[str, Floats] = field(default_factory=dict)
    #: The time for which the velocities hold.
    time_step: float = 0.0

    @classmethod
    def checked(
        cls,
        count: int,
        *,
        linear_velocities: Any = None,
        angular_velocities: Any = None,
        time_step: float = 0.0,
        turning_points: Any = None,
    ) -> Motion:
        """Checks the arguments of a call for `count` bodies. Each is None or of shape (count, 3).

        Raises:
            InvalidArgument: an argument has a wrong shape or type, or is out of its range. A number
                that is not finite only makes its body unusable, as in a pose.
        """
        given = {
            "linear_velocities": linear_velocities,
            "angular_velocities": angular_velocities,
            "turning_points": turning_points,
        }
        columns = {
            name: _arrays.floats(name, value, count, 3)
            for name, value in given.items()
            if value is not None
        }
        return cls(columns, _arguments.number("time_step", time_step, 0, LARGEST))

    def over(self, before: Motion, count: int, bodies: Indices | None = None) -> Motion:
        """The motion `before` of `count` bodies, with the columns of this one put in for `bodies`.

        None means all bodies. The time step is this motion's, because it holds for one step.
        """
        columns = dict(before.columns)
        for name, column in self.columns.items():
            whole = np.array(column)
            if bodies is not None:
                whole = np.array(columns.get(name, np.zeros((count, 3))))
                whole[bodies] = column
            columns[name] = whole
        return Motion(columns, self.time_step)

    def renumbered(self, previous: npt.NDArray[np.int64]) -> Motion:
        """The motion of other bodies: for each its index among these bodies, or -1 for a new one.

        New bodies do not move, and turn about the origins of their frames.
        """
        is_new = previous < 0
        columns: dict[str, Floats] = {}
        for name, column in self.columns.items():
            columns[name] = np.where(
                is_new[:, None], 0.0, np.vstack([column, np.zeros(3)])[previous]
            )
        return Motion(columns)

    def changes(self, since: Motion) -> npt.NDArray[np.bool_] | None:
        """(bodies,): which bodies have numbers with other bits than in `since`; None if no body."""
        changed: npt.NDArray[np.bool_] | None = None
        for name, column in self.columns.items():
            old = since.columns.get(name)
            if old is column:
                continue
            differ = (column.view("<u8") != (0 if old is None else old.view("<u8"))).any(axis=1)
            if differ.any():
                changed = differ if changed is None else changed | differ
        return changed

    def __bool__(self) -> bool:
        """Whether a server has to know motions to answer the query."""
        return bool(self.columns) or self.time_step > 0

    def of(self, bodies: Indices | None) -> list[tuple[str, npt.NDArray[Any]]]:
        """The columns of a message that has the given bodies; None for all bodies."""
        if bodies is None:
            return list(self.columns.items())
        return [(name, column[bodies]) for name, column in self.columns.items()]

    def unusable(self) -> Indices:
        """The bodies of which a number is not finite or too large, ascending."""
        wrong = [~_usable(column).all(axis=1) for column in self.columns.values()]
        return np.flatnonzero(np.any(wrong, axis=0)).astype("<u4") if wrong else np.zeros(0, "<u4")

    def why_unusable(self, body: int) -> tuple[str, str] | None:
        """The argument that makes a body unusable, and why; None if no argument here does."""
        for name, column in self.columns.items():
            if not _usable(column[body]).all():
                text = f"({', '.join(f'{c:g}' for c in column[body])})"
                allowed = f"finite numbers from -{LARGEST:g} to {LARGEST:g} are allowed"
                return name, f"its {_CALLED[name]} is {text}, {allowed}"
        return None


def _usable(values: Floats) -> npt.NDArray[np.bool_]:
    # A comparison with NaN is false.
    return np.abs(values) <= LARGEST

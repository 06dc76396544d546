"""Joint values of a robot, in the order of its joints or by their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from . import _numbers
from ._arguments import counted, shown
from ._arrays import Floats
from ._errors import InvalidArgument, JointLimitsWarning, warn


def read(joints: Any, names: Sequence[str], limits: Floats) -> tuple[Floats, bool]:
    """Reads the argument `joints` of `Robot.poses`.

    Args:
        joints: the argument.
        names: the names of the robot's joints.
        limits: (joints, 2): the lowest and the highest value of each joint.

    Returns:
        The joint values (k, joints), and whether the caller gave several configurations.

    Raises:
        InvalidArgument: as `Robot.poses`.
    """
    # A joint without a given value is as near to 0 as its limits allow.
    rest = np.clip(0.0, limits[:, 0], limits[:, 1])
    named = {} if joints is None else _by_name(joints)
    if named is None:
        given = _in_order(joints, len(names))
        values, several, axes = np.atleast_2d(given), given.ndim == 2, given.ndim
    else:
        values, several = _placed(named, names, rest)
        axes = 0
    _check(values, names, limits, axes)
    return values, several


def _in_order(joints: Any, count: int) -> Floats:
    """The values (joints,) or (k, joints) of an array in the order of the joints."""
    values = _numbers.any_shape("joints", joints)
    if values.shape[-1:] != (count,) or values.ndim > 2:
        raise InvalidArgument(
            f"expected shape ({count},) or (k, {count}), one value for each of Robot.joints, got "
            f"{values.shape}",
            reason="WRONG_SHAPE",
            field="joints",
        )
    return values


def _by_name(joints: Any) -> dict[str, Any] | None:
    """The values by name of a mapping, a pandas `Series` or a data frame; None without names.

    The numbers from 0 upwards, which pandas gives by default, are not names.

    Raises:
        InvalidArgument: REPEATED_NAME.
    """
    if isinstance(joints, Mapping):
        mapping = cast("Mapping[Any, Any]", joints)
        return {str(name): value for name, value in mapping.items()}
    # A table of pyarrow has the names as `column_names`, a data frame of another library as
    # `columns`, and a Series as its `index`.
    names = getattr(joints, "column_names", getattr(joints, "columns", None))
    if names is None and callable(getattr(joints, "items", None)):
        names = getattr(joints, "index", None)
    if names is None or list(names) == list(range(len(names))):
        return None
    labels = [str(name) for name in names]
    if len(set(labels)) < len(labels):
        raise InvalidArgument(
            f"a name occurs twice in {shown(labels)}, expected each joint at most once",
            reason="REPEATED_NAME",
            field="joints",
        )
    return {str(name): joints[name] for name in names}


def _placed(named: Mapping[str, Any], names: Sequence[str], rest: Floats) -> tuple[Floats, bool]:
    """The values (k, joints) from those by name, and whether there are several configurations."""
    columns = {
        name: _numbers.any_shape(f"joints[{name!r}]", value) for name, value in named.items()
    }
    lengths = {column.shape for column in columns.values() if column.ndim}
    if len(lengths) > 1 or any(len(shape) > 1 for shape in lengths):
        raise InvalidArgument(
            f"got values of shapes {sorted(lengths)}, expected numbers or arrays (k,)",
            reason="WRONG_SHAPE",
            field="joints",
        )
    values = np.tile(rest, (next(iter(lengths), (1,))[0], 1))
    for name, column in columns.items():
        if name not in names:
            nothing = "none: the robot has no joint that moves"
            allowed = f"one of {', '.join(names)}" if names else nothing
            raise InvalidArgument(
                f"got the joint {name!r}, expected {allowed}",
                reason="UNKNOWN_JOINT",
                field="joints",
            )
        values[:, names.index(name)] = column
    return values, bool(lengths)


def _check(values: Floats, names: Sequence[str], limits: Floats, axes: int) -> None:
    """Raises for values that are not finite, and warns of values beyond the limits.

    `axes` is the number of axes of the caller's array, for messages; 0 for values by name.
    """
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        row, joint = (int(i) for i in wrong[0])
        error = InvalidArgument(
            f"the value of joint {names[joint]!r} is {values[row, joint]:g}, expected a finite "
            "number",
            reason="NOT_FINITE",
            field="joints",
        )
        error.entry = (row, joint)[2 - axes :]
        raise error
    low, high = limits.T
    # Limits and values are often rounded to a few digits in files and messages.
    slack = 1e-6 * np.maximum(1.0, np.abs(np.where(np.isfinite(limits), limits, 0)))
    beyond = (values < low - slack[:, 0]) | (values > high + slack[:, 1])
    if beyond.any():
        row, joint = np.argwhere(beyond)[0]
        several = f" in {beyond.any(axis=1).sum()} of {len(values)} configurations"
        warn(
            JointLimitsWarning(
                f"{counted(int(beyond.any(axis=0).sum()), 'joint')} beyond the limits"
                f"{several if len(values) > 1 else ''}: joint {names[joint]!r} is "
                f"{values[row, joint]:g}, its limits are {low[joint]:g} to {high[joint]:g}"
            )
        )

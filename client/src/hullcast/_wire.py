"""Names for the numbers and the columns of the wire format."""

from __future__ import annotations

import enum
from typing import Any, TypeVar

from ._errors import InvalidArgument

_Kind = TypeVar("_Kind", bound=enum.Enum)


def member_of(kind: type[_Kind], name: str | bytes) -> _Kind:
    """The member of an enum with a name, in upper or lower case.

    Raises:
        InvalidArgument: UNKNOWN_VALUE.
    """
    text = name.decode("ascii", "replace") if isinstance(name, bytes) else str(name)
    member = kind.__members__.get(text.upper())
    if member is None:
        raise InvalidArgument(
            f"got {text!r}, expected one of {', '.join(kind.__members__)}",
            reason="UNKNOWN_VALUE",
            field=kind.__name__,
        )
    return member


class _Named:
    """Makes the members of an enum of integers equal their names, and print them.

    A name that no member has is refused, because a misspelt name would be unequal in silence.
    Python finds an entry of a set or of a dict by its hash, and the hash of a member is that of its
    number. So `member in {"CONTACT"}` is False; `member.name in {"CONTACT"}` is right, and so are
    sets of members.
    """

    def __eq__(self, other: object) -> bool:
        this: Any = self
        if isinstance(other, (str, bytes)):
            kind: Any = type(self)
            return int(this) == int(member_of(kind, other))
        return int(this) == other

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        this: Any = self
        return hash(int(this))

    def __str__(self) -> str:
        this: Any = self
        return this.name

    def __format__(self, spec: str) -> str:
        this: Any = self
        return format(int(this), spec) if spec else str(self)


class Outcome(_Named, enum.IntEnum):
    """The result of comparing a pair's distance with the margin.

    A member equals its number and its name: `pair.outcome == "CONTACT"`. In a set or a dict only
    the number or the member is found: write `pair.outcome.name in {"CONTACT", "SEPARATED"}`.
    """

    #: The hulls are within the margin of each other, to rounding.
    CONTACT = 1
    #: The hulls are certified to be farther apart than the margin.
    SEPARATED = 2
    #: A search reached its iteration limit, or stopped making progress, before it was decided.
    UNDECIDED = 3
    #: The pair was not computed; the flags say why. Its numbers are NaN, and it has no points.
    INVALID = 4


class Flag(_Named, enum.IntFlag):
    """Qualifications of a pair's numbers. A newer server may set further bits.

    A member equals its number and its name, as those of `Outcome` do.
    """

    #: The projected features do not meet, so the pair has one estimated contact point.
    ESTIMATED = 1
    #: The contraction points coincide to rounding: alpha is 0 and the normal is arbitrary.
    COINCIDENT = 2
    #: The bracket of alpha is wider than the requested tolerance.
    GAP_OPEN = 4
    #: Some contact points were dropped because of `max_points`.
    REDUCED = 8
    #: The server does not have one of the hulls: register it.
    UNKNOWN_HULL = 16
    #: The server's store could not be read: retry.
    HULL_UNAVAILABLE = 32
    #: One of the bodies has an unusable position or rotation.
    INVALID_BODY = 64
    #: The gradient is not unique. Only set if the query requested a derivative.
    KINK = 128

    def __str__(self) -> str:
        names = [str(flag.name) for flag in Flag if flag & self]
        unknown = int(self) & ~sum(Flag)
        return "|".join([*names, *([str(unknown)] if unknown else [])]) or "-"


class FeatureKind(_Named, enum.IntEnum):
    """The kind of a hull's feature that touches the other hull.

    A member equals its number and its name, as those of `Outcome` do.
    """

    NONE = 0
    VERTEX = 1
    EDGE = 2
    FACE = 3


#: The columns of the wire format that each output brings.
OUTPUT_COLUMNS: dict[str, tuple[str, ...]] = {
    "OUTCOME": (),
    "ALPHA": ("alphas", "alpha_lowers", "alpha_uppers"),
    "NORMAL": ("normals", "separations"),
    "POINTS": ("point_counts", "witness_as", "distances"),
    "WITNESS_B": ("point_counts", "witness_bs"),
    "FEATURES": ("point_counts", "feature_kinds", "feature_indices", "point_ids"),
    "BASES": ("bases",),
    "DIAGNOSTICS": ("iterations", "support_calls", "kept_areas"),
    "MATCHES": ("point_counts", "previous_pairs", "previous_points"),
    "ALPHA_GRADIENT": ("alpha_gradients", "gradient_errors"),
    "SEPARATION_GRADIENT": ("separation_gradients", "gradient_errors"),
    "NORMAL_JACOBIAN": ("normal_jacobians", "gradient_errors"),
}
DEFAULT_OUTPUTS = ("ALPHA", "NORMAL", "POINTS")

#: The number of entries per pair of each per-pair column.
PAIR_COLUMNS = {
    "alphas": 1,
    "alpha_lowers": 1,
    "alpha_uppers": 1,
    "separations": 1,
    "normals": 3,
    "point_counts": 1,
    "feature_kinds": 2,
    "feature_indices": 4,
    "bases": 6,
    "iterations": 1,
    "support_calls": 1,
    "kept_areas": 1,
    "previous_pairs": 1,
    "alpha_gradients": 9,
    "separation_gradients": 9,
    "normal_jacobians": 27,
    "gradient_errors": 1,
}
#: Columns that servers of the first version of the protocol do not send. They are read as NaN, or
#: as 2^32 - 1 if they have indices.
LATER_COLUMNS = frozenset({
    "kept_areas", "previous_pairs", "previous_points", "alpha_gradients", "separation_gradients",
    "normal_jacobians", "gradient_errors",
})  # fmt: skip
#: The number of entries per point of each per-point column.
POINT_COLUMNS = {
    "witness_as": 3,
    "distances": 1,
    "witness_bs": 3,
    "point_ids": 4,
    "previous_points": 1,
}
#: On the wire, the index of a row or a point that has no predecessor.
NONE = 2**32 - 1
#: The contract number from which a server knows `find`, `moved`, `previous_bodies`, MATCHES, the
#: margins of bodies, and velocities.
LOOP_CONTRACT = 1

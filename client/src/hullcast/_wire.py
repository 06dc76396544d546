"""Names for the numbers and the columns of the wire format."""

from __future__ import annotations

import enum


class _Named(enum.IntEnum):
    """An enum whose members equal their number and their name, in upper or lower case."""

    def __eq__(self, other: object) -> bool:
        if isinstance(other, str):
            return self.name == other.upper()
        return int(self) == other

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash(int(self))

    def __str__(self) -> str:
        return self.name

    def __format__(self, spec: str) -> str:
        return format(int(self), spec) if spec else self.name


class Outcome(_Named):
    """The result of comparing a pair's distance with the margin."""

    #: The hulls are within the margin of each other, to rounding.
    CONTACT = 1
    #: The hulls are certified to be farther apart than the margin.
    SEPARATED = 2
    #: A search reached its iteration limit, or stopped making progress, before it was decided.
    UNDECIDED = 3
    #: The pair was not computed; the flags say why. Its numbers are NaN, and it has no points.
    INVALID = 4


class Flag(enum.IntFlag):
    """Qualifications of a pair's numbers. A newer server may set further bits."""

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


class FeatureKind(_Named):
    """The kind of a hull's feature that touches the other hull."""

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
}
#: Columns that servers of the first version of the protocol do not send; they are read as NaN.
LATER_COLUMNS = frozenset({"kept_areas"})
#: The number of entries per point of each per-point column.
POINT_COLUMNS = {"witness_as": 3, "distances": 1, "witness_bs": 3, "point_ids": 4}

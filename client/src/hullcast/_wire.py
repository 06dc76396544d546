"""The numbers and columns of the wire, by name."""

from __future__ import annotations

import enum


class _Named(enum.IntEnum):
    """Compares with its number and with its name, of either case."""

    def __eq__(self, other: object) -> bool:
        if isinstance(other, str):
            return self.name == other.upper()
        return int(self) == other

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash(int(self))


class Outcome(_Named):
    """What is known of a pair's distance and the margin."""

    #: Within the margin, to rounding.
    CONTACT = 1
    #: Certified farther apart than the margin.
    SEPARATED = 2
    #: An iteration limit was met before the outcome was known.
    UNDECIDED = 3
    #: Not answered: the flags say why. Numbers are NaN, no points.
    INVALID = 4


class Flag(enum.IntFlag):
    """What a pair's numbers have to be read with; a newer server may set others."""

    #: The projected features miss each other: one estimated point.
    ESTIMATED = 1
    #: The centres coincide to rounding: alpha is 0, the normal arbitrary.
    COINCIDENT = 2
    #: The bracket of alpha is wider than asked.
    GAP_OPEN = 4
    #: `max_points` dropped points.
    REDUCED = 8
    #: A hull that the server does not have: register it.
    UNKNOWN_HULL = 16
    #: The server's store could not be read: try again.
    HULL_UNAVAILABLE = 32
    #: A body's position or rotation is not usable.
    INVALID_BODY = 64


class FeatureKind(_Named):
    """What of a hull touches."""

    NONE = 0
    VERTEX = 1
    EDGE = 2
    FACE = 3


#: Of each output: the columns of the wire that it brings.
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

#: Of each column: entries a pair, or a point.
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
#: What servers of the first contract do not send: unknown (NaN) then.
LATER_COLUMNS = frozenset({"kept_areas"})
POINT_COLUMNS = {"witness_as": 3, "distances": 1, "witness_bs": 3, "point_ids": 4}

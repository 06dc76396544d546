"""The contacts of a step in the solver's form, by growth distance from the server."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import hullcast

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Ids = npt.NDArray[np.uint32]
Rows = npt.NDArray[np.int64]


@dataclass
class Contacts:
    """Pairs of bodies and their contact points, pair after pair; world frame, metres."""

    #: (n, 2): the bodies A and B.
    pairs: Ids
    #: (n,): the number of points of each pair.
    counts: Indices
    #: (n, 3): unit normals from A to B.
    normal: Floats
    #: (p, 3): the points midway between the two hulls.
    point: Floats
    #: (p,): signed distances along the normal; negative means overlap.
    distance: Floats
    #: (p, 4): the id of each point, which stays the same while the same features make the point.
    #: None for the server's contacts, whose points the server compares with those of the last step.
    ids: Ids | None = None


def by_growth_distance(m: hullcast.Manifolds) -> Contacts:
    """Converts the server's result without changing it."""
    of = np.repeat(np.arange(len(m)), m.point_counts)
    point = m.witness_a + 0.5 * m.distance[:, None] * m.normal[of]
    counts = m.point_counts.astype(np.intp)
    return Contacts(m.pairs, counts, m.normal, point, m.distance)


def as_manifolds(found: Contacts, m: hullcast.Manifolds) -> hullcast.Manifolds:
    """The contacts as an answer for the pairs of `m`, for a comparison by `hullcast.match`."""
    assert found.ids is not None
    of = np.repeat(np.arange(len(found.pairs)), found.counts)
    columns = {
        "outcomes": np.full(len(found.pairs), int(hullcast.Outcome.CONTACT), dtype="u1"),
        "flags": np.zeros(len(found.pairs), dtype="u1"),
        "pairs": found.pairs,
        "missing_hulls": m.missing_hulls,
        "invalid_bodies": m.invalid_bodies,
        "normals": found.normal,
        "point_counts": found.counts.astype("<u4"),
        "witness_as": found.point - 0.5 * found.distance[:, None] * found.normal[of],
        "distances": found.distance,
        "point_ids": found.ids,
    }
    return hullcast.Manifolds(columns, m.scene)


def frames(normal: Floats) -> Floats:
    """(n, 3, 3): each normal (n, 3) and two unit tangents, right-handed."""
    helper = np.where(np.abs(normal[:, :1]) < 0.6, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = np.cross(normal, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.array([normal, first, np.cross(normal, first)], dtype=np.float64).swapaxes(0, 1)

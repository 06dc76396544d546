"""The columns of a result, by the names that callers use."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from . import _arguments
from ._arrays import Floats, Indices
from ._errors import InvalidArgument, OutputNotAsked
from ._names import FeatureKindArray, FlagArray, OutcomeArray
from ._scene import Scene
from ._settled import Settled
from ._wire import Outcome


class ManifoldColumns(Settled):
    """The columns of `Manifolds`, whose docstring explains their rows."""

    _instead: ClassVar[dict[str, str]] = {"": "copy the columns that you want to change"}

    #: (n,): each pair's outcome, uint8. Compare it with `Outcome` or with a name, such as
    #: "CONTACT"; `np.isin` tests for several names, and `astype(str)` gives the names. pandas takes
    #: the column for numbers, which equal no name: use `to_dataframe`.
    outcome: OutcomeArray
    #: (n,): the bits of `Flag` of each pair, uint8.
    flags: FlagArray
    #: (n, 2): the body indices A and B of each pair.
    pairs: Indices
    #: The indices into `Scene.hull_ids` of the hulls that the server could not use, ascending.
    missing_hulls: Indices
    #: The indices of the bodies with an unusable pose, ascending.
    invalid_bodies: Indices

    def __init__(self, columns: Mapping[str, np.ndarray], scene: Scene | None = None) -> None:
        self._columns = dict(columns)
        self._scene = scene
        self._restarted = False
        self._set(
            outcome=self._columns["outcomes"].view(OutcomeArray),
            flags=self._columns["flags"].view(FlagArray),
            pairs=self._columns["pairs"],
            missing_hulls=self._columns["missing_hulls"],
            invalid_bodies=self._columns["invalid_bodies"],
        )

    @property
    def scene(self) -> Scene | None:
        """The scene of the query; None if the manifolds were loaded from a file.

        It can be assigned, so that manifolds from a file can be drawn.
        """
        return self._scene

    @scene.setter
    def scene(self, scene: Scene | None) -> None:
        if scene is not None:
            _arguments.instance("scene", scene, Scene, "a hullcast.Scene or None")
            last = int(self.pairs.max(initial=0))
            if last >= len(scene) and self.pairs.size:
                raise InvalidArgument(
                    f"got a scene with {_arguments.counted(len(scene), 'body', 'bodies')}, "
                    f"expected the scene of these pairs, which name body {last}",
                    reason="LENGTH_MISMATCH",
                    field="scene",
                )
        self._scene = scene

    @property
    def restarted(self) -> bool:
        """Whether a session began anew with this answer, and so has nothing to compare it with.

        It is True for the first step, after a step that failed, after the server was lost or had no
        room for the session's state, and after an update without `previous`. If the session has
        several streams, it is True if one of them began anew. It is False for `query` and `find`.
        """
        return self._restarted

    def _column(self, wire: str, name: str, output: str) -> np.ndarray:
        try:
            return self._columns[wire]
        except KeyError:
            raise OutputNotAsked(name, output) from None

    @property
    def in_contact(self) -> npt.NDArray[np.bool_]:
        """(n,): whether each pair's outcome is CONTACT: the hulls are within the margin."""
        return np.equal(self.outcome, Outcome.CONTACT)

    @property
    def alpha(self) -> Floats:
        """(n,): the growth scale: below 1 if the hulls overlap, above 1 if they are apart.

        For SEPARATED pairs it is a certified lower bound.
        """
        return self._column("alphas", "alpha", "ALPHA")

    @property
    def alpha_lower(self) -> Floats:
        """(n,): the certified lower end of the growth scale's bracket."""
        return self._column("alpha_lowers", "alpha_lower", "ALPHA")

    @property
    def alpha_upper(self) -> Floats:
        """(n,): the certified upper end of the growth scale's bracket; infinity if SEPARATED."""
        return self._column("alpha_uppers", "alpha_upper", "ALPHA")

    @property
    def normal(self) -> Floats:
        """(n, 3): unit vectors from A to B; for SEPARATED pairs the separating direction."""
        return self._column("normals", "normal", "NORMAL")

    @property
    def separation(self) -> Floats:
        """(n,): the signed separation along the normal, negative when the hulls overlap.

        For SEPARATED pairs it is a certified lower bound of the distance.
        """
        return self._column("separations", "separation", "NORMAL")

    @property
    def point_counts(self) -> Indices:
        """(n,): the number of contact points of each pair."""
        return self._column("point_counts", "point_counts", "POINTS")

    @property
    def point_offsets(self) -> npt.NDArray[np.int64]:
        """(n + 1,): the row at which each pair's points begin; the last entry is p."""
        offsets = self._columns.get("point_offsets")
        if offsets is None:
            counts = self._column("point_counts", "point_offsets", "POINTS")
            offsets = np.zeros(len(counts) + 1, dtype=np.int64)
            np.cumsum(counts, out=offsets[1:])
            self._columns["point_offsets"] = offsets
        return offsets

    @property
    def witness_a(self) -> Floats:
        """(p, 3): the witness points on A."""
        return self._column("witness_as", "witness_a", "POINTS")

    @property
    def witness_b(self) -> Floats:
        """(p, 3): the witness points on B.

        They are computed as `witness_a + distance * normal` unless the query requested WITNESS_B.
        """
        points = self._columns.get("witness_bs")
        if points is None:
            distance = self._column("distances", "witness_b", "POINTS")
            normal = self._column("normals", "witness_b", "NORMAL")
            points = distance[:, None] * np.repeat(normal, self.point_counts, axis=0)
            points += self.witness_a
            self._columns["witness_bs"] = points
        return points

    @property
    def distance(self) -> Floats:
        """(p,): the signed distance of each contact point along the pair's normal."""
        return self._column("distances", "distance", "POINTS")

    @property
    def point_ids(self) -> Indices:
        """(p, 4): an id of each point, from the features that make it.

        An id has two vertex indices of A, then two of B. An edge is named by its two vertices, and
        a vertex by its index twice. If the point is inside a face of a hull, both entries of that
        hull are 2^32 - 1. The id of a point stays the same while the same features make it. Indices
        refer to the registered points.
        """
        return self._column("point_ids", "point_ids", "FEATURES")

    @property
    def feature_kinds(self) -> FeatureKindArray:
        """(n, 2): the `FeatureKind` of A and of B.

        Compare it with `FeatureKind` or a name ("FACE").
        """
        column = self._column("feature_kinds", "feature_kinds", "FEATURES")
        return column.view(FeatureKindArray)

    @property
    def feature_indices(self) -> Indices:
        """(n, 4): the touching feature of A (two entries) and of B (two entries).

        A face has its index in `Hull.faces`, an edge its two vertices, and a vertex its index.
        Unused entries are 2^32 - 1.
        """
        return self._column("feature_indices", "feature_indices", "FEATURES")

    @property
    def bases(self) -> Indices:
        """(n, 6): the optimal triple of vertex pairs, as A0 A1 A2 B0 B1 B2; 2^32 - 1 if none."""
        return self._column("bases", "bases", "BASES")

    @property
    def iterations(self) -> Indices:
        """(n,): the number of solver iterations for each pair."""
        return self._column("iterations", "iterations", "DIAGNOSTICS")

    @property
    def support_calls(self) -> Indices:
        """(n,): the number of support mapping calls for each pair; each hull counts separately."""
        return self._column("support_calls", "support_calls", "DIAGNOSTICS")

    @property
    def kept_area(self) -> Floats:
        """(n,): the share of each contact patch's area that its points span: 1 unless `REDUCED`.

        It is NaN if the server is too old to send this column.
        """
        return self._column("kept_areas", "kept_area", "DIAGNOSTICS")

    @property
    def previous_pairs(self) -> npt.NDArray[np.int64]:
        """(n,): the row that each pair had in the previous step's answer; -1 if it had none.

        Only CONTACT and UNDECIDED pairs have one, and only if they were in contact or undecided in
        the step before.
        """
        return self._column("previous_pairs", "previous_pairs", "MATCHES")

    @property
    def previous_points(self) -> npt.NDArray[np.int64]:
        """(p,): the row that each point had among the previous step's points; -1 if it had none.

        The row is one of the columns of points, such as `distance`. So values of points, with a
        row of zeros for the points that are new, are carried over by

            impulses = np.concatenate([impulses, np.zeros((1, 3))])[m.previous_points]

        Points match by their ids, and points whose features have changed by the distance that they
        have moved on both bodies.
        """
        return self._column("previous_points", "previous_points", "MATCHES")

    @property
    def ended_pairs(self) -> Indices:
        """(k, 2): the pairs that were in contact or undecided in the step before, and are not now.

        They are the body indices of the step before.
        """
        return self._column("ended_pairs", "ended_pairs", "MATCHES")

    @property
    def alpha_gradient(self) -> Floats:
        """(n, 9): the gradient of `alpha`.

        Entries 0 to 2 are by a translation of B relative to A, 3 to 5 by a rotation of A, and 6 to
        8 by a rotation of B, along the world's axes. A rotation is about the origin of the body's
        frame, in radians. A pair without a basis has NaN; every SEPARATED pair is one. With the
        flag KINK, the gradient is not unique. docs/python/derivatives.md explains how to use it.
        """
        return self._column("alpha_gradients", "alpha_gradient", "ALPHA_GRADIENT")

    @property
    def separation_gradient(self) -> Floats:
        """(n, 9): the gradient of `separation`, with the entries of `alpha_gradient`."""
        return self._column("separation_gradients", "separation_gradient", "SEPARATION_GRADIENT")

    @property
    def normal_jacobian(self) -> Floats:
        """(n, 3, 9): the derivative of each coordinate of `normal`, as in `alpha_gradient`."""
        column = self._column("normal_jacobians", "normal_jacobian", "NORMAL_JACOBIAN")
        return column.reshape(len(column), 3, 9)

    @property
    def gradient_error(self) -> Floats:
        """(n,): a bound of the rounding error of the derivatives, relative to their sizes.

        It is infinite if the centres coincide or the bracket is open. The page
        docs/python/derivatives.md states the sizes.
        """
        return self._column("gradient_errors", "gradient_error", "ALPHA_GRADIENT")

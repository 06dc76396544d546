"""The answer: columns, one entry a pair or a point."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, cast, overload

import numpy as np
import numpy.typing as npt

from . import _arguments, _export, _tensors
from ._arguments import kind
from ._arrays import Floats, Indices
from ._errors import InvalidArgument, OutputNotAsked
from ._export import Padded
from ._names import FeatureKindArray, FlagArray, OutcomeArray
from ._scene import Scene
from ._wire import FeatureKind, Flag, Outcome


class Manifolds:
    """Contact manifolds of a batch of pairs, as columns.

    `len(m)` pairs. Per-pair columns have one row a pair; the points of pair `i`
    are rows `point_offsets[i]` to `point_offsets[i + 1]` of the per-point ones.
    `m[i]` is one pair's `Manifold`; `m[1:5]`, `m[indices]` and `m[mask]` are the
    `Manifolds` of some pairs.

    World frame, the caller's units. The normal points from A to B; separations
    and distances are negative when overlapping.

    Raises:
        OutputNotAsked: on reading a column that the query did not ask for.
    """

    def __init__(self, columns: Mapping[str, np.ndarray], scene: Scene | None = None) -> None:
        self._columns = dict(columns)
        #: The scene that the query was about; None if the answer was loaded from a file.
        self.scene = scene
        #: Outcome of each pair, uint8: compare with `Outcome` or with a name, such as "CONTACT".
        self.outcome: OutcomeArray = self._columns["outcomes"].view(OutcomeArray)
        #: Bits of `Flag` of each pair, uint8.
        self.flags: FlagArray = self._columns["flags"].view(FlagArray)
        #: (n, 2): body indices A, B.
        self.pairs: Indices = self._columns["pairs"]
        #: Indices into `Scene.hull_ids` that were not answered for, ascending.
        self.missing_hulls: Indices = self._columns["missing_hulls"]
        #: Bodies with an unusable pose, ascending.
        self.invalid_bodies: Indices = self._columns["invalid_bodies"]

    def _column(self, wire: str, name: str, output: str) -> np.ndarray:
        try:
            return self._columns[wire]
        except KeyError:
            raise OutputNotAsked(name, output) from None

    @property
    def in_contact(self) -> npt.NDArray[np.bool_]:
        """Whether each pair's outcome is CONTACT: within the margin."""
        return np.equal(self.outcome, Outcome.CONTACT)

    @property
    def alpha(self) -> Floats:
        """Growth scale: below 1 overlapping, above 1 apart; of SEPARATED pairs a lower bound."""
        return self._column("alphas", "alpha", "ALPHA")

    @property
    def alpha_lower(self) -> Floats:
        """Certified: the exact growth scale is not below it."""
        return self._column("alpha_lowers", "alpha_lower", "ALPHA")

    @property
    def alpha_upper(self) -> Floats:
        """Certified: the exact growth scale is not above it; infinity for SEPARATED pairs."""
        return self._column("alpha_uppers", "alpha_upper", "ALPHA")

    @property
    def normal(self) -> Floats:
        """(n, 3): unit, from A to B; of SEPARATED pairs the separating direction."""
        return self._column("normals", "normal", "NORMAL")

    @property
    def separation(self) -> Floats:
        """Signed, along the normal; of SEPARATED pairs a certified lower bound of the distance."""
        return self._column("separations", "separation", "NORMAL")

    @property
    def point_counts(self) -> Indices:
        """Points of each pair."""
        return self._column("point_counts", "point_counts", "POINTS")

    @property
    def point_offsets(self) -> npt.NDArray[np.int64]:
        """(n + 1,): where each pair's points start, and where the last one's end."""
        offsets = self._columns.get("point_offsets")
        if offsets is None:
            counts = self._column("point_counts", "point_offsets", "POINTS")
            offsets = np.zeros(len(counts) + 1, dtype=np.int64)
            np.cumsum(counts, out=offsets[1:])
            self._columns["point_offsets"] = offsets
        return offsets

    @property
    def witness_a(self) -> Floats:
        """(p, 3): the point on A, world frame."""
        return self._column("witness_as", "witness_a", "POINTS")

    @property
    def witness_b(self) -> Floats:
        """(p, 3): the point on B: `witness_a + distance * normal`, computed unless asked for."""
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
        """(p,): signed, along the pair's normal."""
        return self._column("distances", "distance", "POINTS")

    @property
    def point_ids(self) -> Indices:
        """(p, 4): A's edge (or vertex twice), B's: the same while they make the point.

        Indices as registered; 2^32 - 1 twice where the point is inside that hull's face.
        """
        return self._column("point_ids", "point_ids", "FEATURES")

    @property
    def feature_kinds(self) -> FeatureKindArray:
        """(n, 2): `FeatureKind` of A and of B; compare with it or with a name, such as "FACE"."""
        column = self._column("feature_kinds", "feature_kinds", "FEATURES")
        return column.view(FeatureKindArray)

    @property
    def feature_indices(self) -> Indices:
        """(n, 4): A's two and B's two: face, edge's vertices or vertex; 2^32 - 1 where unused."""
        return self._column("feature_indices", "feature_indices", "FEATURES")

    @property
    def bases(self) -> Indices:
        """(n, 6): the optimal triple of vertex pairs A0 A1 A2 B0 B1 B2; 2^32 - 1: none."""
        return self._column("bases", "bases", "BASES")

    @property
    def iterations(self) -> Indices:
        """Solver iterations of each pair."""
        return self._column("iterations", "iterations", "DIAGNOSTICS")

    @property
    def support_calls(self) -> Indices:
        """Support mapping calls of each pair, each hull counted."""
        return self._column("support_calls", "support_calls", "DIAGNOSTICS")

    @property
    def kept_area(self) -> Floats:
        """Share of each patch's area that its points still span: 1 unless `REDUCED`.

        NaN: the server is older than this column.
        """
        return self._column("kept_areas", "kept_area", "DIAGNOSTICS")

    def __len__(self) -> int:
        return len(self.outcome)

    @overload
    def __getitem__(self, pair: int | np.integer[Any]) -> Manifold: ...
    @overload
    def __getitem__(
        self, pair: slice | Sequence[int] | npt.NDArray[np.integer[Any] | np.bool_]
    ) -> Manifolds: ...
    def __getitem__(self, pair: Any) -> Manifold | Manifolds:
        if isinstance(pair, (int, np.integer)):
            # Negative ones too, and IndexError past the end.
            return Manifold(self, range(len(self))[int(cast("int", pair))])
        chosen = np.arange(len(self))[pair]
        return Manifolds(_export.take(self._columns, chosen), self.scene)

    def contacts_of(self, body: int) -> Manifolds:
        """The pairs in which `body` has contact points, turned so that it is A.

        So `pairs[:, 1]` are the bodies it meets, and the normals point away from
        it. Needs the outputs NORMAL and POINTS.
        """
        touching = (self.pairs == body).any(axis=1) & (self.point_counts > 0)
        chosen = self[np.flatnonzero(touching)]
        chosen._columns["witness_bs"] = chosen.witness_b
        turned = _export.turned(chosen._columns, chosen.pairs[:, 0] != body)
        return Manifolds(turned, self.scene)

    def padded(self, k: int) -> Padded:
        """The points as dense arrays of `k` slots a pair, the deepest where there are more.

        Needs the output POINTS.
        """
        with_b = "witness_bs" in self._columns or "normals" in self._columns
        return _export.padded(
            self.point_counts,
            self.distance,
            self.witness_a,
            self.witness_b if with_b else None,
            self._columns.get("point_ids"),
            k,
        )

    def to_dataframe(self, rows: str = "points") -> Any:
        """A pandas data frame of the columns that were asked for.

        Args:
            rows: "points": one row a contact point, with its pair's columns, so
                that pairs without points have none; "pairs": one row a pair.

        Raises:
            ImportError: pandas is not installed.
        """
        if rows == "points":
            self._column("point_counts", "points", "POINTS")
        return _export.dataframe(self._columns, rows)

    def to_torch(self) -> dict[str, Any]:
        """The columns that were asked for as torch tensors on the CPU, by their attributes' names.

        They share the columns' memory. `tensor.to("cuda")` copies one to a device.

        Raises:
            ImportError: torch is not installed.
        """
        return _tensors.to_torch(self._arrays())

    def to_jax(self) -> dict[str, Any]:
        """The columns that were asked for as jax arrays, by their attributes' names.

        jax keeps 64 bits only with its setting `jax_enable_x64`.

        Raises:
            ImportError: jax is not installed.
        """
        return _tensors.to_jax(self._arrays())

    def _arrays(self) -> dict[str, np.ndarray]:
        """The columns by their attributes' names."""
        single = {name: name.removesuffix("s") for name in self._columns}
        return {
            single[name] if hasattr(self, single[name]) else name: column
            for name, column in self._columns.items()
        }

    @classmethod
    def concat(cls, manifolds: Iterable[Manifolds]) -> Manifolds:
        """The pairs of several answers as one, in their order.

        The numbers of bodies are kept as they are. The scene is kept if all answers
        have the same one. All answers need the same outputs.

        Raises:
            InvalidArgument: there is none, or the outputs differ.
        """
        from . import _answers  # which loads protobuf

        if isinstance(manifolds, (Manifolds, Manifold, str, Mapping)) or not isinstance(
            manifolds, Iterable
        ):
            raise InvalidArgument(
                f"expected a list of Manifolds, got {kind(manifolds)}",
                reason="WRONG_TYPE",
                field="manifolds",
            )
        parts = list(manifolds)
        for i, part in enumerate(parts):
            _arguments.instance(f"manifolds[{i}]", part, Manifolds, "Manifolds")
        if not parts:
            raise InvalidArgument(
                "expected one or more, got none", reason="EMPTY", field="manifolds"
            )
        # What was computed from other columns is computed again.
        derived = ("point_offsets", "witness_bs")
        kept = [name for name in parts[0]._columns if name not in derived]
        if all("witness_bs" in part._columns for part in parts):
            kept.append("witness_bs")
        for i, part in enumerate(parts):
            odd = {name for name in part._columns if name not in derived} ^ (
                set(kept) - set(derived)
            )
            if odd:
                raise InvalidArgument(
                    f"{min(odd)} is not in every answer: expected the same outputs in all",
                    reason="OTHER_OUTPUTS",
                    field="manifolds",
                    index=i,
                )
        scene = parts[0].scene if all(part.scene is parts[0].scene for part in parts) else None
        columns = [{name: part._columns[name] for name in kept} for part in parts]
        return cls(_answers.merge(columns), scene)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the columns as a numpy `npz` file, without the scene."""
        _export.save(path, self._columns)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Manifolds:
        """What `save` wrote.

        Raises:
            InvalidArgument: NOT_MANIFOLDS, another kind of file.
        """
        return cls(_export.load(path))

    def plot(
        self,
        *,
        pairs: npt.ArrayLike | None = None,
        path: str | os.PathLike[str] | None = None,
        ax: Any = None,
    ) -> Any:
        """A picture of bodies and contacts, by matplotlib (extra `plot`); needs no display.

        Hulls, their patches' polygons, normals and witness pairs, the points
        coloured by distance. Needs the outputs NORMAL and POINTS. A notebook shows the
        picture if the call is the last line of a cell.

        Args:
            pairs: indices of the pairs to draw; by default all.
            path: where the picture is written too, such as "contacts.png".
            ax: matplotlib axes with projection="3d" to draw into; by default new ones.

        Returns:
            The `matplotlib.figure.Figure`.
        """
        from . import _plot

        shown, bodies, scene = self._drawn(pairs)
        points = shown._drawn_points()
        return _plot.picture(bodies, shown.pairs, shown.normal, points, scene, path, ax)

    def log(
        self,
        path: str = "hullcast",
        *,
        pairs: npt.ArrayLike | None = None,
        hulls: bool = True,
        recording: Any = None,
    ) -> None:
        """Writes bodies and contacts into a rerun recording (extra `rerun`).

        Hulls, their patches' outlines, normals (labelled with the pair's bodies) and
        witness pairs, the points red where they overlap, blue where they are apart.
        The same path again, at another time of the recording, shows the next step.
        Needs the outputs NORMAL and POINTS.

        Args:
            path: the entity under which all is written.
            pairs: indices of the pairs to write; by default all.
            hulls: whether to write the bodies' hulls and not their poses alone; in
                a loop the first step does for all.
            recording: a `rerun.RecordingStream`; by default the current one.
        """
        from . import _rerun

        shown, bodies, scene = self._drawn(pairs)
        points = shown._drawn_points()
        _rerun.log(bodies, shown.pairs, shown.normal, points, scene, path, hulls, recording)

    def _drawn(
        self, pairs: npt.ArrayLike | None
    ) -> tuple[Manifolds, npt.NDArray[np.uint32], Scene]:
        """The pairs to draw, their bodies that have a pose, and the scene."""
        if self.scene is None:
            raise InvalidArgument("a loaded answer has no scene", reason="NO_SCENE", field="scene")
        shown = self if pairs is None else self[np.asarray(pairs)]
        return shown, np.setdiff1d(shown.pairs, self.invalid_bodies), self.scene

    def _drawn_points(self) -> _export.Columns:
        return {
            "point_counts": self.point_counts,
            "witness_as": self.witness_a,
            "witness_bs": self.witness_b,
            "distances": self.distance,
        }

    def __iter__(self) -> Iterator[Manifold]:
        return (Manifold(self, i) for i in range(len(self)))

    def __repr__(self) -> str:
        counts = ", ".join(
            f"{count} {outcome.name}"
            for outcome in Outcome
            if (count := int(np.count_nonzero(self.outcome == int(outcome))))
        )
        text = f"{len(self)} pair{'' if len(self) == 1 else 's'}: {counts or 'none'}"
        if "point_counts" in self._columns:
            points = int(self.point_offsets[-1])
            text += f"; {points} point{'' if points == 1 else 's'}"
        if flags := int(np.bitwise_or.reduce(self.flags, initial=0)):
            text += f"; flags {Flag(flags)!r}"
        return f"Manifolds({text})"


class Manifold:
    """One pair of a `Manifolds`: the same names, this pair's entries."""

    __slots__ = ("_all", "index")

    def __init__(self, all: Manifolds, index: int) -> None:
        self._all = all
        #: The pair's place in the batch.
        self.index = index

    def _points(self) -> slice:
        start, stop = self._all.point_offsets[self.index : self.index + 2]
        return slice(int(start), int(stop))

    @property
    def bodies(self) -> tuple[int, int]:
        """Body indices A, B."""
        a, b = self._all.pairs[self.index]
        return int(a), int(b)

    @property
    def outcome(self) -> Outcome:
        """Within the margin or beyond."""
        return Outcome(int(self._all.outcome[self.index]))

    @property
    def flags(self) -> Flag:
        """What the numbers have to be read with."""
        return Flag(int(self._all.flags[self.index]))

    @property
    def alpha(self) -> float:
        """Growth scale."""
        return float(self._all.alpha[self.index])

    @property
    def alpha_lower(self) -> float:
        """Certified lower end of its bracket."""
        return float(self._all.alpha_lower[self.index])

    @property
    def alpha_upper(self) -> float:
        """Certified upper end of its bracket."""
        return float(self._all.alpha_upper[self.index])

    @property
    def normal(self) -> Floats:
        """(3,): unit, world frame, from A to B."""
        return self._all.normal[self.index]

    @property
    def separation(self) -> float:
        """Signed, along the normal."""
        return float(self._all.separation[self.index])

    @property
    def witness_a(self) -> Floats:
        """(k, 3): the points on A."""
        return self._all.witness_a[self._points()]

    @property
    def witness_b(self) -> Floats:
        """(k, 3): the points on B."""
        return self._all.witness_b[self._points()]

    @property
    def distance(self) -> Floats:
        """(k,): signed, along the normal."""
        return self._all.distance[self._points()]

    @property
    def point_ids(self) -> Indices:
        """(k, 4): what made each point."""
        return self._all.point_ids[self._points()]

    @property
    def feature_kinds(self) -> tuple[FeatureKind, FeatureKind]:
        """Of A and of B."""
        a, b = self._all.feature_kinds[self.index]
        return FeatureKind(int(a)), FeatureKind(int(b))

    @property
    def feature_indices(self) -> Indices:
        """(4,): A's two, B's two."""
        return self._all.feature_indices[self.index]

    def __repr__(self) -> str:
        parts = [f"bodies={self.bodies}", self.outcome.name]
        if self.flags:
            parts.append(f"flags={self.flags!r}")
        for name in ("alpha", "normal", "separation", "witness_a", "distance"):
            if hasattr(self, name):
                parts.append(f"{name}={getattr(self, name)}")
        return f"Manifold({', '.join(parts)})"

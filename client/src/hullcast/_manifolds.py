"""The result of a query: columns with one entry per pair or per contact point."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, cast, overload

import numpy as np
import numpy.typing as npt

from . import _arguments, _export, _numbers
from ._arguments import iterable, kind
from ._arrays import Floats, Indices
from ._errors import InvalidArgument, PairOutOfRange
from ._export import Padded
from ._scene import Scene
from ._views import ManifoldViews, frames
from ._wire import FeatureKind, Flag, Outcome


class Manifolds(ManifoldViews):
    """The contact manifolds of a batch of pairs, as columns.

    `len(m)` is the number of pairs. A per-pair column has one row per pair. In a per-point column,
    the points of pair `i` are the rows `point_offsets[i]` to `point_offsets[i + 1]`. `m[i]` is the
    `Manifold` of one pair; `m[1:5]`, `m[indices]` and `m[mask]` are the `Manifolds` of some pairs.

    The points of a pair are in order around its patch, anticlockwise about the normal.

    Vectors are in the world frame, lengths in the caller's units. The normal points from A to B.
    Separations and distances are negative when the hulls overlap.

    In the shapes below, n is the number of pairs and p the number of contact points.

    Raises:
        OutputNotAsked: a column is read that the query did not request.
    """

    def __len__(self) -> int:
        return len(self.outcome)

    @overload
    def __getitem__(self, pair: int | np.integer[Any]) -> Manifold: ...
    @overload
    def __getitem__(
        self, pair: slice | Sequence[int] | npt.NDArray[np.integer[Any] | np.bool_]
    ) -> Manifolds: ...
    def __getitem__(self, pair: Any) -> Manifold | Manifolds:
        pair = _arguments.plain(pair)
        if isinstance(pair, (int, np.integer)) and not isinstance(pair, bool):
            index = int(cast("int", pair))
            if not -len(self) <= index < len(self):
                raise self._out_of_range(index)
            return Manifold(self, index % len(self))
        chosen = self._chosen("index", pair)
        return self._with(_export.take(self._columns, chosen))

    def _with(self, columns: Mapping[str, np.ndarray]) -> Manifolds:
        """Manifolds of the same answer with other columns."""
        found = Manifolds(columns, self.scene)
        found._restarted = self._restarted
        return found

    def _chosen(self, field: str, pairs: Any) -> npt.NDArray[np.intp]:
        """The indices of the pairs that a slice, indices or a mask selects, from 0.

        Raises:
            PairOutOfRange: INDEX_OUT_OF_RANGE, or NOT_INTEGERS for an object of another kind.
            InvalidArgument: NO_ORDER, a set.
        """
        count = len(self)
        _arguments.ordered(field, pairs)
        expected = f"an integer, a slice, integers (k,) or a mask ({count},)"
        try:
            if isinstance(pairs, slice):
                return np.arange(count)[pairs]
            is_one = pairs is None or isinstance(pairs, (str, bytes))
            array = np.array(None) if is_one else _numbers.array_of(field, pairs, expected)
        except TypeError:  # a slice of words
            array = np.array(None)
        except InvalidArgument as error:
            raise _not_indices(field, error.message, error.index) from None
        array = array.astype(np.intp) if array.size == 0 and array.dtype != bool else array
        if array.ndim != 1:
            got = _arguments.shown(pairs) if array.ndim == 0 else f"shape {array.shape}"
            raise _not_indices(field, f"got {got}, expected {expected}")
        if array.dtype.kind not in "iubO":  # integers beyond 64 bits are objects
            raise _not_indices(field, f"got numbers of type {array.dtype}, expected {expected}")
        if array.dtype == bool:
            if len(array) != count:
                raise PairOutOfRange(
                    f"got a mask of {len(array)} entries, expected one entry for each of the "
                    f"{_arguments.counted(count, 'pair')}",
                    reason="LENGTH_MISMATCH",
                    field=field,
                )
            return np.flatnonzero(array)
        wrong = np.flatnonzero((array < -count) | (array >= count))
        if wrong.size:
            raise self._out_of_range(int(array[wrong[0]]), field, int(wrong[0]))
        return np.arange(count)[array.astype(np.intp)]

    def _out_of_range(
        self, index: int, field: str = "index", place: int | None = None
    ) -> PairOutOfRange:
        count = len(self)
        allowed = f"{-count} to {count - 1} is allowed" if count else "nothing is allowed"
        there = f"there {'is' if count == 1 else 'are'} {_arguments.counted(count, 'pair')}"
        return PairOutOfRange(
            f"{index} is out of range: {there}, so that {allowed}",
            reason="INDEX_OUT_OF_RANGE",
            field=field,
            index=place,
        )

    def contacts_of(self, body: int) -> Manifolds:
        """The pairs in which `body` has contact points, arranged such that `body` is always A.

        In the result `pairs[:, 1]` are the bodies that `body` touches, and the normals point away
        from `body`. The points of a pair that was turned keep their order, which is then clockwise
        about the normal. The query must have the outputs NORMAL and POINTS.

        Raises:
            InvalidArgument: `body` is not the index of a body.
        """
        last = 2**32 - 1 if self.scene is None else len(self.scene) - 1
        body = _arguments.integer("body", body, 0, last)
        touching = (self.pairs == body).any(axis=1) & (self.point_counts > 0)
        chosen = self[np.flatnonzero(touching)]
        chosen._columns["witness_bs"] = chosen.witness_b
        turned = _export.turned(chosen._columns, chosen.pairs[:, 0] != body)
        return self._with(turned)

    def padded(self, k: int) -> Padded:
        """The contact points as dense arrays with `k` slots per pair, the deepest points first.

        If a pair has more than `k` points, the deepest are kept. The query must have the output
        POINTS.
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
        """Converts the requested columns to a pandas data frame (extra `pandas`).

        Outcomes and kinds of features are categories of names, such as "CONTACT". Flags are
        numbers: `frame[frame["flags"] & int(hullcast.Flag.ESTIMATED) != 0]`.

        Args:
            rows: "points" gives one row per contact point, together with the columns of its pair;
                pairs without points have no row. "pairs" gives one row per pair.

        Raises:
            ImportError: pandas is not installed.
            InvalidArgument: `rows` has another value.
            OutputNotAsked: `rows` is "points", and the query did not request POINTS.
        """
        if _arguments.one_of("rows", rows, ("pairs", "points")) == "points":
            self._column("point_counts", "points", "POINTS")
        return _export.dataframe(self._columns, rows)

    @classmethod
    def concat(cls, manifolds: Iterable[Manifolds]) -> Manifolds:
        """Joins the pairs of several results into one, in order.

        Body indices are kept as they are. The scene is kept if all results have the same one. All
        results must have the same outputs.

        Raises:
            InvalidArgument: WRONG_TYPE; NO_ORDER, a set; EMPTY, no manifolds; or OTHER_OUTPUTS, the
                outputs differ.
        """
        from . import _answers  # which loads protobuf

        _arguments.ordered("manifolds", manifolds)
        if isinstance(manifolds, (Manifolds, Manifold, str, Mapping)) or not iterable(manifolds):
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
        # Columns that were derived from others are dropped, and derived again when needed.
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
        """Writes the columns to a numpy `npz` file, without the scene.

        Raises:
            InvalidArgument: NOT_A_PATH or UNWRITABLE_FILE.
        """
        _export.save(path, self._columns)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Manifolds:
        """Reads a file that `save` wrote.

        Raises:
            InvalidArgument: NOT_MANIFOLDS, the file is of another kind; NOT_A_PATH or
                UNREADABLE_FILE.
            FileNotFound: the file does not exist.
        """
        return cls(_export.load(path))

    def plot(
        self,
        *,
        pairs: npt.ArrayLike | None = None,
        path: str | os.PathLike[str] | None = None,
        ax: Any = None,
    ) -> Any:
        """Draws bodies and contacts with matplotlib (extra `plot`); needs no display.

        The picture shows the hulls, and for each contact its patch, its normal and its pairs of
        witness points, coloured by distance. The query must have the outputs NORMAL and POINTS. A
        notebook shows the picture if the call is the last line of a cell.

        Args:
            pairs: the indices of the pairs to draw; by default all.
            path: a file to write the picture to, such as "contacts.png"; by default none.
            ax: matplotlib axes with projection="3d" to draw into; by default new axes.

        Returns:
            The `matplotlib.figure.Figure`.

        Raises:
            ImportError: matplotlib or scipy is not installed.
            InvalidArgument: NO_SCENE, the manifolds were loaded from a file; NO_GEOMETRY, the scene
                has only ids of hulls; WRONG_TYPE for `ax`.
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
        """Writes bodies and contacts to a rerun recording (extra `rerun`).

        The recording shows the hulls, the outlines of the contact patches, the normals (labelled
        with the pair's bodies) and the pairs of witness points: red where the hulls overlap, blue
        where they are apart. Logging to the same path at a later time of the recording shows the
        next step. The query must have the outputs NORMAL and POINTS.

        Args:
            path: the entity path under which everything is written.
            pairs: the indices of the pairs to write; by default all.
            hulls: whether to write the hulls as well as the poses. In a loop it is enough to write
                the hulls in the first step.
            recording: a `rerun.RecordingStream`; by default the current one.

        Raises:
            ImportError: rerun is not installed.
            InvalidArgument: NO_RECORDING, there is no recording; WRONG_TYPE for `recording`;
                NO_SCENE or NO_GEOMETRY, as for `plot`.
        """
        from . import _rerun

        hulls = _arguments.flag("hulls", hulls)
        _arguments.instance("path", path, str, "a str, an entity path")
        shown, bodies, scene = self._drawn(pairs)
        points = shown._drawn_points()
        _rerun.log(bodies, shown.pairs, shown.normal, points, scene, path, hulls, recording)

    def _drawn(
        self, pairs: npt.ArrayLike | None
    ) -> tuple[Manifolds, npt.NDArray[np.uint32], Scene]:
        """The pairs to draw, the bodies in them that have a usable pose, and the scene."""
        scene = self._with_scene()
        shown = self
        if pairs is not None:
            chosen: Any = _arguments.plain(pairs)
            if isinstance(chosen, (int, np.integer)) and not isinstance(chosen, bool):
                chosen = [chosen]
            shown = self[self._chosen("pairs", chosen)]
        return shown, np.setdiff1d(shown.pairs, self.invalid_bodies), scene

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
        text = f"{_arguments.counted(len(self), 'pair')}: {counts or 'none'}"
        if "point_counts" in self._columns:
            text += f"; {_arguments.counted(int(self.point_offsets[-1]), 'point')}"
        if flags := int(np.bitwise_or.reduce(self.flags, initial=0)):
            text += f"; flags {Flag(flags)!r}"
        return f"Manifolds({text})"


def _not_indices(field: str, message: str, place: int | None = None) -> PairOutOfRange:
    """The error for an object that selects no pairs."""
    return PairOutOfRange(message, reason="NOT_INTEGERS", field=field, index=place)


class Manifold:
    """One pair of a `Manifolds`, with the same attribute names as there."""

    __slots__ = ("_all", "_index")

    def __init__(self, all: Manifolds, index: int) -> None:
        self._all = all
        self._index = index

    @property
    def index(self) -> int:
        """The pair's index in the batch."""
        return self._index

    def _points(self) -> slice:
        start, stop = self._all.point_offsets[self.index : self.index + 2]
        return slice(int(start), int(stop))

    @property
    def bodies(self) -> tuple[int, int]:
        """The body indices A and B."""
        a, b = self._all.pairs[self.index]
        return int(a), int(b)

    @property
    def outcome(self) -> Outcome:
        """The pair's outcome: whether the hulls are within the margin."""
        return Outcome(int(self._all.outcome[self.index]))

    @property
    def flags(self) -> Flag:
        """The pair's flags, which qualify its numbers."""
        return Flag(int(self._all.flags[self.index]))

    @property
    def alpha(self) -> float:
        """The growth scale."""
        return float(self._all.alpha[self.index])

    @property
    def alpha_lower(self) -> float:
        """The certified lower end of the growth scale's bracket."""
        return float(self._all.alpha_lower[self.index])

    @property
    def alpha_upper(self) -> float:
        """The certified upper end of the growth scale's bracket."""
        return float(self._all.alpha_upper[self.index])

    @property
    def normal(self) -> Floats:
        """(3,): the unit normal from A to B, world frame."""
        return self._all.normal[self.index]

    @property
    def separation(self) -> float:
        """The signed separation along the normal."""
        return float(self._all.separation[self.index])

    @property
    def witness_a(self) -> Floats:
        """(k, 3): the witness points on A, world frame."""
        return self._all.witness_a[self._points()]

    @property
    def witness_b(self) -> Floats:
        """(k, 3): the witness points on B, world frame."""
        return self._all.witness_b[self._points()]

    @property
    def frame(self) -> Floats:
        """(3, 3): the normal and two tangents, one per row, right-handed."""
        return frames(self.normal[None])[0]

    @property
    def local_a(self) -> Floats:
        """(k, 3): the witness points on A, in the frame of A's hull."""
        return self._all[self._index : self._index + 1].local_a

    @property
    def local_b(self) -> Floats:
        """(k, 3): the witness points on B, in the frame of B's hull."""
        return self._all[self._index : self._index + 1].local_b

    @property
    def distance(self) -> Floats:
        """(k,): the signed distances along the normal."""
        return self._all.distance[self._points()]

    @property
    def point_ids(self) -> Indices:
        """(k, 4): the ids of the features that make each point."""
        return self._all.point_ids[self._points()]

    @property
    def feature_kinds(self) -> tuple[FeatureKind, FeatureKind]:
        """The kinds of the touching features of A and of B."""
        a, b = self._all.feature_kinds[self.index]
        return FeatureKind(int(a)), FeatureKind(int(b))

    @property
    def feature_indices(self) -> Indices:
        """(4,): the touching feature of A (two entries) and of B (two entries)."""
        return self._all.feature_indices[self.index]

    def __repr__(self) -> str:
        parts = [f"bodies={self.bodies}", self.outcome.name]
        if self.flags:
            parts.append(f"flags={self.flags!r}")
        for name in ("alpha", "normal", "separation", "witness_a", "distance"):
            if hasattr(self, name):
                parts.append(f"{name}={getattr(self, name)}")
        return f"Manifold({', '.join(parts)})"

"""Converts results: selected pairs, dense arrays, data frames and files."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _arguments, _files
from ._arrays import Floats, Indices
from ._errors import InvalidArgument
from ._wire import PAIR_COLUMNS, POINT_COLUMNS, FeatureKind, Outcome

Columns = dict[str, np.ndarray]

_FORMAT = "hullcast.manifolds.v1"
_FLOATS = (
    "alphas", "alpha_lowers", "alpha_uppers", "separations", "normals", "kept_areas", "witness_as",
    "distances", "witness_bs", "alpha_gradients", "separation_gradients", "normal_jacobians",
    "gradient_errors",
)  # fmt: skip
#: The columns that every response has.
_ALWAYS = {"outcomes": 1, "flags": 1, "pairs": 2}
_OF_SCENE = {"missing_hulls": 1, "invalid_bodies": 1, "ended_pairs": 2}
#: Columns of rows or points of the answer before, with -1 for none.
_ROWS = ("previous_pairs", "previous_points")

#: How far each pair's row must be rotated to exchange the entries of A and B.
_SIDES = {"pairs": 1, "feature_kinds": 1, "feature_indices": 2, "bases": 3, "point_ids": 2}

#: The sign of a gradient's value if A and B are exchanged. The normal is then its opposite.
_GRADIENTS = {"alpha_gradients": 1.0, "separation_gradients": 1.0, "normal_jacobians": -1.0}


@dataclass(frozen=True, repr=False)
class Padded:
    """Contact points as dense arrays with k slots per pair, the deepest point first.

    An unused slot has `mask` False, distance infinity, witness points of zero and ids of 2^32 - 1.
    """

    #: (n, k): whether the slot has a point.
    mask: npt.NDArray[np.bool_]
    #: (n, k): signed distances along the pair's normal, ascending; negative means overlap.
    distance: Floats
    #: (n, k, 3): the witness points on A, world frame.
    witness_a: Floats
    #: (n, k, 3): the witness points on B, world frame; None without output NORMAL or WITNESS_B.
    witness_b: Floats | None
    #: (n, k, 4): as `Manifolds.point_ids`; None without output FEATURES.
    point_ids: Indices | None

    def __repr__(self) -> str:
        pairs, slots = self.mask.shape
        points = _arguments.counted(int(np.count_nonzero(self.mask)), "point")
        return f"Padded({_arguments.counted(pairs, 'pair')} of {slots} slots; {points})"


def take(columns: Mapping[str, np.ndarray], chosen: npt.NDArray[np.intp]) -> Columns:
    """The columns of some pairs, in the given order."""
    points = None
    if "point_counts" in columns:
        points, _ = _points_of(columns["point_counts"], chosen)
    taken: Columns = {}
    for name, values in columns.items():
        if name in PAIR_COLUMNS or name in _ALWAYS:
            taken[name] = values[chosen]
        elif name in POINT_COLUMNS:
            taken[name] = values[points]
        elif name in _OF_SCENE:
            taken[name] = values
    return taken


def _points_of(
    counts: Indices, chosen: npt.NDArray[np.intp]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The rows of the chosen pairs' points, and each point's index within its pair."""
    starts = np.zeros(len(counts) + 1, dtype=np.int64)
    np.cumsum(counts, out=starts[1:])
    kept = counts[chosen].astype(np.int64)
    before = np.cumsum(kept) - kept
    slot = np.arange(int(kept.sum())) - np.repeat(before, kept)
    return np.repeat(starts[:-1][chosen], kept) + slot, slot


def turned(columns: Columns, turn: npt.NDArray[np.bool_]) -> Columns:
    """Exchanges A and B in the pairs that `turn` marks. The column `witness_bs` is required."""
    of_point = np.repeat(turn, columns["point_counts"])
    result = dict(columns)
    for name, width in _SIDES.items():
        if name in result:
            rows = of_point if name in POINT_COLUMNS else turn
            values = result[name].copy()
            values[rows] = np.roll(values[rows], width, axis=1)
            result[name] = values
    result["normals"] = np.where(turn[:, None], -result["normals"], result["normals"])
    for name, sign in _GRADIENTS.items():
        if name in result:
            rows = result[name].reshape(len(turn), -1, 9).copy()
            # The rotations change places, and the translation of the other body is the opposite.
            turned = sign * rows[turn][..., [0, 1, 2, 6, 7, 8, 3, 4, 5]]
            turned[..., :3] *= -1
            rows[turn] = turned
            result[name] = rows.reshape(result[name].shape)
    a, b = result["witness_as"], result["witness_bs"]
    result["witness_as"] = np.where(of_point[:, None], b, a)
    result["witness_bs"] = np.where(of_point[:, None], a, b)
    return result


def padded(
    counts: Indices,
    distance: Floats,
    witness_a: Floats,
    witness_b: Floats | None,
    point_ids: Indices | None,
    slots: int,
) -> Padded:
    """Converts the ragged points to `slots` slots per pair, and keeps the deepest points."""
    slots = _arguments.integer("k", slots, 0, 2**31 - 1)
    pair = np.repeat(np.arange(len(counts)), counts)
    # Sort by pair, then by depth. Equal depths keep their order.
    order = np.lexsort((distance, pair))
    _, slot = _points_of(counts, np.arange(len(counts)))
    kept = slot < slots
    rows, place = order[kept], (pair[kept], slot[kept])
    shape = (len(counts), slots)

    def dense(values: np.ndarray, unused: Any) -> np.ndarray:
        array = np.full((*shape, *values.shape[1:]), unused, dtype=values.dtype)
        array[place] = values[rows]
        return array

    return Padded(
        mask=dense(np.ones(len(distance), dtype=bool), False),
        distance=dense(distance, np.inf),
        witness_a=dense(witness_a, 0.0),
        witness_b=None if witness_b is None else dense(witness_b, 0.0),
        point_ids=None if point_ids is None else dense(point_ids, 2**32 - 1),
    )


def dataframe(columns: Mapping[str, np.ndarray], rows: str) -> Any:
    """A pandas data frame with one row per pair or per point."""
    try:
        import pandas as library
    except ImportError as error:
        raise ImportError(
            "to_dataframe needs pandas: pip install './client[pandas]' in the clone"
        ) from error
    pandas: Any = library
    series: dict[str, Any] = {"pair": np.arange(len(columns["outcomes"]))}
    for name, values in columns.items():
        if name in PAIR_COLUMNS or name in _ALWAYS:
            series.update(_series(name, values))
    if rows == "points":
        counts = columns["point_counts"]
        series = {name: np.repeat(values, counts) for name, values in series.items()}
        del series["points"]
        for name, values in columns.items():
            if name in POINT_COLUMNS:
                series.update(_series(name, values))
    frame = pandas.DataFrame(series)
    kinds = dict.fromkeys(_NAMES["feature_kinds"], FeatureKind)
    for name, members in {"outcome": Outcome, **kinds}.items():
        if name in frame.columns:
            # The code of a category is its place, and the first member may have another number.
            codes = frame[name].astype("int64") - int(next(iter(members)))
            frame[name] = pandas.Categorical.from_codes(codes, categories=[*members.__members__])
    return frame


#: The nine motions of a gradient: B moved, A rotated, B rotated.
_MOTIONS = tuple(f"{motion}_{axis}" for motion in ("move", "turn_a", "turn_b") for axis in "xyz")
_NAMES: dict[str, tuple[str, ...]] = {
    "pairs": ("body_a", "body_b"),
    "outcomes": ("outcome",),
    "flags": ("flags",),
    "point_counts": ("points",),
    "normals": ("normal_x", "normal_y", "normal_z"),
    "witness_as": ("witness_a_x", "witness_a_y", "witness_a_z"),
    "witness_bs": ("witness_b_x", "witness_b_y", "witness_b_z"),
    "feature_kinds": ("feature_kind_a", "feature_kind_b"),
    "feature_indices": tuple(f"feature_{side}{i}" for side in "ab" for i in range(2)),
    "point_ids": tuple(f"point_id_{side}{i}" for side in "ab" for i in range(2)),
    "bases": tuple(f"basis_{side}{i}" for side in "ab" for i in range(3)),
    "iterations": ("iterations",),
    "support_calls": ("support_calls",),
    "kept_areas": ("kept_area",),
    "previous_pairs": ("previous_pair",),
    "previous_points": ("previous_point",),
    "alpha_gradients": tuple(f"alpha_by_{by}" for by in _MOTIONS),
    "separation_gradients": tuple(f"separation_by_{by}" for by in _MOTIONS),
    "normal_jacobians": tuple(f"normal_{of}_by_{by}" for of in "xyz" for by in _MOTIONS),
    "gradient_errors": ("gradient_error",),
}


def _series(column: str, values: np.ndarray) -> dict[str, np.ndarray]:
    # Other columns, such as "alphas" and "distances", are named like the attribute of `Manifolds`.
    names = _NAMES.get(column, (column.removesuffix("s"),))
    table = values.reshape(len(values), len(names))
    return {name: table[:, i] for i, name in enumerate(names)}


def save(path: str | os.PathLike[str], columns: Mapping[str, np.ndarray]) -> None:
    """Writes an npz file, whatever suffix its name has.

    Raises:
        InvalidArgument: NOT_A_PATH or UNWRITABLE_FILE.
    """
    path = _files.writable("path", path)
    kept = {name: values for name, values in columns.items() if name in _widths()}
    with _files.writing("path", path), open(path, "wb") as file:
        np.savez(file, format=np.array(_FORMAT), **kept)  # type: ignore[arg-type]


def load(path: str | os.PathLike[str]) -> Columns:
    """Reads a file that `save` wrote, and checks the columns and their shapes.

    Raises:
        InvalidArgument: NOT_MANIFOLDS, NOT_A_PATH or UNREADABLE_FILE.
        FileNotFound: the file does not exist.
    """
    path = _files.path_of("path", path)
    data = _files.read("path", path)
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            written = str(file["format"]) if "format" in file.files else ""
            columns = {name: file[name] for name in file.files if name in _widths()}
    except Exception:  # a damaged archive may raise anything
        what = "is not an npz file: expected one that Manifolds.save wrote"
        if data.startswith(b"PK"):
            what = "is a damaged npz file: its end is missing, or its content has changed"
        raise InvalidArgument(f"{path} {what}", reason="NOT_MANIFOLDS", field="path") from None
    always = (*_ALWAYS, "missing_hulls", "invalid_bodies")
    missing = [name for name in always if name not in columns]
    if written != _FORMAT or missing:
        raise InvalidArgument(
            f"{path} is an npz file, but not one that Manifolds.save wrote ({_FORMAT})",
            reason="NOT_MANIFOLDS",
            field="path",
        )
    for name, values in columns.items():
        if values.dtype != _type_of(name):
            raise InvalidArgument(
                f"{path}: {name} has the type {values.dtype}, expected {_type_of(name)}",
                reason="NOT_MANIFOLDS",
                field="path",
            )
    pairs = columns["outcomes"].size
    points = int(columns["point_counts"].sum()) if "point_counts" in columns else 0
    for name, values in columns.items():
        width = _widths()[name]
        rows = (
            points
            if name in POINT_COLUMNS
            else values.size // width
            if name in _OF_SCENE
            else pairs
        )
        if values.shape != ((rows,) if width == 1 else (rows, width)):
            raise InvalidArgument(
                f"{path}: {name} has shape {values.shape}", reason="NOT_MANIFOLDS", field="path"
            )
    from . import _checked  # it loads protobuf, which saved results do not need otherwise

    _checked.values(
        columns,
        lambda text: InvalidArgument(f"{path}: {text}", reason="NOT_MANIFOLDS", field="path"),
    )
    return columns


def _type_of(column: str) -> np.dtype[Any]:
    """The type of a column's numbers."""
    if column in ("outcomes", "flags", "feature_kinds"):
        return np.dtype("u1")
    if column in _ROWS:
        return np.dtype("<i8")
    return np.dtype("<f8" if column in _FLOATS else "<u4")


def _widths() -> dict[str, int]:
    return {**_ALWAYS, **PAIR_COLUMNS, **POINT_COLUMNS, **_OF_SCENE}

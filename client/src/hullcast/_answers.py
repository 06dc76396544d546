"""Reads response messages into numpy columns, and joins the columns of several messages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from . import _checked, _packed
from ._pb import contacts_pb2
from ._wire import LATER_COLUMNS, OUTPUT_COLUMNS, PAIR_COLUMNS, POINT_COLUMNS

Columns = dict[str, np.ndarray]

_KINDS = {name: np.dtype(kind) for name, kind in _packed.COLUMN_TYPES.items()}
_BYTE = np.dtype("u1")


class Answer:
    """One response message, whose columns are checked for their lengths when they are read.

    Attributes:
        message: the parsed message, with its numeric columns as bytes.

    `_packed.py` reads a packed numeric column as raw bytes. If the bytes have the wrong length, the
    sender split the column into several records or did not pack it. Then the message is parsed
    again with the column's declared type.
    """

    def __init__(self, data: bytes, request_id: int = 0) -> None:
        self._data = data
        self.message = _checked.parsed(_packed.QueryContactsResponse.FromString, data)
        _checked.request_id(self.message.request_id, request_id)
        self._typed: contacts_pb2.QueryContactsResponse | None = None

    def columns(self, outputs: Sequence[str], pairs: np.ndarray | None) -> Columns:
        """Reads the columns of some outputs.

        Args:
            outputs: the names of the requested outputs.
            pairs: (n, 2), the pairs that the request named; None if the response names its pairs
                itself.

        Raises:
            ServerError: MALFORMED_ANSWER, a column has a wrong length.
        """
        count = len(self.message.outcomes) if pairs is None else len(pairs)
        found = {
            "outcomes": self._column("outcomes", count, 1),
            "flags": self._column("flags", count, 1),
            "pairs": self._column("pairs", count, 2) if pairs is None else pairs,
            "missing_hulls": np.array(self.message.missing_hulls, dtype="<u4"),
            "invalid_bodies": np.array(self.message.invalid_bodies, dtype="<u4"),
        }
        wanted = list(dict.fromkeys(name for output in outputs for name in OUTPUT_COLUMNS[output]))
        for name in wanted:
            if name in PAIR_COLUMNS:
                found[name] = self._column(name, count, PAIR_COLUMNS[name])
        points = int(found["point_counts"].sum(dtype=np.uint64)) if "point_counts" in found else 0
        for name in wanted:
            if name in POINT_COLUMNS:
                found[name] = self._column(name, points, POINT_COLUMNS[name])
        if "MATCHES" in outputs:
            ended = np.array(self.message.ended_pairs, dtype="<u4")
            _checked.length("ended_pairs", len(ended) % 2, 0)
            found["ended_pairs"] = ended.reshape(-1, 2)
        return found

    def _column(self, name: str, rows: int, width: int) -> np.ndarray:
        kind = _KINDS.get(name, _BYTE)
        # np.frombuffer returns a read-only array; the copy is writable.
        raw = getattr(self.message, name)
        if len(raw) == rows * width * kind.itemsize:
            values = np.frombuffer(raw, dtype=kind).copy()
        else:
            values = self._real(name, kind)
        if len(values) == 0 and name in LATER_COLUMNS:
            none = np.nan if kind.kind == "f" else np.iinfo(kind).max
            values = np.full(rows * width, none, dtype=kind)
        _checked.length(name, len(values), rows * width)
        return values if width == 1 else values.reshape(rows, width)

    def _real(self, name: str, kind: np.dtype) -> np.ndarray:
        if name not in _packed.COLUMN_TYPES:
            return np.frombuffer(getattr(self.message, name), dtype=kind)
        if self._typed is None:
            read = contacts_pb2.QueryContactsResponse.FromString
            self._typed = _checked.parsed(read, self._data)
        return np.array(getattr(self._typed, name), dtype=kind)


def read(
    data: bytes, outputs: Sequence[str], pairs: np.ndarray | None, request_id: int = 0
) -> Columns:
    """Reads the columns of one response message, and checks the length of each.

    Args:
        data: a serialised QueryContactsResponse.
        outputs: the names of the requested outputs.
        pairs: (n, 2), the pairs that the request named; None for FindContacts, whose response names
            its pairs itself.
        request_id: the `request_id` of the request.

    Raises:
        ServerError: MALFORMED_ANSWER, the bytes are not a response to this request.
    """
    return Answer(data, request_id).columns(outputs, pairs)


def merge(parts: Sequence[Columns]) -> Columns:
    """Joins the columns of several messages into one batch, in the given order."""
    if len(parts) == 1:
        return parts[0]
    merged = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    for name in ("missing_hulls", "invalid_bodies"):
        merged[name] = np.unique(merged[name])
    return merged

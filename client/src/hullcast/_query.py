"""A query as messages: what is sent, and how the answers become one.

Everything but the call itself, so that every way of calling shares it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from . import _answers, _arrays, _packed
from ._arrays import Indices
from ._errors import InvalidArgument
from ._manifolds import Manifolds
from ._pb import contacts_pb2
from ._scene import Scene
from ._wire import DEFAULT_OUTPUTS

#: A message that carries more bodies than this many a pair is sent with only
#: the bodies that its pairs name.
_BODIES_PER_PAIR = 4


@dataclass(frozen=True)
class Accuracy:
    """Speed against accuracy.

    Args:
        solver: "PORTAL" or "GJK_RAY_CAST" (the paper's).
        relative_tolerance: width of the bracket over its upper end that is good
            enough, 0 to 1; 0: to rounding.
        feature_angle: radians, 0 to 0.5: faces and edges within it of the normal
            count as touched; 0 is the pure Gauss map.
        max_points: points a pair; 0: all.
    """

    solver: str = "PORTAL"
    relative_tolerance: float = 0.0
    feature_angle: float = 0.01
    max_points: int = 0

    #: To rounding, the whole patch: the default. Chosen, as the other, from what
    #: `hullcast tradeoff` measured (docs/tradeoff.md): no coarser tolerance is faster; brackets
    #: at most 1.4e-13 of alpha wide.
    EXACT: ClassVar[Accuracy]
    #: The same, at most four points a pair: fewer to send and to solve for. Measured: 2 to 7 %
    #: more time; in 19 of 20 pairs the patch is at most 6 % of the hulls' size off.
    FOUR_POINTS: ClassVar[Accuracy]

    def fill(self, message: Any) -> None:
        """Writes it into a request's `accuracy`."""
        enum = message.DESCRIPTOR.fields_by_name["solver"].enum_type
        value = enum.values_by_name.get(f"SOLVER_{self.solver}")
        if value is None or value.number == 0:
            known = [v.name.removeprefix("SOLVER_") for v in enum.values[1:]]
            raise InvalidArgument(
                f"{self.solver!r} is none of {', '.join(known)}",
                reason="UNKNOWN_VALUE",
                field="accuracy.solver",
            )
        message.solver = value.number
        message.relative_tolerance = self.relative_tolerance
        message.feature_angle = self.feature_angle
        message.max_points = self.max_points


Accuracy.EXACT = Accuracy()
Accuracy.FOUR_POINTS = Accuracy(max_points=4)


@dataclass(frozen=True)
class Span:
    """Pairs `start` to `stop` of a query: what one message asks for."""

    start: int
    stop: int

    def halves(self) -> list[Span]:
        """Two that make this one."""
        middle = (self.start + self.stop) // 2
        return [Span(self.start, middle), Span(middle, self.stop)]


@dataclass(frozen=True)
class Message:
    """A request, and what its own numbering of hulls and bodies stands for."""

    data: bytes
    hulls: Indices | None = None
    bodies: Indices | None = None


class Query:
    """One `query` or (with `pairs` None) `find`.

    Raises:
        InvalidArgument: shapes that do not fit, an index or a name that is not known.
    """

    def __init__(
        self,
        scene: Scene,
        pairs: Any,
        *,
        margin: float = 0.0,
        accuracy: Accuracy | None = None,
        outputs: Iterable[str] | None = None,
        warm: Manifolds | None = None,
    ) -> None:
        #: The bodies asked about.
        self.scene = scene
        self._pairs = (
            None if pairs is None else _arrays.indices("pairs", pairs, None, 2, below=len(scene))
        )
        self._outputs = output_names(outputs)
        self._bases = None if warm is None else warm.bases
        if self._bases is not None and len(self._bases) != _length(self._pairs):
            raise InvalidArgument(
                f"{len(self._bases)} manifolds for another number of pairs",
                reason="LENGTH_MISMATCH",
                field="warm",
            )
        # What every message of this query has alike.
        self._common = contacts_pb2.QueryContactsRequest(
            margin=margin,
            outputs=[f"OUTPUT_{name}" for name in self._outputs],
        )
        (accuracy or Accuracy()).fill(self._common.accuracy)
        self._body_scratch = np.empty(len(scene), dtype="<u4")
        self._hull_scratch = np.empty(len(scene.hull_ids), dtype="<u4")

    @property
    def pair_count(self) -> int:
        """Pairs asked for."""
        return _length(self._pairs)

    def move(self, positions: Any, rotations: Any) -> None:
        """The same query of the bodies at new poses."""
        self.scene = self.scene.moved(positions, rotations)

    def start_from(self, found: Manifolds) -> None:
        """The next messages in full start from an answer's bases, if it has them."""
        if "BASES" in self._outputs:
            self._bases = found.bases

    def spans(self, pairs_per_message: int) -> list[Span]:
        """The query in parts of about equal size, none larger; one where there is no pair."""
        count = _length(self._pairs)
        parts = max(1, -(-count // pairs_per_message))
        ends = [count * i // parts for i in range(parts + 1)]
        return [Span(start, stop) for start, stop in itertools.pairwise(ends)]

    def message(self, span: Span) -> Message:
        """The request for some of the pairs."""
        scene = self.scene
        assert self._pairs is not None
        pairs = self._pairs[span.start : span.stop]
        columns: list[tuple[str, npt.NDArray[Any]]] = []
        if self._bases is not None:
            columns.append(("warm_starts", self._bases[span.start : span.stop]))
        if len(scene) <= _BODIES_PER_PAIR * len(pairs):
            columns += [("pairs", pairs), *self._bodies()]
            return Message(_packed.request(self._with(scene.hull_ids), columns))
        bodies, pairs = _compact(pairs.reshape(-1), self._body_scratch)
        hulls, body_hulls = _compact(scene.body_hulls[bodies], self._hull_scratch)
        columns += [
            ("pairs", pairs),
            ("body_hulls", body_hulls),
            ("positions", scene.positions[bodies]),
            ("rotations", scene.rotations[bodies]),
        ]
        rest = self._with([scene.hull_ids[int(i)] for i in hulls])
        return Message(_packed.request(rest, columns), hulls, bodies)

    def step_message(self, before: Message) -> bytes:
        """The request that inherits from `before` on a stream: the poses of its bodies."""
        positions, rotations = self.scene.positions, self.scene.rotations
        if before.bodies is not None:
            positions, rotations = positions[before.bodies], rotations[before.bodies]
        rest = contacts_pb2.QueryContactsRequest(inherit=True)
        return _packed.request(rest, [("positions", positions), ("rotations", rotations)])

    def find_message(self) -> bytes:
        """The request to find the pairs."""
        scene = self.scene
        columns = self._bodies()
        for name in ("worlds", "groups", "ignored_groups"):
            column = getattr(scene, name)
            if column is not None:
                columns.append((name, column))
        return _packed.request(self._with(scene.hull_ids), columns)

    def _with(self, hull_ids: Sequence[bytes]) -> contacts_pb2.QueryContactsRequest:
        """What all messages have, and the hulls of one."""
        rest = contacts_pb2.QueryContactsRequest(hull_ids=hull_ids)
        rest.MergeFrom(self._common)
        return rest

    def _bodies(self) -> list[tuple[str, npt.NDArray[Any]]]:
        scene = self.scene
        return [
            ("body_hulls", scene.body_hulls),
            ("positions", scene.positions),
            ("rotations", scene.rotations),
        ]

    def read(self, span: Span | None, message: Message | None, data: bytes) -> _answers.Columns:
        """The answer to `message`, hulls and bodies numbered as the scene does."""
        asked = None
        if span is not None and self._pairs is not None:
            asked = self._pairs[span.start : span.stop]
        columns = _answers.read(data, self._outputs, asked)
        if message is not None and message.bodies is not None and message.hulls is not None:
            columns["missing_hulls"] = np.sort(message.hulls[columns["missing_hulls"]])
            columns["invalid_bodies"] = np.sort(message.bodies[columns["invalid_bodies"]])
        return columns


def _length(pairs: Indices | None) -> int:
    return 0 if pairs is None else len(pairs)


def _compact(numbers: Indices, scratch: Indices) -> tuple[Indices, Indices]:
    """The distinct `numbers`, and `numbers` as indices into them.

    By scattering into `scratch` (as long as the largest number, its content of
    no matter), which takes half the time of sorting. Order: of last occurrence.
    """
    order = np.arange(len(numbers), dtype="<u4")
    scratch[numbers] = order
    distinct = numbers[scratch[numbers] == order]
    scratch[distinct] = order[: len(distinct)]
    return distinct, scratch[numbers]


def output_names(outputs: Iterable[str] | None) -> Sequence[str]:
    """Those asked for, each known; the default for None."""
    if outputs is None:
        return DEFAULT_OUTPUTS
    names = (outputs,) if isinstance(outputs, str) else tuple(outputs)
    known = contacts_pb2.Output.keys()
    for i, name in enumerate(names):
        if f"OUTPUT_{name}" not in known[1:]:
            choices = ", ".join(key.removeprefix("OUTPUT_") for key in known[1:])
            raise InvalidArgument(
                f"{name!r} is none of {choices}", reason="UNKNOWN_VALUE", field="outputs", index=i
            )
    # Empty means the default on the wire; outcomes always come.
    return names or ("OUTCOME",)

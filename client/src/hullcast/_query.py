"""A query as request messages, and the combination of the responses into one result.

Everything but the call itself is here, so that all ways of calling share it.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from . import _answers, _arguments, _arrays, _checked, _packed
from ._arguments import counted
from ._arrays import Indices
from ._errors import InvalidArgument, InvalidPoses, MissingHullsWarning, warn
from ._manifolds import Manifolds
from ._motion import Motion
from ._outputs import output_names
from ._pb import contacts_pb2
from ._scene import Scene
from ._wire import LOOP_CONTRACT, Flag

#: The request ids of this process, by which responses are recognised. They start at a random
#: number, so that two processes behind one proxy hardly ever use the same id.
_request_ids = itertools.count(1 + int.from_bytes(os.urandom(6), "little"))

#: The number of bodies that a message about unusable poses describes.
_DESCRIBED = 5

#: If a message would have more than this many bodies per pair, only the bodies that its pairs name
#: are sent.
_BODIES_PER_PAIR = 4


@dataclass(frozen=True)
class Accuracy:
    """The trade-off between speed and accuracy.

    Args:
        solver: "PORTAL", or "GJK_RAY_CAST" (the solver of the paper).
        relative_tolerance: the width of alpha's bracket at which the solver may stop, as a fraction
            of the bracket's upper end, 0 to 1. With 0 the bracket is as narrow as rounding allows.
        feature_angle: an angle in radians, 0 to 0.5: faces and edges within this angle of the
            contact normal count as touching. With 0 the features are those of the pure Gauss map.
        max_points: the largest number of contact points per pair; 0 for all.

    Raises:
        InvalidArgument: an argument is not usable; the error names it.
    """

    solver: str = "PORTAL"
    relative_tolerance: float = 0.0
    feature_angle: float = 0.01
    max_points: int = 0

    #: The default: brackets as narrow as rounding allows, and all contact points. This preset and
    #: the other one were chosen by measurements of `make tradeoff` (docs/tradeoff.md). No
    #: coarser tolerance is faster, and brackets are at most 1.4e-13 of alpha wide.
    EXACT: ClassVar[Accuracy]
    #: As EXACT, but with at most four points per pair, so that there are fewer points to send and
    #: to solve for. Measured: 2 to 7 % more time; in 19 of 20 pairs the patch differs by at most
    #: 6 % of the hulls' size.
    FOUR_POINTS: ClassVar[Accuracy]

    def __post_init__(self) -> None:
        known = [key.removeprefix("SOLVER_") for key in contacts_pb2.Solver.keys()[1:]]
        _arguments.one_of("solver", self.solver, known)
        # The class is frozen, so `object.__setattr__` is used to convert numpy scalars to Python
        # numbers.
        for name, high in (("relative_tolerance", 1.0), ("feature_angle", 0.5)):
            value = _arguments.number(name, getattr(self, name), 0, high)
            object.__setattr__(self, name, value)
        most = _arguments.integer("max_points", self.max_points, 0, 2**32 - 1)
        object.__setattr__(self, "max_points", most)

    def fill(self, message: Any) -> None:
        """Writes the settings into the `accuracy` field of a request."""
        message.solver = contacts_pb2.Solver.Value(f"SOLVER_{self.solver}")
        message.relative_tolerance = self.relative_tolerance
        message.feature_angle = self.feature_angle
        message.max_points = self.max_points


Accuracy.EXACT = Accuracy()
Accuracy.FOUR_POINTS = Accuracy(max_points=4)


@dataclass(frozen=True)
class Span:
    """The pairs `start` to `stop` (exclusive) of a query, which one message requests."""

    start: int
    stop: int

    def halves(self) -> list[Span]:
        """Two spans that together make this one."""
        middle = (self.start + self.stop) // 2
        return [Span(self.start, middle), Span(middle, self.stop)]


@dataclass(frozen=True)
class Message:
    """A serialised request, and how it numbers hulls and bodies.

    If `hulls` or `bodies` is not None, entry i is the scene's index of the message's number i.
    """

    data: bytes
    request_id: int
    hulls: Indices | None = None
    bodies: Indices | None = None


class Query:
    """One call of `query`, or of `find` if `find` is true.

    Raises:
        InvalidArgument: an argument has a wrong shape, an index out of range or an unknown name.
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
        on_invalid: str = "raise",
        find: bool = False,
        session: bool = False,
        linear_velocities: Any = None,
        angular_velocities: Any = None,
        time_step: float = 0.0,
        turning_points: Any = None,
    ) -> None:
        _arguments.instance("scene", scene, Scene, "a hullcast.Scene")
        self._is_session = session
        self._on_invalid = _arguments.one_of("on_invalid", on_invalid, ("raise", "flag"))
        self._pairs = None if find else own_pairs(pairs, len(scene))
        self._outputs = output_names(outputs, session=session)
        margin = _arguments.number("margin", margin, 0, infinite=not find)
        self.motion = Motion.checked(
            len(scene),
            linear_velocities=linear_velocities,
            angular_velocities=angular_velocities,
            time_step=time_step,
            turning_points=turning_points,
        )
        if accuracy is not None:
            _arguments.instance("accuracy", accuracy, Accuracy, "a hullcast.Accuracy")
        if warm is not None:
            _arguments.instance("warm", warm, Manifolds, "the hullcast.Manifolds of a query")
        self._bases = None if warm is None else warm.bases
        #: Whether some message had only the bodies that its pairs name.
        self._compacted = False
        if self._bases is not None and len(self._bases) != _length(self._pairs):
            raise InvalidArgument(
                f"got {counted(len(self._bases), 'pair')}, expected {_length(self._pairs)}: give "
                "the answer of an earlier query of the same pairs",
                reason="LENGTH_MISMATCH",
                field="warm",
            )
        # The fields that all messages of this query share.
        self._common = contacts_pb2.QueryContactsRequest(
            margin=margin,
            outputs=[f"OUTPUT_{name}" for name in self._outputs],
        )
        (accuracy or Accuracy()).fill(self._common.accuracy)
        self.replace(scene)

    def replace(self, scene: Scene, motion: Motion | None = None) -> None:
        """Replaces the bodies of the query, and their motion if it is given; the options stay."""
        self.scene = scene
        if motion is not None:
            self.motion = motion
        self._body_scratch = np.empty(len(scene), dtype="<u4")
        self._hull_scratch = np.empty(len(scene.hull_ids), dtype="<u4")

    @property
    def unknown_to_old(self) -> str | None:
        """What a server of the contract 0 does not know of this query; None if it knows all."""
        if self.motion or self.scene.margins is not None:
            return "the margins of bodies and their velocities"
        if self._is_session and self.finds:
            return "find sessions"
        return "the output MATCHES" if self.matches else None

    @property
    def contract(self) -> int:
        """The least contract number of a server that knows the fields of this query."""
        return LOOP_CONTRACT if self.unknown_to_old else 0

    @property
    def finds(self) -> bool:
        """Whether the server finds the pairs."""
        return self._pairs is None

    @property
    def matches(self) -> bool:
        """Whether the output MATCHES is requested."""
        return "MATCHES" in self._outputs

    @property
    def pair_count(self) -> int:
        """The number of pairs of the query."""
        return _length(self._pairs)

    def start_from(self, columns: _answers.Columns) -> None:
        """Makes the next full messages start from the bases of a result, if it has them."""
        if "BASES" in self._outputs:
            self._bases = columns["bases"]

    def spans(self, pairs_per_message: int) -> list[Span]:
        """Splits the pairs into spans of about equal size, each of at most `pairs_per_message`.

        A query without pairs has one empty span.
        """
        count = _length(self._pairs)
        parts = max(1, -(-count // pairs_per_message))
        ends = [count * i // parts for i in range(parts + 1)]
        return [Span(start, stop) for start, stop in itertools.pairwise(ends)]

    def message(self, span: Span) -> Message:
        """The request for the pairs of a span."""
        scene = self.scene
        assert self._pairs is not None
        pairs = self._pairs[span.start : span.stop]
        columns: list[tuple[str, npt.NDArray[Any]]] = []
        if self._bases is not None:
            columns.append(("warm_starts", self._bases[span.start : span.stop]))
        if len(scene) <= _BODIES_PER_PAIR * len(pairs):
            columns += [("pairs", pairs), *self._bodies()]
            rest = self._with(scene.hull_ids)
            return Message(_packed.request(rest, columns), rest.request_id)
        self._compacted = True
        bodies, pairs = _compact(pairs.reshape(-1), self._body_scratch)
        columns.append(("pairs", pairs))
        return self._of_some(bodies, columns)

    def step_message(
        self,
        before: Message,
        moved: npt.NDArray[np.bool_] | None = None,
        motion: Motion | None = None,
    ) -> Message:
        """The request that inherits from `before` on a stream: what is new of its bodies.

        Args:
            before: the last message of the stream.
            moved: (bodies of the scene,), or `NOTHING`: only the poses of these bodies are sent.
                None sends those of all bodies, which is the only form that an old server knows.
            motion: the motion that the server has; None if it is the query's.
        """
        scene, bodies = self.scene, before.bodies
        columns: list[tuple[str, npt.NDArray[Any]]] = []
        changed = None if motion is None else self.motion.changes(motion)
        if moved is not None:
            if changed is not None:
                moved = changed if len(moved) == 0 else moved | changed
            moved = moved if bodies is None or len(moved) == 0 else moved[bodies]
            chosen = np.flatnonzero(moved)
            # A body takes 56 bytes, and 4 more if the message names it.
            if len(moved) == 0 or 60 * len(chosen) < 56 * len(moved):
                columns.append(("moved", chosen.astype("<u4")))
                bodies = chosen if bodies is None else bodies[chosen]
        if bodies is None:
            columns += [("positions", scene.positions), ("rotations", scene.rotations)]
        else:
            columns += [
                ("positions", scene.positions[bodies]),
                ("rotations", scene.rotations[bodies]),
            ]
        if changed is not None:
            columns += self.motion.of(bodies)
        number = next(_request_ids)
        rest = contacts_pb2.QueryContactsRequest(
            inherit=True, request_id=number, time_step=self.motion.time_step
        )
        return replace(before, data=_packed.request(rest, columns), request_id=number)

    def find_message(
        self,
        bodies: Indices | None = None,
        *,
        stream: bool = False,
        previous: Indices | None = None,
    ) -> Message:
        """The request of `find`, for all bodies or for some, whose indices ascend.

        Args:
            bodies: the indices of the message's bodies; None for all.
            stream: whether the message is for a stream, where the field `find` asks for the search.
            previous: for each of the message's bodies its number in the stream's last message, or
                2^32 - 1; None if no body is the same.
        """
        scene = self.scene
        groups, ignored = scene.groups, scene.ignored_groups
        if bodies is not None and groups is not None and ignored is not None:
            ignored = ignored[np.isin(ignored, groups[bodies]).all(axis=1)]
        columns: list[tuple[str, npt.NDArray[Any]]] = []
        for name, column in (("worlds", scene.worlds), ("groups", groups)):
            if column is not None:
                columns.append((name, column if bodies is None else column[bodies]))
        if ignored is not None:
            columns.append(("ignored_groups", ignored))
        if previous is not None:
            columns.append(("previous_bodies", previous))
        if bodies is not None:
            return self._of_some(bodies, columns, find=stream)
        rest = self._with(scene.hull_ids, find=stream)
        return Message(_packed.request(rest, columns + self._bodies()), rest.request_id)

    def _of_some(
        self, bodies: Indices, columns: list[tuple[str, npt.NDArray[Any]]], *, find: bool = False
    ) -> Message:
        """A request that has only the given bodies and their hulls, besides `columns`."""
        scene = self.scene
        hulls, body_hulls = _compact(scene.body_hulls[bodies], self._hull_scratch)
        columns += [
            ("body_hulls", body_hulls),
            ("positions", scene.positions[bodies]),
            ("rotations", scene.rotations[bodies]),
            *self._margins(bodies),
        ]
        rest = self._with([scene.hull_ids[int(i)] for i in hulls], find=find)
        return Message(_packed.request(rest, columns), rest.request_id, hulls, bodies)

    def _with(
        self, hull_ids: Sequence[bytes], *, find: bool = False
    ) -> contacts_pb2.QueryContactsRequest:
        """The options that all messages share, the hulls of one message, and a new request id."""
        rest = contacts_pb2.QueryContactsRequest(
            hull_ids=hull_ids,
            request_id=next(_request_ids),
            find=find,
            time_step=self.motion.time_step,
        )
        rest.MergeFrom(self._common)
        return rest

    def _bodies(self) -> list[tuple[str, npt.NDArray[Any]]]:
        scene = self.scene
        return [
            ("body_hulls", scene.body_hulls),
            ("positions", scene.positions),
            ("rotations", scene.rotations),
            *self._margins(None),
        ]

    def _margins(self, bodies: Indices | None) -> list[tuple[str, npt.NDArray[Any]]]:
        """The columns of the margins and motions of some bodies; None for all bodies."""
        margins, columns = self.scene.margins, self.motion.of(bodies)
        if margins is not None:
            columns.append(("margins", margins if bodies is None else margins[bodies]))
        return columns

    def read(self, span: Span, message: Message, answer: _answers.Answer) -> _answers.Columns:
        """Reads and checks the response to `message`; numbers hulls and bodies as the scene does.

        Raises:
            ServerError: MALFORMED_ANSWER.
        """
        assert self._pairs is not None
        pairs = self._pairs[span.start : span.stop]
        columns = answer.columns(self._outputs, pairs)
        self._renumber(message, columns)
        _checked.columns(columns, pairs, self.scene.body_hulls)
        return columns

    def read_found(self, message: Message, answers: Iterable[_answers.Answer]) -> _answers.Columns:
        """Reads and checks the responses to a `find_message`.

        Raises:
            ServerError: MALFORMED_ANSWER.
        """
        parts: list[_answers.Columns] = []
        last: tuple[int, int] | None = None
        bodies = message.bodies
        for answer in answers:
            part = answer.columns(self._outputs, None)
            count = len(self.scene) if bodies is None else len(bodies)
            last = _checked.found_pairs(part["pairs"], part["outcomes"], count, last)
            if bodies is not None:
                part["pairs"] = bodies[part["pairs"]]
            self._renumber(message, part)
            _checked.columns(part, part["pairs"], self.scene.body_hulls)
            parts.append(part)
        if not parts:
            raise _checked.malformed("FindContacts ended without a message, expected one or more")
        return _answers.merge(parts)

    def _renumber(self, message: Message, columns: _answers.Columns) -> None:
        """Checks the lists of hulls and bodies of a response; numbers them as the scene does."""
        for name, own, count in (
            ("missing_hulls", message.hulls, len(self.scene.hull_ids)),
            ("invalid_bodies", message.bodies, len(self.scene)),
        ):
            _checked.ascending(name, columns[name], count if own is None else len(own))
            if own is not None:
                columns[name] = np.sort(own[columns[name]])

    def delivered(self, columns: _answers.Columns, *, restarted: bool = False) -> Manifolds:
        """The result as the caller gets it. `restarted` is its attribute of that name.

        Raises:
            InvalidPoses: some bodies have unusable poses, and `on_invalid` is "raise".
        """
        if self._compacted:
            # The server has not seen the bodies that no pair names, so check their poses here.
            unseen = _arrays.unusable(self.scene.positions, self.scene.rotations)
            unseen = np.union1d(unseen, self.motion.unusable())
            columns["invalid_bodies"] = np.union1d(columns["invalid_bodies"], unseen)
        if self._pairs is not None and not columns["pairs"].flags.writeable:
            # The caller may change the result's pairs, but not those of the query.
            columns["pairs"] = columns["pairs"].copy()
        found = Manifolds(columns, self.scene)
        found._restarted = restarted
        if len(found.missing_hulls):
            lost = int(
                np.count_nonzero(found.flags & int(Flag.UNKNOWN_HULL | Flag.HULL_UNAVAILABLE))
            )
            if self._pairs is None:
                bodies = int(np.isin(self.scene.body_hulls, found.missing_hulls).sum())
                verb = "is" if bodies == 1 else "are"
                effect = (
                    f"{bodies} of {counted(len(self.scene), 'body', 'bodies')} {verb} in no pair"
                )
            else:
                verb = "is" if lost == 1 else "are"
                effect = f"{lost} of {counted(len(found), 'pair')} {verb} INVALID"
            warn(
                MissingHullsWarning(
                    f"the server does not have {len(found.missing_hulls)} of "
                    f"{counted(len(self.scene.hull_ids), 'hull')}, so that {effect}: make the "
                    "scene with Hull objects, not ids, or register the hulls"
                )
            )
        if len(found.invalid_bodies) and self._on_invalid == "raise":
            raise self._invalid(found)
        return found

    def _invalid(self, found: Manifolds) -> InvalidPoses:
        """The error that names the bodies with unusable poses, and the reasons."""
        scene, bodies = self.scene, found.invalid_bodies
        known = [
            self.motion.why_unusable(i)
            or _arrays.why_unusable(scene.positions[i], scene.rotations[i])
            for i in bodies
        ]
        texts = [f"body {i}: {why}" for i, (_, why) in zip(bodies, known, strict=True)]
        more = len(texts) - _DESCRIBED
        listed = "; ".join(texts[:_DESCRIBED]) + (f"; and {more} more" if more > 0 else "")
        return InvalidPoses(
            f"{len(bodies)} of {counted(len(scene), 'body', 'bodies')} "
            f"{'has' if len(bodies) == 1 else 'have'} an unusable pose ({listed}). The answer is "
            'in the attribute manifolds; on_invalid="flag" answers INVALID without an exception',
            bodies,
            tuple(why for _, why in known),
            found,
            reason="INVALID_POSES",
            field=known[0][0],
            index=int(bodies[0]),
        )


def own_pairs(pairs: Any, bodies: int) -> Indices:
    """Checks pairs of body indices for a scene with `bodies` bodies.

    Returns:
        (n, 2), a read-only copy, so that a caller may change the given array later.
    """
    of = f"the scene has {counted(bodies, 'body', 'bodies')}"
    return _arrays.frozen(_arrays.indices("pairs", pairs, None, 2, below=bodies, of=of))


def _length(pairs: Indices | None) -> int:
    return 0 if pairs is None else len(pairs)


def _compact(numbers: Indices, scratch: Indices) -> tuple[Indices, Indices]:
    """The distinct `numbers`, and each of `numbers` as an index into them.

    Scattering the numbers into `scratch` takes half the time of sorting. `scratch` must be longer
    than the largest number; its content does not matter. The distinct numbers are in the order of
    their last occurrence.
    """
    order = np.arange(len(numbers), dtype="<u4")
    scratch[numbers] = order
    distinct = numbers[scratch[numbers] == order]
    scratch[distinct] = order[: len(distinct)]
    return distinct, scratch[numbers]

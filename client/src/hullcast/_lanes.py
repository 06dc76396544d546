"""The parts of a session: each has a stream, and what both ends keep of the stream's last message.

A session of given pairs is cut into spans of pairs, and a find session into ranges of worlds, if
one message may not have all bodies.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from . import _answers, _calls, _checked, _errors, _link, _matches, _worlds
from ._arrays import Indices
from ._matches import Rows
from ._motion import Motion
from ._query import Message, Query, Span
from ._scene import NOTHING, Scene
from ._wire import LOOP_CONTRACT, NONE

Mask = npt.NDArray[np.bool_]


@dataclass
class Step:
    """The bodies of one step at their new poses."""

    scene: Scene
    #: (bodies,): which bodies have another pose than in the scene `since`; or `NOTHING`.
    moved: Mask = field(default_factory=lambda: NOTHING)
    #: The scene of the step before; None if this one has other bodies.
    since: Scene | None = None
    #: (bodies,): each body's index in the scene of the step before, or -1; None if all are new.
    previous: Rows | None = None
    #: The motion of all bodies of `scene`.
    motion: Motion = field(default_factory=Motion)


class Lane(ABC):
    """A part of a session's work, and the stream that answers for it."""

    def __init__(self) -> None:
        self.link: _link.Link | None = None
        self.stream: _link.Stream | None = None
        self.failures = 0
        #: The contract number of the stream's last answer; 0 before the first.
        self.contract = 0
        #: Whether the last answer was computed without the one before.
        self.restarted = True
        #: Whether the last answer is bit for bit the one before.
        self.unchanged = False
        #: The columns of the last answer; those of matches as on the wire.
        self.columns: _answers.Columns = {}
        #: (rows,): the place of each row of the last answer in the session's whole answer.
        self.rows: Rows = np.zeros(0, dtype=np.int64)
        #: The last message. Messages that inherit from it number hulls and bodies as it does.
        self._message: Message | None = None
        #: The scene of the last message; None if the server keeps nothing of that message.
        self._sent: Scene | None = None
        #: The motion of the bodies that the server has with that message.
        self._motion = Motion()
        #: The bodies of the message before the last one, and the columns of its answer that tell
        #: which matches are possible.
        self._before: tuple[Message | None, _matches.Live | None] = (None, None)
        self._live: _matches.Live | None = None

    def drop(self) -> None:
        """Ends the stream. The next message is sent in full, on a new stream."""
        stream, self.stream = self.stream, None
        self.contract, self._sent = 0, None
        if stream is not None:
            stream.cancel()

    def forget(self) -> None:
        """Gives up the stream without ending it, in a forked child."""
        self.stream, self._sent = None, None

    def next_message(self, query: Query, step: Step) -> bytes:
        """The lane's message of a step: only the poses that changed if the server has the rest."""
        sent, before, motion = self._sent, self._message, self._motion
        self._sent, self._motion = step.scene, step.motion
        # If the last step failed on another lane, this lane may have the scene before that one.
        inherits = sent is not None and sent is step.since
        if before is None or not (inherits or (sent is not None and step.previous is not None)):
            self._before, self.restarted = (None, None), True
            self._message = self._full(query, step, None)
            return self._message.data
        self._before, self.restarted = (before, self._live), False
        if inherits:
            moved = step.moved if self.contract >= LOOP_CONTRACT else None
            self._message = query.step_message(before, moved, motion)
        else:
            self._message = self._full(query, step, before)
        return self._message.data

    def answer(self, data: bytes) -> _answers.Answer:
        """Parses one message of the answer.

        Raises:
            ServerError: MALFORMED_ANSWER.
        """
        assert self._message is not None
        return _answers.Answer(data, self._message.request_id)

    def take(self, query: Query, answers: Sequence[_answers.Answer]) -> None:
        """Reads and checks the messages of an answer.

        Raises:
            ServerError: MALFORMED_ANSWER.
        """
        message = self._message
        assert message is not None
        last = answers[-1].message
        self.unchanged = bool(last.unchanged)
        if self.unchanged and (self.restarted or len(answers) > 1):
            raise _checked.malformed("unchanged is set, but there is no answer before it")
        if last.state_dropped:
            self._sent = None
        if self.unchanged:
            self.columns = self._again(query)
            if query.matches:
                self.columns |= _matches.identical(self.columns)
            return
        earlier, self.columns = self.columns, self._read(query, message, answers)
        if query.matches:
            before, live = self._before
            _matches.check(self.columns, live)
            ended = self.columns["ended_pairs"]
            if before is not None and before.bodies is not None:
                self.columns["ended_pairs"] = before.bodies[ended]
            count = len(query.scene) if message.bodies is None else len(message.bodies)
            if count == 0 and live is not None:
                # A message without bodies cannot refer to the one before, so its answer has no
                # ended pairs.
                self.columns["ended_pairs"] = earlier["pairs"][live.rows]
            self._live = _matches.Live.of(self.columns, count)

    @abstractmethod
    def halves(self, query: Query, error: _errors.InvalidArgument) -> Sequence[Lane]:
        """Two lanes that together make this one, or raises the error."""

    @abstractmethod
    def _full(self, query: Query, step: Step, before: Message | None) -> Message:
        """The whole request, whose bodies are numbered by those of `before` if that is given."""

    @abstractmethod
    def _read(
        self, query: Query, message: Message, answers: Sequence[_answers.Answer]
    ) -> _answers.Columns:
        """The checked columns of an answer."""

    @abstractmethod
    def _again(self, query: Query) -> _answers.Columns:
        """The columns of the last answer once more."""


class PairLane(Lane):
    """Some of the given pairs."""

    def __init__(self, span: Span) -> None:
        super().__init__()
        self.span = span
        self._kept: tuple[Message, _answers.Answer] | None = None

    def halves(self, query: Query, error: _errors.InvalidArgument) -> Sequence[Lane]:
        return [PairLane(span) for span in _calls.halves_of(self.span, error)]

    def _full(self, query: Query, step: Step, before: Message | None) -> Message:
        return query.message(self.span)

    def _read(
        self, query: Query, message: Message, answers: Sequence[_answers.Answer]
    ) -> _answers.Columns:
        if len(answers) > 1:
            raise _checked.malformed("more is set, but the message named its pairs")
        self._kept = (message, answers[0]) if self.contract >= LOOP_CONTRACT else None
        return query.read(self.span, message, answers[0])

    def _again(self, query: Query) -> _answers.Columns:
        # The caller may have changed the arrays of the last result, so read new ones.
        assert self._kept is not None
        return query.read(self.span, *self._kept)


class FindLane(Lane):
    """The bodies of some worlds, among which the server finds the pairs."""

    def __init__(self, worlds: tuple[int, int] | None = None) -> None:
        super().__init__()
        #: The first and the last world of this lane; None if it has all bodies.
        self.worlds = worlds

    def halves(self, query: Query, error: _errors.InvalidArgument) -> Sequence[Lane]:
        first, last = self.worlds or (0, _worlds.EVERY_WORLD - 1)
        middle = _worlds.middle(query.scene, self._bodies(query.scene), error)
        return [FindLane((first, middle)), FindLane((middle + 1, last))]

    def _bodies(self, scene: Scene) -> Indices | None:
        if self.worlds is None:
            return None
        worlds = np.zeros(len(scene), dtype="<u4") if scene.worlds is None else scene.worlds
        mine = (worlds >= self.worlds[0]) & (worlds <= self.worlds[1])
        return np.flatnonzero(mine | (worlds == _worlds.EVERY_WORLD)).astype("<u4")

    def _full(self, query: Query, step: Step, before: Message | None) -> Message:
        bodies = self._bodies(query.scene)
        numbers: Indices | None = None
        if before is not None:
            assert step.previous is not None
            previous = step.previous if bodies is None else step.previous[bodies]
            numbers = _numbers_in(previous, before.bodies)
        return query.find_message(bodies, stream=True, previous=numbers)

    def _read(
        self, query: Query, message: Message, answers: Sequence[_answers.Answer]
    ) -> _answers.Columns:
        return query.read_found(message, answers)

    def _again(self, query: Query) -> _answers.Columns:
        return dict(self.columns)  # results of a find session are read-only


def _numbers_in(bodies: Rows, of: Indices | None) -> Indices:
    """The place of each body in a message that has the bodies `of`; 2^32 - 1 if it is not there.

    Args:
        bodies: indices of bodies, or -1 for none.
        of: the bodies of the message, ascending; None for all.
    """
    if of is None:
        return np.where(bodies < 0, NONE, bodies).astype("<u4")
    if len(of) == 0:
        return np.full(len(bodies), NONE, dtype="<u4")
    place = np.minimum(np.searchsorted(of, bodies), len(of) - 1)
    return np.where(of[place] == bodies, place, NONE).astype("<u4")

"""Step loops: the same bodies and pairs in each step, and only new poses to send.

As in `_calls.py`, everything but the waiting is written once for both clients.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

from . import _answers, _calls, _connection, _errors, _link
from ._arguments import counted
from ._manifolds import Manifolds
from ._query import Message, Query, Span
from ._settled import Settled

STREAM = "/hullcast.v1.ContactService/StreamContacts"

#: The number of streams over which a large session is spread, so that the server computes one while
#: the client reads another; and the largest size of a stream's part, in messages of a plain query.
_LANES = 8
_MESSAGES_PER_LANE = 16

#: One in this many of the calls that a server permits on one connection is kept for calls that are
#: not steps.
_SHARE_OF_OTHER_CALLS = 16


@dataclass(eq=False)
class _Lane:
    """A part of the pairs, and the stream that answers for it."""

    span: Span
    link: _link.Link | None = None
    stream: _link.Stream | None = None
    #: The last full message. Messages that inherit from it number hulls and bodies as it does.
    message: Message | None = None
    failures: int = 0

    def drop(self) -> None:
        """Ends the stream. The next message is sent in full, on a new stream."""
        stream, self.stream = self.stream, None
        if stream is not None:
            stream.cancel()


class Steps(Settled):
    """The common part of `hullcast.Session` and `hullcast.aio.Session`."""

    _instead: ClassVar[dict[str, str]] = {"": "open another session with client.session"}

    def __init__(self, calls: _calls.Calls, make: Callable[[], Query]) -> None:
        self._calls = calls
        self._query = make()
        count, least = self._query.pair_count, calls.pairs_per_message
        size = min(max(least, -(-count // _LANES)), _MESSAGES_PER_LANE * least)
        self._lanes = [_Lane(span) for span in self._query.spans(size)]
        self._closed = False
        #: Locked while a step is under way.
        self._step = threading.Lock()
        _sessions.add(self)

    def __len__(self) -> int:
        return self._query.pair_count

    def __repr__(self) -> str:
        return f"{type(self).__name__}({counted(len(self), 'pair')}, {self._calls.target!r})"

    def close(self) -> None:
        """Ends the session's streams. The client stays open."""
        self._closed = True
        for lane in self._lanes:
            lane.drop()

    def _stepping(
        self, positions: Any, rotations: Any, timeout: float | None
    ) -> _link.Steps[Manifolds]:
        if self._closed:
            raise _errors.Error(
                "the session is closed: open a new one with client.session", reason="CLOSED"
            )
        # Two steps at a time would read each other's answers.
        step = self._step
        if not step.acquire(blocking=False):
            raise _errors.Error(
                "another thread or task makes a step of this session: open a session for each",
                reason="STEP_UNDER_WAY",
            )
        try:
            return (yield from self._stepped(positions, rotations, timeout))
        finally:
            step.release()

    def _stepped(
        self, positions: Any, rotations: Any, timeout: float | None
    ) -> _link.Steps[Manifolds]:
        query, deadline = self._query, self._calls._deadline(timeout)
        query.move(positions, rotations)
        parts: dict[Span, _answers.Columns] = {}
        yield from self._calls._ready(deadline)
        try:
            yield from self._exchange(self._lanes, parts, deadline)
            for times in range(1, _calls.REGISTRATIONS + 1):
                lost = [lane for lane in self._lanes if _calls.lacks_hulls(parts[lane.span])]
                answers = [parts[lane.span] for lane in lost]
                if not (yield from self._calls._restore(query.scene, answers, times, deadline)):
                    break
                for lane in lost:
                    lane.drop()  # inheriting from that response would start without bases
                yield from self._exchange(lost, parts, deadline)
        except BaseException:
            # A response that has not arrived yet would be mistaken for the response to the next
            # step.
            for lane in self._lanes:
                lane.drop()
            raise
        columns = _answers.merge([parts[lane.span] for lane in self._lanes])
        query.start_from(columns)
        return query.delivered(columns)

    def _exchange(
        self, lanes: Iterable[_Lane], parts: dict[Span, _answers.Columns], deadline: float | None
    ) -> _link.Steps[None]:
        """Sends one message on each lane, all of them before the first response is read."""
        waiting, asked = deque(lanes), deque[_Lane]()
        while waiting or asked:
            while waiting:
                lane = waiting.popleft()
                stream, data = self._next_message(lane)
                yield stream.send(data, _link.remaining(deadline))
                asked.append(lane)
            lane = asked.popleft()
            assert lane.stream is not None
            try:
                data = yield lane.stream.receive(_link.remaining(deadline))
            except _errors.InvalidArgument as error:
                halves = [_Lane(span) for span in _calls.halves_of(lane.span, error)]
                lane.drop()
                place = self._lanes.index(lane)
                self._lanes[place : place + 1] = halves
                waiting.extend(halves)
            except _errors.Unavailable as error:
                lane.drop()
                lane.failures += 1
                pause = self._calls._pause_before(error, lane.failures, deadline)
                if pause:
                    yield self._calls._link().pause(pause)
                waiting.append(lane)
            else:
                lane.failures = 0
                assert lane.message is not None
                yield from self._calls._check_contract(self._query, data, deadline)
                parts[lane.span] = self._query.read(lane.span, lane.message, data)

    def _next_message(self, lane: _Lane) -> tuple[_link.Stream, bytes]:
        """The stream and the next message, which has only the poses if the stream has the rest."""
        link = self._calls._link()  # it changes in a forked child or another event loop
        if lane.stream is not None and lane.message is not None and lane.link is link:
            lane.message = self._query.step_message(lane.message)
            return lane.stream, lane.message.data
        lane.drop()
        _check_count(link)
        lane.message = self._query.message(lane.span)
        lane.link, lane.stream = link, link.open(STREAM)
        return lane.stream, lane.message.data


_sessions: weakref.WeakSet[Steps] = weakref.WeakSet()


def _check_count(link: _link.Link) -> None:
    """Raises if one more stream would leave too few calls of a connection to all other calls.

    A call beyond the server's limit would wait until another one ends, and streams do not end by
    themselves.
    """
    if not link.max_calls:
        return
    lanes = [lane for session in list(_sessions) for lane in session._lanes]
    used = sum(lane.stream is not None and lane.link is link for lane in lanes)
    allowed = link.max_calls - max(1, link.max_calls // _SHARE_OF_OTHER_CALLS)
    if used >= allowed:
        raise _errors.ResourceExhausted(
            f"the open sessions of this client have {counted(used, 'stream')}, and {allowed} are "
            f"allowed: the server permits {link.max_calls} calls at once on one connection "
            "(max_streams_per_connection), some of which are kept for other calls. Close sessions, "
            "use one session for the bodies of many worlds, or make another client",
            reason="TOO_MANY_SESSIONS",
        )


def _before_fork() -> None:
    """Ends idle streams, because gRPC's threads for them do not exist in the child.

    The next step of either process sends a full message.
    """
    for session in list(_sessions):
        if not session._step.locked():
            for lane in session._lanes:
                lane.drop()


def _after_fork() -> None:
    """Forgets streams in use. It does not end them: only the parent's threads could do that."""
    for session in list(_sessions):
        session._step = threading.Lock()  # the step under way belongs to the parent
        for lane in session._lanes:
            _connection.inherited.append(lane.stream)
            lane.stream = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before_fork, after_in_child=_after_fork)

"""Step loops: the same bodies in each step, and only the poses that changed to send.

As in `_calls.py`, everything but the waiting is written once for both clients.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, ClassVar

import numpy as np

from . import _answers, _arguments, _arrays, _calls, _connection, _errors, _link, _worlds
from ._arguments import counted
from ._lanes import FindLane, Lane, PairLane, Step
from ._manifolds import Manifolds
from ._matches import Rows, identical, placed
from ._motion import Motion
from ._query import Query
from ._scene import Scene
from ._settled import Settled

STREAM = "/hullcast.v1.ContactService/StreamContacts"

#: The number of streams over which a large session is spread, so that the server computes one while
#: the client reads another; and the largest size of a stream's part, in messages of a plain query.
_LANES = 8
_MESSAGES_PER_LANE = 16

#: One in this many of the calls that a server permits on one connection is kept for calls that are
#: not steps.
_SHARE_OF_OTHER_CALLS = 16


class Steps(Settled):
    """The common part of `hullcast.Session` and `hullcast.aio.Session`."""

    _instead: ClassVar[dict[str, str]] = {"": "open another session with client.session"}

    def __init__(self, calls: _calls.Calls, make: Callable[[], Query]) -> None:
        self._calls = calls
        self._query = make()
        self._lanes: list[Lane] = [FindLane()]
        if not self._query.finds:
            count, least = self._query.pair_count, calls.pairs_per_message
            size = min(max(least, -(-count // _LANES)), _MESSAGES_PER_LANE * least)
            self._lanes = [PairLane(span) for span in self._query.spans(size)]
        #: The first point of each row of the last whole answer, if there are matches.
        self._offsets: Rows = np.zeros(0, dtype=np.int64)
        #: The columns of the last whole answer of a find session, and whether its matches are those
        #: of an answer that did not change.
        self._last: tuple[_answers.Columns, bool] = ({}, False)
        self._pairs = self._query.pair_count
        #: A scene with the bodies of the last one that was answered, and their last motion.
        #: `update` refers to it, so an update that failed can be repeated.
        self._answered_scene = self._query.scene
        self._motion = self._query.motion
        self._closed = False
        #: Locked while a step is under way.
        self._step = threading.Lock()
        _sessions.add(self)

    def __len__(self) -> int:
        return self._pairs

    def __repr__(self) -> str:
        what = counted(len(self), "pair")
        if self._query.finds:
            what = f"find, {counted(len(self._query.scene), 'body', 'bodies')}"
        return f"{type(self).__name__}({what}, {self._calls.target!r})"

    def close(self) -> None:
        """Ends the session's streams. The client stays open."""
        self._closed = True
        for lane in self._lanes:
            lane.drop()

    def _stepping(
        self,
        positions: Any,
        rotations: Any,
        moved: Any,
        motion: dict[str, Any],
        timeout: float | None,
    ) -> _link.Steps[Manifolds]:
        make = partial(self._moved, positions, rotations, moved, motion)
        return (yield from self._alone(make, timeout))

    def _updating(
        self, scene: Any, previous: Any, motion: dict[str, Any], timeout: float | None
    ) -> _link.Steps[Manifolds]:
        return (yield from self._alone(partial(self._replaced, scene, previous, motion), timeout))

    def _moved(self, positions: Any, rotations: Any, moved: Any, motion: dict[str, Any]) -> Step:
        """The step to new poses and a new motion of all bodies, or of the bodies `moved`."""
        query, before = self._query, self._query.scene
        count, bodies = len(before), None
        if moved is None:
            scene, mask = before._moved_where(positions, rotations)
        else:
            of = f"the scene has {counted(count, 'body', 'bodies')}"
            bodies = _arrays.indices("moved", moved, None, below=count, of=of)
            _arrays.distinct("moved", bodies)
            scene, mask = before._moved_some(bodies, positions, rotations)
        given = Motion.checked(count if bodies is None else len(bodies), **motion)
        new = given.over(query.motion, count, bodies)
        return Step(scene, mask, since=before, motion=new)

    def _replaced(self, scene: Any, previous: Any, motion: dict[str, Any]) -> Step:
        """The step to another scene."""
        if not self._query.finds:
            raise _errors.InvalidArgument(
                "the bodies of a session of given pairs are fixed: open another session, or one "
                "with find=True",
                reason="FIND_ONLY",
                field="scene",
            )
        _arguments.instance("scene", scene, Scene, "a hullcast.Scene")
        numbers = None
        if previous is not None:
            before = len(self._answered_scene)
            of = f"the scene of the step before has {counted(before, 'body', 'bodies')}"
            numbers = _arrays.rows("previous", previous, len(scene), before, of)
        given = Motion.checked(len(scene), **motion)
        stayed = Motion() if numbers is None else self._motion.renumbered(numbers)
        return Step(scene, previous=numbers, motion=given.over(stayed, len(scene)))

    def _alone(self, make: Callable[[], Step], timeout: float | None) -> _link.Steps[Manifolds]:
        """Makes a step, unless another one is under way."""
        if self._closed:
            raise _errors.Error(
                "the session is closed: open a new one with client.session", reason="CLOSED"
            )
        # Two steps at a time would read each other's answers.
        lock = self._step
        if not lock.acquire(blocking=False):
            raise _errors.Error(
                "another thread or task makes a step of this session: open a session for each",
                reason="STEP_UNDER_WAY",
            )
        try:
            return (yield from self._stepped(make(), timeout))
        finally:
            lock.release()

    def _stepped(self, step: Step, timeout: float | None) -> _link.Steps[Manifolds]:
        query, deadline = self._query, self._calls._deadline(timeout)
        if step.since is None:
            query.replace(step.scene, step.motion)
        else:
            if step.since is self._answered_scene:
                # A step that fails keeps its velocities, as it keeps its poses.
                self._motion, self._answered_scene = step.motion, step.scene
            query.scene, query.motion = step.scene, step.motion
        yield from self._calls._ready(deadline)
        try:
            yield from self._exchange(self._lanes, step, deadline)
            for times in range(1, _calls.REGISTRATIONS + 1):
                lost = [lane for lane in self._lanes if _calls.lacks_hulls(lane.columns, query)]
                answers = [lane.columns for lane in lost]
                if not (yield from self._calls._restore(query.scene, answers, times, deadline)):
                    break
                for lane in lost:
                    # Inheriting from that answer would start without bases, and compare with an
                    # answer that the caller never had.
                    lane.drop()
                yield from self._exchange(lost, step, deadline)
        except BaseException:
            # A response that has not arrived yet would be mistaken for the response to the next
            # step.
            for lane in self._lanes:
                lane.drop()
            raise
        columns = self._whole()
        self._answered_scene, self._motion = query.scene, query.motion
        query.start_from(columns)
        restarted = any(lane.restarted for lane in self._lanes)
        return query.delivered(columns, restarted=restarted)

    def _whole(self) -> _answers.Columns:
        """The answers of all lanes as one, in which matches are rows of the whole answer before."""
        query, lanes = self._query, self._lanes
        if query.finds and all(lane.unchanged for lane in lanes):
            columns, is_still = self._last
            if query.matches and not is_still:
                same = columns | identical(columns)
                columns = placed(same, np.arange(self._pairs), self._offsets)
            return self._kept(columns, is_still=True)
        parts = [lane.columns for lane in lanes]
        if query.matches:
            parts = [placed(lane.columns, lane.rows, self._offsets) for lane in lanes]
        columns = _worlds.together(parts) if query.finds else _answers.merge(parts)
        if query.finds and query.matches and len(parts) > 1:
            ended = columns["ended_pairs"]
            columns["ended_pairs"] = ended[_worlds.order(ended)]
        self._pairs = len(columns["outcomes"])
        if query.matches:
            self._remember(columns)
        return self._kept(columns, is_still=False) if query.finds else columns

    def _kept(self, columns: _answers.Columns, *, is_still: bool) -> _answers.Columns:
        """Keeps the columns of a find session, and makes them read-only, for a later result."""
        for column in columns.values():
            column.flags.writeable = False
        self._last = columns, is_still
        return columns

    def _remember(self, columns: _answers.Columns) -> None:
        """Keeps where each lane's rows and each row's points are, for the next step's matches."""
        counts = columns["point_counts"]
        self._offsets = np.cumsum(counts, dtype=np.int64) - counts
        ends = np.cumsum([len(lane.columns["outcomes"]) for lane in self._lanes])
        rank = np.arange(self._pairs)
        if self._query.finds and len(self._lanes) > 1:
            order = _worlds.order(np.concatenate([lane.columns["pairs"] for lane in self._lanes]))
            rank[order] = np.arange(self._pairs)
        for lane, end in zip(self._lanes, ends, strict=True):
            lane.rows = rank[end - len(lane.columns["outcomes"]) : end]

    def _exchange(
        self, lanes: Iterable[Lane], step: Step, deadline: float | None
    ) -> _link.Steps[None]:
        """Sends one message on each lane, all of them before the first response is read."""
        waiting, asked = deque(lanes), deque[Lane]()
        while waiting or asked:
            while waiting:
                lane = waiting.popleft()
                stream, data = self._next_message(lane, step)
                yield stream.send(data, _link.remaining(deadline))
                asked.append(lane)
            lane = asked.popleft()
            try:
                answers = yield from self._received(lane, deadline)
            except _errors.InvalidArgument as error:
                yield from self._check_server(lane, deadline)
                lane.drop()
                halves = lane.halves(self._query, error)
                place = self._lanes.index(lane)
                self._lanes[place : place + 1] = halves
                waiting.extend(halves)
            except _errors.Unavailable as error:
                lane.drop()
                lane.failures += 1
                assert lane.link is not None
                pause, link = yield from self._calls._after(
                    error, lane.failures, deadline, lane.link
                )
                if pause:
                    yield link.pause(pause)
                waiting.append(lane)
            else:
                lane.failures = 0
                lane.take(self._query, answers)

    def _received(self, lane: Lane, deadline: float | None) -> _link.Steps[list[_answers.Answer]]:
        """The messages of an answer. All but the last one say that more follow."""
        assert lane.stream is not None
        answers: list[_answers.Answer] = []
        while not answers or answers[-1].message.more:
            data = yield lane.stream.receive(_link.remaining(deadline))
            answers.append(lane.answer(data))
            lane.contract = int(answers[-1].message.contract)
            yield from self._calls._check_contract(self._query, answers[-1], deadline)
        return answers

    def _check_server(self, lane: Lane, deadline: float | None) -> _link.Steps[None]:
        """Raises SERVER_TOO_OLD if a refused message was the first to a server that is too old.

        Such a server refuses the worlds and groups of a scene, since it ignores the field `find`.
        """
        if self._query.contract == 0 or lane.contract:
            return
        info = yield from self._calls._informing(_link.remaining(deadline))
        if info.contract < self._query.contract:
            raise (yield from self._calls._too_old(self._query, info.contract, deadline))

    def _next_message(self, lane: Lane, step: Step) -> tuple[_link.Stream, bytes]:
        """The lane's stream, which is opened if there is none, and its next message."""
        link = self._calls._link()  # it changes in a forked child or another event loop
        if lane.stream is None or lane.link is not link:
            lane.drop()
            _check_count(link)
            lane.link, lane.stream = link, link.open(STREAM)
        return lane.stream, lane.next_message(self._query, step)


def query_of(
    scene: Scene, pairs: Any, *, find: Any, warm: Manifolds | None, **options: Any
) -> Query:
    """The query that a session repeats. The arguments are those of `Client.session`.

    Raises:
        InvalidArgument: MISSING_ARGUMENT or CONTRADICTION, about `pairs`, `find` and `warm`; or an
            argument is not usable.
    """
    find = _arguments.flag("find", find)
    if not find and pairs is None:
        raise _errors.InvalidArgument(
            "missing: expected the pairs of bodies, or find=True to let the server find them",
            reason="MISSING_ARGUMENT",
            field="pairs",
        )
    for name, value in (("pairs", pairs), ("warm", warm)) if find else ():
        if value is not None:
            raise _errors.InvalidArgument(
                f"got {name} and find=True, expected one of them: with find the server finds the "
                "pairs, and starts them from its own last answer",
                reason="CONTRADICTION",
                field=name,
            )
    return Query(scene, pairs, find=find, warm=warm, session=True, **options)


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
            lane.forget()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before_fork, after_in_child=_after_fork)

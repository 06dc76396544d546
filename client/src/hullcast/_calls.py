"""What a client does, whichever way it waits.

Each operation is a generator that yields the call it waits for next and is sent
the answer, or thrown the call's error. The clients (`_client.py`, `aio.py`)
only wait: everything else is here, once.
"""

from __future__ import annotations

import itertools
import os
import random
import threading
import time
import weakref
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from . import _answers, _channel, _errors
from ._hulls import Content, Hull
from ._manifolds import Manifolds
from ._query import Query, Span
from ._register import Registration
from ._scene import Scene
from ._wire import Flag

if TYPE_CHECKING:
    from typing_extensions import Self

T = TypeVar("T")

#: Yields what is waited for (`Link.start`, `.call`, `.stream`); returns the result.
Steps = Generator[Any, Any, T]

REGISTER = "/hullcast.v1.HullService/RegisterHulls"
QUERY = "/hullcast.v1.ContactService/QueryContacts"
FIND = "/hullcast.v1.ContactService/FindContacts"

#: Messages of one call under way at once: enough that the server always has
#: the next one while this side reads the last.
_IN_FLIGHT = 6

#: Times that pairs are asked for again after registering the hulls they lack.
REGISTRATIONS = 3

#: Times that one message is sent again because its answer was cut off. Each
#: is a call with all of gRPC's own retries.
_CUT_OFFS = 3

#: Times that one message is sent again to a server that is too busy, and the
#: longest wait in between, seconds: some 15 s in all.
_BUSY = 12
_LONGEST_PAUSE = 2.0


class Stream(Protocol):
    """An open stream of messages, answered in order."""

    def send(self, data: bytes) -> Any:
        """What to wait for until a message is under way. What goes wrong, `receive` tells."""

    def receive(self, timeout: float | None) -> Any:
        """What to wait for until the oldest message not yet answered is."""

    def cancel(self) -> None:
        """Ends it."""


class Link(Protocol):
    """An open channel: ways to make a call, each giving what the client waits for."""

    def start(self, method: str, data: bytes, timeout: float | None) -> Any:
        """Under way at once; has `.cancel()`."""

    def call(self, method: str, data: bytes, timeout: float | None) -> Any:
        """One that is waited for at once."""

    def stream(self, method: str, data: bytes, timeout: float | None) -> Any:
        """One that is answered by a list of messages."""

    def open(self, method: str) -> Stream:
        """A stream of messages and their answers."""
        ...

    def pause(self, seconds: float) -> Any:
        """Nothing for a while."""

    def abandon(self) -> None:
        """Called where the channel belongs to another process or event loop."""


class Calls(ABC):
    """What `hullcast.Client` and `hullcast.aio.Client` have in common.

    Attributes:
        pairs_per_message: larger queries are split into messages of at most
            this many pairs, several at a time under way. The split changes no
            bit of the answer.
    """

    def __init__(
        self, settings: _channel.Settings, *, on_close: Callable[[], None] | None = None
    ) -> None:
        self._settings = settings
        self.pairs_per_message = 4096
        self._on_close = on_close
        self._owner = os.getpid()
        self._closed = False
        self._lock = threading.Lock()
        self._opened: tuple[Any, Link] | None = None
        _clients.add(self)

    @classmethod
    def connect(
        cls,
        target: _channel.Target,
        *,
        tls: _channel.Tls = None,
        token: str | None = None,
        timeout: float | None = 60,
        options: Iterable[tuple[str, Any]] = (),
    ) -> Self:
        """A client of the server at `target`. Connects at the first call.

        A call that finds no server, or one too busy, is tried again for some 12
        seconds, within its timeout. A forked child that uses the client gets a
        connection of its own; pickling keeps these settings alone.

        Args:
            target: "host:port", "unix:PATH", or several servers that calls are
                spread over: "dns:///name:port", followed as the name's addresses
                change, or a list of "host:port".
            tls: None for none; True for TLS with the system's roots; the roots to
                trust, as PEM bytes or the path of a PEM file; or gRPC credentials.
            token: sent with every call, as a bearer token.
            timeout: seconds that a call may take unless it says otherwise; None: any.
            options: further gRPC channel options; each replaces this package's own
                of that name, if any.
        """
        kept = target if isinstance(target, str) else tuple(target)
        return cls(_channel.Settings(kept, tls, token, timeout, tuple(options)))

    @property
    def target(self) -> str:
        """The server's address, or several separated by commas."""
        target = self._settings.target
        return target if isinstance(target, str) else ",".join(target)

    @property
    def timeout(self) -> float | None:
        """Seconds that a call may take unless it says otherwise."""
        return self._settings.timeout

    def _registering(
        self, make: Callable[[], Registration], timeout: float | None
    ) -> Steps[list[Hull]]:
        return (yield from self._register(make(), self._deadline(timeout)))

    def _querying(self, make: Callable[[], Query], timeout: float | None) -> Steps[Manifolds]:
        query = make()
        deadline = self._deadline(timeout)
        spans = query.spans(self.pairs_per_message)
        parts = yield from self._exchange(query, spans, deadline)
        for times in range(1, REGISTRATIONS + 1):
            lost = {span: part for span, part in parts.items() if lacks_hulls(part)}
            if not (yield from self._restore(query.scene, lost.values(), times, deadline)):
                break
            for span in lost:
                del parts[span]
            parts.update((yield from self._exchange(query, list(lost), deadline)))
        ordered = [parts[span] for span in sorted(parts, key=lambda span: span.start)]
        return Manifolds(_answers.merge(ordered), query.scene)

    def _finding(self, make: Callable[[], Query], timeout: float | None) -> Steps[Manifolds]:
        query = make()
        deadline = self._deadline(timeout)
        message = query.find_message()
        parts: list[_answers.Columns] = []
        for times in range(1, REGISTRATIONS + 2):
            link = self._link()
            answers = yield from _asked(link, partial(link.stream, FIND, message), deadline)
            parts = [query.read(None, None, data) for data in answers or [b""]]
            lost = [part for part in parts if len(part["missing_hulls"])]
            last = times > REGISTRATIONS
            if last or not (yield from self._restore(query.scene, lost, times, deadline)):
                break
        return Manifolds(_answers.merge(parts), query.scene)

    def _register(self, call: Registration, deadline: float | None) -> Steps[list[Hull]]:
        answers: list[bytes] = []
        for message, data in enumerate(call.requests()):
            link = self._link()
            begin = partial(link.call, REGISTER, data)
            try:
                answers.append((yield from _asked(link, begin, deadline)))
            except _errors.InvalidArgument as error:
                raise call.named(error, message) from None
        return call.read(answers)

    def _restore(
        self, scene: Scene, parts: Iterable[_answers.Columns], times: int, deadline: float | None
    ) -> Steps[bool]:
        """Registers the hulls that answers lack; false where the scene has none of them.

        The second time twice and so on: where replicas that share no store take
        turns, once would reach the same one every time.
        """
        missing = {int(i) for part in parts for i in part["missing_hulls"]}
        known = [scene.contents[i] for i in sorted(missing)]
        contents: list[Content] = [content for content in known if content is not None]
        for _ in range(times if contents else 0):
            yield from self._register(Registration(contents), deadline)
        return bool(contents)

    def _exchange(
        self, query: Query, spans: list[Span], deadline: float | None
    ) -> Steps[dict[Span, _answers.Columns]]:
        """Asks for every span, some at a time, in halves where something is too large."""
        link = self._link()
        parts: dict[Span, _answers.Columns] = {}
        waiting = deque(spans)
        under_way: deque[tuple[Span, Any, Any]] = deque()
        failed: Counter[Span] = Counter()
        window = _IN_FLIGHT
        try:
            while waiting or under_way:
                alone = len(waiting) == 1 and not under_way
                begin = link.call if alone else link.start
                while waiting and len(under_way) < window:
                    span = waiting.popleft()
                    message = query.message(span)
                    call = begin(QUERY, message.data, remaining(deadline))
                    under_way.append((span, message, call))
                span, message, call = under_way.popleft()
                try:
                    data = yield call
                except _errors.InvalidArgument as error:
                    waiting.extendleft(reversed(halves_of(span, error)))
                except _errors.Unavailable as error:
                    failed[span] += 1
                    pause = pause_before(error, failed[span], deadline)
                    if pause:
                        # This client's other messages may be what the server is busy with.
                        window = max(1, window // 2)
                        yield link.pause(pause)
                    waiting.appendleft(span)
                else:
                    parts[span] = query.read(span, message, data)
            return parts
        finally:
            for _, _, call in under_way:
                call.cancel()

    def _deadline(self, timeout: float | None) -> float | None:
        seconds = self.timeout if timeout is None else timeout
        return None if seconds is None else time.monotonic() + seconds

    def _link(self) -> Link:
        """The open channel, opened at first use, and anew in another `_place`."""
        place = self._place()
        opened = self._opened
        if opened is None or opened[0] is not place:
            with self._lock:
                if self._closed:
                    raise _errors.Error("the client is closed", reason="CLOSED")
                opened = self._opened
                if opened is None or opened[0] is not place:
                    if opened is not None:
                        opened[1].abandon()
                    opened = self._opened = (place, self._open())
        return opened[1]

    def _place(self) -> object:
        """What a channel is bound to, apart from its process."""
        return None

    @abstractmethod
    def _open(self) -> Link: ...

    @abstractmethod
    def _run(self, steps: Steps[T]) -> T:
        """Waits for what the steps yield."""

    def _begin_close(self) -> tuple[Link | None, Callable[[], None] | None]:
        """Marks the client closed; the channel and the server that are to be closed with it."""
        with self._lock:
            self._closed = True
            opened, self._opened = self._opened, None
            on_close, self._on_close = self._on_close, None
        # A forked child must not stop its parent's server.
        server = on_close if self._owner == os.getpid() else None
        return (None if opened is None else opened[1]), server

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (type(self), self._settings, self.pairs_per_message)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.target!r})"


def _unpickled(kind: type[Calls], settings: _channel.Settings, pairs_per_message: int) -> Calls:
    client = kind(settings)
    client.pairs_per_message = pairs_per_message
    return client


#: Channels of the process that this one was forked from. Never closed, since
#: closing would wait for threads that are not here.
inherited: list[Any] = []
_clients: weakref.WeakSet[Calls] = weakref.WeakSet()


def _after_fork() -> None:
    for client in list(_clients):
        inherited.append(client._opened)
        client._opened = None
        client._lock = threading.Lock()  # another thread may have held it


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def lacks_hulls(part: _answers.Columns) -> bool:
    """Whether the answer says that the server does not know some hull."""
    # Most answers lack none, and small ones are counted in microseconds.
    return len(part["missing_hulls"]) > 0 and bool(np.any(part["flags"] & Flag.UNKNOWN_HULL))


def _asked(link: Link, begin: Callable[[float | None], Any], deadline: float | None) -> Steps[Any]:
    """The answer of a call, made again where that helps."""
    for failures in itertools.count(1):
        try:
            return (yield begin(remaining(deadline)))
        except _errors.Unavailable as error:
            pause = pause_before(error, failures, deadline)
            if pause:
                yield link.pause(pause)
    raise AssertionError  # count has no end


def pause_before(error: _errors.Unavailable, failures: int, deadline: float | None) -> float:
    """Seconds to wait before a message is sent again, or the error where it is not.

    gRPC has tried already, but at most five times, and not where part of the
    answer had come.
    """
    if error.cut_off and failures <= _CUT_OFFS:
        return 0.0
    if error.retry_after is None or failures > _BUSY:
        raise error
    # Spread, so that those refused together do not come back together.
    pause = min(error.retry_after * 2 ** (failures - 1), _LONGEST_PAUSE) * random.uniform(0.5, 1.5)
    if deadline is not None and time.monotonic() + pause > deadline:
        raise error
    return pause


def stream_ended() -> _errors.Unavailable:
    """What a stream that ends without an error and without an answer is."""
    error = _errors.Unavailable("the server ended the stream", reason="STREAM_ENDED")
    error.cut_off = True
    return error


def halves_of(span: Span, error: _errors.Error) -> list[Span]:
    """The span in halves if its answer or its hulls were too large, else the error."""
    too_large = error.reason in ("RESPONSE_TOO_LARGE", "HULLS_TOO_LARGE")
    if not too_large or span.stop - span.start < 2:
        raise error
    return span.halves()


def remaining(deadline: float | None) -> float | None:
    """Seconds until then, for a call's timeout."""
    return None if deadline is None else max(0.0, deadline - time.monotonic())

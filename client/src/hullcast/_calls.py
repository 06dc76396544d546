"""The operations of a client, for both ways of waiting.

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

from . import _answers, _arguments, _channel, _errors, _manage, _reach
from ._hulls import Content, Hull
from ._manifolds import Manifolds
from ._query import Query, Span
from ._register import Registration
from ._scene import Scene
from ._wire import Flag

if TYPE_CHECKING:
    from typing_extensions import Self

    from ._serve import Server

T = TypeVar("T")

#: Yields what is waited for (`Link.start`, `.call`, `.stream`); returns the result.
Steps = Generator[Any, Any, T]

REGISTER = "/hullcast.v1.HullService/RegisterHulls"
QUERY = "/hullcast.v1.ContactService/QueryContacts"
FIND = "/hullcast.v1.ContactService/FindContacts"

#: The methods of one request and one answer.
UNARY = (REGISTER, QUERY, _manage.INFO, _manage.LIST, _manage.DELETE, _manage.GET)

#: Seconds in which a server answers the first call, GetServerInfo.
_PROOF_SECONDS = 5.0

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

    #: Whether a server has answered on it.
    proven: bool

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

    def run(self, function: Callable[[], Any]) -> Any:
        """The result of a function that blocks."""

    def shut(self) -> None:
        """Closes the channel, if that does not need an event loop."""

    def abandon(self) -> None:
        """Called where the channel belongs to another process or event loop."""


class Calls(ABC):
    """What `hullcast.Client` and `hullcast.aio.Client` have in common.

    Attributes:
        pairs_per_message: a larger query is split into messages of at most this
            many pairs, several at a time under way. The split changes no bit of
            the answer.
    """

    def __init__(self, settings: _channel.Settings, *, server: Server | None = None) -> None:
        self._settings = settings
        self._pairs_per_message = 4096
        #: The server that `serve` started for this client.
        self._server = server
        # A client that is forgotten takes its server with it, as does the end of the process.
        self._held: list[Link] = []
        self._forget = (
            None if server is None else weakref.finalize(self, _forgotten, server, self._held)
        )
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
        """A client of the server at `target`. It connects at the first call.

        The first call fails at once if nothing listens at the address, if only one
        side speaks TLS, or if the certificate is not trusted. After that, a call that
        finds no server, or one too busy, is tried again for some 12 seconds, within
        its timeout. A forked child that uses the client gets a connection of its own;
        pickling keeps only these settings.

        Args:
            target: "host:port", "unix:PATH", "http://host:port", "https://host:port", or
                several servers that calls are spread over: "dns:///name:port", followed
                as the name's addresses change, or a list of "host:port". The port is
                50051 if the address has none.
            tls: None for none (or for what the address says); True for TLS with the
                system's roots; the roots to trust, as PEM bytes or the path of a PEM
                file; or gRPC credentials.
            token: sent with every call, as a bearer token.
            timeout: seconds above 0 that a call may take unless it says otherwise; None
                or infinity: no limit.
            options: further gRPC channel options; each replaces this package's own
                option of that name.

        Raises:
            InvalidArgument: naming the argument.
        """
        return cls(_channel.Settings.of(target, tls, token, timeout, options))

    @property
    def pairs_per_message(self) -> int:
        """Pairs of a query in one message at most."""
        return self._pairs_per_message

    @pairs_per_message.setter
    def pairs_per_message(self, count: int) -> None:
        self._pairs_per_message = _arguments.integer("pairs_per_message", count, 1, 2**31 - 1)

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
        deadline = self._deadline(timeout)
        query = make()
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
        return query.delivered(_answers.merge(ordered))

    def _finding(self, make: Callable[[], Query], timeout: float | None) -> Steps[Manifolds]:
        deadline = self._deadline(timeout)
        query = make()
        message = query.find_message()
        found: _answers.Columns = {}
        for times in range(1, REGISTRATIONS + 2):
            link = yield from self._ready(deadline)
            begin = partial(link.stream, FIND, message.data)
            found = query.read_found(message, (yield from self._asked(link, begin, deadline)))
            lost = [found] if len(found["missing_hulls"]) else []
            last = times > REGISTRATIONS
            if last or not (yield from self._restore(query.scene, lost, times, deadline)):
                break
        return query.delivered(found)

    def _register(self, call: Registration, deadline: float | None) -> Steps[list[Hull]]:
        answers: list[bytes] = []
        for message, data in enumerate(call.requests()):
            try:
                answers.append((yield from self._ask(REGISTER, data, deadline)))
            except _errors.InvalidArgument as error:
                raise call.named(error, message) from None
        return call.read(answers, self._settings)

    def _informing(self, timeout: float | None) -> Steps[_manage.ServerInfo]:
        data = yield from self._ask(_manage.INFO, b"", self._deadline(timeout))
        return _manage.ServerInfo.read(data)

    def _pinging(self, timeout: float | None) -> Steps[float]:
        deadline = self._deadline(timeout)
        yield from self._ready(deadline)  # the connection is not part of the round trip
        started = time.perf_counter()
        yield from self._ask(_manage.INFO, b"", deadline)
        return time.perf_counter() - started

    def _listing(self, timeout: float | None) -> Steps[list[_manage.StoredHull]]:
        deadline = self._deadline(timeout)
        found: list[_manage.StoredHull] = []
        token = ""
        while True:
            data = yield from self._ask(_manage.LIST, _manage.list_request(token), deadline)
            page, token = _manage.read_page(data, found[-1].id if found else b"")
            found += page
            if not token:
                return found

    def _deleting(self, hulls: Any, timeout: float | None) -> Steps[list[bool]]:
        deadline = self._deadline(timeout)
        deleted: list[bool] = []
        for count, data in _manage.delete_requests(_manage.ids_of(hulls)):
            answer = yield from self._ask(_manage.DELETE, data, deadline)
            deleted += _manage.read_deleted(answer, count)
        return deleted

    def _facing(self, hull: Hull) -> Steps[Any]:
        deadline = self._deadline(None)
        request = _manage.faces_request(hull.id)
        try:
            answer = yield from self._ask(_manage.GET, request, deadline)
            return _manage.read_faces(answer, hull.id)
        except _errors.Error as error:
            if error.reason != "UNKNOWN_HULL":
                raise
        yield from self._register(Registration([hull.content]), deadline)
        answer = yield from self._ask(_manage.GET, request, deadline)
        return _manage.read_faces(answer, hull.id)

    def _ask(self, method: str, data: bytes, deadline: float | None) -> Steps[bytes]:
        """The answer to one message."""
        link = yield from self._ready(deadline)
        return (yield from self._asked(link, partial(link.call, method, data), deadline))

    def _asked(
        self, link: Link, begin: Callable[[float | None], Any], deadline: float | None
    ) -> Steps[Any]:
        """The answer of a call, made again if that helps."""
        for failures in itertools.count(1):
            try:
                return (yield begin(remaining(deadline)))
            except _errors.Unavailable as error:
                pause = self._pause_before(error, failures, deadline)
                if pause:
                    yield link.pause(pause)
        raise AssertionError  # count has no end

    def _ready(self, deadline: float | None) -> Steps[Link]:
        """The open channel, after a server has answered on it once.

        A first call that cannot succeed fails at once, with its cause: gRPC would try again for
        some 12 seconds, as is right after a connection that worked.
        """
        link = self._link()
        self._check_server()
        if link.proven:
            return link
        seconds = remaining(deadline)
        proof = _PROOF_SECONDS if seconds is None else min(seconds, _PROOF_SECONDS)
        try:
            yield link.call(_manage.INFO, b"", proof)
        except _errors.Unavailable as error:
            if error.reason == "UNAVAILABLE":  # of gRPC itself, not of a server
                cause = yield link.run(partial(self._cause, error))
                if cause is not None:
                    raise cause from None
                return link  # as gRPC's own retries may find it
        except _errors.DeadlineExceeded:
            if seconds is not None and seconds <= proof:
                raise
            return link
        except _errors.Error:
            pass  # a server has answered, and says more to the call itself
        link.proven = True
        return link

    def _cause(self, error: _errors.Unavailable) -> _errors.Unavailable | None:
        """The error of a connection that cannot be made, if waiting does not help."""
        settings, several = self._settings, not isinstance(self._settings.target, str)
        text = None if several else _reach.absent(self.target, settings.addresses)
        for target in settings.addresses if text is None else ():
            text = _reach.mismatch(target, error.message, settings.trust())
            if text is not None:
                break
        if text is None:
            return None
        return _errors.Unavailable(text, reason=error.reason)

    def _check_server(self, seconds: float = 0.0) -> None:
        """Raises if the server that `serve` started has ended, or ends within so many seconds."""
        if self._server is not None and not self._closed:
            how = self._server.how_it_ended(seconds)
            if how is not None:
                raise _errors.Unavailable(
                    f"the server that serve() started ended ({how})", reason="SERVER_ENDED"
                )

    def _pause_before(
        self, error: _errors.Unavailable, failures: int, deadline: float | None
    ) -> float:
        """Seconds to wait before a message is sent again, or the error if it is not.

        gRPC has tried already, but at most five times, and not after part of the answer had come.
        """
        # A connection breaks a moment before its server's end can be seen.
        self._check_server(0.2)
        if error.cut_off and failures <= _CUT_OFFS:
            return 0.0
        if error.retry_after is None or failures > _BUSY:
            raise error
        # Spread, so that those refused together do not come back together.
        wait = min(max(error.retry_after, 0.0) * 2 ** (failures - 1), _LONGEST_PAUSE)
        pause = wait * random.uniform(0.5, 1.5)
        if deadline is not None and time.monotonic() + pause > deadline:
            raise error
        return pause

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
        link = yield from self._ready(deadline)
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
                    pause = self._pause_before(error, failed[span], deadline)
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
        seconds = self.timeout if timeout is None else _arguments.seconds("timeout", timeout)
        if timeout is not None and seconds is None:
            return None  # infinity, although the client has a limit
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
                    self._held[:] = [opened[1]]
        return opened[1]

    def _place(self) -> object:
        """What a channel is bound to, apart from its process."""
        return None

    @abstractmethod
    def _open(self) -> Link: ...

    @abstractmethod
    def _run(self, steps: Steps[T]) -> T:
        """Waits for what the steps yield."""

    def _begin_close(self) -> tuple[Link | None, Callable[[], Any] | None]:
        """Marks the client closed; the channel to close, and what stops the client's server."""
        with self._lock:
            self._closed = True
            opened, self._opened = self._opened, None
            self._held.clear()
        link = None if opened is None else opened[1]
        server = self._release_server()
        return link, None if server is None else server.close

    def _release_server(self) -> Server | None:
        """The server that `serve` started, which then outlives this client."""
        if self._forget is not None:
            self._forget.detach()
        server, self._server, self._forget = self._server, None, None
        return server

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (type(self), self._settings, self.pairs_per_message)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.target!r})"


def _forgotten(server: Server, held: list[Link]) -> None:
    """Ends the server of a client that nobody has any more. An open connection would delay it."""
    for link in held:
        link.shut()
    server.forget()


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
        client._held.clear()
        client._lock = threading.Lock()  # another thread may have held it


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def lacks_hulls(part: _answers.Columns) -> bool:
    """Whether the answer says that the server does not know some hull."""
    # Most answers lack none, and small ones are counted in microseconds.
    return len(part["missing_hulls"]) > 0 and bool(np.any(part["flags"] & Flag.UNKNOWN_HULL))


def stream_ended() -> _errors.Unavailable:
    """What a stream that ends without an error and without an answer is."""
    error = _errors.Unavailable("the server ended the stream", reason="STREAM_ENDED")
    error.cut_off = True
    return error


#: Reasons for which a server refuses a message that its halves may not have.
_TOO_LARGE = (
    "RESPONSE_TOO_LARGE",
    "HULLS_TOO_LARGE",
    "MESSAGE_TOO_LARGE",
    "TOO_MANY_PAIRS",
    "TOO_MANY_BODIES",
    "TOO_MANY_HULLS",
)


def halves_of(span: Span, error: _errors.Error) -> list[Span]:
    """The span in halves if its message or its answer was too large, otherwise the error."""
    if error.reason not in _TOO_LARGE or span.stop - span.start < 2:
        raise error
    return span.halves()


def late() -> _errors.DeadlineExceeded:
    """A call that took longer than it may."""
    return _errors.DeadlineExceeded("no answer in time", reason="DEADLINE_EXCEEDED")


def remaining(deadline: float | None) -> float | None:
    """Seconds until then, for a call's timeout.

    Raises:
        DeadlineExceeded: it is past.
    """
    if deadline is None:
        return None
    seconds = deadline - time.monotonic()
    if seconds <= 0:
        raise late()
    return seconds

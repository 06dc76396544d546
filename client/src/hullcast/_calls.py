"""The operations of a client, written once for the blocking client and for asyncio.

Each operation is a generator. It yields the call whose result it needs next. The client
(`_client.py` or `aio.py`) waits for the call, and sends the result into the generator or throws the
call's error into it. The clients do nothing but wait.
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

from . import _answers, _arguments, _channel, _errors, _manage, _reach, _worlds
from ._arrays import Indices
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

#: A generator that yields what to wait for (from `Link.start`, `.call` or `.stream`) and returns
#: the operation's result.
Steps = Generator[Any, Any, T]

REGISTER = "/hullcast.v1.HullService/RegisterHulls"
QUERY = "/hullcast.v1.ContactService/QueryContacts"
FIND = "/hullcast.v1.ContactService/FindContacts"

#: The methods with one request and one response.
UNARY = (REGISTER, QUERY, _manage.INFO, _manage.LIST, _manage.DELETE, _manage.GET)

#: Seconds within which a server must answer the first call, GetServerInfo.
_PROOF_SECONDS = 5.0

#: Messages of one call that are in flight at once: enough that the server always has the next one
#: while this client reads the last response.
_IN_FLIGHT = 6

#: How often pairs are queried again after the hulls that the server lacks were registered.
REGISTRATIONS = 3

#: How often one message is sent again because its response was cut off. Each attempt is a call with
#: all of gRPC's own retries.
_CUT_OFFS = 3

#: How often one message is sent again to a server that is too busy, and the longest pause between
#: two attempts, in seconds: about 15 s in all.
_BUSY = 12
_LONGEST_PAUSE = 2.0


class Stream(Protocol):
    """An open stream: messages are sent, and answered in the order of sending."""

    def send(self, data: bytes) -> Any:
        """Returns what to wait for until the message is under way. `receive` reports any error."""

    def receive(self, timeout: float | None) -> Any:
        """Returns what to wait for until the oldest unanswered message is answered."""

    def cancel(self) -> None:
        """Ends the stream."""


class Link(Protocol):
    """An open channel. Each method that makes a call returns what the client has to wait for."""

    #: Whether a server has answered on this channel.
    proven: bool

    def start(self, method: str, data: bytes, timeout: float | None) -> Any:
        """Makes a unary call, which is under way at once. The result has `.cancel()`."""

    def call(self, method: str, data: bytes, timeout: float | None) -> Any:
        """Makes a unary call that the caller waits for immediately."""

    def stream(self, method: str, data: bytes, timeout: float | None) -> Any:
        """Makes a call whose response is a stream, and collects its messages in a list."""

    def open(self, method: str) -> Stream:
        """Opens a stream of messages in both directions."""
        ...

    def pause(self, seconds: float) -> Any:
        """Waits for some seconds."""

    def run(self, function: Callable[[], Any]) -> Any:
        """Runs a function that blocks, and gives its result."""

    def shut(self) -> None:
        """Closes the channel, if that is possible without an event loop."""

    def abandon(self) -> None:
        """Gives up a channel that belongs to another process or event loop."""


class Calls(ABC):
    """The common part of `hullcast.Client` and `hullcast.aio.Client`.

    Attributes:
        pairs_per_message: the largest number of pairs in one message, 4096 by default. A larger
            query is split into several messages, some of which are in flight at once. The split
            does not change any bit of the results.
    """

    def __init__(self, settings: _channel.Settings, *, server: Server | None = None) -> None:
        self._settings = settings
        self._pairs_per_message = 4096
        #: The server that `serve` started for this client, or None.
        self._server = server
        # The server ends when the client is garbage collected, or when the process ends.
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
        """Makes a client of the server at `target`. The connection is opened by the first call.

        The first call fails at once if nothing listens at the address, if only one side uses TLS,
        or if the server's certificate is not trusted. Later calls that find no server, or a server
        that is too busy, are retried for about 12 seconds, within their timeout. A forked child
        process that uses the client gets a connection of its own. Pickling keeps only the settings
        given here.

        Args:
            target: "host:port", "unix:PATH", "http://host:port" or "https://host:port"; or several
                servers over which calls are spread: "dns:///name:port", whose addresses are looked
                up again when they change, or a list of "host:port". The default port is 50051.
            tls: None for no TLS, unless the address begins with https://; True for TLS with the
                system's root certificates; the root certificates to trust, as PEM bytes or as the
                path of a PEM file; or gRPC credentials.
            token: the bearer token to send with every call.
            timeout: the default timeout of a call, in seconds above 0; None or infinity for no
                limit.
            options: further gRPC channel options, as (name, value) pairs. Each replaces this
                package's own option of the same name.

        Raises:
            InvalidArgument: an argument is not usable; the error names it.
        """
        return cls(_channel.Settings.of(target, tls, token, timeout, options))

    @property
    def pairs_per_message(self) -> int:
        """The largest number of pairs in one message."""
        return self._pairs_per_message

    @pairs_per_message.setter
    def pairs_per_message(self, count: int) -> None:
        self._pairs_per_message = _arguments.integer("pairs_per_message", count, 1, 2**31 - 1)

    @property
    def target(self) -> str:
        """The server's address; several addresses are separated by commas."""
        target = self._settings.target
        return target if isinstance(target, str) else ",".join(target)

    @property
    def timeout(self) -> float | None:
        """The default timeout of a call, in seconds; None for no limit."""
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
        parts = yield from self._find(query, None, deadline)
        return query.delivered(_worlds.together(parts))

    def _find(
        self, query: Query, bodies: Indices | None, deadline: float | None
    ) -> Steps[list[_answers.Columns]]:
        """Finds the pairs of all or some bodies; splits them by worlds if they are too many."""
        message = query.find_message(bodies)
        found: _answers.Columns = {}
        for times in range(1, REGISTRATIONS + 2):
            link = yield from self._ready(deadline)
            begin = partial(link.stream, FIND, message.data)
            try:
                answers = yield from self._asked(link, begin, deadline)
            except _errors.InvalidArgument as error:
                if error.reason not in _TOO_LARGE:
                    raise
                halves = _worlds.halves(query.scene, bodies, error)
                parts: list[_answers.Columns] = []
                for half in halves:
                    parts += yield from self._find(query, half, deadline)
                return parts
            found = query.read_found(message, answers)
            lost = [found] if len(found["missing_hulls"]) else []
            last = times > REGISTRATIONS
            if last or not (yield from self._restore(query.scene, lost, times, deadline)):
                break
        return [found]

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
        yield from self._ready(deadline)  # opening the connection is not part of the round trip
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
        """Sends one message of a unary call and returns the response."""
        link = yield from self._ready(deadline)
        return (yield from self._asked(link, partial(link.call, method, data), deadline))

    def _asked(
        self, link: Link, begin: Callable[[float | None], Any], deadline: float | None
    ) -> Steps[Any]:
        """Makes a call and returns its result; makes it again where a retry can help."""
        for failures in itertools.count(1):
            try:
                return (yield begin(remaining(deadline)))
            except _errors.Unavailable as error:
                pause = self._pause_before(error, failures, deadline)
                if pause:
                    yield link.pause(pause)
        raise AssertionError  # unreachable: `count` does not end

    def _ready(self, deadline: float | None) -> Steps[Link]:
        """Returns the open channel, after a server has answered on it once.

        If a first call cannot succeed, it fails at once with the cause. Without this check gRPC
        would retry for about 12 seconds, which is only right once the connection has worked.
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
            if error.reason == "UNAVAILABLE":  # from gRPC itself, not from a server
                cause = yield link.run(partial(self._cause, error))
                if cause is not None:
                    raise cause from None
                return link  # gRPC's own retries may still reach the server
        except _errors.DeadlineExceeded:
            if seconds is not None and seconds <= proof:
                raise
            return link
        except _errors.Error:
            pass  # a server has answered; the call itself will report the error
        link.proven = True
        return link

    def _cause(self, error: _errors.Unavailable) -> _errors.Unavailable | None:
        """The error for a connection that waiting cannot help to make; otherwise None."""
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
        """Raises Unavailable if the server of `serve` has ended, or ends within `seconds`."""
        if self._server is not None and not self._closed:
            how = self._server.how_it_ended(seconds)
            if how is not None:
                raise _errors.Unavailable(
                    f"the server that serve() started ended ({how})", reason="SERVER_ENDED"
                )

    def _pause_before(
        self, error: _errors.Unavailable, failures: int, deadline: float | None
    ) -> float:
        """Returns the seconds to wait before a retry; raises the error if there is to be none.

        gRPC itself has made up to five attempts by then, but it retries nothing after part of the
        response has arrived.
        """
        # The connection breaks shortly before the end of the server's process can be observed.
        self._check_server(0.2)
        if error.cut_off and failures <= _CUT_OFFS:
            return 0.0
        if error.retry_after is None or failures > _BUSY:
            raise error
        # The pauses are randomised, so that clients that were refused together do not return
        # together.
        wait = min(max(error.retry_after, 0.0) * 2 ** (failures - 1), _LONGEST_PAUSE)
        pause = wait * random.uniform(0.5, 1.5)
        if deadline is not None and time.monotonic() + pause > deadline:
            raise error
        return pause

    def _restore(
        self, scene: Scene, parts: Iterable[_answers.Columns], times: int, deadline: float | None
    ) -> Steps[bool]:
        """Registers the hulls that responses lack; returns whether the scene has points of any.

        Attempt number `times` registers the hulls that many times: calls may alternate between
        replicas that share no store, and a single registration per attempt could reach the same
        replica each time.
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
        """Queries every span, several at once; splits a span whose message is too large in two."""
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
                        # The server may be busy with this client's own messages, so send fewer.
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
            return None  # the caller passed infinity, which overrides the client's limit
        return None if seconds is None else time.monotonic() + seconds

    def _link(self) -> Link:
        """Returns the open channel.

        It is opened at first use, and again if `_place` has changed.
        """
        place = self._place()
        opened = self._opened
        if opened is None or opened[0] is not place:
            with self._lock:
                if self._closed:
                    raise _errors.Error(
                        "the client is closed: make a new one with hullcast.connect",
                        reason="CLOSED",
                    )
                opened = self._opened
                if opened is None or opened[0] is not place:
                    if opened is not None:
                        opened[1].abandon()
                    opened = self._opened = (place, self._open())
                    self._held[:] = [opened[1]]
        return opened[1]

    def _place(self) -> object:
        """The object, besides the process, to which a channel is bound: asyncio's event loop."""
        return None

    @abstractmethod
    def _open(self) -> Link: ...

    @abstractmethod
    def _run(self, steps: Steps[T]) -> T:
        """Runs an operation: waits for each call that it yields."""

    def _begin_close(self) -> tuple[Link | None, Callable[[], Any] | None]:
        """Marks the client as closed.

        Returns its channel and the function that stops its server.
        """
        with self._lock:
            self._closed = True
            opened, self._opened = self._opened, None
            self._held.clear()
        link = None if opened is None else opened[1]
        server = self._release_server()
        return link, None if server is None else server.close

    def _release_server(self) -> Server | None:
        """Detaches the server that `serve` started, so that it outlives this client."""
        if self._forget is not None:
            self._forget.detach()
        server, self._server, self._forget = self._server, None, None
        return server

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (type(self), self._settings, self.pairs_per_message)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.target!r})"


def _forgotten(server: Server, held: list[Link]) -> None:
    """Ends the server of a client that was garbage collected.

    The channels are closed first, since an open connection would delay the server's end.
    """
    for link in held:
        link.shut()
    server.forget()


def _unpickled(kind: type[Calls], settings: _channel.Settings, pairs_per_message: int) -> Calls:
    client = kind(settings)
    client.pairs_per_message = pairs_per_message
    return client


#: Channels that belong to the process from which this one was forked. They are never closed,
#: because closing would wait for threads that do not exist in this process.
inherited: list[Any] = []
_clients: weakref.WeakSet[Calls] = weakref.WeakSet()


def _after_fork() -> None:
    for client in list(_clients):
        inherited.append(client._opened)
        client._opened = None
        client._held.clear()
        client._lock = threading.Lock()  # another thread of the parent may have held the old one


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def lacks_hulls(part: _answers.Columns) -> bool:
    """Whether a response says that the server does not know some hull."""
    # Most responses lack no hull. For small responses even microseconds count, so test this first.
    return len(part["missing_hulls"]) > 0 and bool(np.any(part["flags"] & Flag.UNKNOWN_HULL))


def stream_ended() -> _errors.Unavailable:
    """The error for a stream that ended without an error before every message was answered."""
    error = _errors.Unavailable(
        "the server ended the stream before it had answered every message",
        reason="STREAM_ENDED",
    )
    error.cut_off = True
    return error


#: Error reasons that may not apply to the halves of a message.
_TOO_LARGE = (
    "RESPONSE_TOO_LARGE",
    "HULLS_TOO_LARGE",
    "MEMORY_TOO_LARGE",
    "MESSAGE_TOO_LARGE",
    "TOO_MANY_PAIRS",
    "TOO_MANY_BODIES",
    "TOO_MANY_HULLS",
)


def halves_of(span: Span, error: _errors.Error) -> list[Span]:
    """Splits a span in two if its message or response was too large, or raises the error."""
    if error.reason not in _TOO_LARGE or span.stop - span.start < 2:
        raise error
    return span.halves()


def late() -> _errors.DeadlineExceeded:
    """The error for a call that exceeded its timeout."""
    return _errors.DeadlineExceeded("no answer within the timeout", reason="DEADLINE_EXCEEDED")


def remaining(deadline: float | None) -> float | None:
    """The seconds from now until a deadline, for the timeout of a call.

    Raises:
        DeadlineExceeded: the deadline has passed.
    """
    if deadline is None:
        return None
    seconds = deadline - time.monotonic()
    if seconds <= 0:
        raise late()
    return seconds

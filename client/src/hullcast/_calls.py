"""The operations of a client, written once for the blocking client and for asyncio.

Each operation is a generator. It yields the call whose result it needs next. The client
(`_client.py` or `aio.py`) waits for the call, and sends the result into the generator or throws the
call's error into it. The clients do nothing but wait.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _answers, _arguments, _channel, _errors, _manage, _worlds
from ._arrays import Indices
from ._connection import Connection, Home
from ._hulls import Content, Hull
from ._link import Steps, remaining
from ._manifolds import Manifolds
from ._query import Query, Span
from ._register import Registration
from ._scene import Scene
from ._wire import Flag

if TYPE_CHECKING:
    from ._serve import Server

REGISTER = "/hullcast.v1.HullService/RegisterHulls"
QUERY = "/hullcast.v1.ContactService/QueryContacts"
FIND = "/hullcast.v1.ContactService/FindContacts"

#: The methods with one request and one response.
UNARY = (REGISTER, QUERY, _manage.INFO, _manage.LIST, _manage.DELETE, _manage.GET)

#: Messages of one call that are in flight at once: enough that the server always has the next one
#: while this client reads the last response.
_IN_FLIGHT = 6

#: How often pairs are queried again after the hulls that the server lacks were registered.
REGISTRATIONS = 3


class Calls(Connection):
    """The common part of `hullcast.Client` and `hullcast.aio.Client`.

    Attributes:
        pairs_per_message: the largest number of pairs in one message, 4096 by default. A larger
            query is split into several messages, some of which are in flight at once. The split
            does not change any bit of the results.
    """

    def __init__(self, settings: _channel.Settings, *, server: Server | None = None) -> None:
        super().__init__(settings, server=server)
        self._pairs_per_message = 4096

    @property
    def pairs_per_message(self) -> int:
        """The largest number of pairs in one message."""
        return self._pairs_per_message

    @pairs_per_message.setter
    def pairs_per_message(self, count: int) -> None:
        self._pairs_per_message = _arguments.integer("pairs_per_message", count, 1, 2**31 - 1)

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
            lost = {span: part for span, part in parts.items() if lacks_hulls(part, query)}
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
            try:
                answers = yield from self._asked(
                    link, lambda to, left: to.stream(FIND, message.data, left), deadline
                )
            except _errors.InvalidArgument as error:
                if error.reason not in _TOO_LARGE:
                    raise
                halves = _worlds.halves(query.scene, bodies, error)
                parts: list[_answers.Columns] = []
                for half in halves:
                    parts += yield from self._find(query, half, deadline)
                return parts
            parsed = [_answers.Answer(data, message.request_id) for data in answers[:1]]
            for answer in parsed:
                yield from self._check_contract(query, answer, deadline)
            number = message.request_id
            rest = (_answers.Answer(data, number) for data in answers[1:])
            found = query.read_found(message, itertools.chain(parsed, rest))
            lost = [found] if len(found["missing_hulls"]) else []
            last = times > REGISTRATIONS
            if last or not (yield from self._restore(query.scene, lost, times, deadline)):
                break
        return [found]

    def _register(self, call: Registration, deadline: float | None) -> Steps[list[Hull]]:
        answers: dict[Span, bytes] = {}
        waiting = deque(call.spans())
        while waiting:
            span = waiting.popleft()
            try:
                answers[span] = yield from self._ask(REGISTER, call.request(span), deadline)
            except _errors.InvalidArgument as error:
                if error.reason not in _TOO_LARGE or span.stop - span.start < 2:
                    raise call.named(error, span) from None
                waiting.extendleft(reversed(span.halves()))
        return call.read(answers, Home(self._settings, self._watched))

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
        waiting = deque(_manage.delete_parts(_manage.ids_of(hulls)))
        while waiting:
            part = waiting.popleft()
            request = _manage.delete_request(part)
            try:
                answer = yield from self._ask(_manage.DELETE, request, deadline)
            except _errors.InvalidArgument as error:
                if error.reason not in _TOO_LARGE or len(part) < 2:
                    raise
                # The server's limit is lower than the usual one.
                middle = len(part) // 2
                waiting.extendleft([part[middle:], part[:middle]])
            else:
                deleted += _manage.read_deleted(answer, len(part))
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

    def _check_contract(
        self, query: Query, answer: _answers.Answer, deadline: float | None
    ) -> Steps[None]:
        """Checks that the server which sent a response knows the fields of the query.

        Raises:
            Unimplemented: SERVER_TOO_OLD.
        """
        contract = int(answer.message.contract)
        if contract < query.contract:
            raise (yield from self._too_old(query, contract, deadline))

    def _too_old(
        self, query: Query, contract: int, deadline: float | None
    ) -> Steps[_errors.Unimplemented]:
        """The error for a server that does not know a field of a query, and ignored it.

        A server ignores the fields that it does not know, and would answer another question. Each
        answer therefore has the contract number of its server, which rises whenever a field is
        added that changes answers.
        """
        data = yield from self._ask(_manage.INFO, b"", deadline)
        version = _manage.ServerInfo.read(data).version
        return _errors.Unimplemented(
            f"the server's version {version} does not know {query.unknown_to_old}: its answers "
            f"have the contract number {contract}, expected {query.contract} or more. Update the "
            "server",
            reason="SERVER_TOO_OLD",
        )

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
                    pause, link = yield from self._after(error, failed[span], deadline, link)
                    if pause:
                        # The server may be busy with this client's own messages, so send fewer.
                        window = max(1, window // 2)
                        yield link.pause(pause)
                    waiting.appendleft(span)
                else:
                    answer = _answers.Answer(data, message.request_id)
                    yield from self._check_contract(query, answer, deadline)
                    parts[span] = query.read(span, message, answer)
            return parts
        finally:
            for _, _, call in under_way:
                call.cancel()

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (type(self), self._settings, self.pairs_per_message)


def _unpickled(kind: type[Calls], settings: _channel.Settings, pairs_per_message: int) -> Calls:
    client = kind(settings)
    client.pairs_per_message = pairs_per_message
    return client


def lacks_hulls(part: _answers.Columns, query: Query) -> bool:
    """Whether a response says that the server does not know some hull."""
    # Most responses lack no hull. For small responses even microseconds count, so test this first.
    # If the server finds the pairs, it fails where a hull cannot be read, and no pair has a flag.
    return len(part["missing_hulls"]) > 0 and (
        query.finds or bool(np.any(part["flags"] & Flag.UNKNOWN_HULL))
    )


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

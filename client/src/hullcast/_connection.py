"""A client's connection: when it is opened, tried and closed, and which failed calls are repeated.

A connection is opened by its first call, again in a forked child process, and again in another
event loop. Everything that waits is a generator, as in `_calls.py`.
"""

from __future__ import annotations

import itertools
import os
import random
import threading
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from . import _arguments, _channel, _errors, _manage, _reach, _subset
from ._link import Link, Steps, remaining
from ._settled import Settled

if TYPE_CHECKING:
    from typing_extensions import Self

    from ._serve import Server

T = TypeVar("T")

#: Seconds within which a server must answer the first call, GetServerInfo.
_PROOF_SECONDS = 5.0

#: How often one message is sent again because its response was cut off. Each attempt is a call with
#: all of gRPC's own retries.
_CUT_OFFS = 3

#: How often one message is sent again to a server that is too busy, and the longest pause between
#: two attempts, in seconds: about 15 s in all.
_BUSY = 12
_LONGEST_PAUSE = 2.0

#: Seconds after which a client that uses servers beyond its subset tries the subset again, and
#: within which a server of the subset must answer then.
_RETURN_SECONDS = 30.0
_PROBE_SECONDS = 1.0


@dataclass(frozen=True, eq=False)
class Home:
    """A hull's memory of the client that registered it: how to ask its server again."""

    settings: _channel.Settings
    #: The server that `serve` started for the client, or None. It ends with that client.
    server: Server | None


class Connection(Settled, ABC):
    """The connection of a client, without the operations."""

    _instead: ClassVar[dict[str, str]] = {
        "timeout": "give it to hullcast.connect, or to a call",
        "target": "make a new client with hullcast.connect",
        "": "give settings to hullcast.connect and to the calls",
    }

    def __init__(self, settings: _channel.Settings, *, server: Server | None = None) -> None:
        self._settings = settings
        #: The server that `serve` started for this client, or None.
        self._server = server
        #: The server whose end explains failed calls, or None.
        self._watched = server
        # The server ends when the client is garbage collected, or when the process ends.
        self._held: list[Link] = []
        self._forget = (
            None if server is None else weakref.finalize(self, _forgotten, server, self._held)
        )
        self._closed = False
        self._lock = threading.Lock()
        self._opened: tuple[Any, Link] | None = None
        self._choose()
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
        subset: int | None = None,
        identity: str | None = None,
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
            subset: how many servers of a list of addresses this client uses, 1 or more; by default
                8. They are chosen by a hash of the client's identity and the address, so that many
                clients spread evenly, and a server that leaves or joins the list changes few
                subsets. If none of them can be reached, the client uses others of the list, and
                tries its subset again every 30 seconds. A number as large as the list uses all.
            identity: 1 to 200 visible ASCII characters that choose the subset; by default random.
                Clients with the same identity use the same servers. A random identity is not
                pickled or inherited by a forked process.

        Raises:
            InvalidArgument: an argument is not usable; the error names it.
        """
        return cls(_channel.Settings.of(target, tls, token, timeout, options, subset, identity))

    def _choose(self) -> None:
        """Chooses the client's subset of the servers. A random identity is drawn anew."""
        identity = self._settings.identity or _subset.random_identity()
        #: The groups of servers to use one after the other, and the number of the one in use.
        self._groups = self._settings.groups(identity)
        self._group = 0
        self._return_at = 0.0
        #: Whether a server has answered in this process and event loop.
        self._has_worked = False

    @classmethod
    def _of_home(cls, home: Home) -> Self:
        """A client of the server of a hull, which does not end that server."""
        client = cls(home.settings)
        client._watched = home.server
        return client

    @property
    def target(self) -> str:
        """The server's address; several addresses are separated by commas."""
        target = self._settings.target
        return target if isinstance(target, str) else ",".join(target)

    @property
    def timeout(self) -> float | None:
        """The default timeout of a call, in seconds; None for no limit."""
        return self._settings.timeout

    def _ask(self, method: str, data: bytes, deadline: float | None) -> Steps[bytes]:
        """Sends one message of a unary call and returns the response."""
        link = yield from self._ready(deadline)
        return (
            yield from self._asked(link, lambda to, left: to.call(method, data, left), deadline)
        )

    def _asked(
        self, link: Link, begin: Callable[[Link, float | None], Any], deadline: float | None
    ) -> Steps[Any]:
        """Makes a call and returns its result; makes it again where a retry can help."""
        for failures in itertools.count(1):
            try:
                return (yield begin(link, remaining(deadline)))
            except _errors.Unavailable as error:
                pause, link = yield from self._after(error, failures, deadline, link)
                if pause:
                    yield link.pause(pause)
        raise AssertionError  # unreachable: `count` does not end

    def _after(
        self, error: _errors.Unavailable, failures: int, deadline: float | None, link: Link
    ) -> Steps[tuple[float, Link]]:
        """Returns the seconds to wait before a retry, and the channel for it.

        If no server of the subset can be reached, it is the channel of other servers of the list.

        Raises:
            Unavailable: the error, because there is to be no retry.
        """
        try:
            return self._pause_before(error, failures, deadline), link
        except _errors.Unavailable:
            # An error of gRPC itself. Each repetition uses a group that has just answered, so the
            # limit matters only if servers come and go all the time.
            if error.reason != "UNAVAILABLE" or not 1 < len(self._groups) >= failures:
                raise
        link.proven = False
        other = yield from self._ready(deadline)
        if not other.proven:
            raise error
        return 0.0, other

    def _ready(self, deadline: float | None) -> Steps[Link]:
        """Returns the open channel, after a server has answered on it once.

        If no server of the subset can be reached, the next group of servers is tried, and so on. If
        a first call cannot succeed, it fails at once with the cause. Without this check gRPC would
        retry for about 12 seconds, which is only right once the connection has worked.
        """
        if self._group and time.monotonic() >= self._return_at:
            yield from self._return(deadline)
        link = self._link()
        self._check_server()
        first: _errors.Unavailable | None = None
        for _ in self._groups:
            if link.proven:
                return link
            error = yield from self._prove(link, deadline)
            if error is None:
                return link
            first = first or error
            self._leave(link)
            link = self._link()
        if first is not None:
            cause = None
            if not self._has_worked:
                cause = yield link.run(partial(self._cause, first))
            if cause is not None:
                raise cause from None
            link.trouble = first.message
        return link  # gRPC's own retries may still reach a server

    def _prove(self, link: Link, deadline: float | None) -> Steps[_errors.Unavailable | None]:
        """Asks whether a server answers on a channel; returns the error if none can be reached."""
        seconds = remaining(deadline)
        proof = _PROOF_SECONDS if seconds is None else min(seconds, _PROOF_SECONDS)
        try:
            answer = yield link.call(_manage.INFO, b"", proof)
            link.max_calls = _manage.max_calls(answer)
        except _errors.Unavailable as error:
            if error.reason == "UNAVAILABLE":  # from gRPC itself, not from a server
                return error
        except _errors.DeadlineExceeded:
            if seconds is not None and seconds <= proof:
                raise
            return None
        except _errors.Error:
            pass  # a server has answered; the call itself will report the error
        link.proven, link.trouble = True, ""
        self._has_worked = True
        return None

    def _leave(self, link: Link) -> None:
        """Goes on to the next group of servers, unless another thread has left the channel."""
        with self._lock:
            if len(self._groups) > 1 and self._opened is not None and self._opened[1] is link:
                if not self._group:
                    self._return_at = time.monotonic() + _RETURN_SECONDS
                self._group = (self._group + 1) % len(self._groups)
                # The channel closes when the last call and session on it have ended.
                self._opened = None

    def _return(self, deadline: float | None) -> Steps[None]:
        """Goes back to the subset if one of its servers answers."""
        self._return_at = time.monotonic() + _RETURN_SECONDS
        place = self._place()
        link = self._open(self._groups[0])
        seconds = remaining(deadline)
        probe = _PROBE_SECONDS if seconds is None else min(seconds, _PROBE_SECONDS)
        try:
            answer = yield link.call(_manage.INFO, b"", probe)
        except _errors.Error:
            link.shut()
            return
        link.proven, link.max_calls = True, _manage.max_calls(answer)
        with self._lock:
            if not self._closed and self._group:
                self._group, self._opened = 0, (place, link)

    def _explain(self, error: _errors.DeadlineExceeded, timeout: float | None) -> None:
        """Adds the timeout to a late call's error, and why no server has answered, if known.

        `timeout` is the call's own timeout; None for the client's.
        """
        seconds = self.timeout if timeout is None else _arguments.seconds("timeout", timeout)
        if seconds is not None:
            within = "within the timeout"
            error.message = error.message.replace(within, f"{within} of {seconds:g} s", 1)
        opened = self._opened
        if opened is not None and len(self._groups) > 1:
            # Perhaps the whole subset is down: the next call asks, and goes elsewhere if it is.
            opened[1].proven = False
        trouble = "" if opened is None else opened[1].trouble
        if trouble and trouble not in error.message:
            error.message += f". The first attempt failed: {trouble}"

    def _cause(self, error: _errors.Unavailable) -> _errors.Unavailable | None:
        """The error for a connection that waiting cannot help to make; otherwise None."""
        settings = self._settings
        text = _reach.absent(self.target, settings.addresses)
        for target in settings.addresses if text is None else ():
            text = _reach.mismatch(target, error.transport, settings.trust())
            if text is not None:
                break
        if text is None:
            return None
        return _errors.Unavailable(text, reason=error.reason)

    def _check_server(self, seconds: float = 0.0) -> None:
        """Raises Unavailable if the server of `serve` has ended, or ends within `seconds`."""
        if self._watched is not None and not self._closed:
            how = self._watched.how_it_ended(seconds)
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
                        self._has_worked = False
                    opened = self._opened = (place, self._open(self._groups[self._group]))
                    self._held[:] = [opened[1]]
        return opened[1]

    def _place(self) -> object:
        """The object, besides the process, to which a channel is bound: asyncio's event loop."""
        return None

    @abstractmethod
    def _open(self, group: _channel.Target) -> Link: ...

    @abstractmethod
    def _run(self, steps: Steps[T], timeout: float | None = None) -> T:
        """Runs an operation: waits for each call that it yields.

        `timeout` is the operation's timeout as the caller gave it, for the error of a late call.
        """

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

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.target!r})"


def _forgotten(server: Server, held: list[Link]) -> None:
    """Ends the server of a client that was garbage collected.

    The channels are closed first, since an open connection would delay the server's end.
    """
    for link in held:
        link.shut()
    server.forget()


#: Channels that belong to the process from which this one was forked. They are never closed,
#: because closing would wait for threads that do not exist in this process.
inherited: list[Any] = []
_clients: weakref.WeakSet[Connection] = weakref.WeakSet()


def _after_fork() -> None:
    for client in list(_clients):
        inherited.append(client._opened)
        client._opened = None
        client._held.clear()
        client._choose()
        client._lock = threading.Lock()  # another thread of the parent may have held the old one


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)

"""The synchronous client: the calls themselves."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from types import TracebackType
from typing import Any

import grpc

from . import _answers, _errors
from ._hulls import Hull, Registration
from ._manifolds import Manifolds
from ._query import Accuracy, Query, Span
from ._scene import Scene

_HULLS = "/hullcast.v1.HullService/"
_CONTACTS = "/hullcast.v1.ContactService/"

#: Messages of one call under way at once: enough that the server always has
#: the next one while this side reads the last.
_IN_FLIGHT = 6

_OPTIONS = (
    # The server's limits are the ones that count.
    ("grpc.max_send_message_length", -1),
    ("grpc.max_receive_message_length", -1),
    # Columns are megabytes: fewer frames, and windows that take a whole message.
    ("grpc.http2.max_frame_size", 1 << 20),
    ("grpc.http2.lookahead_bytes", 8 << 20),
)


class Client:
    """A connection to a server; made by `connect` or `serve`, closed by `close` or `with`.

    Its calls may be made from several threads at once.

    Attributes:
        pairs_per_message: larger queries are split into messages of at most
            this many pairs, several at a time under way. The split changes no
            bit of the answer.
    """

    def __init__(
        self,
        channel: grpc.Channel,
        *,
        target: str,
        timeout: float | None,
        metadata: Sequence[tuple[str, str]] = (),
        on_close: Callable[[], None] | None = None,
    ) -> None:
        self.target = target
        self.timeout = timeout
        self.pairs_per_message = 4096
        self._channel = channel
        self._metadata = tuple(metadata)
        self._on_close = on_close
        self._register = channel.unary_unary(_HULLS + "RegisterHulls")
        self._query = channel.unary_unary(_CONTACTS + "QueryContacts")
        self._find = channel.unary_stream(_CONTACTS + "FindContacts")

    def register(
        self,
        hulls: Iterable[Any],
        *,
        contraction_points: Any = None,
        max_vertices: int | None = None,
        max_deviation: float | None = None,
        timeout: float | None = None,
    ) -> list[Hull]:
        """Registers convex hulls, each given by points; those already known cost little.

        Args:
            hulls: per hull an array (n, 3) or an object with such `.vertices`,
                as trimesh's. Points inside are dropped, none is moved.
            contraction_points: per hull (3,), strictly inside, or None: the
                centre of mass.
            max_vertices, max_deviation: simplify to at most so many vertices, or
                by at most so much.
            timeout: seconds for the whole call; the client's by default.

        Raises:
            HullRejected: some are no hulls; the others are registered, see its `results`.
        """
        call = Registration(hulls, contraction_points, max_vertices, max_deviation)
        deadline = _deadline(self.timeout if timeout is None else timeout)
        return call.read([self._call(self._register, data, deadline) for data in call.requests()])

    def query(
        self,
        scene: Scene,
        pairs: Any,
        *,
        margin: float = 0.0,
        accuracy: Accuracy | None = None,
        outputs: Iterable[str] | None = None,
        warm: Manifolds | None = None,
        timeout: float | None = None,
    ) -> Manifolds:
        """The contact manifold of each pair.

        Args:
            scene: the bodies.
            pairs: (n, 2) integers, body indices A, B.
            margin: contact points are wanted where the hulls are within it;
                infinity gives every pair its numbers and points.
            accuracy: the solver and how exact; to rounding by default.
            outputs: names of `OUTCOME`, `ALPHA`, `NORMAL`, `POINTS`, `WITNESS_B`,
                `FEATURES`, `BASES`, `DIAGNOSTICS`: what is computed and sent;
                by default ALPHA, NORMAL and POINTS.
            warm: earlier manifolds of the same pairs, with output BASES: where
                the solver starts.
            timeout: seconds for the whole call; the client's by default.
        """
        query = Query(scene, pairs, margin=margin, accuracy=accuracy, outputs=outputs, warm=warm)
        deadline = _deadline(self.timeout if timeout is None else timeout)
        spans = query.spans(self.pairs_per_message)
        return Manifolds(_answers.merge(self._exchange(query, spans, deadline)))

    def find(
        self,
        scene: Scene,
        *,
        margin: float = 0.0,
        accuracy: Accuracy | None = None,
        outputs: Iterable[str] | None = None,
        timeout: float | None = None,
    ) -> Manifolds:
        """The contact manifolds of all pairs within the margin; the server finds them.

        The arguments are those of `query`; the pairs found are `.pairs`, sorted.
        """
        query = Query(scene, None, margin=margin, accuracy=accuracy, outputs=outputs)
        deadline = _deadline(self.timeout if timeout is None else timeout)
        stream = self._find(
            query.find_message(), timeout=_remaining(deadline), metadata=self._metadata
        )
        try:
            parts = [query.read(None, None, data) for data in stream]
        except grpc.RpcError as error:
            raise _errors.from_rpc(error) from None
        return Manifolds(_answers.merge(parts or [query.read(None, None, b"")]))

    def _call(self, method: Any, data: bytes, deadline: float | None) -> bytes:
        try:
            return method(data, timeout=_remaining(deadline), metadata=self._metadata)
        except grpc.RpcError as error:
            raise _errors.from_rpc(error) from None

    def _exchange(
        self, query: Query, spans: list[Span], deadline: float | None
    ) -> list[_answers.Columns]:
        """Asks for every span, some at a time, and returns the answers in their order."""
        if len(spans) == 1:
            waiting: deque[Span] = deque()
            first = query.message(spans[0])
            try:
                return [query.read(spans[0], first, self._call(self._query, first.data, deadline))]
            except _errors.InvalidArgument as error:
                waiting.extend(_halves(spans[0], error))
        else:
            waiting = deque(spans)
        parts: list[_answers.Columns] = []
        under_way: deque[tuple[Any, ...]] = deque()
        try:
            while waiting or under_way:
                while waiting and len(under_way) < _IN_FLIGHT:
                    span = waiting.popleft()
                    message = query.message(span)
                    future = self._query.future(
                        message.data, timeout=_remaining(deadline), metadata=self._metadata
                    )
                    under_way.append((span, message, future))
                span, message, future = under_way.popleft()
                try:
                    parts.append(query.read(span, message, future.result()))
                except grpc.RpcError as error:
                    # Whatever was sent after it has to wait, to keep the order.
                    waiting.extendleft(entry[0] for entry in reversed(under_way))
                    _cancel(under_way)
                    waiting.extendleft(reversed(_halves(span, _errors.from_rpc(error))))
            return parts
        finally:
            _cancel(under_way)

    def close(self) -> None:
        """Closes the connection, and the server where `serve` started it."""
        self._channel.close()
        if self._on_close is not None:
            self._on_close()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Client({self.target!r})"


def connect(
    target: str,
    *,
    tls: bool | bytes | str | os.PathLike[str] | grpc.ChannelCredentials | None = None,
    token: str | None = None,
    timeout: float | None = 60,
    options: Iterable[tuple[str, Any]] = (),
) -> Client:
    """A client of the server at `target`. Connects at the first call.

    Args:
        target: "host:port" or "unix:PATH".
        tls: None for none; True for TLS with the system's roots; the roots to
            trust, as PEM bytes or the path of a PEM file; or gRPC credentials.
        token: sent with every call, as a bearer token.
        timeout: seconds that a call may take unless it says otherwise; None: any.
        options: further gRPC channel options.
    """
    merged: dict[str, Any] = dict(_OPTIONS)
    if target.startswith("unix:"):
        # Else the authority is the socket's path, which HTTP/2 servers refuse.
        merged["grpc.default_authority"] = "localhost"
    merged.update(options)
    channel_options = list(merged.items())
    if tls is None or tls is False:
        channel = grpc.insecure_channel(target, options=channel_options)
    else:
        channel = grpc.secure_channel(target, _credentials(tls), options=channel_options)
    metadata = () if token is None else (("authorization", f"Bearer {token}"),)
    return Client(channel, target=target, timeout=timeout, metadata=metadata)


def _credentials(tls: Any) -> grpc.ChannelCredentials:
    if isinstance(tls, grpc.ChannelCredentials):
        return tls
    if tls is True:
        return grpc.ssl_channel_credentials()
    if isinstance(tls, bytes):
        return grpc.ssl_channel_credentials(root_certificates=tls)
    with open(tls, "rb") as file:
        return grpc.ssl_channel_credentials(root_certificates=file.read())


def _halves(span: Span, error: _errors.Error) -> list[Span]:
    """The span in halves if its answer was too large, else the error."""
    if error.reason != "RESPONSE_TOO_LARGE" or span.stop - span.start < 2:
        raise error
    return span.halves()


def _cancel(under_way: deque[tuple[Any, ...]]) -> None:
    while under_way:
        under_way.pop()[2].cancel()


def _deadline(timeout: float | None) -> float | None:
    return None if timeout is None else time.monotonic() + timeout


def _remaining(deadline: float | None) -> float | None:
    return None if deadline is None else max(0.0, deadline - time.monotonic())

"""The asyncio client: the same operations, with `await`.

    async with hullcast.aio.connect("localhost:50051") as client:  # or hullcast.aio.serve()
        hulls = await client.register([vertices_a, vertices_b])
        m = await client.query(hullcast.Scene(hulls, positions, rotations), pairs)

Arguments, results and errors are those of `hullcast.Client`. Several tasks may make calls on one
client at once. Cancelling a task cancels its calls on the server. A client may be used in one event
loop after another, but not in two at the same time.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine, Generator, Iterable
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, Concatenate, Literal, NoReturn, ParamSpec, TypeVar

from . import _calls, _channel, _client, _errors, _link, _serve, _session, _status
from ._grpc import grpc
from ._manifolds import Manifolds
from ._query import Accuracy
from ._scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Self

T = TypeVar("T")
P = ParamSpec("P")

__all__ = ["Client", "Session", "connect", "serve"]


def __dir__() -> list[str]:
    return sorted(__all__)


def _awaited(
    method: Callable[Concatenate[Any, P], T],
) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """Retypes a blocking method as a coroutine function: here `_run` returns a coroutine."""
    return method  # type: ignore[return-value]


class Client(_calls.Calls):
    """A connection to a server, whose calls are awaited.

    Make a client with `connect` or `serve`, and close it with `close` or `async with`.
    """

    __doc__ = f"{__doc__}\n{_calls.Calls.__doc__}"

    register = _awaited(_client.Client.register)
    query = _awaited(_client.Client.query)
    find = _awaited(_client.Client.find)
    info = _awaited(_client.Client.info)
    ping = _awaited(_client.Client.ping)
    hulls = _awaited(_client.Client.hulls)
    delete = _awaited(_client.Client.delete)

    def session(
        self,
        scene: Scene,
        pairs: Any = None,
        *,
        find: bool = False,
        margin: float = 0.0,
        accuracy: Accuracy | None = None,
        outputs: Iterable[str] | None = None,
        warm: Manifolds | None = None,
        on_invalid: Literal["raise", "flag"] = "raise",
    ) -> Session:
        """As `hullcast.Client.session`. Do not await this method; await the session's steps."""
        make = partial(
            _session.query_of,
            scene,
            pairs,
            find=find,
            margin=margin,
            accuracy=accuracy,
            outputs=outputs,
            warm=warm,
            on_invalid=on_invalid,
        )
        return Session(self, make)

    def _place(self) -> object:
        return asyncio.get_running_loop()

    def _open(self, group: _channel.Target) -> _link.Link:
        return _Link(self._settings.open(grpc.aio, group), self._settings.metadata)

    async def _drive(self, steps: _link.Steps[T], timeout: float | None) -> T:
        try:
            waited_for = next(steps)
            while True:
                try:
                    answer = await waited_for
                except grpc.RpcError as error:
                    waited_for = steps.throw(_status.from_rpc(error))
                except _errors.Error as error:
                    waited_for = steps.throw(error)
                else:
                    waited_for = steps.send(answer)
        except StopIteration as done:
            return done.value
        except _errors.DeadlineExceeded as error:
            self._explain(error, timeout)
            raise
        finally:
            steps.close()

    def _run(self, steps: _link.Steps[T], timeout: float | None = None) -> T:
        return self._drive(steps, timeout)  # type: ignore[return-value]

    async def close(self) -> None:
        """Closes the connection, and ends the server if `serve` started it."""
        link, stop_server = self._begin_close()
        if isinstance(link, _Link):
            await link.channel.close()
        if stop_server is not None:
            await asyncio.to_thread(stop_server)

    def __enter__(self) -> NoReturn:
        raise _plain_with()

    def __exit__(self, *error: object) -> None:
        """Defined so that a plain `with` reaches the message of `__enter__`."""

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()


class Session(_session.Steps):
    """A step loop. Make one with `Client.session`, end it with `close` or `async with`."""

    __doc__ = f"{__doc__}\n{_client.Session.__doc__}"

    step = _awaited(_client.Session.step)
    update = _awaited(_client.Session.update)

    def __enter__(self) -> NoReturn:
        raise _plain_with()

    def __exit__(self, *error: object) -> None:
        """Defined so that a plain `with` reaches the message of `__enter__`."""

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


class _Link:
    """The calls on a `grpc.aio.Channel`."""

    def __init__(self, channel: Any, metadata: Callable[[], _channel.Metadata]) -> None:
        self.channel = channel
        self._metadata = metadata
        self._unary: dict[str, Any] = {name: channel.unary_unary(name) for name in _calls.UNARY}
        self._stream: Any = channel.unary_stream(_calls.FIND)
        self.proven = False
        self.max_calls = 0
        self.trouble = ""

    def start(self, method: str, data: bytes, timeout: float | None) -> Any:
        return self._unary[method](data, timeout=timeout, metadata=self._metadata())

    call = start

    async def stream(self, method: str, data: bytes, timeout: float | None) -> list[bytes]:
        assert method == _calls.FIND
        call = self._stream(data, timeout=timeout, metadata=self._metadata())
        return [message async for message in call]

    def open(self, method: str) -> _link.Stream:
        return _Stream(self.channel.stream_stream(method)(metadata=self._metadata()))

    def pause(self, seconds: float) -> Any:
        return asyncio.sleep(seconds)

    def run(self, function: Callable[[], Any]) -> Any:
        return asyncio.to_thread(function)

    def shut(self) -> None:
        pass  # only the channel's event loop could close it

    def abandon(self) -> None:
        pass  # the channel's event loop has ended, and its sockets with it


class _Stream:
    """A stream on a `grpc.aio.Channel`."""

    def __init__(self, call: Any) -> None:
        self._call = call

    async def send(self, data: bytes, timeout: float | None) -> None:
        # If the stream has failed, reading from it reports the error. Writing waits until the
        # connection has a free stream, which may never be.
        with contextlib.suppress(grpc.RpcError, asyncio.InvalidStateError):
            try:
                await asyncio.wait_for(self._call.write(data), timeout)
            except asyncio.TimeoutError:
                raise _link.late() from None

    async def receive(self, timeout: float | None) -> bytes:
        try:
            answer = await asyncio.wait_for(self._call.read(), timeout)
        except asyncio.TimeoutError:
            raise _link.late() from None
        if not isinstance(answer, bytes):  # grpc.aio.EOF, which the type stubs do not have
            raise _link.stream_ended()
        return answer

    def cancel(self) -> None:
        self._call.cancel()


def _plain_with() -> TypeError:
    return TypeError("hullcast.aio is for asyncio: write `async with` in place of `with`")


class _Starting:
    """A server that is being started. It can be awaited, or entered with `async with`."""

    def __getattr__(self, name: str) -> NoReturn:
        if hasattr(Client, name):
            raise AttributeError(
                f"the server is being started, and {name!r} is an attribute of its client: write "
                "`client = await hullcast.aio.serve()`, or `async with`",
                name=name,
                obj=self,
            )
        raise AttributeError(f"no attribute {name!r}", name=name, obj=self)

    def __init__(self, start: Callable[[], _client.Client]) -> None:
        self._start = start
        self._client: Client | None = None

    async def _started(self) -> Client:
        blocking = await asyncio.to_thread(self._start)
        # The blocking client was not used, so it has no connection to close.
        return Client(blocking._settings, server=blocking._release_server())

    def __await__(self) -> Generator[Any, Any, Client]:
        return self._started().__await__()

    def __enter__(self) -> NoReturn:
        raise _plain_with()

    def __exit__(self, *error: object) -> None:
        """Defined so that a plain `with` reaches the message of `__enter__`."""

    async def __aenter__(self) -> Client:
        self._client = await self._started()
        return self._client

    async def __aexit__(self, *error: object) -> None:
        if self._client is not None:
            await self._client.close()


def _started(serve: Callable[P, _client.Client]) -> Callable[P, _Starting]:
    def start(*args: P.args, **kwargs: P.kwargs) -> _Starting:
        return _Starting(partial(serve, *args, **kwargs))

    start.__doc__ = serve.__doc__
    return start


connect = Client.connect
serve = _started(_serve.serve)

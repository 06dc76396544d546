"""The blocking client's calls, on a `grpc.Channel`."""

from __future__ import annotations

import queue
import threading
import time
import weakref
from collections.abc import Callable
from functools import partial
from typing import Any

from . import _calls, _channel, _link
from ._grpc import grpc


class Link:
    """The calls on a `grpc.Channel`."""

    def __init__(self, channel: grpc.Channel, metadata: Callable[[], _channel.Metadata]) -> None:
        self.channel = channel
        self._metadata = metadata
        self._unary: dict[str, Any] = {name: channel.unary_unary(name) for name in _calls.UNARY}
        self._stream: Any = channel.unary_stream(_calls.FIND)
        self.proven = False
        self.max_calls = 0
        self.trouble = ""

    def start(self, method: str, data: bytes, timeout: float | None) -> Any:
        return self._unary[method].future(data, timeout=timeout, metadata=self._metadata())

    def call(self, method: str, data: bytes, timeout: float | None) -> Any:
        # This takes half the time of a future, because the call waits on this thread.
        make = self._unary[method]
        return _Later(partial(make, data, timeout=timeout, metadata=self._metadata()))

    def stream(self, method: str, data: bytes, timeout: float | None) -> Any:
        assert method == _calls.FIND
        make = partial(self._stream, data, timeout=timeout, metadata=self._metadata())
        return _Later(lambda: list(make()))

    def open(self, method: str) -> _link.Stream:
        return _Stream(self.channel.stream_stream(method), self._metadata())

    def pause(self, seconds: float) -> Any:
        return _Later(partial(time.sleep, seconds))

    def run(self, function: Callable[[], Any]) -> Any:
        return _Later(function)

    def shut(self) -> None:
        self.channel.close()

    def abandon(self) -> None:
        pass  # only a forked child's channel is given up, and `_after_fork` handles that


class _Stream:
    """A stream on a `grpc.Channel`. The stream has no deadline; each response has its own."""

    def __init__(self, begin: Any, metadata: _channel.Metadata) -> None:
        self._requests: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._call: Any = begin(iter(self._requests.get, None), metadata=metadata)
        self._watch = _Watch(self._call.cancel)
        # gRPC's thread blocks on the request queue until it reads the final None.
        self.cancel = weakref.finalize(self, _end, self._call, self._requests, self._watch)

    def send(self, data: bytes, timeout: float | None) -> Any:
        self._requests.put(data)
        return _Later(_nothing)

    def receive(self, timeout: float | None) -> Any:
        return _Later(partial(self._receive, timeout))

    def _receive(self, timeout: float | None) -> bytes:
        self._watch.set(timeout)
        try:
            answer = next(self._call, None)
        except grpc.RpcError:
            if self._watch.expired:
                raise _link.late() from None
            raise
        finally:
            self._watch.set(None)
        if self._watch.expired:  # it expired just now and has cancelled the stream
            raise _link.late()
        if answer is None:
            raise _link.stream_ended()
        return answer


def _nothing() -> None:
    """Returns without waiting, because gRPC's own thread sends the message."""


def _end(call: Any, requests: queue.SimpleQueue[bytes | None], watch: _Watch) -> None:
    watch.stop()
    call.cancel()
    requests.put(None)


class _Watch:
    """Calls a function when a deadline has passed; the deadline is set again for each step.

    There is one thread per stream, which sleeps through most steps. One timer per step would cost
    as much as the step itself.
    """

    def __init__(self, late: Callable[[], Any]) -> None:
        self.expired = False
        self._late = late
        self._deadline: float | None = None
        self._wakes_at: float | None = 0.0
        self._changed = threading.Event()
        self._stopped = False
        self._thread: threading.Thread | None = None

    def set(self, seconds: float | None) -> None:
        """Sets the deadline to `seconds` from now; None clears it."""
        self._deadline = deadline = None if seconds is None else time.monotonic() + seconds
        if deadline is None:
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, daemon=True, name="hullcast-watch")
            self._thread.start()
        if self._wakes_at is None or deadline < self._wakes_at:
            self._changed.set()

    def stop(self) -> None:
        """Ends the thread."""
        self._stopped = True
        self._changed.set()

    def _run(self) -> None:
        while not self._stopped:
            deadline = self._wakes_at = self._deadline
            seconds = None if deadline is None else deadline - time.monotonic()
            if seconds is not None and seconds <= 0:
                self.expired = True
                self._late()
                return
            self._changed.wait(seconds)
            self._changed.clear()


class _Later:
    """A call that begins only when the client waits for its result."""

    __slots__ = ("result",)

    def __init__(self, result: Callable[[], Any]) -> None:
        self.result = result

    def cancel(self) -> None:
        """Does nothing: the call was not begun."""

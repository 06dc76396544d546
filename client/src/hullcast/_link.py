"""The interface of an open channel, and the time that is left to an operation.

`_blocking.py` implements the interface for the blocking client, and `aio.py` for asyncio.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import Any, Protocol, TypeVar

from . import _errors

T = TypeVar("T")

#: A generator that yields what to wait for (from `Link.start`, `.call` or `.stream`) and returns
#: the operation's result.
Steps = Generator[Any, Any, T]


class Stream(Protocol):
    """An open stream: messages are sent, and answered in the order of sending."""

    def send(self, data: bytes, timeout: float | None) -> Any:
        """Returns what to wait for until the message is under way.

        It fails only if that takes longer than the timeout. `receive` reports any other error.
        """

    def receive(self, timeout: float | None) -> Any:
        """Returns what to wait for until the oldest unanswered message is answered."""

    def cancel(self) -> None:
        """Ends the stream."""


class Link(Protocol):
    """An open channel. Each method that makes a call returns what the client has to wait for."""

    #: Whether a server has answered on this channel.
    proven: bool
    #: The most concurrent calls that the server permits on one connection; 0 if it is not known.
    max_calls: int
    #: Why the first call on this channel failed; "" if it has not, or if a server has answered.
    trouble: str

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


def stream_ended() -> _errors.Unavailable:
    """The error for a stream that ended without an error before every message was answered."""
    error = _errors.Unavailable(
        "the server ended the stream before it had answered every message",
        reason="STREAM_ENDED",
    )
    error.cut_off = True
    return error


#: The text of the exception if a server did not answer in time.
NO_ANSWER = (
    "the server did not answer within the timeout: it may be frozen, overloaded or out of reach, "
    "or the work may take longer; client.ping() tests whether it answers, and timeout= gives a "
    "call more time"
)


def late() -> _errors.DeadlineExceeded:
    """The error for a call that exceeded its timeout."""
    return _errors.DeadlineExceeded(NO_ANSWER, reason="DEADLINE_EXCEEDED")


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

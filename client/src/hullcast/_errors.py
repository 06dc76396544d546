"""The exceptions and warnings of this package."""

from __future__ import annotations

import os
import sys
import warnings
from typing import Any, cast


def warn(warning: Warning) -> None:
    """Issues a warning, attributed to the line of the caller that called this package."""
    folder = os.path.dirname(__file__) + os.sep
    level, frame = 1, sys._getframe()
    while frame is not None and frame.f_code.co_filename.startswith(folder):
        level, frame = level + 1, frame.f_back
    warnings.warn(warning, stacklevel=level)


class _Pickled:
    """An exception that keeps all its attributes when it is pickled or copied.

    By default Python calls the class with only `args`, which fails for a class that takes other
    arguments.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        args: tuple[Any, ...] = self.args  # type: ignore[attr-defined]
        return _unpickled, (type(self), args, self.__dict__.copy())


def _unpickled(kind: type[BaseException], args: tuple[Any, ...], state: dict[str, Any]) -> Any:
    # Make the object with the innermost built-in class, whose memory layout it has. A class may
    # have several built-in bases.
    base: type = kind
    while base.__module__ != "builtins":
        base = base.__base__ or object
    error = cast("Any", base).__new__(kind)
    error.args = args
    error.__dict__.update(state)
    return error


class Error(_Pickled, Exception):
    """The base class of every exception of this package.

    Attributes:
        reason: a stable identifier in upper case, such as "INDEX_OUT_OF_RANGE"; "" if none is
            known.
        field: the argument at fault, such as "pairs"; "" if no argument is at fault.
        index: the entry of the field at fault, as an index into the flattened array; or None.
        retry_after: the seconds after which the server asks to retry, or None.
        message: the text without reason and field.
    """

    #: The entry of an array at fault, with one index per axis; empty if there is none.
    entry: tuple[int, ...] = ()

    def __init__(
        self,
        message: str,
        *,
        reason: str = "",
        field: str = "",
        index: int | None = None,
        retry_after: float | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.reason = reason
        self.field = field
        self.index = index
        self.retry_after = retry_after

    @property
    def place(self) -> str:
        """The field and the index as one text, such as "pairs[1, 0]"."""
        if self.entry:
            return f"{self.field}[{', '.join(map(str, self.entry))}]"
        return self.field + ("" if self.index is None else f"[{self.index}]")

    def __str__(self) -> str:
        return ": ".join(part for part in (self.reason, self.place, self.message) if part)


class InvalidArgument(Error, ValueError):
    """An argument or the request is not valid. The client or the server found the fault."""


class PairOutOfRange(InvalidArgument, IndexError):
    """An index of a `Manifolds` is not that of a pair."""


class InvalidPoses(InvalidArgument):
    """Some bodies have an unusable position or rotation, so that their pairs are INVALID.

    Attributes:
        bodies: the indices of these bodies, ascending.
        reasons: the reason for each of these bodies, as text.
        manifolds: the whole result. The pairs of all other bodies are answered as usual.
    """

    def __init__(
        self, message: str, bodies: Any, reasons: tuple[str, ...], manifolds: Any, **known: Any
    ) -> None:
        super().__init__(message, **known)
        self.bodies = bodies
        self.reasons = reasons
        self.manifolds = manifolds

    @property
    def place(self) -> str:
        """Empty, because the message names the bodies."""
        return ""


class HullRejected(InvalidArgument):
    """The server refused at least one hull of a `register` call. The other hulls are registered.

    Attributes:
        index: the index in the call of the first refused hull.
        point: the index of the point at fault in that hull, or None.
        results: for each hull of the call, its `Hull`, or a `HullRejected` of its own.
    """

    def __init__(self, message: str, *, point: int | None = None, **known: Any) -> None:
        super().__init__(message, **known)
        self.point = point
        self.results: list[Any] = []

    @property
    def place(self) -> str:
        """The place of the fault: "hulls[2].vertices[7]" is point 7 of the third hull."""
        return f"hulls[{self.index}].{self.field}" + (
            "" if self.point is None else f"[{self.point}]"
        )


class OutputNotAsked(Error, AttributeError):
    """A column was read that the query did not request.

    Attributes:
        output: the output that has the column; add it to the query's `outputs`.
    """

    def __init__(self, column: str, output: str) -> None:
        super().__init__(
            f"add {output!r} to the query's outputs",
            reason="OUTPUT_NOT_ASKED",
            field=column,
        )
        self.output = output


class ServerError(Error):
    """The call failed.

    Attributes:
        code: the name of the gRPC status code.
    """

    code = "UNKNOWN"


class Unavailable(ServerError, ConnectionError):
    """There is no server, or it is too busy.

    Retry, after `retry_after` seconds if that is given.
    """

    #: Whether the connection broke while the response was arriving. gRPC does not retry such calls.
    cut_off = False
    #: gRPC's own text, if the failure is one of the connection.
    transport = ""


class DeadlineExceeded(ServerError, TimeoutError):
    """The server did not answer within the timeout."""


class ResourceExhausted(ServerError):
    """The server's store is full, or a message is too large."""


class Unimplemented(ServerError, NotImplementedError):
    """The server's version does not support the call."""


class Unauthenticated(ServerError, PermissionError):
    """The token is missing or wrong, or does not permit the call."""


class ServerNotFound(Error, FileNotFoundError):
    """`serve` did not find a hullcast binary."""


class ServerDidNotStart(Error, RuntimeError):
    """The server that `serve` started exited, or did not listen in time.

    The message contains the end of the server's log.
    """


class FileNotFound(InvalidArgument, FileNotFoundError):
    """A file does not exist: a mesh, a robot description, or a file that one of these names."""


class NoBodiesWarning(UserWarning):
    """A robot has no collision geometry, so that it has no bodies."""


class JointLimitsWarning(UserWarning):
    """Values of joints are beyond the joints' limits. The text names a joint and its limits."""


class NotCachedWarning(UserWarning):
    """The convex pieces of a mesh cannot be kept in a file, and will be computed again."""


class InvalidPosesWarning(UserWarning):
    """Some poses are unusable, so that their pairs are INVALID. The text has the counts."""


class MissingHullsWarning(UserWarning):
    """The server lacks some hulls, so that their pairs are INVALID. The text has the counts."""


class NotConvexWarning(_Pickled, UserWarning):
    """A mesh that is not convex was registered as its convex hull, which is a different shape.

    Attributes:
        field: the mesh, such as "hulls[2]".
        ratio: the fraction of its convex hull that the mesh fills, at most 1. It is an estimate,
            good to about 1 %, if parts of the mesh overlap or edges are open.
        open_edges: the number of edges that do not join two faces; 0 for a watertight mesh.
    """

    def __init__(self, message: str, field: str, ratio: float, open_edges: int) -> None:
        super().__init__(message)
        self.field = field
        self.ratio = ratio
        self.open_edges = open_edges

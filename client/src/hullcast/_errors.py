"""Exceptions."""

from __future__ import annotations

from typing import Any


class Error(Exception):
    """What every exception of this package is.

    Attributes:
        reason: stable and upper case, such as "INDEX_OUT_OF_RANGE"; "" where none is known.
        field: the argument at fault, such as "pairs"; "" where none is.
        index: the entry of the field at fault, or None.
        retry_after: seconds after which the server says to try again, or None.
    """

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
        """Field and index as one text, such as "pairs[7]"."""
        return self.field + ("" if self.index is None else f"[{self.index}]")

    def __str__(self) -> str:
        return ": ".join(part for part in (self.reason, self.place, self.message) if part)


class InvalidArgument(Error, ValueError):
    """The request is malformed; found here or by the server."""


class HullRejected(InvalidArgument):
    """At least one hull of a `register` call was refused.

    `index` is the first such hull's place in the call, `point` the point of it
    at fault where one is. The others are registered: `results` has, per hull of
    the call, its `Hull` or its own `HullRejected`.
    """

    def __init__(self, message: str, *, point: int | None = None, **known: Any) -> None:
        super().__init__(message, **known)
        self.point = point
        self.results: list[Any] = []

    @property
    def place(self) -> str:
        """Such as "hulls[2].vertices[7]": the third hull's point 7."""
        return f"hulls[{self.index}].{self.field}" + (
            "" if self.point is None else f"[{self.point}]"
        )


class OutputNotAsked(Error, AttributeError):
    """A column was read that the query did not ask for; `output` names what to ask."""

    def __init__(self, column: str, output: str) -> None:
        super().__init__(
            f"add {output!r} to the query's outputs",
            reason="OUTPUT_NOT_ASKED",
            field=column,
        )
        self.output = output


class ServerError(Error):
    """The call failed; `code` is the gRPC status code's name."""

    code = "UNKNOWN"


class Unavailable(ServerError, ConnectionError):
    """No server, or one too busy: try again, after `retry_after` where given."""

    #: The connection broke while the answer was arriving, which gRPC does not retry.
    cut_off = False


class DeadlineExceeded(ServerError, TimeoutError):
    """No answer within the timeout."""


class ResourceExhausted(ServerError):
    """The server's store is full, or a message too large."""


class Unimplemented(ServerError, NotImplementedError):
    """This server's version does not have it."""


class Unauthenticated(ServerError, PermissionError):
    """The token is missing, wrong, or not allowed this."""


class ServerNotFound(Error, FileNotFoundError):
    """`serve` found no hullcast binary."""


class ServerDidNotStart(Error, RuntimeError):
    """The server that `serve` started ended or was silent; the message has its log's end."""


class FileNotFound(InvalidArgument, FileNotFoundError):
    """A file that was named does not exist: a mesh, a robot, or one that those name."""


class NotConvexWarning(UserWarning):
    """A mesh was registered as its convex hull, which is another shape.

    Attributes:
        field: which mesh, such as "hulls[2]".
        ratio: the share of its hull that the mesh fills, at most 1; an estimate to about
            1 % where parts of the mesh overlap or edges are open.
        open_edges: edges that do not join two faces; 0 for a watertight mesh.
    """

    def __init__(self, message: str, field: str, ratio: float, open_edges: int) -> None:
        super().__init__(message)
        self.field = field
        self.ratio = ratio
        self.open_edges = open_edges

"""Exceptions, and how a failed call becomes one.

The server puts an `ErrorInfo` (reason; field and index in its metadata) and,
where trying again helps, a `RetryInfo` into the `grpc-status-details-bin`
trailer. Their few fields are
read with descriptors of this module's own, in a pool of their own, so that no
further package is needed and none is disturbed.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import grpc
from google.protobuf import any_pb2, descriptor_pb2, descriptor_pool, duration_pb2, message_factory

_DETAILS_KEY = "grpc-status-details-bin"


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


class NotConvexWarning(UserWarning):
    """A mesh was registered as its convex hull, which is another shape.

    Attributes:
        field: which mesh, such as "hulls[2]".
        ratio: the mesh's volume over the hull's; of little meaning with open edges.
        open_edges: edges that do not join two faces; 0 for a watertight mesh.
    """

    def __init__(self, message: str, field: str, ratio: float, open_edges: int) -> None:
        super().__init__(message)
        self.field = field
        self.ratio = ratio
        self.open_edges = open_edges


_BY_CODE: dict[grpc.StatusCode, type[Error]] = {
    grpc.StatusCode.INVALID_ARGUMENT: InvalidArgument,
    grpc.StatusCode.OUT_OF_RANGE: InvalidArgument,
    grpc.StatusCode.UNAVAILABLE: Unavailable,
    grpc.StatusCode.DEADLINE_EXCEEDED: DeadlineExceeded,
    grpc.StatusCode.RESOURCE_EXHAUSTED: ResourceExhausted,
    grpc.StatusCode.UNIMPLEMENTED: Unimplemented,
    grpc.StatusCode.UNAUTHENTICATED: Unauthenticated,
    grpc.StatusCode.PERMISSION_DENIED: Unauthenticated,
}


def from_rpc(call: Any) -> Error:
    """The exception for a failed call (a `grpc.RpcError` that is also a `grpc.Call`)."""
    code = call.code()
    known: dict[str, Any] = {}
    message = call.details() or ""
    for key, value in call.trailing_metadata() or ():
        if key == _DETAILS_KEY:
            known = _read_details(value)
    # What the transport itself refuses (no connection, say) has no reason of its own.
    known.setdefault("reason", code.name)
    error = _BY_CODE.get(code, ServerError)("", **known)
    # Whoever shows only the message reads the reason and the place in it.
    for part in (error.reason, error.place):
        message = message.removeprefix(f"{part}: ")
    error.message = message
    if isinstance(error, ServerError):
        error.code = code.name
    if isinstance(error, Unavailable):
        error.cut_off = bool(call.initial_metadata())
    return error


def _read_details(data: bytes) -> dict[str, Any]:
    """Reason, field, index and retry_after of a serialised google.rpc.Status."""
    known: dict[str, Any] = {}
    try:
        for detail in _Status.FromString(data).details:
            kind = detail.type_url.rpartition("/")[2]
            if kind == "google.rpc.ErrorInfo":
                info = _ErrorInfo.FromString(detail.value)
                known["reason"] = info.reason
                place = {entry.key: entry.value for entry in info.metadata}
                known["field"] = place.get("field", "")
                known["index"] = int(place["index"]) if "index" in place else None
            elif kind == "google.rpc.RetryInfo":
                delay = _RetryInfo.FromString(detail.value).retry_delay
                known["retry_after"] = delay.seconds + delay.nanos * 1e-9
    except ValueError:  # also protobuf's DecodeError: the code and message still stand
        pass
    return known


def _messages() -> dict[str, Any]:
    """The few messages of google.rpc that are read, with only the fields that are."""
    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(
        name="hullcast/client/status.proto",
        package="google.rpc",
        syntax="proto3",
        dependency=["google/protobuf/any.proto", "google/protobuf/duration.proto"],
    )

    def message(name: str, fields: Iterable[tuple[str, int, bool, str]]) -> None:
        entry = file.message_type.add(name=name)
        for label, number, repeated, kind in fields:
            entry.field.add(
                name=label,
                number=number,
                label=kinds.LABEL_REPEATED if repeated else kinds.LABEL_OPTIONAL,
                type=kinds.TYPE_MESSAGE if kind else kinds.TYPE_STRING,
                type_name=kind or None,
            )

    message("Status", [("details", 3, True, ".google.protobuf.Any")])
    # On the wire a map is a list of such entries.
    message("Entry", [("key", 1, False, ""), ("value", 2, False, "")])
    message("ErrorInfo", [("reason", 1, False, ""), ("metadata", 3, True, ".google.rpc.Entry")])
    message("RetryInfo", [("retry_delay", 1, False, ".google.protobuf.Duration")])
    pool = descriptor_pool.DescriptorPool()
    for dependency in (any_pb2, duration_pb2):
        pool.AddSerializedFile(dependency.DESCRIPTOR.serialized_pb)
    pool.AddSerializedFile(file.SerializeToString())
    return {
        entry.name: message_factory.GetMessageClass(
            pool.FindMessageTypeByName(f"google.rpc.{entry.name}")
        )
        for entry in file.message_type
    }


_known = _messages()
_Status, _ErrorInfo, _RetryInfo = _known["Status"], _known["ErrorInfo"], _known["RetryInfo"]

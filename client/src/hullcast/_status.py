"""Converts a failed call to an exception.

The server puts an `ErrorInfo` (a reason, with field and index in its metadata) into the trailer
`grpc-status-details-bin`, and a `RetryInfo` if a retry can help. The few fields of these messages
are read with descriptors defined here, in a descriptor pool of their own. So no further package is
needed, and no other package's descriptors are affected.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from google.protobuf import any_pb2, descriptor_pb2, descriptor_pool, duration_pb2, message_factory

from ._errors import (
    DeadlineExceeded,
    Error,
    InvalidArgument,
    ResourceExhausted,
    ServerError,
    Unauthenticated,
    Unavailable,
    Unimplemented,
)
from ._grpc import grpc
from ._link import NO_ANSWER

_DETAILS_KEY = "grpc-status-details-bin"
_CLOSED = (
    "the connection was {how} before the answer had arrived: the server may have ended, or what "
    "listens at the address is not a hullcast server; a proxy that has no server does this too"
)
#: Parts of gRPC's own texts, and what the exception says instead. The first part that is found
#: decides.
_TEXTS = {
    "before receiving SETTINGS frame": (
        "the server accepts connections and does not answer: is it a hullcast server? It may be "
        "frozen, or a proxy that has lost its server"
    ),
    "ping timeout": "the server stopped answering, and the connection was given up",
    "http2 header with status: 431": (
        "the server refused the call's headers as too long: use a shorter token"
    ),
    "Received http2 header with status": (
        "the peer gave an HTTP error ({status}) instead of an answer: it is a proxy that does not "
        "reach a hullcast server, or it is another server"
    ),
    "Connection refused": (
        "nothing listens at the server's address (connection refused): start the server, or "
        "correct the address"
    ),
    "DNS resolution failed": "the server's host name has no address: correct the name",
    "No route to host": "the server's host cannot be reached over the network (no route to host)",
    "Network is unreachable": "the server's network cannot be reached",
    "reset by peer": _CLOSED.format(how="reset"),
    "Broken pipe": _CLOSED.format(how="reset"),
    "Socket closed": _CLOSED.format(how="closed"),
    "Handshake read failed": _CLOSED.format(how="closed"),
    "Stream removed": _CLOSED.format(how="closed"),
}
#: The text of the exception for a call that the server cut (docs/errors.md).
_CUT = (
    "the server reset the call, because the answer was not read in time; the server's "
    "settings answer_seconds and max_deadline_seconds decide how long that is"
)

#: What to do about an error of the server, by its reason.
_REMEDIES = {
    "MISSING_TOKEN": "give token= to hullcast.connect",
    "UNKNOWN_TOKEN": "give hullcast.connect a token= that is on the server's lists",
}

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
    """The exception for a failed call, a `grpc.RpcError` that is also a `grpc.Call`."""
    code = call.code()
    known: dict[str, Any] = {}
    message = call.details() or ""
    for key, value in call.trailing_metadata() or ():
        if key == _DETAILS_KEY:
            known = _read_details(value)
    # An error of the transport itself, such as a failed connection, has no reason of its own.
    known.setdefault("reason", code.name)
    error = _BY_CODE.get(code, ServerError)("", **known)
    # The server's text repeats the reason and the place, for programs that show only the text.
    # Remove them, since the exception has them as attributes.
    for part in (error.reason, error.place):
        message = message.removeprefix(f"{part}: ")
    error.message = message if known["reason"] != code.name else _text(code, message)
    if code is grpc.StatusCode.CANCELLED and "RST_STREAM" in message:
        error.message = _CUT
    if error.reason in _REMEDIES:
        error.message = f"{error.message}: {_REMEDIES[error.reason]}"
    if isinstance(error, ServerError):
        error.code = code.name
    if isinstance(error, Unavailable):
        error.cut_off = bool(call.initial_metadata())
        error.transport = message
    return error


def _text(code: grpc.StatusCode, message: str) -> str:
    """The text of the exception in place of a text of gRPC itself."""
    if code is grpc.StatusCode.DEADLINE_EXCEEDED:
        return NO_ANSWER
    status = message.rpartition("http2 header with status: ")[2][:3]
    found = next((text for part, text in _TEXTS.items() if part in message), message)
    return found.replace("{status}", status)


def _read_details(data: bytes) -> dict[str, Any]:
    """Reads reason, field, index and retry_after from a serialised google.rpc.Status."""
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
    except ValueError:  # includes protobuf's DecodeError; code and message are still usable
        pass
    return known


def _messages() -> dict[str, Any]:
    """The message classes of google.rpc that are read, with only the fields that are used."""
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
    # On the wire, a map is a list of such entries.
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

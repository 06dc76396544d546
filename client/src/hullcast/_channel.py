"""How a channel is set up: target, credentials, options, retries, balancing."""

from __future__ import annotations

import dataclasses
import importlib
import ipaddress
import json
import os
import socket
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import grpc

from ._errors import InvalidArgument

Target = str | Sequence[str]
Metadata = tuple[tuple[str, str], ...]
Tls = bool | bytes | str | os.PathLike[str] | grpc.ChannelCredentials | None

#: Attempts and waits (seconds, each give or take a fifth) of a call that finds
#: its server UNAVAILABLE: about 12 s in all, longer than a balancer takes to
#: see that a server is gone and than a server takes to start again. Every call
#: is idempotent. A server that is too busy says itself when to come back
#: (`grpc-retry-pushback-ms`), which gRPC obeys. gRPC allows no more than 5.
_SERVICE_CONFIG: dict[str, Any] = {
    "loadBalancingConfig": [{"round_robin": {}}],
    "methodConfig": [
        {
            "name": [{}],
            "retryPolicy": {
                "maxAttempts": 5,
                "initialBackoff": "0.2s",
                "backoffMultiplier": 4,
                "maxBackoff": "8s",
                "retryableStatusCodes": ["UNAVAILABLE"],
            },
        }
    ],
    # Where more than half of many attempts fail, retrying only adds to the load.
    "retryThrottling": {"maxTokens": 200, "tokenRatio": 0.5},
}

_OPTIONS: dict[str, Any] = {
    # The server's limits are the ones that count.
    "grpc.max_send_message_length": -1,
    "grpc.max_receive_message_length": -1,
    # Columns are megabytes: fewer frames, and windows that take a whole message.
    "grpc.http2.max_frame_size": 1 << 20,
    "grpc.http2.lookahead_bytes": 8 << 20,
    "grpc.service_config": json.dumps(_SERVICE_CONFIG),
    # A request larger than this is not retried: the server's message limit.
    "grpc.per_rpc_retry_buffer_size": 64 << 20,
    # A server that is back is found within the retries.
    "grpc.initial_reconnect_backoff_ms": 100,
    "grpc.min_reconnect_backoff_ms": 1000,
    "grpc.max_reconnect_backoff_ms": 2000,
    "grpc.dns_min_time_between_resolutions_ms": 5000,
    # A peer that vanished without a word is noticed during a call, early enough for another
    # to answer within the usual timeout; no pings between calls.
    "grpc.keepalive_time_ms": 15_000,
    "grpc.keepalive_timeout_ms": 15_000,
    "grpc.keepalive_permit_without_calls": 0,
    # A forked child must not write into its parent's connections.
    "grpc.use_local_subchannel_pool": 1,
}


@dataclass(frozen=True)
class Settings:
    """What a client is made of, and all that is kept of it when it is pickled."""

    target: Target
    tls: Tls = None
    token: str | None = dataclasses.field(default=None, repr=False)
    timeout: float | None = 60
    options: tuple[tuple[str, Any], ...] = ()

    def open(self, module: Any) -> Any:
        """A channel of `grpc` or `grpc.aio`. Nothing is connected yet."""
        target = address(self.target)
        options = channel_options(self.target, self.options)
        if self.tls is None or self.tls is False:
            return module.insecure_channel(target, options=options)
        return module.secure_channel(target, _credentials(self.tls), options=options)

    def metadata(self) -> Metadata:
        """Sent with a call that begins here and now."""
        token = () if self.token is None else (("authorization", f"Bearer {self.token}"),)
        return token + _trace_context()


def _trace_context() -> Metadata:
    """The trace that the caller is in (`traceparent`), by OpenTelemetry where it is in use."""
    if "opentelemetry.trace" not in sys.modules:
        return ()
    headers: dict[str, str] = {}
    importlib.import_module("opentelemetry.propagate").inject(headers)
    return tuple((name.lower(), value) for name, value in headers.items())


def channel_options(target: Target, own: Iterable[tuple[str, Any]]) -> list[tuple[str, Any]]:
    """This package's options, each replaced where the caller names it too."""
    merged = dict(_OPTIONS)
    # Else the authority is the socket's path or the whole list, which HTTP/2 servers refuse.
    if not isinstance(target, str):
        merged["grpc.default_authority"] = target[0]
    elif target.startswith("unix:"):
        merged["grpc.default_authority"] = "localhost"
    merged.update(own)
    return list(merged.items())


def address(target: Target) -> str:
    """The gRPC target of one address, or of a list that calls are spread over."""
    if isinstance(target, str):
        return target
    if not target:
        raise InvalidArgument("no address", reason="NO_ADDRESS", field="target")
    if len(target) == 1:
        return target[0]
    found = [_resolved(i, entry) for i, entry in enumerate(target)]
    families = {family for family, _ in found}
    if len(families) > 1:
        raise InvalidArgument(
            "IPv4 and IPv6 addresses in one list", reason="MIXED_ADDRESSES", field="target"
        )
    return f"{families.pop()}:" + ",".join(text for _, text in found)


def _resolved(place: int, entry: str) -> tuple[str, str]:
    """Family and "address:port"; gRPC takes lists of numeric addresses only."""
    host, colon, port = entry.rpartition(":")
    if not colon or not port.isdecimal() or "/" in host:
        raise InvalidArgument(
            f"{entry!r} is not host:port", reason="NOT_AN_ADDRESS", field="target", index=place
        )
    bare = host.removeprefix("[").removesuffix("]")
    try:
        number = ipaddress.ip_address(bare)
    except ValueError:
        try:
            number = ipaddress.ip_address(socket.gethostbyname(bare))
        except OSError as error:
            raise InvalidArgument(
                f"{bare}: {error}", reason="NAME_NOT_FOUND", field="target", index=place
            ) from None
    return ("ipv4", f"{number}:{port}") if number.version == 4 else ("ipv6", f"[{number}]:{port}")


def _credentials(tls: Any) -> grpc.ChannelCredentials:
    if isinstance(tls, grpc.ChannelCredentials):
        return tls
    if tls is True:
        return grpc.ssl_channel_credentials()
    if isinstance(tls, bytes):
        return grpc.ssl_channel_credentials(root_certificates=tls)
    with open(tls, "rb") as file:
        return grpc.ssl_channel_credentials(root_certificates=file.read())

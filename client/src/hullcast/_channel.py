"""Setup of a channel: target, credentials, options, retries and load balancing."""

from __future__ import annotations

import dataclasses
import importlib
import ipaddress
import json
import os
import socket
import ssl
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from . import _arguments, _files, _subset
from ._arguments import iterable, kind, shown
from ._errors import InvalidArgument
from ._grpc import grpc

Target = str | Sequence[str]
Metadata = tuple[tuple[str, str], ...]
#: The port of an address without a port.
DEFAULT_PORT = 50051
_FORMS = "host, host:port, unix:PATH, dns:///host:port, http://host:port or https://host:port"
#: A server accepts 16 KiB of headers in all (`src/service/connection.rs`).
_LONGEST_TOKEN = 15_000
Tls = bool | bytes | str | os.PathLike[str] | grpc.ChannelCredentials | None


# A call that fails with UNAVAILABLE is retried for about 12 s in all. That is longer than a
# balancer needs to notice that a server is gone, and longer than a server needs to restart. A retry
# is safe because every call is idempotent. A server that is too busy states itself when to retry
# (`grpc-retry-pushback-ms`), and gRPC obeys. gRPC allows at most 5 attempts.
def service_config(attempts: int) -> dict[str, Any]:
    """The gRPC service config: load balancing over several servers, and retries."""
    retries = {
        "maxAttempts": attempts,
        "initialBackoff": "0.2s",
        "backoffMultiplier": 4,
        "maxBackoff": "8s",
        "retryableStatusCodes": ["UNAVAILABLE"],
    }
    return {
        "loadBalancingConfig": [{"round_robin": {}}],
        "methodConfig": [
            {"name": [{}], "retryPolicy": retries},
            # These calls test whether a server answers at all, so they are not retried.
            {"name": [{"service": "hullcast.v1.ServerService"}]},
        ],
        # If more than half of many attempts fail, retries only add to the load.
        "retryThrottling": {"maxTokens": 200, "tokenRatio": 0.5},
    }


_OPTIONS: dict[str, Any] = {
    # The server enforces the message limits.
    "grpc.max_send_message_length": -1,
    "grpc.max_receive_message_length": -1,
    # Columns are megabytes long: use few, large frames, and windows that hold a whole message.
    "grpc.http2.max_frame_size": 1 << 20,
    "grpc.http2.lookahead_bytes": 8 << 20,
    "grpc.service_config": json.dumps(service_config(attempts=5)),
    # gRPC does not retry a request larger than this. It is the server's message limit.
    "grpc.per_rpc_retry_buffer_size": 64 << 20,
    # Reconnect quickly, so that a restarted server is found while calls are still retried.
    "grpc.initial_reconnect_backoff_ms": 100,
    "grpc.min_reconnect_backoff_ms": 1000,
    "grpc.max_reconnect_backoff_ms": 2000,
    "grpc.dns_min_time_between_resolutions_ms": 5000,
    # A server that hangs, or that vanished without closing the connection, is detected after about
    # 20 s of a call. That is early enough for another server to answer within the usual timeout. No
    # pings are sent between calls. gRPC waits for the response to a ping by the third option, and
    # for any data by the second.
    "grpc.keepalive_time_ms": 10_000,
    "grpc.keepalive_timeout_ms": 10_000,
    "grpc.http2.ping_timeout_ms": 10_000,
    "grpc.keepalive_permit_without_calls": 0,
    # Send pings even while a call waits for its response and sends no data.
    "grpc.http2.max_pings_without_data": 0,
    # Connections are not shared between channels, because a forked child must not write into its
    # parent's connections.
    "grpc.use_local_subchannel_pool": 1,
}


@dataclass(frozen=True)
class Settings:
    """All settings of a client. A pickled client keeps nothing else."""

    target: Target
    tls: Tls = None
    token: str | None = dataclasses.field(default=None, repr=False)
    timeout: float | None = 60
    options: tuple[tuple[str, Any], ...] = ()
    #: How many servers of a list the client uses; None for the default.
    subset: int | None = None
    #: The client's identity, which chooses the subset; None for a random one per client.
    identity: str | None = None

    @classmethod
    def of(
        cls,
        target: Any,
        tls: Any,
        token: Any,
        timeout: Any,
        options: Any,
        subset: Any = None,
        identity: Any = None,
    ) -> Settings:
        """Makes the settings from the arguments of `connect`, and checks each argument.

        Raises:
            InvalidArgument: an argument is not usable; the error names it.
        """
        if isinstance(target, os.PathLike):
            target = f"unix:{os.fspath(target)}"  # pyright: ignore[reportUnknownArgumentType]
        several = not isinstance(target, str)
        if several and (isinstance(target, (bytes, Mapping)) or not iterable(target)):
            raise InvalidArgument(
                f"expected an address or a list of addresses, got {kind(target)}",
                reason="WRONG_TYPE",
                field="target",
            )
        entries: list[Any] = list(target) if several else [target]  # pyright: ignore[reportUnknownArgumentType]
        if not entries:
            raise InvalidArgument(
                "the list is empty: expected one or more addresses",
                reason="NO_ADDRESS",
                field="target",
            )
        read = [_entry(entry, i if several else None) for i, entry in enumerate(entries)]
        for i, (_, text) in enumerate(read):
            if len(read) > 1 and text.startswith(("unix:", "dns:", "ipv4:", "ipv6:")):
                raise InvalidArgument(
                    f"got {shown(entries[i])}, expected host:port in a list of addresses",
                    reason="NOT_AN_ADDRESS",
                    field="target",
                    index=i,
                )
        schemes = {scheme for scheme, _ in read} - {""}
        if len(schemes) > 1 or (schemes and len({scheme for scheme, _ in read}) > 1):
            raise InvalidArgument(
                "expected the same prefix (http://, https:// or none) in all addresses",
                reason="MIXED_ADDRESSES",
                field="target",
            )
        tls = _tls(tls, schemes)
        addresses = tuple(address for _, address in read)
        return cls(
            addresses if several else addresses[0],
            tls,
            _token(token),
            _arguments.seconds("timeout", timeout),
            _options(options),
            _subset.checked_size(subset, several=several),
            _subset.checked_identity(identity),
        )

    def groups(self, identity: str) -> list[Target]:
        """The targets that a client uses, one after the other: first its subset of the servers."""
        if isinstance(self.target, str):
            return [self.target]
        return list(_subset.groups(identity, self.target, self.subset))

    def open(self, module: Any, group: Target | None = None) -> Any:
        """Opens a channel of `grpc` or `grpc.aio` to one of the groups. It does not connect yet."""
        target = address(self.target if group is None else group)
        options = channel_options(self.target, self.options)
        if self.tls is None or self.tls is False:
            return module.insecure_channel(target, options=options)
        return module.secure_channel(target, _credentials(self.tls), options=options)

    @property
    def addresses(self) -> tuple[str, ...]:
        """The addresses as `host:port`, for opening a socket; none for a Unix socket."""
        targets = (self.target,) if isinstance(self.target, str) else tuple(self.target)
        return tuple(t.rpartition("/")[2] for t in targets if not t.startswith("unix:"))

    def trust(self) -> ssl.SSLContext | None:
        """An SSL context that trusts the same certificates as the client; None without TLS.

        The root certificates inside gRPC credentials cannot be read. For such credentials the
        context trusts no certificate.
        """
        if self.tls is None or self.tls is False:
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.set_alpn_protocols(["h2"])
        if self.tls is True:
            context.load_default_certs()
        elif not isinstance(self.tls, grpc.ChannelCredentials):
            context.load_verify_locations(cadata=_roots(self.tls).decode("ascii", "ignore"))
        return context

    def metadata(self) -> Metadata:
        """The metadata of a call that begins now: the token and the caller's trace context."""
        token = () if self.token is None else (("authorization", f"Bearer {self.token}"),)
        return token + _trace_context()


def _trace_context() -> Metadata:
    """The headers (`traceparent`) of the caller's trace, if OpenTelemetry is loaded."""
    if "opentelemetry.trace" not in sys.modules:
        return ()
    headers: dict[str, str] = {}
    importlib.import_module("opentelemetry.propagate").inject(headers)
    return tuple((name.lower(), value) for name, value in headers.items())


def channel_options(target: Target, own: Iterable[tuple[str, Any]]) -> list[tuple[str, Any]]:
    """This package's channel options; an option of the same name in `own` replaces one."""
    merged = dict(_OPTIONS)
    # Without this option the authority is the socket's path or the whole list, and HTTP/2 servers
    # refuse both.
    if not isinstance(target, str):
        merged["grpc.default_authority"] = target[0]
    elif target.startswith("unix:"):
        merged["grpc.default_authority"] = "localhost"
    merged.update(own)
    return list(merged.items())


def _entry(entry: Any, place: int | None) -> tuple[str, str]:
    """Splits an address into its scheme ("http", "https" or "") and gRPC's form, with a port."""
    if not isinstance(entry, str):
        raise InvalidArgument(
            f"expected {_FORMS}, got {kind(entry)}",
            reason="WRONG_TYPE",
            field="target",
            index=place,
        )

    def wrong(why: str = f"{shown(entry)} is not an address: expected ") -> InvalidArgument:
        return InvalidArgument(
            f"{why}{_FORMS}",
            reason="NOT_AN_ADDRESS",
            field="target",
            index=place,
        )

    if entry.startswith("unix:") and len(entry) > 5:
        return "", entry
    for prefix in ("dns:", "ipv4:", "ipv6:"):
        if entry.startswith(prefix) and not entry[len(prefix) :].isdecimal():
            # gRPC's own forms: `dns://server/name`, and lists of numeric addresses.
            rest = entry[len(prefix) :]
            head, slash, last = rest.rpartition("/")
            hosts = [_with_port(host, wrong, numeric=prefix == "ipv6:") for host in last.split(",")]
            return "", f"{prefix}{head}{slash}{','.join(hosts)}"
    scheme, separator, rest = entry.partition("://")
    if not separator:
        return "", _with_port(entry, wrong)
    if scheme not in ("http", "https"):
        raise wrong()
    return scheme, _with_port(rest.removesuffix("/"), wrong)


def _with_port(text: str, wrong: Any, *, numeric: bool = False) -> str:
    """Completes a host, with or without a port, to `host:port`."""
    host, colon, port = text.rpartition(":")
    if not colon or "]" in port:
        host, port = text, str(DEFAULT_PORT)
    bare = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    if (
        not bare
        or any(c.isspace() or c in "/?#@[]" for c in bare)
        or (":" in bare and bare == host)
    ):
        raise wrong()
    if not (port.isascii() and port.isdecimal() and 0 < int(port) < 2**16):
        raise wrong()
    if host == text and host.isascii() and host.isdecimal():
        raise wrong(f"{host!r} is a port without a host: expected localhost:{host}, or ")
    return f"{host}:{port}"


def _tls(tls: Any, schemes: set[str]) -> Any:
    if "http" in schemes and tls not in (None, False):
        raise InvalidArgument(
            "the address begins with http://, which excludes TLS: use https://, or leave out tls=",
            reason="CONTRADICTION",
            field="tls",
        )
    if "https" in schemes:
        if tls is False:
            raise InvalidArgument(
                "the address begins with https://, which needs TLS: use http://, or leave out tls=",
                reason="CONTRADICTION",
                field="tls",
            )
        tls = True if tls is None else tls
    if tls is None or isinstance(tls, (bool, grpc.ChannelCredentials)):
        return tls
    _roots(tls)  # refuse a bad file now, not at the first call
    return tls


def _roots(tls: Any) -> bytes:
    """The PEM bytes of the root certificates to trust."""
    if isinstance(tls, bytes):
        content, name = tls, "the bytes"
    elif isinstance(tls, (str, os.PathLike)) or _files.is_open_file(tls):
        name = _files.path_of("tls", tls, "PEM bytes or the path of a PEM file")
        content = _files.read("tls", name)
    else:
        raise InvalidArgument(
            "expected True, PEM bytes, the path of a PEM file or grpc.ChannelCredentials, got "
            f"{kind(tls)}",
            reason="WRONG_TYPE",
            field="tls",
        )
    try:
        text = content.decode("ascii", errors="ignore")
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(cadata=text)
    except (ssl.SSLError, ValueError):
        raise InvalidArgument(
            f"{name!s:.60} has no certificate in PEM form (-----BEGIN CERTIFICATE-----)",
            reason="NOT_PEM",
            field="tls",
        ) from None
    return content


def _token(token: Any) -> str | None:
    if token is None:
        return None
    if not isinstance(token, str):
        raise InvalidArgument(
            f"expected a str, got {kind(token)}", reason="WRONG_TYPE", field="token"
        )
    token = token.strip()  # a token read from a file may end with a line break
    if not token or not all("!" <= c <= "~" for c in token):
        # The message does not show the token, because it is a secret.
        raise InvalidArgument(
            "expected one or more visible ASCII characters, without spaces",
            reason="NOT_A_TOKEN",
            field="token",
        )
    if len(token) > _LONGEST_TOKEN:
        raise InvalidArgument(
            f"got {len(token):,} characters, expected at most {_LONGEST_TOKEN:,}: servers refuse "
            "longer headers",
            reason="NOT_A_TOKEN",
            field="token",
        )
    return token


def _options(options: Any) -> tuple[tuple[str, Any], ...]:
    expected = "expected pairs of a gRPC option's name and its value (an int or a str)"
    pairs = options.items() if isinstance(options, Mapping) else options  # pyright: ignore[reportUnknownVariableType, reportUnknownMemberType]
    if isinstance(pairs, (str, bytes)) or not iterable(pairs):
        raise InvalidArgument(
            f"{expected}, got {kind(options)}", reason="WRONG_TYPE", field="options"
        )
    kept: list[tuple[str, Any]] = []
    for i, pair in enumerate(pairs):  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
        good = isinstance(pair, (tuple, list)) and len(pair) == 2 and isinstance(pair[0], str)  # pyright: ignore[reportUnknownArgumentType]
        if (
            not good
            or not isinstance(pair[1], (int, str, bytes))
            or (isinstance(pair[1], int) and not -(2**31) <= pair[1] < 2**31)
        ):
            raise InvalidArgument(
                f"{expected}, got {shown(pair)}", reason="WRONG_TYPE", field="options", index=i
            )
        kept.append((pair[0], pair[1]))  # pyright: ignore[reportUnknownArgumentType]
    return tuple(kept)


def address(target: Target) -> str:
    """The gRPC target of one address, or of a list of addresses over which calls are spread."""
    if isinstance(target, str):
        return target
    if not target:
        raise InvalidArgument(
            "expected one or more addresses, got none", reason="NO_ADDRESS", field="target"
        )
    if len(target) == 1:
        return target[0]
    found = [_resolved(i, entry) for i, entry in enumerate(target)]
    families = {family for family, _ in found}
    if len(families) > 1:
        raise InvalidArgument(
            "expected only IPv4 or only IPv6 addresses in a list, got both",
            reason="MIXED_ADDRESSES",
            field="target",
        )
    return f"{families.pop()}:" + ",".join(text for _, text in found)


def _resolved(place: int, entry: str) -> tuple[str, str]:
    """The family and "address:port" of an entry, resolved, because gRPC lists must be numeric."""
    host, colon, port = entry.rpartition(":")
    if not colon or not port.isdecimal() or "/" in host:
        raise InvalidArgument(
            f"got {entry!r}, expected host:port",
            reason="NOT_AN_ADDRESS",
            field="target",
            index=place,
        )
    bare = host.removeprefix("[").removesuffix("]")
    try:
        number = ipaddress.ip_address(bare)
    except ValueError:
        try:
            number = ipaddress.ip_address(socket.gethostbyname(bare))
        except OSError as error:
            raise InvalidArgument(
                f"the host name {bare!r} cannot be resolved: {error}",
                reason="NAME_NOT_FOUND",
                field="target",
                index=place,
            ) from None
    return ("ipv4", f"{number}:{port}") if number.version == 4 else ("ipv6", f"[{number}]:{port}")


def _credentials(tls: Any) -> grpc.ChannelCredentials:
    if isinstance(tls, grpc.ChannelCredentials):
        return tls
    if tls is True:
        return grpc.ssl_channel_credentials()
    return grpc.ssl_channel_credentials(root_certificates=_roots(tls))

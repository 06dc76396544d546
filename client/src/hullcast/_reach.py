"""Why a server cannot be reached: the text of gRPC as a cause and a remedy.

The command line says the same (`src/cli/reach.rs`).
"""

from __future__ import annotations

import contextlib
import socket

#: An HTTP/2 client's first bytes: the preface, and an empty SETTINGS frame.
_GREETING = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + b"\0\0\0\x04" + bytes(5)
#: Seconds that a peer may take to say what it speaks.
_PATIENCE = 2.0


def refused(target: str, details: str, *, several: bool) -> str | None:
    """The sentence for a server that is not there; None for another cause.

    Args:
        target: the address as the user gave it.
        details: the text of gRPC.
        several: whether the target names several servers.
    """
    start = f"start one with `hullcast serve --listen {target}`"
    if "Connection refused" in details and not several:
        start = start if target.startswith("unix:") else "start one with `hullcast serve`"
        return f"no hullcast server at {target} (connection refused); {start}"
    if "No such file or directory" in details and target.startswith("unix:"):
        return f"no hullcast server at {target} (no such socket); {start}"
    if "errors resolving" in details or "lookup failed" in details:
        return f"no host of the name in {target}"
    return None


def mismatch(target: str, details: str, *, tls: bool) -> str | None:
    """The sentence for a server that is there but cannot be spoken to; None for another cause.

    Args:
        target: one address, `host:port`.
        details: the text of gRPC.
        tls: whether the client speaks TLS.
    """
    if tls:
        if "WRONG_VERSION_NUMBER" in details:
            return f"the server at {target} does not speak TLS: leave out tls=, or use http://"
        if "Hostname Verification" in details:
            return (
                f"the certificate of the server at {target} is for another host name: connect to "
                "the name that the certificate has"
            )
        if "CERTIFICATE_VERIFY_FAILED" in details:
            cause = details.partition("CERTIFICATE_VERIFY_FAILED:")[2].removesuffix(": OK").strip()
            return (
                f"the certificate of the server at {target} is not trusted ({cause}): give the PEM "
                "file of its authority as tls="
            )
        if "CERTIFICATE_REQUIRED" in details:
            return (
                f"the server at {target} asks for a client certificate: give "
                "grpc.ssl_channel_credentials with a key and a certificate as tls="
            )
        return None
    if "Socket closed" not in details and "HTTP/2" not in details:
        return None
    answer = _greeting(target)
    if answer[:2] in (b"\x15\x03", b"\x16\x03"):
        return f"the server at {target} speaks TLS: give tls=, or use https://"
    # The fourth byte of a frame is its type; a server begins with SETTINGS, type 4.
    if len(answer) >= 4 and answer[3] != 4:
        return f"the server at {target} does not speak HTTP/2: it is not a hullcast server"
    return None


def _greeting(target: str) -> bytes:
    """The first bytes that a peer answers to HTTP/2's preface; none if it says nothing."""
    host, _, port = target.rpartition(":")
    with contextlib.suppress(OSError, ValueError):
        address = (host.strip("[]"), int(port))
        with socket.create_connection(address, timeout=_PATIENCE) as peer:
            peer.sendall(_GREETING)
            return peer.recv(9)
    return b""

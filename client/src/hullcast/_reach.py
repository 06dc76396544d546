"""Explains why a server cannot be reached: turns gRPC's text into a cause and a remedy.

The Rust client gives the same explanations (`crates/client/src/reach.rs`).
"""

from __future__ import annotations

import contextlib
import socket
import ssl

#: The first bytes of an HTTP/2 client: the preface and an empty SETTINGS frame.
_GREETING = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + b"\0\0\0\x04" + bytes(5)
#: OpenSSL's error numbers for a certificate of another host name, and of another IP address.
_HOST_MISMATCH = (62, 64)
#: The seconds within which a peer must answer.
_PATIENCE = 2.0


def absent(target: str, addresses: tuple[str, ...]) -> str | None:
    """The explanation for a server that is not there; None if that is not the cause.

    Args:
        target: the address as gRPC has it.
        addresses: the target's addresses as `host:port`; empty for a Unix socket.
    """
    if len(addresses) > 1:
        # One server that is there is enough.
        found = [absent(address, (address,)) for address in addresses]
        if None in found:
            return None
        return f"none of {len(addresses)} servers is there: {'; '.join(map(str, found[:3]))}"
    try:
        if not addresses:
            with socket.socket(socket.AF_UNIX) as peer:
                peer.settimeout(_PATIENCE)
                peer.connect(target.removeprefix("unix:").removeprefix("//"))
        for address in addresses:
            _connected(address).close()
    except ConnectionRefusedError:
        return f"no hullcast server at {target} (connection refused); {_remedy(target)}"
    except FileNotFoundError:
        return f"no hullcast server at {target} (no such socket); {_remedy(target)}"
    except socket.gaierror:
        return f"no host of the name in {target}"
    except (OSError, ValueError):
        pass  # a temporary condition, or one that gRPC describes better
    return None


def _remedy(target: str) -> str:
    listen = f" --listen {target}" if target.startswith("unix:") else ""
    return f"start one with `hullcast serve{listen}`"


def mismatch(target: str, details: str, trust: ssl.SSLContext | None) -> str | None:
    """The explanation for a server that is there but does not fit the client's settings.

    Args:
        target: `host:port`.
        details: gRPC's text. If a name has several addresses, the text is about the last one only.
        trust: the certificates that the client trusts; None if it does not use TLS.

    Returns:
        The explanation, or None if the cause is another.
    """
    answer = _greeting(target)
    # The fourth byte of a frame is its type. A server begins with a SETTINGS frame, type 4.
    plain = len(answer) >= 4 and answer[3] == 4
    if trust is None:
        if answer[:2] in (b"\x15\x03", b"\x16\x03"):
            return f"the server at {target} speaks TLS: give tls=, or use https://"
        if len(answer) >= 4 and not plain:
            return f"the server at {target} does not speak HTTP/2: it is not a hullcast server"
        return None
    if plain or "WRONG_VERSION_NUMBER" in details:
        return f"the server at {target} does not speak TLS: leave out tls=, or use http://"
    cause = details.partition("CERTIFICATE_VERIFY_FAILED:")[2].removesuffix(": OK").strip()
    other_name = "Hostname Verification" in details
    try:
        with _connected(target) as peer:
            trust.wrap_socket(peer, server_hostname=_host(target)).close()
    except ssl.SSLCertVerificationError as error:
        if trust.cert_store_stats()["x509_ca"]:
            other_name = other_name or error.verify_code in _HOST_MISMATCH
            cause = cause or error.verify_message
    except (OSError, ValueError):
        pass
    if other_name:
        return (
            f"the certificate of the server at {target} is for another host name: connect to a "
            "name that the certificate has"
        )
    if cause:
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


def _host(target: str) -> str:
    return target.rpartition(":")[0].strip("[]")


def _connected(target: str) -> socket.socket:
    return socket.create_connection(
        (_host(target), int(target.rpartition(":")[2])), timeout=_PATIENCE
    )


def _greeting(target: str) -> bytes:
    """The first bytes of a peer's response to an HTTP/2 preface; empty if it does not respond."""
    with contextlib.suppress(OSError, ValueError), _connected(target) as peer:
        peer.sendall(_GREETING)
        return peer.recv(9)
    return b""

"""Why a server cannot be reached: the text of gRPC as a cause and a remedy.

The command line says the same (`src/cli/reach.rs`).
"""

from __future__ import annotations

import contextlib
import socket
import ssl

#: An HTTP/2 client's first bytes: the preface, and an empty SETTINGS frame.
_GREETING = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + b"\0\0\0\x04" + bytes(5)
#: OpenSSL's numbers for a certificate of another host name, and of another address.
_HOST_MISMATCH = (62, 64)
#: Seconds in which a peer has to answer.
_PATIENCE = 2.0


def absent(target: str, addresses: tuple[str, ...]) -> str | None:
    """The sentence for a server that is not there; None for another cause.

    Args:
        target: the address as gRPC has it.
        addresses: the `host:port` of the target; none of a Unix socket.
    """
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
        pass  # what passes, or what gRPC says better
    return None


def _remedy(target: str) -> str:
    listen = f" --listen {target}" if target.startswith("unix:") else ""
    return f"start one with `hullcast serve{listen}`"


def mismatch(target: str, details: str, trust: ssl.SSLContext | None) -> str | None:
    """The sentence for a server that is there but cannot be spoken to; None for another cause.

    Args:
        target: `host:port`.
        details: the text of gRPC. For a name with several addresses, it is about the last one only.
        trust: the certificates that the client trusts; None if it does not speak TLS.
    """
    answer = _greeting(target)
    # The fourth byte of a frame is its type; a server begins with SETTINGS, type 4.
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
    """The first bytes that a peer answers to HTTP/2's preface; none if it says nothing."""
    with contextlib.suppress(OSError, ValueError), _connected(target) as peer:
        peer.sendall(_GREETING)
        return peer.recv(9)
    return b""

"""Failures of the connection are explained by this package's own texts, never by gRPC's."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import grpc
import numpy as np
import psutil
import pytest
from crowds import CUBE, NO_PROXY, Server

import hullcast
from hullcast import _status

#: Parts of gRPC's own texts, none of which a caller may see.
RAW = re.compile(r"last error|recvmsg|Socket closed|Stream removed|Deadline Exceeded|http2 header")


def reset(peer: socket.socket) -> None:
    """Closes a connection such that the other end gets a reset."""
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    peer.close()


def after_reading(end: Callable[[socket.socket], None]) -> Callable[[socket.socket], None]:
    """Reads the peer's first bytes before it ends the connection."""

    def run(peer: socket.socket) -> None:
        peer.recv(100)
        end(peer)

    return run


ENDS: dict[str, Callable[[socket.socket], None]] = {
    "closes": socket.socket.close,
    "resets": reset,
    "closes after reading": after_reading(socket.socket.close),
    "resets after reading": after_reading(reset),
}


@pytest.fixture(params=ENDS)
def peer(request: pytest.FixtureRequest) -> Iterator[str]:
    """The address of a peer that accepts connections and ends each at once."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        while True:
            try:
                accepted, _ = listener.accept()
            except OSError:
                return
            ENDS[request.param](accepted)

    threading.Thread(target=serve, daemon=True).start()
    yield f"127.0.0.1:{listener.getsockname()[1]}"
    listener.shutdown(socket.SHUT_RDWR)
    listener.close()


@pytest.mark.parametrize("scheme", ["", "https://"])
def test_a_peer_that_ends_the_connection(peer, scheme):
    """Catches gRPC's own text for a peer that closes or resets at once, such as an idle proxy."""

    def expect(error: hullcast.Error) -> None:
        assert "not a hullcast server" in str(error)
        assert "proxy that has no server" in str(error)
        assert not RAW.search(str(error))

    with hullcast.connect(scheme + peer, options=NO_PROXY) as client:
        with pytest.raises(hullcast.Unavailable) as caught:
            client.ping()
        expect(caught.value)
        with pytest.raises(hullcast.DeadlineExceeded, match="The first attempt failed") as late:
            client.register(CUBE, timeout=1)
        expect(late.value)

    async def run() -> None:
        async with hullcast.aio.connect(scheme + peer, options=NO_PROXY) as client:
            with pytest.raises(hullcast.DeadlineExceeded, match="The first attempt") as caught:
                await client.register(CUBE, timeout=1)
            expect(caught.value)

    asyncio.run(run())


def test_a_frozen_server_and_a_short_timeout():
    """Catches "Deadline Exceeded" as the whole text, for every kind of call."""
    with Server() as server, hullcast.connect(server.address, options=NO_PROXY) as client:
        scene = hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]])
        session = client.session(scene, [[0, 0]])
        session.step(scene.positions, scene.rotations)
        os.kill(server.process.pid, signal.SIGSTOP)
        while psutil.Process(server.process.pid).status() != psutil.STATUS_STOPPED:
            time.sleep(0.01)  # its threads do not stop at once
        try:
            for call in (
                lambda: client.query(scene, [[0, 0]], timeout=0.3),
                lambda: client.find(scene, timeout=0.3),
                lambda: client.register(CUBE, timeout=0.3),
                lambda: client.ping(timeout=0.3),
                lambda: session.step(scene.positions, scene.rotations, timeout=0.3),
            ):
                with pytest.raises(hullcast.DeadlineExceeded) as caught:
                    call()
                assert "did not answer within the timeout of 0.3 s: " in str(caught.value)
                assert "timeout= gives a call more time" in str(caught.value)
                assert not RAW.search(str(caught.value))
        finally:
            os.kill(server.process.pid, signal.SIGCONT)


def test_the_longest_token_is_accepted_by_the_server():
    """Catches a limit of the client that is above the server's, which resets such calls."""
    token = "x" * 15_000
    with (
        Server() as server,
        hullcast.connect(server.address, token=token, options=NO_PROXY) as client,
    ):
        assert client.ping() > 0
    with pytest.raises(hullcast.InvalidArgument, match="expected at most 15,000") as caught:
        hullcast.connect("localhost", token=token + "x")
    assert "xxx" not in str(caught.value)  # a token is a secret


class Failed(grpc.RpcError):
    """A call that failed in the transport."""

    def __init__(self, code: grpc.StatusCode, details: str) -> None:
        self._failure = code, details

    def code(self) -> grpc.StatusCode:
        return self._failure[0]

    def details(self) -> str:
        return self._failure[1]

    def trailing_metadata(self) -> tuple[()]:
        return ()

    initial_metadata = trailing_metadata


#: Texts of gRPC, and a part of this package's text.
TEXTS = [
    ("UNAVAILABLE", "connections to all backends failing; last error: UNKNOWN: ipv4:127.0.0.1:1: Failed to connect to remote host: connect: Connection refused (111)", "nothing listens"),
    ("UNAVAILABLE", "last error: UNAVAILABLE: ipv4:1.2.3.4:5: Handshake read failed (Socket closed)", "closed before"),
    ("UNAVAILABLE", "Stream removed (recvmsg:Connection reset by peer (104))", "reset before"),
    ("UNAVAILABLE", "DNS resolution failed for x:1: C-ares status is not ARES_SUCCESS", "host name"),
    ("UNAVAILABLE", "last error: connect: No route to host (113)", "no route to host"),
    ("UNAVAILABLE", "last error: connect: Network is unreachable (101)", "network cannot be reached"),
    ("UNKNOWN", "Received http2 header with status: 431", "use a shorter token"),
    ("UNAVAILABLE", "Received http2 header with status: 502", "HTTP error (502)"),
    ("UNIMPLEMENTED", "Received http2 header with status: 404", "HTTP error (404)"),
    ("DEADLINE_EXCEEDED", "Deadline Exceeded", "did not answer within the timeout"),
]  # fmt: skip


@pytest.mark.parametrize(("code", "details", "part"), TEXTS)
def test_texts_of_the_transport(code, details, part):
    """Catches gRPC's own text where this package has a better one."""
    error = _status.from_rpc(Failed(grpc.StatusCode[code], details))
    assert part in str(error)
    assert not RAW.search(str(error))


def test_an_unknown_text_is_kept():
    """Catches a cause that is lost because this package does not know it."""
    error = _status.from_rpc(Failed(grpc.StatusCode.UNAVAILABLE, "a new cause"))
    assert str(error) == "UNAVAILABLE: a new cause"


TLS = """
import os, sys, hullcast
with hullcast.connect(sys.argv[1]) as client:
    try:
        client.ping()
    except hullcast.Unavailable as error:
        print(error)
print(os.environ["GRPC_VERBOSITY"])
"""


@pytest.mark.parametrize("own", [None, "INFO"])
def test_grpc_is_silent_on_standard_error(own):
    """Catches gRPC's own lines about a failed TLS handshake, and a user's setting that is lost."""
    environment = {**os.environ, "PYTHONPATH": str(Path(hullcast.__file__).parents[1])}
    environment.pop("GRPC_VERBOSITY", None)
    environment.update({} if own is None else {"GRPC_VERBOSITY": own}, no_proxy="*")
    with Server() as server:
        done = subprocess.run(
            [sys.executable, "-c", TLS, f"https://{server.address}"],
            capture_output=True,
            text=True,
            timeout=60,
            check=True,
            env=environment,
        )
    assert "does not speak TLS" in done.stdout
    assert done.stdout.split()[-1] == (own or "ERROR")
    assert bool(done.stderr) == (own is not None), done.stderr

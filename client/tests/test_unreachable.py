"""Permanent failures are reported at once, with cause and remedy, from Python and Rust."""

from __future__ import annotations

import asyncio
import http.server
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trustme
from crowds import CUBE, NO_PROXY, Server
from silent import SilentProxy

import hullcast
from hullcast import _channel
from hullcast._serve import find_binary

SCENE = Path(__file__).resolve().parents[2] / "examples/scenes/panda.json"


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """A plain server, one with TLS, a web server, a port without a server, and PEM files."""
    folder = tmp_path_factory.mktemp("tls")
    authority = trustme.CA()
    own = authority.issue_cert("localhost")
    own.private_key_pem.write_to_path(folder / "key.pem")
    (folder / "certificate.pem").write_bytes(b"".join(b.bytes() for b in own.cert_chain_pems))
    authority.cert_pem.write_to_path(folder / "ca.pem")
    trustme.CA().cert_pem.write_to_path(folder / "other.pem")
    (folder / "no.pem").write_text("not a certificate\n")
    web = http.server.HTTPServer(("127.0.0.1", 0), http.server.BaseHTTPRequestHandler)
    threading.Thread(target=web.serve_forever, daemon=True).start()
    with socket.create_server(("127.0.0.1", 0)) as gone:
        free = gone.getsockname()[1]
    files = {name: str(folder / f"{name}.pem") for name in ("ca", "other", "no")}
    options = [
        "--tls-certificate",
        str(folder / "certificate.pem"),
        "--tls-key",
        str(folder / "key.pem"),
    ]
    with Server() as plain, Server("memory://", *options) as secured:
        yield {
            "plain": plain.address.rpartition(":")[2],
            "tls": secured.address.rpartition(":")[2],
            "web": str(web.server_port),
            "free": str(free),
            **files,
        }
    web.shutdown()


#: For each failure: the target, the root certificates, and parts of the messages of Python and of
#: the command line.
FAILURES = [
    ("127.0.0.1:{free}", None, ["no hullcast server at", "connection refused", "hullcast serve"], None),
    ("http://localhost:{free}", None, ["connection refused", "hullcast serve"], None),
    ("unix:/nonexistent/socket", None, ["no such socket", "hullcast serve --listen unix:"], None),
    ("nosuchhost.invalid", None, ["no host of the name"], None),
    ("localhost:{tls}", None, ["speaks TLS", "https://"], None),
    ("http://localhost:{tls}", None, ["speaks TLS", "https://"], None),
    ("https://localhost:{plain}", "ca", ["does not speak TLS", "http://"], None),
    ("https://localhost:{tls}", "other", ["certificate", "is not trusted", "PEM file"], None),
    ("https://localhost:{tls}", None, ["certificate", "is not trusted", "PEM file"], None),
    ("https://127.0.0.1:{tls}", "ca", ["certificate", "another host name"], ["certificate", "127.0.0.1"]),
    ("127.0.0.1:{web}", None, ["does not speak HTTP/2", "not a hullcast server"], None),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(FAILURES)))
def test_each_fails_at_once_and_says_why(places, number):
    """Catches twelve seconds of silence, and gRPC's own text; blocking, asyncio and Rust."""
    target, roots, texts, other = FAILURES[number]
    target = target.format(**places)
    tls = None if roots is None else places[roots]

    def expect(text: str, parts: list[str]) -> None:
        assert all(part in text for part in parts), text
        assert "last error" not in text

    with hullcast.connect(target, tls=tls, options=NO_PROXY) as client:
        started = time.monotonic()
        for call in (
            lambda: client.register(CUBE),
            client.ping,
            lambda: client.session(
                hullcast.Scene([b"\1" * 32], np.zeros((1, 3)), [[0, 0, 0, 1]]), [[0, 0]]
            ).step(np.zeros((1, 3)), [[0, 0, 0, 1]]),
        ):
            with pytest.raises(hullcast.Unavailable) as caught:
                call()
            expect(str(caught.value), texts)
        assert time.monotonic() - started < 8  # gRPC's own retries take 12 s per call

    async def run() -> None:
        async with hullcast.aio.connect(target, tls=tls, options=NO_PROXY) as client:
            with pytest.raises(hullcast.Unavailable) as caught:
                await client.register(CUBE)
            expect(str(caught.value), texts)

    asyncio.run(run())
    command = [find_binary(), "query", str(SCENE), "--remote", target]
    command += [] if tls is None else ["--tls-ca", tls]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode != 0
    expect(done.stderr, other or texts)


def test_what_is_right_is_answered(places):
    """Catches addresses and root certificates that are refused although they are right."""
    good = [
        (f"localhost:{places['plain']}", None),
        (f"http://localhost:{places['plain']}/", False),
        (f"ipv4:127.0.0.1:{places['plain']}", None),
        (f"dns:///localhost:{places['plain']}", None),
        ([f"127.0.0.1:{places['plain']}", f"127.0.0.1:{places['free']}"], None),
        (f"https://localhost:{places['tls']}", places["ca"]),
        (f"localhost:{places['tls']}", Path(places["ca"])),
        (f"localhost:{places['tls']}", Path(places["ca"]).read_bytes()),
    ]
    for target, tls in good:
        with hullcast.connect(target, tls=tls, options=NO_PROXY) as client:
            assert 0 < client.ping() < 10


def test_a_port_that_is_not_given():
    """Catches gRPC's own default port, which is 443."""
    for target, expected in {
        "localhost": "localhost:50051",
        "http://localhost": "localhost:50051",
        "https://host": "host:50051",
        "[::1]": "[::1]:50051",
        "[::1]:7": "[::1]:7",
        "dns:///name": "dns:///name:50051",
        "dns://8.8.8.8/name:1": "dns://8.8.8.8/name:1",
        "ipv4:1.2.3.4,1.2.3.5:7": "ipv4:1.2.3.4:50051,1.2.3.5:7",
        "unix:relative": "unix:relative",
    }.items():
        assert hullcast.connect(target).target == expected
    assert hullcast.connect(["a", "b:1"]).target == "a:50051,b:1"
    assert hullcast.connect("https://host")._settings.tls is True
    with pytest.raises(hullcast.InvalidArgument, match="CONTRADICTION: tls"):
        hullcast.connect("http://host", tls=True)


def test_a_file_that_is_not_pem_is_refused_at_once(places):
    """Catches eleven seconds of retries without a certificate, in Python and Rust."""
    with pytest.raises(hullcast.InvalidArgument, match="NOT_PEM: tls"):
        hullcast.connect("localhost", tls=places["no"])
    command = [find_binary(), "query", str(SCENE), "--remote", "https://localhost", "--tls-ca"]
    done = subprocess.run(
        [*command, places["no"]], capture_output=True, text=True, timeout=30, check=False
    )
    assert done.returncode != 0
    assert "--tls-ca" in done.stderr
    assert "not a PEM file" in done.stderr


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGABRT])
def test_the_own_server_that_has_ended_is_named_at_once(how):
    """Catches fourteen seconds of waiting for a server that cannot come back."""
    with hullcast.serve() as client:
        scene = hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]])
        session = client.session(scene, [[0, 0]])
        session.step(scene.positions, scene.rotations)
        os.kill(client._server._process.pid, how)
        if how != signal.SIGKILL:
            client._server._process.wait(30)
        started = time.monotonic()
        for call in (
            lambda: client.query(scene, [[0, 0]]),
            lambda: session.step(scene.positions, scene.rotations),
            lambda: client.find(scene),
            client.ping,
        ):
            with pytest.raises(hullcast.Unavailable, match=r"serve\(\) started ended \(") as caught:
                call()
            assert caught.value.reason == "SERVER_ENDED"
        named = f"signal {int(how)}, {how.name}" if how != signal.SIGTERM else "exit code 0"
        assert named in str(caught.value)
        assert time.monotonic() - started < 5


def test_a_server_that_answered_before_is_waited_for():
    """Catches a restart that is mistaken for a wrong address: only a first call fails at once."""
    with Server() as server, hullcast.connect(server.address, options=NO_PROXY) as client:
        client.register(CUBE)
        server.kill()
        later = threading.Timer(1.0, server.start)
        later.start()
        assert len(client.register(CUBE)) == 1
        later.join()


def tenth_of_the_intervals() -> list[tuple[str, int]]:
    """gRPC's options for a silent peer, at a tenth of the package's own intervals.

    The package's own intervals must add up to less than a call's usual timeout.
    """
    names = ("grpc.keepalive_time_ms", "grpc.keepalive_timeout_ms", "grpc.http2.ping_timeout_ms")
    own = [_channel._OPTIONS[name] for name in names]
    assert own[0] + max(own[1:]) <= 30_000
    return [*NO_PROXY, *((name, value // 10) for name, value in zip(names, own, strict=True))]


def test_a_frozen_server_is_left_for_another():
    """Catches a call that waits for a frozen server until its deadline, although another would
    answer."""
    with (
        Server() as a,
        Server() as b,
        hullcast.connect([a.address, b.address], options=tenth_of_the_intervals()) as client,
    ):
        hulls = client.register(CUBE)
        scene = hullcast.Scene(hulls, np.zeros((1, 3)), [[0, 0, 0, 1]])
        sessions = [client.session(scene, [[0, 0]]) for _ in range(2)]
        for session in sessions:
            session.step(scene.positions, scene.rotations)
        os.kill(a.process.pid, signal.SIGSTOP)
        try:
            for _ in range(4):
                assert client.query(scene, [[0, 0]], timeout=40).in_contact.all()
            for session in sessions:
                m = session.step(scene.positions, scene.rotations, timeout=40)
                assert m.in_contact.all()
        finally:
            os.kill(a.process.pid, signal.SIGCONT)


@pytest.mark.parametrize("first", ["session", "query", "find"])
def test_a_proxy_that_falls_silent_is_left_for_another(first):
    """Catches a call that waits for its deadline because a proxy accepts the bytes and forwards none.

    Each kind of call must notice it, so each kind comes first once.
    """
    with (
        Server() as a,
        Server() as b,
        SilentProxy(a.address) as proxy,
        hullcast.connect([proxy.address, b.address], options=tenth_of_the_intervals()) as client,
    ):
        scene = hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]])
        sessions = [client.session(scene, [[0, 0]]) for _ in range(2)]
        calls = {
            "session": lambda: [
                s.step(scene.positions, scene.rotations, timeout=40) for s in sessions
            ],
            "query": lambda: [client.query(scene, [[0, 0]], timeout=40) for _ in range(4)],
            "find": lambda: [client.find(scene, timeout=40) for _ in range(4)],
        }
        for call in calls.values():
            call()
        proxy.silence()
        # Each entry makes several calls, so that at least one of them goes to the proxy.
        for name in sorted(calls, key=lambda name: name != first):
            assert len(calls[name]()) > 1


def test_a_proxy_that_is_silent_from_the_start():
    """Catches a first call that waits for a silent peer although another server could answer.

    Without another server, the call must end with an error that names the cause.
    """
    with (
        Server() as server,
        SilentProxy(server.address, silent=True) as proxy,
        hullcast.connect([proxy.address, server.address], options=NO_PROXY) as client,
    ):
        assert len(client.register(CUBE, timeout=40)) == 1
        with hullcast.connect(proxy.address, options=NO_PROXY) as alone:
            with pytest.raises(
                hullcast.Unavailable, match="accepts connections and does not answer"
            ):
                alone.ping()
            with pytest.raises((hullcast.Unavailable, hullcast.DeadlineExceeded)):
                alone.register(CUBE, timeout=1)
        command = [find_binary(), "query", str(SCENE), "--remote", proxy.address]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 4
        assert "accepts connections and does not answer: is it a hullcast server?" in done.stderr

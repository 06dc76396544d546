"""Servers started by `serve`: sockets, stores, start and end."""

from __future__ import annotations

import pickle
import threading

import numpy as np
import programs
import pytest
from crowds import CUBE, NO_PROXY

import hullcast
from hullcast import Outcome


def test_no_server_is_unavailable():
    """Nothing listens on the port."""
    with (
        hullcast.connect("127.0.0.1:1", options=[*NO_PROXY, ("grpc.enable_retries", 0)]) as client,
        pytest.raises(hullcast.Unavailable) as caught,
    ):
        client.register([CUBE])
    assert isinstance(caught.value, ConnectionError)
    assert caught.value.reason == "UNAVAILABLE"


def test_a_unix_socket_serves_too(tmp_path):
    """The client sends an authority that HTTP/2 accepts."""
    with hullcast.serve(listen=f"unix:{tmp_path}/socket") as client:
        assert client.target.startswith("unix:")
        assert len(client.register([CUBE])) == 1


def test_a_store_outlives_its_server(tmp_path):
    """A hull registered with one server is known to the next server with the same store."""
    with hullcast.serve(tmp_path) as client:
        hulls = client.register([CUBE])
    scene = hullcast.Scene(hulls, np.zeros((1, 3)), [[0, 0, 0, 1]])
    with hullcast.serve(tmp_path) as client:
        assert client.query(scene, [[0, 0]]).outcome.tolist() == [Outcome.CONTACT]


def test_the_server_ends_with_its_parent(tmp_path):
    """The server ends even if its parent is killed and so cannot close anything."""
    program = """
        import hullcast, os, signal
        client = hullcast.serve()
        print(client._server._process.pid, flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
    """
    parent = programs.run(program, TMPDIR=str(tmp_path))
    server = int(parent.stdout)
    for _ in range(200):
        try:
            with open(f"/proc/{server}/stat") as file:
                if file.read().rpartition(")")[2].split()[0] == "Z":
                    return  # it has ended, and its new parent has not waited for it yet
        except FileNotFoundError:
            return
        threading.Event().wait(0.05)
    pytest.fail("the server is still there")


def test_a_server_that_does_not_start_says_why(tmp_path, monkeypatch):
    """The message has the end of the server's log. A missing binary is another error."""
    with pytest.raises(hullcast.ServerDidNotStart, match="no-such-flag"):
        hullcast.serve(arguments=["--no-such-flag"])
    monkeypatch.setenv("HULLCAST_BIN", str(tmp_path / "none"))
    with pytest.raises(hullcast.ServerNotFound, match="HULLCAST_BIN"):
        hullcast.serve()
    monkeypatch.delenv("HULLCAST_BIN")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(hullcast.ServerNotFound, match="PATH"):
        hullcast.serve()


def test_a_server_that_starts_too_slowly_names_the_argument(monkeypatch, tmp_path):
    """Catches "did not print its address in time", which names neither argument nor value."""
    slow = tmp_path / "slow"
    slow.write_text("#!/bin/sh\nsleep 60\n")
    slow.chmod(0o755)
    monkeypatch.setenv("HULLCAST_BIN", str(slow))
    with pytest.raises(hullcast.ServerDidNotStart, match=r"within 0\.25 s, the start_timeout"):
        hullcast.serve(start_timeout=0.25)


def test_faces_of_a_hull_whose_server_ended():
    """Catches "start one with `hullcast serve`" for a server of `serve()`, which does not come back."""
    with hullcast.serve() as client:
        hulls = client.register([hullcast.box(1), hullcast.box(2), hullcast.box(3)])
        assert len(hulls[0].faces) == 6
        assert client.ping() > 0  # reading the faces does not end the server
        client._server._process.kill()
        client._server._process.wait(10)
        with pytest.raises(hullcast.Unavailable, match=r"SERVER_ENDED: .*SIGKILL"):
            hulls[1].faces  # noqa: B018
        assert pickle.loads(pickle.dumps(hulls[1])).home is None
    with pytest.raises(hullcast.Unavailable, match="SERVER_ENDED"):
        hulls[2].faces  # noqa: B018

"""Three replicas on one store behind deploy/haproxy.cfg, deploy/nginx.conf, and the client's own
round robin: under load one is killed, added again, drained, and cut off, and no query fails.

Needs haproxy and nginx (`apt-get install haproxy nginx-light`).
"""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import grpc
import numpy as np
import pytest

import hullcast
from hullcast._pb import hulls_pb2
from hullcast._serve import find_binary

DEPLOY = Path(__file__).resolve().parents[3] / "deploy"
ENV = {"PATH": os.environ["PATH"] + ":/usr/sbin"}


def free_ports(count: int) -> list[int]:
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [s.getsockname()[1] for s in sockets]
    for s in sockets:
        s.close()
    return ports


class Replica:
    """One server of the three, on an address that it keeps."""

    def __init__(self, store: Path) -> None:
        self.port, self.admin = free_ports(2)
        self.store = store
        self.start()

    def start(self) -> None:
        command = [
            find_binary(),
            "serve",
            "--listen",
            f"127.0.0.1:{self.port}",
            "--store",
            str(self.store),
        ]
        command += ["--admin-listen", f"127.0.0.1:{self.admin}", "--compute-threads", "1"]
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self.process.stdout
        self.process.stdout.readline()

    def stop(self, how: signal.Signals) -> None:
        self.process.send_signal(how)
        if how in (signal.SIGKILL, signal.SIGTERM):
            self.process.wait(timeout=60)

    def metric(self, name: str) -> float:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.admin}/metrics", timeout=10) as page:
            lines = [line.decode() for line in page]
        return sum(float(line.split()[-1]) for line in lines if line.startswith(name))


@contextmanager
def replicas(store: Path) -> Iterator[list[Replica]]:
    all_three = [Replica(store) for _ in range(3)]
    try:
        yield all_three
    finally:
        for replica in all_three:
            replica.process.kill()
            replica.process.wait()


@contextmanager
def haproxy(all_three: list[Replica], tmp_path: Path) -> Iterator[str]:
    (port,) = free_ports(1)
    environment = ENV | {"HULLCAST_BIND": f"127.0.0.1:{port}"}
    for number, replica in enumerate(all_three, 1):
        environment[f"HULLCAST_{number}"] = f"127.0.0.1:{replica.port}"
        environment[f"HULLCAST_ADMIN_{number}"] = str(replica.admin)
    with running(
        ["haproxy", "-db", "-f", str(DEPLOY / "haproxy.cfg")], environment, port, tmp_path
    ):
        yield f"127.0.0.1:{port}"


@contextmanager
def nginx(all_three: list[Replica], tmp_path: Path) -> Iterator[str]:
    (port,) = free_ports(1)
    text = (DEPLOY / "nginx.conf").read_text().replace("listen 50050", f"listen 127.0.0.1:{port}")
    for number, replica in enumerate(all_three, 1):
        text = text.replace(f"10.0.0.{number}:50051", f"127.0.0.1:{replica.port}")
    assert "10.0.0" not in text
    (tmp_path / "nginx.conf").write_text(text)
    command = [
        "nginx",
        "-p",
        str(tmp_path),
        "-c",
        str(tmp_path / "nginx.conf"),
        "-g",
        "daemon off;",
    ]
    with running(command, ENV, port, tmp_path):
        yield f"127.0.0.1:{port}"


@contextmanager
def running(
    command: list[str], environment: dict[str, str], port: int, tmp_path: Path
) -> Iterator[None]:
    if not shutil.which(command[0], path=ENV["PATH"]):
        pytest.skip(f"{command[0]} is not installed")
    with open(tmp_path / "balancer.log", "w") as log:
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
    try:
        wait_until(lambda: listens(port), (tmp_path / "balancer.log").read_text)
        yield
    finally:
        process.terminate()
        process.wait(timeout=30)


def listens(port: int) -> bool:
    with socket.socket() as attempt:
        return attempt.connect_ex(("127.0.0.1", port)) == 0


def has(replica: Replica, ids: list[bytes]) -> list[bool]:
    with grpc.insecure_channel(
        f"127.0.0.1:{replica.port}", [("grpc.enable_http_proxy", 0)]
    ) as channel:
        call = channel.unary_unary(
            "/hullcast.v1.HullService/HasHulls",
            hulls_pb2.HasHullsRequest.SerializeToString,
            hulls_pb2.HasHullsResponse.FromString,
        )
        return list(call(hulls_pb2.HasHullsRequest(ids=ids), timeout=60).present)


def wait_until(condition, why=lambda: "") -> None:
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline, why()
        time.sleep(0.05)


class Load:
    """Threads that query, and register new hulls, until told to stop; what fails is kept."""

    def __init__(self, target: str | list[str], threads: int = 4) -> None:
        self.target = target
        self.stopping = threading.Event()
        self.counts: Counter[str] = Counter()
        self.phase = "start"
        self.failures: list[str] = []
        self.acknowledged: list[bytes] = []
        self.threads = [threading.Thread(target=self.run, args=(n,)) for n in range(threads)]
        for thread in self.threads:
            thread.start()

    def run(self, number: int) -> None:
        random = np.random.default_rng(number)
        with hullcast.connect(self.target) as client:
            while not self.stopping.is_set():
                try:
                    cloud = random.normal(size=(16, 3))
                    hulls = client.register([cloud])
                    self.acknowledged.append(hulls[0].id)
                    scene = hullcast.Scene(
                        hulls, np.zeros((2, 3)), [[0, 0, 0, 1]] * 2, body_hulls=[0, 0]
                    )
                    for _ in range(10):
                        answer = client.query(scene, np.tile([0, 1], (64, 1)))
                        assert (answer.outcome == hullcast.Outcome.CONTACT).all()
                        self.counts["queries"] += 1
                except Exception as error:
                    self.failures.append(f"{self.phase}: {error!r}")

    def more(self, phase: str, queries: int = 300) -> None:
        """Waits for so many more answers."""
        self.phase = phase
        wanted = self.counts["queries"] + queries
        deadline = time.monotonic() + 120
        while self.counts["queries"] < wanted and not self.failures:
            assert time.monotonic() < deadline, self.counts
            time.sleep(0.02)

    def stop(self) -> None:
        self.stopping.set()
        for thread in self.threads:
            thread.join(timeout=120)


@pytest.mark.parametrize("way", ["haproxy", "nginx", "round_robin"])
def test_no_query_fails_while_replicas_come_and_go(way: str, tmp_path: Path):
    """Under load: kill -9 one, start it again, drain another (SIGTERM), start it again, stop a third
    from answering without closing anything (SIGSTOP, as when its cable is out) and let it go on.
    No call fails that the client makes, every hull that was acknowledged is in the store, and all
    three have work again at the end."""
    with replicas(tmp_path / "store") as all_three:
        first, second, third = all_three
        if way == "round_robin":
            targets = [f"127.0.0.1:{replica.port}" for replica in all_three]
            go(targets, first, second, third, hang=False)
            return
        with (haproxy if way == "haproxy" else nginx)(all_three, tmp_path) as target:
            go(target, first, second, third, hang=way == "haproxy")


def go(
    target: str | list[str], first: Replica, second: Replica, third: Replica, *, hang: bool
) -> None:
    load = Load(target)
    try:
        load.more("at first")
        first.stop(signal.SIGKILL)
        load.more("one killed")
        first.start()
        load.more("it is back")
        second.stop(signal.SIGTERM)
        load.more("another drains")
        second.start()
        load.more("it is back")
        if hang:
            third.stop(signal.SIGSTOP)
            load.more("a third hangs")
            third.stop(signal.SIGCONT)
            load.more("it goes on")
    finally:
        load.stop()
        third.stop(signal.SIGCONT)
    assert load.failures == []
    assert load.counts["queries"] >= 1500
    for replica in (first, second, third):
        present = has(replica, load.acknowledged)
        assert present.count(True) == len(load.acknowledged) >= 100

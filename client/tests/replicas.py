"""Replicas with a shared store, the balancers of deploy/, and load on them.

Each replica may be in a network namespace of its own, if that is permitted.
"""

from __future__ import annotations

import json
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
from contextlib import ExitStack, contextmanager
from pathlib import Path

import grpc
import numpy as np
import pytest
from crowds import NO_PROXY

import hullcast
from hullcast._pb import hulls_pb2
from hullcast._serve import find_binary

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
ENV = {"PATH": os.environ["PATH"] + ":/usr/sbin"}


def free_ports(count: int) -> list[int]:
    """Ports of the loopback address that were free a moment ago."""
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [s.getsockname()[1] for s in sockets]
    for s in sockets:
        s.close()
    return ports


class Cable:
    """A virtual cable from this network to a network namespace that has only this connection.

    Its addresses are in 198.18.0.0/15, which is reserved for network tests (RFC 2544).
    """

    def __init__(self, number: int) -> None:
        self.name = f"hullcast-{os.getpid()}-{number}"
        self.here = f"hc{os.getpid() % 10**8}n{number}"
        block = f"198.{18 + os.getpid() % 2}.{os.getpid() // 2 % 256}.{4 * number}"
        first = block.rpartition(".")[0]
        self.address = f"{first}.{4 * number + 2}"
        try:
            self._ip("netns", "add", self.name)
        except AssertionError as error:
            pytest.skip(f"network namespaces are not allowed here: {error}")
        try:
            self._ip("link", "add", self.here, "type", "veth", "peer", "eth0", "netns", self.name)
            self._ip("addr", "add", f"{first}.{4 * number + 1}/30", "dev", self.here)
            self._ip("link", "set", self.here, "up")
            self._ip("-n", self.name, "addr", "add", f"{self.address}/30", "dev", "eth0")
            self._ip("-n", self.name, "link", "set", "lo", "up")
            self.mend()
        except BaseException:
            self._ip("netns", "del", self.name)
            raise

    def cut(self) -> None:
        """Cuts the cable: packets are lost in both directions without an error."""
        self._ip("-n", self.name, "link", "set", "eth0", "down")

    def mend(self) -> None:
        """Restores the connection."""
        self._ip("-n", self.name, "link", "set", "eth0", "up")

    def remove(self) -> None:
        """Removes the cable, which would otherwise outlast its namespace, and the namespace."""
        self._ip("link", "del", self.here)
        self._ip("netns", "del", self.name)

    def _ip(self, *words: str) -> None:
        done = subprocess.run(["ip", *words], env=ENV, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"ip {' '.join(words)}: {done.stderr}"


@contextmanager
def cables(count: int) -> Iterator[list[Cable]]:
    """Makes cables; skips the test if network namespaces are not permitted."""
    if os.geteuid() != 0 or not shutil.which("ip", path=ENV["PATH"]):
        pytest.skip("network namespaces need root and the command ip (Debian: iproute2)")
    with ExitStack() as stack:
        made: list[Cable] = []
        for number in range(count):
            made.append(Cable(number))
            stack.callback(made[-1].remove)
        yield made


class Replica:
    """One server, which keeps its address when it is restarted."""

    def __init__(self, store: Path, cable: Cable | None = None) -> None:
        self.store = store
        self.cable = cable
        self.host = cable.address if cable else "127.0.0.1"
        self.port, self.admin = (50051, 9090) if cable else free_ports(2)
        self.address = f"{self.host}:{self.port}"
        self.start()

    def start(self) -> None:
        """Starts the server and waits until it listens."""
        command = ["ip", "netns", "exec", self.cable.name] if self.cable else []
        command += [find_binary(), "serve", "--listen", self.address, "--store", str(self.store)]
        command += ["--admin-listen", f"{self.host}:{self.admin}", "--compute-threads", "1"]
        command += ["--allow-plaintext"] if self.cable else []
        self.process = subprocess.Popen(
            command, env={**os.environ, **ENV}, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        assert self.process.stdout
        assert self.process.stdout.readline().startswith("listening on ")

    def stop(self, how: signal.Signals) -> None:
        """Sends a signal: SIGKILL or SIGTERM (and waits for the end), SIGSTOP or SIGCONT."""
        self.process.send_signal(how)
        if how in (signal.SIGKILL, signal.SIGTERM):
            self.process.wait(timeout=60)

    def pairs(self) -> int:
        """The number of pairs that it has answered since it started."""
        page = f"http://{self.host}:{self.admin}/metrics"
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(page, timeout=10) as lines:
            found = [line.decode() for line in lines if line.startswith(b"hullcast_pairs_total")]
        assert found
        return round(sum(float(line.split()[-1]) for line in found))

    def has(self, ids: list[bytes]) -> list[bool]:
        """For each hull, whether the replica has it."""
        with grpc.insecure_channel(self.address, NO_PROXY) as channel:
            call = channel.unary_unary(
                "/hullcast.v1.HullService/HasHulls",
                hulls_pb2.HasHullsRequest.SerializeToString,
                hulls_pb2.HasHullsResponse.FromString,
            )
            return list(call(hulls_pb2.HasHullsRequest(ids=ids), timeout=60).present)


@contextmanager
def replicas(store: Path, cables: list[Cable] | None = None) -> Iterator[list[Replica]]:
    """Three replicas, each at the end of a cable if cables are given."""
    all_three: list[Replica] = []
    try:
        for place in range(3):
            all_three.append(Replica(store, cables[place] if cables else None))
        yield all_three
    finally:
        for replica in all_three:
            replica.process.kill()
            replica.process.wait()


@contextmanager
def haproxy(all_three: list[Replica], folder: Path) -> Iterator[str]:
    """HAProxy with deploy/haproxy.cfg."""
    (port,) = free_ports(1)
    environment = ENV | {"HULLCAST_BIND": f"127.0.0.1:{port}"}
    for number, replica in enumerate(all_three, 1):
        environment[f"HULLCAST_{number}"] = replica.address
        environment[f"HULLCAST_ADMIN_{number}"] = str(replica.admin)
    command = ["haproxy", "-db", "-f", str(DEPLOY / "haproxy.cfg")]
    with _running(command, environment, port, folder):
        yield f"127.0.0.1:{port}"


@contextmanager
def nginx(all_three: list[Replica], folder: Path) -> Iterator[str]:
    """nginx with deploy/nginx.conf, with the replicas' addresses in it."""
    (port,) = free_ports(1)
    text = (DEPLOY / "nginx.conf").read_text().replace("listen 50050", f"listen 127.0.0.1:{port}")
    for number, replica in enumerate(all_three, 1):
        text = text.replace(f"10.0.0.{number}:50051", replica.address)
    assert "10.0.0" not in text
    config = folder / "nginx.conf"
    config.write_text(text)
    command = ["nginx", "-p", str(folder), "-c", str(config), "-g", "daemon off;"]
    with _running(command, ENV, port, folder):
        yield f"127.0.0.1:{port}"


@contextmanager
def round_robin(all_three: list[Replica], folder: Path) -> Iterator[list[str]]:
    """No balancer: the client itself spreads its calls."""
    yield [replica.address for replica in all_three]


WAYS = {"haproxy": haproxy, "nginx": nginx, "round_robin": round_robin}


@contextmanager
def _running(
    command: list[str], environment: dict[str, str], port: int, folder: Path
) -> Iterator[None]:
    if not shutil.which(command[0], path=ENV["PATH"]):
        pytest.skip(f"{command[0]} is not installed")
    log = folder / "balancer.log"
    with open(log, "w") as file:
        process = subprocess.Popen(command, env=environment, stdout=file, stderr=file)
    try:
        deadline = time.monotonic() + 30
        while not _listens(port):
            assert time.monotonic() < deadline, log.read_text()
            time.sleep(0.05)
        yield
    finally:
        process.terminate()
        process.wait(timeout=30)


def _listens(port: int) -> bool:
    with socket.socket() as attempt:
        return attempt.connect_ex(("127.0.0.1", port)) == 0


class Load:
    """Load until it is stopped: Python threads that register and query, and `hullcast load`.

    Failures are collected in `failures`.
    """

    def __init__(self, target: str | list[str], threads: int = 3) -> None:
        self.target = target
        self.stopping = threading.Event()
        self.counts: Counter[str] = Counter()
        self.failures: list[str] = []
        self.acknowledged: list[bytes] = []
        self._phase = "start"
        addresses = target if isinstance(target, str) else ",".join(target)
        self._rust = subprocess.Popen(
            [
                *(find_binary(), "load", "--remote", addresses, "--family", "poly16"),
                *("--pairs", "64", "--concurrency", "3", "--connections", "3", "--verify", "4"),
                *("--retries", "10", "--duration", "3600", "--json"),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._threads = [threading.Thread(target=self._run, args=(n,)) for n in range(threads)]
        for thread in self._threads:
            thread.start()

    def _run(self, number: int) -> None:
        random = np.random.default_rng(number)
        poses = np.zeros((2, 3)), [[0, 0, 0, 1]] * 2
        with hullcast.connect(self.target, options=NO_PROXY) as client:
            while not self.stopping.is_set():
                try:
                    hulls = client.register([random.normal(size=(16, 3))])
                    self.acknowledged.append(hulls[0].id)
                    scene = hullcast.Scene(hulls, *poses, body_hulls=[0, 0])
                    for _ in range(10):
                        answer = client.query(scene, np.tile([0, 1], (64, 1)))
                        assert (answer.outcome == hullcast.Outcome.CONTACT).all()
                        self.counts["queries"] += 1
                except Exception as error:
                    self.failures.append(f"{self._phase}: {error!r}")

    def more(self, phase: str, queries: int = 300) -> None:
        """Waits until `queries` more queries are answered."""
        self._phase = phase
        wanted = self.counts["queries"] + queries
        deadline = time.monotonic() + 240
        while self.counts["queries"] < wanted and not self.failures:
            assert time.monotonic() < deadline, self.counts
            time.sleep(0.02)

    def stop(self) -> dict:
        """Stops the load; returns the counts of `hullcast load`."""
        self.stopping.set()
        self._rust.send_signal(signal.SIGINT)
        for thread in self._threads:
            thread.join(timeout=120)
        out, said = self._rust.communicate(timeout=120)
        assert out, said
        return json.loads(out)

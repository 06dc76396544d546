"""Servers that share a bucket, over S3's protocol as moto and s3s-fs implement it.

A proxy between the servers and the bucket adds latency, throttling, failures and outages. Needs a
server built with the feature `s3`, and s3s-fs (`make test-s3`).
"""

from __future__ import annotations

import http.client
import shutil
import socket
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import grpc
import numpy as np
import pytest

import hullcast
from hullcast._pb import contacts_pb2, hulls_pb2
from hullcast._serve import find_binary

moto_server = pytest.importorskip("moto.server")

BUCKET = "hulls"
CONTACT, INVALID = contacts_pb2.OUTCOME_CONTACT, contacts_pb2.OUTCOME_INVALID
UNKNOWN, UNAVAILABLE = contacts_pb2.FLAG_UNKNOWN_HULL, contacts_pb2.FLAG_HULL_UNAVAILABLE
ENVIRONMENT = {
    "AWS_ACCESS_KEY_ID": "x",
    "AWS_SECRET_ACCESS_KEY": "x",
    "AWS_REGION": "us-east-1",
    "AWS_ALLOW_HTTP": "true",
}


class Proxy(ThreadingHTTPServer):
    """A proxy before the bucket's server. `fault` may answer or cut a request; all are counted."""

    daemon_threads = True

    def __init__(self, upstream: int) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.upstream = upstream
        self.fault: Callable[[Handler], bool] = lambda _: False
        self.counts: Counter[tuple[str, str]] = Counter()
        self.lock = threading.Lock()

    def reset(self) -> None:
        self.fault = lambda _: False
        self.counts.clear()

    def handle_error(self, *_: object) -> None:
        """Ignores errors, because faults cut connections on purpose."""


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: Proxy

    def handle_any(self) -> None:
        body = self.rfile.read(int(self.headers.get("content-length", 0)))
        with self.server.lock:
            self.server.counts[self.command, self.path.split("?")[0]] += 1
        if self.server.fault(self):
            return
        upstream = http.client.HTTPConnection("127.0.0.1", self.server.upstream, timeout=30)
        upstream.request(self.command, self.path, body, dict(self.headers))
        answer = upstream.getresponse()
        content = answer.read()
        self.send_response(answer.status)
        for name, value in answer.getheaders():
            if name.lower() not in ("transfer-encoding", "connection", "content-length"):
                self.send_header(name, value)
        head = self.command == "HEAD"
        self.send_header(
            "content-length", answer.headers["content-length"] if head else str(len(content))
        )
        self.end_headers()
        self.wfile.write(content)

    do_GET = do_PUT = do_HEAD = do_DELETE = do_POST = handle_any

    def log_message(self, *_: object) -> None:
        """Logs nothing."""

    def answer(self, status: int, code: str) -> bool:
        """Responds with an error in S3's form."""
        body = b"" if self.command == "HEAD" else f"<Error><Code>{code}</Code></Error>".encode()
        self.send_response(status)
        self.send_header("content-type", "application/xml")
        self.send_header("content-length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)
        return True

    def cut(self) -> bool:
        """Cuts the connection without a response."""
        self.close_connection = True
        self.connection.shutdown(2)
        return True


# Every kind of outage of the store, except that it reports an object as missing.
OUTAGES: dict[str, Callable[[Handler], bool]] = {
    "cut": Handler.cut,
    "internal": lambda handler: handler.answer(500, "InternalError"),
    "throttled": lambda handler: handler.answer(503, "SlowDown"),
    "forbidden": lambda handler: handler.answer(403, "AccessDenied"),
    "no_bucket": lambda handler: handler.answer(404, "NoSuchBucket"),
    "not_s3": lambda handler: handler.answer(404, "a page of some other server"),
}


@contextmanager
def moto(_: Path) -> Iterator[int]:
    """moto in this process, with its data in memory. It checks no signatures."""
    server = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    _, port = server.get_host_and_port()
    made = http.client.HTTPConnection("127.0.0.1", port)
    made.request(
        "PUT",
        f"/{BUCKET}",
        headers={"authorization": "AWS4-HMAC-SHA256 Credential=x/1/us-east-1/s3/aws4_request"},
    )
    assert made.getresponse().status == 200
    try:
        yield port
    finally:
        server.stop()


@contextmanager
def s3s_fs(folder: Path) -> Iterator[int]:
    """s3s-fs in a process of its own, on a directory. It checks every signature."""
    binary = shutil.which("s3s-fs")
    if binary is None:
        pytest.skip("s3s-fs is not installed: make test-s3 does it")
    (folder / BUCKET).mkdir()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [binary, "--host", "127.0.0.1", "--port", str(port), str(folder)]
    command += ["--access-key", "x", "--secret-key", "x"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 60
        with socket.socket() as attempt:
            while attempt.connect_ex(("127.0.0.1", port)) != 0:
                assert process.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.05)
        yield port
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module", params=[moto, s3s_fs], ids=["moto", "s3s-fs"])
def proxy(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Proxy]:
    """A proxy before each of the two S3 servers."""
    with request.param(tmp_path_factory.mktemp("s3")) as port:
        proxy = Proxy(port)
        threading.Thread(target=proxy.serve_forever, daemon=True).start()
        yield proxy
        proxy.shutdown()


@pytest.fixture(autouse=True)
def healthy(proxy: Proxy) -> None:
    proxy.reset()


class Replica:
    """A server on the bucket, with plain gRPC calls: the client would register missing hulls."""

    def __init__(self, target: str) -> None:
        self.channel = grpc.insecure_channel(target, options=[("grpc.enable_http_proxy", 0)])

    def call(self, method: str, request, kind):
        path = f"/hullcast.v1.{method}"
        serialize = type(request).SerializeToString
        return self.channel.unary_unary(path, serialize, kind.FromString)(request, timeout=60)

    def register(self, clouds: list[np.ndarray]) -> list[bytes]:
        request = hulls_pb2.RegisterHullsRequest()
        for cloud in clouds:
            request.hulls.add(vertices=cloud.ravel())
        response = self.call("HullService/RegisterHulls", request, hulls_pb2.RegisterHullsResponse)
        return [result.hull.id for result in response.results]

    def query(self, ids: list[bytes]) -> contacts_pb2.QueryContactsResponse:
        """Queries each hull against itself at the origin."""
        bodies = range(len(ids))
        request = contacts_pb2.QueryContactsRequest(
            hull_ids=ids,
            body_hulls=bodies,
            positions=[0.0] * 3 * len(ids),
            rotations=[0.0, 0.0, 0.0, 1.0] * len(ids),
            pairs=[body for body in bodies for _ in "ab"],
        )
        kind = contacts_pb2.QueryContactsResponse
        return self.call("ContactService/QueryContacts", request, kind)

    def delete(self, ids: list[bytes]) -> list[bool]:
        request = hulls_pb2.DeleteHullsRequest(ids=ids)
        return list(
            self.call("HullService/DeleteHulls", request, hulls_pb2.DeleteHullsResponse).deleted
        )


@contextmanager
def replicas(proxy: Proxy, count: int, tmp_path: Path) -> Iterator[list[Replica]]:
    environment = ENVIRONMENT | {"AWS_ENDPOINT": f"http://127.0.0.1:{proxy.server_address[1]}"}
    store = f"s3://{BUCKET}/{tmp_path.name}"
    command = [find_binary(), "serve", "--listen", "127.0.0.1:0", "--store", store]
    command += ["--cache-age-seconds", "1", "--until-stdin-closes"]
    processes = []
    try:
        for _ in range(count):
            processes.append(
                subprocess.Popen(
                    command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL, text=True,
                )
            )  # fmt: skip
        yield [
            Replica(p.stdout.readline().strip().removeprefix("listening on ")) for p in processes
        ]
    finally:
        for process in processes:
            process.stdin.close()
            process.wait(timeout=60)


def clouds(count: int, seed: int) -> list[np.ndarray]:
    return list(np.random.default_rng(seed).normal(size=(count, 20, 3)))


def all_in_contact(answer: contacts_pb2.QueryContactsResponse, count: int) -> bool:
    return answer.outcomes == bytes([CONTACT]) * count


def test_replicas_share_the_bucket(proxy: Proxy, tmp_path: Path):
    """Replicas see each other's hulls, including replicas that start later.

    If one replica deletes a hull, the others stop using it within their cache age. A missing hull
    is not remembered as missing.
    """
    with replicas(proxy, 2, tmp_path) as (first, second):
        shapes = clouds(12, 1)
        expected = [hullcast.hull_id(shape) for shape in shapes]
        absent = second.query(expected)
        assert absent.outcomes == bytes([INVALID]) * 12
        assert absent.flags == bytes([UNKNOWN]) * 12
        assert first.register(shapes) == expected
        assert all_in_contact(second.query(expected), 12)
        assert first.delete(expected[:1]) == [True]
        deadline = time.monotonic() + 30
        while second.query(expected).flags[0] != UNKNOWN:
            assert time.monotonic() < deadline
            time.sleep(0.1)
        assert all_in_contact(second.query(expected[1:]), 11)
        second.register(shapes[:1])
    with replicas(proxy, 1, tmp_path) as (later,):
        assert all_in_contact(later.query(expected), 12)


class Slow:
    """A fault that delays every request, and measures how many are in flight at most."""

    def __init__(self, proxy: Proxy) -> None:
        self.proxy = proxy
        self.under_way = self.most = 0

    def __call__(self, _: Handler) -> bool:
        with self.proxy.lock:
            self.under_way += 1
            self.most = max(self.most, self.under_way)
        time.sleep(0.3)
        with self.proxy.lock:
            self.under_way -= 1
        return False


def test_a_hull_is_fetched_once_however_many_ask(proxy: Proxy, tmp_path: Path):
    """Under latency, missing hulls are fetched in parallel, at most 16 at a time.

    A hull that several requests need at the same time is fetched only once.
    """
    with replicas(proxy, 3, tmp_path) as (first, second, third):
        ids = first.register(clouds(48, 2))
        proxy.fault = slow = Slow(proxy)
        assert all_in_contact(third.query(ids), 48)
        assert 4 <= slow.most <= 16
        proxy.reset()
        proxy.fault = Slow(proxy)
        with ThreadPoolExecutor(8) as pool:
            answers = list(pool.map(lambda _: second.query(ids[:16]), range(8)))
        assert all(all_in_contact(answer, 16) for answer in answers)
        gets = {path: count for (method, path), count in proxy.counts.items() if method == "GET"}
        assert sorted(gets.values()) == [1] * 16


def test_passing_faults_are_not_seen(proxy: Proxy, tmp_path: Path):
    """Every third request is throttled, fails or is cut; all hulls are stored nevertheless."""
    with replicas(proxy, 2, tmp_path) as (first, second):
        faults = [OUTAGES["throttled"], OUTAGES["internal"], OUTAGES["cut"]]
        seen = Counter()

        def every_third(handler: Handler) -> bool:
            with proxy.lock:
                seen["requests"] += 1
                number = seen["requests"]
            if number % 3:
                return False
            seen["faults"] += 1
            return faults[number // 3 % 3](handler)

        proxy.fault = every_third
        ids = first.register(clouds(30, 3))
        assert len(set(ids)) == 30
        assert all_in_contact(second.query(ids), 30)
        assert seen["faults"] >= 20


@pytest.mark.parametrize("outage", OUTAGES)
def test_an_outage_is_no_unknown_hull(proxy: Proxy, tmp_path: Path, outage: str):
    """A store's outage is reported as such, not as an unknown hull.

    During the outage a replica uses its cached hulls within their cache age. After it, everything
    works again without a restart.
    """
    with replicas(proxy, 2, tmp_path) as (first, second):
        ids = first.register(clouds(3, 4))
        proxy.fault = OUTAGES[outage]
        answer = second.query(ids)
        assert answer.outcomes == bytes([INVALID]) * 3
        assert answer.flags == bytes([UNAVAILABLE]) * 3
        assert list(answer.missing_hulls) == [0, 1, 2]
        with pytest.raises(grpc.RpcError) as refused:
            second.register(clouds(1, 5))
        assert refused.value.code() == grpc.StatusCode.UNAVAILABLE
        assert "STORE_UNAVAILABLE" in refused.value.details()
        time.sleep(1.2)  # longer than the cache age: the cached hulls cannot be checked now
        assert first.query(ids).flags == bytes([UNAVAILABLE]) * 3
        proxy.fault = lambda _: False
        assert all_in_contact(second.query(ids), 3)
        assert all_in_contact(first.query(ids), 3)


def test_bytes_that_are_not_the_hull_are_not_answered_with(proxy: Proxy, tmp_path: Path):
    """The server checks bytes against the hull's id, and so notices a store that mixes objects."""
    with replicas(proxy, 2, tmp_path) as (first, second):
        ids = first.register(clouds(2, 6))
        paths = [f"/{BUCKET}/{tmp_path.name}/{i.hex()[:2]}/{i.hex()}" for i in ids]

        def mixed_up(handler: Handler) -> bool:
            if handler.command == "GET" and handler.path == paths[0]:
                handler.path = paths[1]
            return False

        proxy.fault = mixed_up
        answer = second.query(ids)
        assert list(answer.outcomes) == [INVALID, CONTACT]
        proxy.fault = lambda _: False
        assert all_in_contact(second.query(ids), 2)

"""Fixtures: a real server for the whole run, started as a user would start it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

import grpc
import pytest
from checks import Hulls

import hullcast
from hullcast._pb import hulls_pb2


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--no-skips", action="store_true", help="a skipped test fails the run")


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fails a run with --no-skips if a test was skipped, because its subject is then missing."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    skipped = [
        report
        for report in reporter.stats.get("skipped", [])
        if "only on demand" not in str(report.longrepr)
    ]
    if session.config.getoption("no_skips") and skipped and session.exitstatus == 0:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
        reporter.write_line(
            f"{len(skipped)} tests were skipped, which --no-skips forbids", red=True
        )


@pytest.fixture(scope="session")
def client() -> Iterator[hullcast.Client]:
    """A client of a server that is started for the tests."""
    with hullcast.serve() as client:
        yield client


@pytest.fixture(scope="session")
def channel(client: hullcast.Client) -> Iterator[grpc.Channel]:
    """A plain gRPC channel to the same server, for calls that the client does not offer."""
    with grpc.insecure_channel(client.target, options=[("grpc.enable_http_proxy", 0)]) as channel:
        yield channel


@pytest.fixture(scope="session")
def get_hulls(channel: grpc.Channel) -> Callable[[list[hullcast.Hull]], Hulls]:
    """A function that gets the faces of some hulls from the server."""
    call = channel.unary_unary(
        "/hullcast.v1.HullService/GetHulls",
        request_serializer=hulls_pb2.GetHullsRequest.SerializeToString,
        response_deserializer=hulls_pb2.GetHullsResponse.FromString,
    )

    def get(hulls: list[hullcast.Hull]) -> Hulls:
        request = hulls_pb2.GetHullsRequest(ids=[hull.id for hull in hulls])
        request.field_mask.paths.append("faces")
        faces = {}
        for record in call(request, timeout=60).hulls:
            ends = list(record.face_offsets)
            faces[record.id] = [
                list(record.face_vertices[start:stop]) for start, stop in itertools.pairwise(ends)
            ]
        return Hulls(faces)

    return get

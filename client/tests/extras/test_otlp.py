"""Traces from the caller through the server to a collector, over OTLP.

Needs a server built with the feature `otlp` (`make test-otlp`).
"""

from __future__ import annotations

import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from concurrent import futures
from contextlib import contextmanager

import grpc
import numpy as np
import pytest

import hullcast
from hullcast._serve import find_binary

sdk = pytest.importorskip("opentelemetry.sdk.trace")
service = pytest.importorskip("opentelemetry.proto.collector.trace.v1.trace_service_pb2")
spans_pb2 = pytest.importorskip("opentelemetry.proto.trace.v1.trace_pb2")

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
NO_PROXY = [("grpc.enable_http_proxy", 0)]
EXPORT = "opentelemetry.proto.collector.trace.v1.TraceService"


class Collector:
    """A collector that keeps every span exported to it."""

    def __init__(self) -> None:
        self.spans: list[spans_pb2.Span] = []
        self.services: set[str] = set()
        self._server = grpc.server(futures.ThreadPoolExecutor(2))
        handler = grpc.unary_unary_rpc_method_handler(
            self._export,
            service.ExportTraceServiceRequest.FromString,
            service.ExportTraceServiceResponse.SerializeToString,
        )
        handlers = grpc.method_handlers_generic_handler(EXPORT, {"Export": handler})
        self._server.add_generic_rpc_handlers((handlers,))
        self.port = self._server.add_insecure_port("127.0.0.1:0")
        self._server.start()

    def _export(self, request, _):
        for resource in request.resource_spans:
            about = {a.key: a.value.string_value for a in resource.resource.attributes}
            self.services.add(f"{about['service.name']} {about['service.version']}")
            self.spans += [span for scope in resource.scope_spans for span in scope.spans]
        return service.ExportTraceServiceResponse()

    def stop(self) -> None:
        self._server.stop(0).wait()


@pytest.fixture
def collector() -> Iterator[Collector]:
    collector = Collector()
    yield collector
    collector.stop()


@contextmanager
def serving(endpoint: str, *arguments: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    command = [find_binary(), "serve", "--listen", "127.0.0.1:0", "--store", "memory://"]
    command += ["--grace-seconds", "0", "--otlp-endpoint", endpoint, *arguments]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            yield line.strip().removeprefix("listening on "), process
        finally:
            process.kill()


def stopped(process: subprocess.Popen[str]) -> tuple[int, str, float]:
    """Stops a server; returns its exit code, its log and the seconds that it took to stop."""
    began = time.monotonic()
    process.send_signal(signal.SIGTERM)
    _, log = process.communicate(timeout=60)
    return process.returncode, log, time.monotonic() - began


def attributes(span: spans_pb2.Span) -> dict[str, object]:
    return {a.key: getattr(a.value, a.value.WhichOneof("value")) for a in span.attributes}


def scene(hulls: list[hullcast.Hull], bodies: int) -> hullcast.Scene:
    positions = np.arange(3.0 * bodies).reshape(-1, 3)
    return hullcast.Scene([hulls[0]] * bodies, positions, [[0, 0, 0, 1]] * bodies)


def test_a_call_is_a_child_of_its_caller(collector: Collector) -> None:
    """Catches a server span in the wrong trace, with a wrong parent or status, or without children.

    The children are the parts of the call that took its time. Also catches spans that are lost when
    the server stops, since it must send them at its end.
    """
    tracer = sdk.TracerProvider().get_tracer("test")
    with serving(f"http://127.0.0.1:{collector.port}") as (target, process):
        with hullcast.connect(target, options=NO_PROXY) as client:
            with tracer.start_as_current_span("registering") as registering:
                hulls = client.register([CUBE])
            with tracer.start_as_current_span("asking") as asking:
                client.query(scene(hulls, 100), [[i, i] for i in range(100)])
            with (
                tracer.start_as_current_span("asking wrongly") as wrong,
                pytest.raises(hullcast.InvalidArgument),
            ):
                client.query(scene(hulls, 2), [[0, 1]], margin=-1.0)
            client.register([CUBE])
        code, log, _ = stopped(process)
    assert code == 0, log
    assert collector.services == {f"hullcast {hullcast.__version__}"}
    spans = {span.span_id: span for span in collector.spans}
    calls = [span for span in collector.spans if span.kind == span.SPAN_KIND_SERVER]
    parents = {registering: "RegisterHulls", asking: "QueryContacts", wrong: "QueryContacts"}
    for caller, method in parents.items():
        about = caller.get_span_context()
        (call,) = [c for c in calls if c.parent_span_id == about.span_id.to_bytes(8, "big")]
        assert call.trace_id == about.trace_id.to_bytes(16, "big")
        assert call.name.endswith(f"/{method}")
        assert attributes(call)["rpc.method"] == method
        assert attributes(call)["rpc.grpc.status_code"] == (3 if caller is wrong else 0)
        assert call.status.code == call.status.STATUS_CODE_UNSET
        assert call.start_time_unix_nano < call.end_time_unix_nano
        within = {s.name: s for s in collector.spans if s.parent_span_id == call.span_id}
        assert within.keys() == ({"queue", "compute"} if caller is asking else set())
        if caller is asking:
            assert attributes(within["compute"])["pairs"] == 100
    # A call without a caller's trace begins a trace of its own.
    (alone,) = [call for call in calls if not call.parent_span_id]
    assert alone.name.endswith("/RegisterHulls")
    assert len({call.trace_id for call in calls}) == len(calls) == 4
    assert len(spans) == len(collector.spans) == 6


def test_the_caller_decides_what_is_traced(collector: Collector) -> None:
    """Catches the export of calls whose caller does not sample them.

    Also catches that `--otlp-share` is ignored for calls without a trace.
    """
    sampled = sdk.TracerProvider().get_tracer("test")
    dropped = sdk.TracerProvider(sampler=sdk.sampling.ALWAYS_OFF).get_tracer("test")
    endpoint = f"http://127.0.0.1:{collector.port}"
    with serving(endpoint, "--otlp-share", "0") as (target, process):
        with hullcast.connect(target, options=NO_PROXY) as client:
            client.register([CUBE])
            with dropped.start_as_current_span("not this one"):
                client.register([CUBE])
            with sampled.start_as_current_span("this one") as this:
                client.register([CUBE])
        assert stopped(process)[0] == 0
    (call,) = collector.spans
    assert call.parent_span_id == this.get_span_context().span_id.to_bytes(8, "big")


@pytest.mark.parametrize("silent", [False, True])
def test_a_collector_that_is_away_costs_nothing(silent: bool) -> None:
    """Catches calls or a stop that wait for a collector that is down or never responds."""
    with socket_of(silent) as port, serving(f"http://127.0.0.1:{port}") as (target, process):
        with hullcast.connect(target, options=NO_PROXY, timeout=30) as client:
            hulls = client.register([CUBE])
            # More spans than the server keeps.
            for _ in range(1000):
                client.query(scene(hulls, 2), [[0, 1]])
        code, log, seconds = stopped(process)
    assert code == 0, log
    # The default timeout of the exporters is already ten seconds.
    assert seconds < 9, log
    assert "traces were not sent" in log


@contextmanager
def socket_of(silent: bool) -> Iterator[int]:
    """A port without a working server: connections are refused, or accepted without a response."""
    import socket

    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
        if not silent:
            listener.close()
            yield port
            return
        listener.listen()
        kept = []
        threading.Thread(target=lambda: _accept(listener, kept), daemon=True).start()
        yield port
        # Closing the listener ends the thread.
        listener.close()


def _accept(listener, kept: list) -> None:
    try:
        while True:
            kept.append(listener.accept())
    except OSError:
        pass


def test_an_endpoint_that_is_none_is_refused() -> None:
    """Catches a malformed endpoint that is only noticed when traces are missing."""
    for arguments in (["http://host name:1"], ["http://h:1", "--otlp-share", "1.5"]):
        command = [find_binary(), "serve", "--store", "memory://", "--otlp-endpoint", *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert done.returncode == 1
        assert "otlp_" in done.stderr

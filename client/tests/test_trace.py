"""The caller's trace reaches the server, whose log contains it."""

from __future__ import annotations

import asyncio
import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import hullcast
from hullcast._serve import find_binary

trace = pytest.importorskip("opentelemetry.trace")
context = pytest.importorskip("opentelemetry.context")

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
NO_PROXY = [("grpc.enable_http_proxy", 0)]


@pytest.fixture
def logged(tmp_path: Path) -> Iterator[SimpleNamespace]:
    """A server that logs every call, and a function that ends it and returns its log."""
    command = [find_binary(), "serve", "--listen", "127.0.0.1:0", "--store", "memory://"]
    command += ["--log", "debug", "--log-format", "json", "--until-stdin-closes"]
    log = tmp_path / "log"
    with log.open("w") as errors:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True
        )
    assert process.stdout is not None

    def calls() -> dict[str, str | None]:
        process.communicate(timeout=60)
        lines = [json.loads(line) for line in log.read_text().splitlines()]
        ended = [line["span"] for line in lines if line["fields"].get("message") == "ended"]
        return {call["method"].rpartition("/")[2]: call.get("trace") for call in ended}

    target = process.stdout.readline().strip().removeprefix("listening on ")
    yield SimpleNamespace(target=target, calls=calls)
    process.communicate(timeout=60)


class Within:
    """Puts calls into a remote parent's span, without OpenTelemetry's SDK."""

    def __init__(self, trace_id: int) -> None:
        parent = trace.SpanContext(trace_id, 0xABC, True, trace.TraceFlags(1))
        self._context = trace.set_span_in_context(trace.NonRecordingSpan(parent))

    def __enter__(self) -> None:
        self._token = context.attach(self._context)

    def __exit__(self, *_: object) -> None:
        context.detach(self._token)


def _scene(hulls: list[hullcast.Hull]) -> hullcast.Scene:
    return hullcast.Scene([hulls[0]] * 2, [[0, 0, 0], [0.9, 0, 0]], [[0, 0, 0, 1]] * 2)


def test_each_kind_of_call_is_of_the_callers_trace(logged: SimpleNamespace) -> None:
    """Catches a call without the caller's trace or with an invented one.

    Also catches a call with the trace of the first call, or of the caller who connected.
    """
    with Within(1), hullcast.connect(logged.target, options=NO_PROXY) as client:
        with Within(2):
            scene = _scene(client.register([CUBE]))
        with Within(3):
            client.query(scene, [[0, 1]])
        with Within(4):
            client.find(scene)
        with Within(5), client.session(scene, [[0, 1]]) as session:
            session.step(scene.positions, scene.rotations)
    # Before the first call, the client asks whether a server is there.
    expected = {
        "GetServerInfo": 2,
        "RegisterHulls": 2,
        "QueryContacts": 3,
        "FindContacts": 4,
        "StreamContacts": 5,
    }
    assert logged.calls() == {name: f"{trace:032x}" for name, trace in expected.items()}


def test_tasks_keep_their_traces_apart(logged: SimpleNamespace) -> None:
    """Catches a call with another task's trace, or with a trace although its task has none."""

    async def run() -> None:
        async with hullcast.aio.connect(logged.target, options=NO_PROXY) as client:

            async def register() -> list[hullcast.Hull]:
                with Within(6):
                    return await client.register([CUBE])

            async def query() -> None:
                scene = _scene(await asyncio.create_task(register()))
                await client.query(scene, [[0, 1]])

            await query()

    asyncio.run(run())
    trace = f"{6:032x}"
    expected = {"GetServerInfo": trace, "RegisterHulls": trace, "QueryContacts": None}
    assert logged.calls() == expected

"""Records of calls whose answers depend on earlier messages, on the caller, or on the choice of the calls."""

from __future__ import annotations

import contextlib
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import grpc
import numpy as np
import pytest
from crowds import NO_PROXY, Server, crowd

import hullcast
from hullcast._pb import contacts_pb2
from hullcast._serve import find_binary


@contextlib.contextmanager
def recording(folder: Path, *choice: str) -> Iterator[hullcast.Client]:
    """A client of a server that writes records into `folder`. The server stops in order at the end."""
    with Server("memory://", "--record", str(folder), *choice) as server:
        with hullcast.connect(server.address, options=NO_PROXY) as client:
            yield client
        server.process.send_signal(signal.SIGTERM)
        assert server.process.wait(60) == 0


def replay(folder: Path) -> tuple[int, int, int]:
    """Exit code, calls and compared messages of a replay, by a server of another number of threads."""
    command = [find_binary(), "replay", str(folder), "--threads", "1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    counts = re.match(r"(\d+) calls?, (\d+) messages? of their answers compared", done.stdout)
    assert counts, done.stdout + done.stderr
    assert done.returncode == 0, done.stderr
    return done.returncode, int(counts[1]), int(counts[2])


def steps(scene: hullcast.Scene, session: hullcast.Session, count: int, seed: int) -> None:
    """Steps of a session in which a third of the bodies move, and none in every fifth step."""
    rng = np.random.default_rng(seed)
    positions = np.array(scene.positions)
    for number in range(count):
        moved = rng.random(len(positions)) < (0 if number % 5 == 4 else 1 / 3)
        positions[moved] += rng.normal(0, 0.05, (moved.sum(), 3))
        session.step(positions, scene.rotations)


def test_find_and_sessions_are_reproduced(tmp_path: Path) -> None:
    """Catches a stream that is replayed without the messages before, and an answer of several messages
    of which only one is compared: each step depends on the steps before it."""
    with recording(tmp_path / "records", "--record-share", "1") as client:
        scene = crowd(client, 150)
        found = client.find(scene, margin=0.1)
        assert len(found.outcome) > 100
        with client.session(
            scene, find=True, margin=0.1, outputs=["ALPHA", "POINTS", "MATCHES"]
        ) as session:
            steps(scene, session, 40, 1)
        pairs = np.random.default_rng(2).integers(150, size=(500, 2))
        with client.session(scene, pairs, margin=0.1) as session:
            steps(scene, session, 40, 2)
    _, calls, messages = replay(tmp_path / "records")
    # One registration, one search and two streams of forty steps.
    assert calls >= 4
    assert messages >= 82


def test_a_stream_whose_caller_leaves_is_compared_as_far_as_it_went(tmp_path: Path) -> None:
    """Catches a cut stream that is lost, or that differs because its last step was never answered."""
    with recording(tmp_path / "records", "--record-share", "1") as client:
        scene = crowd(client, 60)
        with hullcast.connect(client.target, options=NO_PROXY) as other:
            session = other.session(scene, find=True)
            steps(scene, session, 10, 3)
            # The channel closes while the stream is open.
    _, calls, messages = replay(tmp_path / "records")
    assert calls >= 2
    assert messages >= 11


def test_a_long_stream_is_cut_at_the_limit_of_its_request(tmp_path: Path) -> None:
    """Catches a stream beyond 16 MiB that is not recorded at all, and one that is cut within a message."""
    with recording(tmp_path / "records", "--record-share", "1") as client:
        scene = crowd(client, 4000)
        rng = np.random.default_rng(4)
        with client.session(scene, np.arange(4000).reshape(-1, 2)) as session:
            for _ in range(100):
                session.step(scene.positions + rng.normal(0, 1e-3, (4000, 3)), scene.rotations)
    _, calls, messages = replay(tmp_path / "records")
    # 16 MiB are 74.9 times 4,000 poses.
    assert calls >= 2
    assert 70 < messages < 77


@pytest.mark.parametrize("choice", ["failed", "slow", "flagged", "none"])
def test_calls_are_recorded_by_choice(tmp_path: Path, choice: str) -> None:
    """Catches a choice that records other calls, or none."""
    arguments = {
        "failed": ["--record-failed"],
        # No call takes less than this.
        "slow": ["--record-slow-seconds", "1e-9"],
        "flagged": ["--record-flagged"],
        "none": [],
    }[choice]
    with recording(tmp_path / "records", "--record-share", "0", *arguments) as client:
        scene = crowd(client, 40)
        pairs = np.random.default_rng(5).integers(40, size=(100, 2))
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        # Without points there is nothing to estimate.
        plain = client.query(scene, pairs, outputs=["ALPHA"])
        assert not plain.flags.any()
        # At any distance some features face past each other, and their points are estimates.
        apart = client.query(scene, pairs, margin=np.inf)
        assert (apart.flags & hullcast.Flag.ESTIMATED).any()
        with grpc.insecure_channel(client.target, options=NO_PROXY) as channel:
            call = channel.unary_unary("/hullcast.v1.ContactService/QueryContacts")
            with pytest.raises(grpc.RpcError, match="margin"):
                call(contacts_pb2.QueryContactsRequest(margin=-1.0).SerializeToString())
    files = list((tmp_path / "records").glob("*.hullrec"))
    if choice == "none":
        assert files == []
        return
    _, calls, _ = replay(tmp_path / "records")
    assert calls == {"failed": 1, "slow": 4, "flagged": 1}[choice]

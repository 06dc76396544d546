"""Servers are replaced under load, and no call may fail."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from pathlib import Path

import numpy as np
from crowds import NO_PROXY, Server, crowd

import hullcast

RESTARTS = int(os.environ.get("HULLCAST_RESTARTS", "6"))


def _restart(server: Server) -> None:
    """Restarts a server as a supervisor does: stops it, waits, and starts it again."""
    server.process.send_signal(signal.SIGTERM)
    server.process.wait(60)
    assert server.process.returncode == 0
    for pipe in (server.process.stdin, server.process.stdout):
        assert pipe is not None
        pipe.close()
    server.start()


def test_rolling_restarts_fail_no_call(tmp_path: Path) -> None:
    """Catches a draining server that refuses a call, cuts one off, or answers it wrongly.

    Two servers with one store are restarted in turn, while four threads query and one steps a
    session. Connections are also closed for their age after 0.5 s.
    """
    arguments = ("--grace-seconds", "0.3", "--drain-seconds", "20")
    arguments += ("--max-connection-age-seconds", "0.5")
    with contextlib.ExitStack() as stack:
        first, second = (stack.enter_context(Server(tmp_path, *arguments)) for _ in range(2))
        addresses = [first.address, second.address]
        with hullcast.connect(addresses, options=NO_PROXY) as client:
            scene = crowd(client, 100)
            pairs = np.random.default_rng(5).integers(100, size=(300, 2))
            expected = client.query(scene, pairs, margin=0.1)
            done = threading.Event()
            errors: list[BaseException] = []
            counts = [0] * 5

            def work(place: int) -> None:
                try:
                    if place == 4:
                        with client.session(scene, pairs, margin=0.1) as session:
                            while not done.is_set():
                                found = session.step(scene.positions, scene.rotations)
                                assert (found.outcome == expected.outcome).all()
                                counts[place] += 1
                    while not done.is_set():
                        expect_some(client.query(scene, pairs, margin=0.1))
                        counts[place] += 1
                except BaseException as error:
                    errors.append(error)

            def expect_some(found: hullcast.Manifolds) -> None:
                assert found.alpha.tobytes() == expected.alpha.tobytes()
                assert found.outcome.tobytes() == expected.outcome.tobytes()

            threads = [threading.Thread(target=work, args=(place,)) for place in range(5)]
            for thread in threads:
                thread.start()
            try:
                for _ in range(RESTARTS // 2):
                    for server in (first, second):
                        before = sum(counts)
                        _restart(server)
                        # The restart only tested something if calls were answered during it.
                        assert errors or sum(counts) > before
            finally:
                done.set()
                for thread in threads:
                    thread.join(90)
            assert not errors, errors
            assert min(counts) >= RESTARTS
            expect_some(client.query(scene, pairs, margin=0.1))
    print(f"{RESTARTS} restarts, {sum(counts)} calls, none failed")

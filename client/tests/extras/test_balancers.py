"""Three replicas with a shared store, behind HAProxy, nginx and the clients' own round robin.

Under load, a replica is killed, restarted, drained and cut off, and no query may fail. The tests
use deploy/haproxy.cfg and deploy/nginx.conf. They need haproxy and nginx (`apt-get install haproxy
nginx-light`), and root to cut the network.
"""

from __future__ import annotations

import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from crowds import CUBE, NO_PROXY, crowd_of
from replicas import WAYS, Load, Replica, cables, replicas

import hullcast
from hullcast._serve import find_binary


@pytest.mark.parametrize("way", WAYS)
def test_no_query_fails_while_replicas_come_and_go(way: str, tmp_path: Path):
    """Stops and restarts replicas under load, and no call of a client fails.

    One replica is killed (SIGKILL) and restarted. Another is drained (SIGTERM) and restarted.
    Behind HAProxy, which has health checks, a third is frozen without closing its connections
    (SIGSTOP). Every acknowledged hull is in the store, and at the end all three replicas share the
    load evenly.
    """
    with replicas(tmp_path / "store") as all_three, WAYS[way](all_three, tmp_path) as target:
        first, second, third = all_three
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
            if way == "haproxy":
                third.stop(signal.SIGSTOP)
                load.more("a third hangs")
                third.stop(signal.SIGCONT)
                load.more("it goes on")
            shares = expect_even(load, all_three)
        finally:
            third.stop(signal.SIGCONT)
            rust = load.stop()
        faults = "killed, back, drained, back" + (", hung, back" if way == "haproxy" else "")
        report(way, faults, expect_nothing_lost(load, rust, all_three), shares)


@pytest.mark.parametrize("way", WAYS)
def test_no_query_fails_while_a_replica_is_cut_off(way: str, tmp_path: Path):
    """Cuts a replica off from the network under load, and no call of a client fails.

    Each replica is in a network of its own. While one is cut off, calls in flight there get neither
    a response nor an error. The network is restored later. No acknowledged hull is lost, and the
    replica gets its share of the load again.
    """
    with (
        cables(3) as ends,
        replicas(tmp_path / "store", ends) as all_three,
        WAYS[way](all_three, tmp_path) as target,
    ):
        load = Load(target)
        try:
            load.more("at first")
            ends[1].cut()
            time.sleep(35)  # longer than the balancer or the client needs to notice
            load.more("one is cut off", 600)
            ends[1].mend()
            load.more("it is back")
            shares = expect_even(load, all_three)
        finally:
            rust = load.stop()
        assert way != "round_robin" or rust["lost"] >= 1
        report(way, "cut off, back", expect_nothing_lost(load, rust, all_three), shares)


@pytest.mark.parametrize("way", WAYS)
def test_large_messages_and_long_silence_pass(way: str, tmp_path: Path):
    """Messages of tens of megabytes pass in both directions, which balancers refuse by default.

    A stream also survives a pause that is longer than the timeout of a call.
    """
    rng = np.random.default_rng(1)
    count = 120_000
    with (
        replicas(tmp_path / "store") as all_three,
        WAYS[way](all_three, tmp_path) as target,
        hullcast.connect(target, options=NO_PROXY) as client,
    ):
        scene = crowd_of(client.register([CUBE]), count, rng)
        pairs = np.stack([np.arange(count), (np.arange(count) + 1) % count], axis=1)
        expected = client.query(scene, pairs, margin=0.1)
        client.pairs_per_message = count
        found = client.query(scene, pairs, margin=0.1)
        assert found.alpha.tobytes() == expected.alpha.tobytes()
        assert found.witness_a.tobytes() == expected.witness_a.tobytes()
        small = crowd_of(client.register([CUBE]), 10, rng)
        with client.session(small, pairs[:9]) as session:
            before = session.step(small.positions, small.rotations)
            stream = session._lanes[0].stream
            time.sleep(28)
            after = session.step(small.positions, small.rotations)
            assert after.outcome.tobytes() == before.outcome.tobytes()
            assert session._lanes[0].stream is stream, "the session has replaced its stream"


@pytest.mark.parametrize("way", ["haproxy", "nginx"])
def test_no_replica_at_all_is_unavailable(way: str, tmp_path: Path):
    """Without any replica, both clients get Unavailable as a gRPC status.

    A balancer's own error page is HTML. Some clients take it for a malformed response and do not
    retry.
    """
    with replicas(tmp_path / "store") as all_three, WAYS[way](all_three, tmp_path) as target:
        for replica in all_three:
            replica.stop(signal.SIGKILL)
        with (
            hullcast.connect(target, options=NO_PROXY) as client,
            pytest.raises(hullcast.Unavailable, match="no replica answers"),
        ):
            client.register([CUBE])
        command = [find_binary(), "load", "--remote", target, "--pairs", "10"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 4
        assert "Unavailable: no replica answers" in done.stderr


def expect_even(load: Load, all_three: list[Replica]) -> list[int]:
    """Asserts that the replicas answer equally many pairs, within a fifth of their mean.

    The counts begin 30 s after the last fault, and are the replicas' own. Both balancers send more
    calls to a replica that answers faster, and on a busy machine the three processes may differ in
    speed for a while. Therefore counting continues until the counts are even, up to six times as
    long.
    """
    time.sleep(30)
    before = [replica.pairs() for replica in all_three]
    for _ in range(6):
        load.more("even load", 1000)
        done = [replica.pairs() - b for replica, b in zip(all_three, before, strict=True)]
        mean = sum(done) / 3
        if max(abs(pairs - mean) for pairs in done) <= 0.2 * mean:
            break
    assert mean >= 64 * 500
    assert max(abs(pairs - mean) for pairs in done) <= 0.2 * mean, done
    return done


def expect_nothing_lost(load: Load, rust: dict, all_three: list[Replica]) -> str:
    """Asserts that no query of either client failed and no hull was lost; returns the counts."""
    assert load.failures == []
    assert rust["errors"] == {}
    assert rust["wrong_batches"] == 0
    assert rust["batches"] == rust["sent"] >= 500
    assert rust["checked_batches"] >= 100
    for replica in all_three:
        assert replica.has(load.acknowledged) == [True] * len(load.acknowledged)
    assert len(load.acknowledged) >= 100
    return (
        f"{load.counts['queries']} queries, {len(load.acknowledged)} hulls from Python, "
        f"{rust['batches']} batches from Rust ({rust['lost']} sent again)"
    )


def report(way: str, faults: str, counts: str, shares: list[int]) -> None:
    """Prints a row of the table in docs/cluster.md; run with `-s` to see it."""
    percent = ", ".join(f"{share / sum(shares):.1%}" for share in shares)
    print(f"\n{way}, {faults}: {counts}; 0 failed, 0 lost; pairs at the end {percent}")

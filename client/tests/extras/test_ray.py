"""Clients and scenes given to ray's tasks and actors."""

from __future__ import annotations

import pytest
from crowds import crowd

import hullcast

ray = pytest.importorskip("ray")


def test_tasks_and_actors(client, monkeypatch):
    """Each worker connects by itself and answers as this process does."""
    scene, pairs = crowd(client, 50), [[i, (i * 7) % 50] for i in range(50)]

    def ask(client: hullcast.Client, scene: hullcast.Scene) -> bytes:
        return client.query(scene, pairs, margin=0.1).alpha.tobytes()

    class Worker:
        def __init__(self, client: hullcast.Client) -> None:
            self.client = client

        def ask(self, scene: hullcast.Scene) -> bytes:
            return ask(self.client, scene)

    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")  # else it writes into the home folder
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, _node_ip_address="127.0.0.1")
    try:
        worker = ray.remote(Worker).remote(client)
        asked = [ray.remote(ask).remote(client, scene), worker.ask.remote(scene)]
        assert ray.get(asked, timeout=60) == [ask(client, scene)] * 2
    finally:
        ray.shutdown()

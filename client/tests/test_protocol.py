"""The protocol's page, and clients with another version of the protocol than the server's."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import grpc
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

import hullcast
from hullcast._pb import contacts_pb2

ROOT = Path(__file__).resolve().parents[2]
CASES = json.loads((ROOT / "tests/golden/contacts.json").read_text())["cases"]


def test_the_page_is_what_the_comments_say(tmp_path: Path):
    """Catches a change of proto/ without `make protocol`."""
    pytest.importorskip("grpc_tools")
    written = tmp_path / "protocol.md"
    subprocess.run([sys.executable, ROOT / "scripts/protocol-docs", written], check=True)
    assert written.read_text() == (ROOT / "docs/protocol.md").read_text()


class Contract:
    """The messages and calls of a descriptor set, which may be of another version."""

    def __init__(self, path: Path, channel: grpc.Channel) -> None:
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(path.read_bytes()).file:
            pool.Add(file)
        self.pool, self.channel = pool, channel

    def message(self, name: str):
        descriptor = self.pool.FindMessageTypeByName(f"hullcast.v1.{name}")
        return message_factory.GetMessageClass(descriptor)

    def call(self, service: str, method: str):
        kind = (
            self.channel.stream_stream if method.startswith("Stream") else self.channel.unary_unary
        )
        described = self.pool.FindServiceByName(f"hullcast.v1.{service}").methods_by_name[method]
        return kind(
            f"/hullcast.v1.{service}/{method}",
            request_serializer=self.message(described.input_type.name).SerializeToString,
            response_deserializer=self.message(described.output_type.name).FromString,
        )


@pytest.fixture
def first(channel: grpc.Channel) -> Contract:
    """The protocol as it was first committed, with a choice of precision."""
    return Contract(ROOT / "tests/golden/first_contract.binpb", channel)


def scene(contract: Contract, case: dict, ids: list[bytes]):
    """A request for the case's pair, as a message of a protocol version."""
    distinct = list(dict.fromkeys(ids))
    return contract.message("QueryContactsRequest")(
        hull_ids=distinct,
        body_hulls=[distinct.index(i) for i in ids],
        positions=[*case["a"]["position"], *case["b"]["position"]],
        rotations=[*case["a"]["rotation"], *case["b"]["rotation"]],
        pairs=[0, 1],
        margin=float("inf") if case["margin"] is None else case["margin"],
    )


def test_a_client_of_the_first_contract_is_answered(first: Contract):
    """Catches a server that no longer understands an older client, or the reverse.

    For example a field was renumbered, a default changed its meaning, or a removed value is
    refused.
    """
    assert "precision" in first.message("Accuracy").DESCRIPTOR.fields_by_name
    register = first.call("HullService", "RegisterHulls")
    query = first.call("ContactService", "QueryContacts")
    stream = first.call("ContactService", "StreamContacts")
    requests, answers = [], []
    for number, case in enumerate(CASES):
        request = first.message("RegisterHullsRequest")()
        for side in (case["a"], case["b"]):
            vertices = [c for vertex in side["vertices"] for c in vertex]
            request.hulls.add(vertices=vertices, contraction_point=side["contraction_point"])
        ids = [result.hull.id for result in register(request, timeout=60).results]
        requests.append(scene(first, case, ids))
        requests[-1].request_id = number
        # This field has been removed since.
        requests[-1].accuracy.precision = number % 2
        answers.append(query(requests[-1], timeout=60))
        outcomes = first.pool.FindEnumTypeByName("hullcast.v1.Outcome").values_by_number
        outcome = outcomes[answers[-1].outcomes[0]].name
        assert outcome == f"OUTCOME_{case['outcome']}"
        assert answers[-1].alpha_lowers[0] <= case["alpha_below"]
        assert answers[-1].alpha_uppers[0] >= case["alpha_above"]
        assert len(answers[-1].distances) == answers[-1].point_counts[0]
        if case["outcome"] == "CONTACT":
            assert abs(answers[-1].alphas[0] - case["alpha_below"]) <= 2 * case["alpha_budget"]
            assert answers[-1].point_counts[0] >= 1
    assert list(stream(iter(requests), timeout=60)) == answers
    assert len(answers) >= 39


def test_a_newer_client_is_answered(client: hullcast.Client, channel: grpc.Channel):
    """Catches a server that refuses a field or an output of a later version."""
    case = CASES[0]
    sides = [case["a"], case["b"]]
    points = [side["contraction_point"] for side in sides]
    hulls = client.register([side["vertices"] for side in sides], contraction_points=points)
    present = Contract(ROOT / "proto/hullcast.v1.binpb", channel)
    query = present.call("ContactService", "QueryContacts")
    request = scene(present, case, [hull.id for hull in hulls])
    known = query(request, timeout=60)
    # The message has the unknown field 1000 (a varint), and outputs with the default columns and an
    # unknown one.
    unknown = bytes([0xC0, 0x3E, 0x01])
    newer = present.message("QueryContactsRequest").FromString(
        request.SerializeToString() + unknown
    )
    newer.outputs.extend([contacts_pb2.OUTPUT_ALPHA, contacts_pb2.OUTPUT_NORMAL])
    newer.outputs.extend([contacts_pb2.OUTPUT_POINTS, 100])
    assert unknown in newer.SerializeToString()
    assert query(newer, timeout=60) == known

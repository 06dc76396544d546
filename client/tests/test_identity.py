"""A hull's id: the documented bytes, and the server's id."""

from __future__ import annotations

import hashlib
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from shapes import FAMILIES, family

import hullcast

TETRAHEDRON = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def by_hand(version: int, options: bytes) -> bytes:
    """The hash of the documented byte string for the tetrahedron."""
    numbers = struct.pack("<12d", *(c for point in TETRAHEDRON for c in point))
    head = b"hullcast" + struct.pack("<I", version)
    return hashlib.sha256(head + options + b"\4\0\0\0" + numbers).digest()


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, b"\0\0"),
        (
            {"contraction_point": (0.25, 0.25, 0.25)},
            b"\1" + struct.pack("<3d", 0.25, 0.25, 0.25) + b"\0",
        ),
        ({"max_vertices": 16}, b"\0\1\1\x10\0\0\0\0"),
        ({"max_deviation": 0.5}, b"\0\1\0\1" + struct.pack("<d", 0.5)),
        ({"max_deviation": -0.0}, b"\0\1\0\1" + struct.pack("<d", 0.0)),
    ],
)
def test_the_bytes_are_the_documented_ones(options, expected):
    """The bytes are version, contraction point, simplification, planarity and points."""
    assert hullcast.hull_id(TETRAHEDRON, **options, planarity=None) == by_hand(1, expected)
    for planarity in (0.0, -0.0, 1e-4):
        two = by_hand(2, expected + struct.pack("<d", planarity + 0.0))
        assert hullcast.hull_id(TETRAHEDRON, **options, planarity=planarity) == two
    default = by_hand(2, expected + struct.pack("<d", hullcast.DEFAULT_PLANARITY))
    assert hullcast.hull_id(TETRAHEDRON, **options) == default


def test_the_vectors_of_the_page(client: hullcast.Client):
    """Catches an id, of the client or the server, that differs from the documented one."""
    page = (Path(__file__).parents[2] / "docs/identity.md").read_text(encoding="utf-8")
    vectors = json.loads(page.split("```json\n")[1].split("```")[0])
    assert len(vectors) == 8
    for vector in vectors:
        points = np.array(vector["vertices"]).reshape(-1, 3)
        options = {key: vector.get(key) for key in ("max_vertices", "max_deviation", "planarity")}
        centre = vector.get("contraction_point")
        assert hullcast.hull_id(points, centre, **options).hex() == vector["id"], vector["name"]
        hull = client.register([points], contraction_points=[centre], **options)[0]
        assert hull.id.hex() == vector["id"], vector["name"]


def test_planarities(client: hullcast.Client):
    """Catches a planarity that is not sent, not returned, or lost when registered again."""
    sent = {"default": hullcast.DEFAULT_PLANARITY, None: None, 0: 0.0, 0.01: 0.01}
    hulls = {}
    for planarity, share in sent.items():
        hull = hulls[planarity] = client.register([TETRAHEDRON], planarity=planarity)[0]
        assert hull.id == hullcast.hull_id(TETRAHEDRON, planarity=planarity)
        assert hull.planarity == (1e-6 if share is None else share)
        # A hull keeps its planarity when it is registered again, unless another is given.
        assert client.register([hull])[0] == hull
        assert client.register([hull], planarity=planarity)[0] == hull
        assert client.register([hull], planarity=1e-5)[0].planarity == 1e-5
        # It also keeps its planarity with another option.
        simpler = client.register([hull], max_vertices=4)[0]
        expected = hullcast.hull_id(TETRAHEDRON, max_vertices=4, planarity=share)
        assert simpler.id == expected
    assert len({hull.id for hull in hulls.values()}) == len(sent)
    for wrong in (-1e-9, 0.011, np.inf, np.nan):
        with pytest.raises(hullcast.HullRejected, match="PLANARITY_OUT_OF_RANGE") as refused:
            client.register([TETRAHEDRON], planarity=wrong)
        assert refused.value.field == "planarity"
    with pytest.raises(hullcast.InvalidArgument, match="planarity"):
        client.register([TETRAHEDRON], planarity="coarse")


def test_negative_zero_is_zero_and_order_counts():
    """-0.0 equals 0.0, so the hull is the same. Another order of points is another hull."""
    negated = -np.abs(np.array(TETRAHEDRON))
    negated[negated != 0] *= -1
    assert np.signbit(negated).any()
    assert hullcast.hull_id(negated) == hullcast.hull_id(TETRAHEDRON)
    assert hullcast.hull_id(TETRAHEDRON[::-1]) != hullcast.hull_id(TETRAHEDRON)


def test_the_server_gives_the_same(client: hullcast.Client):
    """The client computes the same id as the server, so it knows the id without a call."""
    rng = np.random.default_rng(5)
    shapes = [shape for name in FAMILIES for shape in family(name, 2, rng)]
    points = [shape.vertices for shape in shapes]
    points.append(-0.0 * points[0] + points[0])
    centres = [None] * len(points)
    centres[1] = [0.01, -0.0, 0.02]
    hulls = client.register(points, contraction_points=centres)
    for hull, vertices, centre in zip(hulls, points, centres, strict=True):
        assert hull.id == hullcast.hull_id(vertices, centre)


def test_simplified_hulls(client: hullcast.Client):
    """Simplified hulls have the right ids and keep the limits; impossible limits are refused."""
    points = np.random.default_rng(6).normal(size=(150, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    for options in (
        {"max_vertices": 24},
        {"max_deviation": 0.1},
        {"max_vertices": 90, "max_deviation": 0.2},
    ):
        hull = client.register([points], **options)[0]
        assert hull.id == hullcast.hull_id(points, **options)
        assert hull.vertex_count <= options.get("max_vertices", 150)
        assert 0 < hull.deviation <= options.get("max_deviation", 1)
        # The contraction point is unchanged, so fewer vertices give a smaller inradius.
        assert hull.inradius < client.register([points])[0].inradius
        # Registering the hull object again keeps its options.
        assert client.register([hull])[0] == hull
    with pytest.raises(hullcast.HullRejected, match="SIMPLIFICATION_NOT_POSSIBLE"):
        client.register([points], max_vertices=4, max_deviation=1e-3)

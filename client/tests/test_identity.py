"""A hull's identity: the documented bytes, and the server's own answer."""

from __future__ import annotations

import hashlib
import struct

import numpy as np
import pytest
from shapes import FAMILIES, family

import hullcast

TETRAHEDRON = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def by_hand(options: bytes) -> bytes:
    """The documented byte string of the tetrahedron, hashed."""
    numbers = struct.pack("<12d", *(c for point in TETRAHEDRON for c in point))
    return hashlib.sha256(b"hullcast\1\0\0\0" + options + b"\4\0\0\0" + numbers).digest()


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
    """Version, contraction point, simplification, points."""
    assert hullcast.hull_id(TETRAHEDRON, **options) == by_hand(expected)


def test_negative_zero_is_zero_and_order_counts():
    """-0.0 is the same number, hence the same hull; another order is another registration."""
    negated = -np.abs(np.array(TETRAHEDRON))
    negated[negated != 0] *= -1
    assert np.signbit(negated).any()
    assert hullcast.hull_id(negated) == hullcast.hull_id(TETRAHEDRON)
    assert hullcast.hull_id(TETRAHEDRON[::-1]) != hullcast.hull_id(TETRAHEDRON)


def test_the_server_gives_the_same(client: hullcast.Client):
    """So that a client knows a hull's id without asking."""
    rng = np.random.default_rng(5)
    shapes = [shape for name in FAMILIES for shape in family(name, 2, rng)]
    points = [shape.vertices for shape in shapes]
    points.append(-0.0 * points[0] + points[0])
    centers = [None] * len(points)
    centers[1] = [0.01, -0.0, 0.02]
    hulls = client.register(points, contraction_points=centers)
    for hull, vertices, center in zip(hulls, points, centers, strict=True):
        assert hull.id == hullcast.hull_id(vertices, center)


def test_simplified_hulls(client: hullcast.Client):
    """Ids, limits kept, a bound that a point left out does not pass; named where it cannot be."""
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
        # About the same centre: no point was nearer to it than this.
        assert hull.inradius < client.register([points])[0].inradius
        # Registered again as it was, by itself.
        assert client.register([hull])[0] == hull
    with pytest.raises(hullcast.HullRejected, match="SIMPLIFICATION_NOT_POSSIBLE"):
        client.register([points], max_vertices=4, max_deviation=1e-3)

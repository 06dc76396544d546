"""Resting faces: the patch against the exact intersection of the two polygons."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from cases import Case, ask, matrix, resting_case
from shapes import FAMILIES, family

import hullcast
from hullcast import FeatureKind, Flag

OUTPUTS = ("ALPHA", "NORMAL", "POINTS", "FEATURES")


def plane_of(normal: np.ndarray) -> np.ndarray:
    """(3, 2): two unit vectors perpendicular to a normal."""
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(normal, across)], axis=1)


def polygon(case: Case, side: int, face: list[int], plane: np.ndarray) -> shapely.Polygon:
    """A face's outline as seen along the normal, relative to A's position."""
    corners = case.shapes[side].vertices[face] @ matrix(case.rotations[side]).T
    corners += case.positions[side] - case.positions[0]
    return shapely.Polygon(corners @ plane)


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("tilt", [0.0, 1e-6, 0.008])
def test_the_patch_is_the_exact_intersection(client, get_hulls, name, tilt):
    """The patch equals the exact intersection of the faces, to a Hausdorff distance of 1e-9 R.

    Tilts stay below the feature angle, within which the whole patch is computed.
    """
    rng = np.random.default_rng([21, FAMILIES.index(name)])
    shapes = family(name, 6, rng)
    # Without a planarity, no two faces of these shapes are merged.
    hulls = client.register([shape.vertices for shape in shapes], planarity=None)
    faces = get_hulls(hulls)
    cases = [resting_case(rng, shapes, hulls, tilt) for _ in range(60)]
    m = ask(client, cases, margin=0.02, outputs=OUTPUTS)
    met = laid = 0
    for case, pair in zip(cases, m, strict=True):
        assert case.faces is not None
        if pair.feature_kinds != (FeatureKind.FACE, FeatureKind.FACE):
            continue
        named = [
            faces.face(hull, pair.feature_indices[2 * side]) for side, hull in enumerate(case.hulls)
        ]
        laid += all(set(a) == set(b) for a, b in zip(named, case.faces, strict=True))
        plane = plane_of(pair.normal)
        exact = shapely.intersection(*(polygon(case, i, named[i], plane) for i in range(2)))
        if exact.area == 0 or pair.flags & Flag.ESTIMATED:
            assert bool(exact.area == 0) == bool(pair.flags & Flag.ESTIMATED)
            continue
        found = (pair.witness_a - case.positions[0]) @ plane
        assert len(found) >= 3
        radius = sum(hull.circumradius for hull in case.hulls)
        patch = shapely.Polygon(found)
        assert patch.is_valid  # the points are in order around the patch, without repetition
        assert shapely.hausdorff_distance(patch, exact) <= 1e-9 * radius
        met += 1
    # A small face of a hull with many faces need not be the one of the optimal normal.
    assert met >= (50 if name in ("box", "prism") else 30 if name != "poly64" else 10)
    assert laid >= met * 0.9


def test_the_feature_angle_is_a_cliff(client):
    """A tilt of 0.9 times the feature angle gives the whole patch; 1.1 times only an edge."""
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.5
    hulls = client.register([cube])
    for angle in (1e-3, 1e-2, 0.1):
        counts = []
        for tilt in (0.0, 0.9 * angle, 1.1 * angle):
            turn = [np.sin(tilt / 2), 0, 0, np.cos(tilt / 2)]
            scene = hullcast.Scene(
                hulls, [[0, 0, 0], [0.1, 0, 0.999]], [[0, 0, 0, 1], turn], body_hulls=[0, 0]
            )
            m = client.query(scene, [[0, 1]], accuracy=hullcast.Accuracy(feature_angle=angle))
            counts.append(int(m.point_counts[0]))
        assert counts == [4, 4, 2]

"""The test of convexity depends on a mesh's geometry only, not on how it is triangulated."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import solids
from solids import BARS, box, cylinder, halved, inverted, sphere, turned

import hullcast
from hullcast import Outcome, _convexity, _nearest, _quickhull

CUBE = box((0, 0, 0), (1, 1, 1))
FAR = box((4, 0, 0), (5, 1, 1))
BOWL = turned([(0, 0), (1, 0), (1, 1), (0.9, 1), (0.9, 0.1), (0, 0.1)], 24)
TORUS = turned(
    [(1 + 0.3 * np.cos(a), 0.3 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 16, False)], 32
)
TUBE = turned([(0.1, 0), (1, 0), (1, 1), (0.1, 1)], 32)


def judge(*parts: np.ndarray) -> _convexity.Dents | None:
    """The result for the parts as one mesh."""
    made = solids.mesh(*parts)
    return _convexity.dents(made.vertices, made.faces)


#: Shapes that are not convex, with the fraction of their hull that they fill.
DENTED = {
    "an L of overlapping bars": (BARS, 6 / 7),
    "the bars doubled": ((*BARS, *BARS), 6 / 7),
    "the bars, one inside out": ((BARS[0], inverted(BARS[1])), 6 / 7),
    "the bars inside out": ((inverted(BARS[0]), inverted(BARS[1])), 6 / 7),
    "the bars without two ends": ((BARS[0][2:], BARS[1]), 6 / 7),
    "an L of bars that touch": ((box((0, 0, 0), (2, 1, 1)), box((0, 1, 0), (1, 2, 1))), 6 / 7),
    "an L with a box in its corner": (
        (*BARS, *(box((-0.4, -0.4, -0.4), (0.4, 0.4, 0.4)),) * 4),
        6 / 7,
    ),
    "two far boxes": ((CUBE, FAR), 2 / 5),
    "two far boxes with equal volumes of copies": ((CUBE, CUBE, CUBE, FAR), 2 / 5),
    "a torus": ((TORUS,), None),
    "a tube with a hole of a tenth": ((TUBE,), 0.99),
    "a bowl": ((BOWL,), 1 - 0.9 * 0.9 * 0.9),
    "a flat dish": (
        (turned([(0, 0), (1, 0), (1, 0.02), (0.9, 0.02), (0.9, 0.01), (0, 0.01)], 24),),
        1 - 0.81 / 2,
    ),
    "a thin profile of two legs": (
        (box((0, 0, 0), (0.01, 0.001, 1)), box((0, 0, 0), (0.001, 0.01, 1))),
        19 / (100 - 40.5),
    ),
    "a cube without a side": ((CUBE[2:],), None),
    "a cube in the dent of bars": ((*BARS, box((0.7, 0.7, -0.5), (0.9, 0.9, 0.5))), None),
}


@pytest.mark.parametrize("name", DENTED)
def test_shapes_that_are_not_convex(name):
    """Catches a volume that counts overlapping, doubled, inverted or open parts wrongly.

    Each shape is found not convex in any position and order of triangles, with the fraction of its
    hull that it fills.
    """
    parts, ratio = DENTED[name]
    rng = np.random.default_rng(181)
    for turn in (np.eye(3), solids.rotation(rng)):
        made = solids.mesh(*(part @ turn.T * 7 + [3, -2, 1] for part in parts))
        order = rng.permutation(len(made.faces))
        found = _convexity.dents(made.vertices, made.faces[order])
        assert found is not None
        assert not _convexity.is_convex(made.vertices, made.faces)
        assert 0 <= found.ratio <= 1
        if ratio is not None:
            assert found.ratio == pytest.approx(ratio, abs=0.03)


def with_t_junctions() -> np.ndarray:
    """A cube with one side cut into strips, whose corners are on no other side."""
    strips = [
        np.array([[[1, 0, a], [1, 1, a], [1, 1, b]], [[1, 0, a], [1, 1, b], [1, 0, b]]])
        for a, b in ((0, 0.3), (0.3, 0.35), (0.35, 1))
    ]
    others = np.array([t for t in CUBE if not (t[:, 0] == 1).all()])
    return np.concatenate([others, *strips])


def mixed(triangles: np.ndarray) -> np.ndarray:
    """The triangles, with every second one inside out."""
    flipped = triangles.copy()
    flipped[::2] = inverted(flipped[::2])
    return flipped


HULLS = {
    "a sphere": (sphere(24, 32),),
    "a fine sphere": (sphere(60, 80),),
    "a cylinder": (cylinder(64),),
    "a cone": (turned([(0, 0), (1, 0), (0, 2)], 48),),
    "a needle": (box((0, 0, 0), (1, 1e-4, 1e-4)),),
    "a plate": (box((0, 0, 0), (1, 1, 1e-4)),),
    "a round plate": (cylinder(100, 1.0, 1e-3),),
    "a lens": (sphere(24, 64) * [1, 1, 0.01],),
    "a box with T-junctions": (with_t_junctions(),),
    "a box of small coplanar triangles": (halved(CUBE, 4),),
    "a box doubled": (CUBE, CUBE),
    "a box, and inside out": (CUBE, inverted(CUBE)),
    "a box of mixed winding": (mixed(CUBE),),
    "a box of mixed winding and T-junctions": (mixed(with_t_junctions()),),
    "a box of a fine and a coarse surface": (halved(CUBE, 3), CUBE),
    "a box of two overlapping halves": (box((0, 0, 0), (0.6, 1, 1)), box((0.4, 0, 0), (1, 1, 1))),
    "a box of two halves that touch": (box((0, 0, 0), (0.3, 1, 1)), box((0.3, 0, 0), (1, 1, 1))),
    "a box with a cavity": (CUBE, inverted(box((0.2, 0.2, 0.2), (0.7, 0.7, 0.7)))),
    "a box with parts inside": (CUBE, sphere(9, 12) * 0.2 + 0.5),
    "a box and triangles without area": (CUBE, CUBE[:, [0, 1, 1]]),
    "a tetrahedron": (
        np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1]])[
            [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]
        ].astype(float),
    ),
}


@pytest.mark.parametrize("name", HULLS)
def test_convex_shapes(name):
    """Catches false alarms: every form of a convex surface is accepted.

    The positions vary, and coordinates are exact, in single precision or with six decimals.
    """
    rng = np.random.default_rng(182)
    for turn in (np.eye(3), solids.rotation(rng), solids.rotation(rng)):
        exact = [part @ turn.T + [0.3, -0.2, 0.1] for part in HULLS[name]]
        for rounded in (np.asarray, np.float32, lambda part: np.round(part, 6)):
            made = solids.mesh(*(np.asarray(rounded(part), dtype=float) for part in exact))
            assert _convexity.is_convex(made.vertices, made.faces)
            assert _convexity.dents(made.vertices, made.faces) is None


@pytest.mark.parametrize("size", [1e-150, 1e-6, 1.0, 1e150])
def test_the_size_of_a_mesh_does_not_matter(size):
    """Catches absolute tolerances, and squares that overflow or underflow."""
    assert judge(CUBE * size) is None
    assert judge(*(bar * size for bar in BARS)).ratio == pytest.approx(6 / 7, abs=0.03)


def column_taken_out(depth: float) -> np.ndarray:
    """A unit cube without a square column at one edge, as two boxes."""
    return np.concatenate([box((0, 0, 0), (1, 1 - depth, 1)), box((0, 0, 0), (1 - depth, 1, 1))])


def test_the_stated_tolerance():
    """Catches a tolerance other than the documented 1 % of the bounding box's diagonal.

    The middle of the hull's facet above the dent is half the column's side from the mesh.
    """
    limit = 2 * _convexity.TOLERANCE * 3**0.5
    assert _convexity.TOLERANCE == 0.01
    for share in (0.2, 0.5, 0.9):
        assert judge(column_taken_out(share * limit)) is None
    for share in (1.1, 1.5, 4.0):
        assert judge(column_taken_out(share * limit)) is not None


def test_a_narrow_hole_is_found_wherever_it_is():
    """Catches sampling that misses a small hole, wherever it is.

    A plate has a square hole whose side is 4 % of the plate's diagonal, which is 0.3 % of its area.
    With the hole filled the plate is convex.
    """
    rng = np.random.default_rng(183)
    for _ in range(20):
        x, y = rng.uniform(0.1, 0.8, 2)
        w = 0.06
        around = [
            box((0, 0, 0), (x, 1, 0.1)),
            box((x + w, 0, 0), (1, 1, 0.1)),
            box((x, 0, 0), (x + w, y, 0.1)),
            box((x, y + w, 0), (x + w, 1, 0.1)),
        ]
        assert judge(*around) is not None
        assert judge(*around, box((x, y, 0), (x + w, y + w, 0.1))) is None


def test_distances_to_triangles():
    """Catches a wrong nearest point.

    Each distance is compared with the least over a fine grid of points on the triangle; some
    triangles are degenerate. The tree's result is compared with that of all triangles one by one.
    """
    rng = np.random.default_rng(184)
    triangles = rng.uniform(-0.5, 0.5, (200, 3, 3)) * rng.choice([0.05, 0.3], (200, 1, 1))
    triangles += rng.uniform(-0.3, 0.3, (200, 1, 3))
    triangles[:10, 2] = triangles[:10, 1]
    triangles[10:15, 1:] = triangles[10:15, :1]
    points = rng.uniform(-0.5, 0.5, (50, 3))
    u, v = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60))
    u, v = u[u + v <= 1], v[u + v <= 1]
    weights = np.stack([1 - u - v, u, v], axis=1)
    step = np.linalg.norm(np.ptp(triangles, axis=1), axis=1) / 59
    every = np.empty((50, 200))
    for k, triangle in enumerate(triangles):
        sampled = np.linalg.norm(points[:, None] - weights @ triangle, axis=2).min(axis=1)
        every[:, k] = _nearest.distances(points, np.broadcast_to(triangle, (50, 3, 3)))
        assert (every[:, k] <= sampled + 1e-12).all()
        assert (every[:, k] >= sampled - step[k]).all()
    tree = _nearest.Tree(triangles)
    found, which = tree.nearest(points, 0.2)
    near = every.min(axis=1) <= 0.2
    assert 10 < near.sum() < 50
    assert found[near] == pytest.approx(every.min(axis=1)[near], abs=1e-15)
    assert np.isinf(found[~near & (every.min(axis=1) > 0.35)]).all()
    to_named = _nearest.distances(points[near], tree.triangles[which[near]])
    assert to_named == pytest.approx(found[near])


def test_the_hull_has_all_points_within_its_error():
    """Catches a hull that loses points.

    No point may be above a facet by more than the error, the facets must form a closed surface, and
    the volume must equal that of scipy's hull.
    """
    spatial = pytest.importorskip("scipy.spatial")
    rng = np.random.default_rng(185)
    clouds = [
        rng.normal(size=(300, 3)),
        sphere(30, 40).reshape(-1, 3),
        halved(CUBE, 3).reshape(-1, 3),
        rng.integers(0, 4, (200, 3)).astype(float),
        rng.normal(size=(100, 3)) * [1, 1e-3, 1e-3],
    ]
    for points in clouds:
        points = points / np.linalg.norm(np.ptp(points, axis=0))
        start, _ = _quickhull.simplex(points)
        for error in (1e-8, 1e-3):
            facets = _quickhull.hull(points, start, error)
            a, b, c = points[facets].swapaxes(0, 1)
            normals = np.cross(b - a, c - a)
            areas = np.linalg.norm(normals, axis=1, keepdims=True)
            heights = (points - points.mean(axis=0)) @ (normals / np.maximum(areas, 1e-300)).T
            offsets = np.einsum("ni,ni->n", normals, a - points.mean(axis=0)) / np.maximum(
                areas[:, 0], 1e-300
            )
            assert (heights - offsets)[:, areas[:, 0] > 1e-9].max() <= error + 1e-9
            assert _convexity._open_edges(facets) == 0
            if error == 1e-8:
                volume = float(np.einsum("ni,ni->", a, np.cross(b, c))) / 6
                assert volume == pytest.approx(spatial.ConvexHull(points).volume, rel=1e-6)


def test_flat_meshes_have_no_answer():
    """Catches a crash for a mesh that lies in one plane, on one line or in one point."""
    flat = CUBE * [1, 1, 0]
    for points in (flat, CUBE * [1, 0, 0], CUBE * 0):
        assert judge(points) is None
        assert _convexity.is_flat(points.reshape(-1, 3))
    assert not _convexity.is_flat(CUBE.reshape(-1, 3))


def test_a_cube_in_the_dent_of_overlapping_bars(client):
    """Catches an L that is accepted as its hull.

    Registering the L warns with the true ratio. The bars by themselves are 0.2 from a cube that the
    L's hull overlaps by 0.42.
    """
    cube = box((0.7, 0.7, -0.2), (1.1, 1.1, 0.2)).reshape(-1, 3)
    with pytest.warns(hullcast.NotConvexWarning) as caught:
        hull = client.register([solids.mesh(*BARS)])
    assert caught.list[0].message.ratio == pytest.approx(6 / 7, abs=0.01)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hulls = client.register([cube, *(solids.mesh(bar) for bar in BARS)])
    scene = hullcast.Scene([*hulls, *hull], np.zeros((4, 3)), [[0, 0, 0, 1]] * 4)
    m = client.query(scene, [[0, 1], [0, 2], [0, 3]], margin=0.5)
    assert m.outcome.tolist() == [Outcome.CONTACT] * 3
    assert m.separation[:2] == pytest.approx([0.2, 0.2])
    assert m.separation[2] == pytest.approx(-0.6 / 2**0.5)
    apart = client.query(scene, [[0, 1], [0, 2]], margin=0.19)
    assert apart.outcome.tolist() == [Outcome.SEPARATED] * 2

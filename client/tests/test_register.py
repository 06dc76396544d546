"""Registering hulls: the returned numbers, and refusals."""

from __future__ import annotations

import array
import decimal
import fractions
import pickle
from typing import Any

import numpy as np
import pytest
from crowds import CUBE
from scipy import spatial
from shapes import FAMILIES, box, family
from solids import stl

import hullcast


def test_registering_says_what_a_hull_is(client):
    """A box has known numbers, and an interior point and a duplicate do not change them."""
    half = np.array([0.5, 1.0, 1.5])
    points = np.concatenate([box(half).vertices, [[0.1, 0.2, 0.3]], box(half).vertices[:1]])
    (hull,) = client.register([points])
    assert (hull.vertex_count, hull.face_count, hull.edge_count) == (8, 6, 12)
    assert hull.volume == pytest.approx(6, rel=1e-14)
    assert hull.contraction_point == pytest.approx(np.zeros(3), abs=1e-15)
    assert hull.inradius == pytest.approx(0.5, rel=1e-14)
    assert hull.inradius <= 0.5
    assert hull.circumradius == pytest.approx(np.linalg.norm(half), rel=1e-14)
    assert hull.geometric_error < 1e-14
    squares = (2 * half) ** 2
    assert np.diag(hull.inertia) == pytest.approx(6 / 12 * (squares.sum() - squares), rel=1e-13)
    assert hull.inertia == pytest.approx(hull.inertia.T)


def test_radii_are_bounds_of_the_brute_force_ones(client):
    """The inradius is not too large, and the circumradius not too small, as other tests assume."""
    rng = np.random.default_rng(38)
    shapes = [shape for name in FAMILIES for shape in family(name, 4, rng)]
    # Without a planarity, no two faces of these shapes are merged.
    hulls = client.register([s.vertices for s in shapes], planarity=None)
    for shape, hull in zip(shapes, hulls, strict=True):
        planes = [shape.plane(face) for face in shape.faces]
        assert hull.face_count == len(planes)
        inner = min(n @ (middle - hull.contraction_point) for n, middle in planes)
        outer = np.linalg.norm(shape.vertices - hull.contraction_point, axis=1).max()
        assert inner * (1 - 1e-13) - 1e-15 <= hull.inradius <= inner * (1 + 1e-15)
        assert outer * (1 - 1e-15) <= hull.circumradius <= outer * (1 + 1e-13)


def test_registering_takes_arrays_and_meshes(client):
    """Lists, float32, Fortran order and objects with vertices give one hull with one id."""

    class Mesh:
        """Like a trimesh mesh, with the one attribute that is used."""

        vertices = CUBE

    forms = [CUBE, CUBE.tolist(), CUBE.astype(np.float32), np.asfortranarray(CUBE), Mesh()]
    hulls = client.register(forms)
    assert len({hull.id for hull in hulls}) == 1
    assert len(set(hulls)) == 1


def test_registering_many_takes_several_messages(client):
    """If there are more hulls than fit one message, all are registered in order."""
    rng = np.random.default_rng(32)
    points = CUBE + rng.uniform(-0.1, 0.1, (1030, 8, 3))
    hulls = client.register(points)
    assert [hull.id for hull in hulls] == [hullcast.hull_id(p) for p in points]


def test_a_given_contraction_point_is_used(client):
    """A given contraction point makes another hull, and is returned as given."""
    centre = np.array([0.25, 0.125, -0.0625])
    plain, moved = client.register([CUBE, CUBE], contraction_points=[None, centre])
    assert (moved.contraction_point == centre).all()
    assert moved.inradius == pytest.approx(0.25)
    assert plain.id != moved.id


@pytest.mark.parametrize(
    ("points", "centre", "reason", "field", "point"),
    [
        (CUBE[:3], None, "TOO_FEW_POINTS", "vertices", None),
        ([[0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, 3]], None, "COLLINEAR", "vertices", None),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], None, "COPLANAR", "vertices", None),
        ([*CUBE, [0, np.nan, 0]], None, "NOT_FINITE", "vertices", 8),
        (CUBE * 1e60, None, "SIZE_OUT_OF_RANGE", "vertices", None),
        (CUBE, [0.5, 0, 0], "CONTRACTION_POINT_NOT_INSIDE", "contraction_point", None),
    ],
)
def test_one_bad_hull_does_not_sink_the_others(client, points, centre, reason, field, point):
    """The error has the hull, the reason and the place; `results` has the other hulls."""
    good = CUBE * 0.75
    with pytest.raises(hullcast.HullRejected) as caught:
        client.register([good, points, CUBE], contraction_points=[None, centre, None])
    error = caught.value
    assert (error.reason, error.field, error.index) == (reason, field, 1)
    if point is not None:
        assert error.point == point
        assert f"hulls[1].{field}[{point}]" in str(error)
    first, second, third = error.results
    assert first.id == hullcast.hull_id(good)
    assert second.reason == reason
    assert third.id == hullcast.hull_id(CUBE)


def test_a_hull_too_large_for_a_message_is_named():
    """Catches an error about bytes that does not say which hull is too large.

    The limit is 1 MB, and a cloud of 60,000 points is among cubes. The cubes can be registered
    without it.
    """
    cloud = np.random.default_rng(39).normal(size=(60_000, 3))
    with hullcast.serve(arguments=["--max-message-bytes", "1048576"]) as client:
        for hulls, place in (([CUBE, CUBE * 2, cloud], 2), ([cloud, CUBE], 0)):
            with pytest.raises(hullcast.InvalidArgument) as caught:
                client.register(hulls)
            error = caught.value
            assert (error.reason, error.place) == ("MESSAGE_TOO_LARGE", f"hulls[{place}]")
            assert "60000 points" in error.message
            assert "at most 1 MiB" in error.message
        assert len(client.register([CUBE, CUBE * 2])) == 2


class Duck:
    """A mesh as in other libraries."""

    def __init__(self, vertices):
        self.vertices = vertices


class FakeScene:
    """The two attributes of a trimesh.Scene that are used."""

    geometry = ()

    def dump(self):
        return [Duck(CUBE), Duck(CUBE * 2)]


@pytest.mark.parametrize(
    "hulls",
    [
        CUBE,
        CUBE.tolist(),
        Duck(CUBE),
        [CUBE],
        (CUBE,),
        CUBE[None],
        iter([CUBE]),
        {1: CUBE}.values(),
    ],
    ids=["array", "rows", "mesh", "list", "tuple", "stack", "iterator", "values"],
)
def test_one_hull_or_several(client, hulls):
    """Catches one hull that is mistaken for a list of points, and an iterable that is refused."""
    assert [hull.id for hull in client.register(hulls)] == [hullcast.hull_id(CUBE)]


def test_shapes_of_other_libraries(client):
    """Catches a scipy hull whose vertex indices are mistaken for points.

    Also catches a scene that is not split into its parts.
    """
    scipy = pytest.importorskip("scipy.spatial")
    (hull,) = client.register(scipy.ConvexHull(CUBE))
    assert hull.id == hullcast.hull_id(CUBE)
    assert client.register([hull]) == [hull] == client.register(hull)
    assert [part.id for part in client.register(FakeScene())] == [
        hullcast.hull_id(CUBE), hullcast.hull_id(CUBE * 2)
    ]  # fmt: skip


def test_faces_are_those_that_features_number(client, get_hulls):
    """Catches faces in another order than the server's, and a hull that cannot be pickled."""
    (hull,) = client.register(CUBE)
    faces = get_hulls([hull])
    assert [face.tolist() for face in hull.faces] == faces._faces[hull.id]
    assert sorted(map(len, hull.faces)) == [4] * 6
    copy = pickle.loads(pickle.dumps(hull))
    assert copy == hull
    assert len(copy.faces) == 6  # faces that were read are kept
    (fresh,) = client.register(CUBE * 3)
    with pytest.raises(hullcast.Error, match="NO_SERVER"):
        _ = pickle.loads(pickle.dumps(fresh)).faces


@pytest.mark.parametrize(("limit", "most"), [("hulls-per-request", 3), ("message-bytes", 2048)])
def test_hulls_over_a_limit_of_the_server_are_registered_in_parts(client, limit, most):
    """Catches hulls that are lost, or in another order, if a server has low limits."""
    rng = np.random.default_rng(9)
    shapes = [rng.normal(size=(12 + i, 3)) for i in range(20)]
    expected = [hull.id for hull in client.register(shapes)]
    with hullcast.serve(arguments=[f"--max-{limit}", str(most)]) as low:
        assert [hull.id for hull in low.register(shapes)] == expected
        shapes[3] = np.zeros((5, 3))
        with pytest.raises(hullcast.HullRejected) as caught:
            low.register(shapes)
        assert (caught.value.index, len(caught.value.results)) == (3, 20)


class Mesh:
    """A mesh as other libraries have it."""

    def __init__(self, vertices, faces):
        self.vertices, self.faces = vertices, faces


def test_a_vertex_that_no_face_uses_is_not_registered(client):
    """A stray vertex far away made the hull larger, without a warning."""
    corners = np.array([[0, 0, 0], [9, 9, 9], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    faces = np.array([[0, 3, 2], [0, 2, 4], [0, 4, 3], [2, 3, 4]])
    mesh = Mesh(corners, faces)
    (hull,) = client.register(mesh)
    assert hull.volume == pytest.approx(1 / 6)
    assert hull.vertices.tolist() == corners[[0, 2, 3, 4]].tolist()
    assert hull.id == hullcast.hull_id(mesh) == hullcast.hull_id(corners[[0, 2, 3, 4]])
    dented = Mesh(
        np.vstack([corners, [[0.1, 0.1, 0.1]]]),
        np.array([[0, 3, 2], [0, 2, 4], [0, 4, 3], [2, 3, 5], [3, 4, 5], [4, 2, 5]]),
    )
    with pytest.warns(hullcast.NotConvexWarning):
        client.register(dented)


class Vertices:
    """A mesh with vertices, and with triangles as another library names them."""

    def __init__(self, vertices: Any, **triangles: Any) -> None:
        self.vertices = vertices
        self.__dict__.update(triangles)


@pytest.mark.parametrize("attribute", ["faces", "triangles", "indices"])
def test_triangles_of_any_name_are_checked_for_convexity(client, attribute):
    """Catches a mesh of open3d or coacd that becomes its hull without a warning.

    The mesh is a cube with a dent: the middle of its upper side is pushed in.
    """
    corners = np.array([*CUBE, [0.0, 0.0, -0.3]])
    faces = [[int(i) for i in face] for face in trimesh_faces(CUBE) if not upper(CUBE[face])]
    ring = np.flatnonzero(CUBE[:, 2] > 0)
    ring = ring[np.argsort(np.arctan2(*CUBE[ring, :2].T))]
    faces += [[int(ring[i]), int(ring[i - 1]), 8] for i in range(4)]
    with pytest.warns(hullcast.NotConvexWarning) as caught:
        client.register(Vertices(corners, **{attribute: faces}))
    assert caught[0].message.ratio < 0.9
    # A vertex that no triangle uses is no part of the mesh.
    far = np.array([*CUBE, [9.0, 9.0, 9.0]])
    (plain,) = client.register(Vertices(far, **{attribute: trimesh_faces(CUBE)}))
    assert plain.vertex_count == 8
    with pytest.raises(
        hullcast.InvalidArgument, match=rf"hulls\[0\]\.{attribute}\[0, 2\]: 9 is out"
    ):
        client.register(Vertices(CUBE, **{attribute: [[0, 1, 9]]}))


def trimesh_faces(points: np.ndarray) -> np.ndarray:
    """(12, 3): the triangles of a box."""
    return spatial.ConvexHull(points).simplices


def upper(corners: np.ndarray) -> bool:
    """Whether a triangle is part of the upper side of the cube."""
    return bool((corners[:, 2] > 0).all())


class Frame:
    """A data frame whose iteration gives columns, as polars' does."""

    def __init__(self, array: np.ndarray) -> None:
        self._array = array

    def __iter__(self) -> Any:
        return iter(self._array.T)

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return self._array


def test_rows_of_any_kind_are_the_points_of_one_hull(client):
    """Catches rows of decimals, arrays or a generator, or the columns of a frame, taken for hulls."""
    (expected,) = client.register(CUBE)
    for points in (
        [[decimal.Decimal(float(x)) for x in row] for row in CUBE],
        [[fractions.Fraction(float(x)) for x in row] for row in CUBE],
        [array.array("d", row) for row in CUBE],
        [tuple(row) for row in CUBE],
        list(CUBE),
        zip(*CUBE.T.tolist(), strict=True),
        (tuple(row) for row in CUBE.tolist()),
        Frame(CUBE),
    ):
        assert client.register(points) == [expected]
    for hulls in ((cube for cube in (CUBE, CUBE * 2)), [Frame(CUBE), Frame(CUBE * 2)]):
        assert len(client.register(hulls)) == 2


def test_a_refused_file_is_named_once(client, tmp_path):
    """Catches `hulls[0].vertices: hulls[0] (flat.stl): ...`, which has the number twice."""
    (tmp_path / "flat.stl").write_bytes(stl(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]] * 2)))
    with pytest.raises(hullcast.HullRejected) as caught:
        client.register([CUBE, tmp_path / "flat.stl"])
    assert str(caught.value).count("hulls[1]") == 1
    assert "hulls[1].vertices: flat.stl: " in str(caught.value)

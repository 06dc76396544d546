"""Convex meshes are registered without a warning, others as their hulls with one; mesh files."""

from __future__ import annotations

import itertools
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from crowds import CUBE
from shapes import FAMILIES, Shape, family

import hullcast


def mesh(shape: Shape, scale: float = 1.0, rng: np.random.Generator | None = None):
    """The triangles of a shape, each with its own corners and in single precision, as in STL."""
    triangles = [[face[0], b, c] for face in shape.faces for b, c in itertools.pairwise(face[1:])]
    points = shape.vertices[np.array(triangles).reshape(-1)] * scale
    if rng is not None:
        points = points * (1 + 1e-8 * rng.normal(size=points.shape))
    points = points.astype(np.float32).astype(float)
    return SimpleNamespace(vertices=points, faces=np.arange(len(points)).reshape(-1, 3))


def ell(depth: float):
    """A unit cube without a corner column.

    Its volume is 1 - depth^2, its hull's 1 - depth^2 / 2.
    """
    d = 1 - depth
    outline = np.array([[0, 0], [1, 0], [1, d], [d, d], [d, 1], [0, 1]], dtype=float)
    points = np.concatenate([np.column_stack([outline, np.full(6, z)]) for z in (0.0, 1.0)])
    faces = [[i, (i + 1) % 6, 6 + (i + 1) % 6] for i in range(6)]
    faces += [[i, 6 + (i + 1) % 6, 6 + i] for i in range(6)]
    # Fans around the dent's corner, from which the whole outline is visible.
    fan = [(3, i, (i + 1) % 6) for i in range(6) if 3 not in (i, (i + 1) % 6)]
    faces += [[6 + a, 6 + b, 6 + c] for a, b, c in fan]
    faces += [[a, c, b] for a, b, c in fan]
    return SimpleNamespace(vertices=points, faces=np.array(faces))


def test_convex_meshes_pass_in_silence(client):
    """Meshes of every family, tiny and huge, inside out, with rounding noise, give no warning."""
    rng = np.random.default_rng(81)
    meshes = []
    for name, scale in itertools.product(FAMILIES, (1e-6, 1.0, 1e6)):
        made = mesh(family(name, 1, rng)[0], scale, rng)
        meshes += [made, SimpleNamespace(vertices=made.vertices, faces=made.faces[:, ::-1])]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(client.register(meshes)) == 30


@pytest.mark.parametrize("depth", [0.2, 0.5, 0.9])
def test_a_dent_is_told_with_its_ratio(client, depth):
    """The ratio has a closed form. The warning names the mesh, and points at the calling line."""
    with pytest.warns(hullcast.NotConvexWarning, match=r"hulls\[1\] is not convex") as caught:
        cube, hull = client.register([CUBE, ell(depth)])
    warning = caught.list[0].message
    assert warning.ratio == pytest.approx((1 - depth**2) / (1 - depth**2 / 2))
    assert (warning.field, warning.open_edges) == ("hulls[1]", 0)
    assert caught.list[0].filename == __file__
    assert hull.volume == pytest.approx(1 - depth**2 / 2)
    assert cube.volume == pytest.approx(1)


def test_a_hole_is_told(client):
    """A convex mesh without one triangle has three open edges."""
    rng = np.random.default_rng(82)
    whole = mesh(family("poly16", 1, rng)[0])
    holed = SimpleNamespace(vertices=whole.vertices, faces=whole.faces[1:])
    with pytest.warns(hullcast.NotConvexWarning, match="not watertight") as caught:
        client.register([holed])
    assert caught.list[0].message.open_edges == 3
    assert 0.3 < caught.list[0].message.ratio < 1


def test_a_mesh_whose_faces_fit_no_vertex_is_refused(client):
    """The error names the argument, and nothing is sent."""
    with pytest.raises(hullcast.InvalidArgument, match=r"hulls\[0\].faces"):
        client.register([SimpleNamespace(vertices=CUBE, faces=[[0, 1, 8]])])


def test_files(client, tmp_path):
    """OBJ and binary STL files give the same hull as their mesh."""
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box((1, 2, 3))
    box.export(tmp_path / "box.stl")
    box.export(tmp_path / "box.obj")
    dented = ell(0.5)
    trimesh.Trimesh(dented.vertices, dented.faces).export(tmp_path / "ell.obj")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hulls = client.register([tmp_path / "box.stl", str(tmp_path / "box.obj"), box])
    for hull in hulls:
        assert hull.volume == pytest.approx(6)
        assert len(hull.vertices) == 8  # corners that triangles share are sent only once
    with pytest.warns(hullcast.NotConvexWarning, match=r"0\.857"):
        client.register([tmp_path / "ell.obj"])
    with pytest.raises(FileNotFoundError):
        client.register([tmp_path / "none.stl"])
    assert client.register(str(tmp_path / "box.stl")) == hulls[:1]  # one file is a list of one
    (tmp_path / "empty.obj").write_text("v 0 0 0\n")
    with pytest.raises(hullcast.InvalidArgument, match="NO_TRIANGLES"):
        client.register([tmp_path / "empty.obj"])

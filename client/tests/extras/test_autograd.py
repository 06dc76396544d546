"""`hullcast.torch` and `hullcast.jax` with the real libraries, beside finite differences."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import Any

import numpy as np
import pages
import pytest
from blocks import ROOT
from crowds import CUBE, four_polyhedra
from crowds import FOUR_PAIRS as PAIRS
from test_pages import EXTRAS

from hullcast import Flag

FUNCTIONS = ["alpha", "separation", "normal"]


@pytest.fixture
def scene(client):
    return four_polyhedra(client)


@pytest.fixture
def torch() -> Any:
    return pytest.importorskip("torch")


@pytest.fixture
def jax() -> Any:
    """jax with numbers of 64 bits."""
    library = pytest.importorskip("jax")
    library.config.update("jax_enable_x64", True)
    yield library
    library.config.update("jax_enable_x64", False)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_torch_accepts_the_gradients(client, scene, torch, name):
    """Catches a gradient that differs from finite differences, by positions or by quaternions."""
    import hullcast.torch

    function = getattr(hullcast.torch, name)
    poses = [torch.tensor(pose, requires_grad=True) for pose in (scene.positions, scene.rotations)]
    of_poses = lambda *poses: function(client, scene, PAIRS, *poses)  # noqa: E731
    assert torch.autograd.gradcheck(of_poses, poses, eps=1e-6, atol=1e-7, rtol=1e-6)
    values = of_poses(*poses)
    m = client.query(scene, PAIRS, margin=np.inf)
    assert np.array_equal(values.detach().numpy(), getattr(m, name))


def test_torch_keeps_types_and_refuses_second_derivatives(client, scene, torch):
    """Catches a result of another type, a gradient that is computed for nothing, and a wrong second one."""
    import hullcast.torch

    singles = [
        torch.tensor(pose, dtype=torch.float32) for pose in (scene.positions, scene.rotations)
    ]
    plain = hullcast.torch.alpha(client, scene, PAIRS, *singles)
    assert plain.dtype == torch.float32
    assert not plain.requires_grad
    positions = torch.tensor(scene.positions, requires_grad=True)
    rotations = torch.tensor(scene.rotations)
    total = hullcast.torch.alpha(client, scene, PAIRS, positions, rotations).sum()
    (gradient,) = torch.autograd.grad(total, positions, create_graph=True)
    with pytest.raises(RuntimeError, match="first derivatives only"):
        gradient.sum().backward()


@pytest.mark.parametrize("name", FUNCTIONS)
def test_jax_accepts_the_gradients(client, scene, jax, name):
    """Catches a gradient that differs from finite differences, and one that a compiled program changes."""
    from jax.test_util import check_grads

    import hullcast.jax

    function = getattr(hullcast.jax, name)
    of_poses = lambda *poses: function(client, scene, PAIRS, *poses)  # noqa: E731
    poses = (scene.positions, scene.rotations)
    check_grads(of_poses, poses, order=1, modes=["rev"], eps=1e-6, atol=1e-7, rtol=1e-6)
    values, pull = jax.vjp(jax.jit(of_poses), *poses)
    m = client.query(scene, PAIRS, margin=np.inf)
    assert np.array_equal(np.asarray(values), getattr(m, name))
    weights = np.ones_like(values)
    for one, other in zip(pull(weights), jax.vjp(of_poses, *poses)[1](weights), strict=True):
        assert np.array_equal(one, other)


def test_jax_maps_over_many_scenes(client, scene, jax):
    """Catches a batch whose entries are mixed, in values or in gradients."""
    import hullcast.jax

    def cost(positions: Any) -> Any:
        return hullcast.jax.alpha(client, scene, PAIRS, positions, scene.rotations).sum()

    shifts = np.random.default_rng(3).normal(scale=0.05, size=(4, *scene.positions.shape))
    batch = scene.positions + shifts
    values, gradients = jax.jit(jax.vmap(jax.value_and_grad(cost)))(batch)
    for positions, value, gradient in zip(batch, values, gradients, strict=True):
        one, other = jax.value_and_grad(cost)(positions)
        assert value == one
        assert np.array_equal(gradient, other)


def test_jax_in_single_precision(client, scene):
    """Catches a callback whose type is not the one that jax expects; 32 bits are jax' default."""
    jax = pytest.importorskip("jax")
    import hullcast.jax

    assert not jax.config.jax_enable_x64
    cost = lambda p: hullcast.jax.alpha(client, scene, PAIRS, p, scene.rotations).sum()  # noqa: E731
    value, gradient = jax.value_and_grad(cost)(scene.positions.astype(np.float32))
    assert value.dtype == gradient.dtype == np.float32
    m = client.query(scene, PAIRS, margin=np.inf)
    assert float(value) == pytest.approx(m.alpha.sum(), rel=1e-5)


def test_at_a_kink_both_libraries_have_one_facets_gradient(client, torch, jax):
    """Catches NaN, or a gradient that is no element of the generalised gradient, at a tie."""
    import hullcast.jax
    import hullcast.torch

    (cube,) = client.register([CUBE])
    positions, rotations = np.array([[0, 0, 0], [0.8, 0.8, 0.2]]), np.tile([0.0, 0, 0, 1], (2, 1))
    two = hullcast.Scene([cube, cube], positions, rotations)
    assert client.query(two, [[0, 1]], outputs=["ALPHA_GRADIENT"]).flags[0] & Flag.KINK
    at = torch.tensor(positions, requires_grad=True)
    hullcast.torch.alpha(client, two, [[0, 1]], at, torch.tensor(rotations)).sum().backward()
    found = at.grad[1].numpy()
    # alpha is max(|x|, |y|, |z|), so the generalised gradient is between (1, 0, 0) and (0, 1, 0).
    assert found.sum() == pytest.approx(1, abs=1e-12)
    assert (found >= -1e-12).all()
    assert abs(found[2]) < 1e-12
    cost = lambda p: hullcast.jax.alpha(client, two, [[0, 1]], p, rotations).sum()  # noqa: E731
    assert np.array_equal(jax.grad(cost)(positions)[1], found)


def test_the_page_about_fitting(torch, jax, tmp_path):
    """Runs the page: a gradient by torch, and the same by jax."""
    assert pages.run(pages.DOCS / "fitting.md", tmp_path) == EXTRAS["fitting"]


def test_the_brick_gets_into_the_corner(torch, tmp_path):
    """Catches a gradient by which the example does not fit the pose."""
    picture = tmp_path / "fitting.png"
    command = [sys.executable, ROOT / "client/examples/fit_pose.py", "--picture", picture]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    assert picture.stat().st_size > 10_000
    x, _, z = (float(number) for number in re.findall(r"\((.*)\)", done.stdout)[0].split(", "))
    # The brick lies on its largest face, with its shortest side, 0.3, upright and its longest, 0.6, off the wall.
    assert x + z == pytest.approx(0.15 + 0.3, abs=0.01)
    alphas = [float(number) for number in re.findall(r"([0-9.]+) with", done.stdout)]
    assert len(alphas) == 2
    assert min(alphas) > 0.97

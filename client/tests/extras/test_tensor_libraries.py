"""Arrays of the real torch, jax and warp, in and out. `test_tensors.py` has stand-ins for devices."""

from __future__ import annotations

import importlib
import warnings
from typing import Any

import numpy as np
import pytest
from crowds import CUBE, EVERYTHING

import hullcast
from hullcast import _arrays, _tensors

torch: Any = pytest.importorskip("torch")
jax: Any = pytest.importorskip("jax")
warp: Any = pytest.importorskip("warp")

POSITIONS = np.array([[0, 0, 0], [0.75, 0, 0], [0, 0, 4]])
TURNS = np.tile([0.0, 0, 0, 1], (3, 1))


@pytest.fixture(params=[False, True], ids=["32 bits", "64 bits"])
def x64(request):
    """jax with numbers of 32 bits, which is its default, and of 64."""
    jax.config.update("jax_enable_x64", request.param)
    yield request.param
    jax.config.update("jax_enable_x64", False)


def scene_of(client: hullcast.Client, make: Any) -> hullcast.Scene:
    """Two cubes that overlap by 0.25 and one that is apart; `make` converts each array."""
    return hullcast.Scene(
        client.register([make(CUBE)]),
        make(POSITIONS),
        make(TURNS),
        body_hulls=make(np.zeros(3, int)),
    )


MAKERS = {
    "torch": torch.from_numpy,
    "torch 32": lambda array: torch.from_numpy(array).to(torch.float32 if array.dtype == "f8" else torch.int32),
    "torch grad": lambda array: torch.from_numpy(array.copy()).requires_grad_(array.dtype == "f8"),
    "torch parameter": lambda array: torch.nn.Parameter(torch.from_numpy(array), array.dtype == "f8"),
    "torch bfloat16": lambda array: torch.from_numpy(array).bfloat16() if array.dtype == "f8" else torch.from_numpy(array),
    "jax": lambda array: jax.numpy.asarray(array),
    "jax bfloat16": lambda array: jax.numpy.asarray(array, "bfloat16" if array.dtype == "f8" else "int8"),
}  # fmt: skip


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_arrays_go_in(client, make):
    """Catches a type that is refused, read as other numbers, or read with a warning.

    Every coordinate is exact in bfloat16, so that all answers have the same bits.
    """
    plain = client.query(scene_of(client, np.array), [[0, 1], [0, 2]])
    assert plain.in_contact.tolist() == [True, False]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = scene_of(client, make)
        pairs = make(np.array([[0, 1], [0, 2]]))
        m = client.query(scene, pairs)
        with client.session(scene, pairs) as session:
            step = session.step(make(POSITIONS), make(TURNS))
        found = client.find(hullcast.Scene(
            client.register([make(CUBE)]), make(POSITIONS), make(TURNS),
            body_hulls=make(np.zeros(3, int)), worlds=make(np.array([1, 1, 2])),
        ))  # fmt: skip
    for other in (m, step):
        assert other.alpha.tobytes() == plain.alpha.tobytes()
        assert other.witness_a.tobytes() == plain.witness_a.tobytes()
    assert found.pairs.tolist() == [[0, 1]]


def test_views_and_lists_go_in(client):
    """Catches strides that are ignored, and lists of arrays that are read one number at a time."""
    rows = np.arange(12.0).reshape(4, 3)
    for made, expected in [
        (torch.from_numpy(rows).T, rows.T),
        (torch.from_numpy(rows)[::2], rows[::2]),
        (torch.from_numpy(rows)[:1].expand(5, 3), np.repeat(rows[:1], 5, axis=0)),
        (jax.numpy.asarray(rows).T, rows.T),
        ([torch.from_numpy(row).requires_grad_() for row in rows.copy()], rows),
        ([jax.numpy.asarray(row) for row in rows], rows),
    ]:
        read = _arrays.floats("positions", made, None, expected.shape[1])
        assert (read == expected).all()
        assert read.flags.c_contiguous
    turn = torch.tensor([[0.5, 0.5, 0.5, 0.5], [1.0, 0, 0, 0]])
    assert hullcast.from_wxyz(turn)[1].tolist() == [0, 0, 0, 1]
    hulls = client.register([torch.from_numpy(CUBE), jax.numpy.asarray(CUBE)])
    assert hulls[0] == hulls[1] == client.register(torch.from_numpy(CUBE))[0]
    assert client.register(torch.from_numpy(np.stack([CUBE, 2 * CUBE])))[0] == hulls[0]


def test_host_memory_is_not_copied_on_the_way_in(x64):
    """Catches a copy in each step. A read-only array of jax stays read-only."""
    tensor = torch.zeros(1000, 3, dtype=torch.float64, requires_grad=True)
    assert _arrays.floats("positions", tensor, None, 3).ctypes.data == tensor.data_ptr()
    array = jax.numpy.zeros((1000, 3))
    read = _tensors.as_numpy(array)
    assert read is not None
    assert read.ctypes.data == array.unsafe_buffer_pointer()
    assert not read.flags.writeable


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: torch.zeros(5, 4), r"expected shape \(5, 3\), got \(5, 4\)"),
        (lambda: torch.tensor(1.0), r"expected shape \(5, 3\), got \(\)"),
        (lambda: torch.zeros(5, 3, dtype=torch.complex64), "expected numbers.*complex64"),
        (lambda: torch.zeros(5, 3, dtype=torch.complex64).conj(), "conjugate"),
        (lambda: torch.zeros(5, 3, dtype=torch.bool), "expected numbers.*bool"),
        (lambda: torch.zeros(5, 3).to_sparse(), "to_dense"),
        (lambda: torch.zeros(5, 3, device="meta"), "meta"),
        (lambda: jax.numpy.zeros((5, 4)), r"expected shape \(5, 3\), got \(5, 4\)"),
        (lambda: jax.numpy.zeros((5, 3), complex), "expected numbers.*complex64"),
        (lambda: jax.numpy.zeros((5, 3), bool), "expected numbers.*bool"),
        (lambda: jax.random.key(0), "PRNGKey"),
    ],
)
def test_what_is_no_array_of_numbers_is_refused(make, says):
    """Each error is this package's own, and names the argument. Catches an imaginary part or a
    storage layout that is dropped in silence."""
    with pytest.raises(hullcast.InvalidArgument, match=f"(?s)positions: .*{says}"):
        hullcast.Scene([b"\1" * 32], make(), [[0, 0, 0, 1]] * 5, body_hulls=[0] * 5)


def test_traced_arrays_are_refused():
    """Catches a hang or a foreign exception where a query is put under `jit`, `grad` or `vmap`."""

    def made(positions: Any) -> Any:
        return hullcast.Scene([b"\1" * 32], positions, [[0, 0, 0, 1]]).positions.sum()

    for traced in (jax.jit(made), jax.grad(made)):
        with pytest.raises(hullcast.InvalidArgument, match=r"(?s)positions: .*traced"):
            traced(jax.numpy.zeros((1, 3)))
    with pytest.raises(hullcast.InvalidArgument, match="positions: "):
        torch.vmap(made)(torch.zeros(2, 1, 3))


def test_pairs_must_be_integers(client):
    """Catches indices that are rounded, and a negative index that wraps around."""
    scene = scene_of(client, np.array)
    for pairs, says in [
        (torch.tensor([[0.0, 1]]), "expected integers"),
        (torch.tensor([[0, 1]]).bfloat16(), "expected integers"),
        (torch.tensor([[0, -1]]), "-1 is out of range"),
        (torch.tensor([[0, 3]]), "3 is out of range"),
        (jax.numpy.array([[0.0, 1]]), "expected integers"),
        (jax.numpy.array([[0, 1]], "bfloat16"), "expected integers"),
    ]:
        with pytest.raises(hullcast.InvalidArgument, match=f"pairs.*{says}"):
            client.query(scene, pairs)


def test_columns_go_to_torch(client):
    """Every column has its name, type and bits, and its memory is shared."""
    m = client.query(scene_of(client, np.array), [[0, 1], [0, 2]], outputs=EVERYTHING)
    tensors = m.to_torch()
    assert {"alpha", "normal", "outcome", "pairs", "point_ids", "witness_b"} <= tensors.keys()
    for name, tensor in tensors.items():
        column = np.asarray(getattr(m, name))
        assert tensor.numpy().dtype == column.dtype, name
        assert tensor.numpy().tobytes() == column.tobytes(), name
        assert tensor.device.type == "cpu"
        assert not column.size or tensor.data_ptr() == column.ctypes.data, name
    assert tensors["pairs"].long()[:, 0].tolist() == [0, 0]
    assert (tensors["outcome"] == hullcast.Outcome.CONTACT).tolist() == [True, False]
    # The columns of some pairs, of a file, and of an empty result can be converted too.
    assert m[:0].to_torch()["normal"].shape == (0, 3)
    assert m[1:].to_torch()["alpha"].tolist() == m.alpha[1:].tolist()
    # Out and in again: the tensors of an answer are arguments of the next query.
    again = client.query(m.scene, tensors["pairs"], outputs=EVERYTHING)
    assert again.alpha.tobytes() == m.alpha.tobytes()


def test_columns_go_to_jax(client, x64):
    """64-bit numbers keep their bits if jax has 64 bits, and are rounded to 32 bits otherwise."""
    m = client.query(scene_of(client, np.array), [[0, 1], [0, 2]], outputs=EVERYTHING)
    arrays = m.to_jax()
    assert arrays.keys() == m.to_torch().keys()
    for name, array in arrays.items():
        column = np.asarray(getattr(m, name))
        kept = column if x64 or column.dtype != "f8" else column.astype("f4")
        assert isinstance(array, jax.Array)
        assert array.dtype == kept.dtype, name
        assert np.asarray(array).tobytes() == kept.tobytes(), name
        aligned = kept is column and column.size and column.ctypes.data % 64 == 0
        assert not aligned or array.unsafe_buffer_pointer() == column.ctypes.data, name
    assert jax.jit(lambda a: a.sum())(arrays["normal"]) == pytest.approx(m.normal.sum())
    again = client.query(m.scene, arrays["pairs"], outputs=EVERYTHING)
    assert again.alpha.tobytes() == m.alpha.tobytes()


def test_columns_go_to_warp(client):
    """Every column has its name, type and bits, and its memory is shared, of empty results too."""
    m = client.query(scene_of(client, np.array), [[0, 1], [0, 2]], outputs=EVERYTHING)
    arrays = m.to_warp()
    assert arrays.keys() == m.to_torch().keys()
    for name, array in arrays.items():
        column = np.asarray(getattr(m, name))
        assert array.numpy().dtype == column.dtype, name
        assert array.numpy().tobytes() == column.tobytes(), name
        assert array.device.is_cpu
        assert not column.size or array.ptr == column.ctypes.data, name
    assert {name for name, array in arrays.items() if array.dtype is warp.vec3d} == {
        "normal", "witness_a", "witness_b",
    }  # fmt: skip
    assert m[:0].to_warp()["normal"].shape == (0,)
    # Warp's arrays are arguments of the next query, without a copy.
    positions = warp.array(POSITIONS, dtype=warp.vec3d, device="cpu")
    assert _arrays.floats("positions", positions, None, 3).ctypes.data == positions.ptr
    again = client.query(m.scene.moved(positions, TURNS), arrays["pairs"], outputs=EVERYTHING)
    assert again.alpha.tobytes() == m.alpha.tobytes()


@pytest.mark.parametrize("library", ["torch", "jax", "warp"])
def test_read_only_columns_go_out(client, library, tmp_path):
    """Catches torch's warning about memory that must not be written, and a failed conversion."""
    m = client.query(scene_of(client, np.array), [[0, 1]])
    m.normal.flags.writeable = False
    m.save(tmp_path / "m.npz")
    importlib.import_module(library)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for answer in (m, hullcast.Manifolds.load(tmp_path / "m.npz")):
            out = getattr(answer, f"to_{library}")()
            assert np.asarray(out["normal"]).tolist() == [[1, 0, 0]]

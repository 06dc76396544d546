"""Arrays of other libraries, in and out; numpy's own DLPack stands in for missing libraries."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import pytest
from crowds import CUBE

import hullcast
from hullcast import _tensors


class Exported:
    """An array of another library, with DLPack but neither `__array__` nor a sequence's methods."""

    def __init__(self, array: np.ndarray) -> None:
        self._array = array

    def __dlpack__(self, **options: Any) -> Any:
        return self._array.__dlpack__(**options)

    def __dlpack_device__(self) -> Any:
        return self._array.__dlpack_device__()


class Recorded(Exported):
    """Like a torch tensor that records gradients: it exports nothing until it is detached."""

    def __dlpack__(self, **options: Any) -> Any:
        raise BufferError("requires grad")

    def detach(self) -> Exported:
        return Exported(self._array)


class OnDevice(Exported):
    """Like a torch tensor on CUDA: this process cannot read its memory until it is copied."""

    def __dlpack__(self, **options: Any) -> Any:
        raise AssertionError("device memory was read")

    def __dlpack_device__(self) -> Any:
        return (2, 0)

    def cpu(self) -> Exported:
        return Exported(self._array)


class Unknown(OnDevice):
    """Like a cupy array, which is copied by `get`."""

    cpu = None  # type: ignore[assignment]

    def get(self) -> np.ndarray:
        return self._array


class Converted:
    """An object with only `__array__`, like those of pandas."""

    def __init__(self, array: np.ndarray) -> None:
        self._array = array

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return self._array if dtype is None else self._array.astype(dtype)


@pytest.mark.parametrize("kind", [Exported, Recorded, OnDevice, Unknown, Converted])
def test_arrays_of_other_libraries_are_taken(client, kind):
    """Catches an export that is refused, or read without being detached or copied to the host."""
    positions, turns = np.zeros((2, 3)), np.tile([0.0, 0, 0, 1], (2, 1))
    positions[1, 0] = 0.9
    hulls = client.register(kind(CUBE)) if hasattr(kind, "ndim") else client.register([kind(CUBE)])
    scene = hullcast.Scene(hulls, kind(positions), kind(turns), body_hulls=kind(np.zeros(2, int)))
    m = client.query(scene, kind(np.array([[0, 1]])))
    assert m.in_contact.tolist() == [True]
    with client.session(scene, kind(np.array([[0, 1]]))) as session:
        found = session.step(kind(positions.astype(np.float32)), kind(turns))
    assert found.in_contact.tolist() == [True]


def test_host_memory_is_not_copied():
    """Catches a copy, in each step, of arrays that are already on the CPU."""
    array = np.zeros((1000, 3))
    assert np.shares_memory(_tensors.as_numpy(Exported(array)), array)


def test_an_export_that_fails_is_named():
    """Catches a foreign exception without the argument's name."""

    class Broken(Exported):
        def __dlpack__(self, **options: Any) -> Any:
            raise BufferError("bfloat16 is not supported")

    with pytest.raises(hullcast.InvalidArgument, match=r"positions: .*bfloat16"):
        hullcast.Scene([b"\1" * 32], Broken(np.zeros((1, 3))), [[0, 0, 0, 1]])


def columns(client: hullcast.Client) -> hullcast.Manifolds:
    scene = hullcast.Scene(
        client.register(CUBE), [[0, 0, 0], [0.9, 0, 0]], [[0, 0, 0, 1]] * 2, body_hulls=[0, 0]
    )
    return client.query(scene, [[0, 1]])


@pytest.mark.parametrize("library", ["torch", "jax", "warp"])
def test_columns_go_out(client, library):
    """Catches a column with another name or type, and a copy that torch does not need."""
    m = columns(client)
    if importlib.util.find_spec(library):
        found = getattr(m, f"to_{library}")()
    else:
        with pytest.raises(ImportError, match=f"pip install {library}"):
            getattr(m, f"to_{library}")()
        plain = {name: _tensors._plain(column) for name, column in m._arrays().items()}
        assert type(plain["outcome"]) is np.ndarray
        assert np.shares_memory(plain["normal"], m.normal)
        found = {name: np.from_dlpack(column) for name, column in plain.items()}
    for name in ("outcome", "alpha", "normal", "separation", "witness_a", "distance", "pairs"):
        assert np.asarray(found[name]) == pytest.approx(getattr(m, name), rel=1e-6)


def test_answers_are_put_together(client):
    """Catches points that are assigned to another pair, and a scene that not all parts have."""
    m = columns(client)
    both = hullcast.Manifolds.concat([m, m[:0], m])
    assert len(both) == 2
    assert both.point_offsets.tolist() == [0, 4, 8]
    assert (both[1].witness_b == m[0].witness_b).all()
    assert both.scene is m.scene
    other = columns(client)
    assert hullcast.Manifolds.concat([m, other]).scene is None
    fewer = client.query(m.scene, [[0, 1]], outputs=["ALPHA"])
    for wrong in ([], [m, fewer], m, [m, 1], None, {}, "m", 5, [None], [[m]]):
        with pytest.raises(hullcast.InvalidArgument, match="expected"):
            hullcast.Manifolds.concat(wrong)

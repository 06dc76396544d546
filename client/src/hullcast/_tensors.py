"""Conversion of arrays from and to other libraries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import numpy.typing as npt

#: DLPack device types whose memory this process can read: CPU, and pinned host memory.
_HOST = (1, 3, 11)


def as_numpy(value: Any) -> npt.NDArray[Any] | None:
    """The numpy array of an object that exports one (torch, jax, cupy, warp); otherwise None.

    Host memory is not copied. Device memory is copied to the host by the library that owns it.
    """
    if isinstance(value, np.ndarray):
        return value  # pyright: ignore[reportUnknownVariableType]
    if not hasattr(value, "__dlpack__") or isinstance(value, np.generic):
        return None
    if hasattr(value, "detach"):  # torch does not export a tensor that records gradients
        value = value.detach()
    device = value.__dlpack_device__()[0] if hasattr(value, "__dlpack_device__") else 1
    if int(device) not in _HOST:
        value = _on_host(value)
        if isinstance(value, np.ndarray):
            return value  # pyright: ignore[reportUnknownVariableType]
    try:
        return np.from_dlpack(value)
    except (BufferError, RuntimeError, TypeError):
        # DLPack cannot pass this array to numpy, for example bfloat16 or read-only memory.
        if _is_torch_float(value):  # numpy has no bfloat16; every such number is a double
            value = value.double()
        if hasattr(value, "__array__"):
            return np.asarray(value)
        raise


def each_as_numpy(value: Any) -> Any:
    """A list of other libraries' arrays as a list of numpy arrays; anything else as it is."""
    if not isinstance(value, (list, tuple)):
        return value
    entries = cast("Sequence[Any]", value)
    if not entries or not hasattr(entries[0], "__dlpack__"):
        return entries
    arrays = [as_numpy(entry) for entry in entries]
    return entries if any(array is None for array in arrays) else arrays


def _is_torch_float(value: Any) -> bool:
    test = getattr(value, "is_floating_point", None)
    return callable(test) and bool(test()) and hasattr(value, "double")


def _on_host(value: Any) -> Any:
    """Copies a device's array to host memory: torch by `cpu`, warp by `numpy`, cupy by `get`."""
    for method in ("cpu", "numpy", "get"):
        if callable(getattr(value, method, None)):
            return getattr(value, method)()
    if hasattr(value, "__array__"):  # jax
        return np.asarray(value)
    return np.from_dlpack(value, device="cpu")


def to_torch(columns: dict[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """The columns as torch tensors on the CPU, which share the columns' memory.

    Versions of torch before 2.3 have no uint32. There these columns are copied to int64.
    """
    try:
        import torch as library
    except ImportError as error:
        raise ImportError("to_torch needs torch: pip install torch") from error
    torch: Any = library
    plain = {name: _plain(column) for name, column in columns.items()}
    if not hasattr(torch, "uint32"):
        plain = {k: v.astype("i8") if v.dtype == "u4" else v for k, v in plain.items()}
    return {name: torch.from_numpy(column) for name, column in plain.items()}


def to_jax(columns: dict[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """The columns as jax arrays on jax's default device.

    On the CPU a column is not copied if jax can use its memory, which must begin at a multiple of
    64 bytes. jax keeps 64-bit numbers only with its setting `jax_enable_x64`; otherwise it rounds
    them to 32 bits.
    """
    try:
        import jax as library
    except ImportError as error:
        raise ImportError("to_jax needs jax: pip install jax") from error
    jax: Any = library
    make = jax.numpy.from_dlpack if jax.default_backend() == "cpu" else jax.numpy.asarray
    return {name: make(_plain(column)) for name, column in columns.items()}


def to_warp(columns: dict[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """The columns as warp arrays on the CPU, which share the columns' memory.

    A float64 column with three entries in each row becomes an array of `vec3d`.
    """
    try:
        import warp as library
    except ImportError as error:
        raise ImportError("to_warp needs warp: pip install warp-lang") from error
    warp: Any = library

    def converted(column: npt.NDArray[Any]) -> Any:
        kind = warp.vec3d if column.dtype == "f8" and column.shape[1:] == (3,) else None
        options = {} if kind is None else {"dtype": kind}
        return warp.array(_plain(column), copy=False, device="cpu", **options)

    return {name: converted(column) for name, column in columns.items()}


def _plain(column: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """A column as a plain numpy array that is contiguous and writable."""
    return np.require(np.asarray(column).view(np.ndarray), requirements=["C", "W"])

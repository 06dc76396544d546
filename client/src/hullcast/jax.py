"""Functions of poses that jax can differentiate (extra `jax`).

    import hullcast.jax
    def cost(positions):
        return hullcast.jax.alpha(client, scene, pairs, positions, scene.rotations).sum()
    jax.grad(cost)(positions)

They may be inside `jax.jit`, `jax.grad` in reverse mode, and `jax.vmap` (which makes one call per
entry). jax computes in single precision unless `jax_enable_x64` is set; poses are then rounded
before the server sees them. The gradient of a pair with the flag KINK is not unique: the page about
derivatives explains which one it is. `import hullcast` does not load this module.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ._client import Client
from ._gradients import PairFunction
from ._scene import Scene

try:
    import jax as _library
except ImportError as error:
    raise ImportError("hullcast.jax needs jax: pip install './client[jax]' in the clone") from error

_jax: Any = _library


def alpha(client: Client, scene: Scene, pairs: Any, positions: Any, rotations: Any) -> Any:
    """The growth scale of each pair, as a function of the poses.

    The server computes the values and the gradients in double precision. It computes gradients only
    if jax differentiates the function. Every pair has a value, whatever its distance.

    Args:
        client: a client, for example of `hullcast.serve()`.
        scene: the bodies; its own poses are not used.
        pairs: (n, 2), the body indices A and B of each pair: an array, which jax does not trace.
        positions: (bodies, 3), a floating-point array.
        rotations: (bodies, 4), quaternions in the order x, y, z, w, which need not be normalised.

    Returns:
        (n,), with the type to which jax promotes both arrays.

    Raises:
        InvalidPoses: a body has an unusable pose. Within `jax.jit`, jax wraps this error.
        InvalidArgument: an argument is not usable; the error names it.
    """
    return _value(PairFunction("alpha", client, scene, pairs), positions, rotations)


def separation(client: Client, scene: Scene, pairs: Any, positions: Any, rotations: Any) -> Any:
    """The signed separation of each pair along its normal; otherwise as `alpha`.

    At a kink the value itself jumps.
    """
    return _value(PairFunction("separation", client, scene, pairs), positions, rotations)


def normal(client: Client, scene: Scene, pairs: Any, positions: Any, rotations: Any) -> Any:
    """The unit normal of each pair, from A to B: (n, 3); otherwise as `alpha`.

    At a kink the value itself jumps.
    """
    return _value(PairFunction("normal", client, scene, pairs), positions, rotations)


def _value(function: PairFunction, positions: Any, rotations: Any) -> Any:
    positions, rotations = _jax.numpy.asarray(positions), _jax.numpy.asarray(rotations)
    kind = _jax.numpy.result_type(positions, rotations, np.float32)
    pair_count = len(np.asarray(function.pairs).reshape(-1, 2))
    width = 3 if function.name == "normal" else 1
    values = (pair_count, 3) if function.name == "normal" else (pair_count,)

    def called(of: Any, shapes: list[tuple[int, ...]], *arguments: Any) -> Any:
        """Calls a method of `function`, also from within a compiled program."""

        def in_type(*arguments: Any) -> list[Any]:
            return [np.asarray(array, kind) for array in of(*arguments)]

        results = [_jax.ShapeDtypeStruct(shape, kind) for shape in shapes]
        return _jax.pure_callback(in_type, results, *arguments, vmap_method="sequential")

    @_jax.custom_vjp
    def value(positions: Any, rotations: Any) -> Any:
        return called(lambda *poses: [function.values(*poses)], [values], positions, rotations)[0]

    def forward(positions: Any, rotations: Any) -> Any:
        shapes = [values, (pair_count, width, 9)]
        found, derivatives = called(function.with_derivatives, shapes, positions, rotations)
        return found, (derivatives, rotations)

    def backward(kept: Any, weights: Any) -> Any:
        bodies = len(kept[1])
        gradients = called(function.pulled_back, [(bodies, 3), (bodies, 4)], *kept, weights)
        poses = (positions, rotations)
        return tuple(by.astype(pose.dtype) for by, pose in zip(gradients, poses, strict=True))

    value.defvjp(forward, backward)
    return value(positions, rotations)
